//! The kernel of the Haar DWT: rows of bytes for K up to 32, otherwise a histogram and butterflies.

use super::{Accumulate, Impulse, Kernel, PhaseScale};
use crate::fixed_point::Sum;
use crate::transform::{Basis, Dwt};

/// The kernel of [`Dwt`]. Exact, except for the factor 2^(j/2), which is left to whoever needs the value.
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
