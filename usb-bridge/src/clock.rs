//! Relates the device's clock to the host's.
//!
//! A transfer arrives some time after its last event: h = o + (1 + e) d + l, where h is the host's time, d the
//! device's time, o the offset, e the drift, and l > 0 the delay that the bus, the kernel and the device's buffers
//! add. As l is never negative, the pairs with the least h - d determine o and e. The pair of least delay in each
//! half second is kept for the last half minute, and a line is fitted to these pairs by least squares.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Span of host time from which one pair is kept.
const BUCKET: Duration = Duration::from_millis(500);
/// Number of pairs kept: half a minute.
const BUCKETS: usize = 60;
/// Fewest pairs for a fit.
const BUCKETS_MIN: usize = 4;
/// Root mean square of the fit's residuals above which the clocks are taken as unrelated, as in a replay that runs
/// faster than real time.
const RESIDUAL_US_MAX: f64 = 5000.0;

/// Host and device time, in microseconds since the first pair.
#[derive(Debug, Clone, Copy)]
struct Pair {
    host_us: f64,
    device_us: f64,
}

impl Pair {
    fn delay_us(self) -> f64 {
        self.host_us - self.device_us
    }
}

/// The line fitted to the least delays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relation {
    /// How much faster the device's clock runs than the host's, in parts per million.
    pub drift_ppm: f64,
    /// Root mean square of the least delays around the line, in microseconds.
    pub residual_us: f64,
    /// Delay on the line at device time 0, counted from the first pair, in microseconds.
    offset_us: f64,
    /// Host microseconds per device microsecond, minus 1.
    slope: f64,
}

/// Estimates the relation between the two clocks.
#[derive(Debug, Default)]
pub struct Clock {
    start: Option<(Instant, u64)>,
    /// Start of each bucket in host microseconds and its pair of least delay, the newest last.
    least: VecDeque<(f64, Pair)>,
    relation: Option<Relation>,
}

impl Clock {
    /// Records that a transfer arrived at `at`, with `device_us` as the last device time in it.
    pub fn note(&mut self, at: Instant, device_us: u64) {
        let (start, device_start_us) = *self.start.get_or_insert((at, device_us));
        let pair = Pair {
            host_us: at.saturating_duration_since(start).as_secs_f64() * 1e6,
            device_us: device_us as f64 - device_start_us as f64,
        };
        match self.least.back_mut() {
            Some((began_us, least)) if pair.host_us - *began_us < BUCKET.as_secs_f64() * 1e6 => {
                if pair.delay_us() < least.delay_us() {
                    *least = pair;
                }
            }
            _ => {
                self.relation = self.fit();
                if self.least.len() == BUCKETS {
                    self.least.pop_front();
                }
                self.least.push_back((pair.host_us, pair));
            }
        }
    }

    /// Fits a line by least squares to the pairs of the complete buckets.
    fn fit(&self) -> Option<Relation> {
        if self.least.len() < BUCKETS_MIN {
            return None;
        }
        let pairs = || self.least.iter().map(|(_, pair)| *pair);
        let n = self.least.len() as f64;
        let mean_d = pairs().map(|pair| pair.device_us).sum::<f64>() / n;
        let mean_l = pairs().map(Pair::delay_us).sum::<f64>() / n;
        let (mut square, mut product) = (0.0, 0.0);
        for pair in pairs() {
            let d = pair.device_us - mean_d;
            square += d * d;
            product += d * (pair.delay_us() - mean_l);
        }
        // Without any progress of the device's time the slope is undefined.
        if square <= 0.0 {
            return None;
        }
        let slope = product / square;
        let offset_us = mean_l - slope * mean_d;
        let left = |pair: Pair| pair.delay_us() - offset_us - slope * pair.device_us;
        let residual_us = (pairs().map(|pair| left(pair).powi(2)).sum::<f64>() / n).sqrt();
        Some(Relation {
            // Host time grows by 1 + slope per device microsecond.
            drift_ppm: -1e6 * slope / (1.0 + slope),
            residual_us,
            offset_us,
            slope,
        })
    }

    /// Returns how the clocks are related; `None` in the first two seconds and while the fit's residuals are too
    /// large.
    #[must_use]
    pub fn relation(&self) -> Option<Relation> {
        self.relation
            .filter(|relation| relation.residual_us <= RESIDUAL_US_MAX)
    }

    /// Returns the device time, in microseconds, of the newest bytes that can have arrived at `at`, assuming the
    /// usual least delay. `None` without a relation.
    #[must_use]
    pub fn device_us(&self, at: Instant) -> Option<u64> {
        let relation = self.relation()?;
        let (start, device_start_us) = self.start?;
        let host_us = at.saturating_duration_since(start).as_secs_f64() * 1e6;
        let device_us = (host_us - relation.offset_us) / (1.0 + relation.slope);
        let device_us = device_start_us as f64 + device_us;
        (device_us >= 0.0).then_some(device_us as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A device that runs `ppm` faster and sends a pair every `every_ms`, delayed by 0 to `jitter_us` - 1 µs.
    fn run(ppm: f64, every_ms: u64, jitter_us: u64, seconds: u64) -> (Clock, Instant) {
        let mut clock = Clock::default();
        let start = Instant::now();
        let mut state = 1_u64;
        let mut at = start;
        for i in 0..seconds * 1000 / every_ms {
            let host_us = i * every_ms * 1000;
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            let delay_us = (state >> 33) % jitter_us.max(1);
            at = start + Duration::from_micros(host_us + delay_us);
            let device_us = 1e12 + host_us as f64 * (1.0 + ppm * 1e-6);
            clock.note(at, device_us as u64);
        }
        (clock, at)
    }

    #[test]
    fn drift_is_found_below_the_jitter() {
        for ppm in [-80.0, 0.0, 12.5, 300.0] {
            let (clock, _) = run(ppm, 5, 4000, 30);
            let relation = clock.relation().unwrap();
            assert!(
                (relation.drift_ppm - ppm).abs() < 6.0,
                "{ppm}: {relation:?}"
            );
        }
    }

    #[test]
    fn device_time_follows_the_host_through_a_silence() {
        let (clock, last) = run(50.0, 5, 2000, 20);
        let later = last + Duration::from_secs(60);
        let host_us = 20_000_000 + 60_000_000 - 5000;
        let expected = 1e12 + f64::from(host_us) * (1.0 + 50e-6);
        let device_us = clock.device_us(later).unwrap();
        assert!(
            (device_us as f64 - expected).abs() < 4000.0,
            "{device_us} {expected}"
        );
    }

    #[test]
    fn a_replay_at_any_speed_is_not_related() {
        let mut clock = Clock::default();
        let start = Instant::now();
        for i in 0..2000_u64 {
            // The ratio of the clocks grows steadily.
            clock.note(start + Duration::from_millis(5 * i), i * i * 40);
        }
        assert!(clock.relation().is_none());
        assert!(clock.device_us(start).is_none());
        assert!(Clock::default().relation().is_none());
    }
}
