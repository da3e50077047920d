//! The pixels of each scene in model 1.

use super::photoreceptor::PixelModel;
use crate::light::scene::preset::Preset;

/// How the pixels of a scene are emulated.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tuning {
    pub(super) step_us: u32,
    pub(super) pixel: PixelModel,
    /// Share of hot pixels, and their lowest rate in Hz.
    pub(super) hot: (f32, f32),
}

/// Pixels as in a DAVIS346 with its usual biases.
const PIXEL: PixelModel = PixelModel {
    threshold_on: 0.25,
    threshold_off: 0.27,
    mismatch: 0.08,
    refractory_us: 300,
    jitter_us: 60,
    leak_hz: 0.05,
    noise_hz: (0.01, 0.12),
    bandwidth_hz: 200.0,
};

/// Returns the pixels of a scene.
pub(super) fn tuning(preset: Preset) -> Tuning {
    let (pixel, hot) = match preset {
        Preset::IndoorDarkHdr | Preset::IndoorDarkBlur | Preset::OutdoorLowBrightness => {
            (PIXEL, (2e-4, 20.0))
        }
        Preset::IndoorHdrBlur | Preset::OutdoorWellLitBlur | Preset::IndoorFlying => {
            (PIXEL, (1e-4, 20.0))
        }
        Preset::OutdoorDarkBlur => {
            let noise_hz = (0.01, 0.2);
            (PixelModel { noise_hz, ..PIXEL }, (3e-4, 30.0))
        }
        Preset::Motorcycle => {
            let refractory_us = 200;
            let pixel = PixelModel {
                refractory_us,
                ..PIXEL
            };
            (pixel, (1e-4, 20.0))
        }
        Preset::OutdoorDark => {
            let pixel = PixelModel {
                leak_hz: 0.03,
                noise_hz: (0.01, 0.06),
                ..PIXEL
            };
            (pixel, (2e-4, 10.0))
        }
    };
    Tuning {
        step_us: 1_000,
        pixel,
        hot,
    }
}
