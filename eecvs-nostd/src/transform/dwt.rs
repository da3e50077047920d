//! Haar DWT: c_0 = sum_i p_i, c_(2^j + m) = sum_i p_i 2^(j/2) h(2^j u_i - m), the largest kept.

use core::cell::Cell;

use super::{Basis, Impulse, Oscillators, Rule, Transform};
use crate::fixed_point::{CHUNK_EVENTS, Sum};
use crate::phase::PhaseScale;
use crate::quantise::{Level, Quantiser};

/// The Haar wavelet transform (eq. 6), for sparse windows; h is +1 on [0, 1/2), -1 on [1/2, 1).
///
/// `[Impulse; n] -> [Sum; K]`, K a power of two. The sums hold the integers
/// D_k = c_k / 2^(j/2), |D_k| <= n: a fine histogram and K - 1 butterflies, exact. The irrational
/// scale is left to whoever needs the value, so that pruning compares D^2 2^j, an integer, and ties
/// are exact.
#[derive(Debug, Clone, Copy)]
pub struct Dwt;

/// j of coefficient k = 2^j + m; 0 for k = 0.
#[inline(always)]
#[must_use]
pub const fn scale_of(k: usize) -> u32 {
    if k == 0 { 0 } else { k.ilog2() }
}

impl Basis for Dwt {
    const TRANSFORM: Transform = Transform::Dwt;
    const RULE: Rule = Rule::Magnitude;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        _: u32,
        scale: PhaseScale,
        grid: usize,
        _: &mut Oscillators,
        sums: &mut [Sum],
    ) {
        debug_assert!(grid.is_power_of_two());
        let (differences, bins) = sums.split_at_mut_checked(grid).unwrap_or_default();
        let bins = bins.get_mut(..grid).unwrap_or_default();
        bins.fill(Sum::ZERO);
        let bins_log2 = grid.trailing_zeros();
        for impulse in impulses.take(CHUNK_EVENTS) {
            let bin = scale.bin(impulse.offset_us, bins_log2) as usize;
            // Always there: the offset is below T.
            if let Some(sum) = bins.get_mut(bin) {
                *sum += if impulse.is_on {
                    Sum::ONE
                } else {
                    Sum::NEG_ONE
                };
            }
        }
        // At scale j the pairs of 2^(j+1) bins become their sum, a bin of the next coarser scale,
        // and their difference, D at k = 2^j + m.
        let bins = Cell::from_mut(bins).as_slice_of_cells();
        let (pairs, _) = bins.as_chunks::<2>();
        let mut half = grid / 2;
        while half > 0 {
            let differences = differences.get_mut(half..2 * half).unwrap_or_default();
            for ((bin, [first, second]), difference) in bins.iter().zip(pairs).zip(differences) {
                let (first, second) = (first.get(), second.get());
                *difference = first - second;
                bin.set(first + second);
            }
            half /= 2;
        }
    }
}

/// A number that orders coefficients as |D_k| 2^(j/2) does, ties exact; |D_k| < 2^24, j < 10.
///
/// |D| 2^(j/2) is A for even j and B sqrt 2 for odd j, with integers A, B < 2^29; as sqrt 2 is
/// irrational, A against B sqrt 2 is 2 A against 2 floor(B sqrt 2) + 1.
#[must_use]
pub fn magnitude(difference: i32, k: usize) -> u32 {
    let scale = scale_of(k);
    let whole = difference.unsigned_abs() << (scale / 2);
    if scale.is_multiple_of(2) || whole == 0 {
        2 * whole
    } else {
        let square = |x: u64| x * x;
        // sqrt 2 with 31 fractional bits, rounded down: the product is less than 1/4 too low.
        let low = (u64::from(whole) * 3_037_000_499) >> 31;
        let is_low = square(low + 1) <= 2 * square(u64::from(whole));
        2 * (low as u32 + u32::from(is_low)) + 1
    }
}

/// The same for |D_k| < 256: D_k^2 2^j.
#[inline(always)]
#[must_use]
pub fn small_magnitude(difference: i32, k: usize) -> u32 {
    (difference * difference).unsigned_abs() << scale_of(k)
}

/// The coefficients of a pixel with one event follow from its bin: those of the atoms that hold
/// it, +-2^(j/2) and so in the order of their scales, the finest first; c_0 = +-1 before c_1.
///
/// Whether the finest is kept and its level is not 0, so that it tells the bin, and the bin all of
/// them.
#[inline(always)]
#[must_use]
pub const fn bin_is_told((grid_log2, r): (u32, u32), quantiser: Quantiser) -> bool {
    let is_kept = grid_log2 > 1 || (grid_log2 == 1 && r > 1);
    is_kept && quantiser.haar(1, grid_log2 - 1) != 0
}

