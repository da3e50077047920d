//! Q formats of the signal path, and the rounding rule.
//!
//! | quantity | type | range | resolution |
//! |---|---|---|---|
//! | phase u = (t - t0) / T, a fraction of a turn | [`Phase`] = U0F32 | [0, 1) | 2^-32, exact floor |
//! | atom value | [`Atom`] = I1F15 | [-1, 1 - 2^-15] | 2^-15 |
//! | sum of up to [`CHUNK_EVENTS`] atoms | [`Sum`] = I9F23 | ±256 | 2^-23 |
//! | sum over a window | [`WideSum`] = I41F23 | ±2^40 | 2^-23 |
//!
//! An interpolated atom is a 16-bit table value times an 8-bit weight, so it is exact in 23
//! fractional bits: the sums add without any rounding, and the only rounding of the path is the
//! quantiser's (half away from zero, [`round_shift`]).

use fixed::types::{I1F15, I9F23, I41F23, U0F32};

/// Fraction of a turn; wraps, so that k * phase never drifts.
pub type Phase = U0F32;
/// Value of an atom.
pub type Atom = I1F15;
/// Exact sum of at most [`CHUNK_EVENTS`] signed atoms.
pub type Sum = I9F23;
/// Exact sum over all events that a window can hold.
pub type WideSum = I41F23;

/// Events whose atoms, each at most 1 in magnitude, [`Sum`] holds without overflow.
pub const CHUNK_EVENTS: usize = 255;

/// A coefficient in either width: what pruning and quantising need of it.
pub trait Coefficient: Copy {
    /// The value with 23 fractional bits.
    fn wide(self) -> WideSum;

    /// re^2 + im^2, in an order-preserving scale that fits 64 bits.
    fn energy(re: Self, im: Self) -> u64;
}

impl Coefficient for Sum {
    #[inline]
    fn wide(self) -> WideSum {
        WideSum::from_bits(i64::from(self.to_bits()))
    }

    /// 46 fractional bits, exact: |c| < 2^8, so the sum of the squares is below 2^63.
    #[inline]
    fn energy(re: Self, im: Self) -> u64 {
        square(re.to_bits()) + square(im.to_bits())
    }
}

#[inline]
fn square(bits: i32) -> u64 {
    let magnitude = u64::from(bits.unsigned_abs());
    magnitude * magnitude
}

impl Coefficient for WideSum {
    #[inline]
    fn wide(self) -> WideSum {
        self
    }

    /// 15 fractional bits: a window holds fewer than 2^24 events, so |c|^2 < 2^48. What is cut
    /// moves |c| by less than 2^-7, half of the error bound of a pixel with that many events.
    #[inline]
    fn energy(re: Self, im: Self) -> u64 {
        let square = |bits: i64| {
            let magnitude = u128::from(bits.unsigned_abs());
            magnitude * magnitude
        };
        let sum = (square(re.to_bits()) + square(im.to_bits())) >> 31;
        u64::try_from(sum).unwrap_or(u64::MAX)
    }
}

/// `value` / 2^`shift`, rounded half away from zero.
///
/// `shift` is 0 to 62 and `|value|` below 2^62.
#[inline]
#[must_use]
pub const fn round_shift(value: i64, shift: u32) -> i64 {
    if shift == 0 {
        return value;
    }
    let magnitude = (value.unsigned_abs() + (1 << (shift - 1))) >> shift;
    let magnitude = magnitude as i64;
    if value < 0 { -magnitude } else { magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_half_away_from_zero() {
        for (value, shift, expected) in [
            (0, 3, 0),
            (4, 3, 1),
            (3, 3, 0),
            (-4, 3, -1),
            (-3, 3, 0),
            (12, 3, 2),
            (-12, 3, -2),
            (7, 0, 7),
            (i64::from(i32::MIN), 23, -256),
        ] {
            assert_eq!(round_shift(value, shift), expected, "{value} >> {shift}");
        }
    }

    #[test]
    fn energy_of_a_full_chunk_fits() {
        let full = Sum::from_num(CHUNK_EVENTS as i32);
        assert_eq!(
            Coefficient::energy(full, full),
            2 * (u64::from(CHUNK_EVENTS as u32) << 23).pow(2)
        );
        let most = WideSum::from_num(1_i64 << 24);
        assert_eq!(Coefficient::energy(most, WideSum::ZERO), 1 << 63);
    }
}
