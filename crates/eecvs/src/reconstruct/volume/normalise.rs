//! Scales nonzero values to a mean of 0 and a standard deviation of 1.

use super::Volume;

/// The mean to subtract and the deviation to divide by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    mean: f64,
    /// `None` if all values are equal.
    deviation: Option<f64>,
}

impl Scale {
    /// Computes the scale of a volume's nonzero values in f64, in the order of the array: mean = sum v / n,
    /// deviation = sqrt(sum v^2 / n - mean^2).
    pub fn of(volume: &Volume<'_>) -> Self {
        let [channels, height, width] = volume.shape();
        let mut plane = vec![0.0; height * width];
        let (mut count, mut sum, mut squares) = (0_u64, 0.0, 0.0);
        for channel in 0..channels {
            volume.plane(channel, &mut plane);
            for value in plane.iter().filter(|value| **value != 0.0) {
                let value = f64::from(*value);
                count += 1;
                sum += value;
                squares += value * value;
            }
        }
        let count = count.max(1) as f64;
        let mean = sum / count;
        let variance = squares / count - mean * mean;
        // Bound on what rounding alone leaves of a variance of 0.
        let least = f64::EPSILON * 8.0 * mean * mean;
        Self {
            mean,
            deviation: (variance > least).then(|| variance.sqrt()),
        }
    }

    /// Scales the nonzero values of a plane.
    pub fn apply(self, plane: &mut [f32]) {
        for value in plane.iter_mut().filter(|value| **value != 0.0) {
            *value = ((f64::from(*value) - self.mean) / self.deviation.unwrap_or(1.0)) as f32;
        }
    }
}
