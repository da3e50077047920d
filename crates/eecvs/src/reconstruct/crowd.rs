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
//! by Newton's method; eps = h^2 allows for the quantisation error. A product of two atoms is a sum of two others, so that
//! the second derivatives are sums of the densities' moments, of which there are as many as atoms. The i-th ON event is placed where the
//! cumulative sum of a reaches i + 1/2, or another value between i and i + 1. The work does not depend on the
//! number of events, except for placing them.
//!
//! Jaynes, Physical Review 106 (1957); Mead, Papanicolaou, J. Math. Phys. 25 (1984).

use std::array::from_fn;
use std::f64::consts::FRAC_PI_2;

use eecvs_nostd::Transform;

use super::equations::Equations;
use super::lanes::{LANES, Lanes, add_row, blocks, exp, filled, sin_cos, wide};
use super::normal::Normal;
use super::pursuit::omega;
use super::refine::Work;

/// Points of the density for each period of the highest atom; the number of points is a power of two.
const POINTS_PER_PERIOD: usize = 8;
/// Smallest number of points.
const POINTS_MIN: usize = 64;
/// Largest number of points. Atoms of half as many periods and more have aliases at the points: their rows are not used.
const POINTS_MAX: usize = 512;
/// The highest k that is used.
pub(super) const USED_MAX: u64 = POINTS_MAX as u64 / 2 - 1;
/// Largest number of rows used, lowest k first.
pub(super) const ROWS_MAX: usize = 48;
/// Largest number of Newton steps.
pub(super) const ROUNDS: usize = 30;
/// Largest number of times that a Newton step is halved.
pub(super) const HALVINGS: usize = 20;

/// Cosines and sines of k omega u at the points of a density, for k below a limit.
///
/// Points u and 1 - u have the same cosines and opposite sines; for the DCT, whose atoms have half the frequency, the
/// same cosines for even k and opposite ones for odd k. So there are rows for the lower half of the points alone.
#[derive(Debug)]
struct Waves {
    transform: Transform,
    points: usize,
    /// Blocks of a row.
    blocks: usize,
    cosines: Vec<Lanes>,
    /// Empty for the DCT.
    sines: Vec<Lanes>,
}

impl Waves {
    fn new(transform: Transform, points: usize, limit: usize) -> Self {
        let blocks = blocks(limit);
        let mut waves = Self {
            transform,
            points,
            blocks,
            cosines: Vec::with_capacity(points / 2 * blocks),
            sines: Vec::new(),
        };
        for point in 0..points / 2 {
            let u = (point as f64 + 0.5) / points as f64;
            let quarters = omega(transform) / FRAC_PI_2 * u;
            for block in 0..blocks {
                let (sin, cos) = sin_cos(from_fn(|lane| (block * LANES + lane) as f64 * quarters));
                waves.cosines.push(cos);
                if transform.is_complex() {
                    waves.sines.push(sin);
                }
            }
        }
        waves
    }

    /// Computes the sums of cosines and of sines weighted by the numbers of all points.
    #[inline(always)]
    fn moments(&self, numbers: &[f64], moments: &mut Moments) {
        moments.cosines.clear();
        moments.cosines.resize(self.blocks, [0.0; LANES]);
        moments.sines.clear();
        moments.sines.resize(self.blocks, [0.0; LANES]);
        let mirrored = numbers.iter().rev();
        let pairs = numbers.iter().zip(mirrored).take(self.points / 2);
        if self.transform.is_complex() {
            let sines = self.sines.chunks_exact(self.blocks);
            let rows = self.cosines.chunks_exact(self.blocks).zip(sines);
            for ((a, b), (cosines, sines)) in pairs.zip(rows) {
                add_row(&mut moments.cosines, a + b, cosines);
                add_row(&mut moments.sines, a - b, sines);
            }
        } else {
            for ((a, b), row) in pairs.zip(self.cosines.chunks_exact(self.blocks)) {
                let by = [a + b, a - b, a + b, a - b];
                for (sum, cosines) in moments.cosines.iter_mut().zip(row) {
                    let before = *sum;
                    *sum = from_fn(|lane| before[lane] + by[lane] * cosines[lane]);
                }
            }
        }
    }

