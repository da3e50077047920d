//! Encoding of events, at once and as they come.

use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use eecvs::encode::push::{PushEncoder, Settings};
use eecvs::encode::{
    Codec, EncodeSummary, duration, encode as encode_reader, encode_nothing, readout,
};
use eecvs::frame_file::FrameFileWriter;
use eecvs::representation::check_places;
use eecvs_nostd::Config;
use event_files::sort::Sorted;
use event_types::stream::{Error, EventReader, Intact, Result};
use event_types::{Event, Sensor, ensure};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::errors::warn_of_loss;
use crate::given::{self, Size, Table, raise};
use crate::options::Asked;
use crate::work::{Interruptible, Raised, Signals};

/// A reader of what a caller gave.
pub struct Given {
    pub reader: Box<dyn EventReader>,
    /// Whether the events before damage are taken, with a warning.
    pub keeps_damaged: bool,
}

/// What an encoding came to.
pub struct Done {
    pub summary: EncodeSummary,
    /// Damage of the input, after which nothing was encoded.
    damage: Option<Error>,
}

impl Done {
    /// Warns of events that are in no frame.
    ///
    /// # Errors
    /// Warnings that are exceptions.
    pub fn tell(&self, py: Python<'_>) -> PyResult<()> {
        if let Some(damage) = &self.damage {
            warn_of_loss(py, &format!("{damage:#}: everything before was encoded"))?;
        }
        tell_late(py, &self.summary)
    }
}

/// Encodes a reader's events as the frames of a file, and returns the counts.
///
/// # Errors
/// Those of the reader, the encoder and the output; late events, unless loss is allowed.
pub fn encode_to<W: Write>(
    given: Given,
    asked: &Asked,
    raised: &Raised,
    out: W,
) -> Result<(Done, W)> {
    let sensor = given.reader.sensor();
    let mut reader: Box<dyn EventReader> = Box::new(Interruptible::new(given.reader, raised));
    if asked.sort {
        reader = Box::new(Sorted::new(reader, &mut |_| {})?);
    }
    let mut config = asked.encode.config_of_file(sensor)?;
    ensure!(
        !asked.auto_window || duration::is_free(&config),
        Refused,
        "--auto-window is for --mode hybrid, without --bins and --bytes-per-second"
    );
    if asked.scans {
        (reader, config) = readout::look(reader, config);
    }
    let hot = asked.hot(sensor)?;
    let mut codec = Codec {
        config,
        kernel: asked.kernel,
        hot: &hot,
        budget: None,
        max_nmse: asked.encode.max_nmse,
    };
    if asked.auto_window {
        let (looked, mut config) = duration::look(reader, codec, asked.limits, asked.threads)?;
        config.key_windows = asked.encode.key_windows(config.window.window_us);
        reader = looked;
        codec = Codec { config, ..codec };
    }
    let mut out = FrameFileWriter::new(out);
    let mut signals = Signals::new(raised);
    let mut reader = Intact::new(reader);
    let mut summary = encode_reader(
        &mut reader,
        codec,
        asked.limits,
        asked.threads,
        &mut out,
        &mut |_| {
            // The reader ends the work.
            let _ = signals.check();
        },
    )?;
    let damage = match reader.damage() {
        Some(damage) if !given.keeps_damaged || summary.events_in == 0 => return Err(damage),
        damage => damage,
    };
    refuse_late(&summary, asked.allow_loss)?;
    if summary.frames == 0 {
        encode_nothing(codec, asked.limits, &mut out, &mut summary)?;
    }
    summary.set_bytes_out(out.bytes());
    Ok((Done { summary, damage }, out.finish()?))
}

fn late(summary: &EncodeSummary) -> String {
    format!(
        "{} of {} events came too late and are in no frame: give --reorder-us or --sort",
        summary.events_late, summary.events_in
    )
}

fn refuse_late(summary: &EncodeSummary, allow_loss: bool) -> Result<()> {
    ensure!(
        allow_loss || summary.events_late == 0,
        Refused,
        "{}; with --allow-loss this is a warning",
        late(summary)
    );
    Ok(())
}

/// Warns of events that are in no frame.
///
/// # Errors
/// Warnings that are exceptions.
fn tell_late(py: Python<'_>, summary: &EncodeSummary) -> PyResult<()> {
    if summary.events_late > 0 {
        warn_of_loss(py, &late(summary))?;
    }
    Ok(())
}

