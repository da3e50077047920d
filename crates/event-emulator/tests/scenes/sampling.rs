//! What coarser sampling of the light changes, and how fast a scene is.

use event_emulator::{Effect, PRESETS, PixelParameters, Preset, emulate, emulate_with};
use event_types::stream::EventReader;
use event_types::{Event, Polarity};

use crate::whole;

/// A pixel without random noise, whose light is sampled at this change.
fn quiet(sample_change: f64) -> PixelParameters {
    let mut parameters = PixelParameters {
        sample_change,
        ..PixelParameters::default()
    };
    for effect in [Effect::ShotNoise, Effect::Jitter, Effect::Defects] {
        parameters.switch_off(effect);
    }
    parameters
}

/// How events with light sampled at one change differ from those with light sampled finely.
#[derive(Debug)]
struct Difference {
    samples_hz: f64,
    /// Share of pixels whose events have other polarities, or are more or fewer.
    others: f64,
    /// Differences of the other pixels' times in us, in order.
    apart_us: Vec<u64>,
}

impl Difference {
    fn quantile(&self, share: f64) -> u64 {
        self.apart_us[(self.apart_us.len() as f64 * share) as usize]
    }
}

fn differences(preset: Preset, duration_us: u64, changes: &[f64]) -> Vec<Difference> {
    let config = |preset| {
        let mut config = whole(preset, 1);
        config.duration_us = duration_us;
        config
    };
    let run = |change: f64| {
        let config = config(preset);
        let mut emulator = emulate_with(config, &quiet(change)).expect("a scene");
        let mut events: Vec<Event> = Vec::new();
        while emulator.read(&mut events).expect("events") > 0 {}
        let width = usize::from(config.sensor.width);
        let mut pixels: Vec<Vec<(u64, Polarity)>> =
            vec![Vec::new(); config.sensor.pixels() as usize];
        for e in &events {
            pixels[usize::from(e.y) * width + usize::from(e.x)].push((e.t_us, e.polarity));
        }
        let pixel_seconds = pixels.len() as f64 * duration_us as f64 * 1e-6;
        let samples_hz = emulator.samples().expect("model 2") as f64 / pixel_seconds;
        (pixels, samples_hz)
    };
    let (fine, _) = run(0.05);
    let differences = changes.iter().map(|change| {
        let (coarse, samples_hz) = run(*change);
        let (mut others, mut apart_us) = (0.0, Vec::new());
        for (a, b) in fine.iter().zip(&coarse) {
            if a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.1 == b.1) {
                apart_us.extend(a.iter().zip(b).map(|(a, b)| a.0.abs_diff(b.0)));
            } else {
                others += 1.0 / fine.len() as f64;
            }
        }
        apart_us.sort_unstable();
        Difference {
            samples_hz,
            others,
            apart_us,
        }
    });
    differences.collect()
}

#[test]
fn the_default_sampling_changes_few_events() {
    let default = PixelParameters::default().sample_change;
    let differences = differences(Preset::Motorcycle, 30_000, &[default]);
    let difference = &differences[0];
    let (half, most) = (difference.quantile(0.5), difference.quantile(0.9));
    assert!(half <= 30 && most <= 250, "{half} us, {most} us");
    assert!(difference.others < 0.01, "{}", difference.others);
}

/// Run with `cargo test --release -p event-emulator --test scenes print_sampling -- --ignored --nocapture`.
#[test]
#[ignore = "prints a table; run it in release"]
fn print_sampling() {
    let changes = [0.1, 0.25, 0.5, 0.75, 1.0, 2.0];
    println!(
        "| scene | sample_change | samples/s | other pixels | median | 90 % | 99 % |\n\
         |---|---|---|---|---|---|---|"
    );
    for preset in [Preset::Motorcycle, Preset::IndoorFlying] {
        for (change, difference) in changes.iter().zip(differences(preset, 200_000, &changes)) {
            println!(
                "| {} | {change} | {:.0} | {:.2} % | {} us | {} us | {} us |",
                preset.name(),
                difference.samples_hz,
                100.0 * difference.others,
                difference.quantile(0.5),
                difference.quantile(0.9),
                difference.quantile(0.99)
            );
        }
    }
}

/// Returns for how long this thread has run on a core: other programs do not count.
fn cpu_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("a Linux machine");
    let ns = text
        .split_whitespace()
        .next()
        .and_then(|ns| ns.parse::<f64>().ok());
    ns.expect("nanoseconds") * 1e-9
}

/// Run with `cargo test --release -p event-emulator --test scenes print_speed -- --ignored --nocapture`.
#[test]
#[ignore = "prints a table of speeds; run it in release"]
fn print_speed() {
    println!(
        "| scene | events | events/px/s | samples/s | CPU seconds per second |\n|---|---|---|---|---|"
    );
    for preset in PRESETS {
        let config = whole(preset, 1);
        let mut best = f64::MAX;
        let (mut count, mut samples) = (0, 0);
        for _ in 0..5 {
            let mut emulator = emulate(config).expect("a scene");
            let mut events: Vec<Event> = Vec::new();
            let begun = cpu_seconds();
            while emulator.read(&mut events).expect("events") > 0 {}
            best = best.min(cpu_seconds() - begun);
            (count, samples) = (events.len(), emulator.samples().expect("model 2"));
        }
        let pixels = f64::from(config.sensor.pixels());
        println!(
            "| {} | {count} | {:.2} | {:.0} | {best:.2} |",
            preset.name(),
            count as f64 / pixels,
            samples as f64 / pixels,
        );
    }
}
