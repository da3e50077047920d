//! Events in HDF5 files (`.h5`, `.hdf5`), as data sets of event cameras are published.
//!
//! * MVSEC: `davis/left/events`, of shape (N, 4), columns x, y, t in seconds, p = 1 or -1; the
//!   sensor is 346 x 260.
//! * DSEC: `events/x`, `y`, `t` in us, `p`; `t_offset`, where it is there, is added to every time, and
//!   `ms_to_idx`, the first event of every millisecond after it, tells where to go on. Without such an
//!   index, times are taken to ascend and are bisected.
//! * Prophesee: compounds x, y, p, t in us at `CD/events`; their triggers are not read.
//! * Columns of these or longer names (xs, ts, timestamp, polarity, ...) in the root, `events`,
//!   `CD/events`, `prophesee/left` or `davis/left/events`; compounds with such fields, or a table of
//!   shape (N, 4), in `events`. EHPT-XC's layout is not published: docs/datasets.md says what is known.
//! * Any other place, and a second camera, is named behind the file's name, as h5ls does:
//!   `indoor_flying1_data.hdf5/davis/right/events`.
//!
//! * MATLAB's files of `-v7.3`: a structure `TD`, or vectors, of 1 x N or N x 1, which count as MATLAB's other
//!   files do (see [`crate::mat`]); a matrix of N rows is 4 x N here.
//! * snnTorch: a group with `times` and `addrs` of shape (N, 3), columns x, y, p, named behind the file.
//! * DDD17's and DDD20's `dvs/data`, raw packets of cAER, are named in the error.
//!
//! Types, the unit of times and polarities are as in npz files; an attribute `units` of the times, their group or
//! the root states the unit. The sensor's size is that of `width` and `height`, `sensor_resolution`, Prophesee's
//! `geometry` and the like, among the root's or the events' attributes or beside the events; else the caller's; else that of the data
//! set's cameras; else the largest x and y plus one. Datasets may be contiguous or in chunks, packed by
//! gzip, Blosc, Blosc 2, bitshuffle, LZF, LZ4 or Zstandard, with or without shuffle, or by Prophesee's ECF; other
//! filters are named in the error. The reader holds one batch, some chunks, pieces of the file's structures, and
//! where the chunks of ECF are. It does not follow links to other files.
//!
//! Files are written in DSEC's layout.

mod bitshuffle;
mod blosc;
mod blosc2;
mod chunks;
mod copies;
mod ecf;
mod file;
mod filters;
mod layout;
mod prophesee;
mod shuffle;
mod structures;
mod writer;

use event_types::stream::{ErrorKind, Result};
use event_types::{Sensor, error};

use self::file::Hdf5;
pub use self::file::MAGIC;
use self::layout::Plan;
use self::prophesee::Packed;
pub use self::writer::Hdf5Writer;
use crate::format::{Format, Limits, Opening, Start};
use crate::input::{Batch, Decode, ReadSeek, Reader};
use crate::reading::Reading;
use crate::table::event_numbers::T;
use crate::table::row_events::RowEvents;
use crate::{Assumption, BATCH_EVENTS, Skipped};

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
               reading,
               ..
           }| { Ok(Box::new(Hdf5Reader::new(source, name, place, &reading)?)) },
    has_places: true,
    is_table: true,
    grows: false,
    streams: false,
    // And 38 hours from the first event to the last, which no limit of a single event tells.
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(Hdf5Writer::create(path, sensor)?))),
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
    /// not one that is known; `reading` says what the file does not: its size counts before what the data set's
    /// cameras have.
    ///
    /// # Errors
    /// No HDF5 file, no events of a known layout, no size and no event.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        place: Option<&str>,
        reading: &Reading,
    ) -> Result<Self> {
        let file = Hdf5::open(source, name)?;
        let plan = Plan::find(&file, place, reading)?;
        let (stated, sizes) = file.stated_size(&plan.place);
        let compounds = plan.compounds();
        let mut packed = compounds.and_then(|dataset| Packed::find(&file, dataset));
        let sample = plan.sample(&file, packed.as_mut())?;
        let base = plan.base(&file, reading, stated)?;
        let rows = RowEvents::new(reading, plan.times, base, &sample);
        let mut rows = rows.map_err(|what| match plan.dataset(T) {
            Some(dataset) => file.error(dataset, what).of_kind(ErrorKind::Undecided),
            None => error!(Undecided, "{name}: byte 0: {what}"),
        })?;
        rows.assumptions.extend(plan.assumption.clone());
        rows.sensor = match stated.or(reading.size).or(plan.sensor) {
            Some(sensor) => sensor,
            None => {
                let sensor = plan.largest(&file, reading, base)?;
                rows.assumptions.push(Assumption::size_taken(sensor));
                sensor
            }
        };
        let others = file.datasets().len().saturating_sub(plan.used + sizes);
        rows.skipped.add("other datasets", others as u64);
        Ok(Self::around(Hdf5Decoder {
            file,
            plan,
            rows,
            is_plain: *reading
                == Reading {
                    size: reading.size,
                    ..Reading::default()
                },
            packed,
            events: 0,
        }))
    }
}

