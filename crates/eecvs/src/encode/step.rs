//! Chooses a quantiser for a given error bound.

use eecvs_nostd::Quantiser;

/// Returns the coarsest quantiser whose rounding error is at most `error`, or `None` if `error` is below 2^-16 or
/// NaN.
///
/// The step D is the largest power of two with D / 2 <= `error`. Each number of a kept coefficient (the real and
/// the imaginary part separately) is then within `error` of the number that the kernel computed. The kernel's own
/// error comes on top: at most n 2^-14 for n events in the pixel, and none for the Haar transform.
#[must_use]
pub fn quantiser_within(error: f64) -> Option<Quantiser> {
    (Quantiser::STEP_LOG2_MIN..=Quantiser::STEP_LOG2_MAX)
        .rev()
        .find(|step_log2| f64::from(*step_log2 - 1).exp2() <= error)
        .and_then(Quantiser::new)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_is_the_largest_that_will_do() {
        for (error, step_log2) in [
            (2_f64.powi(-16), Some(-15)),
            (0.0077, Some(-7)),
            (0.0078125, Some(-6)),
            (0.0156, Some(-6)),
            (1.0, Some(1)),
            (128.0, Some(8)),
            (f64::INFINITY, Some(8)),
            (1e-5, None),
            (0.0, None),
            (-1.0, None),
            (f64::NAN, None),
        ] {
            let found = quantiser_within(error).map(Quantiser::step_log2);
            assert_eq!(found, step_log2, "{error}");
        }
    }
}
