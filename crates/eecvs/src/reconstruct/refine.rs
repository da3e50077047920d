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

use nalgebra::{DMatrix, DVector};

use super::equations::Equations;

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

/// Buffers reused from pixel to pixel.
#[derive(Debug, Default)]
pub struct Work {
    residual: Vec<f64>,
    trial: Vec<f64>,
    slopes: Vec<f64>,
    weights: Vec<f64>,
    /// Units of work spent, see [`super::cost`].
    units: u64,
}

impl Work {
    /// Counts work that is about to be done.
    pub const fn spend(&mut self, units: u64) {
        self.units = self.units.saturating_add(units);
    }

    /// Returns the units of work spent since the last call.
    pub const fn take_units(&mut self) -> u64 {
        std::mem::replace(&mut self.units, 0)
    }
}

/// Returns J^T diag(w) J and J^T diag(w) v.
fn normal(
    slopes: &[f64],
    rows: usize,
    n: usize,
    weights: &[f64],
    v: &[f64],
) -> (DMatrix<f64>, DVector<f64>) {
    let mut matrix = DMatrix::zeros(n, n);
    let mut vector = DVector::zeros(n);
    let mut weighted = vec![0.0; rows];
    for i in 0..n {
        let column = &slopes[i * rows..(i + 1) * rows];
        for ((to, slope), weight) in weighted.iter_mut().zip(column).zip(weights) {
            *to = slope * weight;
        }
        vector[i] = weighted.iter().zip(v).map(|(a, b)| a * b).sum();
        for j in 0..=i {
            let other = &slopes[j * rows..(j + 1) * rows];
            let sum: f64 = weighted.iter().zip(other).map(|(a, b)| a * b).sum();
            matrix[(i, j)] = sum;
            matrix[(j, i)] = sum;
        }
    }
    (matrix, vector)
}

/// Solves (matrix + lambda diag) d = vector; `None` if that matrix is not positive definite.
fn damped(matrix: &DMatrix<f64>, vector: &DVector<f64>, lambda: f64) -> Option<DVector<f64>> {
    let mut damped = matrix.clone();
    let mean = matrix.trace() / matrix.nrows().max(1) as f64;
    for i in 0..matrix.nrows() {
        damped[(i, i)] += lambda * (matrix[(i, i)] + 1e-3 * mean);
    }
    let step = damped.cholesky()?.solve(vector);
    step.iter().all(|d| d.is_finite()).then_some(step)
}

fn squares(weights: &[f64], residual: &[f64]) -> f64 {
    weights.iter().zip(residual).map(|(w, r)| w * r * r).sum()
}

/// Returns the largest |r_m|, in units of a coefficient.
pub fn largest(equations: &Equations, u: &[f64], work: &mut Work) -> f64 {
    work.spend(equations.size().residual(u.len() as u64));
    equations.residual(u, &mut work.residual);
    most(&work.residual)
}

fn most(residual: &[f64]) -> f64 {
    residual.iter().fold(0.0, |most, r| r.abs().max(most))
}

/// Returns the root mean square of r_m in units of h.
pub fn rms(equations: &Equations, u: &[f64], work: &mut Work) -> f64 {
    work.spend(equations.size().residual(u.len() as u64));
    equations.residual(u, &mut work.residual);
    let sum: f64 = work.residual.iter().map(|r| r * r).sum();
    (sum / equations.rows().max(1) as f64).sqrt() / equations.half
}

/// Moves the times `u` (normalised to the window) to a nearby minimum of sum_m r_m^2, in at most `rounds` steps.
pub fn least_squares(equations: &Equations, u: &mut [f64], rounds: usize, work: &mut Work) {
    work.weights.clear();
    work.weights.resize(equations.rows(), 1.0);
    weighted(equations, u, work, rounds, None);
}

