//! Coefficients to integer levels and back.

use core::num::NonZeroU32;

use crate::fixed_point::{Coefficient, FRACTION_BITS, mul_add};
use crate::transform::haar_scale::scale_of;
use crate::transform::name::Transform;

/// A quantised coefficient. `im` is 0 for real transforms; c_0 = on - off stands as it is.
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

impl Level {
    /// c_0 = 0.
    pub const NONE: Self = Self { k: 0, re: 0, im: 0 };
}

/// A uniform quantiser whose step is a power of two, D = 2^`step_log2`.
///
/// DCT and DTFT: level = floor(c / D) stands for the middle of its step, (level + 1/2) D, so
/// |c - (level + 1/2) D| <= D / 2, and |c| < n takes the levels from -n / D to n / D - 1: with
/// D <= 1, exactly log2(1 / D) + 1 bits for a single event.
///
/// A Haar coefficient is D_k 2^(j/2) with D_k an integer, so its lattice is quantised instead:
/// level = round(D_k / q_j), half away from zero, with q_j = max(1, floor(D / 2^(j/2))), hence the
/// same bound, and no error at all where D <= 2^(j/2), which for steps up to 1 is everywhere.
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

    /// log2 of the step in units of 2^-25, 10 to 33: what [`Coefficient::level`] takes.
    #[inline(always)]
    #[must_use]
    pub const fn shift(self) -> u32 {
        (FRACTION_BITS as i32 + self.step_log2 as i32) as u32
    }

    /// floor(`coefficient` / D), cut to 32 bits.
    #[inline(always)]
    #[must_use]
    pub fn uniform(self, coefficient: impl Coefficient) -> i32 {
        coefficient.level(self.shift())
    }

    /// round(`difference` / q_j) for the Haar difference D_k at scale j, |D_k| < 2^24.
    #[inline]
    #[must_use]
    pub const fn haar(self, difference: i32, scale: u32) -> i32 {
        if self.step_log2 <= 0 {
            return difference;
        }
        // Never 0; the type spares the division its check.
        let Some(divisor) = NonZeroU32::new(self.haar_divisor(scale)) else {
            return difference;
        };
        let half = divisor.get() / 2;
        let magnitude = ((difference.unsigned_abs() + half) / divisor.get()) as i32;
        if difference < 0 {
            -magnitude
        } else {
            magnitude
        }
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
        if level.k == 0 {
            return (f64::from(level.re), 0.0);
        }
        match transform {
            Transform::Dct => (self.middle(level.re), 0.0),
            Transform::Dtft => (self.middle(level.re), self.middle(level.im)),
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

    fn middle(self, level: i32) -> f64 {
        (f64::from(level) + 0.5) * libm::exp2(f64::from(self.step_log2))
    }
}

/// The levels of a pixel in the order of the link, but for that of k = 0: in lent memory of as many
/// numbers as are kept, twice as many of complex ones.
#[derive(Debug)]
pub struct Levels<'l> {
    levels: &'l mut [u32],
    len: usize,
    spread: u32,
    saturated: u32,
}

impl<'l> Levels<'l> {
    /// None yet.
    #[inline(always)]
    #[must_use]
    pub const fn new(levels: &'l mut [u32]) -> Self {
        Self {
            levels,
            len: 0,
            spread: 0,
            saturated: 0,
        }
    }

    /// Adds some; there is room.
    #[inline(always)]
    pub fn push<const N: usize>(&mut self, levels: [i32; N]) {
        let places = self.levels.get_mut(self.len..);
        if let Some(places) = places.and_then(|places| places.first_chunk_mut::<N>()) {
            *places = levels.map(|level| level as u32);
            self.len += N;
        }
        for level in levels {
            self.spread |= (level ^ (level >> 31)) as u32;
        }
    }

    /// Adds floor(sum / D) of each, cut to 32 bits; `shift` is [`Quantiser::shift`].
    #[inline(always)]
    pub fn push_uniform<const N: usize>(&mut self, sums: [impl Coefficient; N], shift: u32) {
        for sum in sums {
            self.saturated += u32::from(sum.is_cut(shift));
        }
        self.push(sums.map(|sum| sum.level(shift)));
    }

