//! Hot, dead and stuck pixels.

use event_types::Polarity;

use super::Draws;
use crate::parameters::PixelParameters;

/// Number of the random sequences that decide on defects.
const KIND: u64 = 3;

/// What is wrong with a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Defect {
    /// Fires by itself at random, at this rate in Hz.
    Hot(f32),
    /// Never fires.
    Dead,
    /// Fires regularly and always alike; the first time is this share of the period after the beginning.
    Stuck(Polarity, f64),
}

/// Returns what is wrong with a pixel; most have nothing.
pub(crate) fn defect(parameters: &PixelParameters, seed: u64, pixel: u64) -> Option<Defect> {
    let mut draws = Draws::new(seed, KIND, pixel);
    let mut place = draws.unit();
    let mut is_within = |share: f64| {
        let within = place < share;
        place -= share;
        within
    };
    if is_within(parameters.hot_share) {
        let spread = draws.unit();
        let rate = parameters.hot_hz * (1.0 + 9.0 * spread * spread * spread);
        Some(Defect::Hot(rate as f32))
    } else if is_within(parameters.dead_share) {
        Some(Defect::Dead)
    } else if is_within(parameters.stuck_share) {
        let polarity = Polarity::from_bool(draws.unit() < 0.5);
        Some(Defect::Stuck(polarity, draws.unit()))
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_those_of_the_parameters() {
        let parameters = PixelParameters {
            hot_share: 0.2,
            dead_share: 0.3,
            stuck_share: 0.25,
            ..PixelParameters::default()
        };
        for seed in 0..5 {
            let mut counts = [0.0; 4];
            for pixel in 0..100_000 {
                let kind = match defect(&parameters, seed, pixel) {
                    Some(Defect::Hot(rate)) => {
                        assert!((20.0..=200.0).contains(&rate));
                        0
                    }
                    Some(Defect::Dead) => 1,
                    Some(Defect::Stuck(..)) => 2,
                    None => 3,
                };
                counts[kind] += 1e-5;
            }
            // Four standard deviations.
            let close = |i: usize, share: f64| (counts[i] - share).abs() < 0.006;
            assert!(
                close(0, 0.2) && close(1, 0.3) && close(2, 0.25),
                "{counts:?}"
            );
        }
    }
}