/// Returns counts as a dictionary.
///
/// # Errors
/// Those of Python.
pub fn dictionary<'py>(
    py: Python<'py>,
    counts: &impl serde::Serialize,
) -> PyResult<Bound<'py, PyAny>> {
    let text =
        serde_json::to_string(counts).map_err(|error| PyValueError::new_err(error.to_string()))?;
    py.import("json")?.getattr("loads")?.call1((text,))
}

/// Encodes events to frames: the bytes of an ``.eecvs`` file, losslessly unless options ask for less.
///
/// Args:
///     events: A structured array of any of the layouts of ``open``, a dictionary of columns, Columns, a Recording, a
///         Window, or an iterable of these.
///     sensor: (width, height) in pixels; a Recording has its own.
///     **options: Those of ``eecvs encode``, with ``_`` for ``-``: see EncodeOptions.
///
/// Returns:
///     bytes, the same for any number of threads.
///
/// Raises:
///     RefusedError: Options that exclude each other; events that came too late for their window, unless
///         ``allow_loss=True``; an event that no sensor has.
///     TypeError, ValueError: Events or options of a wrong kind.
#[pyfunction]
#[pyo3(signature = (events, *, sensor=None, **options))]
pub fn encode<'py>(
    py: Python<'py>,
    events: &Bound<'py, PyAny>,
    sensor: Option<Size>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyBytes>> {
    let asked = Asked::of(options)?;
    let raised = Raised::default();
    let sensor = Size::of(sensor);
    let given = Given {
        reader: given::reader(events, sensor, &raised)?,
        keeps_damaged: given::keeps_damaged(events),
    };
    let encoded = py.detach(|| encode_to(given, &asked, &raised, Vec::new()));
    let (done, bytes) = encoded.map_err(|error| raise(py, &raised, &error, None))?;
    if let Some(exception) = raised.take() {
        return Err(exception);
    }
    done.tell(py)?;
    Ok(PyBytes::new(py, &bytes))
}

/// Bytes that an encoder has written and that its user has not taken.
#[derive(Clone, Default)]
struct Taken(Arc<Mutex<Vec<u8>>>);

