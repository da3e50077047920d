//! Frames out of a stream of bytes that may be damaged, and what their order says was lost.

use crate::frame::{Frame, FrameError, SYNC};

/// What stands at the start of received bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Scan<'i> {
    /// A frame; it takes up `frame.bytes`.
    Frame(Frame<'i>),
    /// Not a frame: the next that may be one begins after `skip` bytes, at least 1.
    Damage {
        /// Why.
        error: FrameError,
        /// Bytes to leave out.
        skip: usize,
    },
    /// A frame may begin here: more bytes will tell.
    Incomplete,
}

/// Looks at the start of `bytes`, received but not yet used up.
///
/// After damage the scan goes on at the next sync bytes, inside the damaged frame too, so that a
/// frame that follows it is found whatever the damage was.
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

/// Distance to the next place, not the first, where `sync` or its beginning stands.
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

/// Where a frame stands relative to those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Order {
    /// The one that was due, or the first of all.
    InOrder,
    /// This many frames before it have not come.
    Lost(u32),
    /// It has come before.
    Repeated,
    /// It was due earlier: it had been counted as lost.
    Reordered,
}

/// Follows the sequence numbers of frames, across the 2^32 wrap.
///
/// Remembers the last 64 numbers, which tells a repeated frame from one that overtook others; an
/// older one counts as repeated, so that no event is ever taken twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sequence {
    newest: Option<u32>,
    /// Bit i: number newest - i has come.
    seen: u64,
}

impl Sequence {
    /// Before the first frame.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            newest: None,
            seen: 0,
        }
    }

    /// Takes the number of the frame that has come.
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
