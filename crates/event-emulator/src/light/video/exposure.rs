//! From the numbers of a picture to light.

use event_types::ensure;
use event_types::stream::{Response, Result};

use crate::math::{exp, ln};
use crate::wide::wide;

/// What light the numbers of a picture stand for.
///
/// A number v, 0 for black and 1 for white, is the illuminance `white_lux` (r(v) + `flare`) / (1 + `flare`) in lux, with
/// r(v) = v for [`Response::Linear`] and, for [`Response::Srgb`], r(v) = v / 12.92 up to v = 0.04045 and
/// ((v + 0.055) / 1.055)^2.4 above (IEC 61966-2-1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// How numbers follow the light.
    pub response: Response,
    /// Illuminance of white, in lux: 0.001 to 1,000,000. A lit room has 300.
    pub white_lux: f64,
    /// Light that a lens spreads over the picture, as a share of white: 0.00001 to 1. Black is as bright, and has no
    /// events by the steps of its numbers.
    pub flare: f64,
}

/// Ranges of the numbers.
const WHITE_LUX: (f64, f64) = (1e-3, 1e6);
const FLARE: (f64, f64) = (1e-5, 1.0);

impl Exposure {
    /// Returns the usual exposure: white at 300 lx, and flare of 0.01.
    #[must_use]
    pub const fn of(response: Response) -> Self {
        Self {
            response,
            white_lux: 300.0,
            flare: 0.01,
        }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// A value out of its range, or none at all.
    pub fn check(&self) -> Result<()> {
        for (name, unit, value, (least, most)) in [
            ("white_lux", "lx", self.white_lux, WHITE_LUX),
            ("flare", "of white", self.flare, FLARE),
        ] {
            ensure!(
                (least..=most).contains(&value),
                Refused,
                "{name} is {value}; give {least} to {most} {unit}"
            );
        }
        Ok(())
    }

    /// Turns numbers into ln lux.
    pub(crate) fn expose(&self, values: &mut [f32]) {
        let white = (self.white_lux / (1.0 + self.flare)) as f32;
        let flare = self.flare as f32;
        match self.response {
            Response::Srgb => srgb(values, white, flare),
            Response::Linear => linear(values, white, flare),
        }
    }
}

fn srgb(values: &mut [f32], white: f32, flare: f32) {
    wide!(each_srgb, values: &mut [f32], white: f32, flare: f32);
}

fn linear(values: &mut [f32], white: f32, flare: f32) {
    wide!(each_linear, values: &mut [f32], white: f32, flare: f32);
}

#[inline(always)]
fn each_srgb(values: &mut [f32], white: f32, flare: f32) {
    for value in values {
        let low = *value / 12.92;
        let high = exp(2.4 * ln((*value + 0.055) / 1.055));
        let light = if *value <= 0.040_45 { low } else { high };
        *value = ln(white * (light + flare));
    }
}

#[inline(always)]
fn each_linear(values: &mut [f32], white: f32, flare: f32) {
    for value in values {
        *value = ln(white * (*value + flare));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_become_light_by_the_stated_formula() {
        for response in Response::ALL {
            let exposure = Exposure {
                white_lux: 500.0,
                flare: 0.002,
                ..Exposure::of(response)
            };
            let numbers: Vec<f32> = (0..=1_000).map(|i| i as f32 * 1.5e-3).collect();
            let mut lights = numbers.clone();
            exposure.expose(&mut lights);
            for (v, light) in numbers.iter().zip(lights) {
                let v = f64::from(*v);
                let r = match response {
                    Response::Linear => v,
                    Response::Srgb if v <= 0.040_45 => v / 12.92,
                    Response::Srgb => ((v + 0.055) / 1.055).powf(2.4),
                };
                let expected = (500.0 * (r + 0.002) / 1.002).ln();
                assert!((f64::from(light) - expected).abs() < 2e-6, "{v}: {light}");
            }
        }
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        let good = Exposure::of(Response::Srgb);
        good.check().unwrap();
        for bad in [
            Exposure {
                white_lux: 0.0,
                ..good
            },
            Exposure {
                white_lux: f64::NAN,
                ..good
            },
            Exposure { flare: 0.0, ..good },
            Exposure {
                flare: f64::INFINITY,
                ..good
            },
        ] {
            assert!(bad.check().is_err(), "{bad:?}");
        }
    }
}
