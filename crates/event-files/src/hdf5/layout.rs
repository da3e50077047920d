//! Finds the events in an HDF5 file by the layouts of published data sets.

use event_types::stream::{Context, ErrorKind, Result};
use event_types::{Sensor, bail, error};
use hdf5_reader::{Dataset, Datatype, error::Error};

use super::file::{Hdf5, fields, join, number_type, plain, read_column, read_records, read_table};
use super::prophesee;
use crate::mat::Range;
use crate::numpy::npy_header::{Dtype, Number};
use crate::reading::{Columns, Reading, TimeUnit};
use crate::table::event_numbers::{
    P, Row, SAMPLE_ROWS, T, X, Y, column_order, find_names, given_names, names_taken, order_taken,
};
use crate::table::row_events::{Base, Extent, RowEvents, Scale, Times};
use crate::table::time_unit::SAMPLE_TIMES;
use crate::{Assumption, BATCH_EVENTS};

/// Places where events are looked for, in this order: tables and compounds, or groups of columns.
const PLACES: [&str; 8] = [
    "TD",
    "davis/left/events",
    "davis/right/events",
    "events",
    "CD/events",
    "prophesee/left",
    "prophesee/right",
    "",
];

/// Group of MVSEC's cameras, whose tables have the columns x, y, t, p.
const MVSEC: &str = "davis/";
const MVSEC_ORDER: [usize; 4] = [2, 0, 1, 3];

/// Place of DDD17's and DDD20's packets.
const DDD: &str = "dvs/data";

/// Sensor of MVSEC's cameras, mDAVIS-346B, which the files do not state.
const MVSEC_SENSOR: Sensor = Sensor {
    width: 346,
    height: 260,
};

/// Largest number of dataset bytes for each byte of the file: deflate expands by at most 1,032.
const EXPANSION_MAX: u64 = 1100;

/// The datasets that hold the events.
enum Source {
    /// t, x, y and p, each in a dataset of its own.
    Columns(Box<[Dataset; 4]>),
    /// A table of shape (N, columns), or turned: its number of columns and whether it is turned, and the columns
    /// that hold t, x, y and p.
    Table(Box<Dataset>, (usize, bool), [usize; 4]),
    /// Compounds with fields of the usual names, or of those that the caller gave.
    Records(Box<Dataset>, Option<Box<[String; 4]>>),
    /// snnTorch's layout: the times, and x, y, p of shape (N, 3).
    Addresses(Box<[Dataset; 2]>),
}

/// The place and the meaning of the events' numbers.
pub struct Plan {
    source: Source,
    /// Number of events.
    pub events: u64,
    /// The dataset or group that holds them.
    pub place: String,
    /// Unit, type and offset of the times.
    pub times: Times,
    /// How the columns were found, if that may be wrong.
    pub assumption: Option<Assumption>,
    /// DSEC's `ms_to_idx`: for each millisecond after the offset, the index of the first event at or after it.
    milliseconds: Option<Box<Dataset>>,
    /// Sensor of the data set's cameras, if known.
    pub sensor: Option<Sensor>,
    /// Number of datasets that are read.
    pub used: usize,
}

impl Plan {
    /// Finds the events: at `place` if the user named one, otherwise at the first of [`PLACES`] that holds events;
    /// `reading.size` helps to tell the columns of a table apart.
    pub fn find(file: &Hdf5, place: Option<&str>, reading: &Reading) -> Result<Self> {
        if let Some(place) = place {
            let plan = match Self::at(file, place, reading)? {
                None => Self::at(file, &join(place, "events"), reading)?,
                found => found,
            };
            return plan.with_context(|| {
                let (name, found) = (file.name(), file.describe());
                format!("{name}: byte 0: no events at {place}; the file has {found}")
            });
        }
        for place in PLACES {
            if let Some(plan) = Self::at(file, place, reading)? {
                return Ok(plan);
            }
        }
        if file.dataset(DDD)?.is_some() {
            bail!(
                Unsupported,
                "{}: byte 0: raw packets of a DAVIS camera at {DDD}, as in DDD17 and DDD20, which \
                 are not supported: write columns t, x, y, p with the data set's own tools \
                 (ddd20-utils)",
                file.name()
            );
        }
        bail!(
            Damaged,
            "{}: byte 0: no events at davis/left/events, no events/x, y, t, p, no table or \
             compound events; the file has {}: name the dataset or group after the file's name, as \
             in {0}/GROUP/DATASET",
            file.name(),
            file.describe()
        )
    }

