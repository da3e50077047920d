//! The photoreceptor's low-pass: its corner, and the delays that it causes.

use std::f64::consts::TAU;

use event_emulator::PixelParameters;

use super::{Row, STEP_NS, STEP_US, mean, run, times_of};

/// Returns the events after a step of light by e^2 to `lux`, of pixels with small thresholds: their times sample the
/// photoreceptor's response to an impulse.
fn impulse(parameters: PixelParameters, lux: f64) -> Vec<f64> {
    let pixel = PixelParameters {
        threshold_on: 0.01,
        threshold_off: 0.01,
        ..parameters
    };
    let light = |t: f64| lux.ln() - if t < 0.01 { 2.0 } else { 0.0 };
    let (events, _) = run(&pixel, 1.0, 0.0, STEP_NS, light);
    let after = events.iter().map(|event| event.t_us as f64 - STEP_US);
    after.collect()
}

pub fn low_pass() -> PixelParameters {
    let PixelParameters {
        corner_hz_per_lux,
        second_corner_hz,
        ..
    } = PixelParameters::default();
    PixelParameters {
        corner_hz_per_lux,
        second_corner_hz,
        ..PixelParameters::ideal()
    }
}

/// Frequency at which the Fourier transform of the response to an impulse is lower by 3 dB.
pub fn corner() -> Vec<Row> {
    [3.0, 30.0, 300.0, 3_000.0]
        .map(|lux| {
            let pixel = low_pass();
            let times = impulse(pixel, lux);
            let power = |hz: f64| {
                let turn = TAU * hz * 1e-6;
                let re = times.iter().map(|t| (turn * t).cos()).sum::<f64>();
                let im = times.iter().map(|t| (turn * t).sin()).sum::<f64>();
                (re * re + im * im) / (times.len() as f64).powi(2)
            };
            let (mut low, mut high) = (0.1_f64, 3_000.0_f64);
            for _ in 0..12 {
                let middle = (low * high).sqrt();
                if power(middle) > 0.5 {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            Row {
                effect: "corner of the photoreceptor",
                at: format!("{lux} lx"),
                unit: "Hz",
                stated: pixel.corner_hz(lux),
                measured: (low * high).sqrt(),
            }
        })
        .into()
}

/// Mean delay of the events after a step of light.
pub fn latency() -> Vec<Row> {
    [3.0, 30.0, 300.0]
        .map(|lux| {
            let pixel = PixelParameters {
                latency_us: 15.0,
                ..low_pass()
            };
            let first = pixel.corner_hz_per_lux * lux;
            Row {
                effect: "mean latency after a step",
                at: format!("{lux} lx"),
                unit: "us",
                stated: 15.0 + 1e6 / (TAU * first) + 1e6 / (TAU * pixel.second_corner_hz),
                measured: mean(&impulse(pixel, lux)),
            }
        })
        .into()
}

/// Mean time from a step of light to the first event, by the step's contrast.
pub fn first_events() -> Vec<Row> {
    [0.6, 1.2, 2.4]
        .map(|contrast: f64| {
            let pixel = low_pass();
            let lux = 30.0_f64;
            let light = |t: f64| lux.ln() - if t < 0.01 { contrast } else { 0.0 };
            let (events, _) = run(&pixel, 1.0, 0.0, STEP_NS, light);
            let times = times_of(&events, |_| true);
            let first: Vec<f64> = times
                .iter()
                .flat_map(|times| times.first())
                .copied()
                .collect();
            // The output at the step is anywhere between the thresholds: what is missing is even from 0 to their sum.
            let poles = (
                TAU * pixel.corner_hz_per_lux * lux,
                TAU * pixel.second_corner_hz,
            );
            let missing = (pixel.threshold_on + pixel.threshold_off) / contrast;
            let parts = 1_000;
            let stated: f64 = (0..parts)
                .map(|part| (f64::from(part) + 0.5) / f64::from(parts) * missing)
                .map(|share| rise_time(share, poles))
                .sum();
            Row {
                effect: "time to the first event",
                at: format!("{lux} lx, step of {contrast}"),
                unit: "us",
                stated: 1e6 * stated / f64::from(parts),
                measured: mean(&first) - STEP_US,
            }
        })
        .into()
}

/// Returns after how many seconds two poles' response to a step of 1 is `share`.
fn rise_time(share: f64, (w1, w2): (f64, f64)) -> f64 {
    let response = |t: f64| 1.0 - (w2 * (-w1 * t).exp() - w1 * (-w2 * t).exp()) / (w2 - w1);
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if response(middle) < share {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}
