//! Delays in bounded memory, and their quantiles.

/// A histogram of delays in steps of an eighth of a power of two. Quantiles are accurate to a sixteenth of their
/// value (test `quantiles_are_near`).
#[derive(Debug, Clone)]
pub struct Latencies {
    counts: Vec<u64>,
    count: u64,
    max_us: i64,
}

/// Quantiles of delays, in milliseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Quantiles {
    /// The median.
    pub p50_ms: f64,
    /// The 99th percentile.
    pub p99_ms: f64,
    /// The longest delay.
    pub max_ms: f64,
}

/// Steps per power of two.
const STEPS: u32 = 8;

impl Default for Latencies {
    fn default() -> Self {
        Self {
            counts: Vec::new(),
            count: 0,
            max_us: i64::MIN,
        }
    }
}

impl Latencies {
    /// Adds a delay in microseconds. A negative delay, from an offset between clocks that is not known exactly,
    /// counts as 0, except in the maximum.
    pub fn add(&mut self, delay_us: i64) {
        let place = place(delay_us.max(0) as u64);
        if place >= self.counts.len() {
            self.counts.resize(place + 1, 0);
        }
        self.counts[place] += 1;
        self.count += 1;
        self.max_us = self.max_us.max(delay_us);
    }

    /// Adds the delays of another histogram.
    pub fn merge(&mut self, other: &Self) {
        if other.counts.len() > self.counts.len() {
            self.counts.resize(other.counts.len(), 0);
        }
        for (count, more) in self.counts.iter_mut().zip(&other.counts) {
            *count += more;
        }
        self.count += other.count;
        self.max_us = self.max_us.max(other.max_us);
    }

    /// Returns the number of delays.
    #[must_use]
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Returns the delay in microseconds that the given part (0 to 1) of the delays does not exceed, accurate to a
    /// sixteenth; 0 if there are no delays.
    #[must_use]
    pub fn quantile_us(&self, part: f64) -> f64 {
        let rank = ((self.count as f64 * part).ceil() as u64).max(1);
        let mut below = 0;
        for (place, count) in self.counts.iter().enumerate() {
            below += count;
            if below >= rank {
                return middle_us(place).min(self.max_us as f64);
            }
        }
        0.0
    }

    /// Returns the median, 99th percentile and maximum; `None` if there are no delays.
    #[must_use]
    pub fn quantiles(&self) -> Option<Quantiles> {
        (self.count > 0).then(|| Quantiles {
            p50_ms: self.quantile_us(0.5) * 1e-3,
            p99_ms: self.quantile_us(0.99) * 1e-3,
            max_ms: self.max_us as f64 * 1e-3,
        })
    }
}

/// Returns the index of a delay's count: below 8 every microsecond has its own, above that every eighth of a power
/// of two.
const fn place(delay_us: u64) -> usize {
    let bits = u64::BITS - delay_us.leading_zeros();
    if bits <= STEPS.trailing_zeros() {
        return delay_us as usize;
    }
    let shift = bits - 1 - STEPS.trailing_zeros();
    ((shift + 1) * STEPS) as usize + ((delay_us >> shift) as usize - STEPS as usize)
}

fn middle_us(place: usize) -> f64 {
    let steps = STEPS as usize;
    if place < steps {
        return place as f64;
    }
    let shift = (place / steps - 1) as i32;
    let unit = 2f64.powi(shift);
    (steps + place % steps) as f64 * unit + (unit - 1.0) / 2.0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn quantiles_are_near(mut delays in prop::collection::vec(0_i64..10_000_000_000, 1..300)) {
            let mut latencies = Latencies::default();
            let mut other = Latencies::default();
            for (number, delay) in delays.iter().enumerate() {
                if number % 2 == 0 { latencies.add(*delay) } else { other.add(*delay) }
            }
            latencies.merge(&other);
            delays.sort_unstable();
            for part in [0.01, 0.5, 0.9, 0.99, 1.0] {
                let rank = ((delays.len() as f64 * part).ceil() as usize).max(1);
                let exact = delays[rank - 1] as f64;
                let found = latencies.quantile_us(part);
                prop_assert!((found - exact).abs() <= exact / 16.0, "{} {}", found, exact);
            }
            let all = latencies.quantiles().unwrap();
            prop_assert_eq!(all.max_ms, delays[delays.len() - 1] as f64 * 1e-3);
            prop_assert_eq!(latencies.count(), delays.len() as u64);
        }
    }

    #[test]
    fn a_delay_may_seem_negative() {
        let mut latencies = Latencies::default();
        assert_eq!(latencies.quantiles(), None);
        latencies.add(-5000);
        assert_eq!(latencies.quantiles().unwrap().max_ms, -5.0);
        latencies.add(i64::MAX);
        assert_eq!(latencies.count(), 2);
    }
}
