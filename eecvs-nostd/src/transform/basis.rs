//! The trait that a transform implements: what it does in each stage.

use crate::fixed_point::{Coefficient, Sum};
use crate::group::impulse::{Impulse, Impulses};
use crate::prune::Kept;
use crate::quantise::{Levels, Quantiser};
use crate::transform::name::{Rule, Transform};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::Shape;

/// A transform: its accumulation, its pruning and its quantisation.
///
/// For a real transform `sums` holds K values; for a complex one it holds K pairs of real and imaginary part.
pub trait Basis {
    /// The name of the transform.
    const TRANSFORM: Transform;
    /// The rule that selects the kept coefficients.
    const RULE: Rule;
    /// Whether the encoder may replace [`Self::accumulate`] by its fused walks, which contain the table's kernel.
    const HAS_WALKS: bool = true;

    /// Accumulates c_k = sum_i p_i phi_k(u_i) (eq. 6) for k in 1..`grid`.
    ///
    /// Sums at most [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) impulses and leaves out any more. `sums`
    /// needs 2K values or more and is overwritten, except for c_0, the sum of the signs, which the caller knows.
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        sums: &mut [Sum],
    );

    /// Does the same as [`Self::accumulate`] over the first impulses of a pixel's list, with the same bits.
    ///
    /// Returns the remaining impulses if the implementation knows where they begin, otherwise `None`.
    #[inline(always)]
    fn accumulate_list<'s>(
        impulses: &Impulses<'s>,
        scale: PhaseScale,
        grid: usize,
        sums: &mut [Sum],
    ) -> Option<Impulses<'s>> {
        Self::accumulate(impulses.clone(), scale, grid, sums);
        None
    }

    /// Prunes: adds the coefficients that are sent to `kept`, which must be empty.
    ///
    /// `magnitudes` is scratch memory for K numbers. Not needed under [`Rule::LowFrequency`], which fixes the
    /// selection.
    fn prune<C: Coefficient>(
        sums: &[C],
        events: u32,
        shape: Shape,
        magnitudes: &mut [u32],
        kept: &mut Kept,
    );

    /// Quantises: appends the levels of the coefficients that are sent to `levels`, k ascending.
    fn quantise<C: Coefficient>(sums: &[C], shape: Shape, kept: &Kept, levels: &mut Levels<'_>);

    /// Returns b, 0 to 24, so that one of 2^b cells of the window determines the coefficients of a single event,
    /// each to within half a step, or a quarter of a step for the DTFT.
    fn cells_log2(shape: Shape) -> u32;

    /// Returns the cell, one of 2^`cells_log2`, of an offset below T.
    fn cell(scale: PhaseScale, offset_us: u32, cells_log2: u32) -> u32;

    /// Calls `each` with k, re and im of the kept coefficients of a single event of sign `sign` at `u`, k
    /// ascending.
    fn single(u: f64, sign: f64, shape: Shape, each: impl FnMut(u16, f64, f64));

    /// Returns the number of values in `sums` that belong to coefficients: K, or 2K for a complex transform.
    #[must_use]
    fn values(grid: usize) -> usize {
        if Self::TRANSFORM.is_complex() {
            2 * grid
        } else {
            grid
        }
    }
}

/// Returns [`Basis::cells_log2`] for atoms whose fastest turns by `half_turns` pi over the window. It
/// changes by less than half a step D over half a cell: 2^b >= pi `half_turns` / D.
pub(super) fn cells_log2_of(half_turns: usize, quantiser: Quantiser) -> u32 {
    // 3217 / 1024 exceeds pi by a relative 2.8e-6.
    let cells_1024 = (3217 * half_turns as u64) << (8 - i32::from(quantiser.step_log2()));
    let cells = cells_1024.div_ceil(1024 << 8);
    cells.next_power_of_two().trailing_zeros()
}

/// Returns [`Basis::cell`] for atoms that tolerate a neighbouring cell near a cell's edge, that is, for offsets
/// less than 3 * 2^-31 of the window away from it.
#[inline(always)]
pub(super) fn cell_of(scale: PhaseScale, offset_us: u32, cells_log2: u32) -> u32 {
    // u / 2 in turns is below 2^31 in units of 2^-32.
    scale.half(offset_us).to_bits() >> (31_u32.wrapping_sub(cells_log2) & 31)
}
