//! Haar DWT: c_0 = sum_i p_i, c_(2^j + m) = sum_i p_i 2^(j/2) h(2^j u_i - m). The r largest are kept.

use core::cell::Cell;

use crate::accumulate::haar_bytes;
use crate::accumulate::haar_bytes::Lanes;
use crate::fixed_point::{CHUNK_EVENTS, Coefficient, Sum};
use crate::group::impulse::Impulse;
use crate::machine::HAS_DSP;
use crate::prune::{Kept, largest};
use crate::quantise::Levels;
use crate::transform::basis::Basis;
use crate::transform::haar_scale::scale_of;
use crate::transform::name::{Rule, Transform};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::Shape;

/// The Haar wavelet transform (eq. 6), for sparse windows; h is +1 on [0, 1/2), -1 on [1/2, 1).
///
/// `[Impulse; n] -> [Sum; K]`, K a power of two. The sums hold the integers D_k = c_k / 2^(j/2), |D_k| <= n, which
/// are exact. For K up to 32 they are accumulated in rows of bytes (`haar_bytes`), otherwise from a fine histogram
/// with K - 1 butterflies. The irrational factor is left to whoever needs the value, so pruning compares the
/// integers D^2 2^j and finds ties exactly.
#[derive(Debug, Clone, Copy)]
pub struct Dwt;

/// Up to this many events are added one by one, which is cheaper than the butterflies.
const FEW_EVENTS: usize = 6;

impl Basis for Dwt {
    const TRANSFORM: Transform = Transform::Dwt;
    const RULE: Rule = Rule::Magnitude;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        sums: &mut [Sum],
    ) {
        debug_assert!(grid.is_power_of_two());
        let bins_log2 = grid.trailing_zeros();
        // With the DSP assembly few pixels come this way, so the firmware image contains the histogram alone.
        if grid <= haar_bytes::GRID && !HAS_DSP {
            if grid <= haar_bytes::GRID / 2 {
                widen(haar_bytes::sum::<4>(impulses, scale, bins_log2), grid, sums);
            } else {
                widen(haar_bytes::sum::<8>(impulses, scale, bins_log2), grid, sums);
            }
            return;
        }
        accumulate_many(impulses, scale, grid, sums);
    }

    /// Keeps the coefficients that are not 0, or the r largest if there are more than r, and then drops those whose
    /// level is 0.
    #[inline(always)]
    fn prune<C: Coefficient>(
        sums: &[C],
        events: u32,
        shape: Shape,
        magnitudes: &mut [u32],
        kept: &mut Kept,
    ) {
        let Shape { grid, r, quantiser } = shape;
        let mut nonzero = 0;
        for (word, sums) in kept.words_mut(grid).iter_mut().zip(sums.chunks(32)) {
            let sums = sums.iter().take(grid).rev();
            *word = sums.fold(0, |word, sum| (word << 1) | u32::from(!sum.is_zero()));
            nonzero += word.count_ones() as usize;
        }
        if nonzero > r {
            let Some(magnitudes) = magnitudes.get_mut(..grid) else {
                return;
            };
            for (k, (number, sum)) in magnitudes.iter_mut().zip(sums).enumerate() {
                *number = if events < 256 {
                    small_magnitude(sum.integer(), k)
                } else {
                    magnitude(sum.integer(), k)
                };
            }
            kept.clear(grid);
            largest(magnitudes, r, kept);
        }
        if quantiser.step_log2() > 0 {
            for (k, sum) in sums.iter().enumerate().take(grid).skip(1) {
                if quantiser.haar(sum.integer(), scale_of(k)) == 0 {
                    kept.remove(k);
                }
            }
        }
    }

    /// No kept level is 0, so positive levels are moved down by one.
    #[inline(always)]
    fn quantise<C: Coefficient>(sums: &[C], shape: Shape, kept: &Kept, levels: &mut Levels<'_>) {
        kept.for_each(shape.grid, |k| {
            if k > 0
                && let Some(sum) = sums.get(k)
            {
                let level = shape.quantiser.haar(sum.integer(), scale_of(k));
                levels.push([level - i32::from(level > 0)]);
            }
        });
    }

    /// A single event has non-zero coefficients only for the atoms whose support contains it, +-2^(j/2); the finest
    /// are kept, and one of K cells determines them. Returns 0 if the finest is not kept, or is so far below the
    /// step that its level is 0.
    fn cells_log2(shape: Shape) -> u32 {
        let cells_log2 = (shape.grid | 1).ilog2();
        let is_told = coarsest_kept(cells_log2, shape.r) < cells_log2
            && shape.quantiser.haar(1, cells_log2.saturating_sub(1)) != 0;
        if is_told { cells_log2 } else { 0 }
    }

    #[inline(always)]
    fn cell(scale: PhaseScale, offset_us: u32, cells_log2: u32) -> u32 {
        scale.bin(offset_us, cells_log2)
    }

    fn single(u: f64, sign: f64, shape: Shape, mut each: impl FnMut(u16, f64, f64)) {
        let scales = (shape.grid | 1).ilog2();
        // c_0 is among the r largest, because only the `scales - 1` finest coefficients precede it.
        if shape.r >= scales as usize {
            each(0, sign, 0.0);
        }
        if Self::cells_log2(shape) == 0 {
            return;
        }
        for scale in coarsest_kept(scales, shape.r)..scales {
            let shift = f64::from(1_u32 << scale) * u;
            let m = shift as u32;
            let is_first_half = shift - f64::from(m) < 0.5;
            let value = libm::sqrt(f64::from(1_u32 << scale));
            let value = if is_first_half { value } else { -value };
            each(((1 << scale) + m) as u16, sign * value, 0.0);
        }
    }
}

