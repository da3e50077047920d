//! Recordings of every format: how they are opened, read and cut.

mod lent;
mod opening;
mod slices;
mod source;
mod stamp;

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use event_files::recording_info;
use event_files::slices::{ByCount, ByTime};
use event_files::within::Within;
use event_types::Sensor;
use event_types::stream::{Error, EventReader, Result};
use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple, PyType};

use crate::columns::{Builder, Columns};
use crate::given::raise;
use crate::layout::{Packed, Packer, array, no_memory};
use crate::memory::room;
use crate::number;
use crate::work::{Interruptible, Raised, Signals, in_pool_watched};
use lent::{Idle, Lent};
pub use opening::{_reopen, Reopen, absolute, open};
use slices::Cut;
pub use slices::{Slices, Times};
use source::{Found, MARGIN_EVENTS, note};
pub use source::{Origin, Source, locked};

/// A recording: an iterable of arrays, a context manager, and slices of time and of number.
///
/// Every reading begins with the first event, so that a recording can be read as often as wanted, by several threads and
/// by forked or spawned processes. Reading lets other threads run. A pipe can be read once, and a file only as long as it is the
/// one that was opened: ``RefusedError`` says that it was changed or replaced.
#[pyclass(module = "eecvs", frozen)]
pub struct Recording {
    source: Arc<Source>,
    /// The reader that found the format, for the first reading by the same process.
    first: Mutex<Option<(u32, Box<dyn EventReader>)>>,
    /// One for the next part.
    idle: Arc<Idle>,
    format: &'static str,
    sensor: Sensor,
    camera: Option<String>,
    found: Arc<Mutex<Found>>,
    closed: AtomicBool,
    reopen: Reopen,
    info: Mutex<Option<Py<PyAny>>>,
}

impl Recording {
    /// Opens a source.
    ///
    /// # Errors
    /// Those of opening.
    pub fn open(py: Python<'_>, source: Source, reopen: Reopen) -> PyResult<Self> {
        let (source, raised) = (Arc::new(source), Raised::default());
        let opened = py.detach(|| source.open_first(&raised));
        let reader = opened.map_err(|error| raise(py, &raised, &error, Some(&source.name)))?;
        Ok(Self {
            format: reader.format(),
            sensor: reader.sensor(),
            camera: reader.camera().map(str::to_owned),
            found: Arc::new(Mutex::new(Found::of(reader.as_ref(), None))),
            first: Mutex::new(Some((std::process::id(), reader))),
            idle: Arc::default(),
            source,
            closed: AtomicBool::new(false),
            reopen,
            info: Mutex::new(None),
        })
    }

    /// Returns the size of the sensor.
    pub const fn size(&self) -> Sensor {
        self.sensor
    }

    /// Returns the recording's file, if it has one, without a place inside it.
    pub fn file(&self) -> Option<&Path> {
        self.source.path().map(event_files::file_of)
    }

    /// Returns whether damage ends a reading with a warning.
    pub fn keeps_damaged(&self) -> bool {
        self.source.keeps_damaged
    }

    /// Returns a reader that begins with the first event.
    ///
    /// # Errors
    /// Those of opening; `ValueError` if the recording was closed.
    pub fn reader(&self, py: Python<'_>) -> PyResult<Box<dyn EventReader>> {
        self.open_reader(py, false)
    }

    /// Returns a reader that begins with the first event: for a part, one that was opened for another.
    fn open_reader(&self, py: Python<'_>, of_part: bool) -> PyResult<Box<dyn EventReader>> {
        if self.closed.load(Ordering::Relaxed) {
            return Err(PyValueError::new_err(format!(
                "{}: the recording was closed",
                self.source.name
            )));
        }
        let opened = py.detach(|| {
            if !of_part {
                return self.first_or_other();
            }
            let reader = match self.idle.take()? {
                Some(reader) => self.source.unchanged(|| Ok(reader))?,
                None => self.first_or_other()?,
            };
            Ok(Box::new(Lent::new(reader, &self.idle)) as Box<dyn EventReader>)
        });
        opened
            .map_err(|error: Error| raise(py, &Raised::default(), &error, Some(&self.source.name)))
    }

    fn first_or_other(&self) -> Result<Box<dyn EventReader>> {
        let first = locked(&self.first).take();
        match first {
            Some((process, reader)) if process == std::process::id() => {
                self.source.refuse_overwritten().map(|()| reader)
            }
            _ => self.source.open_again(),
        }
    }

