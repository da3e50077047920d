//! Decoding of frames as they come, window by window.

use std::io;
use std::sync::{Mutex, PoisonError};

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs::pushed::{PushError, Pushed};
use eecvs::reconstruct::DecodedWindow;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::reconstruct::recover::Confidences;
use eecvs::reconstruct::volume::{Channels, Form, Maker, Weights};
use event_types::Sensor;
use event_types::stream::{Error, ErrorKind, Result};
use numpy::{PyArray1, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyMemoryView};

use crate::codec::dictionary;
use crate::errors::{exception, warn_of_loss};
use crate::layout::{Layout, array_of};
use crate::number;
use crate::recording::sensor_object;
use crate::work::in_pool;

/// A decoded window: its times, its events, and volumes of it.
#[pyclass(module = "eecvs", frozen)]
pub struct Window {
    window: DecodedWindow,
    layout: Layout,
}

impl Window {
    /// Returns the sensor's size.
    pub const fn size(&self) -> Sensor {
        self.window.header.sensor
    }

    fn volume<'py>(&self, py: Python<'py>, form: Form) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let made = py.detach(|| {
            in_pool(|| {
                let mut maker = Maker::new(form, EventDecoder::new(Finder::Exact));
                let volume = maker.volume(&self.window)?;
                let [channels, height, width] = volume.shape();
                let mut values = Vec::new();
                let count = channels * height * width;
                values
                    .try_reserve_exact(count)
                    .map_err(crate::layout::no_memory)?;
                values.resize(count, 0.0);
                for (channel, plane) in values.chunks_exact_mut(height * width).enumerate() {
                    volume.plane(channel, plane);
                }
                Ok::<_, Error>(([channels, height, width], values))
            })?
        });
        let (shape, values) = made.map_err(|error| exception(py, &error, None))?;
        PyArray1::from_vec(py, values).reshape(shape)
    }
}

#[pymethods]
impl Window {
    /// Time of its start in microseconds.
    #[getter]
    fn t0_us(&self) -> u64 {
        self.window.header.t0_us
    }

    /// Duration in microseconds.
    #[getter]
    fn duration_us(&self) -> u32 {
        self.window.header.duration_us
    }

    /// Size of the sensor in pixels.
    #[getter]
    fn sensor<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        sensor_object(py, self.window.header.sensor)
    }

    /// Whether all times are exact.
    #[getter]
    fn is_exact(&self) -> bool {
        self.window.header.mode.is_lossless()
    }

    /// Transform of its volume of coefficients: ``"dct"``, ``"dtft"`` or ``"dwt"``.
    #[getter]
    fn transform(&self) -> String {
        format!("{:?}", self.window.header.transform).to_ascii_lowercase()
    }

    /// Number of coefficients kept per pixel.
    #[getter]
    fn m(&self) -> u8 {
        self.window.header.m
    }

    /// The events: a structured array, (N,), in the order of time.
    #[getter(events)]
    pub fn events<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array_of(py, self.layout, &self.window.events)
    }

    fn __len__(&self) -> usize {
        self.window.events.len()
    }

    fn __repr__(&self) -> String {
        let header = &self.window.header;
        format!(
            "<Window of {} events from {} us on, {} us long>",
            self.window.events.len(),
            header.t0_us,
            header.duration_us
        )
    }

    /// The volume of coefficients: those of the frames or, if events were sent, those that the encoder would have sent.
    ///
    /// Args:
    ///     normalise: Scales non-zero values to a mean of 0 and a standard deviation of 1.
    ///
    /// Returns:
    ///     float32, (K, H, W), or (2 K, H, W) with re and im in turn; c_0 is ON minus OFF.
    #[pyo3(signature = (*, normalise=false))]
    fn coefficients<'py>(
        &self,
        py: Python<'py>,
        normalise: bool,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let form = Form {
            channels: Channels::Coefficients,
            normalised: normalise,
        };
        self.volume(py, form)
    }

    /// The volume of ``bins`` time bins, as ``eecvs decode --volume --bins`` makes it; each value is rounded once.
    ///
    /// Args:
    ///     bins: Number of bins, 1 to 4096.
    ///     weights: ``"nearest"`` adds 1 to an event's bin; ``"bilinear"`` splits 1 between the two nearest bins.
    ///     polarity: ``"signed"`` is ON minus OFF; ``"split"`` is ON in the first, OFF in the other ``bins`` channels.
    ///     normalise: Scales non-zero values to a mean of 0 and a standard deviation of 1.
    ///
    /// Returns:
    ///     float32, (bins, H, W) or (2 bins, H, W).
    #[pyo3(signature = (bins, *, weights="nearest", polarity="signed", normalise=false))]
    fn voxel<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = number::bins)] bins: u16,
        weights: &str,
        polarity: &str,
        normalise: bool,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let form = Form {
            channels: Channels::Bins {
                count: bins,
                weights: match weights {
                    "nearest" => Weights::Nearest,
                    "bilinear" => Weights::Bilinear,
                    _ => return Err(not_one_of("weights", weights, "nearest, bilinear")),
                },
                split: match polarity {
                    "signed" => false,
                    "split" => true,
                    _ => return Err(not_one_of("polarity", polarity, "signed, split")),
                },
            },
            normalised: normalise,
        };
        self.volume(py, form)
    }
}

