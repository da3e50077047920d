//! The Haar transform's rows of bytes, and its histogram and butterflies beyond K = 32.

use super::{Accumulate, Impulse, Kernel, PhaseScale};
use crate::fixed_point::Sum;
use crate::transform::{Basis, Dwt};

/// What [`Dwt`] takes: exact but for the scale 2^(j/2), which is left to whoever needs the value.
#[derive(Debug, Clone, Copy)]
pub struct Haar;

impl Accumulate<Dwt> for Haar {
    const KERNEL: Kernel = Kernel::Haar;
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
        Dwt::accumulate(impulses, scale, grid, sums);
    }
}
