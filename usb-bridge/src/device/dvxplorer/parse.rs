//! Stream of the DVXplorer: words of 16 bits, of [`words16`](crate::device::inivation) and these.
//!
//! | bits 15..12 | bits | meaning |
//! |---|---|---|
//! | 1 | 9..0 x, 11 first of a readout | column of what follows |
//! | 4 | 5..0 group 1; 10..6 distance, 11 its sign (1: minus), of group 2 | two groups of 8 rows |
//! | 3, 2 | 7..0 mask, 8 polarity (0 = ON) | events of group 1, 2: bit i is row 8 * group + i |
//!
//! An address outside of the sensor is counted and left out; what was known before stays. After a loss
//! nothing is an event until there was a time, after it a column, and groups.

use eecvs_nostd::{Event, Polarity, Sensor};

use crate::device::inivation::parser::{Reader, State, WordParser};
use crate::device::inivation::tally::Count;
use crate::device::inivation::words16;

/// Parser of a DVXplorer's stream.
pub type DvxplorerParser = WordParser<Columns>;

impl DvxplorerParser {
    /// A parser at the beginning of the stream of a camera whose events are in `sensor`; `inverted`
    /// where its logic calls columns rows.
    #[must_use]
    pub fn begin(sensor: Sensor, inverted: bool) -> Self {
        let (columns, rows) = if inverted {
            (sensor.height, sensor.width)
        } else {
            (sensor.width, sensor.height)
        };
        let reader = Columns {
            columns: columns.into(),
            rows: rows.into(),
            inverted,
            column: NONE,
            groups: [Group::NONE; 2],
        };
        Self::new(reader, sensor, words16::TIME_BITS)
    }
}

/// No column is known.
const NONE: u32 = u32::MAX;

/// 8 rows of a column.
#[derive(Debug, Clone, Copy)]
pub struct Group {
    /// First row.
    pub row: u16,
    /// Which of the rows there are: the last group may have fewer.
    pub inside: u32,
}

impl Group {
    /// No group is known.
    pub const NONE: Self = Self { row: 0, inside: 0 };

    /// Group number `group` of `rows`; `None` where it is beyond the last.
    #[inline(always)]
    pub fn new(group: u32, rows: u32) -> Option<Self> {
        let row = group.checked_mul(8).filter(|row| *row < rows)?;
        let inside = if rows - row >= 8 {
            0xFF
        } else {
            (1 << (rows - row)) - 1
        };
        Some(Self {
            row: row as u16,
            inside,
        })
    }
}

/// Reads columns and their groups.
#[derive(Debug)]
pub struct Columns {
    columns: u32,
    rows: u32,
    inverted: bool,
    column: u32,
    groups: [Group; 2],
}

impl Reader for Columns {
    const WORD: usize = 2;
    const EVENTS: usize = 8;

    #[inline(always)]
    fn word(&mut self, word: u32, state: &mut State, events: &mut Vec<Event>) {
        if word & u32::from(words16::TIME) != 0 {
            return words16::time(word, state);
        }
        match word >> 12 {
            code @ (2 | 3) => {
                let group = self.groups[(3 - code) as usize];
                if self.column == NONE || group.inside == 0 {
                    return self.without(state);
                }
                state.tally.add(Count::Masks);
                if word & 0xFF & !group.inside != 0 {
                    outside(word & 0xFF & !group.inside, state);
                }
                let t_us = state.clock.now();
                let polarity = Polarity::from_bool(word & 0x100 == 0);
                let mut mask = word & group.inside;
                while mask != 0 {
                    let row = group.row + mask.trailing_zeros() as u16;
                    let (x, y) = if self.inverted {
                        (row, self.column as u16)
                    } else {
                        (self.column as u16, row)
                    };
                    events.push(Event {
                        t_us,
                        x,
                        y,
                        polarity,
                    });
                    mask &= mask - 1;
                }
            }
            1 => {
                let column = word & 0x3FF;
                if column >= self.columns {
                    state.strange(Count::ColumnsOutside);
                } else if state.clock.is_known() {
                    self.column = column;
                    state.tally.add(Count::Columns);
                } else {
                    state.tally.add(Count::WithoutTime);
                }
            }
            4 => {
                let first = word & 0x3F;
                let distance = word >> 6 & 0x1F;
                let second = if word & 0x800 == 0 {
                    first + distance
                } else {
                    first.wrapping_sub(distance)
                };
                match (Group::new(first, self.rows), Group::new(second, self.rows)) {
                    (Some(first), Some(second)) => {
                        self.groups = [first, second];
                        state.tally.add(Count::Groups);
                    }
                    _ => state.strange(Count::GroupsOutside),
                }
            }
            _ => words16::other(word, state),
        }
    }

    fn forget(&mut self) {
        self.column = NONE;
        self.groups = [Group::NONE; 2];
    }
}

impl Columns {
    #[cold]
    fn without(&self, state: &mut State) {
        state.tally.add(if state.clock.is_known() {
            Count::WithoutPlace
        } else {
            Count::WithoutTime
        });
    }
}

/// Counts events beyond the last row.
#[cold]
pub fn outside(mask: u32, state: &mut State) {
    let events = u64::from(mask.count_ones());
    state.tally.add_many(Count::EventsOutside, events);
}
