//! Refines event times until the pixel's equations hold: least squares, then the centre of the possible times.
//!
//! [`least_squares`] is the Levenberg-Marquardt damped Gauss-Newton method on F(u) = sum_m r_m(u)^2; each step
//! solves (J^T J + lambda diag) d = J^T r.
//!
//! The coefficients were quantised, so the residual is not Gaussian: all times whose residual is within h (half a
//! step plus the kernel's error bound) in every row are equally likely, and no others are possible. [`centre`] moves
//! to the analytic centre of these times, the minimum of B(u) = -sum_m log(h^2 - r_m^2), by Newton steps with
//! J^T W J as the second derivatives. If least squares ends outside of them, it first weights the rows by
//! (|r_m| / max |r|)^6, at least 0.05^6, which reduces the largest residuals.
//!
//! Marquardt, SIAM J. Appl. Math. 11 (1963); Boyd, Vandenberghe: *Convex Optimization*, 8.5.3.

use super::crowd::DensityWork;
use super::equations::Equations;
use super::lanes::{Lanes, wide};
use super::normal::Normal;

/// Largest number of least-squares rounds; nearly all pixels converge earlier.
pub const LEAST_SQUARES_ROUNDS: usize = 40;
/// Largest number of damping factors that are tried in a round.
pub(super) const TRIALS: usize = 8;
/// Largest number of weighted rounds.
pub(super) const WEIGHTED_ROUNDS: usize = 24;
/// Largest number of Newton rounds on the barrier.
pub(super) const CENTRE_ROUNDS: usize = 10;
/// Largest number of times that a Newton step is halved.
pub(super) const HALVINGS: usize = 12;
/// The rounds end once a step moves no event by more than this fraction of the window.
const STILL: f64 = 1e-10;
/// The rounds end once the sum of squares falls by no more than this fraction of it.
const LEVEL: f64 = 1e-9;
/// The same where the residual is down to the quantisation error: how it varies does not say more about the times.
const LEVEL_QUANTISED: f64 = 1e-5;
/// RMS residual, in units of h, below which the residual is taken to be quantisation error. Uniform errors have an
/// RMS of 0.58, with a standard deviation of 0.05 over 30 rows.
pub(super) const RMS_QUANTISED: f64 = 0.75;

/// How long least squares go on where a solution is far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// As long as there is any progress.
    Long,
    /// Where the RMS residual is three h and more, while a round reduces the sum of squares by 0.3 %: what moves as
    /// slowly hardly ever becomes a solution of many events.
    Medium,
    /// Without a solution, while a round reduces the sum of squares by 1 %: there are other starting points.
    Short,
}

impl Patience {
    /// Returns the smallest fraction of the sum of squares that a round has to gain where the RMS residual, in units
    /// of h, is `rms`.
    #[inline(always)]
    fn least_gain(self, rms: f64) -> f64 {
        match self {
            _ if rms < RMS_QUANTISED => LEVEL_QUANTISED,
            Self::Medium if rms >= 3.0 => 0.003,
            Self::Short if rms >= RMS_SOLVED => 0.01,
            _ => LEVEL,
        }
    }
}

/// RMS residual, in units of h, below which times count as a solution.
pub(super) const RMS_SOLVED: f64 = 1.0;

/// Buffers reused from pixel to pixel.
#[derive(Debug, Default)]
pub struct Work {
    residual: Vec<f64>,
    trial: Vec<f64>,
    sums: Vec<Lanes>,
    slopes: Vec<Lanes>,
    /// Of a trial.
    trial_slopes: Vec<Lanes>,
    weights: Vec<f64>,
    /// Times of a trial.
    next: Vec<f64>,
    pub(super) normal: Normal,
    pub(super) density: DensityWork,
    /// Units of work spent, see [`super::cost`].
    units: u64,
}

impl Work {
    /// Counts work that is about to be done.
    pub const fn spend(&mut self, units: u64) {
        self.units = self.units.saturating_add(units);
    }

    /// Computes the residual after `scale` times a step from the times `u`.
    #[inline(always)]
    fn look(&mut self, equations: &Equations, u: &[f64], scale: f64) {
        self.step(equations, u, scale);
        equations.residual(&self.next, &mut self.sums, &mut self.trial);
    }

    /// As [`Self::look`], with the slopes: nearly all trials are the start of the next round.
    #[inline(always)]
    fn look_further(&mut self, equations: &Equations, u: &[f64], scale: f64) {
        self.step(equations, u, scale);
        equations.linearise(
            &self.next,
            &mut self.sums,
            &mut self.trial,
            &mut self.trial_slopes,
        );
    }

    /// Computes the times after `scale` times a step from the times `u`.
    #[inline(always)]
    fn step(&mut self, equations: &Equations, u: &[f64], scale: f64) {
        for ((next, u), d) in self.next.iter_mut().zip(u).zip(self.normal.step()) {
            *next = u + scale * d;
            if !equations.transform.is_complex() {
                *next = next.clamp(0.0, 1.0);
            }
        }
    }

