//! Sums p cos(k a) and p sin(k a) for k = 1, 2, ... by the Chebyshev recurrence x_k = 2 cos(a) x_(k-1) - x_(k-2),
//! with three instructions per coefficient including the sum.
//!
//! The rounding error grows as k^2, so the recurrence restarts from the cosine table every [`RUN`] coefficients.
//! The error of an atom, for any a and k < 1,024, has these parts:
//!
//! - at most 32^2 / 2 roundings of 2^-29: 2^-20;
//! - 32 times the error of the start values: 2^-22. Near whole and half turns, where it would count k^2 times, the
//!   polynomial's error vanishes, as it is proportional to the sine;
//! - the scale [`WEIGHT`]: 2^-18;
//! - rounding down of each product in the sum: 2^-25;
//! - k times the error of the phase ([`crate::transform::phase`]).
//!
//! [`super::Recurrence`] gives the measured total.

#[cfg(eecvs_dsp)]
mod armv7em;

use crate::accumulate::cosine::{cos, cos_sin};
use crate::fixed_point::{Atom, CHUNK_EVENTS, Phase, Sum, mul_high_add, mul_high_round};
use crate::group::impulse::Impulse;

/// Number of coefficients between two starts of the recurrence.
pub const RUN: usize = 32;

/// 2^27 (1 - 2^-18): converts 30 fractional bits to 25 and keeps every atom strictly below 1.
///
/// The recurrence's own error is below 2^-18, so that |c_k| < n holds for n events. The levels of a pixel of n
/// events therefore need no extra bit for n itself.
const WEIGHT: i32 = (1 << 27) - (1 << 9);

/// The recurrence of one event.
#[derive(Debug, Clone, Copy)]
pub struct Oscillator {
    /// cos(a), the step.
    cos: i32,
    /// p in the scale of [`WEIGHT`].
    weight: i32,
    /// x_(k-1).
    before: i32,
    /// x_k.
    now: i32,
}

impl Oscillator {
    /// An oscillator that adds nothing.
    pub const AT_REST: Self = Self {
        cos: 0,
        weight: 0,
        before: 0,
        now: 0,
    };

    /// Returns an oscillator at k = 1, with a step of `cos`, from x_0 in `before` and x_1 in `now`.
    #[inline(always)]
    fn start(impulse: Impulse, cos: Atom, before: Atom, now: Atom) -> Self {
        Self {
            cos: cos.to_bits(),
            weight: if impulse.is_on { WEIGHT } else { -WEIGHT },
            before: before.to_bits(),
            now: now.to_bits(),
        }
    }

    /// Adds p x_k to p x_(k+N-1) to `sums`, and moves on to k + N.
    #[inline(always)]
    fn add<const N: usize>(&mut self, sums: &mut [i32; N]) {
        for sum in sums {
            *sum = mul_high_add(*sum, self.now, self.weight);
            // The product has 28 fractional bits and is doubled: cos(a) x in [-1, 1]. At the ends of this range the
            // shift wraps, and the difference wraps back.
            let next = (mul_high_round(self.cos, self.now) << 3).wrapping_sub(self.before);
            self.before = self.now;
            self.now = next;
        }
    }

    /// Does [`Self::add`] for seven sums, as many as fit the registers with the other values.
    #[inline(always)]
    fn add_seven(&mut self, sums: &mut [i32; 7]) {
        #[cfg(eecvs_dsp)]
        armv7em::add_seven(self, sums);
        #[cfg(not(eecvs_dsp))]
        self.add(sums);
    }
}

/// Memory for the oscillators of a chunk and for the sums of a run.
#[derive(Debug)]
pub struct Oscillators {
    cos: [Oscillator; CHUNK_EVENTS],
    sin: [Oscillator; CHUNK_EVENTS],
    /// Sums of the real and the imaginary parts.
    runs: [[Sum; RUN]; 2],
}

impl Default for Oscillators {
    fn default() -> Self {
        Self {
            cos: [Oscillator::AT_REST; CHUNK_EVENTS],
            sin: [Oscillator::AT_REST; CHUNK_EVENTS],
            runs: [[Sum::ZERO; RUN]; 2],
        }
    }
}

/// Writes the sums of N neighbouring coefficients, kept in registers over all oscillators.
#[inline(always)]
fn block<const N: usize>(
    oscillators: &mut [Oscillator],
    sums: &mut [Sum],
    add: impl Fn(&mut Oscillator, &mut [i32; N]),
) {
    let mut block = [0; N];
    for oscillator in oscillators {
        add(oscillator, &mut block);
    }
    for (sum, bits) in sums.iter_mut().zip(block) {
        *sum = Sum::from_bits(bits);
    }
}

/// Writes the sums of as many coefficients as `sums` has room for, seven at a time. Out of line, so that the loops
/// have all registers to themselves.
#[inline(never)]
fn run(oscillators: &mut [Oscillator], sums: &mut [Sum]) {
    let mut rest = sums;
    while rest.len() >= 7
        && let Some((sums, more)) = core::mem::take(&mut rest).split_first_chunk_mut::<7>()
    {
        block(oscillators, sums, Oscillator::add_seven);
        rest = more;
    }
    for sums in rest.chunks_mut(2) {
        block(oscillators, sums, Oscillator::add::<2>);
    }
}