    /// Returns the events at `place`; `None` if there are none.
    fn at(file: &Hdf5, place: &str, reading: &Reading) -> Result<Option<Self>> {
        let dataset = if place.is_empty() {
            None
        } else {
            file.dataset(place)?
        };
        let found = match dataset {
            None => match columns(file, place, reading)? {
                None => addresses(file, place)?,
                found => found,
            },
            Some(dataset) => Some(Self::whole(file, place, dataset, reading)?),
        };
        let Some(Found {
            source,
            unit,
            assumption,
        }) = found
        else {
            return Ok(None);
        };
        let (events, used) = match &source {
            Source::Columns(columns) => (columns.iter().map(count).max().unwrap_or(0), 4),
            Source::Table(dataset, (_, true), _) => {
                (dataset.shape().get(1).copied().unwrap_or(0), 1)
            }
            Source::Table(dataset, ..) => (dataset.shape().first().copied().unwrap_or(0), 1),
            Source::Records(dataset, _) => (count(dataset), 1),
            Source::Addresses(both) => (both.first().map_or(0, count), 2),
        };
        let mut plan = Self {
            source,
            events,
            place: place.to_owned(),
            times: Times::default(),
            assumption,
            milliseconds: None,
            sensor: place.starts_with(MVSEC).then_some(MVSEC_SENSOR),
            used,
        };
        plan.check_size(file)?;
        plan.times = Times::of(plan.time_type());
        plan.times.scale = plan.stated_unit(file).or(unit).map(Scale::from);
        plan.add_offset(file)?;
        Ok(Some(plan))
    }

    /// Finds the events of a dataset that is a table or holds compounds.
    fn whole(file: &Hdf5, place: &str, dataset: Dataset, reading: &Reading) -> Result<Found> {
        let given = given_names(reading);
        if let Datatype::Compound { .. } = dataset.dtype() {
            let by_places = matches!(reading.columns, Some(Columns::Places { .. }));
            let known =
                fields(dataset.dtype(), given).filter(|_| dataset.shape().len() == 1 && !by_places);
            let Some((_, unit)) = known else {
                let what = "the compound must have one dimension and numeric fields t, x, y, p, or \
                            those that --columns t=NAME,x=NAME,y=NAME,p=NAME names";
                return Err(file.error(&dataset, what));
            };
            return Ok(Found {
                source: Source::Records(Box::new(dataset), given.cloned().map(Box::new)),
                unit,
                assumption: None,
            });
        }
        if given.is_some() {
            let what = "the columns have no names: give --columns txyp, in their order";
            return Err(file.error(&dataset, what).of_kind(ErrorKind::Undecided));
        }
        let wanted = match &reading.columns {
            Some(Columns::Places { columns, .. }) => *columns,
            _ => 4,
        };
        // MATLAB's matrices are transposed in the file; one of 4 x 4 is too.
        let turned = |[a, b]: [u64; 2]| {
            let wanted = wanted as u64;
            if a == wanted && (b != wanted || file.is_matlab()) {
                Some((b, true))
            } else {
                (b == wanted).then_some((a, false))
            }
        };
        let sides = dataset
            .shape()
            .first_chunk::<2>()
            .filter(|_| dataset.shape().len() == 2);
        let shape = sides.and_then(|sides| turned(*sides));
        let (Some((events, is_turned)), Some(_)) = (shape, number_type(dataset.dtype())) else {
            let what = format!(
                "the events must be numbers of shape (N, {wanted}) or ({wanted}, N), or compounds \
                 t, x, y, p: see --columns"
            );
            return Err(file.error(&dataset, what).of_kind(ErrorKind::Undecided));
        };
        let shape = (wanted, is_turned);
        let table = |dataset: Dataset, order, assumption| Found {
            source: Source::Table(Box::new(dataset), shape, order),
            unit: None,
            assumption,
        };
        if let Some(Columns::Places { places, .. }) = &reading.columns {
            return Ok(table(dataset, *places, None));
        }
        if place.starts_with(MVSEC) {
            return Ok(table(dataset, MVSEC_ORDER, None));
        }
        let sample = before_damage(events.min(SAMPLE_ROWS as u64), |count| {
            read_table(&dataset, 0, count, shape, [0, 1, 2, 3])
        })
        .map_err(|error| file.error(&dataset, plain(&error)))?;
        let order = if sample.is_empty() {
            Some(MVSEC_ORDER)
        } else {
            column_order(&sample, reading.size)
        };
        let what = "the order of the four columns is unclear: give --columns txyp, in their order";
        let order =
            order.ok_or_else(|| file.error(&dataset, what).of_kind(ErrorKind::Undecided))?;
        let taken = (!sample.is_empty()).then(|| order_taken(order));
        Ok(table(dataset, order, taken))
    }

