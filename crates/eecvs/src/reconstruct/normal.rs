//! Normal equations of least squares: A = J^T W J, and their solution by Cholesky's factors.
//!
//! Rows of J and of A are whole blocks of [`LANES`] numbers, the last of which zeros fill, so that all sums run over
//! blocks, in the same order on every machine.

use std::array::from_fn;

use super::lanes::{LANES, Lanes, add_row, blocks, dot};

/// Equations for n unknowns, with the memory to solve them.
#[derive(Debug, Default)]
pub struct Normal {
    n: usize,
    /// Rows of A, of [`blocks`] blocks each; only the upper triangle is used.
    matrix: Vec<Lanes>,
    /// J^T W v.
    vector: Vec<Lanes>,
    /// Upper triangle of U with U^T U = A, and 1 / U_ii.
    factor: Vec<Lanes>,
    inverses: Vec<Lanes>,
    /// y with U^T y = J^T W v.
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

    /// Computes A and J^T W v of `n` unknowns from rows of J, of [`blocks`] blocks each; without v, the vector is 0.
    #[inline(always)]
    pub fn fill(&mut self, slopes: &[Lanes], n: usize, weights: &[f64], v: &[f64]) {
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

    /// Solves (A + lambda diag) d = J^T W v into [`Self::step`]; returns false if that matrix is not positive definite,
    /// or the solution not finite.
    #[inline(always)]
    pub fn solve(&mut self, lambda: f64) -> bool {
        let (n, blocks) = (self.n, blocks(self.n));
        let diagonal = |j: usize| self.matrix[j * blocks + j / LANES][j % LANES];
        let mean = (0..n).map(diagonal).sum::<f64>() / n.max(1) as f64;
        let damping = |j: usize| lambda * (diagonal(j) + 1e-3 * mean);
        // Four rows at a time, from their block on the diagonal to the right. Left of the diagonal, blocks hold what is
        // not used; so do rows behind the last.
        for panel in 0..blocks {
            let (above, rows) = self.factor.split_at_mut(LANES * panel * blocks);
            let above = || above.chunks_exact(blocks);
            let of_panel = |i: usize| (LANES * panel + i) * blocks;
            let rest = n - LANES * panel;
            let mut inverses = [0.0; LANES];
            // U of the block on the diagonal.
            let mut corner = [[0.0; LANES]; LANES];
            for block in panel..blocks {
                let mut tile: [Lanes; LANES] = from_fn(|i| self.matrix[of_panel(i) + block]);
                if block == panel {
                    for (i, row) in tile.iter_mut().enumerate().take(rest) {
                        row[i] += damping(LANES * panel + i);
                    }
                }
                for upper in above() {
                    let (by, of) = (upper[panel], upper[block]);
                    for (row, by) in tile.iter_mut().zip(by) {
                        *row = from_fn(|lane| row[lane] - by * of[lane]);
                    }
                }
                for i in 0..LANES.min(rest) {
                    for k in 0..i {
                        let (of, by) = (tile[k], corner[k][i]);
                        tile[i] = from_fn(|lane| tile[i][lane] - by * of[lane]);
                    }
                    if block == panel {
                        let square = tile[i][i];
                        // What is not a number is not positive either.
                        if square.is_nan() || square <= 0.0 {
                            return false;
                        }
                        inverses[i] = 1.0 / square.sqrt();
                    }
                    tile[i] = tile[i].map(|number| number * inverses[i]);
                    if block == panel {
                        corner[i] = tile[i];
                    }
                }
                for (i, row) in tile.into_iter().enumerate() {
                    rows[i * blocks + block] = row;
                }
            }
            self.inverses[panel] = inverses;
        }
        let inverses = self.inverses.as_flattened();
        // U^T y = J^T W v: what is known is taken from the rest.
        self.step.copy_from_slice(&self.vector);
        for (j, inverse) in inverses.iter().enumerate().take(n) {
            let (block, lane) = (j / LANES, j % LANES);
            let solved = self.step[block][lane] * inverse;
            self.half_solved[block][lane] = solved;
            let row = &self.factor[j * blocks..][block..blocks];
            add_row(&mut self.step[block..], -solved, row);
        }
        // U d = y, where d is 0 until it is known.
        self.step.fill([0.0; LANES]);
        for j in (0..n).rev() {
            let (block, lane) = (j / LANES, j % LANES);
            let row = &self.factor[j * blocks..][block..blocks];
            let known = dot(row, &self.step[block..]);
            self.step[block][lane] = (self.half_solved[block][lane] - known) * inverses[j];
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
