//! DCT: c_k = sum_i p_i cos(pi k u_i). The low frequencies are kept.

use core::f64::consts::PI;

use crate::accumulate::{any_grid, dct8, dct16};
use crate::fixed_point::{CHUNK_EVENTS, Coefficient, Sum};
use crate::group::impulse::{Impulse, Impulses};
use crate::machine::HAS_DSP;
use crate::prune::{Kept, low_frequency};
use crate::quantise::Levels;
use crate::transform::basis::{Basis, cell_of, cells_log2_of};
use crate::transform::name::{Rule, Transform};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::Shape;

/// The cosine transform (eq. 6 with phi_k(u) = cos(pi k u)), for dense windows.
///
/// `[Impulse; n] -> [Sum; K]`, |c_k| < n. Measured error against f64, per event:
///
/// - K = 1,024: at most 2^-15.0 (`tests/across/fixed_vs_float.rs` enforces 2^-14.9, and n * 2^-14 for n events);
/// - K up to 8, by the table of [`dct8`]: at most 2^-14.28 (its tests enforce 2^-14.2);
/// - K up to 16, by the table of [`dct16`]: at most 2^-14.21 (its tests enforce 2^-14.2).
#[derive(Debug, Clone, Copy)]
pub struct Dct;

impl Basis for Dct {
    const TRANSFORM: Transform = Transform::Dct;
    const RULE: Rule = Rule::LowFrequency;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        sums: &mut [Sum],
    ) {
        // Half a turn of the cosine is one window.
        let turn = |impulse: Impulse| scale.half(impulse.offset_us);
        if grid <= dct8::GRID {
            let cosines = dct8::cosines(impulses.take(CHUNK_EVENTS), turn);
            return set(sums, grid, cosines);
        }
        if grid <= dct16::GRID {
            let cosines = dct16::cosines(impulses.take(CHUNK_EVENTS), turn);
            return set(sums, grid, cosines);
        }
        let Some(sums) = sums.get_mut(..grid) else {
            return;
        };
        any_grid::cosines(impulses, turn, sums);
    }

    #[inline(always)]
    fn accumulate_list<'s>(
        impulses: &Impulses<'s>,
        scale: PhaseScale,
        grid: usize,
        sums: &mut [Sum],
    ) -> Option<Impulses<'s>> {
        dct8::of_list(impulses, scale, grid, sums, |sums| {
            if HAS_DSP {
                accumulate_apart(impulses, scale, grid, sums);
            } else {
                Self::accumulate(impulses.clone(), scale, grid, sums);
            }
        })
    }

    #[inline(always)]
    fn prune<C: Coefficient>(_: &[C], _: u32, shape: Shape, _: &mut [u32], kept: &mut Kept) {
        low_frequency(shape.r, kept);
    }

    #[inline(always)]
    fn quantise<C: Coefficient>(sums: &[C], shape: Shape, _: &Kept, levels: &mut Levels<'_>) {
        let shift = shape.quantiser.shift();
        for sum in sums.get(1..shape.r).unwrap_or_default() {
            levels.push_uniform([*sum], shift);
        }
    }

    fn cells_log2(shape: Shape) -> u32 {
        cells_log2_of(shape.r.saturating_sub(1), shape.quantiser)
    }

    #[inline(always)]
    fn cell(scale: PhaseScale, offset_us: u32, cells_log2: u32) -> u32 {
        cell_of(scale, offset_us, cells_log2)
    }

    fn single(u: f64, sign: f64, shape: Shape, mut each: impl FnMut(u16, f64, f64)) {
        for (k, cos) in (0..shape.r as u16).zip(cosines(u)) {
            each(k, sign * cos, 0.0);
        }
    }
}

/// Returns cos(pi k u) for k = 0, 1, ..., to k^2 times the precision of f64.
pub fn cosines(u: f64) -> impl Iterator<Item = f64> {
    let cos = libm::cos(PI * u);
    let (mut before, mut here) = (cos, 1.0);
    core::iter::from_fn(move || {
        let value = here;
        // cos(k x) = 2 cos x cos((k - 1) x) - cos((k - 2) x)
        (before, here) = (here, 2.0 * cos * here - before);
        Some(value)
    })
}

/// [`Dct::accumulate`] for grids without assembly. Out of line, so that the path with assembly need not save this
/// one's registers.
#[inline(never)]
fn accumulate_apart(impulses: &Impulses<'_>, scale: PhaseScale, grid: usize, sums: &mut [Sum]) {
    Dct::accumulate(impulses.clone(), scale, grid, sums);
}

/// Writes the sums of k = 1 to K - 1.
#[inline(always)]
fn set(sums: &mut [Sum], grid: usize, cosines: impl IntoIterator<Item = i32>) {
    for (sum, cosine) in sums.iter_mut().take(grid).skip(1).zip(cosines) {
        *sum = Sum::from_bits(cosine);
    }
}
