//! Normal equations of least squares: A = J^T W J, and their solution by Cholesky's factors without roots.
//!
//! Rows of J and of A are whole blocks of [`LANES`] numbers, the last of which zeros fill, so that all sums run over
//! blocks, in the same order on every machine.

use std::array::from_fn;

use super::lanes::{LANES, Lanes, blocks, dot};

/// Equations for n unknowns, with the memory to solve them.
#[derive(Debug, Default)]
pub struct Normal {
    n: usize,
    /// Rows of A, of [`blocks`] blocks each; only the upper triangle is used.
    matrix: Vec<Lanes>,
    /// J^T W v.
    vector: Vec<Lanes>,
    /// lambda diag.
    damping: Vec<f64>,
    /// Upper triangle of R with R^T D^-1 R = A + lambda diag, where D is R's diagonal, and 1 / R_ii.
    factor: Vec<Lanes>,
    inverses: Vec<Lanes>,
    /// y with R^T y = J^T W v.
    half_solved: Vec<Lanes>,
    step: Vec<Lanes>,
}

impl Normal {
    /// Returns the rows of A, of [`blocks`] blocks each.
    pub fn matrix_mut(&mut self) -> &mut [Lanes] {
        &mut self.matrix
    }

    /// Returns J^T W v, with zeros behind its n numbers.
    #[inline(always)]
    pub fn vector(&self) -> &[Lanes] {
        &self.vector
    }

    /// Returns J^T W v, to change it.
    pub fn vector_mut(&mut self) -> &mut [Lanes] {
        &mut self.vector
    }

    /// Returns the solution, of n numbers.
    #[inline(always)]
    pub fn step(&self) -> &[f64] {
        &self.step.as_flattened()[..self.n]
    }

    /// Begins with n unknowns, A = 0 and J^T W v = 0, which the caller fills.
    #[inline(always)]
    pub fn begin(&mut self, n: usize) {
        self.resize(n);
        self.matrix.fill([0.0; LANES]);
        self.vector.fill([0.0; LANES]);
    }

    fn resize(&mut self, n: usize) {
        let blocks = blocks(n);
        self.n = n;
        for (numbers, len) in [
            (&mut self.matrix, LANES * blocks * blocks),
            (&mut self.factor, LANES * blocks * blocks),
            (&mut self.vector, blocks),
            (&mut self.inverses, blocks),
            (&mut self.half_solved, blocks),
            (&mut self.step, blocks),
        ] {
            numbers.resize(len, [0.0; LANES]);
        }
    }

    /// Computes A and J^T W v of `n` unknowns from rows of J, of [`blocks`] blocks each.
    #[inline(always)]
    pub fn fill(&mut self, slopes: &[Lanes], n: usize, weights: &[f64], v: &[f64]) {
        let blocks = blocks(n);
        self.resize(n);
        if n == 0 {
            return;
        }
        let rows = || slopes.chunks_exact(blocks).zip(weights);
        for first in 0..blocks {
            let mut sums = [0.0; LANES];
            for ((row, weight), v) in rows().zip(v) {
                let (by, row) = (weight * v, row[first]);
                sums = from_fn(|lane| sums[lane] + by * row[lane]);
            }
            self.vector[first] = sums;
            for second in first..blocks {
                let mut sums = [[0.0; LANES]; LANES];
                for (row, weight) in rows() {
                    let (a, b) = (row[first], row[second]);
                    for (sums, a) in sums.iter_mut().zip(a) {
                        let by = weight * a;
                        *sums = from_fn(|lane| sums[lane] + by * b[lane]);
                    }
                }
                for (i, sums) in sums.into_iter().enumerate() {
                    self.matrix[(LANES * first + i) * blocks + second] = sums;
                }
            }
        }
    }

