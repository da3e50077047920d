//! Writes text files.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Event, Sensor};

use crate::{EventWriter, create_file};

/// A writer of text files: `.csv` with the header `t,x,y,p` and commas, `.txt` with spaces and no header; times in
/// whole microseconds, p 0 or 1. The sensor's size is not written.
///
/// If the first event's numbers leave it open which of them is the time, `.txt` begins with the comment
/// `# t x y p`. A recording without events gets column names that state the size: `t,x@346,y@260,p`.
pub struct TextWriter {
    file: BufWriter<File>,
    name: String,
    sensor: Sensor,
    separator: u8,
    events: u64,
    /// Lines that are being made.
    lines: Vec<u8>,
}

/// Lines that are made before they are written.
const LINES: usize = 512;

impl TextWriter {
    /// Creates the file; `separator` is a comma or a space.
    ///
    /// # Errors
    /// The file cannot be created.
    pub(crate) fn create(path: &Path, sensor: Sensor, separator: u8) -> Result<Self> {
        let (file, name) = create_file(path)?;
        Ok(Self {
            file,
            name,
            sensor,
            separator,
            events: 0,
            lines: Vec::new(),
        })
    }
}

impl TextWriter {
    /// Writes the line before the first event, or before the end of a file without events.
    fn begin(&mut self, first: Option<&Event>) -> Result<()> {
        let Sensor { width, height } = self.sensor;
        let names = match (first, self.separator) {
            (None, b',') => format!("t,x@{width},y@{height},p\n"),
            (None, _) => format!("# t x@{width} y@{height} p\n"),
            (Some(_), b',') => "t,x,y,p\n".to_owned(),
            // A time below the largest side could be an x or y, an x below 2 a polarity.
            (Some(first), _) if first.t_us < u64::from(Sensor::SIDE_MAX) || first.x < 2 => {
                "# t x y p\n".to_owned()
            }
            _ => String::new(),
        };
        self.file
            .write_all(names.as_bytes())
            .with_context(|| format!("{}: cannot be written", self.name))
    }
}

impl EventWriter for TextWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        let s = self.separator;
        if self.events == 0 && !events.is_empty() {
            self.begin(events.first())?;
        }
        let name = &self.name;
        crate::check_all_inside(name, self.events, events, self.sensor)?;
        let mut numbers = itoa::Buffer::new();
        for events in events.chunks(LINES) {
            self.lines.clear();
            for (index, event) in (self.events..).zip(events) {
                let t_us = crate::signed_us(name, index, event.t_us)?;
                self.lines
                    .extend_from_slice(numbers.format(t_us).as_bytes());
                self.lines.push(s);
                self.lines
                    .extend_from_slice(numbers.format(event.x).as_bytes());
                self.lines.push(s);
                self.lines
                    .extend_from_slice(numbers.format(event.y).as_bytes());
                let end = [s, b'0' + event.polarity as u8, b'\n'];
                self.lines.extend_from_slice(&end);
            }
            self.file
                .write_all(&self.lines)
                .with_context(|| format!("{name}: cannot be written"))?;
            self.events += events.len() as u64;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        if self.events == 0 {
            self.begin(None)?;
        }
        self.file
            .flush()
            .with_context(|| format!("{}: cannot be written", self.name))
    }
}
