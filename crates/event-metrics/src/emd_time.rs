//! Wasserstein-1 distance between the event times of two windows.

/// Returns the W1 distance, in us, between the empirical distributions of two sets of times (us), each of unit mass.
///
/// `W1 = integral of |F_a(t) - F_b(t)| dt`, in exact integers up to the last division; equal to
/// `scipy.stats.wasserstein_distance`. If one side of the window is empty the result is `window_us`, if both are
/// empty it is 0. The slices are sorted in place.
#[must_use]
pub fn wasserstein_us(a: &mut [u64], b: &mut [u64], window_us: u64) -> f64 {
    match (a.is_empty(), b.is_empty()) {
        (true, true) => return 0.0,
        (true, false) | (false, true) => return window_us as f64,
        (false, false) => {}
    }
    a.sort_unstable();
    b.sort_unstable();
    let (total_a, total_b) = (a.len() as u128, b.len() as u128);
    let (mut rest_a, mut rest_b) = (&*a, &*b);
    let (mut below_a, mut below_b) = (0_u128, 0_u128);
    let mut previous = 0;
    let mut area = 0_u128;
    while let Some(t) = rest_a.first().into_iter().chain(rest_b.first()).min() {
        let t = *t;
        // Both distributions are 0 before the first time, so the first step adds nothing.
        let height = (below_a * total_b).abs_diff(below_b * total_a);
        area += height * u128::from(t - previous);
        previous = t;
        below_a += take_equal(&mut rest_a, t);
        below_b += take_equal(&mut rest_b, t);
    }
    area as f64 / (total_a * total_b) as f64
}

/// Removes the times equal to `t` from the front of `rest` and returns how many there were.
fn take_equal(rest: &mut &[u64], t: u64) -> u128 {
    let mut taken = 0;
    while let Some((first, after)) = rest.split_first() {
        if *first != t {
            break;
        }
        *rest = after;
        taken += 1;
    }
    taken
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn hand_computed() {
        assert_eq!(wasserstein_us(&mut [], &mut [], 10), 0.0);
        assert_eq!(wasserstein_us(&mut [3], &mut [], 10), 10.0);
        assert_eq!(wasserstein_us(&mut [], &mut [3], 10), 10.0);
        assert_eq!(wasserstein_us(&mut [3], &mut [7], 10), 4.0);
        assert_eq!(wasserstein_us(&mut [7, 3], &mut [3, 7], 10), 0.0);
        // Half of the mass moves by 4.
        assert_eq!(wasserstein_us(&mut [3, 7], &mut [7], 10), 2.0);
        let far = u64::MAX;
        assert_eq!(wasserstein_us(&mut [far], &mut [far - 8], 10), 8.0);
    }

    /// Integral of `|F_a - F_b|`, summed over every microsecond.
    fn cdf_integral(a: &[u64], b: &[u64]) -> f64 {
        let below = |times: &[u64], t| {
            times.iter().filter(|other| **other <= t).count() as f64 / times.len() as f64
        };
        (0..200).map(|t| (below(a, t) - below(b, t)).abs()).sum()
    }

    proptest! {
        #[test]
        fn equals_the_cdf_integral(
            mut a in proptest::collection::vec(0_u64..200, 1..40),
            mut b in proptest::collection::vec(0_u64..200, 1..40),
        ) {
            let expected = cdf_integral(&a, &b);
            prop_assert!((wasserstein_us(&mut a, &mut b, 200) - expected).abs() < 1e-9);
        }
    }
}
