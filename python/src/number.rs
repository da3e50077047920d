//! Whole numbers that a caller states: every one is named when it is refused, with the range that it must be in.

use std::fmt::Display;
use std::ops::RangeInclusive;

use event_types::Sensor;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyInt;

/// Returns a number in a range: of an int, or of anything that Python takes for an index. A bool is none.
///
/// # Errors
/// `TypeError` for anything else, `ValueError` for a number out of range. The texts begin with the value.
pub fn within<T>(value: &Bound<'_, PyAny>, range: RangeInclusive<T>) -> PyResult<T>
where
    T: TryFrom<i128> + PartialOrd + Display,
{
    let number = whole(value)?;
    // What has more bits is out of every range.
    let fits = number.extract::<i128>().ok();
    let fits = fits.and_then(|number| T::try_from(number).ok());
    fits.filter(|number| range.contains(number)).ok_or_else(|| {
        let (least, most) = range.into_inner();
        PyValueError::new_err(format!(
            "{}: it must be {least} to {most}",
            text_of(&number)
        ))
    })
}

fn whole<'py>(value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    if value.is_exact_instance_of::<PyInt>() {
        return Ok(value.clone());
    }
    let index = value.py().import("operator")?.getattr("index")?;
    let number = index.call1((value,)).ok().filter(|_| !is_bool(value));
    number.ok_or_else(|| not_a(value, "a whole number"))
}

/// Returns a number: of a float, or of anything that Python takes for one. A bool is none.
///
/// # Errors
/// `TypeError` for anything else, whose text begins with the value.
pub fn real(value: &Bound<'_, PyAny>) -> PyResult<f64> {
    let number = value.extract::<f64>().ok().filter(|_| !is_bool(value));
    number.ok_or_else(|| not_a(value, "a number"))
}

/// Whether a value is one of Python's bools, which are ints to it, or one of NumPy's.
fn is_bool(value: &Bound<'_, PyAny>) -> bool {
    let kind = value.get_type().name();
    kind.is_ok_and(|kind| kind.to_string_lossy().starts_with("bool"))
}

fn not_a(value: &Bound<'_, PyAny>, what: &str) -> PyErr {
    let text = value.repr().map(|text| text.to_string());
    let text = text.ok().filter(|text| text.len() <= 40);
    let text = text.unwrap_or_else(|| value.get_type().to_string());
    PyTypeError::new_err(format!("{text}: it must be {what}"))
}

/// Returns a number's digits, or how many bits it has if these are many.
fn text_of(number: &Bound<'_, PyAny>) -> String {
    if number.extract::<i128>().is_ok() {
        return number.to_string();
    }
    let bits = number.call_method0("bit_length");
    bits.map_or_else(
        |_| number.to_string(),
        |bits| format!("a number of {bits} bits"),
    )
}

/// Returns a number in a range, of which refusals say the name.
///
/// # Errors
/// Those of [`within`].
pub fn named<T>(value: &Bound<'_, PyAny>, name_of: &str, range: RangeInclusive<T>) -> PyResult<T>
where
    T: TryFrom<i128> + PartialOrd + Display,
{
    within(value, range).map_err(|error| name(value, name_of, &error))
}

/// Puts the argument's name before the text of [`within`] or [`real`].
pub fn name(value: &Bound<'_, PyAny>, name: &str, error: &PyErr) -> PyErr {
    let text = format!("{name} is {}", error.value(value.py()));
    if error.is_instance_of::<PyTypeError>(value.py()) {
        PyTypeError::new_err(text)
    } else {
        PyValueError::new_err(text)
    }
}

/// Returns a number in a range, for the parts of this package that are written in Python.
#[pyfunction]
pub fn _whole(
    value: &Bound<'_, PyAny>,
    name: &str,
    least: &Bound<'_, PyAny>,
    most: &Bound<'_, PyAny>,
) -> PyResult<i64> {
    named(value, name, least.extract::<i64>()?..=most.extract()?)
}

/// For each argument a function that takes it from Python.
macro_rules! arguments {
    ($($name:ident: $kind:ty = $range:expr;)*) => {$(
        pub fn $name(value: &Bound<'_, PyAny>) -> PyResult<$kind> {
            <$kind as Argument>::take(value, stringify!($name), $range)
        }
    )*};
}

/// A number, or a number that may be left out.
trait Argument: Sized {
    type Number;

    fn take(
        value: &Bound<'_, PyAny>,
        name: &str,
        range: RangeInclusive<Self::Number>,
    ) -> PyResult<Self>;
}

macro_rules! numbers {
    ($($number:ty)*) => {$(
        impl Argument for $number {
            type Number = Self;

            fn take(
                value: &Bound<'_, PyAny>,
                name: &str,
                range: RangeInclusive<Self>,
            ) -> PyResult<Self> {
                named(value, name, range)
            }
        }

        impl Argument for Option<$number> {
            type Number = $number;

            fn take(
                value: &Bound<'_, PyAny>,
                name: &str,
                range: RangeInclusive<$number>,
            ) -> PyResult<Self> {
                (!value.is_none()).then(|| named(value, name, range)).transpose()
            }
        }
    )*};
}

numbers!(u8 u16 u32 u64 usize i64);

arguments! {
    // Of `open` and `Decoder`.
    width: Option<u16> = 1..=Sensor::SIDE_MAX;
    height: Option<u16> = 1..=Sensor::SIDE_MAX;
    time_offset_us: i64 = i64::MIN..=i64::MAX;
    max_events_per_window: Option<u32> = 0..=u32::MAX;
    max_work_per_window: Option<u32> = 0..=u32::MAX;
    // Of slices.
    us: u64 = 1..=u64::MAX;
    origin_us: Option<u64> = 0..=u64::MAX;
    n: usize = 1..=usize::MAX;
    // Of representations.
    bins: u16 = 1..=4096;
    k: u16 = 1..=4096;
    most: u8 = 1..=u8::MAX;
    t0_us: Option<u64> = 0..=u64::MAX;
    t1_us: Option<u64> = 0..=u64::MAX;
    t_us: Option<u64> = 0..=u64::MAX;
    // Of scenes, comparisons and pictures.
    seed: u64 = 0..=u64::MAX;
    duration_us: Option<u64> = 0..=i64::MAX as u64;
    start_us: u64 = 0..=i64::MAX as u64;
    model: u8 = 1..=2;
    window_us: u64 = 1..=u64::MAX;
    clip: u32 = 1..=u32::MAX;
    upscale: Option<usize> = 1..=64;
}

/// Takes the time constant of a surface.
pub fn tau_us(value: &Bound<'_, PyAny>) -> PyResult<f64> {
    real(value).map_err(|error| name(value, "tau_us", &error))
}

/// Takes the duration of a capture.
#[cfg(target_os = "linux")]
pub fn duration_s(value: &Bound<'_, PyAny>) -> PyResult<Option<f64>> {
    let number = (!value.is_none()).then(|| real(value)).transpose();
    number.map_err(|error| name(value, "duration_s", &error))
}

#[cfg(target_os = "linux")]
arguments! {
    // Of live devices.
    max_events: Option<u64> = 0..=u64::MAX;
    queue_mib: usize = 1..=4096;
}
