//! Measurements of the effects.

mod low_pass;
mod noise;

use event_emulator::{Cause, Effect, PixelArray, PixelParameters};
use event_types::{Event, Polarity, Sensor};

use crate::light::Even;

/// What is stated of an effect, and what was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub effect: &'static str,
    /// Of which pixel and in which light.
    pub at: String,
    pub unit: &'static str,
    pub stated: f64,
    pub measured: f64,
}

/// Sensor of the measurements.
const SENSOR: Sensor = Sensor {
    width: 64,
    height: 64,
};
const PIXELS: f64 = 4_096.0;

/// Time of a step of light, in ns, and in us.
const STEP_NS: u64 = 10_000_000;
const STEP_US: f64 = 10_000.0;

pub fn all() -> Vec<Row> {
    let mut rows = Vec::new();
    rows.extend(contrast());
    rows.extend(spread());
    rows.push(toe());
    rows.extend(low_pass::corner());
    rows.extend(low_pass::latency());
    rows.extend(low_pass::first_events());
    rows.push(jitter());
    rows.extend(refractory());
    rows.extend(leak());
    rows.extend(noise::noise_rate());
    rows.extend(noise::noise_of_crossings());
    rows.extend(defects());
    rows
}

/// Runs a pixel array for some seconds and returns its events and their causes.
fn run<F: Fn(f64) -> f64 + Sync>(
    parameters: &PixelParameters,
    seconds: f64,
    bound: f64,
    switch_ns: u64,
    ln_lux: F,
) -> (Vec<Event>, Vec<Cause>) {
    let light = Even {
        sensor: SENSOR,
        ln_lux,
        bound,
        switch_ns,
    };
    run_light(parameters, seconds, light)
}

/// Runs a pixel array of any size.
fn run_light<F: Fn(f64) -> f64 + Sync>(
    parameters: &PixelParameters,
    seconds: f64,
    light: Even<F>,
) -> (Vec<Event>, Vec<Cause>) {
    let mut array = PixelArray::new(light, parameters, 1).expect("parameters in range");
    let (mut events, mut causes) = (Vec::new(), Vec::new());
    let until_us = (seconds * 1e6) as u64;
    while array.read(1 << 16, (0, until_us), &mut events, Some(&mut causes)) > 0 {}
    assert_eq!(events.len(), causes.len());
    (events, causes)
}

/// Runs pixels in constant light.
fn run_constant(parameters: &PixelParameters, seconds: f64, lux: f64) -> (Vec<Event>, Vec<Cause>) {
    run(parameters, seconds, 0.0, u64::MAX, |_| lux.ln())
}

/// Returns the events of pixels whose light rises steadily, or falls, by `per_s` natural log units per second.
fn run_ramp(parameters: &PixelParameters, seconds: f64, per_s: f64) -> Vec<Event> {
    run(parameters, seconds, per_s.abs(), u64::MAX, |t| {
        5.0 + per_s * t
    })
    .0
}

/// Returns each pixel's times in us, of events that are `wanted`.
fn times_of(events: &[Event], wanted: impl Fn(usize) -> bool) -> Vec<Vec<f64>> {
    let mut times = vec![Vec::new(); 256 * 256];
    for (i, event) in events.iter().enumerate() {
        if wanted(i) {
            times[usize::from(event.y) * 256 + usize::from(event.x)].push(event.t_us as f64);
        }
    }
    times
}

/// Returns each pixel's mean time between events, in seconds; pixels with fewer than two have none.
fn mean_intervals(events: &[Event]) -> Vec<f64> {
    let times = times_of(events, |_| true).into_iter();
    times
        .filter(|times| times.len() >= 2)
        .map(|times| (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64 * 1e-6)
        .collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / values.len() as f64).sqrt()
}

