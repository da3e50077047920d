//! What a transform does in each stage.

use crate::fixed_point::{Coefficient, Sum};
use crate::group::impulse::{Impulse, Impulses};
use crate::prune::Kept;
use crate::quantise::{Levels, Quantiser};
use crate::transform::name::{Rule, Transform};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::Shape;

/// What a transform does in each stage.
///
/// `sums` hold K values for a real transform; a complex one has K pairs, real and imaginary part.
pub trait Basis {
    /// The transform's name.
    const TRANSFORM: Transform;
    /// Which coefficients are kept.
    const RULE: Rule;
    /// Whether the encoder may take its walks for this transform, which have the table's kernel in
    /// them, in place of [`Self::accumulate`].
    const HAS_WALKS: bool = true;

    /// Accumulate: c_k = sum_i p_i phi_k(u_i) (eq. 6) for k in 1..`grid`, over at most
    /// [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS) impulses; more are left out. `sums`, 2K or
    /// longer, is overwritten, but for c_0, the sum of the signs, which the caller knows.
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        sums: &mut [Sum],
    );

    /// [`Self::accumulate`] over the first impulses of a pixel's list, with the same bits. Returns the
    /// others where it comes by them.
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

    /// Prune: adds the coefficients that are sent to `kept`, which is empty. `magnitudes` is memory
    /// for K numbers. Not asked for where [`Rule::LowFrequency`] says which.
    fn prune<C: Coefficient>(
        sums: &[C],
        events: u32,
        shape: Shape,
        magnitudes: &mut [u32],
        kept: &mut Kept,
    );

    /// Quantise: adds the levels of what is sent, k ascending, to `levels`.
    fn quantise<C: Coefficient>(sums: &[C], shape: Shape, kept: &Kept, levels: &mut Levels<'_>);

    /// b, 0 to 24: one of 2^b cells of the window tells a single event's coefficients, each within
    /// half a step, in the DTFT within a quarter.
    fn cells_log2(shape: Shape) -> u32;

    /// The cell of an offset below T.
    fn cell(scale: PhaseScale, offset_us: u32, cells_log2: u32) -> u32;

    /// Calls `each` with k, re and im of the kept coefficients of a single event `sign` at `u`, k
    /// ascending.
    fn single(u: f64, sign: f64, shape: Shape, each: impl FnMut(u16, f64, f64));

    /// Numbers in `sums` that are coefficients: K, or 2K for a complex transform.
    #[must_use]
    fn values(grid: usize) -> usize {
        if Self::TRANSFORM.is_complex() {
            2 * grid
        } else {
            grid
        }
    }
}

/// [`Basis::cells_log2`] of atoms whose highest turns by `half_turns` pi over the window: it changes
/// by less than half of a step D over half of a cell, 2^b >= pi `half_turns` / D.
pub(super) fn cells_log2_of(half_turns: usize, quantiser: Quantiser) -> u32 {
    // 3217 / 1024 is above pi by 2.8e-6 of it.
    let cells_1024 = (3217 * half_turns as u64) << (8 - i32::from(quantiser.step_log2()));
    let cells = cells_1024.div_ceil(1024 << 8);
    cells.next_power_of_two().trailing_zeros()
}

/// [`Basis::cell`] where a cell more or less at its edge does no harm: less than 3 * 2^-31 of the
/// window from there.
#[inline(always)]
pub(super) fn cell_of(scale: PhaseScale, offset_us: u32, cells_log2: u32) -> u32 {
    // u / 2 of a turn is below 2^31.
    scale.half(offset_us).to_bits() >> (31_u32.wrapping_sub(cells_log2) & 31)
}
