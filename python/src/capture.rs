//! Live devices: cameras and encoders on USB or a serial port, and simulated ones.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use event_types::stream::{Error, EventReader, Pause, Result};
use event_types::{Sensor, error};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};
use usb_bridge::device::mcu::ANY_SENSOR;
use usb_bridge::live::{LiveReader, Progress};
use usb_bridge::peripheral::stream::Pace;
use usb_bridge::pump::Pumped;
use usb_bridge::session::{Limits, Session};
use usb_bridge::source::{self, Name};
use usb_bridge::stop::Stop;

use crate::codec::dictionary;
use crate::errors::{exception, warn_of_loss};
use crate::given::raise;
use crate::layout::{Layout, Packed, Packer, array};
use crate::number;
use crate::recording::{locked, sensor_object};
use crate::work::{Raised, Signals};

/// Opens a device and starts it: a camera or an encoder on USB or on a serial port, or a simulated camera.
///
/// Args:
///     device: ``"usb:BUS-PORT"``, a serial number or a model, as ``eecvs-usb list`` shows them; ``"serial:PATH"``;
///         ``"replay:FILE.stream"``; ``"sim:MODEL:FILE"``, a simulated camera that plays a recording. By default the only
///         device that is attached.
///     rate: Pace of simulated devices and replays: ``"real"``, ``"max"``, events per second, or ``"Fx"``, F times as fast
///         as recorded.
///     duration_s: Seconds after which the device is stopped.
///     max_events: Number of events after which it is stopped; those that arrive with the last one are kept.
///     wait: Waits until the device is attached.
///     queue_mib: Most MiB that wait for a slow program, 1 to 4096; what arrives beyond them is lost, and counted.
///     dtype: Layout of the arrays, as for ``open``.
///
/// Returns:
///     A Capture: an iterator of arrays as they arrive, and a context manager.
///
/// Raises:
///     EecvsError: There is no such device, or it cannot be used; the message says what to do.
#[pyfunction]
#[pyo3(signature = (
    device=None, *, rate="real", duration_s=None, max_events=None, wait=false, queue_mib=64, dtype=None
))]
#[allow(clippy::too_many_arguments)]
pub fn capture(
    py: Python<'_>,
    device: Option<&str>,
    rate: &str,
    #[pyo3(from_py_with = number::duration_s)] duration_s: Option<f64>,
    #[pyo3(from_py_with = number::max_events)] max_events: Option<u64>,
    wait: bool,
    #[pyo3(from_py_with = number::queue_mib)] queue_mib: usize,
    dtype: Option<&str>,
) -> PyResult<Capture> {
    let layout = Layout::of(dtype)?;
    let name: Option<Name> = device
        .map(str::parse)
        .transpose()
        .map_err(PyValueError::new_err)?;
    let rate: Pace = rate
        .parse()
        .map_err(|why: String| PyValueError::new_err(format!("rate: {why}")))?;
    let duration = duration_s
        .map(Duration::try_from_secs_f64)
        .transpose()
        .map_err(|why| PyValueError::new_err(format!("duration_s: {why}")))?;
    let options = source::Options {
        wait,
        rate,
        trace: None,
        hand_over: None,
    };
    let limits = Limits {
        duration,
        events: max_events,
    };
    let (raised, stop) = (Raised::default(), Stop::default());
    let started = py.detach(|| {
        let source = opened(name.as_ref(), &options, &stop, &raised)?;
        Session::start(source, queue_mib << 20, &stop, limits).map_err(from_anyhow)
    });
    let session = started.map_err(|error| raise(py, &raised, &error, device))?;
    Ok(Capture {
        name: session.name.clone(),
        model: session.model.name(),
        firmware: session.info.firmware.clone(),
        sensor: session.info.sensor,
        progress: session.progress(),
        pumped: Arc::clone(&session.pumped),
        layout,
        stop,
        process: std::process::id(),
        state: Mutex::new(State {
            reader: session.reader(),
            packer: Packer::new(layout),
            session: Some(session),
        }),
        report: Mutex::new(None),
    })
}

