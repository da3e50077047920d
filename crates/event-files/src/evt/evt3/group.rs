//! The words of events with one time, row and polarity in EVT 3.0: a word for each event, or a vector.
//!
//! A sensor sends a vector as four words: `VECT_BASE_X`, `VECT_12`, `VECT_12`, `VECT_8`, never fewer, and all of its
//! 32 columns lie on the sensor. Decoders rely on both: `OpenEB` takes three words for one vector wherever it meets a
//! `VECT_12`, and refuses a vector that begins in the last 31 columns. Hence five events or more within 32 columns
//! are written as a vector, and fewer as single events, which take no more words.

use event_types::{Event, Polarity};

use super::{ADDR_X, VECT_8, VECT_12, VECT_BASE_X};
use crate::evt::vector::Run;

/// Words of a vector, including that of its first column.
const VECTOR_WORDS: usize = 4;

/// The events at the start of a list that are written together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group {
    /// Number of events.
    pub events: usize,
    /// The words; a single event uses only the first.
    words: [u16; VECTOR_WORDS],
}

/// Returns the word of a single event.
#[inline]
pub(super) fn word(event: &Event) -> u16 {
    ADDR_X << 12 | u16::from(event.polarity == Polarity::On) << 11 | event.x
}

/// Returns whether `event` is written as a word of its own: its time, row and polarity are not those of the event with
/// which it would take a vector, the last of the fewest that one is for.
#[inline]
pub(super) fn is_single(event: &Event, later: &[Event]) -> bool {
    let group = |event: &Event| (event.t_us, event.y, event.polarity);
    let last = later.get(VECTOR_WORDS - 1);
    last.is_none_or(|last| group(last) != group(event))
}

impl Group {
    /// Takes the first events of `events` that one vector can hold in their order (the same time, row and polarity,
    /// with x rising within 32 columns of a sensor of `width` columns), or the first event alone if its vector would
    /// take as many words as single events. Returns `None` if there are no events.
    #[must_use]
    pub fn of(events: &[Event], width: u16) -> Option<Self> {
        let first = events.first()?;
        let polarity = u16::from(first.polarity == Polarity::On) << 11;
        let single = Self {
            events: 1,
            words: [word(first), 0, 0, 0],
        };
        let run = Run::of(events, width);
        if run.count <= VECTOR_WORDS {
            return Some(single);
        }
        // Each part is below the width of its word.
        let part = |shift: u32, mask: u32| (run.columns >> shift & mask) as u16;
        Some(Self {
            events: run.count,
            words: [
                VECT_BASE_X << 12 | polarity | run.x,
                VECT_12 << 12 | part(0, 0xfff),
                VECT_12 << 12 | part(12, 0xfff),
                VECT_8 << 12 | part(24, 0xff),
            ],
        })
    }

    /// Returns the words.
    #[inline]
    #[must_use]
    pub fn words(&self) -> &[u16] {
        let count = if self.events == 1 { 1 } else { VECTOR_WORDS };
        self.words.get(..count).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The words of ON events in these columns of a sensor of `width` columns.
    fn words(columns: &[u16], width: u16) -> Vec<u16> {
        let event = |x: &u16| Event {
            t_us: 5,
            x: *x,
            y: 7,
            polarity: Polarity::On,
        };
        let events: Vec<Event> = columns.iter().map(event).collect();
        let (mut rest, mut words) = (events.as_slice(), Vec::new());
        while let Some(group) = Group::of(rest, width) {
            words.extend_from_slice(group.words());
            rest = &rest[group.events..];
        }
        words
    }

    #[test]
    fn vectors_are_whole() {
        assert_eq!(words(&[], 64), [0_u16; 0]);
        assert_eq!(words(&[10, 11], 64), [0x280a, 0x280b]);
        assert_eq!(
            words(&[10, 11, 12, 13], 64),
            [0x280a, 0x280b, 0x280c, 0x280d]
        );
        assert_eq!(
            words(&[10, 11, 12, 13, 14], 64),
            [0x380a, 0x401f, 0x4000, 0x5000]
        );
        assert_eq!(
            words(&[10, 22, 33, 34, 41, 42], 64),
            [0x380a, 0x4001, 0x4801, 0x5081, 0x282a]
        );
        // Without its first event, a group may be a vector.
        assert_eq!(
            words(&[0, 29, 30, 31, 32, 33], 64),
            [0x2800, 0x381d, 0x401f, 0x4000, 0x5000]
        );
    }

    #[test]
    fn vectors_lie_on_the_sensor() {
        assert_eq!(
            words(&[40, 41, 42, 43, 63], 64),
            [0x3820, 0x4f00, 0x4000, 0x5080]
        );
        assert_eq!(words(&[0, 1, 2, 3, 4], 31).len(), 5);
        assert_eq!(words(&[0, 1, 2, 3, 4], 32).len(), 4);
    }

    #[test]
    fn columns_rise_within_a_vector() {
        assert_eq!(words(&[5, 4, 3, 2, 1, 0], 64).len(), 6);
        assert_eq!(words(&[5, 5, 5, 5, 5, 5], 64).len(), 6);
    }
}
