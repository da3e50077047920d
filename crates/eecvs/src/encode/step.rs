//! The quantiser for an error that is asked for.

use eecvs_nostd::Quantiser;

/// The coarsest quantiser whose levels stand for numbers within `error`: the largest step D, a power of
/// two, with D / 2 <= error. Each number of a kept coefficient, re and im of a complex one, is then
/// within `error` of what the kernel computed; the kernel's own error, n 2^-14 at the most for n events
/// in the pixel and none of the Haar transform, comes on top. `None` below 2^-16, or for what is no
/// number.
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
