//! Inverse transform, sampled as B equal time bins.
//!
//! The kept coefficients define a projection of the pixel's signal:
//!
//! ```text
//! DCT    s_hat(u) = c_0 + 2 sum_(k>=1) c_k cos(pi k u)
//! DTFT   s_hat(u) = c_0 + 2 Re sum_(k>=1) c_k exp(+i 2 pi k u)
//! Haar   s_hat(u) = c_0 + sum_(j,m) c_(j,m) 2^(j/2) h(2^j u - m)
//! ```
//!
//! Bin b holds the integral of `s_hat` over [b/B, (b+1)/B), an approximation of the signed event count of the bin.
//! The integrals are evaluated in closed form, so the bins sum to `c_0` for every transform and B.

use std::f64::consts::{PI, TAU};

use num_complex::Complex64;

use super::dwt;
use super::transform::Transform;

/// Returns V\[b\], the integral of `s_hat(u)` over [b/B, (b+1)/B), for b = 0..bins, in signed events.
///
/// `coefficients` holds `c_k` at index k, 0 where it was pruned.
/// Shape: `[Complex64; K] -> [f64; B]`.
#[must_use]
pub fn bins(transform: Transform, coefficients: &[Complex64], bins: usize) -> Vec<f64> {
    (0..bins)
        .map(|b| {
            coefficients
                .iter()
                .enumerate()
                .map(|(k, c)| match transform {
                    Transform::Dct => c.re * dct_integral(k, b, bins),
                    Transform::Dtft => (c * dtft_integral(k, b, bins)).re,
                    Transform::Dwt => c.re * dwt_integral(k, b, bins),
                })
                .sum()
        })
        .collect()
}

/// Returns the integral of 2 cos(pi k u), or of 1 for k = 0, over bin b of B.
fn dct_integral(k: usize, b: usize, bins: usize) -> f64 {
    let (from, to) = edges(b, bins);
    if k == 0 {
        return 1.0 / bins as f64;
    }
    let frequency = PI * k as f64;
    2.0 * ((frequency * to).sin() - (frequency * from).sin()) / frequency
}

/// Returns the integral of 2 exp(i 2 pi k u), or of 1 for k = 0, over bin b of B.
fn dtft_integral(k: usize, b: usize, bins: usize) -> Complex64 {
    let (from, to) = edges(b, bins);
    if k == 0 {
        return Complex64::from(1.0 / bins as f64);
    }
    let frequency = TAU * k as f64;
    2.0 * (Complex64::cis(frequency * to) - Complex64::cis(frequency * from))
        / Complex64::new(0.0, frequency)
}

/// Returns the integral of the Haar atom k over bin b of B: its height times the signed overlap, which is an integer
/// in units of 1 / (2^(j+1) B).
fn dwt_integral(k: usize, b: usize, bins: usize) -> f64 {
    if k == 0 {
        return 1.0 / bins as f64;
    }
    let (j, m) = dwt::scale_and_shift(k);
    let halves = 2_usize << j;
    let bin = (b * halves, (b + 1) * halves);
    let overlap = |half: usize| {
        let (from, to) = (half * bins, (half + 1) * bins);
        bin.1.min(to).saturating_sub(bin.0.max(from)) as f64
    };
    dwt::height(k) * (overlap(2 * m) - overlap(2 * m + 1)) / (halves * bins) as f64
}

