//! Rates per second, averaged over the last few seconds.

use std::time::Duration;

use serde::Serialize;

/// Duration of a slot, for which one sum is kept.
const SLOT: Duration = Duration::from_millis(250);

/// Number of sums kept, besides the one still growing: four seconds.
const SLOTS: u64 = 16;

/// Shortest time for a rate: over less, a first frame could give any rate.
const LEAST_S: f64 = 0.5;

/// The amounts that a frame adds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Amount {
    /// Events in the frame.
    pub events: u64,
    /// Bytes of the frame.
    pub bytes: u64,
    /// 1 if a window begins with the frame, else 0.
    pub windows: u64,
    /// Events left out so that the frame fits the budget.
    pub thinned: u64,
}

/// Rates per second.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Rates {
    /// Events.
    pub events_per_s: f64,
    /// Bytes of frames.
    pub bytes_per_s: f64,
    /// Windows.
    pub windows_per_s: f64,
    /// Events that the sensor left out so that frames fit its budget.
    pub thinned_per_s: f64,
    /// Bits per event; `None` if there were no events.
    pub bits_per_event: Option<f64>,
}

/// Sums up amounts over time. Times are relative to any fixed moment.
#[derive(Debug, Clone, Default)]
pub struct Rate {
    sums: [Amount; SLOTS as usize + 1],
    /// Number of the slot that is growing.
    newest: u64,
    first: Option<Duration>,
}

const fn slot(at: Duration) -> u64 {
    (at.as_millis() / SLOT.as_millis()) as u64
}

impl Rate {
    /// Clears the slots that are too old; returns the sum that is growing.
    fn advance(&mut self, at: Duration) -> &mut Amount {
        let now = slot(at).max(self.newest);
        let steps = (now - self.newest).min(SLOTS + 1);
        for step in 0..steps {
            self.sums[((now - step) % (SLOTS + 1)) as usize] = Amount::default();
        }
        self.newest = now;
        &mut self.sums[(now % (SLOTS + 1)) as usize]
    }

    /// Adds the amounts of a frame that arrived at `at`.
    pub fn add(&mut self, at: Duration, amount: Amount) {
        self.first.get_or_insert(at);
        let sum = self.advance(at);
        sum.events += amount.events;
        sum.bytes += amount.bytes;
        sum.windows += amount.windows;
        sum.thinned += amount.thinned;
    }

    /// Returns the rates of the last four seconds, or since the first frame if that is less.
    pub fn over(&mut self, at: Duration) -> Rates {
        self.advance(at);
        let Some(first) = self.first else {
            return Rates::default();
        };
        let oldest = SLOT.as_secs_f64() * self.newest.saturating_sub(SLOTS) as f64;
        let from = first.as_secs_f64().max(oldest);
        let seconds = (at.as_secs_f64() - from).max(LEAST_S);
        let sum = |of: fn(&Amount) -> u64| self.sums.iter().map(of).sum::<u64>() as f64;
        let (events, bytes) = (sum(|sum| sum.events), sum(|sum| sum.bytes));
        Rates {
            events_per_s: events / seconds,
            bytes_per_s: bytes / seconds,
            windows_per_s: sum(|sum| sum.windows) / seconds,
            thinned_per_s: sum(|sum| sum.thinned) / seconds,
            bits_per_event: (events > 0.0).then(|| bytes * 8.0 / events),
        }
    }
}
