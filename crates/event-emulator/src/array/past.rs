//! How far a pixel's output is from its reference when its emulation begins.

use crate::math;

/// How often a pixel has fired before the beginning, by cause.
#[derive(Debug, Clone, Copy)]
pub(super) struct Past {
    /// By light that rose and fell.
    pub(super) signal_hz: f64,
    /// By shot noise.
    pub(super) noise_hz: f64,
    /// By leakage, were there nothing else.
    pub(super) leak_hz: f64,
}

impl Past {
    /// Returns how far the output is above the reference, from the thresholds and two random values in (0, 1): between
    /// `-off` and `on`.
    ///
    /// The last event came by the signal with a probability of its rate over that of all. Light that rises and falls has then
    /// taken the output anywhere between the thresholds. Otherwise the output has leaked upwards since an event of noise or
    /// leakage: for a time with the density e^(-noise_hz t), 1/leak_hz at most. A pixel without any is anywhere, too.
    pub(super) fn distance(self, (on, off): (f32, f32), cause: f64, share: f64) -> f32 {
        let at_rest_hz = self.noise_hz + self.leak_hz;
        if at_rest_hz <= 0.0 || cause * (self.signal_hz + at_rest_hz) < self.signal_hz {
            return share as f32 * (on + off) - off;
        }
        if self.leak_hz <= 0.0 {
            return 0.0;
        }
        let noise = (self.noise_hz / self.leak_hz) as f32;
        let share = share as f32;
        // Of little noise the density is even.
        let age = if noise < 0.01 {
            share
        } else {
            -math::ln(1.0 - share * (1.0 - math::exp(-noise))) / noise
        };
        age.clamp(0.0, 1.0) * on
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::Draws;

    const THRESHOLDS: (f32, f32) = (0.2, 0.3);

    /// The mean distance, and the smallest and the largest.
    fn seen(past: Past) -> (f64, f32, f32) {
        let mut draws = Draws::new(1, 1, 1);
        let (mut sum, mut least, mut most) = (0.0, f32::MAX, f32::MIN);
        for _ in 0..100_000 {
            let distance = past.distance(THRESHOLDS, draws.unit(), draws.unit());
            assert!((-0.3..=0.2).contains(&distance));
            sum += f64::from(distance);
            (least, most) = (least.min(distance), most.max(distance));
        }
        (sum / 1e5, least, most)
    }

    #[test]
    fn the_past_says_where_the_output_is() {
        let past = |signal_hz, noise_hz, leak_hz| Past {
            signal_hz,
            noise_hz,
            leak_hz,
        };
        // Leakage alone: evenly from the reference to the ON threshold.
        let (mean, least, most) = seen(past(0.0, 0.0, 0.1));
        assert!((mean - 0.1).abs() < 1e-3 && least >= 0.0 && most > 0.199);
        // A signal, or nothing: evenly between both thresholds.
        for alone in [past(1e9, 1.0, 0.1), past(0.0, 0.0, 0.0)] {
            let (mean, least, most) = seen(alone);
            assert!((mean + 0.05).abs() < 1e-3 && least < -0.299 && most > 0.199);
        }
        // Noise ten times as often as leakage: the mean age is near to a tenth of the time that leakage takes.
        let (mean, least, _) = seen(past(0.0, 1.0, 0.1));
        assert!((mean - 0.02).abs() < 5e-4 && least >= 0.0, "{mean}");
        assert_eq!(seen(past(0.0, 1.0, 0.0)), (0.0, 0.0, 0.0));
        // A signal as often as leakage: half of either.
        let (mean, ..) = seen(past(0.1, 0.0, 0.1));
        assert!((mean - 0.025).abs() < 1e-3, "{mean}");
    }
}