/// Change of light per event, on a ramp.
fn contrast() -> Vec<Row> {
    let ideal = PixelParameters::ideal();
    let measured = |per_s: f64| mean(&mean_intervals(&run_ramp(&ideal, 1.0, per_s))) * 10.0;
    vec![
        Row {
            effect: "contrast of an ON event",
            at: "ramp of 10 per second".to_owned(),
            unit: "ln",
            stated: ideal.threshold_on,
            measured: measured(10.0),
        },
        Row {
            effect: "contrast of an OFF event",
            at: "ramp of -10 per second".to_owned(),
            unit: "ln",
            stated: ideal.threshold_off,
            measured: measured(-10.0),
        },
    ]
}

/// Spread of the thresholds over the pixels, by their mean and standard deviation.
fn spread() -> Vec<Row> {
    [0.03, 0.08, 0.2]
        .map(|spread| {
            let pixel = PixelParameters {
                threshold_spread: spread,
                ..PixelParameters::ideal()
            };
            let thresholds = mean_intervals(&run_ramp(&pixel, 1.0, 10.0));
            Row {
                effect: "spread of the thresholds",
                at: format!("threshold_spread {spread}"),
                unit: "1",
                stated: spread,
                measured: deviation(&thresholds) / mean(&thresholds),
            }
        })
        .into()
}

/// Response to light that rises from a hundredth of the dark current to a hundred times as much.
fn toe() -> Row {
    let pixel = PixelParameters {
        dark_lux: 0.1,
        threshold_on: 0.01,
        threshold_off: 0.01,
        ..PixelParameters::ideal()
    };
    let rise = 1e4_f64.ln();
    let light = |t: f64| 1e-3_f64.ln() + rise * t.min(1.0);
    let (events, _) = run(&pixel, 1.1, rise, u64::MAX, light);
    Row {
        effect: "response across the toe",
        at: "0.001 to 10 lx, dark current 0.1 lx".to_owned(),
        unit: "ln",
        stated: (10.1_f64 / 0.101).ln(),
        measured: events.len() as f64 / PIXELS * pixel.threshold_on,
    }
}

/// Spread of the latency, without a low-pass.
fn jitter() -> Row {
    let pixel = PixelParameters {
        latency_us: 100.0,
        jitter_us: 40.0,
        ..PixelParameters::ideal()
    };
    let light = |t: f64| if t < 0.01 { 5.0 } else { 5.6 };
    let (events, _) = run(&pixel, 0.02, 0.0, STEP_NS, light);
    let times: Vec<f64> = events.iter().map(|event| event.t_us as f64).collect();
    Row {
        effect: "jitter of the latency",
        at: "latency 100 us, jitter 40 us".to_owned(),
        unit: "us",
        stated: pixel.jitter_us,
        measured: deviation(&times),
    }
}

/// Time between events beyond that of a ramp, and the shortest of all by noise.
fn refractory() -> Vec<Row> {
    let pixel = PixelParameters {
        refractory_us: 300.0,
        ..PixelParameters::ideal()
    };
    let intervals = mean_intervals(&run_ramp(&pixel, 0.02, 500.0));
    let noisy = PixelParameters {
        shot_noise: 0.2,
        ..low_pass::low_pass()
    };
    let noisy = PixelParameters {
        refractory_us: 300.0,
        ..noisy
    };
    let (events, _) = run_constant(&noisy, 1.0, 20.0);
    let times = times_of(&events, |_| true).into_iter();
    let shortest = times
        .flat_map(|times| {
            let pairs = times.windows(2).map(|pair| pair[1] - pair[0]);
            pairs.collect::<Vec<f64>>()
        })
        .fold(f64::MAX, f64::min);
    vec![
        Row {
            effect: "refractory time",
            at: "ramp of 500 per second".to_owned(),
            unit: "us",
            stated: 300.0,
            measured: 1e6 * (mean(&intervals) - pixel.threshold_on / 500.0),
        },
        Row {
            effect: "shortest time between events",
            at: format!("of {} noise events", events.len()),
            unit: "us",
            stated: 300.0,
            measured: shortest,
        },
    ]
}

