//! The parts of a recording: ranges of times, and slices.

use std::sync::{Arc, Mutex};

use event_files::slices::{ByCount, ByTime};
use event_types::Sensor;
use event_types::stream::{Error, EventReader};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PySlice;

use super::Recording;
use super::source::{Found, Source, locked, note};
use crate::layout::{Packed, Packer, array};
use crate::number;

/// The events of a recording by their times.
#[pyclass(module = "eecvs", frozen)]
pub struct Times {
    recording: Py<Recording>,
}

impl Times {
    /// Returns those of a recording.
    pub const fn of(recording: Py<Recording>) -> Self {
        Self { recording }
    }
}

#[pymethods]
impl Times {
    /// Events with a <= t < b.
    fn __getitem__<'py>(
        &self,
        py: Python<'py>,
        times: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let slice = times.cast::<PySlice>().map_err(|_| {
            PyTypeError::new_err("times are a range: recording.time[a:b], in microseconds")
        })?;
        if !slice.getattr("step")?.is_none() {
            return Err(PyValueError::new_err("a range of times has no step"));
        }
        // Microseconds of the file's own clock.
        let bound = |name: &str, otherwise: u64| -> PyResult<u64> {
            let bound = slice.getattr(name)?;
            if bound.is_none() {
                return Ok(otherwise);
            }
            number::named(&bound, name, 0..=u64::MAX)
        };
        let times = bound("start", 0)?..bound("stop", u64::MAX)?;
        self.recording.get().arrays(py, times)
    }
}

/// How a recording is cut.
pub enum Cut {
    Batches(Box<dyn EventReader>),
    Time(ByTime),
    Count(ByCount),
}

impl Cut {
    fn reader(&self) -> &dyn EventReader {
        match self {
            Self::Batches(reader) => reader.as_ref(),
            Self::Time(slices) => slices.reader(),
            Self::Count(slices) => slices.reader(),
        }
    }
}

struct State {
    /// `None` after the end.
    cut: Option<Cut>,
    packer: Packer,
    times: Option<(u64, u64)>,
}

/// An iterator over the slices of a recording.
#[pyclass(module = "eecvs", frozen)]
pub struct Slices {
    source: Arc<Source>,
    found: Arc<Mutex<Found>>,
    sensor: Sensor,
    state: Mutex<State>,
}

impl Slices {
    /// Returns the size of the sensor.
    pub const fn size(&self) -> Sensor {
        self.sensor
    }

    /// Begins to iterate; what is found goes to `found` at the end.
    pub fn new(source: &Arc<Source>, found: &Arc<Mutex<Found>>, cut: Cut) -> Self {
        Self {
            source: Arc::clone(source),
            found: Arc::clone(found),
            sensor: cut.reader().sensor(),
            state: Mutex::new(State {
                cut: Some(cut),
                packer: Packer::new(source.layout),
                times: None,
            }),
        }
    }
}

/// What a step of an iterator came to.
enum Step {
    Events(Packed),
    End(Found, Option<Error>),
    Over,
}

#[pymethods]
impl Slices {
    fn __iter__(slf: Bound<'_, Self>) -> Bound<'_, Self> {
        slf
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        // A loop in C, such as `list`, does not look by itself.
        py.check_signals()?;
        let layout = self.source.layout;
        let step = py.detach(|| {
            let mut state = locked(&self.state);
            let State { cut, packer, times } = &mut *state;
            let Some(cutter) = cut else {
                return Step::Over;
            };
            let mut packed = Packed::new(layout);
            let read = packer.add(&mut packed, |events| match cutter {
                Cut::Batches(reader) => reader.read(events).map(|read| read > 0),
                Cut::Count(slices) => slices.next_slice(events).map(|slice| slice.is_some()),
                Cut::Time(slices) => slices.next_slice(events).map(|slice| {
                    if let Some(slice) = &slice {
                        *times = Some((slice.start, slice.end));
                    }
                    slice.is_some()
                }),
            });
            match read {
                Ok(true) => Step::Events(packed),
                other => {
                    let failure = other.err();
                    let found = Found::of(cutter.reader(), failure.as_ref());
                    *cut = None;
                    Step::End(found, failure)
                }
            }
        });
        match step {
            Step::Events(packed) => array(py, layout, packed).map(Some),
            Step::Over => Ok(None),
            Step::End(found, failure) => {
                let is_refused = failure
                    .as_ref()
                    .is_some_and(|error| error.kind() == event_files::ErrorKind::Refused);
                if let Some(error) = failure.as_ref().filter(|_| is_refused) {
                    return Err(crate::errors::exception(py, error, Some(&self.source.name)));
                }
                match note(py, &self.source, &self.found, found, failure.as_ref())? {
                    Some(exception) => Err(exception),
                    None => Ok(None),
                }
            }
        }
    }

    /// Times (start, end) of the latest slice in microseconds, half-open; None for slices of a number of events.
    #[getter]
    fn times(&self, py: Python<'_>) -> Option<(u64, u64)> {
        py.detach(|| locked(&self.state).times)
    }
}