/// State between two batches.
pub struct Hdf5Decoder {
    file: Hdf5,
    plan: Plan,
    rows: RowEvents,
    /// Nothing is to be corrected: records may be taken as they stand.
    is_plain: bool,
    /// Compounds packed by ECF, if the events are such.
    packed: Option<Packed>,
    events: u64,
}

impl Hdf5Decoder {
    /// Appends events of Prophesee's compounds, up to the batch's end or the first piece that is not so
    /// plain.
    fn decode_compounds(&mut self, batch: &mut Batch<'_>) {
        let Some(dataset) = self.plan.compounds().filter(|_| self.is_plain) else {
            return;
        };
        let chunk = file::chunk_rows(dataset).unwrap_or(BATCH_EVENTS as u64);
        while batch.room() > 0 && self.events < self.plan.events {
            // A chunk at a time, which is still in the processor's cache when it is looked at.
            let to_end = chunk - self.events.checked_rem(chunk).unwrap_or(0);
            let count = (self.plan.events - self.events)
                .min(batch.room() as u64)
                .min(to_end.max(1));
            let (start, sensor) = (self.events, self.rows.sensor);
            let is_read = match &mut self.packed {
                Some(packed) => {
                    let first = start - start.checked_rem(chunk).unwrap_or(0);
                    packed.read((first, start, count as usize), sensor, batch)
                }
                None => false,
            };
            if !is_read && !prophesee::read(dataset, start, count, sensor, batch) {
                return;
            }
            self.events += count;
        }
    }

    fn error(&self, which: usize, what: &str) -> event_types::stream::Error {
        let what = format!("event {}: {what}", self.events);
        match self.plan.dataset(which) {
            Some(dataset) => self.file.error(dataset, what),
            None => error!(Damaged, "{}: byte 0: {what}", self.file.name()),
        }
    }
}

impl Decode for Hdf5Decoder {
    fn format(&self) -> &'static str {
        "hdf5"
    }

    fn sensor(&self) -> Sensor {
        self.rows.sensor
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.rows.assumptions
    }

    fn skipped(&self) -> &Skipped {
        &self.rows.skipped
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        // Where a probe meets damage, reading on does too, and tells where.
        let Ok(Some(event)) = self.plan.find_time(t_us, &self.rows) else {
            return Ok(false);
        };
        self.rows.rewind();
        self.events = event;
        Ok(true)
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        self.decode_compounds(batch);
        loop {
            let count = (self.plan.events - self.events).min(batch.room() as u64);
            let rows = self.plan.read_whole(self.events, count);
            let rows = rows.map_err(|error| self.plan.error(&self.file, self.events, &error))?;
            for row in &rows {
                match self.rows.event(row) {
                    Ok(event) => event.into_iter().for_each(|event| batch.push(event)),
                    Err((which, what)) => return Err(self.error(which, &what)),
                }
                self.events += 1;
            }
            // None of a batch may have been an event.
            if !batch.is_empty() || rows.is_empty() {
                return Ok(());
            }
        }
    }
}