    /// All of them, in two's complement.
    #[inline(always)]
    #[must_use]
    pub fn as_slice(&self) -> &[u32] {
        self.levels.get(..self.len).unwrap_or_default()
    }

    /// The bits that are not copies of the sign, of any of them.
    #[inline(always)]
    #[must_use]
    pub const fn spread(&self) -> u32 {
        self.spread
    }

    /// How many were cut to 32 bits.
    #[inline(always)]
    #[must_use]
    pub const fn saturated(&self) -> u32 {
        self.saturated
    }
}

/// `levels` side by side, `bits` of each, which they are in the range of and a word has room for;
/// `highest` has the highest bit of each.
#[inline(always)]
#[must_use]
pub fn side_by_side<const N: usize>(levels: [u32; N], bits: u32, highest: u32) -> u32 {
    let all = levels.into_iter().rev().map(u32::cast_signed);
    let all = all
        .reduce(|all, level| mul_add(all, 1 << (bits & 31), level))
        .unwrap_or(0);
    // A negative level has borrowed from its neighbour, which half of a range more gives back.
    (all as u32).wrapping_add(highest) ^ highest
}

/// The highest bit of each of N numbers side by side, of `bits` each, which a word has room for.
#[inline(always)]
#[must_use]
pub fn highest_bits<const N: usize>(bits: u32) -> u32 {
    let mut highest = 0;
    for _ in 0..N {
        highest = (highest << (bits & 31)) | 1;
    }
    highest << ((bits - 1) & 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixed_point::WideSum;
    use proptest::prelude::*;

    #[test]
    fn levels_at_the_edges() {
        let one = Quantiser::new(0).unwrap();
        for (value, level) in [(0.5, 0), (-0.5, -1), (1.0, 1), (-1.0, -1), (255.0, 255)] {
            assert_eq!(one.uniform(WideSum::from_num(value)), level, "{value}");
        }
        let level = |re| Level { k: 1, re, im: 0 };
        assert_eq!(one.dequantise(Transform::Dct, level(0)), (0.5, 0.0));
        assert_eq!(one.dequantise(Transform::Dtft, level(-1)), (-0.5, 0.5));
        assert_eq!(one.dequantise(Transform::Dwt, level(-1)), (-1.0, 0.0));
        let coarse = Quantiser::new(8).unwrap();
        let zeroth = Level {
            k: 0,
            re: -3,
            im: 0,
        };
        for transform in Transform::ALL {
            assert_eq!(coarse.dequantise(transform, zeroth), (-3.0, 0.0));
        }
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
                assert!(divisor == 1.0 || step_log2 > 0);
            }
        }
    }

    proptest! {
        #[test]
        fn errors_are_at_most_half_a_step(
            bits in -(1_i64 << 43)..1 << 43,
            step_log2 in Quantiser::STEP_LOG2_MIN..=Quantiser::STEP_LOG2_MAX,
            k in 1..1024_u16,
        ) {
            let quantiser = Quantiser::new(step_log2).unwrap();
            let step = libm::exp2(f64::from(step_log2));
            let value = WideSum::from_bits(bits);
            let re = quantiser.uniform(value);
            let (back, _) = quantiser.dequantise(Transform::Dct, Level { k, re, im: 0 });
            let is_cut = value.is_cut(quantiser.shift());
            prop_assert!(is_cut || (back - value.to_num::<f64>()).abs() <= step / 2.0);

            let difference = (bits >> FRACTION_BITS) as i32;
            let scale = scale_of(usize::from(k));
            let re = quantiser.haar(difference, scale);
            let (back, _) = quantiser.dequantise(Transform::Dwt, Level { k, re, im: 0 });
            let exact = f64::from(difference) * libm::sqrt(f64::from(1_u32 << scale));
            prop_assert!((back - exact).abs() <= step / 2.0 + exact.abs() * 1e-15);
            prop_assert!(step > 1.0 || (back - exact).abs() <= exact.abs() * 1e-15);
        }
    }
}
