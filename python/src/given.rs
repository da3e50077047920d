//! Events that a caller gives: structured arrays of any known field names, columns, recordings, and iterators of these.

use eecvs::representation::check_places;
use event_types::stream::{BATCH_EVENTS, Error, EventReader, Result, Skipped};
use event_types::{Event, Polarity, Sensor, error};
use numpy::{PyArrayDescrMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyIterator, PyList, PyString, PyTuple};

use crate::columns::Columns;
use crate::recording::{Recording, Slices};
use crate::window::Window;
use crate::work::Raised;

/// Names of an event's fields in the arrays of others.
const NAMES: [&[&str]; 4] = [
    &["t", "ts", "timestamp", "time", "t_us"],
    &["x"],
    &["y"],
    &["p", "on", "polarity", "pol"],
];

/// Type of a column's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
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
    const fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 => 4,
            Self::U64 | Self::I64 => 8,
        }
    }
}

/// One column of a table: values at equal distances in memory of Python.
struct Column {
    start: *const u8,
    stride: isize,
    kind: Kind,
    length: usize,
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
    fn new(values: &Bound<'_, PyAny>, name: &str) -> PyResult<Self> {
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
                return Err(PyTypeError::new_err(format!(
                    "{name} is {dtype}: whole numbers are needed{}",
                    if name.starts_with('t') {
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
    fn get(&self, at: usize) -> i128 {
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
    fn read<T: Number>(&self, at: usize) -> T {
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
fn refuse_mask(values: &Bound<'_, PyAny>, name: &str) -> PyResult<()> {
    let ma = values.py().import("numpy.ma")?;
    if ma.call_method1("isMaskedArray", (values,))?.extract()? {
        return Err(PyTypeError::new_err(format!(
            "{name} is a masked array: give {name}.compressed(), without what is masked"
        )));
    }
    Ok(())
}

/// Numbers of which any bytes are one.
trait Number: Copy {}
impl Number for u8 {}
impl Number for u16 {}
impl Number for u32 {}
impl Number for u64 {}
impl Number for i8 {}
impl Number for i16 {}
impl Number for i32 {}
impl Number for i64 {}

/// Events in four columns of Python's memory.
pub struct Table {
    /// t, x, y, p.
    columns: [Column; 4],
    length: usize,
    has_minus: bool,
    has_zero: bool,
}

impl Table {
    fn new(columns: [Column; 4]) -> PyResult<Self> {
        let length = columns[0].length;
        if columns.iter().any(|column| column.length != length) {
            let lengths = columns.each_ref().map(|column| column.length);
            return Err(PyValueError::new_err(format!(
                "the columns t, x, y, p have {lengths:?} values: they must have equally many"
            )));
        }
        Ok(Self {
            columns,
            length,
            has_minus: false,
            has_zero: false,
        })
    }

    /// Takes events of a structured array, of a dictionary or of [`Columns`].
    ///
    /// # Errors
    /// `TypeError` and `ValueError` for anything else.
    pub fn of(events: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(window) = events.cast::<Window>() {
            return Self::of(&window.get().events(events.py())?);
        }
        if let Ok(columns) = events.cast::<Columns>() {
            let columns = columns.get().arrays(events.py());
            let [t, x, y, p] = columns;
            return Self::new([
                Column::new(t.bind(events.py()), "t")?,
                Column::new(x.bind(events.py()), "x")?,
                Column::new(y.bind(events.py()), "y")?,
                Column::new(p.bind(events.py()), "p")?,
            ]);
        }
        let names: Vec<String> = if let Ok(dictionary) = events.cast::<PyDict>() {
            dictionary.keys().extract()?
        } else {
            refuse_mask(events, "events")?;
            let dtype = events.getattr("dtype").ok();
            let names = dtype.and_then(|dtype| dtype.getattr("names").ok());
            names.and_then(|names| names.extract().ok()).ok_or_else(|| {
                let kind = events.get_type();
                PyTypeError::new_err(format!(
                    "events are a {kind}: a structured array with fields t, x, y, p or a dictionary of such columns is needed"
                ))
            })?
        };
        let column = |of: usize| {
            let found = NAMES[of]
                .iter()
                .find(|name| names.iter().any(|n| n == *name));
            let name = found.ok_or_else(|| {
                PyValueError::new_err(format!(
                    "events have the fields {}: none is called {}",
                    names.join(", "),
                    NAMES[of].join(" or ")
                ))
            })?;
            Column::new(&events.get_item(*name)?, name)
        };
        Self::new([column(0)?, column(1)?, column(2)?, column(3)?])
    }

    /// Returns the addresses of the columns' memory, from the first byte to behind the last.
    pub fn places(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        let columns = self.columns.iter().filter(|column| column.length > 0);
        columns.map(|column| {
            let first = column.start.addr();
            let last = first.wrapping_add_signed(column.stride * (column.length - 1) as isize);
            first.min(last)..first.max(last) + column.kind.bytes()
        })
    }

    /// Returns the number of events.
    pub const fn len(&self) -> usize {
        self.length
    }

    /// Returns the first time, or the last one; `None` without events.
    pub fn time(&self, last: bool) -> Option<u64> {
        let at = if last { self.length.checked_sub(1)? } else { 0 };
        (at < self.length).then(|| u64::try_from(self.columns[0].get(at)).ok())?
    }

    /// Appends the events from number `from` on, at most `most` of them; returns their number.
    ///
    /// # Errors
    /// A number that no event has.
    pub fn read(&mut self, from: usize, most: usize, events: &mut Vec<Event>) -> Result<usize> {
        let to = self.length.min(from.saturating_add(most));
        let before = events.len();
        let kinds = self.columns.each_ref().map(|column| column.kind);
        let is_common = matches!(kinds[0], Kind::I64 | Kind::U64)
            && matches!(kinds[1], Kind::U16 | Kind::I16)
            && matches!(kinds[2], Kind::U16 | Kind::I16)
            && matches!(kinds[3], Kind::U8);
        if is_common && self.read_common(from..to, events) {
            return Ok(events.len() - before);
        }
        events.truncate(before);
        for at in from..to {
            events.push(self.event(at)?);
        }
        Ok(events.len() - before)
    }

    /// Appends the events of a range, of the types that most arrays have; returns whether all are events.
    fn read_common(&mut self, range: std::ops::Range<usize>, events: &mut Vec<Event>) -> bool {
        let [t, x, y, p] = &self.columns;
        let mut wrong = false;
        events.extend(range.map(|at| {
            let (t_us, x, y, p) = (
                t.read::<u64>(at),
                x.read::<u16>(at),
                y.read::<u16>(at),
                p.read::<u8>(at),
            );
            wrong |= t_us >> 63 != 0 || (x | y) >= Sensor::SIDE_MAX || p > 1;
            Event {
                t_us,
                x,
                y,
                polarity: Polarity::from_bool(p != 0),
            }
        }));
        !wrong
    }

    /// Returns event `at`, with every number checked.
    fn event(&mut self, at: usize) -> Result<Event> {
        let [t, x, y, p] = self.columns.each_ref().map(|column| column.get(at));
        let t_us = i64::try_from(t).ok().and_then(|t| u64::try_from(t).ok());
        let t_us = t_us.ok_or_else(|| {
            error!(
                Refused,
                "event {at}: the time {t} us is below 0 or above 2^63"
            )
        })?;
        let side = |value: i128, name: &str| {
            let value_fits = u16::try_from(value).ok();
            value_fits
                .filter(|value| *value < Sensor::SIDE_MAX)
                .ok_or_else(|| {
                    let most = Sensor::SIDE_MAX - 1;
                    error!(
                        Refused,
                        "event {at}: {name} is {value}: it must be 0 to {most}"
                    )
                })
        };
        let polarity = match p {
            1 => Polarity::On,
            0 | -1 => Polarity::Off,
            _ => {
                return Err(error!(
                    Refused,
                    "event {at}: the polarity is {p}: it must be 0 or 1, or -1 or 1"
                ));
            }
        };
        self.has_zero |= p == 0;
        self.has_minus |= p == -1;
        if self.has_zero && self.has_minus {
            return Err(error!(
                Refused,
                "event {at}: the polarities are -1 and 0: only one of them can be OFF"
            ));
        }
        Ok(Event {
            t_us,
            x: side(x, "x")?,
            y: side(y, "y")?,
            polarity,
        })
    }
}

/// A reader of a table's events.
pub struct TableReader {
    table: Table,
    next: usize,
    sensor: Sensor,
    skipped: Skipped,
}

impl TableReader {
    /// Creates a reader of events of a sensor.
    pub fn new(table: Table, sensor: Sensor) -> Self {
        Self {
            table,
            next: 0,
            sensor,
            skipped: Skipped::default(),
        }
    }
}

impl EventReader for TableReader {
    fn format(&self) -> &'static str {
        "array"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let before = events.len();
        let read = self.table.read(self.next, BATCH_EVENTS, events)?;
        let new = events.get(before..).unwrap_or_default();
        check_places(self.sensor, new, self.next as u64)?;
        self.next += read;
        Ok(read)
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

/// A reader of the arrays that an iterator of Python gives.
struct IteratorReader {
    iterator: Py<PyIterator>,
    table: Option<TableReader>,
    sensor: Sensor,
    raised: Raised,
    skipped: Skipped,
}

impl EventReader for IteratorReader {
    fn format(&self) -> &'static str {
        "arrays"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        loop {
            if let Some(table) = &mut self.table {
                let read = table.read(events)?;
                if read > 0 {
                    return Ok(read);
                }
            }
            let next = Python::attach(|py| {
                let next = self.iterator.bind(py).clone().next().transpose()?;
                next.map(|events| Table::of(&events)).transpose()
            });
            let Some(table) = next.map_err(|raised| self.raised.keep(raised))? else {
                return Ok(0);
            };
            self.table = Some(TableReader::new(table, self.sensor));
        }
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

/// Returns a reader of whatever a caller gave: a recording, an array, columns, a window, or an iterable of arrays.
///
/// # Errors
/// `TypeError`, `ValueError`; a recording that cannot be opened.
pub fn reader(
    events: &Bound<'_, PyAny>,
    sensor: Option<Sensor>,
    raised: &Raised,
) -> PyResult<Box<dyn EventReader>> {
    let py = events.py();
    if let Ok(recording) = events.cast::<Recording>() {
        return recording.get().reader(py);
    }
    let sensor = sensor.or_else(|| size_of_given(events)).ok_or_else(|| {
        PyValueError::new_err("sensor= is needed: arrays do not say how large theirs is")
    })?;
    if is_table(events)? || events.is_instance_of::<PyString>() {
        return Ok(Box::new(TableReader::new(Table::of(events)?, sensor)));
    }
    let iterator = events.try_iter().map_err(|_| {
        PyTypeError::new_err(format!(
            "events are a {}: a structured array, a dictionary of columns, a recording or an iterable of arrays is needed",
            events.get_type()
        ))
    })?;
    Ok(Box::new(IteratorReader {
        iterator: iterator.unbind(),
        table: None,
        sensor,
        raised: raised.clone(),
        skipped: Skipped::default(),
    }))
}

/// Returns the names of an event's fields in the arrays of others: of t, x, y and p.
#[pyfunction]
pub fn _names() -> [Vec<&'static str>; 4] {
    NAMES.map(<[_]>::to_vec)
}

/// Returns whether events can be read more than once: anything but an iterator.
///
/// # Errors
/// Those of looking at an object of Python.
pub fn can_be_read_again(events: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(events.is_instance_of::<Recording>() || is_table(events)?)
}

/// Returns whether an object has the columns of events.
fn is_table(events: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(events.is_instance_of::<PyDict>()
        || events.is_instance_of::<Window>()
        || events.is_instance_of::<Columns>()
        || events.hasattr("dtype")?)
}

/// Returns the size of the sensor that events come with: a window's, columns', a recording's, or that of the first of a list.
pub fn size_of_given(events: &Bound<'_, PyAny>) -> Option<Sensor> {
    if let Ok(window) = events.cast::<Window>() {
        return Some(window.get().size());
    }
    if let Ok(columns) = events.cast::<Columns>() {
        return columns.get().size();
    }
    if let Ok(recording) = events.cast::<Recording>() {
        return Some(recording.get().size());
    }
    if let Ok(slices) = events.cast::<Slices>() {
        return Some(slices.get().size());
    }
    let is_list = events.is_instance_of::<PyList>() || events.is_instance_of::<PyTuple>();
    let first = is_list.then(|| events.get_item(0).ok()).flatten()?;
    let is_one = first.is_instance_of::<Window>() || first.is_instance_of::<Columns>();
    is_one.then(|| size_of_given(&first)).flatten()
}

/// Returns whether the events before damage are to be taken: those of a recording that was opened so.
pub fn keeps_damaged(events: &Bound<'_, PyAny>) -> bool {
    let recording = events.cast::<Recording>();
    recording.is_ok_and(|recording| recording.get().keeps_damaged())
}

/// Returns the tables of a batch: those of a list or a tuple, or one. Also returns whether it is a batch.
///
/// # Errors
/// `TypeError`, `ValueError`.
pub fn tables(events: &Bound<'_, PyAny>) -> PyResult<(Vec<Table>, bool)> {
    if events.is_instance_of::<PyList>() || events.is_instance_of::<PyTuple>() {
        let tables: PyResult<Vec<_>> = events
            .try_iter()?
            .map(|events| Table::of(&events?))
            .collect();
        return Ok((tables?, true));
    }
    Ok((vec![Table::of(events)?], false))
}

/// A sensor as a caller states it: any sequence of width and height.
#[derive(Debug, Clone, Copy)]
pub struct Size(pub Sensor);

impl Size {
    /// Returns the size of these sides.
    ///
    /// # Errors
    /// `ValueError` for sides out of range.
    pub fn sides(width: i64, height: i64) -> PyResult<Self> {
        let side = |side: i64| u16::try_from(side).ok();
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
        let sides: Result<[i64; 2], _> = size.extract();
        let [width, height] = sides.map_err(|_| {
            let kind = size.get_type();
            PyTypeError::new_err(format!("sensor is a {kind}: it must be (width, height)"))
        })?;
        Self::sides(width, height)
    }
}

/// Raises what a library's error stands for: the exception that ended the work, or its own.
pub fn raise(py: Python<'_>, raised: &Raised, error: &Error, file: Option<&str>) -> PyErr {
    raised
        .take()
        .unwrap_or_else(|| crate::errors::exception(py, error, file))
}