    /// Returns by how much `scale` times the step reduces v^T W v if J is right: 2 s d^T b - s^2 d^T A d, with b = J^T W v
    /// and A d = b - lambda diag d.
    #[inline(always)]
    pub fn predicted(&self, scale: f64) -> f64 {
        let vector = self.vector.as_flattened();
        let (mut along, mut damped) = (0.0, 0.0);
        for ((d, b), damping) in self.step().iter().zip(vector).zip(&self.damping) {
            along += d * b;
            damped += damping * d * d;
        }
        scale * (2.0 * along - scale * (along - damped))
    }

    /// Solves (A + lambda diag) d = J^T W v into [`Self::step`]; returns false if that matrix is not positive definite,
    /// or the solution not finite.
    #[inline(always)]
    pub fn solve(&mut self, lambda: f64) -> bool {
        let (n, blocks) = (self.n, blocks(self.n));
        let diagonal = |j: usize| self.matrix[j * blocks + j / LANES][j % LANES];
        let mean = (0..n).map(diagonal).sum::<f64>() / n.max(1) as f64;
        self.damping.clear();
        self.damping
            .extend((0..n).map(|j| lambda * (diagonal(j) + 1e-3 * mean)));
        // Four rows at a time, from their block on the diagonal to the right. Left of the diagonal, blocks hold what is
        // not used; so do rows behind the last.
        for panel in 0..blocks {
            let (above, rows) = self.factor.split_at_mut(LANES * panel * blocks);
            let inverses = self.inverses.as_flattened();
            let above = || above.chunks_exact(blocks).zip(inverses);
            let of_panel = |i: usize| (LANES * panel + i) * blocks;
            let rest = LANES.min(n - LANES * panel);
            let mut of_rows = [0.0; LANES];
            // R of the block on the diagonal.
            let mut corner = [[0.0; LANES]; LANES];
            for block in panel..blocks {
                let mut tile: [Lanes; LANES] = from_fn(|i| self.matrix[of_panel(i) + block]);
                if block == panel {
                    for (i, row) in tile.iter_mut().enumerate().take(rest) {
                        row[i] += self.damping[LANES * panel + i];
                    }
                }
                for (upper, inverse) in above() {
                    let (by, of) = (upper[panel].map(|r| r * inverse), upper[block]);
                    for (row, by) in tile.iter_mut().zip(by) {
                        *row = from_fn(|lane| row[lane] - by * of[lane]);
                    }
                }
                for i in 0..rest {
                    for k in 0..i {
                        let (of, by) = (tile[k], corner[k][i] * of_rows[k]);
                        tile[i] = from_fn(|lane| tile[i][lane] - by * of[lane]);
                    }
                    if block == panel {
                        let pivot = tile[i][i];
                        // What is not a number is not positive either.
                        if pivot.is_nan() || pivot <= 0.0 {
                            return false;
                        }
                        of_rows[i] = 1.0 / pivot;
                        corner[i] = tile[i];
                    }
                }
                for (i, row) in tile.into_iter().enumerate() {
                    rows[i * blocks + block] = row;
                }
            }
            // R^T y = J^T W v: what is known is taken from the rest.
            let mut unknown = self.vector[panel];
            for ((upper, _), y) in above().zip(self.half_solved.as_flattened()) {
                let of = upper[panel];
                unknown = from_fn(|lane| unknown[lane] - y * of[lane]);
            }
            let mut solved = [0.0; LANES];
            for i in 0..rest {
                solved[i] = unknown[i] * of_rows[i];
                unknown = from_fn(|lane| unknown[lane] - solved[i] * corner[i][lane]);
            }
            self.inverses[panel] = of_rows;
            self.half_solved[panel] = solved;
        }
        // D^-1 R d = y, from the last block to the first.
        for panel in (0..blocks).rev() {
            let rest = LANES.min(n - LANES * panel);
            let rows = &self.factor[LANES * panel * blocks..];
            let row = |i: usize| &rows[i * blocks..][..blocks];
            let mut known = [0.0; LANES];
            for (i, known) in known.iter_mut().enumerate().take(rest) {
                *known = dot(&row(i)[panel + 1..], &self.step[panel + 1..]);
            }
            let mut step = [0.0; LANES];
            for i in (0..rest).rev() {
                step[i] = self.half_solved[panel][i] - known[i] * self.inverses[panel][i];
                for (above, known) in known.iter_mut().enumerate().take(i) {
                    *known += row(above)[panel][i] * step[i];
                }
            }
            self.step[panel] = step;
        }
        self.step().iter().all(|d| d.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// The step solves the equations, whatever the number of unknowns is beside a block's.
        #[test]
        fn the_step_solves_the_equations(
            n in 1..20_usize,
            numbers in proptest::collection::vec(-1.0..1.0_f64, 24 * 20),
            weights in proptest::collection::vec(0.1..1.0_f64, 24),
        ) {
            let blocks = blocks(n);
            let mut slopes = vec![[0.0; LANES]; 24 * blocks];
            for (row, numbers) in slopes.chunks_exact_mut(blocks).zip(numbers.chunks_exact(20)) {
                row.as_flattened_mut()[..n].copy_from_slice(&numbers[..n]);
            }
            let v: Vec<f64> = numbers.iter().take(24).copied().collect();
            let mut normal = Normal::default();
            normal.fill(&slopes, n, &weights, &v);
            prop_assert!(normal.solve(1e-9));
            for i in 0..n {
                let of = |row: &[f64]| -> f64 {
                    row.iter().zip(normal.step()).map(|(a, d)| a * d).sum()
                };
                let rows = slopes.chunks_exact(blocks).map(<[Lanes]>::as_flattened);
                let rows = rows.zip(&weights).zip(&v);
                // J^T W (v - J d) is 0, but for the damping.
                let rest: f64 = rows.map(|((row, w), v)| w * row[i] * (v - of(row))).sum();
                prop_assert!(rest.abs() < 1e-5 * (1.0 + normal.step().iter().fold(0.0, |m, d| d.abs().max(m))));
            }
        }

        /// The sum of squares falls as predicted by any part of a damped step.
        #[test]
        fn what_a_step_gains_is_predicted(
            n in 1..20_usize,
            numbers in proptest::collection::vec(-1.0..1.0_f64, 24 * 20),
            scale in 0.1..1.0_f64,
        ) {
            let blocks = blocks(n);
            let mut slopes = vec![[0.0; LANES]; 24 * blocks];
            for (row, numbers) in slopes.chunks_exact_mut(blocks).zip(numbers.chunks_exact(20)) {
                row.as_flattened_mut()[..n].copy_from_slice(&numbers[..n]);
            }
            let v: Vec<f64> = numbers.iter().take(24).copied().collect();
            let mut normal = Normal::default();
            normal.fill(&slopes, n, &[1.0; 24], &v);
            prop_assert!(normal.solve(0.1));
            let rows = slopes.chunks_exact(blocks).map(<[Lanes]>::as_flattened).zip(&v);
            let gained: f64 = rows
                .map(|(row, v)| {
                    let moved: f64 = row.iter().zip(normal.step()).map(|(a, d)| a * d).sum();
                    v * v - (v - scale * moved).powi(2)
                })
                .sum();
            let predicted = normal.predicted(scale);
            prop_assert!((gained - predicted).abs() < 1e-9 * (1.0 + gained), "{gained} {predicted}");
        }
    }

    #[test]
    fn equations_that_have_no_solution_are_refused() {
        let mut normal = Normal::default();
        normal.fill(&[[0.0; 4]], 1, &[1.0], &[1.0]);
        assert!(!normal.solve(1e-3));
        normal.fill(&[[f64::NAN, 0.0, 0.0, 0.0]], 1, &[1.0], &[1.0]);
        assert!(!normal.solve(1e-3));
    }
}
