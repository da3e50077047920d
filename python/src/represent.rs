//! Dense representations of events, of one window or of many at once.

use eecvs::reconstruct::volume::Weights;
use eecvs::representation::{Counts, Span, TimeSurface, Tore, Voxel};
use event_types::stream::{Error, EventReader, Result};
use event_types::{Sensor, error};
use half::f16;
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::errors::exception;
use crate::given::{self, Size, Table, TableReader};
use crate::number;
use crate::recording::{Recording, Slices};
use crate::window::not_one_of;
use crate::work::in_pool;

/// A representation of one window's events.
#[derive(Clone, Copy)]
enum Form {
    Voxel(Voxel),
    Counts(Counts),
    Surface(TimeSurface),
    Tore(Tore),
}

impl Form {
    fn channels(&self) -> usize {
        match self {
            Self::Voxel(voxel) => voxel.channels(),
            Self::Counts(counts) => counts.channels(),
            Self::Surface(_) => TimeSurface::CHANNELS,
            Self::Tore(tore) => tore.channels(),
        }
    }

    fn fill(&self, reader: &mut dyn EventReader, cells: &mut [f32]) -> Result<()> {
        match self {
            Self::Voxel(voxel) => voxel.fill(reader, cells),
            Self::Counts(counts) => counts.fill(reader, cells),
            Self::Surface(surface) => surface.fill(reader, cells),
            Self::Tore(tore) => tore.fill(reader, cells),
        }
    }
}

/// Values of an array.
trait Value: Element + Copy + Send + Sync {
    const ZERO: Self;

    fn fill(form: &Form, reader: &mut dyn EventReader, cells: &mut [Self]) -> Result<()>;
}

impl Value for f32 {
    const ZERO: Self = 0.0;

    fn fill(form: &Form, reader: &mut dyn EventReader, cells: &mut [Self]) -> Result<()> {
        form.fill(reader, cells)
    }
}

impl Value for f16 {
    const ZERO: Self = Self::ZERO;

    fn fill(form: &Form, reader: &mut dyn EventReader, cells: &mut [Self]) -> Result<()> {
        let mut wide = Vec::new();
        wide.try_reserve_exact(cells.len())
            .map_err(crate::layout::no_memory)?;
        wide.resize(cells.len(), 0.0);
        form.fill(reader, &mut wide)?;
        for (cell, value) in cells.iter_mut().zip(wide) {
            *cell = Self::from_f32(value);
        }
        Ok(())
    }
}

impl Value for u8 {
    const ZERO: Self = 0;

    fn fill(form: &Form, reader: &mut dyn EventReader, cells: &mut [Self]) -> Result<()> {
        match form {
            Form::Counts(counts) => counts.fill(reader, cells),
            _ => Err(event_types::error!(Refused, "only counts fit into uint8")),
        }
    }
}

/// The times of a window, where the caller gives none.
#[derive(Clone, Copy)]
struct Asked {
    t0_us: Option<u64>,
    t1_us: Option<u64>,
}

impl Asked {
    /// Returns the span: half-open where an end is given, and else up to the last event.
    fn span(self, table: &Table) -> Result<Span> {
        let first = self.t0_us.or_else(|| table.time(false)).unwrap_or(0);
        match self.t1_us {
            Some(end) => Span::half_open(first, end),
            None => Span::closed(first, table.time(true).unwrap_or(first)),
        }
    }

    fn end(self, table: &Table) -> u64 {
        let last = self.t1_us.or_else(|| table.time(true));
        last.unwrap_or(0)
    }
}

/// Makes arrays of `form` of all windows.
fn make<'py>(
    events: &Bound<'py, PyAny>,
    sensor: Option<Size>,
    dtype: Option<&str>,
    out: Option<&Bound<'py, PyAny>>,
    form: impl Fn(&Table) -> Result<Form>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = events.py();
    if events.is_instance_of::<Recording>() || events.is_instance_of::<Slices>() {
        return Err(PyTypeError::new_err(
            "events are a recording: give an array of its events, such as recording.read(), or a list of arrays",
        ));
    }
    let sensor = Size::of(sensor).or_else(|| given::size_of_given(events));
    let sensor = sensor.ok_or_else(|| {
        PyValueError::new_err("sensor= is needed: arrays do not say how large theirs is")
    })?;
    let (tables, is_batch) = given::tables(events)?;
    let forms: Result<Vec<Form>> = tables.iter().map(form).collect();
    let forms = forms.map_err(|error| exception(py, &error, None))?;
    let out = out
        .map(|out| out.cast::<PyUntypedArray>().cloned())
        .transpose()
        .map_err(|_| PyTypeError::new_err("out is not an array of NumPy"))?;
    let of_out = out.as_ref().map(|out| out.dtype().to_string());
    match dtype.or(of_out.as_deref()).unwrap_or("float32") {
        "float32" => fill::<f32>(py, sensor, tables, &forms, is_batch, out),
        "float16" => fill::<f16>(py, sensor, tables, &forms, is_batch, out),
        "uint8" => fill::<u8>(py, sensor, tables, &forms, is_batch, out),
        other if dtype.is_none() => Err(not_one_of(
            "the dtype of out",
            other,
            "float32, float16, uint8",
        )),
        other => Err(not_one_of("dtype", other, "float32, float16, uint8")),
    }
}