/// Returns the exception for a word that is not one of those known.
pub fn not_one_of(name: &str, value: &str, words: &str) -> PyErr {
    PyValueError::new_err(format!("{name} is {value:?}: it must be one of {words}"))
}

/// Returns the bytes of bytes, or of anything with a buffer: a copy of these.
///
/// # Errors
/// `TypeError` for anything else.
pub fn bytes_of<'py>(data: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyBytes>> {
    // The stable ABI of 3.9 has no buffers: a memoryview reads them.
    match data.cast::<PyBytes>() {
        Ok(bytes) => Ok(bytes.clone()),
        Err(_) => Ok(PyMemoryView::from(data)?
            .call_method0("tobytes")?
            .cast_into::<PyBytes>()?),
    }
}

/// A decoder of frames that come in portions: push bytes, take the windows that come back.
///
/// Bytes may be cut anywhere. Damaged and missing frames are skipped and counted: ``finish`` warns of them, and ``losses``
/// has the counts.
///
/// Args:
///     dtype: Layout of the windows' events, as for ``open``.
///     events: How event times are found in coefficients: ``"exact"`` or ``"peaks"``.
///     max_events_per_window, max_work_per_window: Limits, as in ``eecvs decode``.
#[pyclass(module = "eecvs", frozen)]
pub struct Decoder {
    inner: Mutex<Inner>,
    pushed: Pushed,
    layout: Layout,
}

struct Inner {
    windows: WindowReader<Pushed>,
    events: EventDecoder,
    confidences: Confidences,
}

impl Inner {
    /// Decodes all windows that are complete.
    fn ready(&mut self) -> Result<Vec<DecodedWindow>> {
        let mut ready = Vec::new();
        loop {
            match self.windows.next_window() {
                Ok(Some(mut window)) => {
                    self.confidences.add(self.events.fill(&mut window));
                    ready.push(window);
                }
                Ok(None) => return Ok(ready),
                Err(error) if error.kind() == ErrorKind::Io(io::ErrorKind::WouldBlock) => {
                    return Ok(ready);
                }
                Err(error) => return Err(error),
            }
        }
    }
}

impl Decoder {
    fn windows(&self, py: Python<'_>) -> PyResult<Vec<Window>> {
        let ready = py.detach(|| {
            in_pool(|| {
                let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
                inner.ready()
            })?
        });
        let ready = ready.map_err(|error| exception(py, &error, None))?;
        let layout = self.layout;
        let windows = ready.into_iter().map(|window| Window { window, layout });
        Ok(windows.collect())
    }
}