/// Runs Levenberg-Marquardt. With `power` the weights follow the residual, and it ends once all rows hold.
fn weighted(
    equations: &Equations,
    u: &mut [f64],
    work: &mut Work,
    rounds: usize,
    power: Option<i32>,
) {
    let (rows, n) = (equations.rows(), u.len());
    // In one step no event moves by more than half a period of the highest DTFT atom, or a quarter of that of the
    // DCT.
    let reach = 0.5 / f64::from(equations.ks.last().copied().unwrap_or(1).max(1));
    let mut lambda = 1e-3;
    let mut next = vec![0.0; n];
    let (size, events) = (equations.size(), n as u64);
    for _ in 0..rounds {
        work.spend(size.linearise(events));
        equations.linearise(u, &mut work.residual, &mut work.slopes);
        if let Some(power) = power {
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
        let (matrix, vector) = normal(&work.slopes, rows, n, &work.weights, &work.residual);
        let mut moved = 0.0_f64;
        let mut gained = 0.0;
        for _ in 0..TRIALS {
            work.spend(size.trial(events));
            let Some(step) = damped(&matrix, &vector, lambda) else {
                lambda = (lambda * 10.0).max(1e-9);
                continue;
            };
            moved = step.amax();
            let scale = (reach / moved).min(1.0);
            for ((next, u), d) in next.iter_mut().zip(&*u).zip(step.iter()) {
                *next = u + scale * d;
                if !equations.transform.is_complex() {
                    *next = next.clamp(0.0, 1.0);
                }
            }
            equations.residual(&next, &mut work.trial);
            let after = squares(&work.weights, &work.trial);
            if after < before {
                u.copy_from_slice(&next);
                gained = before - after;
                lambda = (lambda * 0.1).max(1e-12);
                break;
            }
            lambda *= 10.0;
            if moved < STILL {
                break;
            }
        }
        if gained <= 1e-9 * before || moved < STILL {
            return;
        }
    }
}

/// Moves the times `u` (normalised to the window) to the analytic centre of the times whose residual is within h;
/// returns whether times within h were found nearby. If not, `u` is unchanged.
pub fn centre(equations: &Equations, u: &mut [f64], work: &mut Work) -> bool {
    let half = equations.half;
    if largest(equations, u, work) >= half {
        let mut better = u.to_vec();
        weighted(equations, &mut better, work, WEIGHTED_ROUNDS, Some(6));
        if largest(equations, &better, work) >= half {
            return false;
        }
        u.copy_from_slice(&better);
    }
    let (rows, n) = (equations.rows(), u.len());
    let mut next = vec![0.0; n];
    let barrier = |residual: &[f64]| -> Option<f64> {
        let mut product = 0.0;
        for r in residual {
            let room = 1.0 - (r / half).powi(2);
            if room <= 0.0 {
                return None;
            }
            product -= room.ln();
        }
        Some(product)
    };
    let (size, events) = (equations.size(), n as u64);
    for _ in 0..CENTRE_ROUNDS {
        work.spend(size.linearise(events) + size.normal(events) + size.solve(events));
        equations.linearise(u, &mut work.residual, &mut work.slopes);
        let Some(before) = barrier(&work.residual) else {
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
        let (matrix, vector) = normal(&work.slopes, rows, n, &work.weights, &work.trial);
        let Some(step) = damped(&matrix, &vector, 1e-9) else {
            break;
        };
        let mut scale = 1.0;
        let mut is_better = false;
        for _ in 0..HALVINGS {
            work.spend(size.residual(events));
            for ((next, u), d) in next.iter_mut().zip(&*u).zip(step.iter()) {
                *next = u + scale * d;
                if !equations.transform.is_complex() {
                    *next = next.clamp(0.0, 1.0);
                }
            }
            equations.residual(&next, &mut work.trial);
            if barrier(&work.trial).is_some_and(|after| after < before) {
                is_better = true;
                break;
            }
            scale *= 0.5;
        }
        if !is_better {
            break;
        }
        u.copy_from_slice(&next);
        if step.amax() * scale < STILL {
            break;
        }
    }
    true
}
