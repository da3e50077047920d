//! Treuzell, the control protocol of Prophesee's boards: a frame sent to one bulk endpoint is answered on another.
//!
//! | bytes | field |
//! |---|---|
//! | 4 | property; with [`WRITE`] to write it; in an answer with [`FAILED`] on failure |
//! | 4 | number of bytes of the payload |
//! | n | payload: 32-bit numbers, or the device's number followed by strings that end with 0 |
//!
//! All numbers are little-endian. The answer has the property of the question; [`FAILED`] alone means that the
//! property does not exist. The answer to a failed register access has the system's error number as its third
//! number.

use anyhow::{Context, Result, bail, ensure};

use crate::link::control::Control;

/// Endpoint for questions.
pub const OUT: u8 = 0x02;
/// Endpoint for answers.
pub const IN: u8 = 0x82;
/// Property flag of a write.
pub const WRITE: u32 = 0x4000_0000;
/// Property flag of a failure.
pub const FAILED: u32 = 0x8000_0000;
/// Length of the longest frame, in bytes.
pub const FRAME_BYTES_MAX: usize = 1024;
/// Number of bytes before the payload.
pub const HEAD_BYTES: usize = 8;

/// Serial number of the board, 32 or 64 bits.
pub const SERIAL: u32 = 0x72;
/// Firmware release of the board, `major << 16 | minor << 8 | patch`.
pub const RELEASE: u32 = 0x79;
/// Build date of the firmware, in seconds since 1970, 64 bits.
pub const BUILD_DATE: u32 = 0x7A;
/// Number of devices on the board.
pub const DEVICES: u32 = 0x1_0000;
/// Name of a device.
pub const NAME: u32 = 0x1_0001;
/// Compatibility strings of a device.
pub const COMPATIBLE: u32 = 0x1_0003;
/// Registers of a device from an address on, 4 bytes each.
pub const REGISTERS: u32 = 0x1_0102;
/// Whether a device streams.
pub const STREAM: u32 = 0x1_0200;

/// Builds a frame from a property and its payload.
#[must_use]
pub fn frame(property: u32, payload: &[u8]) -> Vec<u8> {
    let mut bytes = property.to_le_bytes().to_vec();
    bytes.extend((payload.len() as u32).to_le_bytes());
    bytes.extend(payload);
    bytes
}

/// Returns the property and the payload of a frame; `None` if the bytes are not a whole frame.
#[must_use]
pub fn parse(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (property, rest) = bytes.split_first_chunk()?;
    let (length, payload) = rest.split_first_chunk()?;
    let is_whole = u32::from_le_bytes(*length) as usize == payload.len();
    is_whole.then_some((u32::from_le_bytes(*property), payload))
}

/// Encodes 32-bit numbers as a payload.
#[must_use]
pub fn payload(numbers: &[u32]) -> Vec<u8> {
    numbers.iter().flat_map(|n| n.to_le_bytes()).collect()
}

/// Returns number `index` of a payload, if it is long enough.
#[must_use]
pub fn number(payload: &[u8], index: usize) -> Option<u32> {
    payload
        .as_chunks()
        .0
        .get(index)
        .map(|n| u32::from_le_bytes(*n))
}

/// A board that answers questions.
pub struct Board<'c> {
    control: &'c mut dyn Control,
}

impl<'c> Board<'c> {
    /// Uses the board at a control side.
    pub fn new(control: &'c mut dyn Control) -> Self {
        Self { control }
    }

    /// Returns the control side, for requests outside the protocol.
    pub fn control(&mut self) -> &mut dyn Control {
        self.control
    }

    fn ask(&mut self, property: u32, payload: &[u8]) -> Result<Vec<u8>> {
        let asked = || format!("property {property:#x}");
        self.control
            .bulk_out(OUT, &frame(property, payload))
            .with_context(asked)?;
        let mut answer = [0; FRAME_BYTES_MAX];
        let length = self.control.bulk_in(IN, &mut answer).with_context(asked)?;
        let answer = answer.get(..length).unwrap_or(&answer);
        let name = self.control.name();
        let Some((of, content)) = parse(answer) else {
            bail!(
                "{name}: its answer of {length} bytes to property {property:#x} is not a valid \
                 frame: reconnect it"
            );
        };
        ensure!(
            of != FAILED,
            "{name}: its firmware has no property {property:#x}: update the firmware"
        );
        if of == property | FAILED {
            let why = number(content, content.len() / 4 - usize::from(content.len() >= 4));
            bail!(
                "{name}: property {property:#x} failed{}",
                why.map_or_else(String::new, |why| format!(" (error {why})"))
            );
        }
        ensure!(
            of == property,
            "{name}: it answered a request for property {property:#x} with property {of:#x}: reconnect it"
        );
        Ok(content.to_vec())
    }