fn fill<'py, T: Value>(
    py: Python<'py>,
    sensor: Sensor,
    tables: Vec<Table>,
    forms: &[Form],
    is_batch: bool,
    out: Option<Bound<'py, PyUntypedArray>>,
) -> PyResult<Bound<'py, PyAny>> {
    let channels = forms.first().map_or(0, Form::channels);
    let sides = [usize::from(sensor.height), usize::from(sensor.width)];
    let of_window = channels * sides[0] * sides[1];
    let mut shape = vec![channels, sides[0], sides[1]];
    if is_batch {
        shape.insert(0, tables.len());
    }
    let places: Vec<_> = match &out {
        Some(_) => tables.iter().flat_map(Table::places).collect(),
        None => Vec::new(),
    };
    let work = |cells: &mut [T]| -> Result<()> {
        let one = |cells: &mut [T], table: Table, form: &Form| {
            T::fill(form, &mut TableReader::new(table, sensor), cells)
        };
        if tables.len() < 2 {
            let windows = cells.chunks_exact_mut(of_window.max(1));
            return windows
                .zip(tables)
                .zip(forms)
                .try_for_each(|((cells, table), form)| one(cells, table, form));
        }
        in_pool(|| {
            let windows = cells.par_chunks_exact_mut(of_window.max(1));
            windows
                .zip(tables)
                .zip(forms)
                .try_for_each(|((cells, table), form)| one(cells, table, form))
        })?
    };
    let failed = |error: Error| exception(py, &error, None);
    let Some(out) = out else {
        let count = shape.iter().product();
        let cells = py.detach(|| {
            let mut cells = Vec::new();
            cells.try_reserve_exact(count).map_err(|_| {
                error!(
                    Refused,
                    "the system refuses the memory for an array of shape {shape:?}: take fewer windows or bins"
                )
            })?;
            cells.resize(count, T::ZERO);
            work(&mut cells)?;
            Ok(cells)
        });
        let cells = cells.map_err(failed)?;
        return Ok(PyArray1::from_vec(py, cells).reshape(shape)?.into_any());
    };
    let array = out.cast::<PyArrayDyn<T>>().map_err(|_| {
        PyTypeError::new_err(format!("out is {}: it has another dtype", out.dtype()))
    })?;
    if array.shape() != shape.as_slice() {
        return Err(PyValueError::new_err(format!(
            "out has the shape {:?}: it must be {shape:?}",
            array.shape()
        )));
    }
    let mut guard = array
        .try_readwrite()
        .map_err(|error| PyValueError::new_err(format!("out: {error}")))?;
    if !array.is_c_contiguous() {
        return Err(PyValueError::new_err(
            "out is not contiguous in the order of C",
        ));
    }
    let cells = guard
        .as_slice_mut()
        .map_err(|_| PyValueError::new_err("out is not contiguous, or not aligned"))?;
    let memory = cells.as_ptr_range();
    let memory = memory.start.addr()..memory.end.addr();
    if places
        .iter()
        .any(|place| place.start < memory.end && memory.start < place.end)
    {
        return Err(PyValueError::new_err(
            "out shares memory with the events, which would be overwritten",
        ));
    }
    py.detach(|| work(cells)).map_err(failed)?;
    drop(guard);
    Ok(out.into_any())
}

fn weights_of(name: &str) -> PyResult<Weights> {
    match name {
        "nearest" => Ok(Weights::Nearest),
        "bilinear" => Ok(Weights::Bilinear),
        _ => Err(not_one_of("weights", name, "nearest, bilinear")),
    }
}

/// Makes the voxel grid of events.
///
/// ``nearest``: V[b, y, x] is the sum of the polarities (+1, -1) of the pixel's events with
/// floor(bins (t - t0) / (t1 - t0)) = b. ``bilinear``: the sum of p max(0, 1 - abs(b - tau)) with
/// tau = (bins - 1) (t - t0) / (t1 - t0).
///
/// Args:
///     events: A structured array, a dictionary of columns, Columns or a Window; or a list of these, made in parallel.
///     bins: Number of bins, 1 to 4096.
///     sensor: (width, height) in pixels.
///     t0_us: Start in microseconds; by default the first event's time.
///     t1_us: End in microseconds, which no event may reach; by default the last event's time, which then belongs to the
///         last bin.
///     weights: ``"bilinear"`` or ``"nearest"``.
///     polarity: ``"signed"``: ON minus OFF; ``"split"``: ``bins`` channels of ON, then ``bins`` of OFF, both positive.
///     dtype: ``"float32"`` or ``"float16"``.
///     out: An array for the result, contiguous and of the right shape and type, which shares no memory with the events.
///
/// Sums are those of float32: whole numbers are exact up to 2^24. float16 holds up to 65,504, and infinity beyond.
/// t1 - t0 is below 2^51 us.
///
/// Returns:
///     (C, H, W), or (N, C, H, W) of a list of N.
///
/// Raises:
///     RefusedError: An event outside of the times or of the sensor.
#[pyfunction]
#[pyo3(signature = (
    events, bins, *, sensor=None, t0_us=None, t1_us=None, weights="bilinear", polarity="signed", dtype=None, out=None
))]
#[allow(clippy::too_many_arguments)]
pub fn voxel<'py>(
    events: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = number::bins)] bins: u16,
    sensor: Option<Size>,
    #[pyo3(from_py_with = number::t0_us)] t0_us: Option<u64>,
    #[pyo3(from_py_with = number::t1_us)] t1_us: Option<u64>,
    weights: &str,
    polarity: &str,
    dtype: Option<&str>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let weights = weights_of(weights)?;
    let split = match polarity {
        "signed" => false,
        "split" => true,
        _ => return Err(not_one_of("polarity", polarity, "signed, split")),
    };
    let asked = Asked { t0_us, t1_us };
    make(events, sensor, dtype, out, |table| {
        let span = asked.span(table)?;
        Ok(Form::Voxel(Voxel {
            span,
            bins,
            weights,
            split,
        }))
    })
}

