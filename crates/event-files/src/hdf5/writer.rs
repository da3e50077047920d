//! Writes HDF5 files in DSEC's layout: `events/t` (int64, us after `t_offset`), `x`, `y` (uint16), `p` (uint8, 0 or
//! 1), `t_offset` (int64, us), `ms_to_idx` (uint64: for each millisecond after the offset, the index of the first
//! event at or after it), and the root's attributes `width` and `height`.
//!
//! DSEC's own files have 32-bit times, which end after 71 minutes; its readers accept both. The offset is the first
//! event's time, so that the index begins with the recording.

use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor, ensure};

use super::structures::{Column, Growing, Integer};
use crate::{EventWriter, create_file};

const MILLISECOND_US: i64 = 1000;

/// Longest recording, about 38 hours: the index has an entry for every millisecond.
const SPAN_MAX_US: i64 = 1 << 37;

/// A writer of HDF5 files. It holds one chunk of every column, 65,536 numbers.
pub struct Hdf5Writer {
    file: Growing,
    name: String,
    sensor: Sensor,
    t: Column,
    x: Column,
    y: Column,
    p: Column,
    milliseconds: Column,
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
            t: column(8, true),
            x: column(2, false),
            y: column(2, false),
            p: column(1, false),
            milliseconds: column(8, false),
            next_us: 0,
            offset_us: None,
            events: 0,
        })
    }

    /// Returns the event's time after the offset, which is the first event's time.
    fn relative_us(&mut self, t_us: u64) -> Result<i64> {
        let (name, index) = (&self.name, self.events);
        let t = crate::signed_us(name, index, t_us)?;
        let relative = t - *self.offset_us.get_or_insert(t);
        ensure!(
            relative < SPAN_MAX_US,
            CannotHold,
            "{name}: event {index}: time {t_us} us is 38 hours or more after the first event's, too \
             long for DSEC's index: write .npz"
        );
        Ok(relative)
    }

    fn put(&mut self, event: &Event, relative: i64) -> std::io::Result<()> {
        let file = &mut self.file;
        while self.next_us <= relative {
            self.milliseconds.push(file, &self.events.to_le_bytes())?;
            self.next_us += MILLISECOND_US;
        }
        self.t.push(file, &relative.to_le_bytes())?;
        self.x.push(file, &event.x.to_le_bytes())?;
        self.y.push(file, &event.y.to_le_bytes())?;
        self.p.push(file, &[event.polarity as u8])
    }
}

impl EventWriter for Hdf5Writer {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            crate::check_inside(&self.name, self.events, event, self.sensor)?;
            let relative = self.relative_us(event.t_us)?;
            self.put(event, relative)
                .with_context(|| format!("{}: cannot be written", self.name))?;
            self.events += 1;
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
    fn close(self) -> std::io::Result<()> {
        let mut file = self.file;
        let columns = [
            ("t", self.t.finish(&mut file)?),
            ("x", self.x.finish(&mut file)?),
            ("y", self.y.finish(&mut file)?),
            ("p", self.p.finish(&mut file)?),
        ];
        let members = [
            ("events", file.group(&columns, &[])?),
            ("ms_to_idx", self.milliseconds.finish(&mut file)?),
            ("t_offset", file.scalar(self.offset_us.unwrap_or(0))?),
        ];
        let Sensor { width, height } = self.sensor;
        let size = [("width", i64::from(width)), ("height", i64::from(height))];
        let root = file.group(&members, &size)?;
        file.finish(root)
    }
}