    /// Returns an error if the file is too short for a dataset: one without data would be read as zeros.
    fn check_size(&self, file: &Hdf5) -> Result<()> {
        let most = file.length().saturating_mul(EXPANSION_MAX);
        for dataset in self.datasets() {
            let bytes = hdf5_reader::dtype_element_size(dataset.dtype()).unwrap_or(0) as u64;
            let sides = dataset.shape().iter();
            let mut sides = sides;
            let all = sides.try_fold(bytes, |all, side| all.checked_mul(*side));
            if all.is_none_or(|all| all > most) {
                let what = format!("{} events are more than the file can hold", self.events);
                return Err(file.error(dataset, what));
            }
        }
        Ok(())
    }

    /// Returns the datasets that are read, t first if there are several.
    /// Returns the datasets that hold the events.
    pub fn datasets(&self) -> &[Dataset] {
        match &self.source {
            Source::Columns(columns) => columns.as_slice(),
            Source::Addresses(both) => both.as_slice(),
            Source::Table(dataset, ..) | Source::Records(dataset, _) => {
                std::slice::from_ref(dataset)
            }
        }
    }

    /// Returns the dataset that holds t, x, y or p, for messages.
    pub fn dataset(&self, which: usize) -> Option<&Dataset> {
        let all = self.datasets();
        all.get(which).or(all.first())
    }

    /// Returns the dataset if the events are Prophesee's compounds.
    pub fn compounds(&self) -> Option<&Dataset> {
        match &self.source {
            Source::Records(dataset, given)
                if given.is_none() && prophesee::is_known(dataset.dtype()) =>
            {
                Some(dataset)
            }
            _ => None,
        }
    }

    /// Returns the type of the times.
    fn time_type(&self) -> Option<Dtype> {
        match &self.source {
            Source::Records(dataset, given) => {
                let (fields, _) = fields(dataset.dtype(), given.as_deref())?;
                let [(_, time), ..] = fields;
                Some(time)
            }
            _ => number_type(self.datasets().first()?.dtype()),
        }
    }

    /// Returns the unit that an attribute states: of the times, of the events' dataset or group, or of the root.
    fn stated_unit(&self, file: &Hdf5) -> Option<TimeUnit> {
        let mut paths = Vec::new();
        if let (Source::Columns(_) | Source::Addresses(_), Some(t)) =
            (&self.source, self.dataset(T))
        {
            let name = t.name().trim_matches('/');
            let last = name.rsplit('/').next().unwrap_or(name);
            paths.push(join(&self.place, last));
        }
        paths.push(self.place.clone());
        paths.push(String::new());
        let paths: Vec<&str> = paths.iter().map(String::as_str).collect();
        file.stated_unit(&paths)
    }