/// Rates of leakage: by itself, when warm, in light; and its spread.
fn leak() -> Vec<Row> {
    let rate = |pixel: &PixelParameters, lux: f64| {
        let seconds = 20.0;
        run_constant(pixel, seconds, lux).0.len() as f64 / PIXELS / seconds
    };
    let cold = PixelParameters {
        leak_hz: 0.1,
        leak_spread: 0.2,
        ..PixelParameters::ideal()
    };
    let warm = PixelParameters {
        temperature_c: 45.0,
        ..cold
    };
    let lit = PixelParameters {
        leak_hz: 0.0,
        parasitic_hz_per_klux: 0.1,
        ..cold
    };
    let mut rows: Vec<Row> = [
        ("leakage", "25 °C", cold, 100.0),
        ("leakage", "45 °C", warm, 100.0),
        ("leakage by light", "5,000 lx", lit, 5_000.0),
    ]
    .map(|(effect, at, pixel, lux)| Row {
        effect,
        at: at.to_owned(),
        unit: "Hz",
        stated: pixel.leak_now_hz(lux),
        measured: rate(&pixel, lux),
    })
    .into();
    let fast = PixelParameters {
        leak_hz: 50.0,
        ..cold
    };
    let intervals = mean_intervals(&run_constant(&fast, 2.0, 100.0).0);
    let rates: Vec<f64> = intervals.iter().map(|interval| 1.0 / interval).collect();
    rows.push(Row {
        effect: "spread of the leakage",
        at: "leak_spread 0.2".to_owned(),
        unit: "1",
        stated: fast.leak_spread,
        measured: deviation(&rates) / mean(&rates),
    });
    rows
}

/// Shares and rates of pixels with defects.
fn defects() -> Vec<Row> {
    let mut pixel = PixelParameters {
        hot_share: 0.2,
        hot_hz: 20.0,
        dead_share: 0.3,
        stuck_share: 0.25,
        stuck_hz: 100.0,
        ..PixelParameters::default()
    };
    for effect in [Effect::ShotNoise, Effect::Leak, Effect::Refractory] {
        pixel.switch_off(effect);
    }
    // All that can fire does, by a rise of the light.
    let light = |t: f64| if t < 0.01 { 5.0 } else { 7.0 };
    // Pixels enough for shares: 5 % of a share of 0.2 are six standard deviations.
    let light = Even {
        sensor: Sensor {
            width: 256,
            height: 256,
        },
        ln_lux: light,
        bound: 0.0,
        switch_ns: STEP_NS,
    };
    let (events, causes) = run_light(&pixel, 2.0, light);
    let pixels = 65_536.0;
    let pixels_of = |cause: Option<Cause>| {
        let times = times_of(&events, |i| cause.is_none_or(|cause| causes[i] == cause));
        times.iter().filter(|times| !times.is_empty()).count() as f64
    };
    let count = |cause: Cause| causes.iter().filter(|other| **other == cause).count() as f64;
    let on = events
        .iter()
        .zip(&causes)
        .filter(|(event, cause)| **cause == Cause::Hot && event.polarity == Polarity::On)
        .count() as f64;
    let row = |effect, unit, stated, measured| Row {
        effect,
        at: "hot 0.2, dead 0.3, stuck 0.25".to_owned(),
        unit,
        stated,
        measured,
    };
    vec![
        row(
            "share of dead pixels",
            "1",
            0.3,
            1.0 - pixels_of(None) / pixels,
        ),
        row(
            "share of hot pixels",
            "1",
            0.2,
            pixels_of(Some(Cause::Hot)) / pixels,
        ),
        row(
            "mean rate of hot pixels",
            "Hz",
            20.0 * 3.25,
            count(Cause::Hot) / pixels_of(Some(Cause::Hot)) / 2.0,
        ),
        row(
            "share of ON in hot pixels",
            "1",
            0.9,
            on / count(Cause::Hot),
        ),
        row(
            "share of stuck pixels",
            "1",
            0.25,
            pixels_of(Some(Cause::Stuck)) / pixels,
        ),
        row(
            "rate of stuck pixels",
            "Hz",
            100.0,
            count(Cause::Stuck) / pixels_of(Some(Cause::Stuck)) / 2.0,
        ),
    ]
}
