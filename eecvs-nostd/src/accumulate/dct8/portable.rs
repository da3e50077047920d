//! Sums the atoms one by one.

use super::{ATOMS, Weighted, Weights, dot_add};

#[derive(Debug, Clone, Copy)]
pub struct Sums([i32; ATOMS]);

impl Sums {
    #[inline(always)]
    pub const fn zero() -> Self {
        Self([0; ATOMS])
    }

    #[inline(always)]
    pub fn add(&mut self, event: Weighted) {
        for (i, (sum, line)) in self.0.iter_mut().zip(event.lines).enumerate() {
            // k = i + 1
            let Weights { even, odd } = event.weights;
            let weights = if i % 2 == 0 { odd } else { even };
            *sum = dot_add(*sum, *line, weights);
        }
    }

    #[inline(always)]
    pub const fn into_array(self) -> [i32; ATOMS] {
        self.0
    }
}
