//! DCT atoms at event times: `phi_k(u) = cos(pi k u)`, eq. (6).

use std::f64::consts::PI;

use super::transform::Impulse;

/// Returns the atom `phi_k(u) = cos(pi k u)` at normalised time u in [0, 1).
#[must_use]
pub fn atom(k: usize, u: f64) -> f64 {
    (PI * k as f64 * u).cos()
}

/// Returns `c_k = sum_i p_i cos(pi k u_i)` for k = 0..grid, eq. (6), without normalisation.
///
/// Shape: `[Impulse; n] -> [f64; grid]`.
#[must_use]
pub fn coefficients(impulses: &[Impulse], duration_us: u32, grid: usize) -> Vec<f64> {
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
    fn one_impulse_in_the_middle() {
        let c = coefficients(
            &[Impulse {
                offset_us: 50,
                p: -1.0,
            }],
            100,
            5,
        );
        for (got, expected) in c.iter().zip([-1.0, 0.0, 1.0, 0.0, -1.0]) {
            assert!((got - expected).abs() < 1e-15, "{c:?}");
        }
    }

    #[test]
    fn one_impulse_at_a_third() {
        let c = coefficients(
            &[Impulse {
                offset_us: 1,
                p: 1.0,
            }],
            3,
            7,
        );
        for (got, expected) in c.iter().zip([1.0, 0.5, -0.5, -1.0, -0.5, 0.5, 1.0]) {
            assert!((got - expected).abs() < 1e-14, "{c:?}");
        }
    }

    #[test]
    fn all_ones_at_the_start() {
        assert_eq!(
            coefficients(
                &[Impulse {
                    offset_us: 0,
                    p: 1.0
                }],
                7,
                4
            ),
            [1.0; 4]
        );
    }

    /// Sampled at the midpoints of K cells, the atoms are orthogonal: `(c_0^2 + 2 sum_(k>=1) c_k^2) / K` is the
    /// energy of the signal.
    #[test]
    fn parseval_at_cell_midpoints() {
        let cells: [f64; 8] = [3.0, 0.0, -2.0, 1.0, 0.0, 5.0, -1.0, 4.0];
        let mut impulses = Vec::new();
        for (offset_us, n) in (1..).step_by(2).zip(cells) {
            let copies = n.abs() as usize;
            impulses.extend(vec![
                Impulse {
                    offset_us,
                    p: n.signum()
                };
                copies
            ]);
        }
        let c = coefficients(&impulses, 16, 8);
        let energy: f64 = c
            .iter()
            .enumerate()
            .map(|(k, c)| if k == 0 { c * c } else { 2.0 * c * c })
            .sum();
        let expected: f64 = cells.iter().map(|n| n * n).sum();
        assert!((energy / 8.0 - expected).abs() < 1e-12);
    }
}
