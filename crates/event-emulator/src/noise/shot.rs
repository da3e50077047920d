//! Shot noise of the photoreceptor's output.
//!
//! ```text
//! s(I)^2 = s0^2 / (1 + f1/f2)                  variance: white noise of power ~ 1/I through poles f1 ~ I and f2
//! n(I)   = sqrt(f1 f2)                         crossings of the mean per second and direction (Rice)
//! R(I)   = n (e^(-on^2/2s^2) + e^(-off^2/2s^2))  events per second
//! ```
//!
//! In the dark f1 is far below f2 and the variance is s0^2 whatever the light; in good light f2 limits the band, and
//! noise falls with light. A pixel's noise events are a Poisson process of rate R, and each crossing of a signal
//! has noise of standard deviation s.

use core::f32::consts::TAU;

use event_types::Polarity;

use crate::math;
use crate::parameters::PixelParameters;

/// The law of a sensor's shot noise, for pixels whose thresholds are the mean ones.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ShotNoise {
    rms: f32,
    /// on^2 / 2 s0^2 and off^2 / 2 s0^2, or a large number where there is no noise.
    on: f32,
    off: f32,
    /// Second pole, in rad/s.
    second_pole: f32,
}

impl ShotNoise {
    pub(crate) fn new(parameters: &PixelParameters) -> Self {
        let rms = parameters.shot_noise;
        let exponent = |threshold: f64| {
            let ratio = threshold * threshold / (2.0 * rms * rms);
            // Also true of an infinite ratio, without noise.
            if ratio < 1e3 { ratio as f32 } else { 1e3 }
        };
        Self {
            rms: rms as f32,
            on: exponent(parameters.threshold_on),
            off: exponent(parameters.threshold_off),
            second_pole: TAU * parameters.second_corner_hz as f32,
        }
    }

    /// Returns the rate of noise events in 1/s, where the first pole is at `pole` rad/s.
    #[inline(always)]
    pub(crate) fn rate(&self, pole: f32) -> f32 {
        let narrow = 1.0 + pole * (1.0 / self.second_pole);
        let crossings = (pole * self.second_pole).sqrt() * (1.0 / TAU);
        crossings * (math::exp(-self.on * narrow) + math::exp(-self.off * narrow))
    }

    /// Returns whether there are less than 1e-5 noise events per second where the first pole is at `pole` rad/s or above.
    #[inline(always)]
    pub(crate) fn is_silent(&self, pole: f32) -> bool {
        let least = if self.on < self.off {
            self.on
        } else {
            self.off
        };
        // The rate falls from half of the second pole on if on^2 / 2 s0^2 is above 1. Where e^-22 is the exponential,
        // sqrt(f1 f2) is below 22 times the second corner.
        let exponent = least * (1.0 + pole / self.second_pole);
        let corner = self.second_pole * (1.0 / TAU);
        least >= 1e3
            || least > 1.0
                && pole > 0.5 * self.second_pole
                && exponent > 22.0 + math::ln(corner / 300.0 + 1.0)
    }

    /// Returns the standard deviation of the output, in natural log units.
    pub(crate) fn rms(&self, pole: f32) -> f64 {
        f64::from(self.rms / (1.0 + pole / self.second_pole).sqrt())
    }

    /// Returns the polarity of a noise event for a random value in (0, 1).
    pub(crate) fn polarity(&self, pole: f32, unit: f64) -> Polarity {
        let narrow = 1.0 + pole / self.second_pole;
        let (on, off) = (math::exp(-self.on * narrow), math::exp(-self.off * narrow));
        Polarity::from_bool(unit * f64::from(on + off) < f64::from(on))
    }

    /// Returns how many times as often as the mean pixel one of these thresholds fires by noise in the dark, 10^-6 to
    /// 10^6: where it would be more, the mean pixel has no noise to speak of.
    pub(crate) fn factor(&self, on: f32, off: f32) -> f64 {
        if self.rms <= 0.0 {
            return 1.0;
        }
        let variance = 2.0 * f64::from(self.rms) * f64::from(self.rms);
        let share = |threshold: f32| {
            let threshold = f64::from(threshold);
            libm::exp(-(threshold * threshold / variance).min(600.0))
        };
        let mean = libm::exp(-f64::from(self.on)) + libm::exp(-f64::from(self.off));
        ((share(on) + share(off)) / mean.max(1e-300)).clamp(1e-6, 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_the_formula() {
        let parameters = PixelParameters::default();
        let noise = ShotNoise::new(&parameters);
        for lux in [0.0, 0.5, 5.0, 50.0, 500.0] {
            let pole = TAU * (parameters.corner_hz_per_lux * (lux + 0.1)) as f32;
            let (seen, expected) = (f64::from(noise.rate(pole)), parameters.noise_hz(lux));
            assert!(
                (seen - expected).abs() < 1e-4 * expected + 1e-12,
                "{lux}: {seen} {expected}"
            );
            assert!((noise.rms(pole) - parameters.noise_rms(lux)).abs() < 1e-6);
        }
        assert!((noise.factor(0.25, 0.27) - 1.0).abs() < 1e-5);
        assert!(noise.factor(0.2, 0.27) > 3.0);
        let small = PixelParameters {
            shot_noise: 0.03,
            ..parameters
        };
        let noise = ShotNoise::new(&small);
        assert_eq!(noise.factor(0.02, 0.02), 1e6);
        assert_eq!(noise.factor(0.5, 0.5), 1e-6);
    }

    #[test]
    fn without_noise_there_is_no_rate() {
        let noise = ShotNoise::new(&PixelParameters::ideal());
        assert!(noise.rate(10.0) < 1e-30);
        assert_eq!(noise.rms(10.0), 0.0);
    }
}
