//! Chunks of events in others' containers, packed as `eecvs-hdf5` packs them.

use eecvs_hdf5::Layout;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::window::bytes_of;

/// Packs the rows of a chunk, bit for bit and in their order.
#[pyfunction]
// A list of Python is taken over.
#[allow(clippy::needless_pass_by_value)]
pub fn _pack<'py>(
    py: Python<'py>,
    rows: &Bound<'py, PyAny>,
    values: Vec<u32>,
) -> PyResult<Bound<'py, PyBytes>> {
    let layout = layout(&values)?;
    let rows = bytes_of(rows)?;
    let rows = rows.as_bytes();
    let packed = py.detach(|| eecvs_hdf5::pack(rows, &layout));
    Ok(PyBytes::new(py, &packed.map_err(refused)?))
}

/// Unpacks the rows of a chunk, of at most `bytes_max` bytes.
#[pyfunction]
// A list of Python is taken over.
#[allow(clippy::needless_pass_by_value)]
pub fn _unpack<'py>(
    py: Python<'py>,
    packed: &Bound<'py, PyAny>,
    values: Vec<u32>,
    bytes_max: usize,
) -> PyResult<Bound<'py, PyBytes>> {
    let layout = layout(&values)?;
    let packed = bytes_of(packed)?;
    let packed = packed.as_bytes();
    let rows = py.detach(|| eecvs_hdf5::unpack(packed, &layout, bytes_max));
    let rows = rows.map_err(|error| match error {
        eecvs_hdf5::Error::Damaged => {
            let error = event_types::error!(Damaged, "{error}");
            crate::errors::exception(py, &error, None)
        }
        other => refused(other),
    })?;
    Ok(PyBytes::new(py, &rows))
}

fn layout(values: &[u32]) -> PyResult<Layout> {
    Layout::from_values(values).map_err(refused)
}

fn refused(error: eecvs_hdf5::Error) -> PyErr {
    PyValueError::new_err(error.to_string())
}
