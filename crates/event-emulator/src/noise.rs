//! Seeded random numbers and the arrival times of noise.
//!
//! Random numbers are turned into events with `+ - * /` and `libm` only, so that a seed gives the same numbers on
//! every machine.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// A stream of random numbers. A scene uses one stream per purpose, so that a change to one purpose does not shift
/// the numbers of the others.
#[derive(Debug, Clone)]
pub(super) struct Random(Xoshiro256PlusPlus);

impl Random {
    /// Creates stream number `stream` of `seed`.
    pub(super) fn new(seed: u64, stream: u64) -> Self {
        // An odd multiplier keeps streams of neighbouring seeds apart; the generator's own
        // SplitMix64 then spreads the bits.
        let mixed = seed ^ stream.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        Self(Xoshiro256PlusPlus::seed_from_u64(mixed))
    }

    /// Returns a uniform value in [0, 1), in steps of 2^-24.
    pub(super) fn unit(&mut self) -> f32 {
        (self.0.next_u64() >> 40) as f32 * (1.0 / 16_777_216.0)
    }

    /// Returns a uniform value in [low, high).
    pub(super) fn within(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Returns a uniform integer in 0..n, or 0 if n is 0.
    pub(super) fn below(&mut self, n: u32) -> u32 {
        // The bias of the multiplication is n / 2^32, less than a thousandth for any sensor.
        (((self.0.next_u64() >> 32) * u64::from(n)) >> 32) as u32
    }

    /// Returns a nearly standard normal value within +-3.5: the sum of four uniform values, scaled to variance 1.
    pub(super) fn normal(&mut self) -> f32 {
        let bits = self.0.next_u64();
        let sum: u64 = (0..4).map(|i| (bits >> (16 * i)) & 0xffff).sum();
        // The sum has mean 2 and variance 4/12 in units of 2^16.
        (sum as f32 * (1.0 / 65_536.0) - 2.0) * 1.732_050_8
    }

    /// Returns an exponentially distributed value with the given mean.
    pub(super) fn exponential(&mut self, mean: f64) -> f64 {
        let uniform = ((self.0.next_u64() >> 11) as f64 + 1.0) * (1.0 / 9_007_199_254_740_992.0);
        -libm::log(uniform) * mean
    }
}

/// Poisson arrivals at a fixed rate, produced step by step.
///
/// It stores the remaining wait rather than an absolute time, so that precision does not fall with the length of the
/// scene.
#[derive(Debug, Clone)]
pub(super) struct Arrivals {
    mean_us: f64,
    wait_us: f64,
}

impl Arrivals {
    /// Creates arrivals at `rate_hz`; a rate of 0 gives none.
    pub(super) fn new(rate_hz: f64, random: &mut Random) -> Self {
        let mean_us = if rate_hz > 0.0 {
            1e6 / rate_hz
        } else {
            f64::INFINITY
        };
        Self {
            mean_us,
            wait_us: random.exponential(mean_us),
        }
    }

    /// Returns the next arrival in this step, in us from the step's start; `None` ends the step.
    pub(super) fn next(&mut self, step_us: u32, random: &mut Random) -> Option<u32> {
        let step = f64::from(step_us);
        // The comparison is also false where the wait is infinite or NaN, which ends the step.
        if self.wait_us < step {
            let at = self.wait_us;
            self.wait_us += random.exponential(self.mean_us);
            Some(at as u32)
        } else {
            self.wait_us -= step;
            None
        }
    }
}

/// A pixel that fires spontaneously, mostly ON.
#[derive(Debug, Clone)]
pub(super) struct HotPixel {
    /// Index of the pixel, row by row.
    pub(super) pixel: u32,
    /// Arrival times of its events.
    pub(super) arrivals: Arrivals,
}

/// Draws the hot pixels of a sensor: on average `pixels * share` of them, each at `low_hz` to ten times that rate.
pub(super) fn hot_pixels(
    pixels: u32,
    share: f32,
    low_hz: f32,
    random: &mut Random,
) -> Vec<HotPixel> {
    let expected = f64::from(pixels) * f64::from(share);
    // The fractional part is rounded at random, so that a tiny sensor has a hot pixel now and then.
    let count = (expected + f64::from(random.unit())) as u32;
    (0..count.min(pixels))
        .map(|_| {
            let pixel = random.below(pixels);
            let spread = random.unit();
            let rate_hz = f64::from(low_hz * (1.0 + 9.0 * spread * spread * spread));
            HotPixel {
                pixel,
                arrivals: Arrivals::new(rate_hz, random),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrivals_keep_their_rate_whatever_the_step() {
        for (rate_hz, step_us) in [(50.0, 1_000), (5_000.0, 1_000), (5_000.0, 37)] {
            let mut random = Random::new(3, 0);
            let mut arrivals = Arrivals::new(rate_hz, &mut random);
            let mut count = 0_u32;
            for _ in 0..20_000_000 / step_us {
                while let Some(at) = arrivals.next(step_us, &mut random) {
                    assert!(at < step_us);
                    count += 1;
                }
            }
            let expected = rate_hz * 20.0;
            // Five standard deviations of a Poisson count.
            assert!(
                (f64::from(count) - expected).abs() < 5.0 * expected.sqrt(),
                "{rate_hz} Hz, step {step_us}: {count}, expected {expected}"
            );
        }
    }

    #[test]
    fn no_arrivals_at_rate_zero() {
        let mut random = Random::new(3, 0);
        let mut arrivals = Arrivals::new(0.0, &mut random);
        assert!((0..1_000).all(|_| arrivals.next(1_000, &mut random).is_none()));
    }

    #[test]
    fn normal_has_mean_zero_and_variance_one() {
        let mut random = Random::new(9, 1);
        let values: Vec<f64> = (0..100_000).map(|_| f64::from(random.normal())).collect();
        let mean = values.iter().sum::<f64>() / 1e5;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / 1e5 - mean * mean;
        assert!(mean.abs() < 0.02, "{mean}");
        assert!((variance - 1.0).abs() < 0.03, "{variance}");
    }

    #[test]
    fn below_stays_below() {
        let mut random = Random::new(1, 2);
        assert_eq!(random.below(0), 0);
        for n in [1, 2, 3, 1_000] {
            assert!((0..1_000).all(|_| random.below(n) < n));
        }
    }
}
