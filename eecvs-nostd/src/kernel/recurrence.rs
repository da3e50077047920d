//! The Chebyshev oscillators of [`crate::transform::oscillator`], for any K.

use super::{Accumulate, Impulse, Kernel, Oscillators, PhaseScale, dct_turn};
use crate::fixed_point::Sum;
use crate::transform::{Basis, Dct, Dtft, oscillator};

/// What the DTFT and the DCT beyond K = 8 take.
///
/// Measured for K = 1,024, |c_k - c_ref| per event: DCT 2^-17.4, DTFT 2^-16.9; `tests/kernels.rs`
/// enforces 2^-16, and `tests/fixed_vs_float.rs` 2^-17 for each part.
#[derive(Debug, Clone, Copy)]
pub struct Recurrence;

impl Accumulate<Dct> for Recurrence {
    const KERNEL: Kernel = Kernel::Recurrence;
    type Sum = Sum;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        work: &mut Oscillators,
        sums: &mut [Sum],
    ) {
        let Some(sums) = sums.get_mut(..grid) else {
            return;
        };
        let turn = |impulse| dct_turn(scale, impulse);
        oscillator::cosines(&impulses, turn, &mut work.cos, sums);
    }
}

impl Accumulate<Dtft> for Recurrence {
    const KERNEL: Kernel = Kernel::Recurrence;
    type Sum = Sum;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        work: &mut Oscillators,
        sums: &mut [Sum],
    ) {
        Dtft::accumulate(impulses, scale, grid, work, sums);
    }
}