    /// Writes the sums of all cosines and sines with these factors at every point.
    #[inline(always)]
    fn values(&self, factors: &Moments, values: &mut [f64]) {
        let used = factors.cosines.len();
        let (lower, upper) = values.split_at_mut(self.points / 2);
        let both = lower.iter_mut().zip(upper.iter_mut().rev());
        let sums = |row: &[Lanes], factors: &[Lanes]| {
            let mut sums = [0.0; LANES];
            for (wave, factor) in row[..used].iter().zip(factors) {
                sums = from_fn(|lane| sums[lane] + wave[lane] * factor[lane]);
            }
            sums
        };
        let cosines = self.cosines.chunks_exact(self.blocks);
        if self.transform.is_complex() {
            let rows = cosines.zip(self.sines.chunks_exact(self.blocks));
            for ((lower, upper), (cosines, sines)) in both.zip(rows) {
                let [a, b, c, d] = sums(cosines, &factors.cosines);
                let [e, f, g, h] = sums(sines, &factors.sines);
                let (even, odd) = ((a + b) + (c + d), (e + f) + (g + h));
                (*lower, *upper) = (even + odd, even - odd);
            }
        } else {
            for ((lower, upper), row) in both.zip(cosines) {
                let [a, b, c, d] = sums(row, &factors.cosines);
                let (even, odd) = (a + c, b + d);
                (*lower, *upper) = (even + odd, even - odd);
            }
        }
    }
}

/// Numbers for the cosine and for the sine of every k.
#[derive(Debug, Default)]
struct Moments {
    cosines: Vec<Lanes>,
    sines: Vec<Lanes>,
}

impl Moments {
    fn cosine(&self, k: usize) -> f64 {
        self.cosines.as_flattened()[k]
    }

    fn sine(&self, k: usize) -> f64 {
        self.sines.as_flattened()[k]
    }
}

/// Numbers of the search for the flattest densities, reused from pixel to pixel.
#[derive(Debug, Default)]
pub(super) struct DensityWork {
    /// Those of all shapes so far, of which there are a few; the last ones are in use.
    waves: Vec<Waves>,
    /// k of the rows that are used.
    ks: Vec<usize>,
    target: Vec<Lanes>,
    lambda: Vec<Lanes>,
    /// Where the value is computed.
    next: Vec<Lanes>,
    /// `next` by k.
    factors: Moments,
    /// (Phi^T lambda)_j, of `next`.
    exponents: Vec<f64>,
    /// Densities of ON and of OFF events, of `next`; empty where there are no such events.
    densities: [Vec<f64>; 2],
    /// Of these.
    moments: [Moments; 2],
    /// on a_j + off b_j.
    sums: Moments,
    /// The mean of the atoms in a density.
    mean: Vec<Lanes>,
}

