//! DCT: c_k = sum_i p_i cos(pi k u_i), the low frequencies kept.

use super::{Basis, Impulse, Oscillators, Rule, Transform, oscillator, rows};
use crate::fixed_point::{CHUNK_EVENTS, Sum};
use crate::phase::PhaseScale;

/// The cosine transform (eq. 6 with phi_k(u) = cos(pi k u)), for dense windows.
///
/// `[Impulse; n] -> [Sum; K]`, |c_k| < n. Measured error against f64, per event: at most 2^-17.4
/// for K = 1,024 (`tests/fixed_vs_float.rs` enforces 2^-17, and n * 2^-14 for n events); for K up
/// to 8, where [`rows`] has the atoms, 2^-14.28, which it enforces.
#[derive(Debug, Clone, Copy)]
pub struct Dct;

impl Basis for Dct {
    const TRANSFORM: Transform = Transform::Dct;
    const RULE: Rule = Rule::LowFrequency;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        events: u32,
        scale: PhaseScale,
        grid: usize,
        work: &mut Oscillators,
        sums: &mut [Sum],
    ) {
        // Half a turn of the cosine is one window.
        let turn = |impulse: Impulse| scale.half(impulse.offset_us);
        if grid <= rows::GRID {
            let cosines = rows::cosines(impulses.take(CHUNK_EVENTS), turn);
            for (sum, cosine) in sums.iter_mut().take(grid).skip(1).zip(cosines) {
                *sum = rows::sum(cosine);
            }
            return;
        }
        let Some(sums) = sums.get_mut(..grid) else {
            return;
        };
        oscillator::cosines(&impulses, events == 1, turn, &mut work.cos, sums);
    }
}