    /// Returns about how many events there are, by the size of the file: most formats take four bytes for one, or more.
    fn about(&self, py: Python<'_>) -> u64 {
        py.detach(|| {
            let file = self.file().map(std::fs::metadata);
            file.and_then(Result::ok).map_or(0, |file| file.len() / 4) + MARGIN_EVENTS
        })
    }

    /// Reads a reader to its end by `add`, which returns whether there was more; then notes and tells what was lost.
    fn read_by(
        &self,
        py: Python<'_>,
        times: std::ops::Range<u64>,
        mut all: impl FnMut(&mut dyn EventReader) -> Result<()> + Send,
    ) -> PyResult<Option<PyErr>> {
        let reader = self.open_reader(py, times != (0..u64::MAX))?;
        let raised = Raised::default();
        let (found, failure) = py
            .detach(|| {
                // Within other readers, which may read for long at once.
                let reader = Interruptible::new(reader, &raised);
                let mut reader = Within::new(Box::new(reader), times)?;
                let failure = all(&mut reader).err();
                Ok::<_, Error>((Found::of(&reader, failure.as_ref()), failure))
            })
            .map_err(|error| raise(py, &raised, &error, Some(&self.source.name)))?;
        if let Some(exception) = raised.take() {
            return Err(exception);
        }
        note(py, &self.source, &self.found, found, failure.as_ref())
    }

    fn arrays<'py>(
        &self,
        py: Python<'py>,
        times: std::ops::Range<u64>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let layout = self.source.layout;
        let mut packed = Packed::new(layout);
        let mut packer = Packer::new(layout);
        if times == (0..u64::MAX) {
            packed.guess(self.about(py));
        }
        let failure = self.read_by(py, times, |reader| packer.read_all(&mut packed, reader))?;
        let events = array(py, layout, packed)?;
        raise_with(py, failure, &events)?;
        Ok(events)
    }
}

/// Raises an exception, if there is one, with the events that were read before.
fn raise_with(py: Python<'_>, failure: Option<PyErr>, events: &Bound<'_, PyAny>) -> PyResult<()> {
    match failure {
        Some(failure) => {
            failure.value(py).setattr("events", events)?;
            Err(failure)
        }
        None => Ok(()),
    }
}

