//! Writer of Prophesee DAT files.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor, bail};

use crate::EventWriter;
use crate::dat::{EVENT_CD, RECORD_BYTES};
use crate::output::sequential::Output;
use crate::wrapping::Wrapping;

/// Time between a `% T0` and the first event, so that events somewhat earlier can still be written.
const ROOM_US: u64 = 1 << 20;

/// A writer of DAT files of version 2, with events of type 12 (`EventCD`).
///
/// It holds times up to 2^60 us, in any order as long as a reader can follow the wraps; gaps must be below 35
/// minutes. If the first time is 2^32 us or later, times count from about one second before it, and a line `% T0`
/// states this start: readers that do not know the line lose only that.
pub struct DatWriter {
    file: Output,
    sensor: Sensor,
    t0_us: u64,
    /// Counter of the times; `None` until the first event, whose time the header needs.
    time: Option<Wrapping>,
    events: u64,
}

impl DatWriter {
    /// Creates the file; the header is written with the first event.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let file = Output::create(path)?;
        Ok(Self {
            file,
            sensor,
            t0_us: 0,
            time: None,
            events: 0,
        })
    }

    fn header(&mut self, first_us: u64) -> Result<Wrapping> {
        if first_us > Wrapping::START_MAX {
            bail!(CannotHold, "{}", self.refused(first_us));
        }
        if first_us >> 32 > 0 {
            self.t0_us = first_us - ROOM_US;
        }
        let Sensor { width, height } = self.sensor;
        let mut text = format!(
            "% Data file containing CD events.\n% Version 2\n% Width {width}\n% Height {height}\n"
        );
        if self.t0_us > 0 {
            text += &format!("% T0 {}\n", self.t0_us);
        }
        self.file.put(text.as_bytes())?;
        self.file.put(&[EVENT_CD, RECORD_BYTES as u8])?;
        Ok(Wrapping::new(32, 0))
    }

    fn refused(&self, t_us: u64) -> String {
        crate::time_refused(self.file.name(), self.events, t_us, "DAT")
    }
}

impl EventWriter for DatWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            crate::check_inside(self.file.name(), self.events, event, self.sensor)?;
            let mut time = match self.time.take() {
                Some(time) => time,
                None => self.header(event.t_us)?,
            };
            let since_t0 = event.t_us.checked_sub(self.t0_us);
            let low = since_t0.map(|since| time.low(since)).filter(|low| {
                // The time must be what a reader will decode.
                since_t0 == Some(time.extend(*low))
            });
            let Some(low) = low else {
                bail!(CannotHold, "{}", self.refused(event.t_us));
            };
            self.time = Some(time);
            let address = u64::from(event.polarity == Polarity::On) << 28
                | u64::from(event.y) << 14
                | u64::from(event.x);
            self.file.put(&(address << 32 | low).to_le_bytes())?;
            self.events += 1;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        if self.events == 0 {
            self.header(0)?;
        }
        self.file.finish()
    }
}
