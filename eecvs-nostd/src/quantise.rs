//! Coefficients to integer levels and back.

use core::num::NonZeroU32;

use crate::bits::BitWriter;
use crate::fixed_point::{Coefficient, mul_add};
use crate::packing::Shape;
use crate::prune::Kept;
use crate::transform::Transform;
use crate::transform::dwt::scale_of;

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

    /// log2 of the step in units of 2^-23, 8 to 31: what [`Coefficient::level`] takes.
    #[inline(always)]
    #[must_use]
    pub const fn shift(self) -> u32 {
        (23 + self.step_log2 as i32) as u32
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

/// The levels of a pixel in the order of the link, quantised as they are asked for.
pub trait Levels {
    /// Whether there is none but that of k = 0.
    fn is_empty(&self) -> bool;

    /// How many were cut to 32 bits.
    fn saturated(&self) -> u32 {
        0
    }

    /// Calls `each` with every level but that of k = 0.
    fn for_each(&self, each: impl FnMut(i32));

    /// Puts the low `bits` (1 to 32) of every level but that of k = 0.
    #[inline(always)]
    fn put(&self, bits: u32, writer: &mut BitWriter<'_>) {
        self.for_each(|level| writer.put(level as u32, bits));
    }
}

/// By width, the highest bit of four numbers side by side, of up to 8 bits each.
const HIGHEST: [u32; 16] = {
    let mut highest = [0; 16];
    let mut bits = 1;
    while bits <= 8 {
        highest[bits] = (1 | (1 << bits) | (1 << (2 * bits)) | (1 << (3 * bits))) << (bits - 1);
        bits += 1;
    }
    highest
};

/// `levels` side by side, `bits` of each, which they are in the range of.
#[inline(always)]
fn side_by_side<const N: usize>(levels: [i32; N], bits: u32) -> u32 {
    if (3..=4).contains(&N) && bits <= 8 {
        let all = levels.into_iter().rev();
        let all = all
            .reduce(|all, level| mul_add(all, 1 << (bits & 31), level))
            .unwrap_or(0);
        // A negative level has borrowed from its neighbour, which half of a range more gives back.
        let highest = HIGHEST[bits as usize % 16] >> (((4 - N as u32) * bits) & 31);
        return (all as u32).wrapping_add(highest) ^ highest;
    }
    let mask = !(u32::MAX << (bits & 31));
    let mut all = 0;
    for level in levels.into_iter().rev() {
        all = (all << (bits & 31)) | (level & mask as i32);
    }
    all as u32
}

/// Levels of neighbouring coefficients: the DCT's k = 1..r, or both parts of the DTFT's.
#[derive(Debug, Clone, Copy)]
pub struct Run<'s, C> {
    /// Coefficients from k = 1 on.
    pub sums: &'s [C],
    /// [`Quantiser::shift`].
    pub shift: u32,
}

impl<C: Coefficient> Levels for Run<'_, C> {
    #[inline(always)]
    fn is_empty(&self) -> bool {
        self.sums.is_empty()
    }

    #[inline(always)]
    fn saturated(&self) -> u32 {
        if !C::CAN_SATURATE {
            return 0;
        }
        let cut = self.sums.iter().filter(|sum| sum.is_cut(self.shift));
        cut.count() as u32
    }

    #[inline(always)]
    fn for_each(&self, mut each: impl FnMut(i32)) {
        for sum in self.sums {
            each(sum.level(self.shift));
        }
    }

    #[inline(always)]
    fn put(&self, bits: u32, writer: &mut BitWriter<'_>) {
        let level = |sum: &C| sum.level(self.shift);
        let mut rest = self.sums;
        if bits <= 8 {
            while let Some((four, more)) = rest.split_first_chunk::<4>() {
                writer.put_clean(side_by_side(four.each_ref().map(level), bits), 4 * bits);
                rest = more;
            }
        }
        if bits <= 10 {
            while let Some((three, more)) = rest.split_first_chunk::<3>() {
                writer.put_clean(side_by_side(three.each_ref().map(level), bits), 3 * bits);
                rest = more;
            }
        }
        for sum in rest {
            writer.put(level(sum) as u32, bits);
        }
    }
}

/// Levels of seven sums.
#[derive(Debug, Clone, Copy)]
pub struct Seven<'s> {
    /// Coefficients from k = 1 on, as [`crate::transform::rows`] gives them.
    pub bits: &'s [i32; 7],
    /// What brings these to levels.
    pub shift: u32,
}

