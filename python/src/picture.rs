//! Pictures of events.

use event_pictures::frame_picture::{FrameStyle, FrameSums, event_frame};
use event_types::stream::EventReader;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::exception;
use crate::given::{self, Size, raise};
use crate::number;
use crate::work::{Interruptible, Raised};

/// A picture, which notebooks show.
#[pyclass(module = "eecvs", frozen)]
pub struct Picture {
    picture: event_pictures::picture::Picture,
}

/// Draws events: ON is blue, OFF orange; the more events of one polarity outweigh the other, the darker.
///
/// Args:
///     events: A structured array, a dictionary of columns, Columns, a Window, a Recording, or an iterable of arrays.
///     sensor: (width, height) in pixels; a Recording, Columns and a Window have their own.
///     clip: Sum of polarities that gets the darkest colour, 1 or more.
///     upscale: Side in pixels of the square that shows a pixel, 1 to 64, as far as no side of the picture exceeds 4,096; by
///         default the smallest that makes the longer side at least 480.
///
/// Returns:
///     A Picture: ``picture.png()`` is a file in memory, ``picture.save(path)`` writes one.
///
/// Raises:
///     RefusedError: An event outside of the sensor.
#[pyfunction]
#[pyo3(signature = (events, *, sensor=None, clip=4, upscale=None))]
pub fn picture(
    events: &Bound<'_, PyAny>,
    sensor: Option<Size>,
    #[pyo3(from_py_with = number::clip)] clip: u32,
    #[pyo3(from_py_with = number::upscale)] upscale: Option<usize>,
) -> PyResult<Picture> {
    let py = events.py();
    let raised = Raised::default();
    let sensor = Size::of(sensor);
    let reader = given::reader(events, sensor, &raised)?;
    let drawn = py.detach(|| {
        let mut reader = Interruptible::new(reader, &raised);
        let sensor = reader.sensor();
        let mut style = FrameStyle::for_sensor(sensor);
        style.clip = clip;
        style.upscale = upscale.unwrap_or(style.upscale);
        let mut sums = FrameSums::empty(sensor);
        let mut batch = Vec::new();
        while reader.read(&mut batch)? > 0 {
            for event in &batch {
                sums.add(event);
            }
            batch.clear();
        }
        Ok(event_frame(&sums, style))
    });
    let picture = drawn.map_err(|error| raise(py, &raised, &error, None))?;
    Ok(Picture { picture })
}

#[pymethods]
impl Picture {
    /// Width and height in pixels.
    #[getter]
    fn size(&self) -> (usize, usize) {
        (self.picture.width(), self.picture.height())
    }

    /// Returns the picture as a PNG file.
    fn png<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let png = py.detach(|| self.picture.png());
        let png = png.map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok(PyBytes::new(py, &png))
    }

    /// Writes the picture as a PNG file.
    ///
    /// Args:
    ///     path: The file.
    ///     overwrite: Replaces a file of that name.
    ///
    /// Raises:
    ///     RefusedError: A file of that name is there, or no such folder.
    ///     FileError: The file cannot be written.
    #[pyo3(signature = (path, *, overwrite=false))]
    // A path of Python is taken over.
    #[allow(clippy::needless_pass_by_value)]
    fn save(&self, py: Python<'_>, path: std::path::PathBuf, overwrite: bool) -> PyResult<()> {
        let name = path.display().to_string();
        let png = self.png(py)?;
        let png = png.as_bytes();
        let saved = py.detach(|| {
            use std::io::Write;
            event_files::output::check(&path, event_files::output::Kind::Picture, overwrite, &[])?;
            let mut out = event_files::output::OutputFile::create(&path)?;
            out.write_all(png)?;
            out.finish()
        });
        saved.map_err(|error| exception(py, &error, Some(&name)))
    }

    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.png(py)
    }

    fn __repr__(&self) -> String {
        let (width, height) = self.size();
        format!("<Picture: {width} x {height}>")
    }
}
