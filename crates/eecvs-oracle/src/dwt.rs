//! Haar atoms at event times, eq. (6): `phi_0 = 1` and, for k = 2^j + m with 0 <= m < 2^j,
//! `phi_k(u) = 2^(j/2) h(2^j u - m)`, where h is +1 on [0, 1/2), -1 on [1/2, 1) and 0 elsewhere.
//!
//! Integers decide in which half an event lies: with u = t/T, the half [m/2^j, (m + 1/2)/2^j) is
//! `2m T <= 2^(j+1) t < (2m + 1) T`. A rounded quotient could put an event exactly on an edge on the wrong side.

use super::transform::Impulse;

/// Returns (j, m), the scale and shift of the atom k = 2^j + m, k >= 1.
///
/// # Panics
/// If k is 0.
#[must_use]
pub fn scale_and_shift(k: usize) -> (u32, usize) {
    let j = k.ilog2();
    (j, k - (1 << j))
}

/// Returns 2^(j/2), the height of the atoms of scale j; 1 for k = 0.
#[must_use]
pub fn height(k: usize) -> f64 {
    if k == 0 {
        1.0
    } else {
        ((1_u64 << scale_and_shift(k).0) as f64).sqrt()
    }
}

/// Returns h(2^j u - m) at u = t/T, one of -1, 0 and +1; 1 for k = 0. `t_us` must be less than `duration_us`.
#[must_use]
pub fn sign(k: usize, t_us: u32, duration_us: u32) -> i64 {
    if k == 0 {
        return 1;
    }
    let (j, m) = scale_and_shift(k);
    let (m, duration) = (m as u128, u128::from(duration_us));
    let time = u128::from(t_us) << (j + 1);
    if (2 * m * duration..(2 * m + 1) * duration).contains(&time) {
        1
    } else if ((2 * m + 1) * duration..(2 * m + 2) * duration).contains(&time) {
        -1
    } else {
        0
    }
}

/// Returns the atom `phi_k(u)` at u = t/T.
#[must_use]
pub fn atom(k: usize, t_us: u32, duration_us: u32) -> f64 {
    height(k) * sign(k, t_us, duration_us) as f64
}

/// Returns `c_k / 2^(j/2) = sum_i p_i h(2^j u_i - m)` for k = 0..grid, as exact integers.
///
/// Shape: `[Impulse; n] -> [i64; grid]`.
#[must_use]
pub fn unscaled(impulses: &[Impulse], duration_us: u32, grid: usize) -> Vec<i64> {
    (0..grid)
        .map(|k| {
            impulses
                .iter()
                .map(|i| i.p as i64 * sign(k, i.offset_us, duration_us))
                .sum()
        })
        .collect()
}

/// Returns `c_k = sum_i p_i phi_k(u_i)` for k = 0..grid, eq. (6), without normalisation by N, T or the grid.
///
/// Shape: `[Impulse; n] -> [f64; grid]`.
#[must_use]
pub fn coefficients(impulses: &[Impulse], duration_us: u32, grid: usize) -> Vec<f64> {
    let sums = unscaled(impulses, duration_us, grid);
    sums.into_iter()
        .enumerate()
        .map(|(k, sum)| height(k) * sum as f64)
        .collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::SQRT_2;

    use super::*;

    #[test]
    fn one_impulse_touches_one_atom_of_each_scale() {
        // u = 0.3: second quarter, third eighth, fifth sixteenth.
        let c = coefficients(
            &[Impulse {
                offset_us: 30,
                p: 1.0,
            }],
            100,
            16,
        );
        let mut expected = [0.0; 16];
        expected[0] = 1.0; // phi_0
        expected[1] = 1.0; // first half
        expected[2] = -SQRT_2; // second half of [0, 1/2)
        expected[4 + 1] = 2.0; // first half of [1/4, 1/2)
        expected[8 + 2] = 2.0 * SQRT_2; // 0.3 lies in [4/16, 5/16), first half of [1/4, 3/8)
        assert_eq!(c, expected);
    }

    #[test]
    fn edges_are_half_open_for_a_duration_that_no_power_of_two_divides() {
        // T = 7: the half is at t = 3.5, so 3 is in the first half and 4 in the second.
        let signs: Vec<i64> = (0..7).map(|t| sign(1, t, 7)).collect();
        assert_eq!(signs, [1, 1, 1, 1, -1, -1, -1]);
        // T = 6: an event exactly on the half belongs to the second half.
        let signs: Vec<i64> = (0..6).map(|t| sign(1, t, 6)).collect();
        assert_eq!(signs, [1, 1, 1, -1, -1, -1]);
        // j = 1, m = 1 on T = 6: [3, 4.5) is +, [4.5, 6) is -.
        let signs: Vec<i64> = (0..6).map(|t| sign(3, t, 6)).collect();
        assert_eq!(signs, [0, 0, 0, 1, 1, -1]);
    }

    #[test]
    fn a_duration_shorter_than_the_grid_still_has_one_cell_per_time() {
        let c = unscaled(
            &[Impulse {
                offset_us: 0,
                p: -1.0,
            }],
            1,
            8,
        );
        assert_eq!(c, [-1, -1, -1, 0, -1, 0, 0, 0]);
    }

    #[test]
    fn exact_at_the_largest_duration() {
        let t = u32::MAX - 1;
        assert_eq!(sign(127, t, u32::MAX), -1);
        assert_eq!(sign(126, t, u32::MAX), 0);
    }

    #[test]
    fn every_time_lies_in_one_atom_of_each_scale() {
        for duration in [1, 2, 3, 5, 100, 128, 1_000] {
            for t in 0..duration {
                for j in 0..6 {
                    let hits = (0..1 << j).filter(|m| sign((1 << j) + m, t, duration) != 0);
                    assert_eq!(hits.count(), 1, "t={t} T={duration} j={j}");
                }
            }
        }
    }

    /// `sum_k c_k^2 / K` is the energy of the K bin counts: the atoms are orthonormal.
    #[test]
    fn parseval_on_bin_counts() {
        let impulses = [
            (0, 1.0),
            (1, 1.0),
            (9, -1.0),
            (15, 1.0),
            (15, 1.0),
            (14, 1.0),
        ]
        .map(|(offset_us, p)| Impulse { offset_us, p });
        // K = 8 bins of two microseconds: counts 2, 0, 0, 0, -1, 0, 0, 3.
        let energy: f64 = coefficients(&impulses, 16, 8).iter().map(|c| c * c).sum();
        assert!((energy / 8.0 - (4.0 + 1.0 + 9.0)).abs() < 1e-12);
    }
}
