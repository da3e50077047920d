//! Writing of recordings in every format that has a writer.

use std::io::Write;
use std::path::PathBuf;

use event_files::convert::{Conversion, convert_reader};
use event_files::output::{Kind, OutputFile, check, is_dash};
use event_files::{FORMATS, Format};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::codec::{Given, encode_to};
use crate::errors::warn_of_loss;
use crate::given::{self, Size, raise};
use crate::options::Asked;
use crate::recording::absolute;
use crate::work::{Interruptible, Raised};

/// Ending of files of frames.
const FRAMES: &str = ".eecvs";

/// Writes events as a recording, in the format of the name's ending: .raw, .dat, .aedat4, .h5, .npz, .parquet, .eecvs, ...
///
/// The file gets its name when it is complete.
///
/// Args:
///     path: The file.
///     events: As for ``encode``; an iterable of arrays is written array by array.
///     sensor: (width, height) in pixels; a Recording has its own.
///     format: Name of the format, such as ``"evt2"``, in place of the ending's.
///     overwrite: Replaces a file of that name.
///     allow_loss: Leaves out or changes what the format cannot hold, with a warning and counts.
///     sort: Sorts the events by time first.
///     **options: Of ``encode``, for ``.eecvs``.
///
/// Returns:
///     Written: path, events_in, events_out, lost.
///
/// Raises:
///     RefusedError: A file of that name is there, or is the one that is read; an event that no sensor has.
///     CannotHoldError: The format cannot hold an event or the sensor.
///     UnsupportedError: No format has this ending.
#[pyfunction]
#[pyo3(signature = (
    path, events, *, sensor=None, format=None, overwrite=false, allow_loss=false, sort=false, **options
))]
// A path of Python is taken over.
#[allow(clippy::too_many_arguments, clippy::needless_pass_by_value)]
pub fn write<'py>(
    py: Python<'py>,
    path: PathBuf,
    events: &Bound<'py, PyAny>,
    sensor: Option<Size>,
    format: Option<&str>,
    overwrite: bool,
    allow_loss: bool,
    sort: bool,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let name = path.display().to_string();
    let fail = |error: &event_files::Error| crate::errors::exception(py, error, Some(&name));
    if is_dash(&path) {
        return Err(PyValueError::new_err("path is -: give the name of a file"));
    }
    // Events that are computed may change the current folder.
    let path = absolute(path);
    let is_frames = format.map_or_else(
        || name.to_ascii_lowercase().ends_with(FRAMES),
        |format| format == "eecvs",
    );
    let kind = match (is_frames, format) {
        (true, _) => Kind::Frames,
        (false, None) => Kind::Recording,
        (false, Some(_)) => Kind::AnyRecording,
    };
    let input = events.cast::<crate::recording::Recording>().ok();
    let input = input.and_then(|recording| recording.get().file().map(ToOwned::to_owned));
    let inputs: Vec<_> = input.iter().map(PathBuf::as_path).collect();
    check(&path, kind, overwrite, &inputs).map_err(|error| fail(&error))?;
    let raised = Raised::default();
    let sensor = Size::of(sensor);
    let written = py.import("eecvs._types")?.getattr("Written")?;
    let lost = PyDict::new(py);
    if is_frames {
        let mut asked = Asked::of(options)?;
        asked.allow_loss |= allow_loss;
        asked.sort |= sort;
        let reader = Given {
            reader: given::reader(events, sensor, &raised)?,
            keeps_damaged: given::keeps_damaged(events),
        };
        let encoded = py.detach(|| {
            let out = OutputFile::create(&path)?;
            let (encoded, mut out) = encode_to(reader, &asked, &raised, out)?;
            out.flush()?;
            out.finish()?;
            Ok::<_, event_files::Error>(encoded)
        });
        let encoded = encoded.map_err(|error| raise(py, &raised, &error, Some(&name)))?;
        let summary = &encoded.summary;
        if summary.events_late > 0 {
            lost.set_item("events too late", summary.events_late)?;
        }
        encoded.tell(py)?;
        return written.call1((name, summary.events_in, summary.events_encoded, lost));
    }
    if let Some(options) = options.filter(|options| !options.is_empty()) {
        let names: Vec<String> = options.keys().extract()?;
        return Err(PyTypeError::new_err(format!(
            "{}: only .eecvs files have such options",
            names.join(", ")
        )));
    }
    let format = format.map(format_named).transpose()?;
    let conversion = Conversion {
        allow_loss,
        sort,
        format,
        refuse_damage: !given::keeps_damaged(events),
        ..Conversion::default()
    };
    let reader = given::reader(events, sensor, &raised)?;
    let converted = py.detach(|| {
        let reader = Box::new(Interruptible::new(reader, &raised));
        convert_reader(reader, &path, &conversion)
    });
    let converted = converted.map_err(|error| raise(py, &raised, &error, Some(&name)))?;
    if let Some(damage) = &converted.damage {
        let place = converted.incomplete_output.as_ref().unwrap_or(&path);
        warn_of_loss(
            py,
            &format!("{damage}: everything before is in {}", place.display()),
        )?;
    }
    let counts = converted.lost;
    for (what, count) in [
        ("outside the format", counts.outside),
        ("beyond its times", counts.beyond_time),
        ("times raised", counts.raised),
        ("times shifted by, us", counts.shifted_us),
    ] {
        if count > 0 {
            lost.set_item(what, count)?;
        }
    }
    if !lost.is_empty() {
        warn_of_loss(py, &format!("{name}: lost or changed: {lost}"))?;
    }
    let place = converted.incomplete_output.as_ref();
    written.call1((
        place.map_or(name, |place| place.display().to_string()),
        converted.events_in,
        converted.events_out,
        lost,
    ))
}

fn format_named(name: &str) -> PyResult<&'static Format> {
    let found = FORMATS
        .iter()
        .find(|format| format.name == name && format.create.is_some());
    found.ok_or_else(|| {
        let names: Vec<&str> = FORMATS
            .iter()
            .filter(|format| format.create.is_some())
            .map(|format| format.name)
            .collect();
        PyValueError::new_err(format!(
            "format is {name:?}: it must be one of {}",
            names.join(", ")
        ))
    })
}
