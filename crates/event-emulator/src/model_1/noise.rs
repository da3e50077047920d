//! The arrival times of noise.

use crate::random::Random;

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
}
