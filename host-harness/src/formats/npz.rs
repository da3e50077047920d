//! Events as numpy arrays in a zip file (`.npz`), stored or deflated.
//!
//! * Either keys t, x, y and p (also ts, time, timestamp(s); pol, polarity), one dimension each,
//! * or one array `events` (or the only array of the file): structured with fields of these names,
//!   or of shape (N, 4), whose columns are told apart as those of a text file without header.
//! * Scalars `width` and `height` give the sensor's size; without them and without a size from
//!   the caller a first pass finds the largest x and y, plus one.
//! * Integers and floats of any width up to 8 bytes, either byte order, bool for p.
//! * t: integers are microseconds. Floats are seconds, rounded to the nearest microsecond, unless
//!   the first 4,096 are whole and there are 16 different ones, or one of 1e10 and more.
//! * p: 1 or true is on; 0, -1 or false is off.
//!
//! The arrays are read in step, one batch of each at a time. A wrong CRC-32 of one is an error
//! after the last event; a truncated file has lost its directory and cannot be read at all.

use eecvs_nostd::{Event, Sensor};

use super::Skipped;
use super::event_numbers::{self, TimeUnit};
use super::format::{Format, Limits, Opening};
use super::input::{Batch, Decode, ReadSeek, Reader};
use super::npz_layout::{Field, NpzFile, Plan, Stream, count, fill};
use super::npz_writer::NpzWriter;

/// First bytes of a zip file with an entry.
pub const MAGIC: &[u8; 4] = b"PK\x03\x04";

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "npz",
    title: "npz",
    endings: &[".npz"],
    detect: |start| start.begins(MAGIC),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(NpzReader::new(source, name, reading.size)?)),
    has_places: false,
    grows: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(NpzWriter::create(path, sensor)?))),
};

/// Reader of npz files.
pub type NpzReader = Reader<NpzDecoder>;

impl NpzReader {
    /// Reads `source`, which messages call `name`; `size` counts where the file names no size.
    ///
    /// # Errors
    /// No zip file, arrays missing or of a wrong type or shape, no size and no event.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        size: Option<Sensor>,
    ) -> anyhow::Result<Self> {
        let file = NpzFile::open(source, name)?;
        let mut plan = file.plan()?;
        plan.seconds = file.times_in_seconds(&plan)?;
        let sensor = match file.stated_size()?.or(size) {
            Some(sensor) => sensor,
            None => file.largest(&plan)?,
        };
        let mut skipped = Skipped::default();
        skipped.add(
            "other arrays",
            file.arrays().saturating_sub(plan.used) as u64,
        );
        let streams = file.streams(&plan)?;
        Ok(Self::around(NpzDecoder {
            file,
            plan,
            streams,
            sensor,
            events: 0,
            skipped,
        }))
    }
}

/// State between two batches.
pub struct NpzDecoder {
    file: NpzFile,
    plan: Plan,
    streams: Vec<Stream>,
    sensor: Sensor,
    events: u64,
    skipped: Skipped,
}

impl NpzDecoder {
    fn event(&self, row: usize) -> Result<Event, (usize, String)> {
        let number = |field: Field| self.streams.get(field.stream)?.number(row, field);
        let numbers = self.plan.fields.map(number);
        let unit = TimeUnit {
            seconds: self.plan.seconds,
            offset_us: 0,
        };
        event_numbers::event(&numbers, unit, self.sensor)
    }

    fn error(&self, stream: usize, what: impl std::fmt::Display) -> anyhow::Error {
        let what = format!("event {}: {what}", self.events);
        match self.plan.streams.get(stream) {
            Some(stream) => self.file.error(&stream.entry, what),
            None => anyhow::anyhow!("{}: {what}", self.file.name()),
        }
    }
}

impl Decode for NpzDecoder {
    fn format(&self) -> &'static str {
        "npz"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        let count = count(self.plan.events - self.events, batch.room());
        let (whole, ended) = fill(&mut self.streams, count);
        for row in 0..whole {
            match self.event(row) {
                Ok(event) => batch.push(event),
                Err((which, what)) => {
                    return Err(self.error(self.plan.fields[which].stream, what));
                }
            }
            self.events += 1;
        }
        match ended {
            // Where in the array the damage is nobody can tell, so the events are out by now.
            None if count == 0 => match self.streams.iter().position(Stream::is_damaged) {
                None => Ok(()),
                Some(stream) => {
                    Err(self.error(stream, "the array's CRC-32 is wrong: damaged data"))
                }
            },
            None => Ok(()),
            Some((stream, error)) => Err(self.error(stream, error)),
        }
    }
}
