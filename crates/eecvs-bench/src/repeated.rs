//! A reader that repeats events, for streams of any length.

use std::ops::Range;

use eecvs_nostd::{Event, Sensor};
use event_files::{BATCH_EVENTS, EventReader, Skipped};

/// Repeats events until it has read a number of them, each time shifted to after the last one.
#[derive(Debug)]
pub struct Repeated<'e> {
    base: &'e [Event],
    sensor: Sensor,
    next: usize,
    later_us: u64,
    count: u64,
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
            count,
            left: count,
            skipped: Skipped::default(),
        }
    }

    /// Returns the time after which the events are repeated.
    fn period_us(&self) -> u64 {
        match (self.base.first(), self.base.last()) {
            (Some(first), Some(last)) => last.t_us - first.t_us + 1,
            _ => 1,
        }
    }

    /// Returns the time after the last event of all.
    #[must_use]
    pub fn end_us(&self) -> u64 {
        let length = self.base.len().max(1) as u64;
        let last = self.count.saturating_sub(1);
        let event = self.base.get((last % length) as usize);
        event.map_or(0, |event| event.t_us + last / length * self.period_us() + 1)
    }

    /// Returns the events of these times, whether they were read or not.
    #[must_use]
    pub fn between(&self, times: &Range<u64>) -> Vec<Event> {
        let first_us = self.base.first().map_or(0, |event| event.t_us);
        let period_us = self.period_us();
        let round = |t_us: u64| t_us.saturating_sub(first_us) / period_us;
        let mut events = Vec::new();
        for round in round(times.start)..=round(times.end) {
            let before = round * self.base.len() as u64;
            let most = self
                .count
                .saturating_sub(before)
                .min(self.base.len() as u64);
            let base = self.base.get(..most as usize).unwrap_or_default();
            let later_us = round * period_us;
            let at = |t_us: u64| base.partition_point(|event| event.t_us + later_us < t_us);
            let inside = base.get(at(times.start)..at(times.end)).unwrap_or_default();
            events.extend(inside.iter().map(|event| Event {
                t_us: event.t_us + later_us,
                ..*event
            }));
        }
        events
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
        if self.base.is_empty() {
            return Ok(0);
        }
        if self.next == self.base.len() {
            self.next = 0;
            self.later_us += self.period_us();
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
