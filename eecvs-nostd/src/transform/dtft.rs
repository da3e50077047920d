//! DTFT: c_k = sum_i p_i exp(-i 2 pi k u_i). The r largest are kept.

use core::f64::consts::TAU;

use crate::accumulate::{any_grid, dtft16};
use crate::fixed_point::{Coefficient, Phase, Sum, mul_high};
use crate::group::impulse::{Impulse, Impulses};
use crate::machine::HAS_DSP;
use crate::prune::{Kept, largest, low_frequency};
use crate::quantise::Levels;
use crate::transform::basis::{Basis, cell_of, cells_log2_of};
use crate::transform::name::{Rule, Transform};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::Shape;

/// The Fourier transform of the impulse train (eq. 6 with phi_k(u) = exp(-i 2 pi k u)), for moderate windows.
///
/// `[Impulse; n] -> [Sum; 2K]`: K pairs of real and imaginary part, each of magnitude < n. As s(t) is real, the
/// coefficients of negative k are the conjugates and are not computed. Measured error of each part against f64, per
/// event, both enforced by `tests/across/fixed_vs_float.rs`:
///
/// - K = 1,024: at most 2^-15.0 (enforced: 2^-14.9, and n * 2^-14 for n events);
/// - K = 16, by the table of [`dtft16`]: at most 2^-14.18 (enforced: 2^-14.15).
#[derive(Debug, Clone, Copy)]
pub struct Dtft;

impl Basis for Dtft {
    const TRANSFORM: Transform = Transform::Dtft;
    const RULE: Rule = Rule::Magnitude;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        sums: &mut [Sum],
    ) {
        let half = |impulse: Impulse| scale.half(impulse.offset_us);
        let (pairs, _) = sums.as_chunks_mut::<2>();
        let Some(pairs) = pairs.get_mut(..grid) else {
            return;
        };
        if let Ok(pairs) = pairs.try_into() {
            return dtft16::exponentials(impulses, half, pairs);
        }
        let turn = |impulse| Phase::from_bits(half(impulse).to_bits() << 1);
        any_grid::exponentials(impulses, turn, pairs);
    }

    #[inline(always)]
    fn accumulate_list<'s>(
        impulses: &Impulses<'s>,
        scale: PhaseScale,
        grid: usize,
        sums: &mut [Sum],
    ) -> Option<Impulses<'s>> {
        dtft16::of_list(impulses, scale, grid, sums, |sums| {
            if HAS_DSP {
                accumulate_apart(impulses, scale, grid, sums);
            } else {
                Self::accumulate(impulses.clone(), scale, grid, sums);
            }
        })
    }

    /// Keeps the r largest by re^2 + im^2. Rounding of the squares shifts |c| by less than n 2^-14.
    #[inline(always)]
    fn prune<C: Coefficient>(
        sums: &[C],
        events: u32,
        shape: Shape,
        magnitudes: &mut [u32],
        kept: &mut Kept,
    ) {
        let Shape { grid, r, .. } = shape;
        if r == grid {
            return low_frequency(r, kept);
        }
        let width = u32::BITS - events.leading_zeros();
        // Always present: `Config::check` requires this much memory.
        let Some(magnitudes) = magnitudes.get_mut(..grid) else {
            return;
        };
        let (pairs, _) = sums.as_chunks::<2>();
        for (magnitude, [re, im]) in magnitudes.iter_mut().zip(pairs) {
            *magnitude = square(re.relative(width)) + square(im.relative(width));
        }
        largest(magnitudes, r, kept);
    }

    #[inline(always)]
    fn quantise<C: Coefficient>(sums: &[C], shape: Shape, kept: &Kept, levels: &mut Levels<'_>) {
        let shift = shape.quantiser.shift();
        let (pairs, _) = sums.as_chunks::<2>();
        kept.for_each(shape.grid, |k| {
            if k > 0
                && let Some(pair) = pairs.get(k)
            {
                levels.push_uniform(*pair, shift);
            }
        });
    }

    /// All coefficients of a single event have magnitude 1 and tie, so k = 0..r are kept.
    fn cells_log2(shape: Shape) -> u32 {
        // Within a quarter of a step: the levels of two events determine their times more finely than a cell of
        // half a step would, and a single event must not be worse.
        let half_turns = 2 * shape.r.saturating_sub(1);
        cells_log2_of(2 * half_turns, shape.quantiser).min(CELLS_LOG2_MAX)
    }

    #[inline(always)]
    fn cell(scale: PhaseScale, offset_us: u32, cells_log2: u32) -> u32 {
        cell_of(scale, offset_us, cells_log2)
    }

    fn single(u: f64, sign: f64, shape: Shape, mut each: impl FnMut(u16, f64, f64)) {
        for (k, (re, im)) in (0..shape.r as u16).zip(exponentials(u)) {
            each(k, sign * re, sign * im);
        }
    }
}

