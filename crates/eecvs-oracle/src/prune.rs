//! Selection of the coefficients of a pixel that are kept.

use num_complex::Complex64;

use super::transform::{Transform, kept_count};

/// Magnitudes that differ by less than this share of the pixel's largest magnitude count as tied.
///
/// Ties are common and exact in the formulas: for a single event |exp(i x)| = 1 at every frequency, and events that
/// cancel leave exact zeros. In f64, tied values differ by a few 1e-16 of the sum, and this rounding noise must not
/// decide which coefficients are kept. Distinct values as close as 1e-12 are equivalent for every use of the
/// coefficients.
pub const TIE: f64 = 1e-12;

/// Returns the indices of the r = min(M, K) kept coefficients, in ascending order.
///
/// DCT: the first r. DTFT and DWT: the r with the largest `|c_k|`; ties (see [`TIE`]) go to the lower k.
/// Shape: `[Complex64; K] -> [usize; r]`.
#[must_use]
pub fn kept(transform: Transform, coefficients: &[Complex64], m: usize) -> Vec<usize> {
    let r = kept_count(m, coefficients.len());
    match transform {
        Transform::Dct => (0..r).collect(),
        Transform::Dtft | Transform::Dwt => largest(coefficients, r),
    }
}

/// Returns the coefficients with all but the kept ones set to 0. Shape: `[Complex64; K] -> [Complex64; K]`.
#[must_use]
pub fn prune(transform: Transform, coefficients: &[Complex64], m: usize) -> Vec<Complex64> {
    let mut pruned = vec![Complex64::ZERO; coefficients.len()];
    for k in kept(transform, coefficients, m) {
        pruned[k] = coefficients[k];
    }
    pruned
}

fn largest(coefficients: &[Complex64], r: usize) -> Vec<usize> {
    let magnitude: Vec<f64> = coefficients.iter().map(|c| c.norm()).collect();
    let tolerance = TIE * magnitude.iter().copied().fold(0.0, f64::max);
    let mut order: Vec<usize> = (0..magnitude.len()).collect();
    order.sort_by(|&a, &b| magnitude[b].total_cmp(&magnitude[a]));
    // Magnitudes within the tolerance of the first of a run form one tie, ordered by k.
    let mut rest = order.as_mut_slice();
    while let Some(&first) = rest.first() {
        let tied = rest.partition_point(|&k| magnitude[first] - magnitude[k] <= tolerance);
        let (tie, after) = rest.split_at_mut(tied);
        tie.sort_unstable();
        rest = after;
    }
    order.truncate(r);
    order.sort_unstable();
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transform::Impulse;

    fn real(values: &[f64]) -> Vec<Complex64> {
        values.iter().copied().map(Complex64::from).collect()
    }

    #[test]
    fn dct_keeps_the_low_frequencies() {
        assert_eq!(
            kept(Transform::Dct, &real(&[0.0, 1.0, 9.0, 8.0]), 2),
            [0, 1]
        );
    }

    #[test]
    fn others_keep_the_largest_in_ascending_order() {
        let c = real(&[1.0, -5.0, 0.0, 4.0, -2.0]);
        assert_eq!(kept(Transform::Dwt, &c, 3), [1, 3, 4]);
        let c = [
            Complex64::new(3.0, 0.0),
            Complex64::new(3.0, 4.0),
            Complex64::new(0.0, -4.0),
        ];
        assert_eq!(kept(Transform::Dtft, &c, 2), [1, 2]);
    }

    #[test]
    fn r_is_the_smaller_of_m_and_the_grid() {
        assert_eq!(kept(Transform::Dwt, &real(&[1.0, 2.0]), 16), [0, 1]);
        assert_eq!(kept(Transform::Dwt, &[], 16), [0; 0]);
        assert_eq!(kept(Transform::Dtft, &real(&[1.0]), 0), [0; 0]);
    }

    #[test]
    fn ties_go_to_the_lower_k() {
        assert_eq!(
            kept(Transform::Dwt, &real(&[1.0, -2.0, 2.0, -2.0, 3.0]), 3),
            [1, 2, 4]
        );
        assert_eq!(kept(Transform::Dwt, &real(&[0.0; 6]), 2), [0, 1]);
    }

    #[test]
    fn rounding_noise_does_not_order_ties() {
        let c = real(&[1.0 - 3e-16, 1.0, 1.0 - 1e-15, 1.0 + 1e-15]);
        assert_eq!(kept(Transform::Dtft, &c, 2), [0, 1]);
        // For one event every magnitude is 1, whatever its time.
        for offset_us in [0, 1, 4_711, 20_000, 32_767] {
            let c = Transform::Dtft.coefficients(&[Impulse { offset_us, p: 1.0 }], 32_768, 64);
            assert_eq!(
                kept(Transform::Dtft, &c, 8),
                [0, 1, 2, 3, 4, 5, 6, 7],
                "{offset_us}"
            );
        }
        // ON and OFF half a window apart: the even frequencies cancel, the odd frequencies have magnitude 2.
        let pair = [(3, 1.0), (53, -1.0)].map(|(offset_us, p)| Impulse { offset_us, p });
        let c = Transform::Dtft.coefficients(&pair, 100, 8);
        assert_eq!(kept(Transform::Dtft, &c, 6), [0, 1, 2, 3, 5, 7]);
    }

    #[test]
    fn a_real_difference_does_order() {
        assert_eq!(kept(Transform::Dwt, &real(&[1.0, 1.0 + 1e-9]), 1), [1]);
    }

    #[test]
    fn pruned_entries_are_zero() {
        let c = real(&[1.0, -5.0, 0.5, 4.0]);
        assert_eq!(prune(Transform::Dwt, &c, 2), real(&[0.0, -5.0, 0.0, 4.0]));
        assert_eq!(prune(Transform::Dct, &c, 2), real(&[1.0, -5.0, 0.0, 0.0]));
    }
}
