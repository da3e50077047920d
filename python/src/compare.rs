//! Distortion between two recordings.

use event_metrics::clock;
use event_types::Sensor;
use event_types::stream::{Error, EventReader, Result};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::given::{self, Size, raise};
use crate::number;
use crate::work::{Interruptible, Raised, in_pool_watched};

/// Compares recording b with recording a, window by window: frames, event times and events.
///
/// Args:
///     a: The original: a Recording, a structured array, a dictionary of columns, Columns or a Window.
///     b: What is judged, such as the decoded events.
///     window_us: Length of the windows in microseconds, which start with a's first event.
///     sensor: (width, height) in pixels; a Recording has its own, which is also that of the other.
///     align: Removes a constant difference of the clocks first.
///
/// Returns:
///     Comparison: counts, exact_fraction, mse, ssim, emd_time_ms, emd_pixel_us, as ``eecvs compare`` gives them.
///
/// Raises:
///     RefusedError: The sensors differ, or a has no events and b has some.
#[pyfunction]
#[pyo3(signature = (a, b, *, window_us=32_768, sensor=None, align=false))]
pub fn compare<'py>(
    py: Python<'py>,
    a: &Bound<'py, PyAny>,
    b: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = number::window_us)] window_us: u64,
    sensor: Option<Size>,
    align: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let raised = Raised::default();
    let sensor = Size::of(sensor);
    let sensor = sensor
        .or_else(|| given::size_of_given(a))
        .or_else(|| given::size_of_given(b));
    let inputs = [Input::new(a, sensor)?, Input::new(b, sensor)?];
    let compared = py.detach(|| {
        in_pool_watched(&raised, || {
            let [a, b] = &inputs;
            let offset_us = clock::offset_us(&mut *a.open(0, &raised)?, &mut *b.open(0, &raised)?)?;
            let ahead_us = offset_us.filter(|_| align).unwrap_or(0);
            let comparison = event_metrics::compare(
                &|| a.open(ahead_us, &raised),
                &|| b.open(ahead_us.saturating_neg(), &raised),
                window_us,
                &mut |_| {},
            )?;
            Ok::<_, Error>((comparison, offset_us))
        })?
    });
    let (c, offset_us) = compared.map_err(|error| raise(py, &raised, &error, None))?;
    let fields = PyDict::new(py);
    fields.set_item("events_a", c.events_a)?;
    fields.set_item("events_b", c.events_b)?;
    fields.set_item("exact_fraction", c.exact_fraction)?;
    fields.set_item("exact_fraction_b", c.exact_fraction_b)?;
    fields.set_item("missing_events", c.missing_events)?;
    fields.set_item("surplus_events", c.surplus_events)?;
    fields.set_item("surplus_fraction", c.surplus_fraction)?;
    fields.set_item("mse", c.mse)?;
    fields.set_item("ssim", c.ssim)?;
    fields.set_item("emd_time_ms", c.emd_time_ms)?;
    fields.set_item("emd_pixel_us", c.emd_pixel_us)?;
    fields.set_item("clock_offset_us", offset_us)?;
    fields.set_item("aligned", align && offset_us.is_some())?;
    let class = py.import("eecvs._types")?.getattr("Comparison")?;
    class.call((), Some(&fields))
}

/// Events that can be read several times.
struct Input {
    events: Py<PyAny>,
    sensor: Option<Sensor>,
}

impl Input {
    fn new(events: &Bound<'_, PyAny>, sensor: Option<Sensor>) -> PyResult<Self> {
        // An iterator would be empty at the second reading.
        if !given::can_be_read_again(events)? {
            return Err(PyTypeError::new_err(format!(
                "events are a {}: a recording, a structured array or a dictionary of columns is needed",
                events.get_type()
            )));
        }
        Ok(Self {
            events: events.clone().unbind(),
            sensor,
        })
    }

    /// Opens the events with times that are later by `later_us`, if that is above 0.
    fn open(&self, later_us: i64, raised: &Raised) -> Result<Box<dyn EventReader>> {
        let reader = Python::attach(|py| given::reader(self.events.bind(py), self.sensor, raised));
        let reader = reader.map_err(|exception| raised.keep(exception))?;
        let reader = Interruptible::new(reader, raised);
        Ok(match u64::try_from(later_us) {
            Ok(later_us) if later_us > 0 => Box::new(clock::Later::new(reader, later_us)),
            _ => Box::new(reader),
        })
    }
}
