//! Writer of text files.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::Context;
use eecvs_nostd::{Event, Sensor};

use super::{EventWriter, create_file};

/// Writer of text files: `.csv` with the header `t,x,y,p` and commas, `.txt` with spaces and no
/// header; times in whole microseconds, p 0 or 1. The sensor's size is not written.
pub struct TextWriter {
    file: BufWriter<File>,
    name: String,
    sensor: Sensor,
    separator: char,
    events: u64,
}

impl TextWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> anyhow::Result<Self> {
        let (mut file, name) = create_file(path)?;
        let csv = path
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("csv"));
        if csv {
            writeln!(file, "t,x,y,p").with_context(|| format!("{name}: cannot be written"))?;
        }
        Ok(Self {
            file,
            name,
            sensor,
            separator: if csv { ',' } else { ' ' },
            events: 0,
        })
    }
}

impl EventWriter for TextWriter {
    fn write(&mut self, events: &[Event]) -> anyhow::Result<()> {
        let s = self.separator;
        for event in events {
            super::check_inside(&self.name, self.events, event, self.sensor)?;
            let Event {
                t_us,
                x,
                y,
                polarity,
            } = event;
            let (name, index) = (&self.name, self.events);
            anyhow::ensure!(
                i64::try_from(*t_us).is_ok(),
                "{name}: event {index}: time {t_us} us is above 2^63 us"
            );
            writeln!(self.file, "{t_us}{s}{x}{s}{y}{s}{}", *polarity as u8)
                .with_context(|| format!("{name}: cannot be written"))?;
            self.events += 1;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> anyhow::Result<()> {
        self.file
            .flush()
            .with_context(|| format!("{}: cannot be written", self.name))
    }
}
