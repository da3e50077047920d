//! Linear interpolation in Q15 tables: the kernel that the encoder uses.

use super::{Accumulate, Impulse, Kernel, PhaseScale};
use crate::fixed_point::Sum;
use crate::group::Impulses;
use crate::transform::{Basis, Dct, Dtft};

/// The table kernel: [`crate::accumulate::dct8`] for the DCT of K up to 8, [`crate::accumulate::dct16`] for K up to
/// 16, [`crate::accumulate::dtft16`] for the DTFT of K = 16, and [`crate::accumulate::any_grid`] otherwise.
///
/// Measured |c_k - c_ref| per event for K = 1,024: DCT 2^-15.2, DTFT 2^-14.9. `tests/across/kernels.rs` enforces 2^-14,
/// and `tests/across/fixed_vs_float.rs` enforces 2^-14.9 for each part.
#[derive(Debug, Clone, Copy)]
pub struct Table;

impl Accumulate<Dct> for Table {
    const KERNEL: Kernel = Kernel::Table;
    type Sum = Sum;
    type Work = ();

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        (): &mut (),
        sums: &mut [Sum],
    ) {
        Dct::accumulate(impulses, scale, grid, sums);
    }

    #[inline(always)]
    fn accumulate_list<'s>(
        impulses: &Impulses<'s>,
        scale: PhaseScale,
        grid: usize,
        (): &mut (),
        sums: &mut [Sum],
    ) -> Option<Impulses<'s>> {
        Dct::accumulate_list(impulses, scale, grid, sums)
    }
}

impl Accumulate<Dtft> for Table {
    const KERNEL: Kernel = Kernel::Table;
    type Sum = Sum;
    type Work = ();

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        (): &mut (),
        sums: &mut [Sum],
    ) {
        Dtft::accumulate(impulses, scale, grid, sums);
    }

    #[inline(always)]
    fn accumulate_list<'s>(
        impulses: &Impulses<'s>,
        scale: PhaseScale,
        grid: usize,
        (): &mut (),
        sums: &mut [Sum],
    ) -> Option<Impulses<'s>> {
        Dtft::accumulate_list(impulses, scale, grid, sums)
    }
}