/// Returns the sensor as Python has it.
pub fn sensor_object(py: Python<'_>, sensor: Sensor) -> PyResult<Bound<'_, PyAny>> {
    let class = py.import("eecvs._types")?.getattr("Sensor")?;
    class.call1((sensor.width, sensor.height))
}

#[pymethods]
impl Recording {
    /// Size of the sensor in pixels: (width, height).
    #[getter]
    fn sensor<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        sensor_object(py, self.sensor)
    }

    /// Name of the format, such as ``"evt3"``.
    #[getter]
    fn format(&self) -> &'static str {
        self.format
    }

    /// The camera or chip, if the file names it.
    #[getter]
    fn camera(&self) -> Option<&str> {
        self.camera.as_deref()
    }

    /// The path that was opened, from the root; None of a scene.
    #[getter]
    fn path(&self) -> Option<&Path> {
        self.source.path()
    }

    /// Counts, times and hashes of the whole recording, which is read four times for them, once.
    ///
    /// Raises:
    ///     EecvsError: The file cannot be read, or is a pipe. Damage after the header is ``info.damage``.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        // Held for a moment, and never without the interpreter's lock.
        if let Some(info) = locked(&self.info).as_ref() {
            return Ok(info.clone_ref(py).into_bound(py));
        }
        let source = &self.source;
        let raised = Raised::default();
        let info = py.detach(|| {
            in_pool_watched(&raised, || {
                let open = |size| -> Result<Box<dyn EventReader>> {
                    let reader = source.open_as_it_is(size)?;
                    Ok(Box::new(Interruptible::new(reader, &raised)))
                };
                source.refuse_pipe()?;
                recording_info::info_of(open(None)?, &|| open(Some(self.sensor)), &mut |_| {})
            })?
        });
        let info = info.map_err(|error| raise(py, &raised, &error, Some(&source.name)))?;
        if let Some(exception) = raised.take() {
            return Err(exception);
        }
        let fields = PyDict::new(py);
        fields.set_item("camera", info.sensor)?;
        fields.set_item("format", info.format)?;
        fields.set_item("width", info.width)?;
        fields.set_item("height", info.height)?;
        fields.set_item("events", info.events)?;
        fields.set_item("on", info.on)?;
        fields.set_item("off", info.off)?;
        fields.set_item("t_first_us", info.t_first_us)?;
        fields.set_item("t_last_us", info.t_last_us)?;
        fields.set_item("times_back", info.times_back)?;
        fields.set_item("back_max_us", info.back_max_us)?;
        fields.set_item("duration_s", info.duration_s)?;
        fields.set_item("rate_eps", info.rate_eps)?;
        fields.set_item("sum_x", info.sum_x)?;
        fields.set_item("sum_y", info.sum_y)?;
        fields.set_item("sha256_events", info.sha256_events)?;
        fields.set_item("xxh128_sum_events", info.xxh128_sum_events)?;
        fields.set_item("assumptions", PyTuple::new(py, info.findings.assumptions)?)?;
        fields.set_item("skipped", info.findings.skipped)?;
        fields.set_item("damage", info.damage)?;
        let class = py.import("eecvs._types")?.getattr("Info")?;
        let made = class.call((), Some(&fields))?;
        *locked(&self.info) = Some(made.clone().unbind());
        Ok(made)
    }

    /// Counts, by kind, of the items of the latest complete reading that are no events or were left out.
    #[getter]
    fn skipped(&self, py: Python<'_>) -> std::collections::BTreeMap<String, u64> {
        py.detach(|| locked(&self.found).findings.skipped.clone())
    }

    /// Of these, the events that are missing.
    #[getter]
    fn losses(&self, py: Python<'_>) -> std::collections::BTreeMap<&'static str, u64> {
        py.detach(|| locked(&self.found).lost.iter().copied().collect())
    }

    /// What the reader assumed, since the file does not state it: one text for each assumption.
    #[getter]
    fn assumptions(&self, py: Python<'_>) -> Vec<String> {
        py.detach(|| locked(&self.found).findings.assumptions.clone())
    }

    /// Where and why the latest complete reading broke off, or None.
    #[getter]
    fn damage(&self, py: Python<'_>) -> Option<String> {
        py.detach(|| locked(&self.found).damage.clone())
    }

    /// Events by their times: ``recording.time[a:b]`` is the array of those with a <= t < b, in microseconds of the file's
    /// own clock. Formats with an index are read from there on.
    #[getter]
    fn time(slf: Bound<'_, Self>) -> Times {
        Times::of(slf.unbind())
    }

    /// Reads all events.
    ///
    /// Returns:
    ///     A structured array, (N,), of the data type that ``open`` was given.
    ///
    /// Raises:
    ///     DamagedError: The file is damaged: ``error.events`` has the events before that place, ``error.offset`` the place.
    fn read<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.arrays(py, 0..u64::MAX)
    }

    /// Reads all events as four contiguous columns, for torch, Arrow, Polars and pandas.
    ///
    /// Raises:
    ///     DamagedError: The file is damaged: ``error.events`` has the columns of the events before that place.
    fn columns(&self, py: Python<'_>) -> PyResult<Py<Columns>> {
        let mut columns = Builder::default();
        columns.guess(self.about(py));
        let failure = self.read_by(py, 0..u64::MAX, |reader| {
            let mut batch = Vec::new();
            while reader.read(&mut batch)? > 0 {
                columns.extend(&batch)?;
                batch.clear();
            }
            Ok(())
        })?;
        let columns = Py::new(py, columns.columns(py, Some(self.sensor)))?;
        raise_with(py, failure, columns.bind(py).as_any())?;
        Ok(columns)
    }

    /// Reads the causes of all events of a scene in model 2, in the order of ``read``.
    ///
    /// Returns:
    ///     (N,) uint8: indices of ``CAUSES``.
    ///
    /// Raises:
    ///     UnsupportedError: The recording is no scene, or one of model 1.
    fn causes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<u8>>> {
        let raised = Raised::default();
        let causes = py.detach(|| {
            in_pool_watched(&raised, || {
                let mut signals = Signals::new(&raised);
                let mut scene = self.source.scene()?;
                let (mut events, mut batch, mut causes) = (Vec::new(), Vec::new(), Vec::new());
                while scene.read_with_causes(&mut events, &mut batch)? > 0 {
                    signals.check()?;
                    room(&mut causes, batch.len()).map_err(no_memory)?;
                    causes.extend(batch.iter().map(|cause| *cause as u8));
                    events.clear();
                    batch.clear();
                }
                Ok(causes)
            })?
        });
        let causes =
            causes.map_err(|error: Error| raise(py, &raised, &error, Some(&self.source.name)))?;
        Ok(PyArray1::from_vec(py, causes))
    }

    /// Computes what is really seen in a scene at a time; the files of ``eecvs emulate --truth`` have the same arrays.
    ///
    /// Args:
    ///     t_us: A time in microseconds, from the scene's start on.
    ///
    /// Returns:
    ///     Truth: (H, W) uint8 ``object``, (H, W, 2) float32 ``flow`` in pixels per second, to the right and down, (H, W)
    ///     float32 ``depth`` relative to that of the picture's middle and NaN in objects, or None, and ``objects``.
    ///
    /// Raises:
    ///     UnsupportedError: The recording is no scene.
    ///     RefusedError: The time is before the scene's start.
    fn truth<'py>(&self, py: Python<'py>, t_us: u64) -> PyResult<Bound<'py, PyAny>> {
        let config = self.source.config();
        let config = config
            .map_err(|error| crate::errors::exception(py, &error, Some(&self.source.name)))?;
        crate::emulate::truth(py, config, t_us)
    }

    /// Iterates over slices of ``us`` microseconds; a slice without events is an empty array.
    ///
    /// Args:
    ///     us: Duration of a slice in microseconds, at least 1.
    ///     origin_us: A time at which a slice begins; by default the first event's.
    ///
    /// Returns:
    ///     An iterator of structured arrays, whose ``times`` is the latest slice's (start, end) in microseconds.
    ///
    /// Raises:
    ///     RefusedError: Times run backwards out of a slice: open with ``sort=True``.
    #[pyo3(signature = (us, *, origin_us=None))]
    fn by_time(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::us)] us: u64,
        #[pyo3(from_py_with = number::origin_us)] origin_us: Option<u64>,
    ) -> PyResult<Slices> {
        let reader = self.reader(py)?;
        self.slices(py, ByTime::new(reader, us, origin_us).map(Cut::Time))
    }

    /// Iterates over slices of ``n`` events; the last one may have fewer.
    ///
    /// Returns:
    ///     An iterator of structured arrays.
    fn by_count(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::n)] n: usize,
    ) -> PyResult<Slices> {
        let reader = self.reader(py)?;
        self.slices(py, ByCount::new(reader, n).map(Cut::Count))
    }

    /// Iterates over arrays of up to 16,384 events.
    fn __iter__(&self, py: Python<'_>) -> PyResult<Slices> {
        let reader = self.reader(py)?;
        self.slices(py, Ok(Cut::Batches(reader)))
    }

    fn __enter__(slf: Bound<'_, Self>) -> Bound<'_, Self> {
        slf
    }

    #[pyo3(signature = (exc_type=None, exc=None, traceback=None))]
    fn __exit__(
        &self,
        py: Python<'_>,
        exc_type: Option<&Bound<'_, PyType>>,
        exc: Option<&Bound<'_, PyAny>>,
        traceback: Option<&Bound<'_, PyAny>>,
    ) {
        let _ = (exc_type, exc, traceback);
        self.close(py);
    }

    /// Closes the file; the recording cannot be read after that.
    fn close(&self, py: Python<'_>) {
        self.closed.store(true, Ordering::Relaxed);
        py.detach(|| {
            drop(locked(&self.first).take());
            self.idle.clear();
        });
    }

    fn __repr__(&self) -> String {
        format!(
            "<Recording {:?}: {}, {} x {}>",
            self.source.name, self.format, self.sensor.width, self.sensor.height
        )
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let reopen = py.import("eecvs._eecvs")?.getattr("_reopen")?;
        let Reopen {
            function,
            of,
            options,
        } = &self.reopen;
        let arguments = (*function, of.bind(py), options.bind(py)).into_pyobject(py)?;
        PyTuple::new(py, [reopen, arguments.into_any()])
    }
}

impl Recording {
    fn slices(&self, py: Python<'_>, cut: Result<Cut>) -> PyResult<Slices> {
        let cut =
            cut.map_err(|error| crate::errors::exception(py, &error, Some(&self.source.name)))?;
        Ok(Slices::new(&self.source, &self.found, cut))
    }
}
