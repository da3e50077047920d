//! Percentiles with linear interpolation between order statistics, like numpy's default.

/// Returns the `q`-th percentile of `values`, with `q` in 0..=100.
///
/// With the values sorted and h = (n - 1) q / 100, the percentile lies the fraction h - floor(h) of the way from
/// value floor(h) to the next value. Shape: `[f64; n]` in any order -> one value. The result is `None` if `values`
/// is empty or holds a NaN, or if `q` is out of range.
#[must_use]
pub fn percentile(values: &[f64], q: f64) -> Option<f64> {
    if values.is_empty() || values.iter().any(|v| v.is_nan()) || !(0.0..=100.0).contains(&q) {
        return None;
    }
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let h = (sorted.len() - 1) as f64 * (q / 100.0);
    let below = h.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    let (a, b, fraction) = (sorted[below], sorted[above], h - h.floor());
    // Interpolated from the nearer side, as numpy does: equal neighbours give exactly their value, and the results
    // are monotonic in q.
    Some(if fraction < 0.5 {
        a + (b - a) * fraction
    } else {
        b - (b - a) * (1.0 - fraction)
    })
}

/// Returns `(tau_low, tau_high)`: the 25th and 75th percentiles of the densities of a calibration set.
///
/// Empty windows must be included, with density 0. The result is `None` if `densities` is empty or holds a NaN.
#[must_use]
pub fn thresholds(densities: &[f64]) -> Option<(f64, f64)> {
    Some((percentile(densities, 25.0)?, percentile(densities, 75.0)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equals_numpy_literals() {
        // numpy.percentile(values, [25, 75]), numpy 2.4.
        let cases: [(&[f64], f64, f64); 8] = [
            (&[3.5], 3.5, 3.5),
            (&[1.0, 2.0], 1.25, 1.75),
            (&[0.0, 0.0, 0.0], 0.0, 0.0),
            (&[1.0, 2.0, 3.0], 1.5, 2.5),
            (&[0.0, 0.0, 1.0, 5.0], 0.0, 2.0),
            (&[0.1, 0.2, 0.3, 0.7, 1.9], 0.2, 0.7),
            (&[0.0, 0.0, 0.0, 0.0, 8.0, 8.0], 0.0, 6.0),
            (
                &[0.371, 0.123, 10.1, 17.7, 2.89, 0.949, 0.464],
                0.4175,
                6.495,
            ),
        ];
        for (values, low, high) in cases {
            assert_eq!(thresholds(values), Some((low, high)), "{values:?}");
        }
        assert_eq!(percentile(&[1.0, 2.0, 4.0, 8.0], 0.0), Some(1.0));
        assert_eq!(percentile(&[1.0, 2.0, 4.0, 8.0], 10.0), Some(1.3));
        assert_eq!(percentile(&[1.0, 2.0, 4.0, 8.0], 50.0), Some(3.0));
        assert_eq!(
            percentile(&[1.0, 2.0, 4.0, 8.0], 90.0),
            Some(6.800000000000001)
        );
        assert_eq!(percentile(&[1.0, 2.0, 4.0, 8.0], 100.0), Some(8.0));
    }

    #[test]
    fn order_does_not_matter() {
        assert_eq!(percentile(&[4.0, 1.0, 3.0, 2.0], 25.0), Some(1.75));
        assert_eq!(thresholds(&[4.0, 1.0, 3.0, 2.0]), Some((1.75, 3.25)));
    }

    #[test]
    fn nothing_from_nothing() {
        assert_eq!(percentile(&[], 25.0), None);
        assert_eq!(thresholds(&[]), None);
        assert_eq!(percentile(&[1.0, f64::NAN], 25.0), None);
        assert_eq!(percentile(&[1.0], 100.1), None);
        assert_eq!(percentile(&[1.0], f64::NAN), None);
    }
}
