//! Quantises coefficients to integer levels and dequantises them.

use core::num::NonZeroU32;

use crate::fixed_point::{Coefficient, FRACTION_BITS, mul_add};
use crate::transform::haar_scale::scale_of;
use crate::transform::name::Transform;

/// A quantised coefficient. `im` is 0 for real transforms. c_0 = on - off is an integer and is not quantised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Level {
    /// Index k of the coefficient, below K.
    pub k: u16,
    /// Real part, in steps.
    pub re: i32,
    /// Imaginary part, in steps.
    pub im: i32,
}

impl Level {
    /// A placeholder: the level of c_0 = 0.
    pub const NONE: Self = Self { k: 0, re: 0, im: 0 };
}

/// A uniform quantiser whose step is a power of two, D = 2^`step_log2`.
///
/// DCT and DTFT: level = floor(c / D), which stands for the middle of its step, (level + 1/2) D, so that
/// |c - (level + 1/2) D| <= D / 2. As |c| < n, levels lie between -n / D and n / D - 1; with D <= 1 a level of a
/// single event takes exactly log2(1 / D) + 1 bits.
///
/// Haar: a coefficient is D_k 2^(j/2) with an integer D_k, so D_k is quantised instead: level = round(D_k / q_j),
/// half away from zero, with q_j = max(1, floor(D / 2^(j/2))). The same error bound holds. There is no error at
/// all where D <= 2^(j/2), which holds at every scale for D <= 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Quantiser {
    step_log2: i8,
}

impl Quantiser {
    /// log2 of the finest step, 2^-15.
    pub const STEP_LOG2_MIN: i8 = -15;
    /// log2 of the coarsest step, 2^8.
    pub const STEP_LOG2_MAX: i8 = 8;
    /// The default step, 2^-6: a single event's time is decoded to within some 10 us in a window of 33 ms.
    pub const DEFAULT: Self = Self { step_log2: -6 };

    /// Returns a quantiser of step 2^`step_log2`, or `None` outside of -15..=8.
    #[must_use]
    pub const fn new(step_log2: i8) -> Option<Self> {
        if step_log2 < Self::STEP_LOG2_MIN || step_log2 > Self::STEP_LOG2_MAX {
            None
        } else {
            Some(Self { step_log2 })
        }
    }

    /// Returns log2 of the step D, -15 to 8.
    #[must_use]
    pub const fn step_log2(self) -> i8 {
        self.step_log2
    }

    /// Returns log2 of the step in units of 2^-25, 10 to 33: the shift that [`Coefficient::level`] takes.
    #[inline(always)]
    #[must_use]
    pub const fn shift(self) -> u32 {
        (FRACTION_BITS as i32 + self.step_log2 as i32) as u32
    }

    /// Returns floor(`coefficient` / D), saturated to 32 bits.
    #[inline(always)]
    #[must_use]
    pub fn uniform(self, coefficient: impl Coefficient) -> i32 {
        coefficient.level(self.shift())
    }

    /// Returns the level round(`difference` / q_j) of the Haar difference D_k at scale j, |D_k| < 2^24.
    #[inline]
    #[must_use]
    pub const fn haar(self, difference: i32, scale: u32) -> i32 {
        if self.step_log2 <= 0 {
            return difference;
        }
        // Never 0; the type saves the division's check.
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

    /// Returns q_j = max(1, floor(2^(step_log2 - j/2))).
    const fn haar_divisor(self, scale: u32) -> u32 {
        // floor(2^(h/2)) for h = 2 step_log2 - j half-octaves, from floor(sqrt(2^h)).
        let half_octaves = 2 * self.step_log2 as i32 - scale as i32;
        if half_octaves <= 0 {
            1
        } else {
            (1_u32 << half_octaves).isqrt()
        }
    }

    /// Returns the coefficient (re, im) that `level` stands for. Exact in f64, except for the square root in the
    /// Haar scale.
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
        // 2^step_log2, whose exponent is all that differs from 1.
        let exponent = 1023 + i64::from(self.step_log2);
        (f64::from(level) + 0.5) * f64::from_bits((exponent as u64) << 52)
    }
}

/// The levels of one pixel in the order in which they are sent, without that of k = 0.
///
/// The lent memory needs one number per kept coefficient, two for a complex transform.
#[derive(Debug)]
pub struct Levels<'l> {
    levels: &'l mut [u32],
    len: usize,
    spread: u32,
    saturated: u32,
}

impl<'l> Levels<'l> {
    /// Starts an empty list in `levels`.
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

    /// Appends levels. If there is no room, they only count towards [`Self::spread`].
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

    /// Appends floor(sum / D) of each sum, saturated to 32 bits. `shift` is [`Quantiser::shift`].
    #[inline(always)]
    pub fn push_uniform<const N: usize>(&mut self, sums: [impl Coefficient; N], shift: u32) {
        for sum in sums {
            self.saturated += u32::from(sum.is_cut(shift));
        }
        self.push(sums.map(|sum| sum.level(shift)));
    }

    /// Returns all levels in two's complement.
    #[inline(always)]
    #[must_use]
    pub fn as_slice(&self) -> &[u32] {
        self.levels.get(..self.len).unwrap_or_default()
    }

    /// Returns a mask of the bits that differ from the sign bit in at least one level.
    #[inline(always)]
    #[must_use]
    pub const fn spread(&self) -> u32 {
        self.spread
    }

    /// Returns how many levels were saturated to 32 bits.
    #[inline(always)]
    #[must_use]
    pub const fn saturated(&self) -> u32 {
        self.saturated
    }
}

/// Packs N levels of `bits` bits each into a word, the first level lowest.
///
/// Each level must fit `bits` bits, and N * `bits` must fit a word. `highest` is [`highest_bits`] of the same N
/// and `bits`.
#[inline(always)]
#[must_use]
pub fn side_by_side<const N: usize>(levels: [u32; N], bits: u32, highest: u32) -> u32 {
    let all = levels.into_iter().rev().map(u32::cast_signed);
    let all = all
        .reduce(|all, level| mul_add(all, 1 << (bits & 31), level))
        .unwrap_or(0);
    // A negative level has borrowed from the field above it. Adding half of the range to each field and flipping
    // each field's highest bit undoes the borrow.
    (all as u32).wrapping_add(highest) ^ highest
}

/// Returns a word in which the highest bit of each of N fields of `bits` bits is set; N * `bits` must fit a word.
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
