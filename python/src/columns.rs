//! Events as four columns, contiguous each, that NumPy, Arrow and torch take without a copy.

use event_types::stream::{Error, Result};
use event_types::{Event, Sensor, error};
use numpy::{PyArray1, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyCapsule, PyTuple};

use crate::arrow;
use crate::memory;
use crate::recording::sensor_object;

/// Columns that events are appended to.
#[derive(Default)]
pub struct Builder {
    t: Vec<i64>,
    x: Vec<u16>,
    y: Vec<u16>,
    p: Vec<bool>,
}

impl Builder {
    /// Makes room for about as many events: a guess.
    pub fn guess(&mut self, events: u64) {
        memory::guess(&mut self.t, events);
        memory::guess(&mut self.x, events);
        memory::guess(&mut self.y, events);
        memory::guess(&mut self.p, events);
    }

    /// Appends events.
    ///
    /// # Errors
    /// The system refuses the memory.
    pub fn extend(&mut self, events: &[Event]) -> Result<()> {
        let refused = |_| -> Error {
            error!(
                Refused,
                "the system refuses the memory for these events: read them in slices"
            )
        };
        let count = events.len();
        memory::room(&mut self.t, count).map_err(refused)?;
        memory::room(&mut self.x, count).map_err(refused)?;
        memory::room(&mut self.y, count).map_err(refused)?;
        memory::room(&mut self.p, count).map_err(refused)?;
        // Readers give no times of 2^63 us and more.
        self.t.extend(events.iter().map(|event| event.t_us as i64));
        self.x.extend(events.iter().map(|event| event.x));
        self.y.extend(events.iter().map(|event| event.y));
        self.p
            .extend(events.iter().map(|event| event.polarity.sign() > 0));
        Ok(())
    }

    /// Returns the columns of a sensor of that size.
    pub fn columns(mut self, py: Python<'_>, sensor: Option<Sensor>) -> Columns {
        self.t.shrink_to_fit();
        self.x.shrink_to_fit();
        self.y.shrink_to_fit();
        self.p.shrink_to_fit();
        Columns {
            t: PyArray1::from_vec(py, self.t).unbind(),
            x: PyArray1::from_vec(py, self.x).unbind(),
            y: PyArray1::from_vec(py, self.y).unbind(),
            p: PyArray1::from_vec(py, self.p).unbind(),
            sensor,
        }
    }
}

/// Events as four columns, each of them one contiguous array.
///
/// NumPy and torch (``torch.from_numpy``, DLPack) take the arrays as they are. Arrow's C data interface gives the columns
/// to pyarrow, Polars and pandas: ``polars.DataFrame(columns)``, ``pyarrow.record_batch(columns)``. Of these, t, x and y
/// are not copied; p becomes a column of booleans, of one bit each.
#[pyclass(module = "eecvs", frozen)]
pub struct Columns {
    /// Times in microseconds: int64, (N,).
    #[pyo3(get)]
    t: Py<PyArray1<i64>>,
    /// Columns of the pixels, from the left: uint16, (N,).
    #[pyo3(get)]
    x: Py<PyArray1<u16>>,
    /// Rows of the pixels, from the top: uint16, (N,).
    #[pyo3(get)]
    y: Py<PyArray1<u16>>,
    /// Polarities, True for ON: bool, (N,).
    #[pyo3(get)]
    p: Py<PyArray1<bool>>,
    sensor: Option<Sensor>,
}

impl Columns {
    /// Returns the columns t, x, y, p.
    pub fn arrays(&self, py: Python<'_>) -> [Py<PyAny>; 4] {
        [
            self.t.clone_ref(py).into_any(),
            self.x.clone_ref(py).into_any(),
            self.y.clone_ref(py).into_any(),
            self.p.clone_ref(py).into_any(),
        ]
    }

    /// Returns the sensor's size, if it is known.
    pub const fn size(&self) -> Option<Sensor> {
        self.sensor
    }
}

#[pymethods]
impl Columns {
    /// Size of the sensor, or None.
    #[getter]
    fn sensor<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.sensor
            .map(|sensor| sensor_object(py, sensor))
            .transpose()
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.t.bind(py).len()
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("Columns of {} events", self.__len__(py))
    }

    /// The type of the columns as a capsule ``arrow_schema``: a structure of t (int64), x, y (uint16), p (bool).
    fn __arrow_c_schema__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        arrow::schema(py)
    }

    /// The columns as capsules ``arrow_schema`` and ``arrow_array``; ``requested_schema`` is not followed, as the protocol
    /// allows.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_array__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        drop(requested_schema);
        let length = self.__len__(py);
        let bits = {
            let p = self.p.bind(py).try_readonly()?;
            let p = p.as_slice()?;
            p.chunks(8)
                .map(|eight| {
                    let bits = eight.iter().enumerate();
                    bits.fold(0_u8, |byte, (at, on)| byte | u8::from(*on) << at)
                })
                .collect::<Vec<u8>>()
        };
        let array = arrow::array(
            py,
            length,
            [
                (
                    self.t.clone_ref(py).into_any(),
                    self.t.bind(py).data().cast(),
                ),
                (
                    self.x.clone_ref(py).into_any(),
                    self.x.bind(py).data().cast(),
                ),
                (
                    self.y.clone_ref(py).into_any(),
                    self.y.bind(py).data().cast(),
                ),
            ],
            bits,
        )?;
        PyTuple::new(py, [arrow::schema(py)?.into_any(), array.into_any()])
    }
}
