//! Parses the stream of a DVXplorer whose sensor is behind MIPI: 32-bit words.
//!
//! | bits | meaning |
//! |---|---|
//! | all 0 | padding |
//! | 31 set | two groups of 8 rows, in the following fields |
//! | 31 set: 7..0, 15..8 | masks of groups 1 and 2 |
//! | 31 set: 16, 17 | polarities of groups 1 and 2 (0 = ON) |
//! | 31 set: 23..18 | number of group 1 |
//! | 31 set: 30..26 | distance of group 2, whose number is not lower than that of group 1 |
//! | 31 clear, 26 set | column: 9..0 x, 20..11 microseconds after the reference, 21 first of a frame |
//! | 31, 26 clear, 27 set | 21..0 reference of time in ms |
//!
//! A frame has one time, that of its first column: reference * 1000 + microseconds. Columns within a frame
//! increase. Events are decoded once a reference and, after it, a first column have arrived. The parser also waits
//! for these where the stream itself shows that words are missing, which is counted as "columns out of order":
//!
//! * a column that does not increase: columns, or the first column of the next frame, were lost;
//! * a frame of the same reference that is not later than the frame before it: a reference was lost.
//!
//! The reference wraps after 70 minutes, which shows as a fall by more than half of that; a fall by less means that
//! time ran back. A lost reference does no lasting harm, as the next one sets the time again.

use eecvs_nostd::{Event, Polarity, Sensor};

use crate::device::dvxplorer::parse::{outside, without};
use crate::device::inivation::clock::{Clock, Settled};
use crate::device::inivation::groups::{Group, Groups};
use crate::device::inivation::parser::{Reader, State, Word, WordParser};
use crate::device::inivation::tally::Count;

/// Bits of the reference.
pub const REFERENCE_BITS: u32 = 22;

/// Marks two groups.
pub const GROUPS: u32 = 1 << 31;

/// Marks a column.
pub const COLUMN: u32 = 1 << 26;

/// Marks the first column of a frame.
pub const FIRST: u32 = 1 << 21;

/// Marks a time reference.
pub const REFERENCE: u32 = 1 << 27;

/// Parses the stream of a DVXplorer with MIPI.
pub type MipiParser = WordParser<Frames>;

impl MipiParser {
    /// Starts at the beginning of the stream of a camera with this sensor.
    #[must_use]
    pub fn begin(sensor: Sensor) -> Self {
        let reader = Frames {
            columns: sensor.width.into(),
            groups: Groups::new(sensor.height.into()),
            column: NONE,
            frame: NO_FRAME,
            t_us: 0,
        };
        Self::new(reader, sensor, REFERENCE_BITS)
    }
}

/// No frame has begun.
const NONE: u32 = u32::MAX;

/// No frame came before; no reference has this value.
const NO_FRAME: (u64, u32) = (u64::MAX, 0);

/// Reads frames, their columns and groups.
#[derive(Debug)]
pub struct Frames {
    columns: u32,
    groups: Groups,
    /// Column of what follows.
    column: u32,
    /// Reference and microseconds of the frame before.
    frame: (u64, u32),
    /// Time of what follows, in microseconds.
    t_us: u64,
}

impl Reader for Frames {
    const WORD: usize = 4;
    const EVENTS: usize = 16;
    const TICK_US: u64 = 1000;

    #[inline(always)]
    fn word(&mut self, word: Word, state: &mut State, events: &mut Vec<Event>) -> bool {
        let bits = word.bits;
        if bits & GROUPS == 0 {
            return self.mark(word, state);
        }
        if self.column == NONE {
            return without(state);
        }
        let first = bits >> 18 & 0x3F;
        let second = first + (bits >> 26 & 0x1F);
        let (first, second) = (self.groups.get(first), self.groups.get(second));
        if first == Group::NONE || second == Group::NONE {
            return state.strange(Count::GroupsOutside, word);
        }
        let inside = first.inside() | second.inside() << 8;
        if bits & 0xFFFF & !inside != 0 {
            outside(bits & 0xFFFF & !inside, state);
        }
        let mut emit = |group: Group, mut mask: u32, off: u32| {
            while mask != 0 {
                events.push(Event {
                    t_us: self.t_us,
                    x: self.column as u16,
                    y: (group.row() + mask.trailing_zeros()) as u16,
                    polarity: Polarity::from_bool(off == 0),
                });
                mask &= mask - 1;
            }
        };
        emit(first, bits & inside & 0xFF, bits >> 16 & 1);
        emit(second, (bits & inside) >> 8, bits >> 17 & 1);
        state.count(Count::Masks)
    }

    fn forget(&mut self) {
        self.column = NONE;
        self.frame = NO_FRAME;
    }

    fn time_us(&self, clock: &Clock) -> Option<u64> {
        let reference = clock.time().map(|ms| ms * 1000);
        // A frame is later than its reference, unless the reference was corrected since.
        reference.map(|reference| {
            let goes_on = self.t_us / 1000 == reference / 1000;
            if goes_on { self.t_us } else { reference }
        })
    }
}

impl Frames {
    /// Takes a word that is not a pair of groups.
    #[inline(always)]
    fn mark(&mut self, word: Word, state: &mut State) -> bool {
        if word.bits & COLUMN != 0 {
            self.column(word, state)
        } else if word.bits & REFERENCE != 0 {
            state.tally.add(Count::Times);
            let low = u64::from(word.bits & 0x3F_FFFF);
            state.clock.take(low) || reference(low, word, state)
        } else if word.bits == 0 {
            state.count(Count::Padding)
        } else {
            state.strange(Count::Unknown, word)
        }
    }

    #[inline(always)]
    fn column(&mut self, word: Word, state: &mut State) -> bool {
        if !state.clock.is_known() {
            return state.count(Count::WithoutTime);
        }
        let column = word.bits & 0x3FF;
        if column >= self.columns {
            return state.strange(Count::ColumnsOutside, word);
        }
        if word.bits & FIRST != 0 {
            let reference = state.clock.now();
            let sub = word.bits >> 11 & 0x3FF;
            if self.frame.0 == reference && sub <= self.frame.1 {
                return self.lost(word, state);
            }
            self.frame = (reference, sub);
            self.t_us = reference * 1000 + u64::from(sub);
        } else if self.column == NONE {
            return state.count(Count::WithoutPlace);
        } else if column <= self.column {
            return self.lost(word, state);
        }
        self.column = column;
        state.count(Count::Columns)
    }

    /// Records that words are missing: waits for the next reference.
    #[cold]
    fn lost(&mut self, word: Word, state: &mut State) -> bool {
        let goes_on = state.strange(Count::OutOfOrder, word);
        state.clock.lose(None);
        self.forget();
        goes_on
    }
}

/// Takes a reference that is below the one before, or the first one after a loss.
#[cold]
fn reference(low: u64, word: Word, state: &mut State) -> bool {
    let before = state.clock;
    if state.clock.settle(low) != Settled::Back {
        return true;
    }
    state.tally.add(Count::TimesBack);
    let after = std::mem::replace(&mut state.clock, before);
    let goes_on = state.strike(word);
    state.clock = after;
    goes_on
}
