//! The link to the host: so many events per microsecond, and a buffer for those that wait.

use super::parameters::ReadoutParameters;

/// The buffer before a link, which empties evenly.
#[derive(Debug, Clone)]
pub(super) struct Link {
    per_ns: f64,
    room: f64,
    /// Events in the buffer at a time.
    level: f64,
    at_ns: f64,
    lost: u64,
}

impl Link {
    pub(super) fn new(parameters: &ReadoutParameters) -> Self {
        Self {
            per_ns: parameters.link_per_us * 1e-3,
            room: parameters.buffer_events,
            level: 0.0,
            at_ns: 0.0,
            lost: 0,
        }
    }

    /// Takes an event at a time, which is none before the last; returns whether there was room for it.
    pub(super) fn takes(&mut self, at_ns: f64) -> bool {
        let sent = (at_ns - self.at_ns) * self.per_ns;
        self.level = (self.level - sent).max(0.0);
        self.at_ns = at_ns;
        if self.level + 1.0 > self.room {
            self.lost += 1;
            return false;
        }
        self.level += 1.0;
        true
    }

    pub(super) fn lost(&self) -> u64 {
        self.lost
    }
}
