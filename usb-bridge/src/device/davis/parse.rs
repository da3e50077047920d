//! Parses the stream of the DAVIS cameras: 16-bit words, those of [`words16`](crate::device::inivation) and these.
//!
//! | bits 15..12 | bits 11..0 | meaning |
//! |---|---|---|
//! | 1 | y | row of the events that follow |
//! | 2, 3 | x | an OFF or ON event in that row at the latest time |
//! | 4 | sample | a pixel of a frame; a DAVIS240 sends each twice |
//!
//! An address outside the sensor is counted and skipped; the row before it stays valid. After a loss, events are
//! decoded again once a time and, after it, a row have arrived.

use eecvs_nostd::{Event, Polarity, Sensor};

use crate::device::inivation::parser::{Reader, State, Word, WordParser};
use crate::device::inivation::tally::Count;
use crate::device::inivation::words16;

/// Parses the stream of a DAVIS.
pub type DavisParser = WordParser<Rows>;

impl DavisParser {
    /// Starts at the beginning of the stream of a camera with this sensor; `inverted` if its logic exchanges
    /// columns and rows.
    #[must_use]
    pub fn begin(sensor: Sensor, inverted: bool) -> Self {
        let (columns, rows) = if inverted {
            (sensor.height, sensor.width)
        } else {
            (sensor.width, sensor.height)
        };
        let reader = Rows {
            columns: columns.into(),
            rows: rows.into(),
            columns_known: 0,
            row_place: 0,
            column_shift: if inverted { 16 } else { 0 },
        };
        Self::new(reader, sensor, words16::TIME_BITS)
    }
}

/// Bits 15..13 of an event.
const EVENT: u32 = 1;

/// Bits 15..12 of a row.
const ROW: u32 = 1;

/// Reads rows and the columns in them.
#[derive(Debug)]
pub struct Rows {
    columns: u32,
    rows: u32,
    /// Number of columns, or 0 while no row is known.
    columns_known: u32,
    /// The row, shifted to its place in y << 16 | x.
    row_place: u32,
    /// Shift of a column to its place: 16 if the logic exchanges columns and rows, else 0.
    column_shift: u32,
}

impl Reader for Rows {
    const WORD: usize = 2;
    const EVENTS: usize = 1;

    #[inline(always)]
    fn word(&mut self, word: Word, state: &mut State, events: &mut Vec<Event>) -> bool {
        let bits = word.bits;
        if bits & u32::from(words16::TIME) != 0 {
            return words16::time(word, state);
        }
        let data = bits & 0xFFF;
        // Both polarities share one branch, because their sequence cannot be predicted.
        if bits >> 13 == EVENT && data < self.columns_known {
            let place = self.row_place | data << self.column_shift;
            events.push(Event {
                t_us: state.clock.now(),
                x: place as u16,
                y: (place >> 16) as u16,
                polarity: Polarity::from_bool(bits & 0x1000 != 0),
            });
            return true;
        }
        if bits >> 12 == ROW
            && data < self.rows
            && (state.clock.is_known() || state.clock.infer_zero())
        {
            self.row_place = data << (16 - self.column_shift);
            self.columns_known = self.columns;
            return state.count(Count::Rows);
        }
        self.other(word, state)
    }

    fn forget(&mut self) {
        self.columns_known = 0;
    }
}

impl Rows {
    #[cold]
    fn other(&mut self, word: Word, state: &mut State) -> bool {
        let data = word.bits & 0xFFF;
        match word.bits >> 12 {
            1 if data >= self.rows => state.strange(Count::RowsOutside, word),
            1 => state.count(Count::WithoutTime),
            2 | 3 if data >= self.columns => state.strange(Count::ColumnsOutside, word),
            2 | 3 if state.clock.is_known() => state.count(Count::WithoutPlace),
            2 | 3 => state.count(Count::WithoutTime),
            4 => state.count(Count::Samples),
            _ => words16::other(word, state),
        }
    }
}
