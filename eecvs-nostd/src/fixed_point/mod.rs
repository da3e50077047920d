//! Q formats of the signal path, its rounding rule, and its multiplications.
//!
//! | quantity | type | range | resolution |
//! |---|---|---|---|
//! | phase u = (t - t0) / T, a fraction of a turn | [`Phase`] = U0F32 | [0, 1) | 2^-32 |
//! | atom value | [`Atom`] = I2F30 | [-1, 1] | 2^-30 |
//! | sum of up to [`CHUNK_EVENTS`] atoms | [`Sum`] = I7F25 | ±64 | 2^-25 |
//! | sum over a window | [`WideSum`] = I39F25 | ±2^38 | 2^-25 |
//!
//! An atom has the sums' 25 fractional bits from the start ([`dot_add`], one instruction on cores with two 16 x 16
//! multipliers), so sums add without any rounding. The quantiser rounds down, and a level stands for the middle of
//! its step ([`crate::quantise`]).

#[cfg_attr(eecvs_dsp, allow(dead_code))]
mod portable;

#[cfg(eecvs_dsp)]
#[allow(unsafe_code)]
mod armv7em;

#[cfg(eecvs_dsp)]
use armv7em as chosen;
use fixed::types::{I2F30, I7F25, I39F25, U0F32};
#[cfg(not(eecvs_dsp))]
use portable as chosen;

/// Fraction of a turn. It wraps, so that k * phase never drifts.
pub type Phase = U0F32;
/// Value of an atom.
pub type Atom = I2F30;
/// Sum of at most [`CHUNK_EVENTS`] signed atoms.
pub type Sum = I7F25;
/// Sum over all events that a window can hold.
pub type WideSum = I39F25;

/// Number of fractional bits of [`Sum`] and [`WideSum`].
pub const FRACTION_BITS: u32 = 25;

/// Number of events summed at a time: as many as [`Sum`] holds without overflow.
pub const CHUNK_EVENTS: usize = 63;
const _: () = assert!(CHUNK_EVENTS << FRACTION_BITS <= i32::MAX as usize);

/// Returns floor(a b / 2^32).
#[inline(always)]
#[must_use]
pub fn mul_high(a: i32, b: i32) -> i32 {
    chosen::mul_high(a, b)
}

/// Returns a b / 2^32, rounded half up.
#[inline(always)]
#[must_use]
pub fn mul_high_round(a: i32, b: i32) -> i32 {
    chosen::mul_high_round(a, b)
}

/// Returns `sum` + floor(a b / 2^32), wrapping.
#[inline(always)]
#[must_use]
pub fn mul_high_add(sum: i32, a: i32, b: i32) -> i32 {
    chosen::mul_high_add(sum, a, b)
}

/// Returns a b + c, wrapping. Takes one instruction even if b is known to be a power of two.
#[inline(always)]
#[must_use]
pub fn mul_add(a: i32, b: i32, c: i32) -> i32 {
    chosen::mul_add(a, b, c)
}

/// Returns `sum` plus the products of the signed upper halves and of the signed lower halves of `a` and `b`,
/// wrapping.
#[inline(always)]
#[must_use]
pub fn dot_add(sum: i32, a: u32, b: u32) -> i32 {
    chosen::dot_add(sum, a, b)
}

/// Negates both signed halves of `halves` if `negative` is all ones; returns `halves` if `negative` is 0.
#[inline(always)]
#[must_use]
pub fn negate_halves(halves: u32, negative: u32) -> u32 {
    chosen::negate_halves(halves, negative)
}

/// Returns the lesser of the unsigned upper halves, and of the lower halves.
#[inline(always)]
#[must_use]
pub fn least_halves(a: u32, b: u32) -> u32 {
    chosen::least_halves(a, b)
}

/// Returns the greater of the unsigned upper halves, and of the lower halves.
#[inline(always)]
#[must_use]
pub fn most_halves(a: u32, b: u32) -> u32 {
    chosen::most_halves(a, b)
}

/// A coefficient as [`Sum`] or [`WideSum`], with the operations that pruning and quantisation need.
pub trait Coefficient: Copy {
    /// Whether [`Self::is_cut`] can ever return `true`.
    const CAN_SATURATE: bool;

