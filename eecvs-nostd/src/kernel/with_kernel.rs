//! A transform whose coefficients another kernel computes, for use by the encoder.

use core::marker::PhantomData;

use super::{Accumulate, PhaseScale, PreciseSum};
use crate::fixed_point::{CHUNK_EVENTS, Coefficient, FRACTION_BITS, Sum, WideSum};
use crate::group::Impulse;
use crate::prune::Kept;
use crate::quantise::Levels;
use crate::transform::shape::Shape;
use crate::transform::{Basis, GRID_MAX, Rule, Transform};

/// The transform `B` with the accumulate stage of the kernel `A`; all other stages are those of `B`.
///
/// `[Impulse; n] -> [Sum; K]` or `[Sum; 2K]`, |c_k| < n. The error of each number is that of the kernel plus less
/// than 2^-25 per chunk, because sums are converted to 25 fractional bits and kept below n. The levels of a pixel
/// of n events therefore need no extra bit for n itself.
///
/// Meant for hosts: the kernel's sums take up to 16 KiB of the stack.
#[derive(Debug, Clone, Copy)]
pub struct WithKernel<B, A>(PhantomData<(B, A)>);

/// A kernel's sum, convertible to the encoder's format.
pub trait KernelSum: Copy + Default {
    /// Returns the value, to within less than 2^-25.
    fn to_wide(self) -> WideSum;
}

impl KernelSum for Sum {
    #[inline(always)]
    fn to_wide(self) -> WideSum {
        self.wide()
    }
}

impl KernelSum for PreciseSum {
    /// Rounds to the nearest.
    #[inline(always)]
    fn to_wide(self) -> WideSum {
        const LOST: u32 = PreciseSum::FRAC_NBITS - FRACTION_BITS;
        // A chunk's sum stays far below the type's limit of 2^33.
        WideSum::from_bits(self.to_bits().wrapping_add(1 << (LOST - 1)) >> LOST)
    }
}

#[cfg(feature = "float")]
impl KernelSum for f32 {
    /// Rounds towards 0.
    #[inline(always)]
    fn to_wide(self) -> WideSum {
        WideSum::from_bits((self * (1_u32 << FRACTION_BITS) as f32) as i64)
    }
}

/// Numbers for the usual grids. Clearing those of the largest grid takes longer than a whole pixel of a usual one.
const USUAL_NUMBERS: usize = 256;

impl<B: Basis, A: Accumulate<B>> Basis for WithKernel<B, A> {
    const TRANSFORM: Transform = B::TRANSFORM;
    const RULE: Rule = B::RULE;
    const HAS_WALKS: bool = false;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        sums: &mut [Sum],
    ) {
        if 2 * grid <= USUAL_NUMBERS {
            accumulate::<B, A, USUAL_NUMBERS>(impulses, scale, grid, sums);
        } else {
            accumulate::<B, A, { 2 * GRID_MAX }>(impulses, scale, grid, sums);
        }
    }

    #[inline(always)]
    fn prune<C: Coefficient>(
        sums: &[C],
        events: u32,
        shape: Shape,
        magnitudes: &mut [u32],
        kept: &mut Kept,
    ) {
        B::prune(sums, events, shape, magnitudes, kept);
    }

    #[inline(always)]
    fn quantise<C: Coefficient>(sums: &[C], shape: Shape, kept: &Kept, levels: &mut Levels<'_>) {
        B::quantise(sums, shape, kept, levels);
    }

    fn cells_log2(shape: Shape) -> u32 {
        B::cells_log2(shape)
    }

    #[inline(always)]
    fn cell(scale: PhaseScale, offset_us: u32, cells_log2: u32) -> u32 {
        B::cell(scale, offset_us, cells_log2)
    }

    fn single(u: f64, sign: f64, shape: Shape, each: impl FnMut(u16, f64, f64)) {
        B::single(u, sign, shape, each);
    }
}

