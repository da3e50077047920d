//! What comes in a second, over the last few of them.

use std::time::Duration;

use serde::Serialize;

/// Time that sums are kept for.
const SLOT: Duration = Duration::from_millis(250);

/// Sums kept, beside the one that still grows: four seconds.
const SLOTS: u64 = 16;

/// A rate is not told over less: a first frame would have any.
const LEAST_S: f64 = 0.5;

/// What a frame adds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Amount {
    /// Events in it.
    pub events: u64,
    /// Its bytes.
    pub bytes: u64,
    /// 1 where a window begins with it.
    pub windows: u64,
    /// Events left out of it so that it fits the budget.
    pub thinned: u64,
}

/// What came in a second.
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
    /// Bits for each event; none without events.
    pub bits_per_event: Option<f64>,
}

/// Adds up what comes. Times are since any fixed moment.
#[derive(Debug, Clone, Default)]
pub struct Rate {
    sums: [Amount; SLOTS as usize + 1],
    /// Number of the slot that grows.
    newest: u64,
    first: Option<Duration>,
}

const fn slot(at: Duration) -> u64 {
    (at.as_millis() / SLOT.as_millis()) as u64
}

impl Rate {
    /// Forgets what has become too old; the sum that grows.
    fn advance(&mut self, at: Duration) -> &mut Amount {
        let now = slot(at).max(self.newest);
        let steps = (now - self.newest).min(SLOTS + 1);
        for step in 0..steps {
            self.sums[((now - step) % (SLOTS + 1)) as usize] = Amount::default();
        }
        self.newest = now;
        &mut self.sums[(now % (SLOTS + 1)) as usize]
    }

    /// Adds what came at a moment.
    pub fn add(&mut self, at: Duration, amount: Amount) {
        self.first.get_or_insert(at);
        let sum = self.advance(at);
        sum.events += amount.events;
        sum.bytes += amount.bytes;
        sum.windows += amount.windows;
        sum.thinned += amount.thinned;
    }

    /// The rates of the last four seconds, or since the first came.
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
