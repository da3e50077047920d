//! Events in columns: structured arrays of any known field names, dictionaries, and tables of other packages.

use eecvs::representation::check_places;
use event_types::stream::{BATCH_EVENTS, EventReader, Result, Skipped};
use event_types::{Event, Polarity, Sensor, error};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::column::{Column, Kind, refuse_mask};
use crate::columns::Columns;
use crate::window::Window;

/// Names of an event's fields in the arrays of others.
pub const NAMES: [&[&str]; 4] = [
    &["t", "ts", "timestamp", "time", "t_us"],
    &["x"],
    &["y"],
    &["p", "on", "polarity", "pol"],
];

/// Events in four columns of Python's memory.
pub struct Table {
    /// t, x, y, p.
    columns: [Column; 4],
    length: usize,
    has_minus: bool,
    has_zero: bool,
}

impl Table {
    fn new(columns: [Column; 4]) -> PyResult<Self> {
        let length = columns[0].length;
        if columns.iter().any(|column| column.length != length) {
            let lengths = columns.each_ref().map(|column| column.length);
            return Err(PyValueError::new_err(format!(
                "the columns t, x, y, p have {lengths:?} values: they must have equally many"
            )));
        }
        Ok(Self {
            columns,
            length,
            has_minus: false,
            has_zero: false,
        })
    }

    /// Takes events of a structured array, of a dictionary or of [`Columns`].
    ///
    /// # Errors
    /// `TypeError` and `ValueError` for anything else.
    pub fn of(events: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(window) = events.cast::<Window>() {
            return Self::of(&window.get().events(events.py())?);
        }
        if let Ok(columns) = events.cast::<Columns>() {
            let columns = columns.get().arrays(events.py());
            let [t, x, y, p] = columns;
            return Self::new([
                Column::new(t.bind(events.py()), "t")?,
                Column::new(x.bind(events.py()), "x")?,
                Column::new(y.bind(events.py()), "y")?,
                Column::new(p.bind(events.py()), "p")?,
            ]);
        }
        if let Some(names) = column_names(events)? {
            return Self::by_names(events, &names, "columns");
        }
        let names: Vec<String> = if let Ok(dictionary) = events.cast::<PyDict>() {
            dictionary.keys().extract()?
        } else {
            refuse_mask(events, "events")?;
            let dtype = events.getattr("dtype").ok();
            let names = dtype.and_then(|dtype| dtype.getattr("names").ok());
            names.and_then(|names| names.extract().ok()).ok_or_else(|| {
                let kind = events.get_type();
                PyTypeError::new_err(format!(
                    "events are a {kind}: a structured array with fields t, x, y, p, a dictionary or a table of such columns is needed"
                ))
            })?
        };
        Self::by_names(events, &names, "fields")
    }

    /// Takes the columns that have an event's names.
    fn by_names(events: &Bound<'_, PyAny>, names: &[String], what: &str) -> PyResult<Self> {
        let column = |of: usize| {
            let found = NAMES[of]
                .iter()
                .find(|name| names.iter().any(|n| n == *name));
            let name = found.ok_or_else(|| {
                PyValueError::new_err(format!(
                    "events have the {what} {}: none is called {}",
                    names.join(", "),
                    NAMES[of].join(" or ")
                ))
            })?;
            Column::new(&events.get_item(*name)?, name)
        };
        Self::new([column(0)?, column(1)?, column(2)?, column(3)?])
    }

    /// Returns the addresses of the columns' memory, from the first byte to behind the last.
    pub fn places(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        let columns = self.columns.iter().filter(|column| column.length > 0);
        columns.map(|column| {
            let first = column.start.addr();
            let last = first.wrapping_add_signed(column.stride * (column.length - 1) as isize);
            first.min(last)..first.max(last) + column.kind.bytes()
        })
    }

    /// Returns the number of events.
    pub const fn len(&self) -> usize {
        self.length
    }

    /// Returns the first time, or the last one; `None` without events.
    pub fn time(&self, last: bool) -> Option<u64> {
        let at = if last { self.length.checked_sub(1)? } else { 0 };
        (at < self.length).then(|| u64::try_from(self.columns[0].get(at)).ok())?
    }