/// Calls `each` with the kept levels of a pixel with one event `sign` in `bin`, k ascending.
pub fn single_levels(
    bin: u32,
    sign: i32,
    (grid_log2, r): (u32, u32),
    quantiser: Quantiser,
    mut each: impl FnMut(Level),
) {
    if r >= grid_log2 {
        each(Level {
            k: 0,
            re: sign,
            im: 0,
        });
    }
    // c_1 ties with c_0, which stays if there is room for one of them.
    let coarsest = if r > grid_log2 {
        0
    } else {
        grid_log2.saturating_sub(r).max(1)
    };
    for scale in coarsest..grid_log2 {
        let below = grid_log2 - scale;
        let is_first_half = (bin >> (below - 1)) & 1 == 0;
        let re = quantiser.haar(if is_first_half { sign } else { -sign }, scale);
        if re != 0 {
            let k = ((1 << scale) + (bin >> below)) as u16;
            each(Level { k, re, im: 0 });
        }
    }
}

/// The bin whose [`single_levels`] end with `finest`, of the finest scale.
#[must_use]
pub fn bin_of(finest: Level, sign: i32, grid_log2: u32) -> u32 {
    let first = u32::from(finest.k).saturating_sub(1 << grid_log2.saturating_sub(1)) << 1;
    first + u32::from((finest.re < 0) == (sign > 0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// One impulse per count of each of 8 bins of a window of 8 us.
    fn transform(bins: &[i32]) -> [i32; 8] {
        let impulses: Vec<Impulse> = bins
            .iter()
            .enumerate()
            .flat_map(|(bin, count)| {
                let impulse = Impulse {
                    offset_us: bin as u32,
                    is_on: *count > 0,
                };
                std::iter::repeat_n(impulse, count.unsigned_abs() as usize)
            })
            .collect();
        let mut sums = [Sum::ZERO; 16];
        let scale = PhaseScale::new(8);
        Dwt::accumulate(
            impulses.iter().copied(),
            impulses.len() as u32,
            scale,
            8,
            &mut Oscillators::new(),
            &mut sums,
        );
        sums[0] = Sum::from_num(bins.iter().sum::<i32>());
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
    fn magnitudes_order_exactly() {
        let square = |d: i64, k: usize| (d * d) << scale_of(k);
        let numbers = [0, 1, 2, 3, 5, 7, 12, 17, 29, 41, 99, 140, 255];
        let large = [(1 << 24) - 1, 11_863_283, 8_388_608, 5_931_641];
        for ks in [[0, 1, 2, 4], [8, 16, 32, 64], [128, 256, 512, 1023]] {
            for (a, j) in numbers
                .iter()
                .chain(&large)
                .flat_map(|d| ks.map(|k| (*d, k)))
            {
                for (b, k) in numbers
                    .iter()
                    .chain(&large)
                    .flat_map(|d| ks.map(|k| (*d, k)))
                {
                    let exact = square(i64::from(a), j).cmp(&square(i64::from(b), k));
                    assert_eq!(
                        magnitude(a, j).cmp(&magnitude(-b, k)),
                        exact,
                        "{a} {j} {b} {k}"
                    );
                    if a < 256 && b < 256 {
                        assert_eq!(small_magnitude(a, j).cmp(&small_magnitude(-b, k)), exact);
                    }
                }
            }
        }
    }

    /// By the definition: transform one event, sort stably by magnitude, quantise, drop zeros.
    fn expected(bin: u32, sign: i32, grid_log2: u32, r: usize, quantiser: Quantiser) -> Vec<Level> {
        let grid = 1 << grid_log2;
        let mut sums = std::vec![Sum::ZERO; 2 * grid];
        let impulse = Impulse {
            offset_us: bin,
            is_on: sign > 0,
        };
        let scale = PhaseScale::new(grid as u32);
        Dwt::accumulate(
            [impulse].into_iter(),
            1,
            scale,
            grid,
            &mut Oscillators::new(),
            &mut sums,
        );
        sums[0] = Sum::from_num(sign);
        let mut order: Vec<usize> = (0..grid).collect();
        order.sort_by_key(|k| std::cmp::Reverse(magnitude(sums[*k].to_num(), *k)));
        order.truncate(r);
        order.sort_unstable();
        let level = |k: usize| Level {
            k: k as u16,
            re: if k == 0 {
                sign
            } else {
                quantiser.haar(sums[k].to_num(), scale_of(k))
            },
            im: 0,
        };
        order
            .into_iter()
            .map(level)
            .filter(|level| level.re != 0)
            .collect()
    }

    #[test]
    fn a_single_events_levels_follow_from_its_bin() {
        for grid_log2 in 0..=10 {
            for bin in (0..1_u32 << grid_log2).step_by(if grid_log2 > 6 { 37 } else { 1 }) {
                for (r, step_log2) in [(1, -6), (3, 0), (4, 2), (5, 3), (8, 4), (11, 8), (64, 1)] {
                    let quantiser = Quantiser::new(step_log2).unwrap();
                    for sign in [1, -1] {
                        let r = r.min(1 << grid_log2);
                        let mut found = Vec::new();
                        let shape = (grid_log2, r);
                        single_levels(bin, sign, shape, quantiser, |level| found.push(level));
                        let expected = expected(bin, sign, grid_log2, r as usize, quantiser);
                        assert_eq!(found, expected, "{grid_log2} {bin} {r} {step_log2} {sign}");
                        if bin_is_told(shape, quantiser) {
                            let finest = *found.last().unwrap();
                            assert_eq!(bin_of(finest, sign, grid_log2), bin);
                        }
                    }
                }
            }
        }
    }
}