    /// Returns the units of work spent since the last call.
    pub const fn take_units(&mut self) -> u64 {
        std::mem::replace(&mut self.units, 0)
    }
}

fn squares(weights: &[f64], residual: &[f64]) -> f64 {
    weights.iter().zip(residual).map(|(w, r)| w * r * r).sum()
}

/// Returns the largest |r_m|, in units of a coefficient.
pub fn largest(equations: &Equations, u: &[f64], work: &mut Work) -> f64 {
    work.spend(equations.size().residual(u.len() as u64));
    residual(equations, u, work);
    most(&work.residual)
}

/// Computes the residual.
fn residual(equations: &Equations, u: &[f64], work: &mut Work) {
    #[inline(always)]
    fn residual(equations: &Equations, u: &[f64], work: &mut Work) {
        equations.residual(u, &mut work.sums, &mut work.residual);
    }
    wide!(residual, equations: &Equations, u: &[f64], work: &mut Work);
}

fn most(residual: &[f64]) -> f64 {
    residual.iter().fold(0.0, |most, r| r.abs().max(most))
}

/// Returns the root mean square of r_m in units of h.
pub fn rms(equations: &Equations, u: &[f64], work: &mut Work) -> f64 {
    work.spend(equations.size().residual(u.len() as u64));
    residual(equations, u, work);
    let sum: f64 = work.residual.iter().map(|r| r * r).sum();
    (sum / equations.rows().max(1) as f64).sqrt() / equations.half
}

/// Moves the times `u` (normalised to the window) to a nearby minimum of sum_m r_m^2, in at most `rounds` steps.
pub fn least_squares(
    equations: &Equations,
    u: &mut [f64],
    (rounds, patience): (usize, Patience),
    work: &mut Work,
) {
    wide!(
        unweighted,
        equations: &Equations, u: &mut [f64], rounds: usize, patience: Patience, work: &mut Work
    );
}

#[inline(always)]
fn unweighted(
    equations: &Equations,
    u: &mut [f64],
    rounds: usize,
    patience: Patience,
    work: &mut Work,
) {
    work.weights.clear();
    work.weights.resize(equations.rows(), 1.0);
    weighted(equations, u, work, rounds, Rows::Alike(patience));
}

/// Weights of the rows of least squares.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rows {
    /// The same for all.
    Alike(Patience),
    /// They follow the residual, to this power.
    ByResidual(i32),
}

/// Runs Levenberg-Marquardt. Where the weights follow the residual, it ends once all rows hold.
#[inline(always)]
fn weighted(equations: &Equations, u: &mut [f64], work: &mut Work, rounds: usize, rows: Rows) {
    let n = u.len();
    // In one step no event moves by more than half a period of the highest DTFT atom, or a quarter of that of the
    // DCT.
    let reach = 0.5 / f64::from(equations.ks.last().copied().unwrap_or(1).max(1));
    let mut lambda = 1e-3;
    work.next.resize(n, 0.0);
    let (size, events) = (equations.size(), n as u64);
    work.spend(size.linearise(events));
    equations.linearise(u, &mut work.sums, &mut work.residual, &mut work.slopes);
    for _ in 0..rounds {
        if let Rows::ByResidual(power) = rows {
            let most = most(&work.residual);
            if most < equations.half * 0.98 {
                return;
            }
            for (weight, r) in work.weights.iter_mut().zip(&work.residual) {
                *weight = (r.abs() / most).max(0.05).powi(power);
            }
        }
        let before = squares(&work.weights, &work.residual);
        work.spend(size.normal(events));
        work.normal
            .fill(&work.slopes, n, &work.weights, &work.residual);
        let mut moved = 0.0_f64;
        let mut gained = 0.0;
        for _ in 0..TRIALS {
            work.spend(size.trial(events));
            if !work.normal.solve(lambda) {
                lambda = (lambda * 10.0).max(1e-9);
                continue;
            }
            moved = most(work.normal.step());
            let scale = (reach / moved).min(1.0);
            work.look_further(equations, u, scale);
            let after = squares(&work.weights, &work.trial);
            if after < before {
                u.copy_from_slice(&work.next);
                std::mem::swap(&mut work.residual, &mut work.trial);
                std::mem::swap(&mut work.slopes, &mut work.trial_slopes);
                gained = before - after;
                lambda = match gained / work.normal.predicted(scale) {
                    ratio if ratio > 0.75 => (lambda * 0.1).max(1e-12),
                    ratio if ratio < 0.25 => lambda * 4.0,
                    _ => lambda,
                };
                break;
            }
            lambda *= 10.0;
            if moved < STILL {
                break;
            }
        }
        let least_gain = match rows {
            Rows::Alike(patience) => {
                let mean = (before - gained) / equations.rows().max(1) as f64;
                patience.least_gain(mean.sqrt() / equations.half)
            }
            Rows::ByResidual(_) => LEVEL,
        };
        if gained <= least_gain * before || moved < STILL {
            return;
        }
    }
}