    /// Returns the first rows, or those before the first damage.
    ///
    /// # Errors
    /// The first row is damaged.
    pub fn sample(&self, file: &Hdf5) -> Result<Vec<Row>> {
        let count = self.events.min(SAMPLE_TIMES as u64);
        self.read_whole(0, count)
            .map_err(|error| self.error(file, 0, &error))
    }

    /// Adds DSEC's `t_offset`, in us, and index, if the times are integers in a column.
    fn add_offset(&mut self, file: &Hdf5) -> Result<()> {
        let (Source::Columns(_), false) = (&self.source, self.times.is_float) else {
            return Ok(());
        };
        self.milliseconds = index(file);
        self.used += usize::from(self.milliseconds.is_some());
        let Some(offset) = file.dataset("t_offset")? else {
            return Ok(());
        };
        let number = match (offset.shape(), number_type(offset.dtype())) {
            ([] | [1], Some(dtype)) => {
                let bytes = offset.read_raw_bytes();
                let bytes = bytes.map_err(|error| file.error(&offset, plain(&error)))?;
                dtype.number(&bytes).and_then(Number::whole)
            }
            _ => None,
        };
        let offset_us = number.filter(|number| *number >= 0);
        let what = "the offset must be one whole number of microseconds, not negative";
        self.times.offset_us = offset_us.ok_or_else(|| file.error(&offset, what))?;
        self.used += 1;
        Ok(())
    }

    /// Reads the rows of `count` events from event `start` on.
    pub fn read(&self, start: u64, count: u64) -> Result<Vec<Row>, Error> {
        match &self.source {
            Source::Columns(columns) => {
                let [t, x, y, p] = columns.as_ref();
                let (t, x) = (read_column(t, start, count)?, read_column(x, start, count)?);
                let (y, p) = (read_column(y, start, count)?, read_column(p, start, count)?);
                let rows = t.into_iter().zip(x).zip(y).zip(p);
                Ok(rows.map(|(((t, x), y), p)| [t, x, y, p]).collect())
            }
            Source::Table(dataset, shape, order) => {
                read_table(dataset, start, count, *shape, *order)
            }
            Source::Records(dataset, given) => {
                read_records(dataset, start, count, given.as_deref())
            }
            Source::Addresses(both) => {
                let [times, addresses] = both.as_ref();
                let times = read_column(times, start, count)?;
                let rows = read_table(addresses, start, count, (3, false), [0, 0, 1, 2])?;
                let rows = times.into_iter().zip(rows);
                Ok(rows.map(|(t, [_, x, y, p])| [t, x, y, p]).collect())
            }
        }
    }

    /// Reads rows like [`Plan::read`], but fewer if the rest is damaged.
    pub fn read_whole(&self, start: u64, count: u64) -> Result<Vec<Row>, Error> {
        before_damage(count, |count| self.read(start, count))
    }

    /// Returns the index of the first event at or after `t_us`, or of one shortly before it, provided that times
    /// ascend.
    ///
    /// Returns `None` if times wrap, since bisection would not notice that.
    pub fn find_time(&self, t_us: u64, rows: &RowEvents) -> Result<Option<u64>, Error> {
        if let Some(event) = self.indexed(t_us) {
            // The index is trusted only if the event before is indeed earlier.
            if event == 0
                || self
                    .time(event - 1, rows)?
                    .is_some_and(|before| before < t_us)
            {
                return Ok(Some(event));
            }
        }
        if rows.may_wrap() && self.has_wrapped()? {
            return Ok(None);
        }
        let (mut first, mut end) = (0, self.events);
        while first < end {
            let middle = first + (end - first) / 2;
            if self.time(middle, rows)?.is_some_and(|time| time < t_us) {
                first = middle + 1;
            } else {
                end = middle;
            }
        }
        Ok(Some(first))
    }

    /// Returns whether the last time is before the first.
    fn has_wrapped(&self) -> Result<bool, Error> {
        let time = |event| -> Result<Option<f64>, Error> {
            let row = self.read(event, 1)?.first().and_then(|row| row[T]);
            Ok(row.map(Number::float))
        };
        if self.events == 0 {
            return Ok(false);
        }
        let (first, last) = (time(0)?, time(self.events.saturating_sub(1))?);
        Ok(last < first)
    }