    /// Converts an integer, which must be in range.
    fn from_integer(value: i32) -> Self;

    /// Returns the value in the wider type.
    fn wide(self) -> WideSum;

    /// Returns floor(value / 2^-25 / 2^`shift`), saturated to 32 bits; `shift` is 10 to 33.
    fn level(self, shift: u32) -> i32;

    /// Returns whether [`Self::level`] saturates.
    fn is_cut(self, shift: u32) -> bool;

    /// Returns the integer part, rounded down.
    fn integer(self) -> i32;

    /// Returns whether the value is 0.
    fn is_zero(self) -> bool;

    /// Returns value / 2^`width` with 31 fractional bits, for |value| < n and any count n of `width` bits.
    fn relative(self, width: u32) -> i32;
}

impl Coefficient for Sum {
    const CAN_SATURATE: bool = false;

    #[inline(always)]
    fn from_integer(value: i32) -> Self {
        Self::from_bits(value << FRACTION_BITS)
    }

    #[inline(always)]
    fn wide(self) -> WideSum {
        WideSum::from_bits(i64::from(self.to_bits()))
    }

    #[inline(always)]
    fn level(self, shift: u32) -> i32 {
        // From a shift of 31 on, only the sign is left.
        self.to_bits() >> shift.min(31)
    }

    #[inline(always)]
    fn is_cut(self, _: u32) -> bool {
        false
    }

    #[inline(always)]
    fn is_zero(self) -> bool {
        self.to_bits() == 0
    }

    #[inline(always)]
    fn integer(self) -> i32 {
        self.to_bits() >> FRACTION_BITS
    }

    /// `width` is at most 6, because a chunk holds fewer than 64 events.
    #[inline(always)]
    fn relative(self, width: u32) -> i32 {
        self.to_bits() << (6_u32.wrapping_sub(width) & 31)
    }
}

impl Coefficient for WideSum {
    const CAN_SATURATE: bool = true;

    #[inline]
    fn from_integer(value: i32) -> Self {
        Self::from_bits(i64::from(value) << FRACTION_BITS)
    }

    #[inline]
    fn wide(self) -> WideSum {
        self
    }

    #[inline]
    fn level(self, shift: u32) -> i32 {
        (self.to_bits() >> (shift & 63)).clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
    }

    #[inline]
    fn is_cut(self, shift: u32) -> bool {
        i64::from(self.level(shift)) != self.to_bits() >> (shift & 63)
    }

    #[inline]
    fn integer(self) -> i32 {
        (self.to_bits() >> FRACTION_BITS) as i32
    }

    #[inline]
    fn is_zero(self) -> bool {
        self.to_bits() == 0
    }

    #[inline]
    fn relative(self, width: u32) -> i32 {
        ((self.to_bits() << 6) >> (width & 31)) as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_widths_agree() {
        for value in [-3.75, -1.0, -0.5, -0.0078125, 0.0, 0.25, 0.999, 3.5] {
            let (sum, wide) = (Sum::from_num(value), WideSum::from_num(value));
            assert_eq!(sum.wide(), wide);
            for shift in [10, 19, 25, 31, 33] {
                assert_eq!(sum.level(shift), wide.level(shift), "{value} {shift}");
                assert!(!sum.is_cut(shift) && !wide.is_cut(shift));
            }
            assert_eq!(sum.relative(2), wide.relative(2), "{value}");
            assert_eq!(sum.integer(), wide.integer());
        }
    }

    #[test]
    fn the_largest_values_are_cut_and_told() {
        for (value, level, is_cut) in [
            (65_535, 65_535 << 15, false),
            (65_536, i32::MAX, true),
            (-65_536, i32::MIN, false),
            (-65_537, i32::MIN, true),
        ] {
            let value = WideSum::from_num(value);
            assert_eq!((value.level(10), value.is_cut(10)), (level, is_cut));
        }
        let most = WideSum::from_num((1 << 24) - 1);
        assert_eq!(most.relative(24), ((1 << 24) - 1) << 7);
        assert_eq!((-most).relative(24), -((1 << 24) - 1) << 7);
    }
}
