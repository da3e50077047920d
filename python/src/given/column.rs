//! A column of a table: whole numbers in memory of Python.

use numpy::{PyArrayDescrMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// Type of a column's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    U8,
    U16,
    U32,
    U64,
    I8,
    I16,
    I32,
    I64,
}

impl Kind {
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 => 4,
            Self::U64 | Self::I64 => 8,
        }
    }
}

/// One column of a table: values at equal distances in memory of Python.
pub struct Column {
    pub start: *const u8,
    pub stride: isize,
    pub kind: Kind,
    pub length: usize,
    /// The array, whose memory it is.
    _owner: Py<PyAny>,
}

// SAFETY: the memory belongs to an array that `_owner` keeps alive; it is read alone, and a `Py` may move between threads.
// A caller who changes the array meanwhile gets events of old and new numbers, each of which is checked after it was read.
#[allow(unsafe_code)]
unsafe impl Send for Column {}
// SAFETY: as above.
#[allow(unsafe_code)]
unsafe impl Sync for Column {}

impl Column {
    /// Takes the values of an array of NumPy, or of anything that NumPy makes one of.
    ///
    /// # Errors
    /// `TypeError` and `ValueError` for values that are no whole numbers, or not in one dimension.
    pub fn new(values: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
        let py = values.py();
        let numpy = py.import("numpy")?;
        refuse_mask(values, name)?;
        let array = numpy.getattr("asarray")?.call1((values,))?;
        let mut array = array.cast_into::<PyUntypedArray>()?;
        if array.ndim() != 1 {
            return Err(PyValueError::new_err(format!(
                "{name} has {} dimensions: it must have one",
                array.ndim()
            )));
        }
        if array.dtype().byteorder() == b'>' {
            let native = array.dtype().call_method1("newbyteorder", ("=",))?;
            array = array
                .call_method1("astype", (native,))?
                .cast_into::<PyUntypedArray>()?;
        }
        // Durations of microseconds: those of a table of evlib, for one.
        let is_time = name.starts_with('t');
        if is_time && array.dtype().to_string() == "timedelta64[us]" {
            array = array
                .call_method1("view", ("i8",))?
                .cast_into::<PyUntypedArray>()?;
        }
        let dtype = array.dtype();
        let kind = match (dtype.kind(), dtype.itemsize()) {
            (b'b' | b'u', 1) => Kind::U8,
            (b'u', 2) => Kind::U16,
            (b'u', 4) => Kind::U32,
            (b'u', 8) => Kind::U64,
            (b'i', 1) => Kind::I8,
            (b'i', 2) => Kind::I16,
            (b'i', 4) => Kind::I32,
            (b'i', 8) => Kind::I64,
            _ => {
                refuse_missing(values, name)?;
                return Err(PyTypeError::new_err(format!(
                    "{name} is {dtype}: whole numbers are needed{}",
                    if is_time {
                        ", times in microseconds"
                    } else {
                        ""
                    }
                )));
            }
        };
        let length = array.len();
        // SAFETY: `array` is an array of NumPy, whose header has the address of its first value.
        #[allow(unsafe_code)]
        let start = unsafe { (*array.as_array_ptr()).fields.data }
            .cast::<u8>()
            .cast_const();
        Ok(Self {
            start,
            stride: array.strides().first().copied().unwrap_or(0),
            kind,
            length,
            _owner: array.into_any().unbind(),
        })
    }

    /// Returns value `at`, which is below `length`.
    pub fn get(&self, at: usize) -> i128 {
        debug_assert!(at < self.length);
        match self.kind {
            Kind::U8 => self.read::<u8>(at).into(),
            Kind::U16 => self.read::<u16>(at).into(),
            Kind::U32 => self.read::<u32>(at).into(),
            Kind::U64 => self.read::<u64>(at).into(),
            Kind::I8 => self.read::<i8>(at).into(),
            Kind::I16 => self.read::<i16>(at).into(),
            Kind::I32 => self.read::<i32>(at).into(),
            Kind::I64 => self.read::<i64>(at).into(),
        }
    }

    #[inline]
    pub fn read<T: Number>(&self, at: usize) -> T {
        let place = self.start.wrapping_offset(at as isize * self.stride);
        // SAFETY: `at` is below the array's length, so that the value lies inside its memory, which `_owner` keeps. Any
        // bytes are a number, and it need not be aligned.
        #[allow(unsafe_code)]
        unsafe {
            place.cast::<T>().read_unaligned()
        }
    }
}

/// Refuses an array with a mask: what it hides would count.
pub fn refuse_mask(values: &Bound<'_, PyAny>, name: &str) -> PyResult<()> {
    let ma = values.py().import("numpy.ma")?;
    if ma.call_method1("isMaskedArray", (values,))?.extract()? {
        return Err(PyTypeError::new_err(format!(
            "{name} is a masked array: give {name}.compressed(), without what is masked"
        )));
    }
    Ok(())
}

/// Refuses a column of pandas, Polars or pyarrow in which values are missing: as numbers they would be something else.
fn refuse_missing(values: &Bound<'_, PyAny>, name: &str) -> PyResult<()> {
    for count in ["null_count", "hasnans"] {
        let Some(count) = values.getattr_opt(count)? else {
            continue;
        };
        let count = if count.is_callable() {
            count.call0()?
        } else {
            count
        };
        if count.is_truthy()? {
            return Err(PyValueError::new_err(format!(
                "{name} has missing values: leave these rows out"
            )));
        }
    }
    Ok(())
}

/// Numbers of which any bytes are one.
pub trait Number: Copy {}
impl Number for u8 {}
impl Number for u16 {}
impl Number for u32 {}
impl Number for u64 {}
impl Number for i8 {}
impl Number for i16 {}
impl Number for i32 {}
impl Number for i64 {}
