//! Packets of raw events: a device's own words, with what a reader needs to start at any packet.
//!
//! A packet carries the content of an `EventPacket` of the ROS drivers as bytes. All numbers are little-endian:
//!
//! | bytes | content |
//! |---|---|
//! | 2 | sync EE C7 |
//! | 1 | version, 1 |
//! | 1 | flags: bit 0 the time base is known, bit 1 bytes before these are missing |
//! | 32 | encoding: the device model's name, `/`, its stream's name; padded with 0 |
//! | 2, 2 | width, height of the sensor |
//! | 4 | sequence number of the packet, wrapping |
//! | 8 | time base: the device's time before the first word, in microseconds, wraps included |
//! | 4 | events in the words |
//! | 4 | bytes of the words, at most [`WORDS_BYTES_MAX`] |
//! | n | the words |
//! | 4 | CRC-32 (ISO HDLC) of everything before |
//!
//! The words continue those of the packet before. A reader that starts, or that missed a packet, passes the time
//! base to its parser, which then resumes at the next word of time.

use crc::{CRC_32_ISO_HDLC, Crc};
use eecvs_nostd::Sensor;
use zerocopy::byteorder::little_endian::{U16, U32, U64};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, Unaligned};

/// First bytes of a packet.
pub const SYNC: [u8; 2] = [0xEE, 0xC7];
const VERSION: u8 = 1;
/// Most bytes of words in a packet.
pub const WORDS_BYTES_MAX: usize = 1 << 20;
/// Length of the longest packet, in bytes.
pub const PACKET_BYTES_MAX: usize = size_of::<Head>() + WORDS_BYTES_MAX + CRC_BYTES;
/// Size of the field for the encoding's name, in bytes.
pub const ENCODING_BYTES: usize = 32;
const CRC_BYTES: usize = 4;
const TIME_IS_KNOWN: u8 = 1;
const AFTER_LOSS: u8 = 2;

static CRC: Crc<u32, crc::Table<16>> = Crc::<u32, crc::Table<16>>::new(&CRC_32_ISO_HDLC);

#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, KnownLayout, Immutable, Unaligned)]
#[repr(C)]
struct Head {
    sync: [u8; 2],
    version: u8,
    flags: u8,
    encoding: [u8; ENCODING_BYTES],
    width: U16,
    height: U16,
    sequence: U32,
    time_base_us: U64,
    events: U32,
    words_bytes: U32,
}

/// The content of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet<'b> {
    /// Name of the device's model, `/`, and name of its stream: `evk4/evt3`.
    pub encoding: &'b str,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// Sequence number of the packet, wrapping.
    pub sequence: u32,
    /// The device's time before the first word, in microseconds, if known.
    pub time_base_us: Option<u64>,
    /// Whether bytes before these are missing.
    pub after_loss: bool,
    /// Number of events in the words.
    pub events: u32,
    /// The words as the device sent them; the first and the last may be incomplete.
    pub words: &'b [u8],
}

/// What [`Packet::look`] found at the start of received bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look<'b> {
    /// A packet and its length in bytes.
    Packet(Packet<'b>, usize),
    /// The beginning of a packet, as far as it has been received.
    Incomplete,
    /// Not a packet; a checksum over this many bytes said so.
    Damage(usize),
}

impl<'b> Packet<'b> {
    /// Appends the packet to `bytes`. `words` longer than [`WORDS_BYTES_MAX`] and an encoding name longer than
    /// [`ENCODING_BYTES`] are truncated.
    pub fn write(&self, bytes: &mut Vec<u8>) {
        let words = &self.words[..self.words.len().min(WORDS_BYTES_MAX)];
        let mut encoding = [0; ENCODING_BYTES];
        for (to, from) in encoding.iter_mut().zip(self.encoding.bytes()) {
            *to = from;
        }
        let head = Head {
            sync: SYNC,
            version: VERSION,
            flags: (u8::from(self.time_base_us.is_some()) * TIME_IS_KNOWN)
                | (u8::from(self.after_loss) * AFTER_LOSS),
            encoding,
            width: self.sensor.width.into(),
            height: self.sensor.height.into(),
            sequence: self.sequence.into(),
            time_base_us: self.time_base_us.unwrap_or(0).into(),
            events: self.events.into(),
            words_bytes: (words.len() as u32).into(),
        };
        let start = bytes.len();
        bytes.extend_from_slice(head.as_bytes());
        bytes.extend_from_slice(words);
        let crc = CRC.checksum(&bytes[start..]);
        bytes.extend_from_slice(&crc.to_le_bytes());
    }

