//! DTFT atoms at event times: `phi_k(u) = exp(-i 2 pi k u)`, eq. (6).
//!
//! The signal is real, so the coefficient at -k is the conjugate of that at k, and only k >= 0 is stored.

use std::f64::consts::TAU;

use num_complex::Complex64;

use super::transform::Impulse;

/// Returns the atom `phi_k(u) = exp(-i 2 pi k u)` at normalised time u in [0, 1).
#[must_use]
pub fn atom(k: usize, u: f64) -> Complex64 {
    Complex64::cis(-TAU * k as f64 * u)
}

/// Returns `c_k = sum_i p_i exp(-i 2 pi k u_i)` for k = 0..grid, eq. (6), without normalisation.
///
/// Shape: `[Impulse; n] -> [Complex64; grid]`.
#[must_use]
pub fn coefficients(impulses: &[Impulse], duration_us: u32, grid: usize) -> Vec<Complex64> {
    (0..grid)
        .map(|k| {
            impulses
                .iter()
                .map(|i| i.p * atom(k, i.u(duration_us)))
                .sum()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_impulse_at_a_quarter_turns_clockwise() {
        let c = coefficients(
            &[Impulse {
                offset_us: 25,
                p: 1.0,
            }],
            100,
            5,
        );
        let expected = [(1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 1.0), (1.0, 0.0)];
        for (got, (re, im)) in c.iter().zip(expected) {
            assert!((got - Complex64::new(re, im)).norm() < 1e-15, "{c:?}");
        }
    }

    #[test]
    fn one_impulse_has_the_same_magnitude_everywhere() {
        let c = coefficients(
            &[Impulse {
                offset_us: 4_711,
                p: -1.0,
            }],
            32_768,
            64,
        );
        assert!(c.iter().all(|c| (c.norm() - 1.0).abs() < 1e-13));
        assert_eq!(c[0], Complex64::new(-1.0, 0.0));
    }

    #[test]
    fn an_even_comb_excites_only_its_multiples() {
        let comb: Vec<Impulse> = (0..4)
            .map(|i| Impulse {
                offset_us: 10 * i,
                p: 1.0,
            })
            .collect();
        for (k, c) in coefficients(&comb, 40, 9).iter().enumerate() {
            let expected = if k % 4 == 0 { 4.0 } else { 0.0 };
            assert!((c - expected).norm() < 1e-13, "k={k} {c}");
        }
    }

    /// On a grid of K times, the atoms k = 0..K form a discrete Fourier basis.
    #[test]
    fn parseval_on_a_time_grid() {
        let impulses = [(0, 1.0), (3, -1.0), (3, -1.0), (6, 1.0)]
            .map(|(offset_us, p)| Impulse { offset_us, p });
        let energy: f64 = coefficients(&impulses, 8, 8)
            .iter()
            .map(Complex64::norm_sqr)
            .sum();
        assert!((energy / 8.0 - (1.0 + 4.0 + 1.0)).abs() < 1e-12);
    }
}