/// Makes the stacked histogram of events: N[p bins + b, y, x] events of polarity p (0 ON, 1 OFF) in time bin b.
///
/// Args:
///     events, bins, sensor, t0_us, t1_us, out: As for ``voxel``.
///     most: Largest number, 1 to 255: more events count as these.
///     dtype: ``"uint8"``, ``"float32"`` or ``"float16"``.
///
/// Returns:
///     (2 bins, H, W), or (N, 2 bins, H, W) of a list of N.
///
/// Raises:
///     RefusedError: An event outside of the times or of the sensor.
#[pyfunction]
#[pyo3(signature = (events, bins=1, *, sensor=None, t0_us=None, t1_us=None, most=255, dtype=None, out=None))]
#[allow(clippy::too_many_arguments)]
pub fn counts<'py>(
    events: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = number::bins)] bins: u16,
    sensor: Option<Size>,
    #[pyo3(from_py_with = number::t0_us)] t0_us: Option<u64>,
    #[pyo3(from_py_with = number::t1_us)] t1_us: Option<u64>,
    #[pyo3(from_py_with = number::most)] most: u8,
    dtype: Option<&str>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let asked = Asked { t0_us, t1_us };
    let dtype = dtype.or(out.is_none().then_some("uint8"));
    make(events, sensor, dtype, out, |table| {
        let span = asked.span(table)?;
        Ok(Form::Counts(Counts { span, bins, most }))
    })
}

/// Makes the time surface of events: exp(-(t_us - t) / tau_us) of the latest ON (channel 0) and OFF event of every pixel, 0
/// without one.
///
/// Args:
///     events, sensor, out: As for ``voxel``.
///     tau_us: Time constant in microseconds, above 0.
///     t_us: Time at which the surface is looked at; by default the last event's.
///     dtype: ``"float32"`` or ``"float16"``.
///
/// Returns:
///     (2, H, W), or (N, 2, H, W) of a list of N.
///
/// Raises:
///     RefusedError: An event after ``t_us`` or outside of the sensor.
#[pyfunction]
#[pyo3(signature = (events, tau_us, *, sensor=None, t_us=None, dtype=None, out=None))]
pub fn time_surface<'py>(
    events: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = number::tau_us)] tau_us: f64,
    sensor: Option<Size>,
    #[pyo3(from_py_with = number::t_us)] t_us: Option<u64>,
    dtype: Option<&str>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let asked = Asked {
        t0_us: None,
        t1_us: t_us,
    };
    make(events, sensor, dtype, out, |table| {
        let end_us = asked.end(table);
        Ok(Form::Surface(TimeSurface { end_us, tau_us }))
    })
}

/// Makes the TORE volume of events: max(0, ln(age + 1) - ln(151)) of the latest k ON (first) and k OFF events of every
/// pixel, with ages in microseconds, at most 5 s, and 5 s where there is no event.
///
/// Args:
///     events, sensor, out: As for ``voxel``.
///     k: Number of events of each polarity, 1 to 4096.
///     t_us: Time at which the volume is looked at; by default the last event's.
///     dtype: ``"float32"`` or ``"float16"``.
///
/// Returns:
///     (2 k, H, W), or (N, 2 k, H, W) of a list of N.
///
/// Raises:
///     RefusedError: An event after ``t_us`` or outside of the sensor.
#[pyfunction]
#[pyo3(signature = (events, k=3, *, sensor=None, t_us=None, dtype=None, out=None))]
pub fn tore<'py>(
    events: &Bound<'py, PyAny>,
    #[pyo3(from_py_with = number::k)] k: u16,
    sensor: Option<Size>,
    #[pyo3(from_py_with = number::t_us)] t_us: Option<u64>,
    dtype: Option<&str>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let asked = Asked {
        t0_us: None,
        t1_us: t_us,
    };
    make(events, sensor, dtype, out, |table| {
        let end_us = asked.end(table);
        Ok(Form::Tore(Tore { end_us, depth: k }))
    })
}