impl Seven<'_> {
    /// The first three levels side by side and the other four, of up to 8 `bits` each.
    #[inline(always)]
    #[must_use]
    pub fn side_by_side(&self, bits: u32) -> (u32, u32) {
        let [a, b, c, d, e, f, g] = self.bits.map(|sum| sum >> (self.shift & 31));
        (
            side_by_side([a, b, c], bits),
            side_by_side([d, e, f, g], bits),
        )
    }
}

/// Levels of kept complex coefficients: re and im in turn.
#[derive(Debug, Clone, Copy)]
pub struct Pairs<'s, C> {
    /// K real parts, then K imaginary ones.
    pub sums: &'s [C],
    /// K and the quantiser.
    pub shape: Shape,
    /// Which are sent.
    pub kept: &'s Kept,
}

impl<C: Coefficient> Pairs<'_, C> {
    /// Calls `each` with re and im of every coefficient that is sent but k = 0.
    #[inline(always)]
    fn for_each_pair(&self, mut each: impl FnMut([C; 2])) {
        let (re, im) = self.sums.split_at(self.shape.grid.min(self.sums.len()));
        self.kept.for_each(self.shape.grid, |k| {
            if k > 0
                && let (Some(re), Some(im)) = (re.get(k), im.get(k))
            {
                each([*re, *im]);
            }
        });
    }
}

impl<C: Coefficient> Levels for Pairs<'_, C> {
    #[inline(always)]
    fn is_empty(&self) -> bool {
        self.shape.r <= 1 && self.kept.contains(0)
    }

    #[inline(always)]
    fn saturated(&self) -> u32 {
        let mut cut = 0;
        if C::CAN_SATURATE {
            let shift = self.shape.quantiser.shift();
            self.for_each_pair(|[re, im]| {
                cut += u32::from(re.is_cut(shift)) + u32::from(im.is_cut(shift));
            });
        }
        cut
    }

    #[inline(always)]
    fn for_each(&self, mut each: impl FnMut(i32)) {
        self.for_each_pair(|[re, im]| {
            each(self.shape.quantiser.uniform(re));
            each(self.shape.quantiser.uniform(im));
        });
    }

    #[inline(always)]
    fn put(&self, bits: u32, writer: &mut BitWriter<'_>) {
        if bits > 16 {
            return self.for_each(|level| writer.put(level as u32, bits));
        }
        self.for_each_pair(|pair| {
            let pair = pair.map(|sum| self.shape.quantiser.uniform(sum));
            writer.put_clean(side_by_side(pair, bits), 2 * bits);
        });
    }
}

/// Levels of kept Haar coefficients, of which none is 0: positive ones are moved down by one.
#[derive(Debug, Clone, Copy)]
pub struct Haar<'s, C> {
    /// D_k from k = 0 on.
    pub sums: &'s [C],
    /// K and the quantiser.
    pub shape: Shape,
    /// Which are sent.
    pub kept: &'s Kept,
}

impl<C: Coefficient> Levels for Haar<'_, C> {
    #[inline(always)]
    fn is_empty(&self) -> bool {
        let mut words = self.kept.words(self.shape.grid).iter();
        let first = words.next().copied().unwrap_or(0);
        first <= 1 && words.all(|word| *word == 0)
    }

    #[inline(always)]
    fn for_each(&self, mut each: impl FnMut(i32)) {
        self.kept.for_each(self.shape.grid, |k| {
            if k > 0
                && let Some(sum) = self.sums.get(k)
            {
                let level = self.shape.quantiser.haar(sum.integer(), scale_of(k));
                each(level - i32::from(level > 0));
            }
        });
    }
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

            let difference = (bits >> 23) as i32;
            let scale = scale_of(usize::from(k));
            let re = quantiser.haar(difference, scale);
            let (back, _) = quantiser.dequantise(Transform::Dwt, Level { k, re, im: 0 });
            let exact = f64::from(difference) * libm::sqrt(f64::from(1_u32 << scale));
            prop_assert!((back - exact).abs() <= step / 2.0 + exact.abs() * 1e-15);
            prop_assert!(step > 1.0 || (back - exact).abs() <= exact.abs() * 1e-15);
        }
    }
}
