//! Stream of a DVXplorer whose sensor is behind MIPI: words of 32 bits.
//!
//! | bits | meaning |
//! |---|---|
//! | all 0 | padding |
//! | 31 set | two groups of 8 rows: 7..0 mask of group 1, 15..8 of group 2, 16 and 17 their polarities (0 = ON), 23..18 group 1, 30..26 distance of group 2, which is not above it |
//! | 31 clear, 26 set | column: 9..0 x, 20..11 microseconds after the reference, 21 first of a frame |
//! | 31, 26 clear, 27 set | 21..0 reference of time in ms |
//!
//! A frame has one time, that of its first column: reference * 1000 + microseconds. Columns of a frame
//! go up. Nothing is an event until there was a reference and, after it, a first column. The same is
//! waited for where the stream tells by itself that words are missing, which is counted as "columns
//! out of order":
//!
//! * a column that does not go up: columns, or the first one of the next frame, were lost;
//! * a frame at the time of the one before or earlier, of the same reference: a reference was lost.
//!
//! The reference wraps after 70 minutes: where it falls by more than half of that; where it falls by
//! less, time ran back. A lost one is not missed: the next one tells the time anew.

use eecvs_nostd::{Event, Polarity, Sensor};

use crate::device::dvxplorer::parse::{Group, outside};
use crate::device::inivation::clock::Clock;
use crate::device::inivation::clock::Settled;
use crate::device::inivation::parser::{Reader, State, WordParser};
use crate::device::inivation::tally::Count;

/// Bits of the reference.
pub const REFERENCE_BITS: u32 = 22;

/// Two groups.
pub const GROUPS: u32 = 1 << 31;

/// A column.
pub const COLUMN: u32 = 1 << 26;

/// The first column of a frame.
pub const FIRST: u32 = 1 << 21;

/// A reference of time.
pub const REFERENCE: u32 = 1 << 27;

/// Parser of the stream.
pub type MipiParser = WordParser<Frames>;

impl MipiParser {
    /// A parser at the beginning of the stream of a camera with this sensor.
    #[must_use]
    pub fn begin(sensor: Sensor) -> Self {
        let reader = Frames {
            columns: sensor.width.into(),
            rows: sensor.height.into(),
            column: NONE,
            frame: None,
            t_us: 0,
            latest: None,
        };
        Self::new(reader, sensor, REFERENCE_BITS)
    }
}

/// No frame has begun.
const NONE: u32 = u32::MAX;

/// Reads frames, their columns and groups.
#[derive(Debug)]
pub struct Frames {
    columns: u32,
    rows: u32,
    /// Column of what follows.
    column: u32,
    /// Reference and microseconds of the frame before.
    frame: Option<(u64, u32)>,
    /// Time of what follows.
    t_us: u64,
    /// Latest time of a frame.
    latest: Option<u64>,
}

impl Reader for Frames {
    const WORD: usize = 4;
    const EVENTS: usize = 16;
    const TICK_US: u64 = 1000;

    #[inline(always)]
    fn word(&mut self, word: u32, state: &mut State, events: &mut Vec<Event>) {
        if word & GROUPS == 0 {
            return self.mark(word, state);
        }
        if self.column == NONE {
            return self.without(state);
        }
        let first = word >> 18 & 0x3F;
        let second = first + (word >> 26 & 0x1F);
        let (Some(first), Some(second)) =
            (Group::new(first, self.rows), Group::new(second, self.rows))
        else {
            return state.strange(Count::GroupsOutside);
        };
        state.tally.add(Count::Masks);
        let beyond = (word & 0xFF & !first.inside) | (word >> 8 & 0xFF & !second.inside) << 8;
        if beyond != 0 {
            outside(beyond, state);
        }
        let mut emit = |group: Group, mut mask: u32, off: u32| {
            while mask != 0 {
                events.push(Event {
                    t_us: self.t_us,
                    x: self.column as u16,
                    y: group.row + mask.trailing_zeros() as u16,
                    polarity: Polarity::from_bool(off == 0),
                });
                mask &= mask - 1;
            }
        };
        emit(first, word & first.inside, word >> 16 & 1);
        emit(second, word >> 8 & second.inside, word >> 17 & 1);
    }

    fn forget(&mut self) {
        self.column = NONE;
        self.frame = None;
    }

    fn time_us(&self, clock: &Clock) -> Option<u64> {
        let reference = clock.time().map(|ms| ms * 1000);
        // A frame is after its reference, but not where that was corrected since.
        match (reference, self.latest) {
            (Some(reference), Some(frame)) if frame / 1000 == reference / 1000 => Some(frame),
            (reference, _) => reference,
        }
    }
}

impl Frames {
    /// Takes what is not a group.
    #[inline]
    fn mark(&mut self, word: u32, state: &mut State) {
        if word & COLUMN != 0 {
            self.column(word, state);
        } else if word & REFERENCE != 0 {
            state.tally.add(Count::Times);
            let low = u64::from(word & 0x3F_FFFF);
            if !state.clock.take(low) {
                reference(low, state);
            }
        } else if word == 0 {
            state.tally.add(Count::Padding);
        } else {
            state.strange(Count::Unknown);
        }
    }

    fn column(&mut self, word: u32, state: &mut State) {
        if !state.clock.is_known() {
            return state.tally.add(Count::WithoutTime);
        }
        let column = word & 0x3FF;
        if column >= self.columns {
            return state.strange(Count::ColumnsOutside);
        }
        if word & FIRST != 0 {
            let reference = state.clock.now();
            let sub = word >> 11 & 0x3FF;
            let goes_on = self
                .frame
                .is_none_or(|(last, last_sub)| last != reference || sub > last_sub);
            if !goes_on {
                return self.lost(state);
            }
            self.frame = Some((reference, sub));
            self.t_us = reference * 1000 + u64::from(sub);
            self.latest = Some(self.t_us);
        } else if self.column == NONE {
            return state.tally.add(Count::WithoutPlace);
        } else if column <= self.column {
            return self.lost(state);
        }
        self.column = column;
        state.tally.add(Count::Columns);
    }

    /// Words are missing: waits for the next reference.
    #[cold]
    fn lost(&mut self, state: &mut State) {
        state.strange(Count::OutOfOrder);
        state.clock.lose(None);
        self.forget();
    }

    #[cold]
    fn without(&self, state: &mut State) {
        state.tally.add(if state.clock.is_known() {
            Count::WithoutPlace
        } else {
            Count::WithoutTime
        });
    }
}

/// Takes a reference that is below the one before, or the first after a loss.
#[cold]
fn reference(low: u64, state: &mut State) {
    let before = state.clock;
    if state.clock.settle(low) == Settled::Back {
        let after = state.clock;
        state.clock = before;
        state.strike();
        state.clock = after;
        state.tally.add(Count::TimesBack);
    }
}