/// Returns the start and end of bin b of B as fractions of the window.
fn edges(b: usize, bins: usize) -> (f64, f64) {
    (b as f64 / bins as f64, (b + 1) as f64 / bins as f64)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_events::impulses;
    use crate::transform::Impulse;

    fn close(a: &[f64], b: &[f64], tolerance: f64) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance)
    }

    /// Counts the signed events per bin, with the bin edges decided on integers.
    fn counts(impulses: &[Impulse], duration_us: u32, bins: usize) -> Vec<f64> {
        let mut counts = vec![0.0; bins];
        for i in impulses {
            counts[(i.offset_us as usize * bins) / duration_us as usize] += i.p;
        }
        counts
    }

    #[test]
    fn constant_spreads_evenly() {
        for transform in Transform::ALL {
            assert_eq!(bins(transform, &[Complex64::from(6.0)], 3), [2.0; 3]);
        }
    }

    #[test]
    fn hand_computed() {
        let one = |k: usize| -> Vec<Complex64> {
            (0..=k)
                .map(|i| Complex64::from(if i == k { 1.0 } else { 0.0 }))
                .collect()
        };
        // 2 cos(pi u) over the two halves: +-2/pi.
        assert!(close(
            &bins(Transform::Dct, &one(1), 2),
            &[2.0 / PI, -2.0 / PI],
            1e-15
        ));
        // 2 cos(2 pi u) over the four quarters: +-1/pi.
        let quarter = 1.0 / PI;
        let expected = [quarter, -quarter, -quarter, quarter];
        assert!(close(&bins(Transform::Dtft, &one(1), 4), &expected, 1e-15));
        // c = -i turns it into 2 sin(2 pi u).
        let sine = [Complex64::ZERO, Complex64::new(0.0, -1.0)];
        assert!(close(
            &bins(Transform::Dtft, &sine, 4),
            &[quarter, quarter, -quarter, -quarter],
            1e-15
        ));
        // k = 3 is the atom of the second half, with height sqrt 2: over the quarters 0, 0, +, -.
        let q = 2.0_f64.sqrt() / 4.0;
        assert_eq!(bins(Transform::Dwt, &one(3), 4), [0.0, 0.0, q, -q]);
        // Three bins cut it at 2/3: sqrt 2 * (2/3 - 1/2) and sqrt 2 * (1/12 - 1/4).
        let s = 2.0_f64.sqrt() / 6.0;
        assert!(close(
            &bins(Transform::Dwt, &one(3), 3),
            &[0.0, s, -s],
            1e-15
        ));
    }

    #[test]
    fn an_impulse_peaks_in_its_bin() {
        let impulse = [Impulse {
            offset_us: 40,
            p: -1.0,
        }];
        for transform in Transform::ALL {
            let c = transform.coefficients(&impulse, 100, 32);
            let v = bins(transform, &c, 8);
            let lowest = (0..8).min_by(|&a, &b| v[a].total_cmp(&v[b]));
            assert_eq!(lowest, Some(3), "{transform:?} {v:?}");
        }
    }

    proptest! {
        #[test]
        fn haar_with_all_coefficients_gives_the_bin_counts(
            (duration_us, a) in impulses(),
            log_bins in 0u32..6,
        ) {
            let size = 1 << log_bins;
            let c = Transform::Dwt.coefficients(&a, duration_us, size);
            prop_assert!(close(
                &bins(Transform::Dwt, &c, size), &counts(&a, duration_us, size), 1e-11
            ));
        }

        #[test]
        fn bins_sum_to_coefficient_zero((duration_us, a) in impulses(), size in 1usize..20) {
            for transform in Transform::ALL {
                let c = transform.coefficients(&a, duration_us, 16);
                let sum: f64 = bins(transform, &c, size).iter().sum();
                prop_assert!((sum - c[0].re).abs() < 1e-10, "{:?}", transform);
            }
        }

        /// DCT and DTFT sums approach the exact bin counts as they grow longer.
        #[test]
        fn more_coefficients_come_closer(offset_us in 0u32..1000) {
            let a = [Impulse { offset_us, p: 1.0 }];
            // An impulse near the edge of a bin shares its mass with the neighbouring bin (Gibbs).
            prop_assume!((20..230).contains(&(offset_us % 250)));
            for transform in [Transform::Dct, Transform::Dtft] {
                let c = transform.coefficients(&a, 1000, 512);
                prop_assert!(close(
                    &bins(transform, &c, 4), &counts(&a, 1000, 4), 0.05
                ), "{:?}", transform);
            }
        }
    }
}
