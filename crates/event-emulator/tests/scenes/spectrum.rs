//! Spectra of the rate of events: no line of the sampling shows.

use event_emulator::{Model, PRESETS, Preset, SceneConfig, emulate};
use event_types::stream::EventReader;
use event_types::{Event, Sensor};

use crate::whole;

/// Bins of time that events are counted in, in us: frequencies far below 50 kHz are seen as they are.
const BIN_US: u64 = 10;

/// Largest power of a line, as a multiple of the median around it. The power of a bin of mere noise has an exponential
/// distribution: above 30 times its median it is once in 10^9 bins.
const LINE_MAX: f64 = 30.0;

/// Returns the power of the rate of events at `hz`, by a Fourier transform of the counts.
fn power(counts: &[f64], hz: f64) -> f64 {
    let turn = std::f64::consts::TAU * hz * BIN_US as f64 * 1e-6;
    let (sin, cos) = turn.sin_cos();
    let (mut re, mut im, mut c, mut s) = (0.0, 0.0, 1.0, 0.0);
    for count in counts {
        re += count * c;
        im += count * s;
        (c, s) = (c * cos - s * sin, c * sin + s * cos);
    }
    re * re + im * im
}

/// Returns the power at a frequency, as a multiple of the median of the 80 bins of 1 Hz around it.
fn line(counts: &[f64], hz: f64) -> f64 {
    let mut around: Vec<f64> = (-42..=42_i32)
        .filter(|i| i.abs() > 2)
        .map(|i| power(counts, hz + f64::from(i)))
        .collect();
    around.sort_by(f64::total_cmp);
    power(counts, hz) / around[around.len() / 2]
}

/// Returns the frequencies at which a line of the sampling might be, and the lines there: the whole milliseconds of
/// model 1, and the mean rate of the samples of model 2.
fn lines(config: SceneConfig) -> Vec<(f64, f64)> {
    let mut emulator = emulate(config).expect("a scene");
    let mut events: Vec<Event> = Vec::new();
    while emulator.read(&mut events).expect("events") > 0 {}
    let mut counts = vec![0.0; (config.duration_us / BIN_US) as usize];
    for event in &events {
        counts[(event.t_us / BIN_US) as usize] += 1.0;
    }
    let pixel_seconds = f64::from(config.sensor.pixels()) * config.duration_us as f64 * 1e-6;
    let sampled_hz = emulator.samples().map(|samples| {
        // A scene's lamps have lines of their own, at multiples of 100 and 180 Hz.
        (samples as f64 / pixel_seconds / 20.0).floor() * 20.0 + 11.0
    });
    let hz = [1_000.0, 2_000.0, 3_000.0].into_iter().chain(sampled_hz);
    hz.map(|hz| (hz, line(&counts, hz))).collect()
}

fn largest(lines: &[(f64, f64)]) -> f64 {
    lines.iter().fold(0.0, |most, (_, line)| line.max(most))
}

fn check(config: SceneConfig) -> f64 {
    let lines = lines(config);
    for (hz, line) in &lines {
        let name = config.preset.name();
        assert!(
            *line <= LINE_MAX,
            "{name} seed {}: {line} at {hz} Hz",
            config.seed
        );
    }
    largest(&lines)
}

#[test]
fn no_line_of_the_sampling_shows_in_small_scenes() {
    for preset in [Preset::Motorcycle, Preset::IndoorHdrBlur] {
        check(SceneConfig {
            sensor: Sensor {
                width: 173,
                height: 130,
            },
            ..whole(preset, 1)
        });
    }
}

/// Run with `cargo test --release -p event-emulator --test scenes all_scenes -- --ignored --nocapture`.
#[test]
#[ignore = "90 scenes of a second; run it in release"]
fn no_line_of_the_sampling_shows_in_all_scenes_and_ten_seeds() {
    println!("| scene | model 1 | model 2 |\n|---|---|---|");
    for preset in PRESETS {
        let of = |model: Model, line: fn(SceneConfig) -> f64| {
            let seeds = 1..=10;
            let config = |seed| SceneConfig {
                model,
                ..whole(preset, seed)
            };
            seeds.map(|seed| line(config(seed))).fold(0.0, f64::max)
        };
        let steps = of(Model::Steps, |config| largest(&lines(config)));
        let physical = of(Model::Physical, check);
        println!("| {} | {steps:.1} | {physical:.1} |", preset.name());
    }
}
