//! The sums over a pixel's list where no assembly keeps them in registers.

use crate::fixed_point::Sum;
use crate::group::impulse::Impulses;
use crate::transform::phase::PhaseScale;

/// The sums over the first impulses of a pixel's list, in assembly that keeps them in registers; returns the
/// impulses after those. Where there is no such assembly, or none for `grid`, the sums are what `otherwise`
/// makes of them, and nothing is returned.
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
