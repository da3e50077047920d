//! A reader of events in memory.

use super::{BATCH_EVENTS, EventReader, Result, Skipped};
use crate::{Event, Sensor};

/// A reader of events that are held in memory.
///
/// ```
/// use event_types::stream::{EventReader, MemoryReader};
/// use event_types::{Event, Polarity, Sensor};
///
/// let sensor = Sensor::new(8, 8).expect("sides from 1 to 2048");
/// let event = |t_us| Event { t_us, x: 3, y: 5, polarity: Polarity::On };
/// let mut reader = MemoryReader::new(sensor, (0..100).map(event).collect());
/// let mut events = Vec::new();
/// while reader.read(&mut events)? > 0 {}
/// assert_eq!(events.len(), 100);
/// # Ok::<(), event_types::stream::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MemoryReader {
    sensor: Sensor,
    events: Vec<Event>,
    /// Number of events returned so far.
    used: usize,
    batch: usize,
    skipped: Skipped,
}

impl MemoryReader {
    /// Creates a reader of `events`, in their order; it does not check that they lie inside the sensor.
    #[must_use]
    pub fn new(sensor: Sensor, events: Vec<Event>) -> Self {
        Self {
            sensor,
            events,
            used: 0,
            batch: BATCH_EVENTS,
            skipped: Skipped::default(),
        }
    }

    /// Sets how many events one call returns at most, clamped to 1 to [`BATCH_EVENTS`].
    #[must_use]
    pub fn in_batches(self, batch: usize) -> Self {
        Self {
            batch: batch.clamp(1, BATCH_EVENTS),
            ..self
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
        let rest = self.events.get(self.used..).unwrap_or_default();
        let batch = rest.get(..self.batch).unwrap_or(rest);
        events.extend_from_slice(batch);
        self.used += batch.len();
        Ok(batch.len())
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}