    /// Appends the events from number `from` on, at most `most` of them; returns their number.
    ///
    /// # Errors
    /// A number that no event has.
    pub fn read(&mut self, from: usize, most: usize, events: &mut Vec<Event>) -> Result<usize> {
        let to = self.length.min(from.saturating_add(most));
        let before = events.len();
        let kinds = self.columns.each_ref().map(|column| column.kind);
        let is_common = matches!(kinds[0], Kind::I64 | Kind::U64)
            && matches!(kinds[1], Kind::U16 | Kind::I16)
            && matches!(kinds[2], Kind::U16 | Kind::I16)
            && matches!(kinds[3], Kind::U8);
        if is_common && self.read_common(from..to, events) {
            return Ok(events.len() - before);
        }
        events.truncate(before);
        for at in from..to {
            events.push(self.event(at)?);
        }
        Ok(events.len() - before)
    }

    /// Appends the events of a range, of the types that most arrays have; returns whether all are events.
    fn read_common(&mut self, range: std::ops::Range<usize>, events: &mut Vec<Event>) -> bool {
        let [t, x, y, p] = &self.columns;
        let mut wrong = false;
        events.extend(range.map(|at| {
            let (t_us, x, y, p) = (
                t.read::<u64>(at),
                x.read::<u16>(at),
                y.read::<u16>(at),
                p.read::<u8>(at),
            );
            wrong |= t_us >> 63 != 0 || (x | y) >= Sensor::SIDE_MAX || p > 1;
            Event {
                t_us,
                x,
                y,
                polarity: Polarity::from_bool(p != 0),
            }
        }));
        !wrong
    }

    /// Returns event `at`, with every number checked.
    fn event(&mut self, at: usize) -> Result<Event> {
        let [t, x, y, p] = self.columns.each_ref().map(|column| column.get(at));
        let t_us = i64::try_from(t).ok().and_then(|t| u64::try_from(t).ok());
        let t_us = t_us.ok_or_else(|| {
            error!(
                Refused,
                "event {at}: the time {t} us is below 0 or above 2^63"
            )
        })?;
        let side = |value: i128, name: &str| {
            let value_fits = u16::try_from(value).ok();
            value_fits
                .filter(|value| *value < Sensor::SIDE_MAX)
                .ok_or_else(|| {
                    let most = Sensor::SIDE_MAX - 1;
                    error!(
                        Refused,
                        "event {at}: {name} is {value}: it must be 0 to {most}"
                    )
                })
        };
        let polarity = match p {
            1 => Polarity::On,
            0 | -1 => Polarity::Off,
            _ => {
                return Err(error!(
                    Refused,
                    "event {at}: the polarity is {p}: it must be 0 or 1, or -1 or 1"
                ));
            }
        };
        self.has_zero |= p == 0;
        self.has_minus |= p == -1;
        if self.has_zero && self.has_minus {
            return Err(error!(
                Refused,
                "event {at}: the polarities are -1 and 0: only one of them can be OFF"
            ));
        }
        Ok(Event {
            t_us,
            x: side(x, "x")?,
            y: side(y, "y")?,
            polarity,
        })
    }
}

/// Returns the names of the columns of a table of pandas, Polars or pyarrow, which gives a column by its name; `None` for
/// anything else.
///
/// # Errors
/// A table that is not computed yet.
pub fn column_names(events: &Bound<'_, PyAny>) -> PyResult<Option<Vec<String>>> {
    // What has a data type is an array.
    if events.is_instance_of::<PyDict>() || events.hasattr("dtype")? {
        return Ok(None);
    }
    let kind = events.get_type();
    if kind.hasattr("columns")? && kind.hasattr("collect")? {
        return Err(PyTypeError::new_err(format!(
            "events are a {kind}: give events.collect()"
        )));
    }
    // pyarrow's tables have both, and their columns are no names.
    for attribute in ["column_names", "columns"] {
        let Some(names) = events.getattr_opt(attribute)? else {
            continue;
        };
        if names.is_callable() {
            continue;
        }
        let names = names.try_iter()?.map(|name| Ok(name?.str()?.to_string()));
        return names.collect::<PyResult<_>>().map(Some);
    }
    Ok(None)
}

/// A reader of a table's events.
pub struct TableReader {
    table: Table,
    next: usize,
    sensor: Sensor,
    skipped: Skipped,
}

impl TableReader {
    /// Creates a reader of events of a sensor.
    pub fn new(table: Table, sensor: Sensor) -> Self {
        Self {
            table,
            next: 0,
            sensor,
            skipped: Skipped::default(),
        }
    }
}

impl EventReader for TableReader {
    fn format(&self) -> &'static str {
        "array"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let before = events.len();
        let read = self.table.read(self.next, BATCH_EVENTS, events)?;
        let new = events.get(before..).unwrap_or_default();
        check_places(self.sensor, new, self.next as u64)?;
        self.next += read;
        Ok(read)
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}
