//! DTFT: c_k = sum_i p_i exp(-i 2 pi k u_i), the largest kept.

use super::{Basis, Impulse, Rule, Transform, accumulate_cosines, net_sign};
use crate::fixed_point::{Coefficient, Phase, Sum};
use crate::quantise::{Level, Quantiser};

/// A quarter of a turn: -sin x = cos(x + pi/2).
const QUARTER: u32 = 1 << 30;

/// The Fourier transform of the impulse train (eq. 6 with phi_k(u) = exp(-i 2 pi k u)), for
/// moderate windows.
///
/// `[Impulse; n] -> [Sum; 2K]`, K real parts and then K imaginary ones; s(t) is real, so negative
/// k are conjugates. Measured error of each part against f64: at most n * 2^-15
/// (`tests/fixed_vs_float.rs` enforces n * 2^-14); c_0 is exact.
#[derive(Debug, Clone, Copy)]
pub struct Dtft;

impl Basis for Dtft {
    const TRANSFORM: Transform = Transform::Dtft;
    const RULE: Rule = Rule::Magnitude;

    fn accumulate(impulses: &[Impulse], grid: usize, sums: &mut [Sum]) {
        let (re, im) = sums[..2 * grid].split_at_mut(grid);
        accumulate_cosines(impulses, 0, Phase::to_bits, re);
        accumulate_cosines(impulses, QUARTER, Phase::to_bits, im);
        re[0] = net_sign(impulses);
        im[0] = Sum::ZERO;
    }

    /// |c_k|^2. The one magnitude of a single event's coefficients is 1 for every k, which table
    /// noise would order at random: the encoder knows it in closed form and never asks.
    #[inline]
    fn magnitude<C: Coefficient>(sums: &[C], grid: usize, k: usize) -> u64 {
        C::energy(sums[k], sums[grid + k])
    }

    #[inline]
    fn level<C: Coefficient>(
        sums: &[C],
        grid: usize,
        k: usize,
        quantiser: Quantiser,
    ) -> (Level, bool) {
        let (re, re_saturated) = quantiser.uniform(sums[k].wide());
        let (im, im_saturated) = quantiser.uniform(sums[grid + k].wide());
        (
            Level {
                k: k as u16,
                re,
                im,
            },
            re_saturated || im_saturated,
        )
    }
}
