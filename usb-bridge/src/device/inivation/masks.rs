//! Packs events of one column into masks of 8 pixels, keeping their order.

use eecvs_nostd::{Event, Polarity};

/// Events of the same time, column and polarity in a group of 8 rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mask {
    /// Rows 8 * group to 8 * group + 7.
    pub group: u16,
    /// Bit i stands for row 8 * group + i.
    pub bits: u8,
    /// 1 if the events are OFF, 0 if they are ON.
    pub off: u16,
}

impl Mask {
    /// Returns the mask of the first events, and their number. It includes only events that are in the order in
    /// which a mask is read, so that order and duplicates survive. `None` if there are no events.
    pub fn first(events: &[Event]) -> Option<(Self, usize)> {
        let first = events.first()?;
        let group = first.y / 8;
        let mut bits = 0;
        let mut count = 0;
        let belongs = |event: &&Event| {
            (event.t_us, event.x, event.polarity) == (first.t_us, first.x, first.polarity)
                && event.y / 8 == group
        };
        for event in events.iter().take_while(belongs) {
            let bit = 1_u8 << (event.y % 8);
            if bits >= bit {
                break;
            }
            bits |= bit;
            count += 1;
        }
        let off = u16::from(first.polarity == Polarity::Off);
        Some((Self { group, bits, off }, count))
    }

    /// Returns the mask after the first `taken` events if it belongs to the same column and time; see
    /// [`Mask::first`].
    pub fn next(events: &[Event], taken: usize) -> Option<(Self, usize)> {
        let (first, rest) = (events.first()?, events.get(taken..)?);
        let same = rest
            .first()
            .is_some_and(|event| (event.t_us, event.x) == (first.t_us, first.x));
        if same { Self::first(rest) } else { None }
    }
}