/// Opens a source; while that waits for a device, a signal's exception ends it.
fn opened(
    name: Option<&Name>,
    options: &source::Options,
    stop: &Stop,
    raised: &Raised,
) -> Result<usb_bridge::session::Source> {
    std::thread::scope(|scope| {
        let opening = scope.spawn(|| source::open(name, options, stop));
        let mut signals = Signals::new(raised);
        while !opening.is_finished() {
            if signals.check().is_err() {
                stop.ask();
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let opened = opening
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        opened.map_err(from_anyhow)
    })
}

fn from_anyhow(error: impl std::fmt::Display) -> Error {
    Error::other(format!("{error:#}"))
}

struct State {
    reader: LiveReader,
    packer: Packer,
    /// `None` when it is over.
    session: Option<Session>,
}

/// A running device: an iterator of arrays of events as they arrive.
///
/// It ends when the device does, at a limit, or when it is closed; events that had arrived are still given.
#[pyclass(module = "eecvs", frozen)]
pub struct Capture {
    name: String,
    model: &'static str,
    firmware: String,
    /// Size of the sensor before the stream has told another.
    sensor: Sensor,
    progress: Arc<Mutex<Progress>>,
    pumped: Arc<Pumped>,
    layout: Layout,
    stop: Stop,
    process: u32,
    state: Mutex<State>,
    report: Mutex<Option<Py<PyAny>>>,
}

/// What a step came to.
enum Step {
    Events(Packed),
    /// The end, and how it came, at the first time.
    Over(Option<Ended>),
}

struct Ended {
    report: Box<usb_bridge::session::Report>,
    failure: Option<Error>,
}

impl State {
    /// Stops the device if it runs, and returns how that went.
    fn end(&mut self, failure: Option<Error>) -> Option<Ended> {
        let (report, unstopped) = self.session.take()?.finish();
        Some(Ended {
            report: Box::new(report),
            failure: failure.or(unstopped.map(from_anyhow)),
        })
    }
}

impl Capture {
    /// Waits for events.
    fn next(&self, raised: &Raised) -> Result<Step> {
        if self.process != std::process::id() {
            return Err(error!(
                Refused,
                "{}: this capture was begun in another process", self.name
            ));
        }
        let mut state = locked(&self.state);
        let State {
            reader,
            packer,
            session,
        } = &mut *state;
        if session.is_none() {
            return Ok(Step::Over(None));
        }
        let mut signals = Signals::new(raised);
        let mut packed = Packed::new(self.layout);
        loop {
            match packer.add(&mut packed, |events| reader.read(events)) {
                Ok(0) if reader.pause() == Pause::Ended => return Ok(Step::Over(state.end(None))),
                Ok(0) => signals.check()?,
                Ok(_) => return Ok(Step::Events(packed)),
                Err(failure) => return Ok(Step::Over(state.end(Some(failure)))),
            }
        }
    }

    /// Keeps the report of the end, and warns of losses.
    fn note(&self, py: Python<'_>, ended: Ended) -> PyResult<()> {
        let report = dictionary(py, ended.report.as_ref())?.unbind();
        py.detach(|| *locked(&self.report) = Some(report));
        if !ended.report.losses.is_empty() {
            let losses = ended.report.losses.iter();
            let losses: Vec<String> = losses.map(|(what, n)| format!("{what}: {n}")).collect();
            warn_of_loss(py, &format!("{}: lost: {}", self.name, losses.join("; ")))?;
        }
        match ended.failure {
            Some(failure) => Err(exception(py, &failure, Some(&self.name))),
            None => Ok(()),
        }
    }
}

#[pymethods]
impl Capture {
    /// Size of the sensor in pixels; None until an encoder has sent its first frame.
    #[getter]
    fn sensor<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let told = py.detach(|| locked(&self.progress).sensor);
        let sensor = told.unwrap_or(self.sensor);
        (sensor != ANY_SENSOR)
            .then(|| sensor_object(py, sensor))
            .transpose()
    }

    /// Name of the device's link.
    #[getter]
    fn device(&self) -> &str {
        &self.name
    }

    /// Model of the device, such as ``"davis346"``.
    #[getter]
    const fn model(&self) -> &'static str {
        self.model
    }

    /// Firmware version as the device reports it.
    #[getter]
    fn firmware(&self) -> &str {
        &self.firmware
    }

    /// What was lost so far, by cause.
    #[getter]
    fn losses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let losses = py.detach(|| {
            let mut losses = locked(&self.progress).losses.clone();
            for (cause, n) in self.pumped.account.losses() {
                losses.add(cause, n);
            }
            losses
        });
        let all = PyDict::new(py);
        for (cause, n) in losses.iter() {
            all.set_item(cause, n)?;
        }
        Ok(all)
    }

    /// The report of the whole stream, with the keys of ``eecvs-usb capture --json``; None before its end.
    #[getter]
    fn report(&self, py: Python<'_>) -> Option<Py<PyAny>> {
        // Held for a moment, and never without the interpreter's lock.
        let report = locked(&self.report);
        report.as_ref().map(|report| report.clone_ref(py))
    }

    fn __iter__(slf: Bound<'_, Self>) -> Bound<'_, Self> {
        slf
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        // A loop in C, such as `list`, does not look by itself.
        py.check_signals()?;
        let raised = Raised::default();
        let step = py.detach(|| self.next(&raised));
        match step.map_err(|error| raise(py, &raised, &error, Some(&self.name)))? {
            Step::Events(packed) => array(py, self.layout, packed).map(Some),
            Step::Over(None) => Ok(None),
            Step::Over(Some(ended)) => self.note(py, ended).map(|()| None),
        }
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
    ) -> PyResult<()> {
        let _ = (exc_type, exc, traceback);
        self.close(py)
    }

    /// Asks the device to stop, from any thread: what it has sent is still given by the iterator, which then ends.
    fn stop(&self) {
        self.stop.ask();
    }

    /// Stops the device, lets go of it, and leaves out what had arrived.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let ended = py.detach(|| {
            if self.process != std::process::id() {
                return None;
            }
            // A thread that waits for events then gives up.
            self.stop.ask();
            locked(&self.state).end(None)
        });
        ended.map_or(Ok(()), |ended| self.note(py, ended))
    }

    fn __repr__(&self) -> String {
        format!("<Capture {:?}: {}>", self.name, self.model)
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        self.stop.ask();
    }
}