impl Taken {
    fn take(&self) -> Vec<u8> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Write for Taken {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// An encoder of events that come in portions: push events, write the bytes that come back.
///
/// All bytes together, those of ``finish`` last, are the ``.eecvs`` file that ``encode`` makes of all events, whatever the
/// portions are. It encodes on the calling thread and lets other threads run.
///
/// Args:
///     sensor: (width, height) in pixels.
///     **options: As for ``encode``, without ``auto_window``, ``sort`` and ``threads``.
///
/// Raises:
///     RefusedError: Options that exclude each other.
#[pyclass(module = "eecvs", frozen)]
pub struct Encoder {
    inner: Mutex<Inner>,
    sensor: Sensor,
}

struct Inner {
    asked: Asked,
    config: Config,
    hot: Vec<(u16, u16)>,
    stage: Stage,
    bytes: Taken,
}

enum Stage {
    /// The first events, in which a readout is looked for.
    Looking(Vec<Event>),
    Encoding(Box<PushEncoder>, Box<FrameFileWriter<Taken>>),
    Finished(EncodeSummary),
}

impl Inner {
    /// Begins to encode, with the events held so far.
    fn begin(&mut self) -> Result<()> {
        if let Stage::Looking(events) = &mut self.stage {
            let events = std::mem::take(events);
            if self.asked.scans {
                self.config = readout::look_at(&events, self.config);
            }
            let settings = Settings {
                config: self.config,
                kernel: self.asked.kernel,
                hot: self.hot.clone(),
                max_nmse: self.asked.encode.max_nmse,
            };
            let mut encoder = PushEncoder::new(settings, self.asked.limits)?;
            let mut out = FrameFileWriter::new(self.bytes.clone());
            encoder.push(&events, &mut out)?;
            self.stage = Stage::Encoding(Box::new(encoder), Box::new(out));
        }
        Ok(())
    }

    fn push(&mut self, events: &[Event]) -> Result<()> {
        if let Stage::Looking(held) = &mut self.stage {
            held.extend_from_slice(events);
            let looks = self.asked.scans && readout::may_scan(self.config.mode);
            if looks && held.len() < readout::EVENTS {
                return Ok(());
            }
            return self.begin();
        }
        match &mut self.stage {
            Stage::Encoding(encoder, out) => encoder.push(events, out.as_mut()),
            _ => Err(Error::new(
                event_types::stream::ErrorKind::Refused,
                "the encoder was finished: begin another one",
            )),
        }
    }

    fn finish(&mut self) -> Result<()> {
        self.begin()?;
        let finished = Stage::Finished(EncodeSummary::default());
        let (encoder, mut out) = match std::mem::replace(&mut self.stage, finished) {
            Stage::Encoding(encoder, out) => (encoder, out),
            other => {
                self.stage = other;
                return Ok(());
            }
        };
        let mut summary = encoder.finish(out.as_mut())?;
        if summary.frames == 0 {
            let codec = Codec {
                kernel: self.asked.kernel,
                hot: &self.hot,
                ..Codec::from(self.config)
            };
            encode_nothing(codec, self.asked.limits, out.as_mut(), &mut summary)?;
        }
        summary.set_bytes_out(out.bytes());
        out.end()?;
        let late = refuse_late(&summary, self.asked.allow_loss);
        self.stage = Stage::Finished(summary);
        late
    }
}

#[pymethods]
impl Encoder {
    #[new]
    #[pyo3(signature = (sensor, **options))]
    fn new(py: Python<'_>, sensor: Size, options: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let asked = Asked::of(options)?;
        if asked.auto_window || asked.sort {
            return Err(PyValueError::new_err(
                "auto_window= and sort= need all events: use encode()",
            ));
        }
        let Size(sensor) = sensor;
        let config = asked.encode.config_of_file(sensor);
        let config = config.and_then(|config| Ok((config, asked.hot(sensor)?)));
        let (config, hot) = config.map_err(|error| crate::errors::exception(py, &error, None))?;
        let looks = asked.scans && readout::may_scan(config.mode);
        let mut inner = Inner {
            asked,
            config,
            hot,
            stage: Stage::Looking(Vec::new()),
            bytes: Taken::default(),
        };
        if !looks {
            // Wrong options are refused here.
            let begun = py.detach(|| inner.begin());
            begun.map_err(|error| crate::errors::exception(py, &error, None))?;
        }
        Ok(Self {
            inner: Mutex::new(inner),
            sensor,
        })
    }

    /// Encodes events, and returns the bytes of all windows that they close; some may be held back.
    ///
    /// Raises:
    ///     RefusedError: An event that no sensor has; the encoder was finished.
    fn push<'py>(
        &self,
        py: Python<'py>,
        events: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let mut table = Table::of(events)?;
        let pushed = py.detach(|| {
            // All of them are checked before one is encoded.
            let mut events = Vec::new();
            let count = table.len();
            table.read(0, count, &mut events)?;
            check_places(self.sensor, &events, 0)?;
            let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
            inner.push(&events)?;
            Ok(inner.bytes.take())
        });
        let bytes = pushed.map_err(|error| crate::errors::exception(py, &error, None))?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// Encodes what is held back, and returns the last bytes.
    ///
    /// Raises:
    ///     RefusedError: Events came too late and are in no frame, unless ``allow_loss=True``; ``error.frames`` has the
    ///         last bytes.
    fn finish<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let (finished, bytes, summary) = py.detach(|| {
            let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
            let finished = inner.finish();
            let summary = match &inner.stage {
                Stage::Finished(summary) => summary.clone(),
                _ => EncodeSummary::default(),
            };
            (finished, inner.bytes.take(), summary)
        });
        let bytes = PyBytes::new(py, &bytes);
        if let Err(error) = finished {
            let exception = crate::errors::exception(py, &error, None);
            exception.value(py).setattr("frames", bytes)?;
            return Err(exception);
        }
        tell_late(py, &summary)?;
        Ok(bytes)
    }

    /// Size of the sensor in pixels.
    #[getter]
    fn sensor<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        crate::recording::sensor_object(py, self.sensor)
    }

    /// Counts so far, with the keys of ``eecvs encode --json``.
    #[getter]
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let summary = py.detach(|| {
            let inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
            match &inner.stage {
                Stage::Looking(events) => EncodeSummary {
                    events_in: events.len() as u64,
                    ..EncodeSummary::default()
                },
                Stage::Encoding(encoder, _) => encoder.summary().clone(),
                Stage::Finished(summary) => summary.clone(),
            }
        });
        dictionary(py, &summary)
    }
}