/// Moves the times `u` (normalised to the window) to the analytic centre of the times whose residual is within h;
/// returns whether times within h were found nearby. If not, `u` is unchanged.
pub fn centre(equations: &Equations, u: &mut [f64], work: &mut Work) -> bool {
    wide!(centred, equations: &Equations, u: &mut [f64], work: &mut Work; bool)
}

#[inline(always)]
fn centred(equations: &Equations, u: &mut [f64], work: &mut Work) -> bool {
    let half = equations.half;
    if largest(equations, u, work) >= half {
        let mut better = u.to_vec();
        weighted(
            equations,
            &mut better,
            work,
            WEIGHTED_ROUNDS,
            Rows::ByResidual(6),
        );
        if largest(equations, &better, work) >= half {
            return false;
        }
        u.copy_from_slice(&better);
    }
    let n = u.len();
    work.next.resize(n, 0.0);
    let (size, events) = (equations.size(), n as u64);
    for _ in 0..CENTRE_ROUNDS {
        work.spend(size.linearise(events) + size.normal(events) + size.solve(events));
        equations.linearise(u, &mut work.sums, &mut work.residual, &mut work.slopes);
        let Some(before) = barrier(&work.residual, half) else {
            break;
        };
        // B' = sum 2 r r' / (h^2 - r^2), B'' ~ sum 2 (h^2 + r^2) r' r' / (h^2 - r^2)^2.
        work.trial.clear();
        for (weight, r) in work.weights.iter_mut().zip(&work.residual) {
            let room = half * half - r * r;
            *weight = 2.0 * (half * half + r * r) / (room * room);
        }
        work.trial.extend(work.residual.iter().map(|r| {
            let room = half * half - r * r;
            r * room / (half * half + r * r)
        }));
        work.normal
            .fill(&work.slopes, n, &work.weights, &work.trial);
        if !work.normal.solve(1e-9) {
            break;
        }
        let mut scale = 1.0;
        let mut is_better = false;
        for _ in 0..HALVINGS {
            work.spend(size.residual(events));
            work.look(equations, u, scale);
            if barrier(&work.trial, half).is_some_and(|after| after < before) {
                is_better = true;
                break;
            }
            scale *= 0.5;
        }
        if !is_better {
            break;
        }
        u.copy_from_slice(&work.next);
        if most(work.normal.step()) * scale < STILL {
            break;
        }
    }
    true
}

/// Returns B(u), up to a constant, of the residual; `None` if it is not within `half`.
fn barrier(residual: &[f64], half: f64) -> Option<f64> {
    let mut sum = 0.0;
    // A room is at least 2^-53, so the product of sixteen is above the smallest number.
    for rows in residual.chunks(16) {
        let mut product = 1.0;
        for r in rows {
            let room = 1.0 - (r / half).powi(2);
            if room <= 0.0 {
                return None;
            }
            product *= room;
        }
        sum -= product.ln();
    }
    Some(sum)
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Transform;
    use proptest::prelude::*;

    use super::*;
    use crate::reconstruct::test_pixel;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// AVX2 only makes it faster: the times are the same to the bit, and so is the work that is counted.
        #[test]
        fn vector_instructions_change_nothing(
            events in proptest::collection::vec((0..5000_u32, any::<bool>(), 0.0..1.0_f64), 2..24),
            step_log2 in -12..=-4_i8,
            is_dct: bool,
        ) {
            let transform = if is_dct { Transform::Dct } else { Transform::Dtft };
            let header = test_pixel::header(transform, 12, step_log2, 5000);
            let sent: Vec<_> = events.iter().map(|(t, is_on, _)| (*t, *is_on)).collect();
            let pixel = test_pixel::pixel(&header, &sent);
            let equations = Equations::new(&header, &pixel).with_signs();
            let start: Vec<f64> = events.iter().map(|(.., u)| *u).collect();
            let (mut wide, mut plain) = (start.clone(), start);
            let [mut work, mut other] = [Work::default(), Work::default()];
            least_squares(&equations, &mut wide, (20, Patience::Long), &mut work);
            unweighted(&equations, &mut plain, 20, Patience::Long, &mut other);
            prop_assert_eq!(&wide, &plain);
            let is_within = centre(&equations, &mut wide, &mut work);
            prop_assert_eq!(is_within, centred(&equations, &mut plain, &mut other));
            prop_assert_eq!(wide, plain);
            prop_assert_eq!(work.take_units(), other.take_units());
        }
    }
}
