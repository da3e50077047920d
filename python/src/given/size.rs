//! The size of a sensor as a caller states it.

use event_types::Sensor;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::number;

/// A sensor as a caller states it: any sequence of width and height.
#[derive(Debug, Clone, Copy)]
pub struct Size(pub Sensor);

impl Size {
    /// Returns the size of these sides.
    ///
    /// # Errors
    /// `ValueError` for sides out of range.
    pub fn sides(width: i128, height: i128) -> PyResult<Self> {
        let side = |side: i128| u16::try_from(side).ok();
        let sensor = side(width).zip(side(height));
        let sensor = sensor.and_then(|(width, height)| Sensor::new(width, height));
        sensor.map(Self).ok_or_else(|| {
            PyValueError::new_err(format!(
                "the sensor is {width} x {height}: each side must be 1 to {}",
                Sensor::SIDE_MAX
            ))
        })
    }

    /// Returns the sensor of a stated size, if there is one.
    pub fn of(size: Option<Self>) -> Option<Sensor> {
        size.map(|Self(sensor)| sensor)
    }
}

impl<'py> FromPyObject<'_, 'py> for Size {
    type Error = PyErr;

    fn extract(size: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let sides: Result<[Bound<'_, PyAny>; 2], _> = size.extract();
        let [width, height] = &sides.map_err(|_| {
            let kind = size.get_type();
            PyTypeError::new_err(format!("sensor is a {kind}: it must be (width, height)"))
        })?;
        let side = |side, name| number::named(side, name, i128::MIN..=i128::MAX);
        Self::sides(
            side(width, "the sensor's width")?,
            side(height, "the sensor's height")?,
        )
    }
}
