//! Atoms of [`crate::accumulate::cosine`] at 64-bit phases, computed one by one.
//!
//! A recurrence would need more than 30 fractional bits, and thus products of three instructions, to stay within
//! the bound. Here no error grows with k.

use fixed::types::I34F30;

use super::{Accumulate, Impulse, Kernel, PhaseScale, zeroed, zeroed_pairs};
use crate::accumulate::cosine::{cos, cos_sin};
use crate::fixed_point::{Atom, CHUNK_EVENTS, Phase};
use crate::transform::{Dct, Dtft};

/// Sum of the signed atoms of a chunk.
pub type PreciseSum = I34F30;

/// The high-precision kernel.
///
/// The error of an atom is at most 2^-27 from [`crate::accumulate::cosine`] plus 2^-30.3 from the phase, which has
/// 64 bits until k times it is rounded to 32. Measured |c_k - c_ref| per event for K = 1,024: DCT 2^-27.2, DTFT
/// 2^-27.1; `tests/across/kernels.rs` enforces 2^-26.
#[derive(Debug, Clone, Copy)]
pub struct Precise;

impl Accumulate<Dct> for Precise {
    const KERNEL: Kernel = Kernel::Precise;
    type Sum = PreciseSum;
    type Work = ();

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        (): &mut (),
        sums: &mut [PreciseSum],
    ) {
        let Some(sums) = zeroed(sums, grid) else {
            return;
        };
        for impulse in impulses.take(CHUNK_EVENTS) {
            let turn = scale.half_wide(impulse.offset_us);
            for (sum, phase) in sums.iter_mut().zip(multiples(turn)) {
                add(sum, cos(phase), impulse.is_on);
            }
        }
    }
}

impl Accumulate<Dtft> for Precise {
    const KERNEL: Kernel = Kernel::Precise;
    type Sum = PreciseSum;
    type Work = ();

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        (): &mut (),
        sums: &mut [PreciseSum],
    ) {
        let Some(sums) = zeroed_pairs(sums, grid) else {
            return;
        };
        for impulse in impulses.take(CHUNK_EVENTS) {
            // exp(-i x) = cos(-x) + i sin(-x), so the turn is -u.
            let turn = (scale.half_wide(impulse.offset_us) << 1).wrapping_neg();
            for ([re, im], phase) in sums.iter_mut().zip(multiples(turn)) {
                let (cos, sin) = cos_sin(phase);
                add(re, cos, impulse.is_on);
                add(im, sin, impulse.is_on);
            }
        }
    }
}

/// Returns the phases of k = 1, 2, ..., rounded to the nearest of 32 bits.
#[inline(always)]
fn multiples(turn: u64) -> impl Iterator<Item = Phase> {
    let mut phase = 0_u64;
    core::iter::repeat_with(move || {
        phase = phase.wrapping_add(turn);
        Phase::from_bits((phase.wrapping_add(1 << 31) >> 32) as u32)
    })
}

/// Adds p times an atom. A chunk's sum stays far below the type's limit of 2^33.
#[inline(always)]
fn add(sum: &mut PreciseSum, atom: Atom, is_on: bool) {
    let atom = i64::from(atom.to_bits());
    let signed = if is_on { atom } else { -atom };
    *sum = sum.wrapping_add(PreciseSum::from_bits(signed));
}
