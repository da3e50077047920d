//! Shot noise: its events, and its part in other crossings.

use event_emulator::{Cause, PixelParameters};

use super::low_pass::low_pass;
use super::{PIXELS, Row, deviation, run_constant};

fn shot_noise() -> PixelParameters {
    let PixelParameters {
        shot_noise,
        dark_lux,
        ..
    } = PixelParameters::default();
    PixelParameters {
        shot_noise,
        dark_lux,
        ..low_pass()
    }
}

/// Rates of noise events by light.
pub fn noise_rate() -> Vec<Row> {
    [0.0, 1.0, 5.0, 20.0, 50.0]
        .map(|lux: f64| {
            let pixel = shot_noise();
            let seconds = 8_000.0 / PIXELS / pixel.noise_hz(lux);
            let (events, causes) = run_constant(&pixel, seconds, lux.max(1e-9));
            assert!(causes.iter().all(|cause| *cause == Cause::ShotNoise));
            Row {
                effect: "noise events",
                at: format!("{lux} lx"),
                unit: "Hz",
                stated: pixel.noise_hz(lux),
                measured: events.len() as f64 / PIXELS / seconds,
            }
        })
        .into()
}

/// Noise of the crossings of a steady rise, by leakage, in constant light.
pub fn noise_of_crossings() -> Vec<Row> {
    [5.0, 100.0, 1_000.0]
        .map(|lux| {
            let pixel = PixelParameters {
                leak_hz: 100.0,
                ..shot_noise()
            };
            let rise_per_s = pixel.leak_hz * pixel.threshold_on;
            let (events, causes) = run_constant(&pixel, 0.5, lux);
            // Events of noise between two others begin anew.
            let mut last = vec![None; PIXELS as usize];
            let mut intervals = Vec::new();
            for (event, cause) in events.iter().zip(&causes) {
                let last = &mut last[usize::from(event.y) * 64 + usize::from(event.x)];
                let before = last.replace((event.t_us, *cause));
                if let Some((t_us, _)) = before
                    && *cause != Cause::ShotNoise
                {
                    intervals.push((event.t_us - t_us) as f64 * 1e-6);
                }
            }
            Row {
                effect: "noise of crossings",
                at: format!("{lux} lx, rise of {rise_per_s} per second"),
                unit: "us",
                stated: 1e6 * pixel.noise_rms(lux) / rise_per_s,
                measured: 1e6 * deviation(&intervals),
            }
        })
        .into()
}