/// Returns re and im of exp(-i 2 pi k u) for k = 0, 1, ..., to k times the precision of f64.
pub fn exponentials(u: f64) -> impl Iterator<Item = (f64, f64)> {
    let (sin, cos) = libm::sincos(TAU * u);
    let (mut re, mut im) = (1.0, 0.0);
    core::iter::from_fn(move || {
        let value = (re, im);
        (re, im) = (re * cos + im * sin, im * cos - re * sin);
        Some(value)
    })
}

/// [`Dtft::accumulate`] over a list without assembly. Out of line, so that the path with assembly need not save
/// this one's registers.
#[inline(never)]
fn accumulate_apart(impulses: &Impulses<'_>, scale: PhaseScale, grid: usize, sums: &mut [Sum]) {
    Dtft::accumulate(impulses.clone(), scale, grid, sums);
}

/// Largest b that a reader accepts.
const CELLS_LOG2_MAX: u32 = 24;

/// Returns x^2 / 2^32.
#[inline(always)]
fn square(x: i32) -> u32 {
    mul_high(x, x) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixed_point::FRACTION_BITS;
    use crate::quantise::Quantiser;
    use proptest::prelude::*;

    const WINDOW_US: u32 = 1 << 20;

    /// Returns the set of k that `prune` keeps for two events.
    fn pruned(events: [Impulse; 2], shape: Shape) -> u32 {
        let mut sums = [Sum::ZERO; 64];
        let scale = PhaseScale::new(WINDOW_US);
        Dtft::accumulate(events.into_iter(), scale, shape.grid, &mut sums);
        let on = events.iter().filter(|event| event.is_on).count() as i32;
        sums[0] = Sum::from_bits((2 * on - 2) << FRACTION_BITS);
        let mut kept = Kept::NONE;
        Dtft::prune(&sums, 2, shape, &mut [0; 32], &mut kept);
        kept.words(shape.grid)[0]
    }

    /// Returns the set of k for which floor(512 d), with d rounded as in the assembly, is at least `value`.
    fn reach(events: [Impulse; 2], shape: Shape, value: u32) -> u32 {
        let scale = PhaseScale::new(WINDOW_US);
        let [a, b] = events.map(|event| scale.half(event.offset_us).to_bits() << 1);
        let difference = (a.wrapping_sub(b).wrapping_add(1 << 16) >> 17) << 1;
        let start = 1 + (u32::from(events[0].is_on == events[1].is_on) << 15);
        let distance = |k| (start + k * difference) as u16 as i16;
        let reaches = |k: &u32| u32::from(distance(*k).unsigned_abs() >> 7) >= value;
        (0..shape.grid as u32)
            .filter(reaches)
            .fold(0, |bits, k| bits | (1 << k))
    }

    proptest! {
        /// The reason why the assembly may order the magnitudes of two events by their distance.
        #[test]
        fn two_events_are_ordered_by_their_distance(
            first in 0..WINDOW_US,
            apart in prop_oneof![0..WINDOW_US, 0..4096_u32, Just(WINDOW_US / 4)],
            is_on: [bool; 2],
            grid in (1..=8_usize).prop_map(|fours| 4 * fours),
            r in 1..32_usize,
        ) {
            let shape = Shape { grid, r: 1 + r % (grid - 1), quantiser: Quantiser::DEFAULT };
            let offsets_us = [first, (first + apart) % WINDOW_US];
            let events = [0, 1].map(|i| Impulse { offset_us: offsets_us[i], is_on: is_on[i] });
            let kept = pruned(events, shape);
            for value in 9..=248 {
                let found = reach(events, shape, value);
                // The margin: no k lies between the two values.
                if found.count_ones() == shape.r as u32 && reach(events, shape, value - 1) == found {
                    prop_assert_eq!(found, kept, "{}", value);
                }
            }
        }
    }
}
