//! Parses the stream of the DVS128: records of 4 bytes.
//!
//! | bytes | bits | meaning |
//! |---|---|---|
//! | 0, 1 | 15 | external input, not an event |
//! | | 14..8 | 127 - y |
//! | | 7..1 | 127 - x |
//! | | 0 | polarity, 0 = ON |
//! | 2, 3 | 15 | wrap: + 2^14 us, the other bits are ignored |
//! | | 14 | the counter was reset, the other bits are ignored |
//! | | 13..0 | time in us |
//!
//! Every record has its own time, so events are decoded again from the first record after a loss. x and y are
//! flipped as in libcaer: (0, 0) is the upper left.

use eecvs_nostd::{Event, Polarity, Sensor};

use super::SENSOR;
use crate::device::inivation::parser::{Reader, State, Word, WordParser};
use crate::device::inivation::tally::Count;

/// Bits of time in a record.
pub const TIME_BITS: u32 = 14;

/// Parses the stream of a DVS128.
pub type Dvs128Parser = WordParser<Records>;

impl Dvs128Parser {
    /// Starts at the beginning of a stream.
    #[must_use]
    pub fn begin() -> Self {
        Self::new(Records, SENSOR, TIME_BITS)
    }
}

/// Reads records, which are independent of each other.
#[derive(Debug)]
pub struct Records;

impl Reader for Records {
    const WORD: usize = 4;
    const EVENTS: usize = 1;

    #[inline(always)]
    fn word(&mut self, word: Word, state: &mut State, events: &mut Vec<Event>) -> bool {
        let bits = word.bits;
        if bits >> 30 != 0 {
            return mark(word, state);
        }
        let low = u64::from(bits >> 16);
        let goes_on = state.clock.take(low) || state.settle(low, word);
        if bits & 0x8000 != 0 {
            state.tally.add(Count::Inputs);
            return goes_on;
        }
        let Sensor { width, height } = SENSOR;
        events.push(Event {
            t_us: state.clock.now(),
            x: (width - 1) - (bits >> 1 & 0x7F) as u16,
            y: (height - 1) - (bits >> 8 & 0x7F) as u16,
            polarity: Polarity::from_bool(bits & 1 == 0),
        });
        goes_on
    }

    fn forget(&mut self) {}
}

/// Takes a wrap or a reset.
#[cold]
fn mark(word: Word, state: &mut State) -> bool {
    if word.bits >> 31 != 0 {
        state.clock.wrap(1);
        return state.count(Count::Wraps);
    }
    // A reset occurs when someone requests it; several in a row come only from misaligned records.
    let goes_on = state.strike(word);
    state.clock.reset();
    state.tally.add(Count::Resets);
    goes_on
}
