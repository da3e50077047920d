//! DTFT: c_k = sum_i p_i exp(-i 2 pi k u_i), the largest kept.

use super::{Basis, Impulse, Oscillators, Rule, Transform, oscillator};
use crate::fixed_point::{Phase, Sum};
use crate::phase::PhaseScale;

/// The Fourier transform of the impulse train (eq. 6 with phi_k(u) = exp(-i 2 pi k u)), for
/// moderate windows.
///
/// `[Impulse; n] -> [Sum; 2K]`, K real parts and then K imaginary ones, each of magnitude < n;
/// s(t) is real, so negative k are conjugates. Measured error of each part against f64, per event:
/// at most 2^-17.1 for K = 1,024 (`tests/fixed_vs_float.rs` enforces 2^-17, and n * 2^-14 for n
/// events).
#[derive(Debug, Clone, Copy)]
pub struct Dtft;

impl Basis for Dtft {
    const TRANSFORM: Transform = Transform::Dtft;
    const RULE: Rule = Rule::Magnitude;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        events: u32,
        scale: PhaseScale,
        grid: usize,
        work: &mut Oscillators,
        sums: &mut [Sum],
    ) {
        // exp(-i x) = cos(-x) + i sin(-x): the turn is -u.
        let turn = |impulse: Impulse| {
            let half = scale.half(impulse.offset_us).to_bits();
            Phase::from_bits((half << 1).wrapping_neg())
        };
        let Some((re, im)) = sums
            .get_mut(..2 * grid)
            .and_then(|sums| sums.split_at_mut_checked(grid))
        else {
            return;
        };
        oscillator::cosines_and_sines(
            &impulses,
            events == 1,
            turn,
            (&mut work.cos, &mut work.sin),
            (re, im),
        );
    }
}