/// Accumulates [`Dwt`]'s sums on any grid. Out of line, so that pixels of one chunk and of several share the code.
#[inline(never)]
fn accumulate_many(
    impulses: impl Iterator<Item = Impulse> + Clone,
    scale: PhaseScale,
    grid: usize,
    sums: &mut [Sum],
) {
    let bins_log2 = grid.trailing_zeros();
    let bin = |impulse: &Impulse| scale.bin(impulse.offset_us, bins_log2) as usize;
    let sign = |impulse: &Impulse| {
        if impulse.is_on {
            Sum::ONE
        } else {
            Sum::NEG_ONE
        }
    };
    if impulses.clone().nth(FEW_EVENTS).is_none() {
        // Each event adds to one coefficient of every scale, from the finest to the coarsest.
        let differences = sums.get_mut(..grid).unwrap_or_default();
        differences.fill(Sum::ZERO);
        for impulse in impulses {
            let sign = sign(&impulse);
            let mut node = grid + bin(&impulse);
            while node > 1 {
                let is_second_half = node % 2 == 1;
                node /= 2;
                if let Some(difference) = differences.get_mut(node) {
                    *difference += if is_second_half { -sign } else { sign };
                }
            }
        }
        return;
    }
    let (differences, bins) = sums.split_at_mut_checked(grid).unwrap_or_default();
    let bins = bins.get_mut(..grid).unwrap_or_default();
    bins.fill(Sum::ZERO);
    for impulse in impulses.take(CHUNK_EVENTS) {
        // Always present: the offset is below T.
        if let Some(sum) = bins.get_mut(bin(&impulse)) {
            *sum += sign(&impulse);
        }
    }
    // At scale j each pair of the 2^(j+1) bins is replaced by its sum, a bin of the next coarser scale, and its
    // difference, D_k of k = 2^j + m.
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

/// Widens bytes to sums, except c_0.
#[inline(always)]
fn widen<const W: usize>(lanes: Lanes<W>, grid: usize, sums: &mut [Sum]) {
    let bytes = lanes.into_bytes();
    let sums = sums.iter_mut().zip(bytes.as_flattened());
    for (sum, byte) in sums.take(grid).skip(1) {
        *sum = Sum::from_num(byte.cast_signed());
    }
}

/// Returns the coarsest scale, for K = 2^`scales`, at which the atom of a single event is kept, or `scales` if
/// there is none. The r finest are kept, except that c_0 ties with c_1 and precedes it.
const fn coarsest_kept(scales: u32, r: usize) -> u32 {
    if r as u32 > scales {
        return 0;
    }
    let coarsest = scales - r as u32;
    // c_0 takes the place of scale 0.
    if coarsest == 0 { 1 } else { coarsest }
}

/// Returns a number that orders coefficients as |D_k| 2^(j/2) does, with exact ties, for |D_k| < 2^24 and j < 10.
///
/// |D| 2^(j/2) is A for even j and B sqrt 2 for odd j, with integers A, B < 2^29. As sqrt 2 is irrational, comparing A
/// with B sqrt 2 is the same as comparing 2 A with 2 floor(B sqrt 2) + 1.
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

/// Returns D_k^2 2^j, which orders coefficients like [`magnitude`] for |D_k| < 256.
#[inline(always)]
#[must_use]
pub fn small_magnitude(difference: i32, k: usize) -> u32 {
    (difference * difference).unsigned_abs() << scale_of(k)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantise::Quantiser;
    use std::vec::Vec;

    /// Transforms a window of 8 us that has as many impulses in each of its 8 bins as `bins` counts.
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
        Dwt::accumulate(impulses.iter().copied(), scale, 8, &mut sums);
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

    /// Computes a single event's coefficients by the definition: transforms the event, then sorts stably by
    /// magnitude.
    fn expected(bin: u32, sign: i32, shape: Shape) -> Vec<(u16, f64)> {
        let grid = shape.grid;
        let mut sums = std::vec![Sum::ZERO; 2 * grid];
        let impulse = Impulse {
            offset_us: bin,
            is_on: sign > 0,
        };
        let scale = PhaseScale::new(grid as u32);
        Dwt::accumulate([impulse].into_iter(), scale, grid, &mut sums);
        sums[0] = Sum::from_num(sign);
        let mut order: Vec<usize> = (0..grid).collect();
        order.sort_by_key(|k| std::cmp::Reverse(magnitude(sums[*k].to_num(), *k)));
        order.truncate(shape.r);
        order.sort_unstable();
        let spacing = |k: usize| libm::sqrt(f64::from(1_u32 << scale_of(k)));
        order
            .into_iter()
            .map(|k| (k as u16, sums[k].to_num::<f64>() * spacing(k)))
            .filter(|(_, value)| *value != 0.0)
            .collect()
    }

    #[test]
    fn a_single_events_coefficients_follow_from_its_cell() {
        for scales in 0..=10 {
            for bin in (0..1_u32 << scales).step_by(if scales > 6 { 37 } else { 1 }) {
                for (r, step_log2) in [(1, -6), (3, 0), (4, 2), (5, 3), (8, 4), (11, 8), (64, 1)] {
                    let grid = 1 << scales;
                    let shape = Shape {
                        grid,
                        r: r.min(grid),
                        quantiser: Quantiser::new(step_log2).unwrap(),
                    };
                    let cells_log2 = Dwt::cells_log2(shape);
                    let cell = Dwt::cell(PhaseScale::new(grid as u32), bin, cells_log2);
                    let u = (f64::from(cell) + 0.5) / f64::from(1_u32 << cells_log2);
                    for sign in [1, -1] {
                        let mut found = Vec::new();
                        Dwt::single(u, f64::from(sign), shape, |k, re, _| found.push((k, re)));
                        let mut expected = expected(bin, sign, shape);
                        if cells_log2 == 0 {
                            // Whatever is left out is within half a step.
                            let (sent, cut) = expected.into_iter().partition(|(k, _)| *k == 0);
                            expected = sent;
                            let half_step = libm::exp2(f64::from(step_log2) - 1.0);
                            let cut: Vec<(u16, f64)> = cut;
                            assert!(cut.iter().all(|(_, value)| value.abs() <= half_step));
                        }
                        assert_eq!(found, expected, "{scales} {bin} {r} {step_log2} {sign}");
                    }
                }
            }
        }
    }
}