    /// Returns the index of the event that `ms_to_idx` states for this time.
    fn indexed(&self, t_us: u64) -> Option<u64> {
        let index = self.milliseconds.as_ref()?;
        let offset_us = u64::try_from(self.times.offset_us).unwrap_or(0);
        let millisecond = t_us.saturating_sub(offset_us) / 1000;
        let number = read_column(index, millisecond, 1).ok()?;
        let event = u64::try_from(number.first().copied()??.whole()?).ok()?;
        (event <= self.events).then_some(event)
    }

    /// Returns the time of an event in us; `None` if it has no valid time.
    fn time(&self, event: u64, rows: &RowEvents) -> Result<Option<u64>, Error> {
        let time = match &self.source {
            Source::Columns(columns) => {
                let [t, ..] = columns.as_ref();
                read_column(t, event, 1)?.first().copied().flatten()
            }
            _ => self.read(event, 1)?.first().and_then(|row| row[T]),
        };
        Ok(rows.t_us(time))
    }

    /// Reads x and y of `count` events from event `start` on.
    fn read_pixels(&self, start: u64, count: u64) -> Result<Vec<[Option<Number>; 2]>, Error> {
        if let Source::Columns(columns) = &self.source {
            let [_, x, y, _] = columns.as_ref();
            let (x, y) = (read_column(x, start, count)?, read_column(y, start, count)?);
            return Ok(x.into_iter().zip(y).map(|(x, y)| [x, y]).collect());
        }
        let rows = self.read(start, count)?;
        Ok(rows.iter().map(|row| [row[X], row[Y]]).collect())
    }

    /// Returns the smallest sensor that holds every event before the first damage.
    pub fn largest(&self, file: &Hdf5, reading: &Reading, base: Base) -> Result<Sensor> {
        let mut extent = Extent::new(reading);
        let mut start = 0;
        'all: while start < self.events {
            let count = (self.events - start).min(BATCH_EVENTS as u64);
            let pixels = match self.read_pixels(start, count) {
                Ok(pixels) => pixels,
                // The reader reports later damage, after it has returned the events before it.
                Err(_) if start > 0 => break,
                Err(error) => return Err(self.error(file, start, &error)),
            };
            for [x, y] in pixels {
                let [x, y] = [x, y].map(|side| less(side, base.pixel));
                if !extent.add(x, y) {
                    break 'all;
                }
            }
            start += count;
        }
        extent.sensor(file.name())
    }

    /// Returns the numbers from which MATLAB's files count pixels and polarities; 0 for all other files.
    pub fn base(&self, file: &Hdf5, reading: &Reading, stated: Option<Sensor>) -> Result<Base> {
        let mut range = Range::default();
        let mut start = 0;
        while file.is_matlab() && start < self.events {
            let count = (self.events - start).min(BATCH_EVENTS as u64);
            // The reader reports damage.
            let Ok(rows) = self.read(start, count) else {
                break;
            };
            if rows.iter().any(|row| !range.take(row, reading)) {
                break;
            }
            start += count;
        }
        Ok(range.base(stated, false))
    }

    /// Returns an error of reading event number `event`.
    pub fn error(&self, file: &Hdf5, event: u64, error: &Error) -> event_types::stream::Error {
        let what = format!("event {event}: {}", plain(error));
        match self.dataset(P).or(self.dataset(T)) {
            Some(dataset) => file.error(dataset, what),
            None => error!(Damaged, "{}: byte 0: {what}", file.name()),
        }
    }
}

/// Returns DSEC's index of milliseconds; anything else with its name is ignored.
fn index(file: &Hdf5) -> Option<Box<Dataset>> {
    let index = file.dataset("ms_to_idx").ok().flatten()?;
    let is_one = index.shape().len() == 1 && number_type(index.dtype()).is_some();
    is_one.then(|| Box::new(index))
}