#[pymethods]
impl Decoder {
    #[new]
    #[pyo3(signature = (*, dtype=None, events="exact", max_events_per_window=None, max_work_per_window=None))]
    fn new(
        dtype: Option<&str>,
        events: &str,
        #[pyo3(from_py_with = number::max_events_per_window)] max_events_per_window: Option<u32>,
        #[pyo3(from_py_with = number::max_work_per_window)] max_work_per_window: Option<u32>,
    ) -> PyResult<Self> {
        let finder = Finder::from_name(events);
        let finder = finder.ok_or_else(|| not_one_of("events", events, "exact, peaks"))?;
        let pushed = Pushed::default();
        let windows = WindowReader::new(FrameReader::new(pushed.clone()).patient());
        Ok(Self {
            inner: Mutex::new(Inner {
                windows: windows.with_limit(max_events_per_window.into()),
                events: EventDecoder::new(finder).with_work_limit(max_work_per_window.into()),
                confidences: Confidences::default(),
            }),
            pushed,
            layout: Layout::of(dtype)?,
        })
    }

    /// Takes bytes, and returns the windows with events that are complete.
    ///
    /// Args:
    ///     data: bytes, or anything with a contiguous buffer of bytes.
    ///
    /// Raises:
    ///     ValueError: The decoder was finished.
    fn push(&self, py: Python<'_>, data: &Bound<'_, PyAny>) -> PyResult<Vec<Window>> {
        let bytes = bytes_of(data)?;
        let bytes = bytes.as_bytes();
        match py.detach(|| self.pushed.push(bytes)) {
            Ok(()) => self.windows(py),
            Err(PushError::Finished) => Err(PyValueError::new_err(
                "the decoder was finished: begin another one",
            )),
            Err(PushError::NoMemory) => Err(PyMemoryError::new_err(
                "the system refuses memory for these bytes",
            )),
        }
    }

    /// Ends the stream, and returns the last windows; warns of what was damaged or lost.
    ///
    /// Raises:
    ///     DamagedError: There was no frame.
    fn finish(&self, py: Python<'_>) -> PyResult<Vec<Window>> {
        py.detach(|| self.pushed.finish());
        let windows = self.windows(py)?;
        let (frames, why, loss) = py.detach(|| {
            let inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
            let report = inner.windows.report();
            let counts = inner.windows.counts();
            let mut losses: Vec<String> = report
                .warning()
                .filter(|_| report.has_loss())
                .into_iter()
                .collect();
            for (count, what) in [
                (counts.events_late, "late at the encoder"),
                (counts.events_dropped, "dropped"),
                (counts.events_thinned, "left out by the rate control"),
                (counts.events_filtered, "filtered"),
            ] {
                if count > 0 {
                    losses.push(format!("{count} events {what}"));
                }
            }
            (report.frames, report.why_empty(), losses.join("; "))
        });
        if frames == 0 {
            let error = Error::new(ErrorKind::Damaged, why);
            return Err(exception(py, &error, None));
        }
        if !loss.is_empty() {
            warn_of_loss(py, &loss)?;
        }
        Ok(windows)
    }

    /// Size of the sensor, which the first frame states; None before it.
    #[getter]
    fn sensor<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let sensor = py.detach(|| {
            let inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
            inner.windows.sensor()
        });
        sensor.map(|sensor| sensor_object(py, sensor)).transpose()
    }

    /// Counts so far, with the keys of ``eecvs decode --json``: damage, missing frames, events left out, confidences.
    #[getter]
    fn losses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (report, counts, confidences) = py.detach(|| {
            let inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
            (
                inner.windows.report().clone(),
                inner.windows.counts(),
                inner.confidences,
            )
        });
        let all = PyDict::new(py);
        for part in [
            dictionary(py, &report)?,
            dictionary(py, &counts)?,
            dictionary(py, &confidences)?,
        ] {
            all.update(part.cast::<PyDict>()?.as_mapping())?;
        }
        Ok(all)
    }
}
