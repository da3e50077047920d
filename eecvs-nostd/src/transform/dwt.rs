//! Haar DWT: c_0 = sum_i p_i, c_(2^j + m) = sum_i p_i 2^(j/2) h(2^j u_i - m), the largest kept.

use super::{Basis, Impulse, Rule, Transform};
use crate::fixed_point::{Coefficient, Sum};
use crate::quantise::{Level, Quantiser};

/// The Haar wavelet transform (eq. 6), for sparse windows; h is +1 on [0, 1/2), -1 on [1/2, 1).
///
/// `[Impulse; n] -> [Sum; K]`, K a power of two. The sums hold the integers
/// D_k = c_k / 2^(j/2): a fine histogram and K - 1 butterflies, exact. The irrational scale is
/// left to whoever needs the value, so that pruning compares D^2 2^j, an integer, and ties are
/// exact.
#[derive(Debug, Clone, Copy)]
pub struct Dwt;

/// j of coefficient k = 2^j + m; 0 for k = 0.
#[must_use]
pub const fn scale_of(k: usize) -> u32 {
    if k == 0 { 0 } else { k.ilog2() }
}

impl Basis for Dwt {
    const TRANSFORM: Transform = Transform::Dwt;
    const RULE: Rule = Rule::Magnitude;

    fn accumulate(impulses: &[Impulse], grid: usize, sums: &mut [Sum]) {
        debug_assert!(grid.is_power_of_two());
        let (differences, bins) = sums[..2 * grid].split_at_mut(grid);
        bins.fill(Sum::ZERO);
        // The top bits of an exact phase are the exact bin; checked_shr covers a grid of 1.
        let shift = 32 - grid.trailing_zeros();
        for impulse in impulses {
            let bin = impulse.phase.to_bits().checked_shr(shift).unwrap_or(0) as usize;
            bins[bin] += Sum::from_num(impulse.sign);
        }
        // At scale j the pairs of 2^(j+1) bins become their sum, a bin of the next coarser scale,
        // and their difference, D at k = 2^j + m.
        let mut half = grid / 2;
        while half > 0 {
            for m in 0..half {
                let (first, second) = (bins[2 * m], bins[2 * m + 1]);
                differences[half + m] = first - second;
                bins[m] = first + second;
            }
            half /= 2;
        }
        differences[0] = bins[0];
    }

    #[inline]
    fn magnitude<C: Coefficient>(sums: &[C], _grid: usize, k: usize) -> u64 {
        let difference = sums[k].wide().to_num::<i64>().unsigned_abs();
        (difference * difference) << scale_of(k)
    }

    #[inline]
    fn level<C: Coefficient>(
        sums: &[C],
        _: usize,
        k: usize,
        quantiser: Quantiser,
    ) -> (Level, bool) {
        let (re, saturated) = quantiser.haar(sums[k].wide(), scale_of(k));
        (
            Level {
                k: k as u16,
                re,
                im: 0,
            },
            saturated,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixed_point::Phase;

    fn transform(bins: &[i32]) -> [i32; 8] {
        let mut sums = [Sum::ZERO; 16];
        let mut impulses = heapless::Vec::<Impulse, 64>::new();
        for (bin, count) in bins.iter().enumerate() {
            for _ in 0..count.unsigned_abs() {
                let phase = Phase::from_bits((bin as u32) << 29);
                impulses
                    .push(Impulse {
                        phase,
                        sign: count.signum(),
                    })
                    .unwrap();
            }
        }
        Dwt::accumulate(&impulses, 8, &mut sums);
        core::array::from_fn(|k| sums[k].to_num())
    }

    #[test]
    fn differences_are_those_of_the_definition() {
        assert_eq!(
            transform(&[1, 0, 0, 0, 0, 0, 0, 0]),
            [1, 1, 1, 0, 1, 0, 0, 0]
        );
        assert_eq!(
            transform(&[0, 0, 0, 0, 0, 0, 0, -1]),
            [-1, 1, 0, 1, 0, 0, 0, 1]
        );
        assert_eq!(
            transform(&[1, 2, 3, 4, 5, 6, 7, 8]),
            [36, -16, -4, -4, -1, -1, -1, -1]
        );
    }

    #[test]
    fn magnitudes_are_exact() {
        let sums = [3, -2, 1, 0].map(Sum::from_num::<i32>);
        let magnitude = |k| Dwt::magnitude(&sums, 4, k);
        assert_eq!(
            [magnitude(0), magnitude(1), magnitude(2), magnitude(3)],
            [9, 4, 2, 0]
        );
    }
}
