//! Seeded random numbers.
//!
//! Random numbers are turned into events with `+ - * /` and `libm` only, so that a seed gives the same numbers on
//! every machine.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// A stream of random numbers. A scene uses one stream per purpose, so that a change to one purpose does not shift
/// the numbers of the others.
#[derive(Debug, Clone)]
pub(crate) struct Random(Xoshiro256PlusPlus);

impl Random {
    /// Creates stream number `stream` of `seed`.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        // An odd multiplier keeps streams of neighbouring seeds apart; the generator's own
        // SplitMix64 then spreads the bits.
        let mixed = seed ^ stream.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        Self(Xoshiro256PlusPlus::seed_from_u64(mixed))
    }

    /// Returns a uniform value in [0, 1), in steps of 2^-24.
    pub(crate) fn unit(&mut self) -> f32 {
        (self.0.next_u64() >> 40) as f32 * (1.0 / 16_777_216.0)
    }

    /// Returns a uniform value in [low, high).
    pub(crate) fn within(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Returns a uniform integer in 0..n, or 0 if n is 0.
    pub(crate) fn below(&mut self, n: u32) -> u32 {
        // The bias of the multiplication is n / 2^32, less than a thousandth for any sensor.
        (((self.0.next_u64() >> 32) * u64::from(n)) >> 32) as u32
    }

    /// Returns a nearly standard normal value within +-3.5: the sum of four uniform values, scaled to variance 1.
    pub(crate) fn normal(&mut self) -> f32 {
        let bits = self.0.next_u64();
        let sum: u64 = (0..4).map(|i| (bits >> (16 * i)) & 0xffff).sum();
        // The sum has mean 2 and variance 4/12 in units of 2^16.
        (sum as f32 * (1.0 / 65_536.0) - 2.0) * 1.732_050_8
    }

    /// Returns an exponentially distributed value with the given mean.
    pub(crate) fn exponential(&mut self, mean: f64) -> f64 {
        let uniform = ((self.0.next_u64() >> 11) as f64 + 1.0) * (1.0 / 9_007_199_254_740_992.0);
        -libm::log(uniform) * mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
