//! One packet of the event link.

use crate::checksum::CRC_16;

/// First two bytes of a packet.
pub const SYNC: [u8; 2] = [0xEE, 0xC6];
/// Size of the largest body in bytes.
pub const BODY_BYTES_MAX: usize = 512;
/// Size of the largest packet in bytes.
pub const PACKET_BYTES_MAX: usize = HEAD_BYTES + BODY_BYTES_MAX + CRC_BYTES;

/// Size of sync, kind, body length and position.
pub(super) const HEAD_BYTES: usize = 9;
pub(super) const CRC_BYTES: usize = 2;

/// Kind of a packet, with its code on the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Kind {
    /// A [`Setup`](super::Setup), with which the encoder starts anew.
    Setup = 1,
    /// EVT 2.0 words, little-endian.
    Words = 2,
    /// The end of the stream: the open window has to be closed and sent.
    Flush = 3,
    /// A [`Status`](super::Status) from the encoder, its answer to every kind but words.
    Status = 4,
    /// Pixels that are never sent, on the sensor of the setup before: [`HotNumbers`](super::HotNumbers).
    Hot = 5,
}

impl Kind {
    pub(super) const fn from_code(code: u8) -> Option<Self> {
        match code {
            1 => Some(Self::Setup),
            2 => Some(Self::Words),
            3 => Some(Self::Flush),
            4 => Some(Self::Status),
            5 => Some(Self::Hot),
            _ => None,
        }
    }
}

/// One packet of the event link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Packet<'p> {
    /// What the body holds.
    pub kind: Kind,
    /// Number of events sent before it since the setup; wraps.
    pub position: u32,
    /// Content of at most [`BODY_BYTES_MAX`] bytes.
    pub body: &'p [u8],
}

/// Error: the packet does not fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TooLong;

impl Packet<'_> {
    /// Writes the packet to the start of `out` and returns its length in bytes.
    ///
    /// # Errors
    /// [`TooLong`] if the body exceeds [`BODY_BYTES_MAX`], or `out` is too short.
    pub fn write(&self, out: &mut [u8]) -> Result<usize, TooLong> {
        let crc_at = HEAD_BYTES + self.body.len();
        let end = crc_at + CRC_BYTES;
        if self.body.len() > BODY_BYTES_MAX || out.len() < end {
            return Err(TooLong);
        }
        out[..2].copy_from_slice(&SYNC);
        out[2] = self.kind as u8;
        out[3..5].copy_from_slice(&(self.body.len() as u16).to_le_bytes());
        out[5..9].copy_from_slice(&self.position.to_le_bytes());
        out[HEAD_BYTES..crc_at].copy_from_slice(self.body);
        let crc = CRC_16.checksum(&out[..crc_at]);
        out[crc_at..end].copy_from_slice(&crc.to_le_bytes());
        Ok(end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_too_long_is_refused() {
        let body = [0; BODY_BYTES_MAX + 1];
        let packet = Packet {
            kind: Kind::Words,
            position: 0,
            body: &body,
        };
        assert_eq!(packet.write(&mut [0; 2 * PACKET_BYTES_MAX]), Err(TooLong));
        let packet = Packet {
            body: &[1, 2],
            ..packet
        };
        assert_eq!(packet.write(&mut [0; HEAD_BYTES + 3]), Err(TooLong));
        assert_eq!(packet.write(&mut [0; HEAD_BYTES + 4]), Ok(HEAD_BYTES + 4));
    }
}
