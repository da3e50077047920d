//! Atoms from `micromath`'s f32 cosine, computed one by one: a recurrence from start values as rough as these would
//! leave [-1, 1].

use micromath::F32Ext;

use super::{
    Accumulate, Impulse, Kernel, Phase, PhaseScale, dct_turn, dtft_turn, multiples, zeroed,
    zeroed_pairs,
};
use crate::fixed_point::CHUNK_EVENTS;
use crate::transform::{Dct, Dtft};

/// 2 pi 2^-32
const RADIANS: f32 = core::f32::consts::TAU / 4_294_967_296.0;

/// For comparison: the cost and the error of a fast approximation in single precision.
///
/// Measured |c_k - c_ref| per event for K = 1,024: DCT 2^-9.8, DTFT 2^-9.8; `tests/across/kernels.rs` enforces 2^-9.
#[derive(Debug, Clone, Copy)]
pub struct Micromath;

impl Accumulate<Dct> for Micromath {
    const KERNEL: Kernel = Kernel::Micromath;
    type Sum = f32;
    type Work = ();

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        (): &mut (),
        sums: &mut [f32],
    ) {
        let Some(sums) = zeroed(sums, grid) else {
            return;
        };
        for impulse in impulses.take(CHUNK_EVENTS) {
            let phases = multiples(dct_turn(scale, impulse));
            for (sum, phase) in sums.iter_mut().zip(phases) {
                add(sum, F32Ext::cos(radians(phase)), impulse);
            }
        }
    }
}

impl Accumulate<Dtft> for Micromath {
    const KERNEL: Kernel = Kernel::Micromath;
    type Sum = f32;
    type Work = ();

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        (): &mut (),
        sums: &mut [f32],
    ) {
        let Some(sums) = zeroed_pairs(sums, grid) else {
            return;
        };
        for impulse in impulses.take(CHUNK_EVENTS) {
            let phases = multiples(dtft_turn(scale, impulse));
            for ([re, im], phase) in sums.iter_mut().zip(phases) {
                let angle = radians(phase);
                add(re, F32Ext::cos(angle), impulse);
                add(im, F32Ext::sin(angle), impulse);
            }
        }
    }
}

/// Converts a phase to radians, from -pi to pi.
#[inline(always)]
fn radians(phase: Phase) -> f32 {
    phase.to_bits() as i32 as f32 * RADIANS
}

#[inline(always)]
fn add(sum: &mut f32, atom: f32, impulse: Impulse) {
    if impulse.is_on {
        *sum += atom;
    } else {
        *sum -= atom;
    }
}
