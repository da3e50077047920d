//! An [`EventReader`] over a slice, for tests.

use std::collections::VecDeque;

use anyhow::Result;
use eecvs_nostd::{Event, Polarity, Sensor};

use crate::formats::{EventReader, Skipped};

/// Sensor of the tests.
pub(crate) const SENSOR: Sensor = match Sensor::new(64, 48) {
    Some(sensor) => sensor,
    None => panic!("a side is out of range"),
};

/// Returns its events `batch` at a time.
pub(crate) struct MemoryReader {
    events: VecDeque<Event>,
    batch: usize,
    sensor: Sensor,
    skipped: Skipped,
}

impl MemoryReader {
    pub(crate) fn new(events: &[Event], batch: usize) -> Self {
        Self::with_sensor(events, batch, SENSOR)
    }

    pub(crate) fn with_sensor(events: &[Event], batch: usize, sensor: Sensor) -> Self {
        Self {
            events: events.iter().copied().collect(),
            batch,
            sensor,
            skipped: Skipped::default(),
        }
    }
}

impl EventReader for MemoryReader {
    fn format(&self) -> &'static str {
        "memory"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let count = self.batch.min(self.events.len());
        events.extend(self.events.drain(..count));
        Ok(count)
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

pub(crate) fn event(t_us: u64, x: u16, y: u16, on: bool) -> Event {
    Event {
        t_us,
        x,
        y,
        polarity: Polarity::from_bool(on),
    }
}
