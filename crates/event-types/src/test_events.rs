//! Events and readers of events for the tests of other crates; needs the feature `test-events`.

use crate::stream::MemoryReader;
use crate::{Event, Polarity, Sensor};

/// The tests' sensor: 64 x 48 pixels.
pub const SENSOR: Sensor = match Sensor::new(64, 48) {
    Some(sensor) => sensor,
    None => panic!("a side is out of range"),
};

/// Returns a reader of `events` on [`SENSOR`] that gives `batch` events at a time.
#[must_use]
pub fn reader(events: &[Event], batch: usize) -> MemoryReader {
    MemoryReader::new(SENSOR, events.to_vec()).in_batches(batch)
}

/// Returns an event whose polarity is `On` if `on` is true.
#[must_use]
pub const fn event(t_us: u64, x: u16, y: u16, on: bool) -> Event {
    Event {
        t_us,
        x,
        y,
        polarity: Polarity::from_bool(on),
    }
}
