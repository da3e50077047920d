//! DTFT: c_k = sum_i p_i exp(-i 2 pi k u_i), the largest kept.

use core::f64::consts::TAU;

use super::{Basis, Impulse, Oscillators, Rule, Transform, cell_of, cells_log2_of, oscillator};
use crate::fixed_point::{Coefficient, Phase, Sum, mul_high};
use crate::packing::Shape;
use crate::phase::PhaseScale;
use crate::prune::{Kept, largest, low_frequency};
use crate::quantise::Levels;

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
        oscillator::cosines_and_sines(&impulses, turn, (&mut work.cos, &mut work.sin), (re, im));
    }

    /// The r largest by re^2 + im^2, whose rounding moves |c| by less than n 2^-14.
    #[inline(always)]
    fn prune<C: Coefficient>(
        sums: &[C],
        events: u32,
        shape: Shape,
        magnitudes: &mut [u32],
        kept: &mut Kept,
    ) {
        let Shape { grid, r, .. } = shape;
        if r == grid {
            return low_frequency(r, kept);
        }
        let width = u32::BITS - events.leading_zeros();
        // Always there: `Config::check` asks for room.
        let Some(magnitudes) = magnitudes.get_mut(..grid) else {
            return;
        };
        let (re, im) = sums.split_at_checked(grid).unwrap_or_default();
        for ((magnitude, re), im) in magnitudes.iter_mut().zip(re).zip(im) {
            *magnitude = square(re.relative(width)) + square(im.relative(width));
        }
        largest(magnitudes, r, kept);
    }

    #[inline(always)]
    fn quantise<C: Coefficient>(sums: &[C], shape: Shape, kept: &Kept, levels: &mut Levels<'_>) {
        let shift = shape.quantiser.shift();
        let (re, im) = sums.split_at_checked(shape.grid).unwrap_or_default();
        kept.for_each(shape.grid, |k| {
            if k > 0
                && let (Some(re), Some(im)) = (re.get(k), im.get(k))
            {
                levels.push_uniform([*re, *im], shift);
            }
        });
    }

    /// All coefficients of a single event have the magnitude 1 and tie: k = 0..r are kept.
    fn cells_log2(shape: Shape) -> u32 {
        cells_log2_of(2 * shape.r.saturating_sub(1), shape.quantiser)
    }

    #[inline(always)]
    fn cell(scale: PhaseScale, offset_us: u32, cells_log2: u32) -> u32 {
        cell_of(scale, offset_us, cells_log2)
    }

    fn single(u: f64, sign: f64, shape: Shape, mut each: impl FnMut(u16, f64, f64)) {
        for k in 0..shape.r as u16 {
            let (sin, cos) = libm::sincos(TAU * f64::from(k) * u);
            each(k, sign * cos, -sign * sin);
        }
    }
}

/// x^2 / 2^32
#[inline(always)]
fn square(x: i32) -> u32 {
    mul_high(x, x) as u32
}
