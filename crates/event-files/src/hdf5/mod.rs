//! Reads events from HDF5 files (`.h5`, `.hdf5`) in the layouts of published data sets, and writes DSEC's.
//!
//! * MVSEC: `davis/left/events`, of shape (N, 4), columns x, y, t in seconds, p = 1 or -1; the sensor is 346 x 260.
//! * DSEC: `events/x`, `y`, `t` in us, `p`. `t_offset`, if present, is added to every time. Seeking uses
//!   `ms_to_idx`, the index of the first event of every millisecond after the offset. Without such an index, times
//!   are assumed to ascend and are bisected.
//! * Prophesee: compounds x, y, p, t in us at `CD/events`; the triggers are not read.
//! * Columns with these or longer names (xs, ts, timestamp, polarity, ...) in the root, `events`, `CD/events`,
//!   `prophesee/left` or `davis/left/events`; compounds with these fields, or a table of shape (N, 4), in `events`.
//!   EHPT-XC's layout is not published: docs/datasets.md says what is known.
//! * The path of any other place, or of a second camera, is appended to the file's name, as for h5ls:
//!   `indoor_flying1_data.hdf5/davis/right/events`.
//! * MATLAB's `-v7.3` files: a structure `TD`, or vectors, of 1 x N or N x 1; pixels and polarities are counted as
//!   in MATLAB's other files (see [`crate::mat`]). A matrix of N rows is 4 x N here.
//! * snnTorch: a group with `times` and `addrs` of shape (N, 3), columns x, y, p; its path is appended to the
//!   file's name.
//! * DDD17's and DDD20's `dvs/data`, raw packets of cAER, are not read; the error names them.
//!
//! Types, the unit of times and polarities are as in npz files; an attribute `units` of the times, their group or
//! the root states the unit. The sensor's size is, in this order: what `width` and `height`, `sensor_resolution`,
//! Prophesee's `geometry` and the like state, as attributes of the root or the events or as datasets beside the
//! events; the caller's; that of the data set's cameras; the largest x and y plus one.
//!
//! Datasets may be contiguous or chunked, packed by gzip, Blosc, Blosc 2, bitshuffle, LZF, LZ4 or Zstandard, with
//! or without shuffle, by Prophesee's ECF, or by the filter of EECVS (`eecvs-hdf5`); the error names any other filter. The
//! reader holds one batch, some chunks, blocks of the file's structures, and the places of all ECF chunks. It does not
//! follow links to other files.

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
use crate::table::row_events::{RowEvents, Scale};
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
    // The writer's limit of 38 hours from the first event to the last is not one of single events.
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(Hdf5Writer::create(path, sensor)?))),
};

/// Returns whether a file begins with HDF5's signature, possibly after a user block.
fn is_hdf5(start: &Start) -> bool {
    [0, 512, 1024, 2048].iter().any(|at| {
        let rest = start.bytes.get(*at..);
        rest.is_some_and(|rest| rest.starts_with(MAGIC))
    })
}

/// A reader of HDF5 files.
pub type Hdf5Reader = Reader<Hdf5Decoder>;

impl Hdf5Reader {
    /// Reads `source`, which messages call `name`. `place` is the dataset or group of the events; `None` looks at
    /// the known places. `reading` states what the file does not; its size takes precedence over that of the data
    /// set's cameras.
    ///
    /// # Errors
    /// The file is not HDF5 or is damaged; it has no events of a known layout; the columns, the unit or the size
    /// cannot be determined.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        place: Option<&str>,
        reading: &Reading,
    ) -> Result<Self> {
        let mut file = Hdf5::open(source, name)?;
        let mut plan = Plan::find(&file, place, reading)?;
        if file.keep_chunks(plan.datasets().iter())? {
            plan = Plan::find(&file, place, reading)?;
        }
        let (stated, sizes) = file.stated_size(&plan.place);
        let compounds = plan.compounds();
        let packed = compounds.and_then(|dataset| Packed::find(&file, dataset));
        let sample = match packed {
            // ECF codes times in us and polarities as bits: there is nothing to find out from a sample.
            Some(_) => {
                plan.times.scale.get_or_insert(Scale::US);
                Vec::new()
            }
            None => plan.sample(&file)?,
        };
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

/// The decoder of [`Hdf5Reader`]: its state between two batches.
pub struct Hdf5Decoder {
    file: Hdf5,
    plan: Plan,
    rows: RowEvents,
    /// Whether the caller corrects nothing, so that records may be taken unchanged.
    is_plain: bool,
    /// The compounds packed by ECF, if the events are stored so.
    packed: Option<Packed>,
    events: u64,
}

impl Hdf5Decoder {
    /// Appends events of Prophesee's compounds, up to the end of the batch or the first part that needs the general
    /// path.
    fn decode_compounds(&mut self, batch: &mut Batch<'_>) {
        let Some(dataset) = self.plan.compounds().filter(|_| self.is_plain) else {
            return;
        };
        let chunk = file::chunk_rows(dataset).unwrap_or(BATCH_EVENTS as u64);
        while batch.room() > 0 && self.events < self.plan.events {
            // One chunk at a time, so that it is still in the processor's cache when its events are checked.
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
        // If a probe meets damage, so does reading on, which then reports its place.
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
            let appended = self.rows.append(&rows, &mut self.events, batch);
            appended.map_err(|(which, what)| self.error(which, &what))?;
            // All rows of a batch may have been left out.
            if !batch.is_empty() || rows.is_empty() {
                return Ok(());
            }
        }
    }
}