/// Returns k times a phase.
#[inline(always)]
fn times(turn: Phase, k: usize) -> Phase {
    Phase::from_bits(turn.to_bits().wrapping_mul(k as u32))
}

/// Returns the first coefficient and the end of each run after a grid's first.
fn later_runs(grid: usize) -> impl Iterator<Item = (usize, usize)> {
    (RUN..grid)
        .step_by(RUN)
        .map(move |first| (first, grid.min(first + RUN)))
}

/// Fills `work` with an oscillator from `start` for each of `impulses`; returns those filled.
#[inline(always)]
fn fill(
    impulses: impl Iterator<Item = Impulse>,
    work: &mut [Oscillator],
    start: impl Fn(Impulse) -> Oscillator,
) -> &mut [Oscillator] {
    let mut len = 0;
    for (oscillator, impulse) in work.iter_mut().zip(impulses) {
        *oscillator = start(impulse);
        len += 1;
    }
    work.get_mut(..len).unwrap_or_default()
}

/// Writes sum p cos(k a) for k in 1..`sums.len()` to `sums`. `turn` maps an impulse to a in turns.
#[inline(always)]
pub fn cosines(
    impulses: &(impl Iterator<Item = Impulse> + Clone),
    turn: impl Fn(Impulse) -> Phase + Copy,
    work: &mut Oscillators,
    sums: &mut [Sum],
) {
    let work = &mut work.cos;
    let first = |impulse: Impulse| {
        let cos = cos(turn(impulse));
        Oscillator::start(impulse, cos, Atom::ONE, cos)
    };
    let grid = sums.len();
    let sums_of_run = sums.get_mut(1..grid.min(RUN)).unwrap_or(&mut []);
    run(first_cosines(impulses.clone(), first, work), sums_of_run);
    for (k, end) in later_runs(grid) {
        let oscillators = fill(impulses.clone(), work, |impulse| {
            let turn = turn(impulse);
            let x = [k - 1, k].map(|k| cos(times(turn, k)));
            Oscillator::start(impulse, cos(turn), x[0], x[1])
        });
        run(oscillators, sums.get_mut(k..end).unwrap_or_default());
    }
}

/// Out of line, like all loops here, so that it has all registers to itself.
#[inline(never)]
fn first_cosines(
    impulses: impl Iterator<Item = Impulse>,
    start: impl Fn(Impulse) -> Oscillator,
    work: &mut [Oscillator],
) -> &mut [Oscillator] {
    fill(impulses, work, start)
}

/// Does the same as [`cosines`], with sum p sin(k a) after every cosine sum.
#[inline(always)]
pub fn cosines_and_sines(
    impulses: &(impl Iterator<Item = Impulse> + Clone),
    turn: impl Fn(Impulse) -> Phase + Copy,
    work: &mut Oscillators,
    sums: &mut [[Sum; 2]],
) {
    let grid = sums.len();
    let first = |impulse: Impulse| {
        let (cos, sin) = cos_sin(turn(impulse));
        (
            Oscillator::start(impulse, cos, Atom::ONE, cos),
            Oscillator::start(impulse, cos, Atom::ZERO, sin),
        )
    };
    let len = fill_pairs(impulses.clone(), first, &mut work.cos, &mut work.sin);
    run_pairs(work, len, sums, (1, grid.min(RUN)));
    for (k, end) in later_runs(grid) {
        let start = |impulse: Impulse| {
            let turn = turn(impulse);
            let step = cos(turn);
            let x = [k - 1, k].map(|k| cos_sin(times(turn, k)));
            (
                Oscillator::start(impulse, step, x[0].0, x[1].0),
                Oscillator::start(impulse, step, x[0].1, x[1].1),
            )
        };
        let len = fill_pairs(impulses.clone(), start, &mut work.cos, &mut work.sin);
        run_pairs(work, len, sums, (k, end));
    }
}

/// Calls [`run`] for the first `len` oscillators and writes the sums from `k` to `end`, which must exist.
#[inline(always)]
fn run_pairs(work: &mut Oscillators, len: usize, sums: &mut [[Sum; 2]], (k, end): (usize, usize)) {
    let Oscillators { cos, sin, runs } = work;
    let sums = sums.get_mut(k..end).unwrap_or_default();
    for (oscillators, parts) in [cos, sin].into_iter().zip(&mut *runs) {
        let parts = parts.get_mut(..sums.len()).unwrap_or_default();
        run(oscillators.get_mut(..len).unwrap_or_default(), parts);
    }
    let [re, im] = runs;
    for ((sum, re), im) in sums.iter_mut().zip(re).zip(im) {
        *sum = [*re, *im];
    }
}

/// Fills cosine and sine oscillators for `impulses`; returns how many.
#[inline(never)]
fn fill_pairs(
    impulses: impl Iterator<Item = Impulse>,
    start: impl Fn(Impulse) -> (Oscillator, Oscillator),
    cos_work: &mut [Oscillator],
    sin_work: &mut [Oscillator],
) -> usize {
    let mut len = 0;
    for ((cos, sin), impulse) in cos_work.iter_mut().zip(sin_work).zip(impulses) {
        (*cos, *sin) = start(impulse);
        len += 1;
    }
    len
}
