//! DCT: c_k = sum_i p_i cos(pi k u_i), the low frequencies kept.

use super::{Basis, Impulse, Rule, Transform, accumulate_cosines, net_sign};
use crate::fixed_point::{Coefficient, Sum};
use crate::quantise::{Level, Quantiser};

/// The cosine transform (eq. 6 with phi_k(u) = cos(pi k u)), for dense windows.
///
/// `[Impulse; n] -> [Sum; K]`. Measured error against f64: at most n * 2^-15
/// (`tests/fixed_vs_float.rs` enforces n * 2^-14); c_0 is exact.
#[derive(Debug, Clone, Copy)]
pub struct Dct;

impl Basis for Dct {
    const TRANSFORM: Transform = Transform::Dct;
    const RULE: Rule = Rule::LowFrequency;

    fn accumulate(impulses: &[Impulse], grid: usize, sums: &mut [Sum]) {
        // Half a turn of the cosine is one window, hence phase / 2 per k.
        accumulate_cosines(impulses, 0, |phase| phase.to_bits() >> 1, &mut sums[..grid]);
        sums[0] = net_sign(impulses);
    }

    #[inline]
    fn magnitude<C: Coefficient>(sums: &[C], _grid: usize, k: usize) -> u64 {
        sums[k].wide().to_bits().unsigned_abs()
    }

    #[inline]
    fn level<C: Coefficient>(
        sums: &[C],
        _: usize,
        k: usize,
        quantiser: Quantiser,
    ) -> (Level, bool) {
        let (re, saturated) = quantiser.uniform(sums[k].wide());
        (
            Level {
                k: k as u16,
                re,
                im: 0,
            },
            saturated,
        )
    }
}
