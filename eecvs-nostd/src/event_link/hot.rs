//! Pixels that are never sent, as a packet's body: of each one its number, y * width + x, minus the number before
//! (at first 0), as a varint of postcard's. Some 200 pixels fill a packet.

use postcard::take_from_bytes;

use super::BODY_BYTES_MAX;

/// Writes or reads a body's pixel numbers, which ascend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HotNumbers {
    /// Bytes of the body so far.
    bytes: usize,
    /// The last number.
    last: u32,
}

impl HotNumbers {
    /// State at the start of a body.
    pub const START: Self = Self { bytes: 0, last: 0 };

    /// Returns the number of bytes written or read so far.
    #[must_use]
    pub const fn bytes(&self) -> usize {
        self.bytes
    }

    /// Appends a number; returns `false` if it is below the one before or there is no room.
    pub fn write(&mut self, number: u32, body: &mut [u8; BODY_BYTES_MAX]) -> bool {
        let Some(step) = number.checked_sub(self.last) else {
            return false;
        };
        let Some(room) = body.get_mut(self.bytes..) else {
            return false;
        };
        let Ok(written) = postcard::to_slice(&step, room) else {
            return false;
        };
        self.bytes += written.len();
        self.last = number;
        true
    }

    /// Reads the next number of a body; `None` at its end, and if what follows is not a number.
    pub fn read(&mut self, body: &[u8]) -> Option<u32> {
        let rest = body.get(self.bytes..)?;
        let (step, after) = take_from_bytes::<u32>(rest).ok()?;
        self.bytes += rest.len() - after.len();
        self.last = self.last.checked_add(step)?;
        Some(self.last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    proptest! {
        #[test]
        fn numbers_come_back(mut numbers in proptest::collection::vec(any::<u32>(), 0..150)) {
            numbers.sort_unstable();
            let (mut body, mut writer) = ([0; BODY_BYTES_MAX], HotNumbers::START);
            let fits = numbers.iter().take_while(|number| writer.write(**number, &mut body)).count();
            // No number takes more than five bytes.
            prop_assert!(fits == numbers.len() || fits * 5 > BODY_BYTES_MAX - 5);
            let body = &body[..writer.bytes()];
            let mut reader = HotNumbers::START;
            let read: Vec<_> = core::iter::from_fn(|| reader.read(body)).collect();
            prop_assert_eq!(&read, &numbers[..fits]);
            prop_assert_eq!(reader.bytes(), body.len());
        }

        #[test]
        fn any_body_ends(body in proptest::collection::vec(any::<u8>(), 0..BODY_BYTES_MAX)) {
            let mut reader = HotNumbers::START;
            let count = core::iter::from_fn(|| reader.read(&body)).count();
            prop_assert!(count <= body.len() && reader.bytes() <= body.len());
        }
    }
}
