//! Coefficients to integer levels and back.

use crate::fixed_point::{WideSum, round_shift};
use crate::transform::Transform;
use crate::transform::dwt::scale_of;

/// A quantised coefficient. `im` is 0 for real transforms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Level {
    /// Index on the grid.
    pub k: u16,
    /// Real part in steps.
    pub re: i32,
    /// Imaginary part in steps.
    pub im: i32,
}

/// A uniform quantiser whose step is a power of two, D = 2^`step_log2`.
///
/// level = round(c / D), half away from zero; |c - level D| <= D / 2. A Haar coefficient is
/// D_k 2^(j/2) with D_k an integer, so its lattice is quantised instead: level = round(D_k / q_j)
/// with q_j = max(1, floor(D / 2^(j/2))), hence the same bound, and no error at all where
/// D <= 2^(j/2), which for steps up to 1 is everywhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Quantiser {
    step_log2: i8,
}

impl Quantiser {
    /// Finest step: 2^-15.
    pub const STEP_LOG2_MIN: i8 = -15;
    /// Coarsest step: 2^8.
    pub const STEP_LOG2_MAX: i8 = 8;
    /// 2^-6: a single event's time comes back within some 10 us of a 33 ms window.
    pub const DEFAULT: Self = Self { step_log2: -6 };

    /// A quantiser of step 2^`step_log2`, or `None` outside of -15..=8.
    #[must_use]
    pub const fn new(step_log2: i8) -> Option<Self> {
        if step_log2 < Self::STEP_LOG2_MIN || step_log2 > Self::STEP_LOG2_MAX {
            None
        } else {
            Some(Self { step_log2 })
        }
    }

    /// log2 of the step.
    #[must_use]
    pub const fn step_log2(self) -> i8 {
        self.step_log2
    }

    /// round(`coefficient` / step); the flag says that the level did not fit 32 bits.
    #[inline]
    #[must_use]
    pub const fn uniform(self, coefficient: WideSum) -> (i32, bool) {
        let shift = (23 + self.step_log2 as i32) as u32;
        saturate(round_shift(coefficient.to_bits(), shift))
    }

    /// round(`difference` / q_j) for the Haar difference D_k at scale j.
    #[inline]
    #[must_use]
    pub const fn haar(self, difference: WideSum, scale: u32) -> (i32, bool) {
        let difference = difference.to_bits() >> 23;
        let divisor = self.haar_divisor(scale) as i64;
        if divisor == 1 {
            return saturate(difference);
        }
        let magnitude = (difference.unsigned_abs() as i64 + divisor / 2) / divisor;
        saturate(if difference < 0 {
            -magnitude
        } else {
            magnitude
        })
    }

    /// q_j = max(1, floor(2^(step_log2 - j/2))).
    const fn haar_divisor(self, scale: u32) -> u32 {
        // floor(2^(h/2)) for h = 2 step_log2 - j half-octaves, from floor(sqrt(2^h)).
        let half_octaves = 2 * self.step_log2 as i32 - scale as i32;
        if half_octaves <= 0 {
            1
        } else {
            (1_u32 << half_octaves).isqrt()
        }
    }

    /// The coefficient (re, im) that `level` stands for; exact in f64 but for the Haar scale's
    /// square root.
    #[must_use]
    pub fn dequantise(self, transform: Transform, level: Level) -> (f64, f64) {
        match transform {
            Transform::Dct | Transform::Dtft => {
                let step = libm::exp2(f64::from(self.step_log2));
                (f64::from(level.re) * step, f64::from(level.im) * step)
            }
            Transform::Dwt => {
                let scale = scale_of(usize::from(level.k));
                let unit = libm::sqrt(f64::from(1_u32 << scale));
                (
                    f64::from(level.re) * f64::from(self.haar_divisor(scale)) * unit,
                    0.0,
                )
            }
        }
    }
}

const fn saturate(level: i64) -> (i32, bool) {
    if level > i32::MAX as i64 {
        (i32::MAX, true)
    } else if level < i32::MIN as i64 + 1 {
        (i32::MIN + 1, true)
    } else {
        (level as i32, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn levels_at_the_edges() {
        let one = Quantiser::new(0).unwrap();
        for (value, level) in [(0.5, 1), (-0.5, -1), (0.499, 0), (-1.5, -2), (255.0, 255)] {
            assert_eq!(
                one.uniform(WideSum::from_num(value)),
                (level, false),
                "{value}"
            );
        }
        let fine = Quantiser::new(-15).unwrap();
        assert_eq!(fine.uniform(WideSum::from_num(1 << 20)), (i32::MAX, true));
        assert_eq!(fine.uniform(-WideSum::from_num(1 << 20)), (-i32::MAX, true));
        assert_eq!(
            fine.uniform(WideSum::from_num(65_535)),
            (65_535 << 15, false)
        );
        assert!(Quantiser::new(9).is_none() && Quantiser::new(-16).is_none());
    }

    #[test]
    fn haar_divisors_never_exceed_the_step() {
        for step_log2 in Quantiser::STEP_LOG2_MIN..=Quantiser::STEP_LOG2_MAX {
            let quantiser = Quantiser::new(step_log2).unwrap();
            for scale in 0..10 {
                let spacing = libm::exp2(f64::from(scale) / 2.0);
                let divisor = f64::from(quantiser.haar_divisor(scale));
                let step = libm::exp2(f64::from(step_log2));
                assert!(divisor == 1.0 || divisor * spacing <= step * (1.0 + 1e-12));
            }
        }
    }

    proptest! {
        #[test]
        fn errors_are_at_most_half_a_step(
            bits in -(1_i64 << 43)..1 << 43,
            step_log2 in Quantiser::STEP_LOG2_MIN..=Quantiser::STEP_LOG2_MAX,
            k in 0..1024_u16,
        ) {
            let quantiser = Quantiser::new(step_log2).unwrap();
            let step = libm::exp2(f64::from(step_log2));
            let value = WideSum::from_bits(bits);
            let (re, saturated) = quantiser.uniform(value);
            let (back, _) = quantiser.dequantise(Transform::Dct, Level { k, re, im: 0 });
            prop_assert!(saturated || (back - value.to_num::<f64>()).abs() <= step / 2.0);

            let difference = bits >> 23;
            let scale = scale_of(usize::from(k));
            let (re, saturated) = quantiser.haar(WideSum::from_num(difference), scale);
            prop_assert!(!saturated);
            let (back, _) = quantiser.dequantise(Transform::Dwt, Level { k, re, im: 0 });
            let exact = difference as f64 * libm::sqrt(f64::from(1_u32 << scale));
            prop_assert!((back - exact).abs() <= step / 2.0 + exact.abs() * 1e-15);
            prop_assert!(step > 1.0 || (back - exact).abs() <= exact.abs() * 1e-15);
        }
    }
}
