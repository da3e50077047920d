//! Where the events are in an HDF5 file: the layouts of the data sets that are published so.

use anyhow::Context;
use eecvs_nostd::Sensor;
use hdf5_reader::{Dataset, Datatype, error::Error};

use super::file::{Hdf5, fields, join, number_type, plain, read_column, read_records, read_table};
use super::prophesee;
use crate::formats::BATCH_EVENTS;
use crate::formats::event_numbers::{
    NAMES, P, Row, SAMPLE_ROWS, SAMPLE_TIMES, T, TimeUnit, X, Y, column_order, coordinate,
};
use crate::formats::npy_header::{Dtype, Number};
use crate::formats::time_unit::TimeSample;

/// Where events are looked for, in this order: tables and compounds, or groups of columns.
const PLACES: [&str; 7] = [
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

/// MVSEC's cameras, mDAVIS-346B: the files do not tell.
const MVSEC_SENSOR: Sensor = Sensor {
    width: 346,
    height: 260,
};

/// Most bytes of a dataset for a byte of the file: deflate packs no more than 1,032 into one.
const EXPANSION_MAX: u64 = 1100;

/// The datasets of the events.
enum Source {
    /// t, x, y, p, a dataset each.
    Columns(Box<[Dataset; 4]>),
    /// Shape (N, 4); the columns that hold t, x, y, p.
    Table(Box<Dataset>, [usize; 4]),
    /// Compounds with fields of these names.
    Records(Box<Dataset>),
}

/// Where the numbers of the events are.
pub struct Plan {
    source: Source,
    /// Number of events.
    pub events: u64,
    /// What the times are.
    pub unit: TimeUnit,
    /// DSEC's `ms_to_idx`: the first event of every millisecond after the offset.
    milliseconds: Option<Box<Dataset>>,
    /// Size that the data set's cameras have.
    pub sensor: Option<Sensor>,
    /// Number of datasets that are read.
    pub used: usize,
}

impl Plan {
    /// Finds the events: at `place` if the user named one, else at the first of [`PLACES`] where
    /// there are some; `size` helps to tell the columns of a table apart.
    pub fn find(file: &Hdf5, place: Option<&str>, size: Option<Sensor>) -> anyhow::Result<Self> {
        if let Some(place) = place {
            let plan = match Self::at(file, place, size)? {
                None => Self::at(file, &join(place, "events"), size)?,
                found => found,
            };
            return plan.with_context(|| {
                let (name, found) = (file.name(), file.describe());
                format!("{name}: byte 0: no events at {place}; the file has {found}")
            });
        }
        for place in PLACES {
            if let Some(plan) = Self::at(file, place, size)? {
                return Ok(plan);
            }
        }
        anyhow::bail!(
            "{}: byte 0: no events at davis/left/events, no events/x, y, t, p, no table or compound \
             events, but {}: name the dataset or group after the file's name, as in {0}/GROUP/DATASET",
            file.name(),
            file.describe()
        )
    }

    /// The events at `place`, if there are some.
    fn at(file: &Hdf5, place: &str, size: Option<Sensor>) -> anyhow::Result<Option<Self>> {
        let dataset = if place.is_empty() {
            None
        } else {
            file.dataset(place)?
        };
        let source = match dataset {
            None => columns(file, place)?,
            Some(dataset) => Some(Self::whole(file, place, dataset, size)?),
        };
        let Some(source) = source else {
            return Ok(None);
        };
        let (events, used) = match &source {
            Source::Columns(columns) => (columns.iter().map(count).max().unwrap_or(0), 4),
            Source::Table(dataset, _) | Source::Records(dataset) => (count(dataset), 1),
        };
        let mut plan = Self {
            source,
            events,
            unit: TimeUnit::default(),
            milliseconds: None,
            sensor: place.starts_with(MVSEC).then_some(MVSEC_SENSOR),
            used,
        };
        plan.check_size(file)?;
        plan.unit.seconds = plan.times_in_seconds(file)?;
        plan.add_offset(file)?;
        Ok(Some(plan))
    }

    /// A table or compounds.
    fn whole(
        file: &Hdf5,
        place: &str,
        dataset: Dataset,
        size: Option<Sensor>,
    ) -> anyhow::Result<Source> {
        if let Datatype::Compound { .. } = dataset.dtype() {
            let known = fields(dataset.dtype()).is_some() && dataset.shape().len() == 1;
            return if known {
                Ok(Source::Records(Box::new(dataset)))
            } else {
                let what = "the compound has no fields t, x, y, p of numbers, in one dimension";
                Err(file.error(&dataset, what))
            };
        }
        let (&[events, 4], Some(_)) = (dataset.shape(), number_type(dataset.dtype())) else {
            let what = "the events must be of shape (N, 4) and numbers, or compounds t, x, y, p";
            return Err(file.error(&dataset, what));
        };
        if place.starts_with(MVSEC) {
            return Ok(Source::Table(Box::new(dataset), MVSEC_ORDER));
        }
        let sample = before_damage(events.min(SAMPLE_ROWS as u64), |count| {
            read_table(&dataset, 0, count)
        })
        .map_err(|error| file.error(&dataset, plain(&error)))?;
        let order = if sample.is_empty() {
            Some(MVSEC_ORDER)
        } else {
            column_order(&sample, size)
        };
        let what = "the order of the four columns is unclear: save t, x, y, p";
        let order = order.ok_or_else(|| file.error(&dataset, what))?;
        Ok(Source::Table(Box::new(dataset), order))
    }

    /// Refuses a dataset that the file is too short for: one without data stands for zeros.
    fn check_size(&self, file: &Hdf5) -> anyhow::Result<()> {
        let most = file.length().saturating_mul(EXPANSION_MAX);
        for dataset in self.datasets() {
            let bytes = hdf5_reader::dtype_element_size(dataset.dtype()).unwrap_or(0) as u64;
            let columns = dataset.shape().get(1).copied().unwrap_or(1);
            let all = count(dataset)
                .checked_mul(bytes)
                .and_then(|bytes| bytes.checked_mul(columns));
            if all.is_none_or(|all| all > most) {
                let what = format!("{} events are more than the file can hold", count(dataset));
                return Err(file.error(dataset, what));
            }
        }
        Ok(())
    }

    /// What is read, t first where there are several.
    fn datasets(&self) -> &[Dataset] {
        match &self.source {
            Source::Columns(columns) => columns.as_slice(),
            Source::Table(dataset, _) | Source::Records(dataset) => std::slice::from_ref(dataset),
        }
    }

    /// The dataset that holds t, x, y or p, for messages.
    pub fn dataset(&self, which: usize) -> Option<&Dataset> {
        let all = self.datasets();
        all.get(which).or(all.first())
    }

    /// Prophesee's compounds, if the events are such and their times count as they stand.
    pub fn compounds(&self) -> Option<&Dataset> {
        match &self.source {
            Source::Records(dataset)
                if self.unit == TimeUnit::default() && prophesee::is_known(dataset.dtype()) =>
            {
                Some(dataset)
            }
            _ => None,
        }
    }

    fn times_in_seconds(&self, file: &Hdf5) -> anyhow::Result<bool> {
        let is_float = match &self.source {
            Source::Records(dataset) => {
                fields(dataset.dtype()).is_some_and(|[(_, t), ..]| t.is_float())
            }
            _ => self
                .datasets()
                .first()
                .is_some_and(|dataset| number_type(dataset.dtype()).is_some_and(Dtype::is_float)),
        };
        if !is_float {
            return Ok(false);
        }
        let rows = self
            .read_whole(0, self.events.min(SAMPLE_TIMES as u64))
            .map_err(|error| self.error(file, 0, &error))?;
        let mut sample = TimeSample::default();
        for time in rows.iter().filter_map(|row| row[T]) {
            sample.add(time.float().fract() == 0.0, time.float());
        }
        Ok(sample.seconds())
    }

    /// DSEC's `t_offset`, in us, of integer times in columns.
    fn add_offset(&mut self, file: &Hdf5) -> anyhow::Result<()> {
        let (Source::Columns(_), false) = (&self.source, self.unit.seconds) else {
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
        let offset_us = number.and_then(|number| u64::try_from(number).ok());
        let what = "the offset must be one whole number of microseconds, not negative";
        self.unit.offset_us = offset_us.ok_or_else(|| file.error(&offset, what))?;
        self.used += 1;
        Ok(())
    }

    /// Rows of `count` events.
    pub fn read(&self, start: u64, count: u64) -> Result<Vec<Row>, Error> {
        match &self.source {
            Source::Columns(columns) => {
                let [t, x, y, p] = columns.as_ref();
                let (t, x) = (read_column(t, start, count)?, read_column(x, start, count)?);
                let (y, p) = (read_column(y, start, count)?, read_column(p, start, count)?);
                let rows = t.into_iter().zip(x).zip(y).zip(p);
                Ok(rows.map(|(((t, x), y), p)| [t, x, y, p]).collect())
            }
            Source::Table(dataset, order) => {
                let mut rows = read_table(dataset, start, count)?;
                for row in &mut rows {
                    *row = order.map(|column| row.get(column).copied().flatten());
                }
                Ok(rows)
            }
            Source::Records(dataset) => read_records(dataset, start, count),
        }
    }

    /// As [`Plan::read`], fewer rows where the rest is damaged.
    pub fn read_whole(&self, start: u64, count: u64) -> Result<Vec<Row>, Error> {
        before_damage(count, |count| self.read(start, count))
    }

    /// The first event of `t_us` or later, or one that is not long before it, if the times ascend.
    pub fn place(&self, t_us: u64) -> Result<u64, Error> {
        if let Some(event) = self.indexed(t_us) {
            // The index is believed where the event before it is earlier indeed.
            if event == 0 || self.time(event - 1)?.is_some_and(|before| before < t_us) {
                return Ok(event);
            }
        }
        let (mut first, mut end) = (0, self.events);
        while first < end {
            let middle = first + (end - first) / 2;
            if self.time(middle)?.is_some_and(|time| time < t_us) {
                first = middle + 1;
            } else {
                end = middle;
            }
        }
        Ok(first)
    }

    /// The event that `ms_to_idx` names.
    fn indexed(&self, t_us: u64) -> Option<u64> {
        let index = self.milliseconds.as_ref()?;
        let millisecond = t_us.saturating_sub(self.unit.offset_us) / 1000;
        let number = read_column(index, millisecond, 1).ok()?;
        let event = u64::try_from(number.first().copied()??.whole()?).ok()?;
        (event <= self.events).then_some(event)
    }

    /// Time of an event, in us; `None` where it is none.
    fn time(&self, event: u64) -> Result<Option<u64>, Error> {
        let time = match &self.source {
            Source::Columns(columns) => {
                let [t, ..] = columns.as_ref();
                read_column(t, event, 1)?.first().copied().flatten()
            }
            _ => self.read(event, 1)?.first().and_then(|row| row[T]),
        };
        Ok(time.and_then(|time| self.unit.us(time)))
    }

    /// x and y of `count` events.
    fn read_pixels(&self, start: u64, count: u64) -> Result<Vec<[Option<Number>; 2]>, Error> {
        if let Source::Columns(columns) = &self.source {
            let [_, x, y, _] = columns.as_ref();
            let (x, y) = (read_column(x, start, count)?, read_column(y, start, count)?);
            return Ok(x.into_iter().zip(y).map(|(x, y)| [x, y]).collect());
        }
        let rows = self.read(start, count)?;
        Ok(rows.iter().map(|row| [row[X], row[Y]]).collect())
    }

    /// Size that holds every event before the first that is damaged.
    pub fn largest(&self, file: &Hdf5) -> anyhow::Result<Sensor> {
        let (mut width, mut height, mut start) = (0, 0, 0);
        'all: while start < self.events {
            let count = (self.events - start).min(BATCH_EVENTS as u64);
            let pixels = match self.read_pixels(start, count) {
                Ok(pixels) => pixels,
                // Damage further on is for the reader, which returns the events before it.
                Err(_) if start > 0 => break,
                Err(error) => return Err(self.error(file, start, &error)),
            };
            for [x, y] in pixels {
                let (Some(x), Some(y)) = (coordinate(x), coordinate(y)) else {
                    break 'all;
                };
                width = width.max(x + 1);
                height = height.max(y + 1);
            }
            start += count;
        }
        Sensor::new(width, height).with_context(|| {
            let name = file.name();
            format!("{name}: byte 0: no event, so no sensor size: give --width W --height H")
        })
    }

    /// Error of reading event number `event`.
    pub fn error(&self, file: &Hdf5, event: u64, error: &Error) -> anyhow::Error {
        let what = format!("event {event}: {}", plain(error));
        match self.dataset(P).or(self.dataset(T)) {
            Some(dataset) => file.error(dataset, what),
            None => anyhow::anyhow!("{}: byte 0: {what}", file.name()),
        }
    }
}

/// DSEC's index of milliseconds, if there is one: what else has its name does not matter.
fn index(file: &Hdf5) -> Option<Box<Dataset>> {
    let index = file.dataset("ms_to_idx").ok().flatten()?;
    let is_one = index.shape().len() == 1 && number_type(index.dtype()).is_some();
    is_one.then(|| Box::new(index))
}

/// What `read` gives for `count` rows, or for fewer: the rows before a damaged chunk are whole.
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

/// Length of the first dimension.
fn count(dataset: &Dataset) -> u64 {
    dataset.shape().first().copied().unwrap_or(0)
}

/// The columns t, x, y, p of the group at `place`, if all are there.
fn columns(file: &Hdf5, place: &str) -> anyhow::Result<Option<Source>> {
    let (_, names) = file.members(place);
    let find = |known: &[&str]| {
        let is = |name: &&String| known.iter().any(|known| name.eq_ignore_ascii_case(known));
        match names.iter().find(is) {
            Some(name) => file.dataset(&join(place, name)),
            None => Ok(None),
        }
    };
    let [t, x, y, p] = NAMES.map(find);
    let (Some(t), Some(x), Some(y), Some(p)) = (t?, x?, y?, p?) else {
        return Ok(None);
    };
    let events = count(&t);
    for column in [&t, &x, &y, &p] {
        if column.shape().len() != 1 || number_type(column.dtype()).is_none() {
            return Err(file.error(column, "the dataset must be one column of numbers"));
        }
        if count(column) != events {
            let what = format!("{} values, but {events} times", count(column));
            return Err(file.error(column, what));
        }
    }
    Ok(Some(Source::Columns(Box::new([t, x, y, p]))))
}