impl DensityWork {
    /// Begins with lambda = 0 for the rows of `ks`.
    fn begin(&mut self, equations: &Equations, terms: usize, points: usize) {
        self.ks.clear();
        self.ks
            .extend(equations.ks.iter().take(terms).map(|k| usize::from(*k)));
        let limit = limit(self.ks.last().copied().unwrap_or(0));
        let transform = equations.transform;
        let is_fit = |waves: &Waves| {
            (waves.transform, waves.points, waves.blocks) == (transform, points, blocks(limit))
        };
        match self.waves.iter().rposition(is_fit) {
            Some(at) => {
                let last = self.waves.len() - 1;
                self.waves.swap(at, last);
            }
            None => self.waves.push(Waves::new(transform, points, limit)),
        }
        let rows = terms * (1 + usize::from(transform.is_complex()));
        let target = &equations.middles[..rows];
        for numbers in [
            &mut self.target,
            &mut self.lambda,
            &mut self.next,
            &mut self.mean,
        ] {
            numbers.clear();
            numbers.resize(blocks(rows), [0.0; LANES]);
        }
        self.target.as_flattened_mut()[..rows].copy_from_slice(target);
        // All k below the highest one, and it.
        let used = blocks(self.ks.last().map_or(1, |k| k + 1));
        for factors in [&mut self.factors.cosines, &mut self.factors.sines] {
            factors.clear();
            factors.resize(used, [0.0; LANES]);
        }
        self.exponents.clear();
        self.exponents.resize(points, 0.0);
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
        let Some(waves) = self.waves.last() else {
            return 0.0;
        };
        let next = self.next.as_flattened();
        if waves.transform.is_complex() {
            for (k, of) in self.ks.iter().zip(next.chunks_exact(2)) {
                self.factors.cosines.as_flattened_mut()[*k] = of[0];
                self.factors.sines.as_flattened_mut()[*k] = -of[1];
            }
        } else {
            for (k, of) in self.ks.iter().zip(next) {
                self.factors.cosines.as_flattened_mut()[*k] = *of;
            }
        }
        waves.values(&self.factors, &mut self.exponents);
        let dot = super::lanes::dot;
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
        let Some(waves) = self.waves.last() else {
            return;
        };
        let is_complex = waves.transform.is_complex();
        let rows = self.ks.len() * (1 + usize::from(is_complex));
        let blocks = blocks(rows);
        normal.begin(rows);
        let gradient = normal.vector_mut();
        for ((gradient, lambda), target) in gradient.iter_mut().zip(&self.lambda).zip(&self.target)
        {
            *gradient = from_fn(|lane| lambda[lane] * noise - target[lane]);
        }
        for sums in [&mut self.sums.cosines, &mut self.sums.sines] {
            sums.clear();
            sums.resize(waves.blocks, [0.0; LANES]);
        }
        let densities = self.densities.iter().zip(&mut self.moments);
        for ((density, moments), count) in densities.zip(counts) {
            if count > 0.0 {
                waves.moments(density, moments);
                add_row(&mut self.sums.cosines, count, &moments.cosines);
                add_row(&mut self.sums.sines, count, &moments.sines);
            }
        }
        // cos a cos b = (cos (a - b) + cos (a + b)) / 2, and so on.
        let matrix = normal.matrix_mut().as_flattened_mut();
        let width = LANES * blocks;
        for (a, k) in self.ks.iter().enumerate() {
            for (b, l) in self.ks.iter().enumerate().skip(a) {
                let apart = self.sums.cosine(l - k) / 2.0;
                let summed = self.sums.cosine(l + k) / 2.0;
                if is_complex {
                    let sine_apart = self.sums.sine(l - k) / 2.0;
                    let sine_summed = self.sums.sine(l + k) / 2.0;
                    let at = 2 * a * width + 2 * b;
                    matrix[at] = apart + summed;
                    matrix[at + 1] = -(sine_summed + sine_apart);
                    matrix[at + width] = -(sine_summed - sine_apart);
                    matrix[at + width + 1] = apart - summed;
                } else {
                    matrix[a * width + b] = apart + summed;
                }
            }
        }
        for row in 0..rows {
            matrix[row * width + row] += noise;
        }
        for ((moments, count), sign) in self.moments.iter().zip(counts).zip([1.0, -1.0]) {
            if count == 0.0 {
                continue;
            }
            let mean = self.mean.as_flattened_mut();
            for (at, k) in self.ks.iter().enumerate() {
                if is_complex {
                    mean[2 * at] = moments.cosine(*k);
                    mean[2 * at + 1] = -moments.sine(*k);
                } else {
                    mean[at] = moments.cosine(*k);
                }
            }
            add_row(normal.vector_mut(), sign * count, &self.mean);
            let matrix = normal.matrix_mut().chunks_exact_mut(blocks);
            for (i, (row, mean)) in matrix.zip(&self.mean.as_flattened()[..rows]).enumerate() {
                let upper = i / LANES..;
                add_row(&mut row[upper.clone()], -count * mean, &self.mean[upper]);
            }
        }
    }
}

/// Writes the density of these exponents, normalised to a sum of 1; returns the log of the sum before normalising.
#[inline(always)]
fn normalised(exponents: &[f64], sign: f64, density: &mut Vec<f64>) -> f64 {
    let most = exponents
        .iter()
        .fold(f64::NEG_INFINITY, |most, e| most.max(sign * e));
    density.clear();
    let mut sums = [0.0; LANES];
    for exponents in exponents.chunks(LANES) {
        let powers = exp(filled(exponents).map(|e| sign * e - most));
        sums = from_fn(|lane| sums[lane] + powers[lane]);
        density.extend(powers);
    }
    let sum = super::lanes::sum(sums);
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
    let points = (POINTS_PER_PERIOD * (highest + 1)).next_power_of_two();
    if points < POINTS_MIN {
        POINTS_MIN
    } else if points > POINTS_MAX {
        POINTS_MAX
    } else {
        points
    }
}

/// Returns the number of k, from 0 on, of which there are waves if the highest coefficient used is `highest`: the sum of
/// two k is among them. It is a power of two, so that a few tables serve all pixels.
pub(super) const fn limit(highest: usize) -> usize {
    2 * (highest + 1).next_power_of_two()
}

fn densities(equations: &Equations, work: &mut Work) -> [Vec<f64>; 2] {
    let rows_of_term = 1 + usize::from(equations.transform.is_complex());
    let is_used = |k: &&u16| u64::from(**k) <= USED_MAX;
    let terms = equations.ks.iter().take_while(is_used).count();
    let terms = terms.min(ROWS_MAX / rows_of_term);
    let Some(highest) = terms.checked_sub(1).map(|last| equations.ks[last]) else {
        return [vec![1.0], vec![1.0]];
    };
    let points = points(highest.into());
    let size = equations.size();
    work.spend(size.density_start(highest.into()));
    work.density.begin(equations, terms, points);
    solved(equations, highest.into(), work);
    work.density.densities.clone()
}

