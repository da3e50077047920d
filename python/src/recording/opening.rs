//! How recordings of files are opened, and opened again where they are unpickled.

use std::path::PathBuf;

use event_files::output::is_dash;
use event_files::{BadEvents, Columns as Places, Reading, TimeUnit};
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::stamp::Stamp;
use super::{Origin, Recording, Source};
use crate::given::Size;
use crate::layout::Layout;
use crate::number;

/// Opens a recording of any format that is known; the format is recognised by the content.
///
/// Args:
///     path: A file or a folder of a recording. A place inside it may follow: ``FILE.hdf5/davis/right/events``.
///     dtype: Layout of the arrays: ``"eecvs"`` (t int64, x uint16, y uint16, p bool), ``"tonic"``, ``"faery"``,
///         ``"expelliarmus"``, ``"metavision"`` or ``"dv"``: theirs, field for field.
///     width, height: Size of the sensor in pixels, for files that do not state it.
///     time_unit: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``, for tables that do not state it.
///     time_offset_us: Microseconds added to every time.
///     columns: Columns of a table, as ``"xytp"`` or ``"t=time,x=col,y=row,p=on"``.
///     leave_out_bad_events: Leaves out and counts invalid events in place of raising.
///     sort: Sorts all events by time first; events of equal time keep their order.
///     damaged: ``"raise"``, or ``"keep"``: everything before the damage, with a warning and ``.damage``.
///     max_events_per_window, max_work_per_window: Limits of ``.eecvs`` files, as in the command.
///
/// Returns:
///     A Recording.
///
/// Raises:
///     MissingFileError: There is no such file.
///     UnsupportedError: The format is not known.
///     UndecidedError: The file leaves something open, which the message names.
///     DamagedError: The header is damaged.
#[pyfunction]
#[pyo3(signature = (
    path, *, dtype=None, width=None, height=None, time_unit=None, time_offset_us=0, columns=None,
    leave_out_bad_events=false, sort=false, damaged="raise", max_events_per_window=None, max_work_per_window=None
))]
#[allow(clippy::too_many_arguments)]
pub fn open(
    py: Python<'_>,
    path: PathBuf,
    dtype: Option<&str>,
    #[pyo3(from_py_with = number::width)] width: Option<u16>,
    #[pyo3(from_py_with = number::height)] height: Option<u16>,
    time_unit: Option<&str>,
    #[pyo3(from_py_with = number::time_offset_us)] time_offset_us: i64,
    columns: Option<&str>,
    leave_out_bad_events: bool,
    sort: bool,
    damaged: &str,
    #[pyo3(from_py_with = number::max_events_per_window)] max_events_per_window: Option<u32>,
    #[pyo3(from_py_with = number::max_work_per_window)] max_work_per_window: Option<u32>,
) -> PyResult<Recording> {
    let size = match (width, height) {
        (None, None) => None,
        (Some(width), Some(height)) => Some(Size::sides(width.into(), height.into())?.0),
        _ => {
            return Err(PyValueError::new_err(
                "width= and height= are needed together",
            ));
        }
    };
    let reading = Reading {
        size,
        time_unit: time_unit.map(unit).transpose()?,
        time_offset_us,
        columns: columns
            .map(|text| {
                Places::parse(text).map_err(|why| PyValueError::new_err(format!("columns: {why}")))
            })
            .transpose()?,
        bad_events: if leave_out_bad_events {
            BadEvents::LeaveOut
        } else {
            BadEvents::Refuse
        },
        window_events_max: max_events_per_window,
        window_work_max: max_work_per_window,
    };
    let keeps_damaged = match damaged {
        "raise" => false,
        "keep" => true,
        _ => {
            return Err(PyValueError::new_err(format!(
                "damaged is {damaged:?}: it must be \"raise\" or \"keep\""
            )));
        }
    };
    let options = PyDict::new(py);
    options.set_item("dtype", dtype)?;
    options.set_item("width", width)?;
    options.set_item("height", height)?;
    options.set_item("time_unit", time_unit)?;
    options.set_item("time_offset_us", time_offset_us)?;
    options.set_item("columns", columns)?;
    options.set_item("leave_out_bad_events", leave_out_bad_events)?;
    options.set_item("sort", sort)?;
    options.set_item("damaged", damaged)?;
    options.set_item("max_events_per_window", max_events_per_window)?;
    options.set_item("max_work_per_window", max_work_per_window)?;
    let path = absolute(path);
    let reopen = Reopen::new("open", &path, options)?;
    let source = Source {
        name: path.display().to_string(),
        stamp: py.detach(|| Stamp::of(event_files::file_of(&path))),
        origin: Origin::File { path, reading },
        sort,
        layout: Layout::of(dtype)?,
        keeps_damaged,
    };
    Recording::open(py, source, reopen)
}

/// Returns a path that leads to the same file whatever the current folder will be; that of stdin as it is.
pub fn absolute(path: PathBuf) -> PathBuf {
    if is_dash(&path) {
        return path;
    }
    // Of an empty path, which opening refuses.
    std::path::absolute(&path).unwrap_or(path)
}

fn unit(name: &str) -> PyResult<TimeUnit> {
    let units = [TimeUnit::S, TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];
    let found = units.into_iter().find(|unit| unit.name() == name);
    found.ok_or_else(|| {
        PyValueError::new_err(format!("time_unit is {name:?}: it must be s, ms, us or ns"))
    })
}

/// The call that made a recording, for where it is unpickled.
pub struct Reopen {
    pub(super) function: &'static str,
    pub(super) of: Py<PyAny>,
    pub(super) options: Py<PyDict>,
}

impl Reopen {
    /// Notes a call of a function of this module, with one argument and keywords.
    pub fn new<'py>(
        function: &'static str,
        of: impl IntoPyObject<'py>,
        options: Bound<'py, PyDict>,
    ) -> PyResult<Self> {
        let of = of.into_py_any(options.py())?;
        Ok(Self {
            function,
            of,
            options: options.unbind(),
        })
    }
}

/// Makes a recording as it was made where it was pickled.
#[pyfunction]
pub fn _reopen<'py>(
    function: &str,
    of: &Bound<'py, PyAny>,
    options: &Bound<'py, PyDict>,
) -> PyResult<Bound<'py, PyAny>> {
    if !["open", "emulate"].contains(&function) {
        return Err(PyValueError::new_err(format!(
            "{function} makes no recordings"
        )));
    }
    let function = of.py().import("eecvs._eecvs")?.getattr(function)?;
    function.call((of,), Some(options))
}
