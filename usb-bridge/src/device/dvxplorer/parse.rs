//! Parses the stream of the DVXplorer: 16-bit words, those of [`words16`](crate::device::inivation) and these.
//!
//! | bits 15..12 | bits | meaning |
//! |---|---|---|
//! | 1 | 9..0 x, 11 first of a readout | column of the events that follow |
//! | 4 | 5..0 group 1; 10..6 distance, 11 its sign (1: minus), of group 2 | two groups of 8 rows |
//! | 3, 2 | 7..0 mask, 8 polarity (0 = ON) | events of group 1, 2: bit i is row 8 * group + i |
//!
//! An address outside the sensor is counted and skipped; the state before it stays valid. After a loss, events are
//! decoded again once a time, after it a column, and groups have arrived.

use eecvs_nostd::{Event, Polarity, Sensor};

use crate::device::inivation::groups::{Group, Groups};
use crate::device::inivation::parser::{Reader, State, Word, WordParser};
use crate::device::inivation::tally::Count;
use crate::device::inivation::words16;

/// Parses the stream of a DVXplorer.
pub type DvxplorerParser = WordParser<Columns>;

impl DvxplorerParser {
    /// Starts at the beginning of the stream of a camera with this sensor; `inverted` if its logic exchanges
    /// columns and rows.
    #[must_use]
    pub fn begin(sensor: Sensor, inverted: bool) -> Self {
        let (columns, rows) = if inverted {
            (sensor.height, sensor.width)
        } else {
            (sensor.width, sensor.height)
        };
        let reader = Columns {
            columns: columns.into(),
            groups: Groups::new(rows.into()),
            column_shift: if inverted { 16 } else { 0 },
            column: NONE,
            pair: [Group::NONE; 2],
        };
        Self::new(reader, sensor, words16::TIME_BITS)
    }
}

/// No column is known.
const NONE: u32 = u32::MAX;

/// Reads columns and the groups in them.
#[derive(Debug)]
pub struct Columns {
    columns: u32,
    groups: Groups,
    /// Shift of a column to its place in y << 16 | x: 16 if the logic exchanges columns and rows, else 0.
    column_shift: u32,
    /// Column of what follows.
    column: u32,
    /// Groups of what follows.
    pair: [Group; 2],
}

impl Reader for Columns {
    const WORD: usize = 2;
    const EVENTS: usize = 8;

    #[inline(always)]
    fn word(&mut self, word: Word, state: &mut State, events: &mut Vec<Event>) -> bool {
        let bits = word.bits;
        if bits & u32::from(words16::TIME) != 0 {
            return words16::time(word, state);
        }
        match bits >> 12 {
            code @ (2 | 3) => {
                let group = self.pair[(3 - code) as usize];
                if self.column == NONE || group == Group::NONE {
                    return without(state);
                }
                if bits & 0xFF & !group.inside() != 0 {
                    outside(bits & 0xFF & !group.inside(), state);
                }
                let t_us = state.clock.now();
                let polarity = Polarity::from_bool(bits & 0x100 == 0);
                let column = self.column << self.column_shift;
                let mut mask = bits & group.inside();
                while mask != 0 {
                    let row = group.row() + mask.trailing_zeros();
                    let place = column | row << (16 - self.column_shift);
                    events.push(Event {
                        t_us,
                        x: place as u16,
                        y: (place >> 16) as u16,
                        polarity,
                    });
                    mask &= mask - 1;
                }
                state.count(Count::Masks)
            }
            1 => {
                let column = bits & 0x3FF;
                if column >= self.columns {
                    state.strange(Count::ColumnsOutside, word)
                } else if state.clock.is_known() || state.clock.infer_zero() {
                    self.column = column;
                    state.count(Count::Columns)
                } else {
                    state.count(Count::WithoutTime)
                }
            }
            4 => {
                let first = bits & 0x3F;
                let distance = bits >> 6 & 0x1F;
                let second = if bits & 0x800 == 0 {
                    first + distance
                } else {
                    first.wrapping_sub(distance)
                };
                let pair = [self.groups.get(first), self.groups.get(second)];
                if pair.contains(&Group::NONE) {
                    return state.strange(Count::GroupsOutside, word);
                }
                self.pair = pair;
                state.count(Count::Groups)
            }
            _ => words16::other(word, state),
        }
    }

    fn forget(&mut self) {
        self.column = NONE;
        self.pair = [Group::NONE; 2];
    }
}

/// Counts a mask whose time or place is unknown.
#[cold]
pub fn without(state: &mut State) -> bool {
    state.count(if state.clock.is_known() {
        Count::WithoutPlace
    } else {
        Count::WithoutTime
    })
}

/// Counts events beyond the last row.
#[cold]
pub fn outside(mask: u32, state: &mut State) {
    let events = u64::from(mask.count_ones());
    state.tally.add_many(Count::EventsOutside, events);
}