    fn short(&self, property: u32) -> String {
        let name = self.control.name();
        format!("{name}: its answer to property {property:#x} is too short")
    }

    /// Reads a property that is a number.
    ///
    /// # Errors
    /// The board is gone, or has no such property.
    pub fn number(&mut self, property: u32) -> Result<u32> {
        let answer = self.ask(property, &[])?;
        number(&answer, 0).with_context(|| self.short(property))
    }

    /// Reads the serial number as hexadecimal digits, at least eight.
    ///
    /// # Errors
    /// As for [`Board::number`].
    pub fn serial(&mut self) -> Result<String> {
        let answer = self.ask(SERIAL, &[])?;
        let low = number(&answer, 0).with_context(|| self.short(SERIAL))?;
        let high = number(&answer, 1).unwrap_or(0);
        Ok(format!("{:08x}", u64::from(high) << 32 | u64::from(low)))
    }

    /// Reads a property of a device that consists of strings.
    ///
    /// # Errors
    /// As for [`Board::number`].
    pub fn strings(&mut self, property: u32, device: u32) -> Result<Vec<String>> {
        let answer = self.ask(property, &payload(&[device]))?;
        let (_, text) = answer
            .split_first_chunk::<4>()
            .with_context(|| self.short(property))?;
        let strings = text.split(|byte| *byte == 0);
        Ok(strings
            .filter(|string| !string.is_empty())
            .map(|string| String::from_utf8_lossy(string).into_owned())
            .collect())
    }

    /// Reads a register of a device.
    ///
    /// # Errors
    /// As for [`Board::number`], or the answer is for another register.
    pub fn read(&mut self, device: u32, address: u32) -> Result<u32> {
        let answer = self.ask(REGISTERS, &payload(&[device, address, 1]))?;
        self.check(&answer, device, address)?;
        number(&answer, 2).with_context(|| self.short(REGISTERS))
    }

    /// Writes a register of a device.
    ///
    /// # Errors
    /// As for [`Board::read`].
    pub fn write(&mut self, device: u32, address: u32, value: u32) -> Result<()> {
        let answer = self.ask(REGISTERS | WRITE, &payload(&[device, address, value]))?;
        self.check(&answer, device, address)
    }

    fn check(&self, answer: &[u8], device: u32, address: u32) -> Result<()> {
        let of = (number(answer, 0), number(answer, 1));
        ensure!(
            of == (Some(device), Some(address)),
            "{}: its answer is not for register {address:#x}: reconnect it",
            self.control.name()
        );
        Ok(())
    }

    /// Turns the streaming of a device on or off.
    ///
    /// # Errors
    /// As for [`Board::number`].
    pub fn stream(&mut self, device: u32, on: bool) -> Result<()> {
        self.ask(STREAM | WRITE, &payload(&[device, on.into()]))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn frames_are_those_of_the_protocol() {
        // A write of register 0x9028, as drivers send it.
        let expected = [
            0x02, 0x01, 0x01, 0x40, 0x0c, 0, 0, 0, 0, 0, 0, 0, 0x28, 0x90, 0, 0, 2, 0, 0, 0,
        ];
        assert_eq!(
            frame(REGISTERS | WRITE, &payload(&[0, 0x9028, 2])),
            expected
        );
        assert_eq!(frame(SERIAL, &[]), [0x72, 0, 0, 0, 0, 0, 0, 0]);
    }

    proptest! {
        #[test]
        fn frames_return(property: u32, content in proptest::collection::vec(any::<u8>(), 0..100)) {
            let bytes = frame(property, &content);
            prop_assert_eq!(parse(&bytes), Some((property, &content[..])));
            prop_assert_eq!(parse(&bytes[..bytes.len() - 1]), None);
        }

        #[test]
        fn any_bytes_are_survived(bytes in proptest::collection::vec(any::<u8>(), 0..40), index in 0..12_usize) {
            if let Some((_, content)) = parse(&bytes) {
                prop_assert_eq!(number(content, index).is_some(), content.len() >= 4 * index + 4);
            }
        }
    }
}