/// Returns what `read` yields for `count` rows or, if that fails, for half as many, and so on, since the rows
/// before a damaged chunk are intact.
fn before_damage<T>(
    mut count: u64,
    read: impl Fn(u64) -> Result<Vec<T>, Error>,
) -> Result<Vec<T>, Error> {
    loop {
        match read(count) {
            Err(_) if count > 1 => count /= 2,
            rows => return rows,
        }
    }
}

/// Returns the length of a dataset along its only dimension that is not 1.
fn count(dataset: &Dataset) -> u64 {
    let shape = dataset.shape();
    let long = shape.iter().find(|side| **side != 1);
    long.or(shape.first()).copied().unwrap_or(0)
}

/// Returns whether all sides but at most one are 1.
fn is_column(dataset: &Dataset) -> bool {
    let long = dataset.shape().iter().filter(|side| **side != 1);
    !dataset.shape().is_empty() && long.count() <= 1
}

/// Returns the number less `base`, the number from which it is counted.
fn less(number: Option<Number>, base: i64) -> Option<Number> {
    match number? {
        Number::Whole(value) => Some(Number::Whole(value.saturating_sub(base))),
        Number::Float(value) => Some(Number::Float(value - base as f64)),
    }
}

/// The events that were found.
struct Found {
    source: Source,
    /// The unit that the name of the times states.
    unit: Option<TimeUnit>,
    assumption: Option<Assumption>,
}

/// Finds snnTorch's columns in the group at `place`; `None` if one is missing.
fn addresses(file: &Hdf5, place: &str) -> Result<Option<Found>> {
    let (_, names) = file.members(place);
    let has = |name: &str| names.iter().any(|other| other == name);
    if !has("times") || !has("addrs") {
        return Ok(None);
    }
    let both = (
        file.dataset(&join(place, "times"))?,
        file.dataset(&join(place, "addrs"))?,
    );
    let (Some(times), Some(addresses)) = both else {
        return Ok(None);
    };
    let events = count(&times);
    let numbers = [&times, &addresses]
        .iter()
        .all(|dataset| number_type(dataset.dtype()).is_some());
    if !numbers || !is_column(&times) || addresses.shape() != [events, 3] {
        let what = "the addresses must be numbers of shape (N, 3), columns x, y, p, for N times";
        return Err(file.error(&addresses, what));
    }
    Ok(Some(Found {
        source: Source::Addresses(Box::new([times, addresses])),
        unit: None,
        assumption: Some(Assumption {
            what: "columns",
            taken: "x, y, p of addrs".to_owned(),
            why: "the order that snnTorch uses".to_owned(),
        }),
    }))
}

/// Finds the columns t, x, y, p in the group at `place`; `None` if one is missing.
fn columns(file: &Hdf5, place: &str, reading: &Reading) -> Result<Option<Found>> {
    let (_, names) = file.members(place);
    let given = given_names(reading);
    let Some(found) = find_names(names.iter().map(String::as_str), given) else {
        return Ok(None);
    };
    let mut all = Vec::new();
    for column in found.places {
        let name = names.get(column).map_or("", String::as_str);
        all.extend(file.dataset(&join(place, name))?);
    }
    let Ok(all) = <[Dataset; 4]>::try_from(all) else {
        return Ok(None);
    };
    let [t, ..] = &all;
    let events = count(t);
    for column in &all {
        if !is_column(column) || number_type(column.dtype()).is_none() {
            return Err(file.error(column, "the dataset must be one column of numbers"));
        }
        if count(column) != events {
            let what = format!("{} values, but {events} times", count(column));
            return Err(file.error(column, what));
        }
    }
    if matches!(reading.columns, Some(Columns::Places { .. })) {
        let what = "the columns have names: give --columns t=NAME,x=NAME,y=NAME,p=NAME";
        return Err(file.error(t, what).of_kind(ErrorKind::Undecided));
    }
    Ok(Some(Found {
        source: Source::Columns(Box::new(all)),
        unit: found.unit,
        assumption: names_taken(&found),
    }))
}
