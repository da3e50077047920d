//! Events in HDF5 files (`.h5`, `.hdf5`), as data sets of event cameras are published.
//!
//! * MVSEC: `davis/left/events`, of shape (N, 4), columns x, y, t in seconds, p = 1 or -1; the
//!   sensor is 346 x 260.
//! * DSEC: `events/x`, `y`, `t` in us, `p`; `t_offset`, where it is there, is added to every time.
//! * Columns of these or longer names (xs, ts, timestamp, polarity, ...) in the root, `events`,
//!   `CD/events`, `prophesee/left` or `davis/left/events`; compounds with such fields, or a table of
//!   shape (N, 4), in `events`. EHPT-XC's layout is not published: docs/datasets.md says what is known.
//! * Any other place, and a second camera, is named behind the file's name, as h5ls does:
//!   `indoor_flying1_data.hdf5/davis/right/events`.
//!
//! Types, the unit of times, polarities and the sensor's size are as in npz files. Datasets may be
//! contiguous or in chunks, packed by gzip with or without shuffle; other filters are named in the
//! error. The reader holds one batch, some chunks and pieces of the file's structures. It does not
//! follow links to other files.

use eecvs_nostd::{Event, Sensor};

pub use super::hdf5_file::MAGIC;

use super::Skipped;
use super::event_numbers::{self, Row};
use super::format::{Format, Limits, Opening, Start};
use super::hdf5_file::Hdf5;
use super::hdf5_layout::Plan;
use super::input::{Batch, Decode, ReadSeek, Reader};

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "hdf5",
    title: "HDF5",
    endings: &[".h5", ".hdf5"],
    detect: is_hdf5,
    open: |Opening {
               source,
               name,
               place,
               size,
               ..
           }| Ok(Box::new(Hdf5Reader::new(source, name, place, size)?)),
    has_places: true,
    grows: false,
    limits: Limits::NONE,
    create: None,
};

/// Whether a file begins with HDF5's signature, behind a user block if there is one.
fn is_hdf5(start: &Start) -> bool {
    [0, 512, 1024, 2048].iter().any(|at| {
        let rest = start.bytes.get(*at..);
        rest.is_some_and(|rest| rest.starts_with(MAGIC))
    })
}

/// Reader of HDF5 files.
pub type Hdf5Reader = Reader<Hdf5Decoder>;

impl Hdf5Reader {
    /// Reads `source`, which messages call `name`; `place` is the dataset or group of the events, if
    /// not one that is known; `size` counts before what the data set's cameras have.
    ///
    /// # Errors
    /// No HDF5 file, no events of a known layout, no size and no event.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        place: Option<&str>,
        size: Option<Sensor>,
    ) -> anyhow::Result<Self> {
        let file = Hdf5::open(source, name)?;
        let plan = Plan::find(&file, place, size)?;
        let sensor = match size.or(plan.sensor) {
            Some(sensor) => sensor,
            None => plan.largest(&file)?,
        };
        let mut skipped = Skipped::default();
        let others = file.datasets().len().saturating_sub(plan.used);
        skipped.add("other datasets", others as u64);
        Ok(Self::around(Hdf5Decoder {
            file,
            plan,
            sensor,
            events: 0,
            skipped,
        }))
    }
}

/// State between two batches.
pub struct Hdf5Decoder {
    file: Hdf5,
    plan: Plan,
    sensor: Sensor,
    events: u64,
    skipped: Skipped,
}

impl Hdf5Decoder {
    fn event(&self, row: &Row) -> Result<Event, (usize, String)> {
        let mut event = event_numbers::event(row, self.plan.seconds, self.sensor)?;
        let t_us = event.t_us.checked_add(self.plan.offset_us);
        let t_us = t_us.filter(|t_us| i64::try_from(*t_us).is_ok());
        event.t_us = t_us.ok_or_else(|| {
            let what = "the time with t_offset is above 2^63 us";
            (event_numbers::T, what.to_owned())
        })?;
        Ok(event)
    }

    fn error(&self, which: usize, what: &str) -> anyhow::Error {
        let what = format!("event {}: {what}", self.events);
        match self.plan.dataset(which) {
            Some(dataset) => self.file.error(dataset, what),
            None => anyhow::anyhow!("{}: byte 0: {what}", self.file.name()),
        }
    }
}

impl Decode for Hdf5Decoder {
    fn format(&self) -> &'static str {
        "hdf5"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        let count = (self.plan.events - self.events).min(batch.room() as u64);
        let rows = self.plan.read_whole(self.events, count);
        let rows = rows.map_err(|error| self.plan.error(&self.file, self.events, &error))?;
        for row in &rows {
            match self.event(row) {
                Ok(event) => batch.push(event),
                Err((which, what)) => return Err(self.error(which, &what)),
            }
            self.events += 1;
        }
        Ok(())
    }
}
