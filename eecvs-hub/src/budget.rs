//! Limits for a sensor's link: a token bucket for frames that are sent again, and a rate for the encoder.

use std::time::{Duration, Instant};

/// A bucket of bytes that fills at a rate; a sender that can wait waits while it is overdrawn.
#[derive(Debug, Clone)]
pub struct Bucket {
    /// Rate in bytes per second; `None` for no limit.
    rate: Option<u32>,
    /// Bytes that may be sent now; if negative, bytes sent in advance.
    level: f64,
    filled: Instant,
}

/// Capacity of a bucket, in seconds at its rate.
const HOLDS: f64 = 0.125;

impl Bucket {
    /// Creates a bucket that is full at `now`.
    #[must_use]
    pub fn new(rate: Option<u32>, now: Instant) -> Self {
        Self {
            rate,
            level: rate.map_or(0.0, |rate| f64::from(rate) * HOLDS),
            filled: now,
        }
    }

    /// Changes the rate from `now` on; the level is cut to the new capacity.
    pub fn set_rate(&mut self, rate: Option<u32>, now: Instant) {
        if rate != self.rate {
            self.fill(now);
            self.rate = rate;
            self.level = self.level.min(f64::from(rate.unwrap_or(0)) * HOLDS);
        }
    }

    fn fill(&mut self, now: Instant) {
        let Some(rate) = self.rate.map(f64::from) else {
            return;
        };
        let since_s = now.saturating_duration_since(self.filled).as_secs_f64();
        self.level = (self.level + since_s * rate).min(rate * HOLDS);
        self.filled = now;
    }

    /// Takes bytes that are sent in any case, even if the bucket is overdrawn.
    pub fn take(&mut self, bytes: usize, now: Instant) {
        self.fill(now);
        if self.rate.is_some() {
            self.level -= bytes as f64;
        }
    }

    /// Returns how long to wait before something that can wait may be sent: zero if the bucket is not overdrawn.
    #[must_use]
    pub fn wait(&mut self, now: Instant) -> Duration {
        self.fill(now);
        match self.rate {
            Some(rate) if self.level < 0.0 => {
                Duration::from_secs_f64((-self.level / f64::from(rate.max(1))).min(60.0))
            }
            _ => Duration::ZERO,
        }
    }
}

/// Finds the rate that a link takes: lowers the limit while frames wait for the link, and raises it again
/// afterwards.
///
/// While more bytes wait than [`Governor::WAITING`] and a quarter of a second's bytes, the limit is a fifth less
/// than what the link took. While hardly anything waits, the limit grows by a tenth per step; once it would reach
/// twice what is made, it is dropped.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Governor {
    limit: Option<u32>,
}

impl Governor {
    /// Steps per second.
    pub const STEPS_HZ: u32 = 4;

    /// Bytes that may wait without indicating congestion: some frames.
    pub const WAITING: u64 = 256 << 10;

    /// Lowest limit in bytes per second.
    pub const LEAST: u32 = 32 << 10;

    /// Advances by a step, given the bytes that wait and the bytes sent and made per second; returns the new limit
    /// in bytes per second.
    pub fn step(&mut self, waiting: u64, sent_per_s: u64, made_per_s: u64) -> Option<u32> {
        let sent = u32::try_from(sent_per_s).unwrap_or(u32::MAX);
        if waiting > Self::WAITING.max(sent_per_s / 4) {
            let limit = (sent - sent / 5).max(Self::LEAST);
            self.limit = Some(self.limit.map_or(limit, |before| before.min(limit)));
        } else if let Some(limit) = self.limit
            && waiting < Self::WAITING / 4
        {
            let more = limit.saturating_add(limit / 10);
            self.limit = (u64::from(more)
                < made_per_s.saturating_mul(2).max(u64::from(Self::LEAST) * 2))
            .then_some(more);
        }
        self.limit
    }

    /// Returns the limit in bytes per second, if there is one.
    #[must_use]
    pub const fn limit(&self) -> Option<u32> {
        self.limit
    }
}

/// Returns the lower of two limits, each of which may be absent.
#[must_use]
pub fn least(a: Option<u32>, b: Option<u32>) -> Option<u32> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (limit, None) | (None, limit) => limit,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bucket_lets_its_rate_pass() {
        let start = Instant::now();
        let mut bucket = Bucket::new(Some(1000), start);
        let mut sent = 0;
        for ms in 0..10_000 {
            let now = start + Duration::from_millis(ms);
            while bucket.wait(now).is_zero() {
                bucket.take(10, now);
                sent += 10;
            }
        }
        assert!((10_000..=10_200).contains(&sent), "{sent}");
        // Bytes that are sent in any case leave less for those that can wait.
        let now = start + Duration::from_secs(10);
        bucket.take(1000, now);
        let wait = bucket.wait(now);
        assert!((0.8..1.1).contains(&wait.as_secs_f64()), "{wait:?}");
        bucket.set_rate(None, now);
        assert!(bucket.wait(now).is_zero());
        assert!(Bucket::new(None, start).wait(start).is_zero());
    }

    /// A link that takes 1 MB/s, and a scene that would make 3 MB/s, then 100 kB/s.
    #[test]
    fn the_governor_finds_what_a_link_takes() {
        let mut governor = Governor::default();
        let (mut waiting, mut sent_before) = (0_u64, 0_u64);
        let mut most_waiting = 0;
        let mut run = |steps: u32, scene: u64, governor: &mut Governor, waiting: &mut u64| {
            let mut total = 0;
            for _ in 0..steps {
                let made = scene.min(governor.limit().map_or(u64::MAX, u64::from)) / 4;
                *waiting += made;
                let sent = (*waiting).min(250_000);
                *waiting -= sent;
                sent_before = sent * 4;
                total += sent;
                most_waiting = most_waiting.max(*waiting);
                governor.step(*waiting, sent_before, made * 4);
            }
            total
        };
        run(20, 3_000_000, &mut governor, &mut waiting);
        let sent = run(80, 3_000_000, &mut governor, &mut waiting);
        // 20 s at 1 MB/s.
        assert!(sent >= 15_000_000, "{sent}");
        run(80, 100_000, &mut governor, &mut waiting);
        assert_eq!((governor.limit(), waiting), (None, 0));
        assert!(most_waiting < 2_000_000, "{most_waiting}");
    }

    #[test]
    fn the_lesser_limit_holds() {
        assert_eq!(least(None, None), None);
        assert_eq!(least(Some(3), None), Some(3));
        assert_eq!(least(None, Some(3)), Some(3));
        assert_eq!(least(Some(2), Some(3)), Some(2));
    }
}
