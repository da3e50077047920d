//! Parameters of a pixel, and the quantities that depend on the light alone: the bandwidth of the photoreceptor,
//! which is proportional to the intensity, and the darkness, which scales noise and jitter.

/// Number of table entries: log intensities from -8 to 8 in steps of 1/64.
const TABLE: usize = 1024;

/// Parameters of a sensor's pixels. Log intensity 0 corresponds to a well-lit room.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelModel {
    /// Mean threshold of ON events, in natural log intensity; positive.
    pub(super) threshold_on: f32,
    /// Mean threshold of OFF events, in natural log intensity; positive.
    pub(super) threshold_off: f32,
    /// Relative standard deviation of the thresholds from pixel to pixel.
    pub(super) mismatch: f32,
    /// Minimum time between two events of a pixel.
    pub(super) refractory_us: u32,
    /// Largest random delay of an event in good light; up to four times as long in the dark.
    pub(super) jitter_us: u32,
    /// Rate of ON events of a pixel in constant light, caused by leakage of its reference level.
    pub(super) leak_hz: f32,
    /// Rates of noise events of a pixel, in good light and in the dark.
    pub(super) noise_hz: (f32, f32),
    /// Bandwidth of the photoreceptor at log intensity 0; it is proportional to the intensity, within limits.
    pub(super) bandwidth_hz: f32,
}

/// Smallest and largest bandwidth: bias currents limit it on both sides.
const BANDWIDTH_HZ: (f32, f32) = (4.0, 2_000.0);

/// Lookup tables of the quantities that depend on the log intensity alone.
#[derive(Debug, Clone)]
pub(super) struct Tables {
    /// Low-pass coefficient: the fraction of the distance to the light covered in one step.
    alpha: [f32; TABLE],
    /// Darkness, from 0 in good light to 1 in the dark.
    dark: [f32; TABLE],
}

impl Tables {
    /// Computes the tables for steps of `step_us`.
    pub(super) fn new(model: &PixelModel, step_us: u32) -> Self {
        let mut alpha = [0.0; TABLE];
        let mut dark = [0.0; TABLE];
        for (i, (alpha, dark)) in alpha.iter_mut().zip(&mut dark).enumerate() {
            let log = (i as f32 + 0.5) / 64.0 - 8.0;
            let bandwidth = (model.bandwidth_hz * libm::expf(log)).clamp(
                BANDWIDTH_HZ.0.min(model.bandwidth_hz),
                BANDWIDTH_HZ.1.max(model.bandwidth_hz),
            );
            let turns = bandwidth * step_us as f32 * 1e-6;
            *alpha = 1.0 - libm::expf(-6.283_185_5 * turns);
            // 0.5 at log intensity -2, about a seventh of the light of a well-lit room.
            *dark = 1.0 / (1.0 + libm::expf(1.5 * (log + 2.0)));
        }
        Self { alpha, dark }
    }

    /// Returns the table index of a log intensity; values outside the table map to the nearest entry.
    pub(super) fn index(log: f32) -> usize {
        // Adding 2^23 leaves the whole part in the low bits, rounded to the nearest: a cast of a bounded number that,
        // unlike `as`, vectorises.
        let bounded = ((log + 8.0) * 64.0 - 0.5).clamp(0.0, (TABLE - 1) as f32);
        (bounded + 8_388_608.0).to_bits() as usize & (TABLE - 1)
    }

    /// Returns the low-pass coefficient of a step, for an index from [`Tables::index`].
    pub(super) fn alpha_at(&self, index: usize) -> f32 {
        self.alpha[index & (TABLE - 1)]
    }

    /// Returns the darkness of a log intensity: 0 in good light to 1 in the dark.
    pub(super) fn dark(&self, log: f32) -> f32 {
        self.dark[Self::index(log)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_the_tables_are_bounded() {
        for log in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30] {
            assert!(Tables::index(log) < TABLE);
        }
        assert_eq!(Tables::index(-8.0), 0);
        assert_eq!(Tables::index(0.008), 512);
        assert_eq!(Tables::index(9.0), TABLE - 1);
    }
}
