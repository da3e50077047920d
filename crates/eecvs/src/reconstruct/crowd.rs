//! Event times of a crowded pixel: quantiles of the flattest densities that explain its coefficients.
//!
//! A pixel with more events than coefficients has many explanations. Among all densities a of its ON events and b
//! of its OFF events, on G points of the window, those of greatest entropy subject to
//!
//! ```text
//! sum_j a_j = on,   sum_j b_j = off,   sum_j (a_j - b_j) phi_k(u_j) = c_k
//! ```
//!
//! are a_j ~ exp(+(Phi^T lambda)_j) and b_j ~ exp(-(Phi^T lambda)_j). Here lambda has one element for each number
//! that was sent, and minimises the convex function
//!
//! ```text
//! D = on log sum_j exp(+(Phi^T lambda)_j) + off log sum_j exp(-(Phi^T lambda)_j) - lambda c
//!   + eps |lambda|^2 / 2
//! ```
//!
//! by Newton's method; eps = h^2 allows for the quantisation error. The i-th ON event is placed where the
//! cumulative sum of a reaches i + 1/2, or another value between i and i + 1. The work does not depend on the
//! number of events, except for placing them.
//!
//! Jaynes, Physical Review 106 (1957); Mead, Papanicolaou, J. Math. Phys. 25 (1984).

use nalgebra::{DMatrix, DVector};

use super::equations::Equations;
use super::refine::Work;

/// Points of the density for each period of the highest atom.
const POINTS_PER_PERIOD: usize = 8;
/// Smallest number of points.
const POINTS_MIN: usize = 64;
/// Largest number of points.
const POINTS_MAX: usize = 512;
/// Largest number of rows used, lowest k first.
pub(super) const ROWS_MAX: usize = 48;
/// Largest number of Newton steps.
pub(super) const ROUNDS: usize = 30;
/// Largest number of times that a Newton step is halved.
pub(super) const HALVINGS: usize = 20;

/// Writes the density of these exponents, normalised to a sum of 1; returns the log of the sum before normalising.
fn normalised(exponents: &[f64], sign: f64, density: &mut Vec<f64>) -> f64 {
    let most = exponents
        .iter()
        .fold(f64::NEG_INFINITY, |most, e| most.max(sign * e));
    density.clear();
    density.extend(exponents.iter().map(|e| (sign * e - most).exp()));
    let sum: f64 = density.iter().sum();
    density.iter_mut().for_each(|p| *p /= sum);
    most + sum.ln()
}

/// The flattest densities of a pixel's ON and OFF events that explain its coefficients.
#[derive(Debug)]
pub struct Densities {
    /// For ON and for OFF events, the density and the number of events.
    of: [(Vec<f64>, usize); 2],
}

impl Densities {
    /// Computes the densities for a pixel's equations, whose signs are not used.
    #[must_use]
    pub fn flattest(equations: &Equations, work: &mut Work) -> Self {
        let [on, off] = densities(equations, work);
        Self {
            of: [(on, equations.on as usize), (off, equations.off as usize)],
        }
    }

    /// Returns the times u of all events, ON events first. The i-th of n events is where the cumulative density
    /// reaches (i + `place`) / n, with `place` from 0 to 1.
    #[must_use]
    pub fn times(&self, place: f64) -> Vec<f64> {
        let all = self.of.iter();
        all.flat_map(|(density, n)| quantiles(density, *n, place))
            .collect()
    }
}

/// Returns the number of points of the densities of a pixel whose highest coefficient used is `highest`.
pub(super) const fn points(highest: usize) -> usize {
    let points = POINTS_PER_PERIOD * (highest + 1);
    if points < POINTS_MIN {
        POINTS_MIN
    } else if points > POINTS_MAX {
        POINTS_MAX
    } else {
        points
    }
}

fn densities(equations: &Equations, work: &mut Work) -> [Vec<f64>; 2] {
    let counts = [f64::from(equations.on), f64::from(equations.off)];
    let rows = equations.rows().min(ROWS_MAX);
    if rows == 0 {
        return [vec![1.0], vec![1.0]];
    }
    let highest = usize::from(
        equations
            .ks
            .iter()
            .take(rows)
            .next_back()
            .copied()
            .unwrap_or(0),
    );
    let points = points(highest);
    let size = equations.size();
    work.spend(size.density_start(points as u64));
    let mut atoms = DMatrix::zeros(points, rows);
    for j in 0..points {
        let u = (j as f64 + 0.5) / points as f64;
        equations.atoms(u, |row, value, _| {
            if row < rows {
                atoms[(j, row)] = value;
            }
        });
    }
    let target = DVector::from_column_slice(&equations.middles[..rows]);
    let noise = equations.half * equations.half;
    let mut lambda = DVector::zeros(rows);
    let mut densities = [Vec::new(), Vec::new()];
    let value_at = |lambda: &DVector<f64>, densities: &mut [Vec<f64>; 2]| -> f64 {
        let exponents = &atoms * lambda;
        let [a, b] = densities;
        counts[0] * normalised(exponents.as_slice(), 1.0, a)
            + counts[1] * normalised(exponents.as_slice(), -1.0, b)
            - lambda.dot(&target)
            + noise / 2.0 * lambda.norm_squared()
    };
    let mut value = value_at(&lambda, &mut densities);
    for _ in 0..ROUNDS {
        work.spend(size.density_round(points as u64));
        let mut gradient = &lambda * noise - &target;
        let mut hessian = DMatrix::identity(rows, rows) * noise;
        for ((count, sign), density) in counts.iter().zip([1.0, -1.0]).zip(&densities) {
            if *count == 0.0 {
                continue;
            }
            let density = DVector::from_column_slice(density);
            let mean = atoms.tr_mul(&density);
            gradient.axpy(sign * count, &mean, 1.0);
            let mut weighted = atoms.clone();
            for mut column in weighted.column_iter_mut() {
                column.component_mul_assign(&density);
            }
            // The lower triangle is all that the factorisation reads.
            for j in 0..rows {
                let rest = atoms.columns(j, rows - j);
                let mut column = hessian.view_mut((j, j), (rows - j, 1));
                let mut column = column.column_mut(0);
                column.gemv_tr(*count, &rest, &weighted.column(j), 1.0);
            }
            hessian.ger(-count, &mean, &mean, 1.0);
        }
        if gradient.amax() < equations.half {
            break;
        }
        let Some(factors) = hessian.cholesky() else {
            break;
        };
        let step = factors.solve(&gradient);
        let slope = gradient.dot(&step);
        let mut scale = 1.0;
        let mut is_better = false;
        for _ in 0..HALVINGS {
            work.spend(size.density_value(points as u64));
            let next = &lambda - &step * scale;
            let after = value_at(&next, &mut densities);
            if after <= value - 1e-4 * scale * slope {
                (lambda, value, is_better) = (next, after, true);
                break;
            }
            scale *= 0.5;
        }
        if !is_better {
            break;
        }
    }
    value_at(&lambda, &mut densities);
    densities
}

/// Returns where the cumulative density reaches (i + place) / n, for i in 0..n.
pub(super) fn quantiles(density: &[f64], n: usize, place: f64) -> Vec<f64> {
    let mut times = Vec::with_capacity(n);
    let (mut point, mut below) = (0, 0.0);
    let last = density.len() - 1;
    for i in 0..n {
        let wanted = (i as f64 + place) / n as f64;
        while point < last && below + density[point] < wanted {
            below += density[point];
            point += 1;
        }
        let within = ((wanted - below) / density[point].max(1e-300)).clamp(0.0, 1.0);
        times.push((point as f64 + within) / density.len() as f64);
    }
    times
}