    /// Parses the packet at the start of `bytes`.
    #[must_use]
    pub fn look(bytes: &'b [u8]) -> Look<'b> {
        if bytes.iter().zip(SYNC).any(|(byte, sync)| *byte != sync) {
            return Look::Damage(0);
        }
        let Ok((head, rest)) = Head::ref_from_prefix(bytes) else {
            return Look::Incomplete;
        };
        let words_bytes = head.words_bytes.get() as usize;
        let name = head.encoding.split(|byte| *byte == 0).next();
        let (Some(sensor), Some(Ok(encoding)), true) = (
            Sensor::new(head.width.get(), head.height.get()),
            name.map(std::str::from_utf8),
            head.version == VERSION && words_bytes <= WORDS_BYTES_MAX,
        ) else {
            return Look::Damage(0);
        };
        let Some((words, rest)) = rest.split_at_checked(words_bytes) else {
            return Look::Incomplete;
        };
        let Some((crc, _)) = rest.split_first_chunk() else {
            return Look::Incomplete;
        };
        let body_bytes = size_of::<Head>() + words_bytes;
        if CRC.checksum(&bytes[..body_bytes]) != u32::from_le_bytes(*crc) {
            return Look::Damage(body_bytes + CRC_BYTES);
        }
        let packet = Self {
            encoding,
            sensor,
            sequence: head.sequence.get(),
            time_base_us: (head.flags & TIME_IS_KNOWN != 0).then_some(head.time_base_us.get()),
            after_loss: head.flags & AFTER_LOSS != 0,
            events: head.events.get(),
            words,
        };
        Look::Packet(packet, body_bytes + CRC_BYTES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn packets_come_back_and_damage_is_seen(
            (width, height) in (1..=2048_u16, 1..=2048_u16),
            sequence: u32,
            time_base_us: Option<u64>,
            after_loss: bool,
            events: u32,
            words in proptest::collection::vec(any::<u8>(), 0..300),
            flip in 0..2000_usize,
        ) {
            let packet = Packet {
                encoding: "davis346/davis",
                sensor: Sensor::new(width, height).unwrap(),
                sequence,
                time_base_us,
                after_loss,
                events,
                words: &words,
            };
            let mut bytes = Vec::new();
            packet.write(&mut bytes);
            prop_assert_eq!(Packet::look(&bytes), Look::Packet(packet, bytes.len()));
            for length in 0..bytes.len() {
                prop_assert_eq!(Packet::look(&bytes[..length]), Look::Incomplete);
            }
            let bit = flip % (8 * bytes.len());
            bytes[bit / 8] ^= 1 << (bit % 8);
            // A damaged length field may make the packet look incomplete.
            prop_assert!(!matches!(Packet::look(&bytes), Look::Packet(..)));
        }
    }

    #[test]
    fn bytes_are_these() {
        let mut bytes = Vec::new();
        let packet = Packet {
            encoding: "evk4/evt3",
            sensor: Sensor::new(1280, 720).unwrap(),
            sequence: 7,
            time_base_us: Some(0x0102),
            after_loss: false,
            events: 1,
            words: &[0xAA, 0x0B],
        };
        packet.write(&mut bytes);
        let mut expected = vec![0xEE, 0xC7, 1, 1];
        expected.extend(*b"evk4/evt3");
        expected.extend([0; 23]);
        expected.extend([
            0, 5, 0xD0, 2, 7, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0,
        ]);
        expected.extend([2, 0, 0, 0, 0xAA, 0x0B]);
        assert_eq!(bytes[..bytes.len() - 4], expected);
    }
}
