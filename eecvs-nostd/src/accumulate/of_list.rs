//! Sums over a pixel's list, for targets without the assembly that keeps them in registers.

use crate::fixed_point::Sum;
use crate::group::impulse::Impulses;
use crate::transform::phase::PhaseScale;

/// Computes the sums over the first impulses of a pixel's list in assembly, and returns the impulses after those.
/// If there is no assembly, or none for `grid`, calls `otherwise` to fill `sums` and returns `None`.
#[inline(always)]
pub(crate) fn of_list<'s>(
    _: &Impulses<'s>,
    _: PhaseScale,
    _grid: usize,
    sums: &mut [Sum],
    otherwise: impl FnOnce(&mut [Sum]),
) -> Option<Impulses<'s>> {
    otherwise(sums);
    None
}
