//! Events that a caller gives: structured arrays of any known field names, columns, tables, recordings, and iterators of
//! these.

mod column;
mod size;
mod table;

use event_types::Event;
use event_types::Sensor;
use event_types::stream::{Error, EventReader, Result, Skipped};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyIterator, PyList, PyString, PyTuple};

pub use size::Size;
use table::NAMES;
pub use table::{Table, TableReader};

use crate::columns::Columns;
use crate::recording::{Recording, Slices};
use crate::window::Window;
use crate::work::Raised;

/// A reader of the arrays that an iterator of Python gives.
struct IteratorReader {
    iterator: Py<PyIterator>,
    table: Option<TableReader>,
    sensor: Sensor,
    raised: Raised,
    skipped: Skipped,
}

impl EventReader for IteratorReader {
    fn format(&self) -> &'static str {
        "arrays"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        loop {
            if let Some(table) = &mut self.table {
                let read = table.read(events)?;
                if read > 0 {
                    return Ok(read);
                }
            }
            let next = Python::attach(|py| {
                let next = self.iterator.bind(py).clone().next().transpose()?;
                next.map(|events| Table::of(&events)).transpose()
            });
            let Some(table) = next.map_err(|raised| self.raised.keep(raised))? else {
                return Ok(0);
            };
            self.table = Some(TableReader::new(table, self.sensor));
        }
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

/// Returns a reader of whatever a caller gave: a recording, an array, columns, a table, a window, or an iterable of these.
///
/// # Errors
/// `TypeError`, `ValueError`; a recording that cannot be opened.
pub fn reader(
    events: &Bound<'_, PyAny>,
    sensor: Option<Sensor>,
    raised: &Raised,
) -> PyResult<Box<dyn EventReader>> {
    let py = events.py();
    if let Ok(recording) = events.cast::<Recording>() {
        return recording.get().reader(py);
    }
    let sensor = sensor.or_else(|| size_of_given(events)).ok_or_else(|| {
        PyValueError::new_err("sensor= is needed: arrays do not say how large theirs is")
    })?;
    if is_table(events)? || events.is_instance_of::<PyString>() {
        return Ok(Box::new(TableReader::new(Table::of(events)?, sensor)));
    }
    let iterator = events.try_iter().map_err(|_| {
        PyTypeError::new_err(format!(
            "events are a {}: a structured array, a dictionary or a table of columns, a recording or an iterable of arrays is needed",
            events.get_type()
        ))
    })?;
    Ok(Box::new(IteratorReader {
        iterator: iterator.unbind(),
        table: None,
        sensor,
        raised: raised.clone(),
        skipped: Skipped::default(),
    }))
}

/// Returns the names of an event's fields in the arrays of others: of t, x, y and p.
#[pyfunction]
pub fn _names() -> [Vec<&'static str>; 4] {
    NAMES.map(<[_]>::to_vec)
}

/// Returns whether events can be read more than once: anything but an iterator.
///
/// # Errors
/// Those of looking at an object of Python.
pub fn can_be_read_again(events: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(events.is_instance_of::<Recording>() || is_table(events)?)
}

/// Returns whether an object has the columns of events.
fn is_table(events: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(events.is_instance_of::<PyDict>()
        || events.is_instance_of::<Window>()
        || events.is_instance_of::<Columns>()
        || events.hasattr("dtype")?
        || table::column_names(events)?.is_some())
}

/// Returns the size of the sensor that events come with: a window's, columns', a recording's, or that of the first of a list.
pub fn size_of_given(events: &Bound<'_, PyAny>) -> Option<Sensor> {
    if let Ok(window) = events.cast::<Window>() {
        return Some(window.get().size());
    }
    if let Ok(columns) = events.cast::<Columns>() {
        return columns.get().size();
    }
    if let Ok(recording) = events.cast::<Recording>() {
        return Some(recording.get().size());
    }
    if let Ok(slices) = events.cast::<Slices>() {
        return Some(slices.get().size());
    }
    let is_list = events.is_instance_of::<PyList>() || events.is_instance_of::<PyTuple>();
    let first = is_list.then(|| events.get_item(0).ok()).flatten()?;
    let is_one = first.is_instance_of::<Window>() || first.is_instance_of::<Columns>();
    is_one.then(|| size_of_given(&first)).flatten()
}

/// Returns whether the events before damage are to be taken: those of a recording that was opened so.
pub fn keeps_damaged(events: &Bound<'_, PyAny>) -> bool {
    let recording = events.cast::<Recording>();
    recording.is_ok_and(|recording| recording.get().keeps_damaged())
}

/// Returns the tables of a batch: those of a list or a tuple, or one. Also returns whether it is a batch.
///
/// # Errors
/// `TypeError`, `ValueError`.
pub fn tables(events: &Bound<'_, PyAny>) -> PyResult<(Vec<Table>, bool)> {
    if events.is_instance_of::<PyList>() || events.is_instance_of::<PyTuple>() {
        let tables: PyResult<Vec<_>> = events
            .try_iter()?
            .map(|events| Table::of(&events?))
            .collect();
        return Ok((tables?, true));
    }
    Ok((vec![Table::of(events)?], false))
}

/// Raises what a library's error stands for: the exception that ended the work, or its own.
pub fn raise(py: Python<'_>, raised: &Raised, error: &Error, file: Option<&str>) -> PyErr {
    raised
        .take()
        .unwrap_or_else(|| crate::errors::exception(py, error, file))
}
