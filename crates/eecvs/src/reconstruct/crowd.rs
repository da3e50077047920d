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

use std::array::from_fn;

use eecvs_nostd::Transform;

use super::equations::Equations;
use super::lanes::{LANES, Lanes, add_row, blocks, dot, wide};
use super::normal::Normal;
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

/// Atoms at the points of a density, which many pixels share.
#[derive(Debug, Default)]
pub(super) struct DensityAtoms {
    transform: Option<Transform>,
    ks: Vec<u16>,
    rows: usize,
    points: usize,
    /// Rows of [`blocks`] blocks: a row for each point.
    atoms: Vec<Lanes>,
}

impl DensityAtoms {
    /// Computes the atoms of the first `rows` equations at these points, unless they are there already.
    fn fit(&mut self, equations: &Equations, rows: usize, points: usize) {
        let is_same = self.transform == Some(equations.transform)
            && (self.rows, self.points) == (rows, points)
            && self.ks == equations.ks;
        if is_same {
            return;
        }
        self.transform = Some(equations.transform);
        self.ks.clone_from(&equations.ks);
        (self.rows, self.points) = (rows, points);
        let blocks = blocks(rows);
        self.atoms.clear();
        self.atoms.resize(points * blocks, [0.0; LANES]);
        for first in (0..points).step_by(LANES) {
            let u = from_fn(|lane| ((first + lane) as f64 + 0.5) / points as f64);
            equations.atoms(u, |row, values, _| {
                for (point, value) in (first..points).zip(values) {
                    if row < rows {
                        self.atoms[point * blocks + row / LANES][row % LANES] = value;
                    }
                }
            });
        }
    }

    /// Returns the rows of all points.
    fn points(&self) -> impl Iterator<Item = &[Lanes]> + Clone {
        self.atoms.chunks_exact(blocks(self.rows).max(1))
    }
}

/// Numbers of the search for the flattest densities, reused from pixel to pixel.
#[derive(Debug, Default)]
pub(super) struct DensityWork {
    atoms: DensityAtoms,
    target: Vec<Lanes>,
    lambda: Vec<Lanes>,
    /// Where the value is computed.
    next: Vec<Lanes>,
    /// (Phi^T lambda)_j, of `next`.
    exponents: Vec<f64>,
    /// Densities of ON and of OFF events, of `next`; empty where there are no such events.
    densities: [Vec<f64>; 2],
    /// on a_j + off b_j.
    weights: Vec<f64>,
    /// The mean of the atoms in a density.
    mean: Vec<Lanes>,
}

impl DensityWork {
    /// Begins with lambda = 0.
    fn begin(&mut self, target: &[f64]) {
        let blocks = blocks(target.len());
        for numbers in [
            &mut self.target,
            &mut self.lambda,
            &mut self.next,
            &mut self.mean,
        ] {
            numbers.clear();
            numbers.resize(blocks, [0.0; LANES]);
        }
        self.target.as_flattened_mut()[..target.len()].copy_from_slice(target);
    }

    /// Returns D at lambda less `scale` times a step.
    #[inline(always)]
    fn value_after(&mut self, step: &[f64], scale: f64, counts: [f64; 2], noise: f64) -> f64 {
        let lambda = self.lambda.as_flattened().iter();
        let next = self.next.as_flattened_mut().iter_mut();
        for ((next, lambda), d) in next.zip(lambda).zip(step) {
            *next = lambda - d * scale;
        }
        self.value(counts, noise)
    }

    /// Returns D at `next`, and computes its densities.
    #[inline(always)]
    fn value(&mut self, counts: [f64; 2], noise: f64) -> f64 {
        self.exponents.clear();
        for atoms in self.atoms.points() {
            self.exponents.push(dot(atoms, &self.next));
        }
        let mut value = noise / 2.0 * dot(&self.next, &self.next) - dot(&self.next, &self.target);
        for ((density, count), sign) in self.densities.iter_mut().zip(counts).zip([1.0, -1.0]) {
            density.clear();
            if count > 0.0 {
                value += count * normalised(&self.exponents, sign, density);
            }
        }
        value
    }

