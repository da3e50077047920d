//! Rounding of coefficients to multiples of a step, and its inverse.

use num_complex::Complex64;

/// Returns the nearest multiple of `step`, counted in steps: q = round(c / step), halves away from zero.
///
/// The error |c - q step| is at most step / 2 (test `error_is_at_most_half_a_step`). The result saturates at the
/// range of `i64`.
///
/// # Panics
/// If `step` is not a positive finite number.
#[must_use]
pub fn quantise(c: f64, step: f64) -> i64 {
    assert!(
        step.is_finite() && step > 0.0,
        "a quantiser step is positive, not {step}"
    );
    (c / step).round() as i64
}

/// Returns the value `q * step` that the decoder reconstructs from level `q`.
#[must_use]
pub fn dequantise(q: i64, step: f64) -> f64 {
    q as f64 * step
}

/// Quantises and dequantises the real and imaginary parts separately: the coefficient as the decoder sees it.
///
/// # Panics
/// If `step` is not a positive finite number.
#[must_use]
pub fn quantised(c: Complex64, step: f64) -> Complex64 {
    let part = |v: f64| dequantise(quantise(v, step), step);
    Complex64::new(part(c.re), part(c.im))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn halves_round_away_from_zero() {
        for (c, q) in [
            (0.0, 0),
            (0.124, 0),
            (0.125, 1),
            (-0.125, -1),
            (0.375, 2),
            (-0.375, -2),
            (0.374, 1),
            (1.0, 4),
            (-7.9, -32),
        ] {
            assert_eq!(quantise(c, 0.25), q, "{c}");
        }
        assert_eq!(dequantise(-32, 0.25), -8.0);
        assert_eq!(
            quantised(Complex64::new(0.9, -0.4), 1.0 / 2.0),
            Complex64::new(1.0, -0.5)
        );
    }

    #[test]
    fn saturates() {
        assert_eq!(quantise(1e300, 1e-3), i64::MAX);
        assert_eq!(quantise(-1e300, 1e-3), i64::MIN);
    }

    #[test]
    #[should_panic(expected = "positive")]
    fn step_zero_is_a_mistake() {
        let _ = quantise(1.0, 0.0);
    }

    proptest! {
        #[test]
        fn error_is_at_most_half_a_step(c in -1e4f64..1e4, exponent in -14i32..4) {
            let step = 2.0_f64.powi(exponent);
            prop_assert!((dequantise(quantise(c, step), step) - c).abs() <= step / 2.0);
            prop_assert_eq!(quantise(-c, step), -quantise(c, step));
        }
    }
}
