//! The vendor's control requests, to the device or to its interface:
//!
//! | request | `bRequest` | direction | data |
//! |---|---|---|---|
//! | counts | 0x01 | from the device | [`Counts`] |
//! | restart | 0x02 | to the device | none |
//! | descriptors | 0x20, `wIndex` 7 | from the device | [`crate::DESCRIPTOR_SET`], for Windows |
//!
//! All others are refused with a stall. A restart begins a session: everything that the encoder has queued, and
//! everything received and not used yet, is dropped; so are frames until the next setup.

/// Request that returns what the device has moved and dropped: [`Counts`].
pub const COUNTS: u8 = 0x01;
/// Request that begins a session, without data.
pub const RESTART: u8 = 0x02;
/// Request that returns Windows' descriptor set.
pub const DESCRIPTORS: u8 = 0x20;

/// Size of [`Counts`] in bytes.
pub const COUNTS_BYTES: usize = 40;
/// First byte of [`Counts`], which identifies the layout.
const LAYOUT: u8 = 1;

/// What the device has moved and dropped since it started; all counts wrap. A *message* is a frame or a packet of
/// the event link.
///
/// | at | type | field |
/// |---|---|---|
/// | 0 | u8 | 1, this layout |
/// | 1 | u8 | 1 if the serial port has the encoder, else 0 |
/// | 2 | u16 | 0 |
/// | 4 | u32, little-endian, as all that follow | sessions |
/// | 8 | u32 | messages sent |
/// | 12 | u32 | bytes sent |
/// | 16 | u32 | messages dropped |
/// | 20 | u32 | bytes dropped |
/// | 24 | u32 | bytes received |
/// | 28 | u32 | bytes refused |
/// | 32 | u32 | packets refused |
/// | 36 | u32 | control transfers refused for their length |
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Whether the serial port has the encoder.
    pub serial: bool,
    /// Number of sessions begun.
    pub sessions: u32,
    /// Messages that the host has taken in full.
    pub messages_sent: u32,
    /// Bytes that the host has taken.
    pub bytes_sent: u32,
    /// Messages that nobody listened to, or whose session ended before they were sent in full.
    pub messages_dropped: u32,
    /// Bytes of such messages that were not sent.
    pub bytes_dropped: u32,
    /// Bytes from the host for the encoder.
    pub bytes_received: u32,
    /// Bytes received by the function that does not have the encoder.
    pub bytes_refused: u32,
    /// Packets received by that function.
    pub packets_refused: u32,
    /// Control transfers with more data than the device takes.
    pub controls_refused: u32,
}

impl Counts {
    /// Returns the bytes of the answer to [`COUNTS`].
    #[must_use]
    pub fn to_bytes(&self) -> [u8; COUNTS_BYTES] {
        let mut bytes = [0; COUNTS_BYTES];
        let head = u32::from(LAYOUT) | u32::from(self.serial) << 8;
        let words = [
            head,
            self.sessions,
            self.messages_sent,
            self.bytes_sent,
            self.messages_dropped,
            self.bytes_dropped,
            self.bytes_received,
            self.bytes_refused,
            self.packets_refused,
            self.controls_refused,
        ];
        for (bytes, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
            *bytes = word.to_le_bytes();
        }
        bytes
    }

    /// Reads an answer; `None` if it has another length or layout.
    #[must_use]
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let bytes: &[u8; COUNTS_BYTES] = bytes.try_into().ok()?;
        let word = |at: usize| {
            let word = bytes.as_chunks().0.get(at).copied();
            u32::from_le_bytes(word.unwrap_or_default())
        };
        let head = word(0);
        (head & !0x100 == u32::from(LAYOUT)).then(|| Self {
            serial: head & 0x100 != 0,
            sessions: word(1),
            messages_sent: word(2),
            bytes_sent: word(3),
            messages_dropped: word(4),
            bytes_dropped: word(5),
            bytes_received: word(6),
            bytes_refused: word(7),
            packets_refused: word(8),
            controls_refused: word(9),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_return() {
        let counts = Counts {
            serial: true,
            sessions: 1,
            messages_sent: 2,
            bytes_sent: 3,
            messages_dropped: 4,
            bytes_dropped: 5,
            bytes_received: u32::MAX,
            bytes_refused: 7,
            packets_refused: 8,
            controls_refused: 9,
        };
        let bytes = counts.to_bytes();
        assert_eq!(Counts::parse(&bytes), Some(counts));
        assert_eq!(Counts::parse(&bytes[1..]), None);
        for at in [0, 1, 2, 3] {
            let mut other = bytes;
            other[at] ^= 0x82;
            assert_eq!(Counts::parse(&other), None, "{at}");
        }
    }
}
