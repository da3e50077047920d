//! The photoreceptor: logarithmic with a linear toe, and a low-pass of two poles, the first of which rises with light.
//!
//! ```text
//! I = E + dark              equivalent illuminance of photocurrent and dark current, lx
//! x = ln I                  linear in E where E is well below the dark current
//! dv1/dt = w1 (x - v1)      w1 = 2 pi corner_hz_per_lux I
//! dv2/dt = w2 (v1 - v2)     w2 = 2 pi second_corner_hz
//! ```
//!
//! Between two samples x is a line and w1 constant, so that v1 and v2 are sums of a line and two exponentials.

mod response;

use core::f32::consts::TAU;

pub(crate) use response::{Response, State};

use crate::math;
use crate::parameters::PixelParameters;
use crate::wide::wide;

/// Smallest and largest first pole, in rad/s: 1 mHz and 1 MHz.
const POLE_RANGE: (f32, f32) = (TAU * 1e-3, TAU * 1e6);

/// A photoreceptor's constants.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Photoreceptor {
    /// Dark current as an illuminance, in lux.
    dark_lux: f32,
    /// First pole per lux, in rad/s.
    pole_per_lux: f32,
    /// Second pole, in rad/s.
    pub(crate) second_pole: f32,
}

impl Photoreceptor {
    pub(crate) fn new(parameters: &PixelParameters) -> Self {
        Self {
            dark_lux: parameters.dark_now_lux() as f32,
            pole_per_lux: TAU * parameters.corner_hz_per_lux as f32,
            second_pole: TAU * parameters.second_corner_hz as f32,
        }
    }

    /// Replaces the light of pixels, ln E, by the input ln I, and writes the current I in lux.
    pub(crate) fn receive(&self, light: &mut [f32], current: &mut [f32]) {
        let dark_lux = self.dark_lux;
        receive_wide(dark_lux, light, current);
    }

    /// Returns the first pole in rad/s at a current in lux, kept 2 % away from the second: the closed form divides by
    /// their difference.
    #[inline(always)]
    pub(crate) fn first_pole(&self, current: f32) -> f32 {
        let pole = self.pole_per_lux * current;
        let pole = if pole < POLE_RANGE.0 {
            POLE_RANGE.0
        } else {
            pole
        };
        let pole = if pole > POLE_RANGE.1 {
            POLE_RANGE.1
        } else {
            pole
        };
        let apart = pole - self.second_pole;
        let apart = if apart < 0.0 { -apart } else { apart };
        if apart < 0.02 * self.second_pole {
            0.98 * self.second_pole
        } else {
            pole
        }
    }
}

fn receive_wide(dark_lux: f32, light: &mut [f32], current: &mut [f32]) {
    wide!(receive, dark_lux: f32, light: &mut [f32], current: &mut [f32]);
}

#[inline(always)]
fn receive(dark_lux: f32, light: &mut [f32], current: &mut [f32]) {
    for (light, current) in light.iter_mut().zip(current) {
        // At least 1e-30 lx, so that darkness without dark current has a logarithm.
        *current = math::exp(*light) + dark_lux + 1e-30;
        *light = math::ln(*current);
    }
}