/// Computes the kernel's sums and converts them to the encoder's format. K is at most half of `NUMBERS`.
#[inline(never)]
fn accumulate<B: Basis, A: Accumulate<B>, const NUMBERS: usize>(
    impulses: impl Iterator<Item = Impulse> + Clone,
    scale: PhaseScale,
    grid: usize,
    sums: &mut [Sum],
) {
    let mut own = [A::Sum::default(); NUMBERS];
    let mut work = A::Work::default();
    A::accumulate(impulses.clone(), scale, grid, &mut work, &mut own);
    let events = impulses.take(CHUNK_EVENTS).count().max(1);
    let most = ((events as i64) << FRACTION_BITS) - 1;
    let numbers = sums.iter_mut().zip(own).take(B::values(grid));
    for (sum, own) in numbers.skip(B::values(1)) {
        let bits = own.to_wide().to_bits().clamp(-most, most);
        *sum = Sum::from_bits(bits as i32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{Precise, Recurrence, Table};
    use crate::transform::{Dct, Dtft};
    use std::vec::Vec;

    /// Events at u = 0, where every atom is 1.
    fn at_start(events: usize) -> Vec<Impulse> {
        let impulse = Impulse {
            offset_us: 0,
            is_on: true,
        };
        std::vec![impulse; events]
    }

    fn sums<B: Basis>(impulses: &[Impulse], grid: usize) -> Vec<Sum> {
        let mut sums = std::vec![Sum::from_num(-7); 2 * grid];
        let impulses = impulses.iter().copied();
        B::accumulate(impulses, PhaseScale::new(1000), grid, &mut sums);
        sums
    }

    #[test]
    fn sums_stay_below_the_number_of_events_and_what_is_not_theirs_stays() {
        for events in [0, 1, 2, 62, CHUNK_EVENTS, CHUNK_EVENTS + 1] {
            let impulses = at_start(events);
            let most = events.min(CHUNK_EVENTS) as i32;
            for grid in [1, 2, 128, 129, GRID_MAX] {
                let dct = sums::<WithKernel<Dct, Precise>>(&impulses, grid);
                let dtft = sums::<WithKernel<Dtft, Precise>>(&impulses, grid);
                let near = |sum: &Sum| {
                    let below = (most << FRACTION_BITS) - sum.to_bits();
                    below == i32::from(most > 0)
                };
                assert!(dct[1..grid].iter().all(near), "{events} {grid}");
                assert!(dtft[2..].iter().step_by(2).all(near), "{events} {grid}");
                assert!(dtft.iter().skip(3).step_by(2).all(|sum| sum.is_zero()));
                let others = [&dct[..1], &dct[grid..], &dtft[..2]].concat();
                assert!(others.iter().all(|sum| *sum == Sum::from_num(-7)));
            }
        }
    }

    #[test]
    fn sums_of_the_encoders_own_format_are_not_changed() {
        let impulses: Vec<_> = (0..40)
            .map(|i| Impulse {
                offset_us: i * i % 1000,
                is_on: i % 3 > 0,
            })
            .collect();
        let own = sums::<Dtft>(&impulses, 32);
        assert_eq!(sums::<WithKernel<Dtft, Table>>(&impulses, 32), own);
        assert_ne!(sums::<WithKernel<Dtft, Recurrence>>(&impulses, 32), own);
    }

    #[test]
    fn precise_sums_are_rounded_to_the_nearest() {
        for (bits, expected) in [(15, 0), (16, 1), (47, 1), (48, 2), (-16, 0), (-17, -1)] {
            assert_eq!(PreciseSum::from_bits(bits).to_wide().to_bits(), expected);
        }
    }

    #[cfg(feature = "float")]
    #[test]
    fn no_float_is_out_of_range() {
        for (sum, bits) in [
            (0.5, 1 << 24),
            (-1.75, -7 << 23),
            (f32::NAN, 0),
            (f32::INFINITY, i64::MAX),
            (f32::NEG_INFINITY, i64::MIN),
        ] {
            assert_eq!(sum.to_wide().to_bits(), bits);
        }
    }
}