fn solved(equations: &Equations, highest: u64, work: &mut Work) {
    wide!(solve, equations: &Equations, highest: u64, work: &mut Work);
}

/// Finds the flattest densities for equations of which the work knows the terms that are used.
#[inline(always)]
fn solve(equations: &Equations, highest: u64, work: &mut Work) {
    let counts = [f64::from(equations.on), f64::from(equations.off)];
    let size = equations.size();
    let noise = equations.half * equations.half;
    let mut value = work.density.value(counts, noise);
    for _ in 0..ROUNDS {
        work.spend(size.density_round(highest));
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
            work.spend(size.density_value(highest));
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments and values are the sums over all points and all k, each computed from its atom.
    #[test]
    fn waves_are_those_of_all_atoms() {
        let (points, limit) = (64, 16);
        for transform in [Transform::Dct, Transform::Dtft] {
            let waves = Waves::new(transform, points, limit);
            let wave = |k: usize, point: usize| {
                let u = (point as f64 + 0.5) / points as f64;
                (omega(transform) * k as f64 * u).sin_cos()
            };
            let of = |i: usize, step: usize| (i * i * step % 23) as f64 / 7.0 - 1.5;
            let numbers: Vec<f64> = (0..points).map(|point| of(point, 3)).collect();
            let mut moments = Moments::default();
            waves.moments(&numbers, &mut moments);
            let mut factors = Moments::default();
            factors.cosines.resize(blocks(limit), [0.0; LANES]);
            factors.sines.resize(blocks(limit), [0.0; LANES]);
            for k in 0..limit {
                factors.cosines.as_flattened_mut()[k] = of(k, 5);
                if transform.is_complex() {
                    factors.sines.as_flattened_mut()[k] = of(k, 7);
                }
                let terms = numbers.iter().enumerate().map(|(point, number)| {
                    let (sin, cos) = wave(k, point);
                    (number * sin, number * cos)
                });
                let (sin, cos) =
                    terms.fold((0.0, 0.0), |sum, term| (sum.0 + term.0, sum.1 + term.1));
                assert!((moments.cosine(k) - cos).abs() < 1e-11, "{transform:?} {k}");
                if transform.is_complex() {
                    assert!((moments.sine(k) - sin).abs() < 1e-11, "{transform:?} {k}");
                }
            }
            let mut values = vec![0.0; points];
            waves.values(&factors, &mut values);
            for (point, value) in values.iter().enumerate() {
                let terms = (0..limit).map(|k| {
                    let (sin, cos) = wave(k, point);
                    factors.cosine(k) * cos + factors.sine(k) * sin
                });
                assert!(
                    (value - terms.sum::<f64>()).abs() < 1e-11,
                    "{transform:?} {point}"
                );
            }
        }
    }

    /// The densities explain the coefficients to within the quantisation error, where any do.
    #[test]
    fn densities_explain_the_coefficients() {
        use crate::reconstruct::test_pixel;

        for transform in [Transform::Dct, Transform::Dtft] {
            let header = test_pixel::header(transform, 8, -6, 32_768);
            let events: Vec<(u32, bool)> = (0..60)
                .map(|i| (500 * i + 91 * (i % 5), i % 4 > 0))
                .collect();
            let pixel = test_pixel::pixel(&header, &events);
            let equations = Equations::new(&header, &pixel);
            let mut work = Work::default();
            let [on, off] = densities(&equations, &mut work);
            let sum = |density: &[f64]| density.iter().sum::<f64>();
            assert!((sum(&on) - 1.0).abs() < 1e-9 && (sum(&off) - 1.0).abs() < 1e-9);
            let mut explained = vec![0.0; equations.rows()];
            for (point, (on, off)) in on.iter().zip(&off).enumerate() {
                let u = (point as f64 + 0.5) / on_points(&equations) as f64;
                let weight = f64::from(pixel.on) * on - f64::from(pixel.off) * off;
                equations.atoms([u; LANES], |row, values, _| {
                    explained[row] += weight * values[0];
                });
            }
            for (explained, middle) in explained.iter().zip(&equations.middles) {
                let error = (explained - middle).abs();
                assert!(error < 4.0 * equations.half, "{transform:?} {error}");
            }
        }
    }

    fn on_points(equations: &Equations) -> usize {
        points(usize::from(*equations.ks.last().expect("coefficients")))
    }
}
