//! Sums the atoms one by one.

use super::{ATOMS, GRID, HALF, Row, Weights};
use crate::fixed_point::dot_add;

#[derive(Debug, Clone, Copy)]
pub struct Sums([i32; GRID]);

impl Sums {
    #[inline(always)]
    pub const fn zero() -> Self {
        Self([0; GRID])
    }

    #[inline(always)]
    pub fn add(&mut self, row: &Row, weights: Weights) {
        let halves = self.0.chunks_mut(HALF).zip(row.chunks(HALF));
        for ((sums, lines), weights) in halves.zip([weights.odd, weights.even]) {
            for (sum, line) in sums.iter_mut().zip(lines) {
                *sum = dot_add(*sum, *line, weights);
            }
        }
    }

    /// Returns the sums, k ascending.
    #[inline(always)]
    pub fn into_array(self) -> [i32; ATOMS] {
        let mut all = [0; ATOMS];
        let (odd, even) = self.0.split_at(HALF);
        for (sum, odd) in all.iter_mut().step_by(2).zip(odd) {
            *sum = *odd;
        }
        for (sum, even) in all.iter_mut().skip(1).step_by(2).zip(even) {
            *sum = *even;
        }
        all
    }
}
