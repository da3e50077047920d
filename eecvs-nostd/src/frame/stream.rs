//! Finds frames in a stream of bytes that may be damaged, and detects lost frames by their sequence numbers.

use crate::frame::{Frame, FrameError, SYNC};

/// What was found at the start of received bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Scan<'i> {
    /// A frame, of `frame.bytes` bytes.
    Frame(Frame<'i>),
    /// Not a frame: the next one can begin after `skip` bytes, at least 1.
    Damage {
        /// Why it is not a frame.
        error: FrameError,
        /// Number of bytes to skip.
        skip: usize,
    },
    /// A frame may begin here; deciding takes more bytes.
    Incomplete,
}

/// Looks for a frame at the start of `bytes`, the bytes received but not used yet.
///
/// After damage the search resumes at the next sync bytes, even inside the damaged frame, so that a following frame
/// is found whatever the damage was.
#[must_use]
pub fn scan(bytes: &[u8]) -> Scan<'_> {
    if bytes.is_empty() {
        return Scan::Incomplete;
    }
    match Frame::parse(bytes) {
        Ok(frame) => Scan::Frame(frame),
        Err(FrameError::Incomplete) => Scan::Incomplete,
        Err(error) => Scan::Damage {
            error,
            skip: next_sync(bytes, SYNC),
        },
    }
}

/// Returns the distance to the next position after the first where `sync`, or a beginning of it cut off by the end,
/// is found.
pub(crate) fn next_sync(bytes: &[u8], sync: [u8; 2]) -> usize {
    let mut skip = 1;
    loop {
        let Some(rest) = bytes.get(skip..).filter(|rest| !rest.is_empty()) else {
            return bytes.len();
        };
        if rest.iter().zip(sync).all(|(byte, sync)| *byte == sync) {
            return skip;
        }
        skip += 1;
    }
}

/// Position of a frame in the sequence, relative to those received before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Order {
    /// The frame that was due, or the first of all.
    InOrder,
    /// This many frames before it are missing.
    Lost(u32),
    /// A frame with this number was received before.
    Repeated,
    /// A late frame, which had been counted as lost.
    Reordered,
}

/// Follows the sequence numbers of frames, across the wrap at 2^32.
///
/// It remembers which of the last 64 numbers were received, which distinguishes a repeated frame from a late one. A
/// frame older than that counts as repeated, so that no event is ever used twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sequence {
    newest: Option<u32>,
    /// Bit i is set if number newest - i was received.
    seen: u64,
}

impl Sequence {
    /// Returns the state before the first frame, which may have any number.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            newest: None,
            seen: 0,
        }
    }

    /// Takes note of a received frame's number and returns its position in the sequence.
    pub fn follow(&mut self, sequence: u32) -> Order {
        let Some(newest) = self.newest else {
            *self = Self {
                newest: Some(sequence),
                seen: 1,
            };
            return Order::InOrder;
        };
        let ahead = sequence.wrapping_sub(newest);
        if ahead != 0 && ahead < 1 << 31 {
            self.newest = Some(sequence);
            self.seen = self.seen.checked_shl(ahead).unwrap_or(0) | 1;
            return if ahead == 1 {
                Order::InOrder
            } else {
                Order::Lost(ahead - 1)
            };
        }
        let behind = newest.wrapping_sub(sequence);
        match 1_u64.checked_shl(behind) {
            Some(bit) if self.seen & bit == 0 => {
                self.seen |= bit;
                Order::Reordered
            }
            _ => Order::Repeated,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_is_told_across_the_wrap() {
        let mut sequence = Sequence::new();
        for (number, order) in [
            (u32::MAX - 1, Order::InOrder),
            (u32::MAX, Order::InOrder),
            (0, Order::InOrder),
            (0, Order::Repeated),
            (3, Order::Lost(2)),
            (1, Order::Reordered),
            (1, Order::Repeated),
            (u32::MAX, Order::Repeated),
            (4, Order::InOrder),
        ] {
            assert_eq!(sequence.follow(number), order, "{number}");
        }
        assert_eq!(sequence.follow(104), Order::Lost(99));
        assert_eq!(sequence.follow(40), Order::Repeated);
        assert_eq!(sequence.follow(41), Order::Reordered);
    }

    #[test]
    fn garbage_is_skipped_to_the_next_sync() {
        assert_eq!(
            scan(&[1, 2, 0xEE, 0xC5, 1]),
            Scan::Damage {
                error: FrameError::Sync,
                skip: 2
            }
        );
        assert_eq!(
            scan(&[1, 2, 0xEE]),
            Scan::Damage {
                error: FrameError::Sync,
                skip: 2
            }
        );
        assert_eq!(
            scan(&[0xEE, 0xC5, 99, 0]),
            Scan::Damage {
                error: FrameError::Version(99),
                skip: 4
            }
        );
        assert_eq!(scan(&[0xEE]), Scan::Incomplete);
    }
}
