//! Where the peaks of a fine search grid may be: an inverse Fourier transform instead of a sum at every point.
//!
//! The sums of [`super::pursuit`] at P points are, for the DTFT,
//!
//! ```text
//! J_p = Re sum_k c_k exp(i pi k / P) exp(i 2 pi k p / P)
//! ```
//!
//! one transform of P numbers. It is computed in f64 and only says which points cannot be the highest, because they are
//! lower by more than the rounding errors of the sums in f32. The sums decide among the others, so the peak found is
//! the same to the bit.

use nalgebra::Complex;

type C64 = Complex<f64>;

/// Smallest number of points for which a transform is cheaper than the sums.
const POINTS_MIN: usize = 1024;
/// Three times the largest error of a sum of `known` products of complex numbers in f32, as a fraction of the sum of all
/// |re| and |im|: each of two additions a product is off by at most 2^-24 of the sum so far, and each product by 2^-23.
fn error(known: usize) -> f64 {
    3.0 * (2.0 * known as f64 + 2.0) / f64::from(1 << 24)
}

/// Tables for P points.
#[derive(Debug)]
pub struct Guide {
    /// exp(i 2 pi j / P), j = 0..P/2.
    turns: Vec<C64>,
    /// exp(i pi k / P), k = 0..K.
    shifts: Vec<C64>,
}

impl Guide {
    /// Creates the tables for K = `grid`; `None` unless `points` is a power of two, and large enough.
    #[must_use]
    pub fn new(points: usize, grid: usize) -> Option<Self> {
        let is_worth_it = points >= POINTS_MIN && points.is_power_of_two() && grid <= points;
        let unit = std::f64::consts::PI / points as f64;
        is_worth_it.then(|| Self {
            turns: (0..points / 2)
                .map(|j| C64::cis(2.0 * unit * j as f64))
                .collect(),
            shifts: (0..grid).map(|k| C64::cis(unit * k as f64)).collect(),
        })
    }

    /// Calls `each` with the points where J or -J, as far as they are allowed, may be largest, in ascending order.
    /// `known` are the k whose coefficients are `re` and `im`; all others are 0. Returns false, before any call, if
    /// the coefficients are too large for f32.
    pub fn peaks(
        &self,
        known: &[usize],
        (re, im): (&[f32], &[f32]),
        (may_be_on, may_be_off): (bool, bool),
        numbers: &mut Vec<C64>,
        mut each: impl FnMut(usize),
    ) -> bool {
        let points = 2 * self.turns.len();
        let unused = usize::BITS - points.ilog2();
        numbers.clear();
        numbers.resize(points, C64::ZERO);
        let mut sum = 0.0;
        for k in known {
            let c = C64::new(re[*k].into(), im[*k].into());
            sum += c.re.abs() + c.im.abs();
            numbers[k.reverse_bits() >> unused] = c * self.shifts[*k];
        }
        // Far below the largest f32, of which the products must be.
        if sum.is_nan() || sum >= 1e30 {
            return false;
        }
        self.transform(numbers);
        let height = |number: &C64| match (may_be_on, may_be_off) {
            (true, true) => number.re.abs(),
            (false, true) => -number.re,
            _ => number.re,
        };
        let most = numbers.iter().map(height).fold(f64::NEG_INFINITY, f64::max);
        let least = most - 2.0 * error(known.len()) * sum;
        for (point, number) in numbers.iter().enumerate() {
            if height(number) >= least {
                each(point);
            }
        }
        true
    }

    /// Computes the inverse Fourier transform, without a factor, of numbers in bit-reversed order.
    fn transform(&self, numbers: &mut [C64]) {
        let mut half = 1;
        while half < numbers.len() {
            let step = self.turns.len() / half;
            for block in numbers.chunks_exact_mut(2 * half) {
                let (lower, upper) = block.split_at_mut(half);
                let turns = self.turns.iter().step_by(step);
                for ((a, b), turn) in lower.iter_mut().zip(upper).zip(turns) {
                    let turned = *b * turn;
                    *b = *a - turned;
                    *a += turned;
                }
            }
            half *= 2;
        }
    }
}
