//! Readers that stay open between readings of parts: to open one again is to find its format, its index and its first
//! window again, which takes as long as to read a part.

use std::sync::{Arc, Mutex};

use event_types::stream::{Assumption, EventReader, MemoryReader, Pause, Result, Skipped};
use event_types::{Event, Sensor};

use super::source::locked;

/// A reader that nobody uses, and the process that opened it.
#[derive(Default)]
pub struct Idle(Mutex<Option<(u32, Box<dyn EventReader>)>>);

impl Idle {
    /// Takes the reader, which begins with the first event again; `None` if there is none of this process.
    ///
    /// # Errors
    /// I/O.
    pub fn take(&self) -> Result<Option<Box<dyn EventReader>>> {
        let idle = locked(&self.0).take();
        let Some((process, mut reader)) = idle else {
            return Ok(None);
        };
        if process != std::process::id() {
            return Ok(None);
        }
        let begins = reader.end_at(u64::MAX)? && reader.seek(0)?;
        Ok(begins.then_some(reader))
    }

    /// Lets the reader go.
    pub fn clear(&self) {
        drop(locked(&self.0).take());
    }
}

/// A reader that goes back when it is not needed any more.
pub struct Lent {
    reader: Box<dyn EventReader>,
    to: Arc<Idle>,
    has_failed: bool,
}

impl Lent {
    /// Lends a reader of this process. It goes back only if its format reads from any place again and again.
    pub fn new(reader: Box<dyn EventReader>, to: &Arc<Idle>) -> Self {
        Self {
            has_failed: reader.format() != "eecvs",
            reader,
            to: Arc::clone(to),
        }
    }

    fn watched<T>(&mut self, result: Result<T>) -> Result<T> {
        self.has_failed |= result.is_err();
        result
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        if !self.has_failed {
            let nothing = MemoryReader::new(self.reader.sensor(), Vec::new());
            let reader = std::mem::replace(&mut self.reader, Box::new(nothing));
            *locked(&self.to.0) = Some((std::process::id(), reader));
        }
    }
}

impl EventReader for Lent {
    fn format(&self) -> &'static str {
        self.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.reader.sensor()
    }

    fn camera(&self) -> Option<&str> {
        self.reader.camera()
    }

    fn assumptions(&self) -> &[Assumption] {
        self.reader.assumptions()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let read = self.reader.read(events);
        self.watched(read)
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        let sought = self.reader.seek(t_us);
        self.watched(sought)
    }

    fn end_at(&mut self, t_us: u64) -> Result<bool> {
        let ends = self.reader.end_at(t_us);
        self.watched(ends)
    }

    fn pause(&self) -> Pause {
        self.reader.pause()
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }
}
