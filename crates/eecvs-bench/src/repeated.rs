//! A reader that repeats events, for streams of any length.

use eecvs_nostd::{Event, Sensor};
use event_files::{BATCH_EVENTS, EventReader, Skipped};

/// Repeats events until it has read a number of them, each time shifted to after the last one.
#[derive(Debug)]
pub struct Repeated<'e> {
    base: &'e [Event],
    sensor: Sensor,
    next: usize,
    later_us: u64,
    left: u64,
    skipped: Skipped,
}

impl<'e> Repeated<'e> {
    /// Repeats `base`, whose events are in order of time, up to `count` events.
    #[must_use]
    pub fn new(base: &'e [Event], count: u64, sensor: Sensor) -> Self {
        Self {
            base,
            sensor,
            next: 0,
            later_us: 0,
            left: count,
            skipped: Skipped::default(),
        }
    }
}

impl EventReader for Repeated<'_> {
    fn format(&self) -> &'static str {
        "memory"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        let (Some(first), Some(last)) = (self.base.first(), self.base.last()) else {
            return Ok(0);
        };
        if self.next == self.base.len() {
            self.next = 0;
            self.later_us += last.t_us - first.t_us + 1;
        }
        let rest = &self.base[self.next..];
        let left = usize::try_from(self.left).unwrap_or(usize::MAX);
        let count = rest.len().min(BATCH_EVENTS).min(left);
        events.extend(rest[..count].iter().map(|event| Event {
            t_us: event.t_us + self.later_us,
            ..*event
        }));
        self.next += count;
        self.left -= count as u64;
        Ok(count)
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}