    /// Computes the second derivatives and the gradient of D at lambda, whose densities are there.
    #[inline(always)]
    fn newton(&mut self, counts: [f64; 2], noise: f64, normal: &mut Normal) {
        self.weights.clear();
        self.weights.resize(self.atoms.points, 0.0);
        for (density, count) in self.densities.iter().zip(counts) {
            for (weight, density) in self.weights.iter_mut().zip(density) {
                *weight += count * density;
            }
        }
        normal.fill(&self.atoms.atoms, self.atoms.rows, &self.weights, &[]);
        let blocks = blocks(self.atoms.rows);
        let gradient = normal.vector_mut();
        for ((gradient, lambda), target) in gradient.iter_mut().zip(&self.lambda).zip(&self.target)
        {
            *gradient = from_fn(|lane| lambda[lane] * noise - target[lane]);
        }
        for row in 0..self.atoms.rows {
            normal.matrix_mut()[row * blocks + row / LANES][row % LANES] += noise;
        }
        for ((density, count), sign) in self.densities.iter().zip(counts).zip([1.0, -1.0]) {
            if count == 0.0 {
                continue;
            }
            self.mean.fill([0.0; LANES]);
            for (atoms, density) in self.atoms.points().zip(density) {
                add_row(&mut self.mean, *density, atoms);
            }
            add_row(normal.vector_mut(), sign * count, &self.mean);
            let rows = normal.matrix_mut().chunks_exact_mut(blocks);
            for (i, (row, mean)) in rows.zip(self.mean.as_flattened()).enumerate() {
                let upper = i / LANES..;
                add_row(&mut row[upper.clone()], -count * mean, &self.mean[upper]);
            }
        }
    }
}

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
    work.density.atoms.fit(equations, rows, points);
    solved(equations, work);
    work.density.densities.clone()
}

fn solved(equations: &Equations, work: &mut Work) {
    wide!(solve, equations: &Equations, work: &mut Work);
}

/// Finds the flattest densities for equations whose atoms are there.
#[inline(always)]
fn solve(equations: &Equations, work: &mut Work) {
    let counts = [f64::from(equations.on), f64::from(equations.off)];
    let (rows, points) = (work.density.atoms.rows, work.density.atoms.points);
    let size = equations.size();
    let noise = equations.half * equations.half;
    work.density.begin(&equations.middles[..rows]);
    let mut value = work.density.value(counts, noise);
    for _ in 0..ROUNDS {
        work.spend(size.density_round(points as u64));
        work.density.newton(counts, noise, &mut work.normal);
        let gradient = work.normal.vector().as_flattened();
        if gradient.iter().fold(0.0, |most: f64, g| most.max(g.abs())) < equations.half {
            break;
        }
        if !work.normal.solve(0.0) {
            break;
        }
        let gradient = work.normal.vector().as_flattened().iter();
        let slope: f64 = gradient.zip(work.normal.step()).map(|(g, d)| g * d).sum();
        let mut scale = 1.0;
        let mut is_better = false;
        for _ in 0..HALVINGS {
            work.spend(size.density_value(points as u64));
            let after = work
                .density
                .value_after(work.normal.step(), scale, counts, noise);
            if after <= value - 1e-4 * scale * slope {
                (value, is_better) = (after, true);
                break;
            }
            scale *= 0.5;
        }
        if !is_better {
            break;
        }
        work.density.lambda.clone_from(&work.density.next);
    }
    work.density.next.clone_from(&work.density.lambda);
    work.density.value(counts, noise);
}

/// Returns where the cumulative density reaches (i + place) / n, for i in 0..n.
pub(super) fn quantiles(density: &[f64], n: usize, place: f64) -> Vec<f64> {
    let mut times = Vec::with_capacity(n);
    let (mut point, mut below) = (0, 0.0);
    let last = density.len().saturating_sub(1);
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
