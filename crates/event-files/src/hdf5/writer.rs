//! Writes HDF5 files in DSEC's layout: `events/t` (int64, us after `t_offset`), `x`, `y` (uint16), `p` (uint8, 0 or
//! 1), `t_offset` (int64, us), `ms_to_idx` (uint64: for each millisecond after the offset, the index of the first
//! event at or after it), and the root's attributes `width` and `height`.
//!
//! DSEC's own files have 32-bit times, which end after 71 minutes; its readers accept both. The offset is the first
//! event's time, so that the index begins with the recording.

use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor, bail};

use super::structures::{Column, Growing, Integer, Packed};
use crate::output::workers::Workers;
use crate::{EventWriter, create_file};

const MILLISECOND_US: i64 = 1000;

/// Longest recording, about 38 hours: the index has an entry for every millisecond.
const SPAN_MAX_US: i64 = 1 << 37;

/// Places of the columns.
const T: usize = 0;
const X: usize = 1;
const Y: usize = 2;
const P: usize = 3;
const MILLISECONDS: usize = 4;

/// A writer of HDF5 files. It holds one chunk of every column, 65,536 numbers, and those that are being packed on other
/// threads, at most nine.
pub struct Hdf5Writer {
    file: Growing,
    name: String,
    sensor: Sensor,
    columns: [Column; 5],
    /// Chunks on their way, with the places of their columns.
    packing: Workers<(usize, Packed)>,
    /// Times of a batch after the offset.
    times: Vec<i64>,
    /// Start of the first millisecond after the offset that is not yet in the index.
    next_us: i64,
    /// Time of the first event.
    offset_us: Option<i64>,
    events: u64,
}

impl Hdf5Writer {
    /// Creates the file.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let (file, name) = create_file(path)?;
        let file = Growing::new(file).with_context(|| format!("{name}: cannot be written"))?;
        let column = |bytes, signed| Column::new(Integer { bytes, signed });
        Ok(Self {
            file,
            name,
            sensor,
            columns: [
                column(8, true),
                column(2, false),
                column(2, false),
                column(1, false),
                column(8, false),
            ],
            packing: Workers::new(),
            times: Vec::new(),
            next_us: 0,
            offset_us: None,
            events: 0,
        })
    }

    /// Puts the times of events after the offset, which is the first event's time, into `times`, up to the first event
    /// that the file cannot hold, which is the error.
    fn relative_times(&mut self, events: &[Event]) -> Result<()> {
        let (name, first) = (&self.name, self.events);
        let checked = crate::signed_times(name, first, events, self.sensor, &mut self.times);
        let Some(earliest) = self.times.first() else {
            return checked;
        };
        let offset = *self.offset_us.get_or_insert(*earliest);
        for index in 0..self.times.len() {
            let t = self.times[index];
            let relative = t - offset;
            self.times[index] = relative;
            if relative >= SPAN_MAX_US {
                self.times.truncate(index);
                bail!(
                    CannotHold,
                    "{name}: event {}: time {t} us is 38 hours or more after the first event's, too long for DSEC's \
                     index: write .npz",
                    first + index as u64
                );
            }
        }
        checked
    }

    /// Appends events, and the times of these after the offset; the columns' chunks have room for them.
    fn put(&mut self, events: &[Event]) -> std::io::Result<()> {
        let times = std::mem::take(&mut self.times);
        for relative in &times {
            while self.next_us <= *relative {
                let first = self.events.to_le_bytes();
                self.columns[MILLISECONDS].extend(std::iter::once(first));
                self.pack(MILLISECONDS, false)?;
                self.next_us += MILLISECOND_US;
            }
            self.events += 1;
        }
        self.times = times;
        let [t, x, y, p, _] = &mut self.columns;
        t.extend(self.times.iter().map(|t| t.to_le_bytes()));
        x.extend(events.iter().map(|event| event.x.to_le_bytes()));
        y.extend(events.iter().map(|event| event.y.to_le_bytes()));
        p.extend(events.iter().map(|event| [event.polarity as u8]));
        for column in [T, X, Y, P] {
            self.pack(column, false)?;
        }
        Ok(())
    }

    /// Packs a column's chunk, if it is full, or `ends` the column.
    fn pack(&mut self, column: usize, ends: bool) -> std::io::Result<()> {
        let Some(pack) = self.columns[column].chunk(ends) else {
            return Ok(());
        };
        let packed = self.packing.give(move || (column, pack()));
        packed.map_or(Ok(()), |packed| self.place(packed))
    }

    fn place(&mut self, (column, packed): (usize, Packed)) -> std::io::Result<()> {
        self.columns[column].place(packed, &mut self.file)
    }
}

impl EventWriter for Hdf5Writer {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        let mut rest = events;
        while !rest.is_empty() {
            let (part, behind) = rest.split_at(rest.len().min(self.columns[T].room()));
            let checked = self.relative_times(part);
            self.put(&part[..self.times.len()])
                .with_context(|| format!("{}: cannot be written", self.name))?;
            checked?;
            rest = behind;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        let name = self.name.clone();
        self.close()
            .with_context(|| format!("{name}: cannot be written"))
    }
}

impl Hdf5Writer {
    fn close(mut self) -> std::io::Result<()> {
        for column in 0..self.columns.len() {
            self.pack(column, true)?;
        }
        while let Some(packed) = self.packing.take() {
            self.place(packed)?;
        }
        let mut file = self.file;
        let [t, x, y, p, milliseconds] = self.columns;
        let columns = [
            ("t", t.finish(&mut file)?),
            ("x", x.finish(&mut file)?),
            ("y", y.finish(&mut file)?),
            ("p", p.finish(&mut file)?),
        ];
        let members = [
            ("events", file.group(&columns, &[])?),
            ("ms_to_idx", milliseconds.finish(&mut file)?),
            ("t_offset", file.scalar(self.offset_us.unwrap_or(0))?),
        ];
        let Sensor { width, height } = self.sensor;
        let size = [("width", i64::from(width)), ("height", i64::from(height))];
        let root = file.group(&members, &size)?;
        file.finish(root)
    }
}
