//! Whole scenes.

use std::time::Instant;

use super::*;

/// Window of the densities, in us.
const WINDOW_US: u64 = 32_768;

/// What a scene looks like, window by window.
struct Seen {
    events: usize,
    on: usize,
    /// Events per pixel and second.
    density: f64,
    /// Events per pixel that has any, over windows of 32,768 us.
    per_active: f64,
    /// Share of active pixels with one event.
    single: f64,
    /// Densities of the whole windows.
    windows: Vec<f64>,
    seconds: f64,
}

fn all(config: SceneConfig) -> Vec<Event> {
    let mut emulator = emulate(config).unwrap();
    let mut events = Vec::new();
    while emulator.read(&mut events).unwrap() > 0 {}
    events
}

fn look(config: SceneConfig) -> Seen {
    let begun = Instant::now();
    let events = all(config);
    let seconds = begun.elapsed().as_secs_f64();
    let pixels = f64::from(config.sensor.pixels());
    let count_of = config.duration_us.div_ceil(WINDOW_US) as usize;
    let (mut active, mut single) = (0_usize, 0_usize);
    let mut windows = vec![0_usize; count_of];
    let mut counts = vec![0_u32; config.sensor.pixels() as usize];
    for window in events.chunk_by(|a, b| a.t_us / WINDOW_US == b.t_us / WINDOW_US) {
        counts.fill(0);
        for e in window {
            counts[usize::from(e.y) * usize::from(config.sensor.width) + usize::from(e.x)] += 1;
        }
        active += counts.iter().filter(|n| **n > 0).count();
        single += counts.iter().filter(|n| **n == 1).count();
        windows[(window[0].t_us / WINDOW_US) as usize] = window.len();
    }
    windows.truncate((config.duration_us / WINDOW_US) as usize);
    Seen {
        events: events.len(),
        on: events.iter().filter(|e| e.polarity == Polarity::On).count(),
        density: events.len() as f64 / pixels / (config.duration_us as f64 * 1e-6),
        per_active: events.len() as f64 / active as f64,
        single: single as f64 / active as f64,
        windows: windows
            .iter()
            .map(|n| *n as f64 / pixels / (WINDOW_US as f64 * 1e-6))
            .collect(),
        seconds,
    }
}

/// `cargo test --release -p host-harness measure_presets -- --ignored --nocapture`
#[test]
#[ignore = "prints a table of densities and speeds; run it in release"]
fn measure_presets() {
    println!(
        "preset                  events     on  ev/px/s  window min..max  ev/active  single  \
         Mev/s  sim s/s"
    );
    for preset in PRESETS {
        let config = SceneConfig::new(preset, 1);
        let mut seen = look(config);
        for _ in 0..4 {
            seen.seconds = seen.seconds.min(look(config).seconds);
        }
        let least = seen.windows.iter().copied().fold(f64::MAX, f64::min);
        let most = seen.windows.iter().copied().fold(0.0, f64::max);
        println!(
            "{:22} {:>8} {:>5.0} % {:>7.2} {:>7.2}..{:<7.2} {:>8.2} {:>6.0} % {:>6.2} {:>7.2}",
            preset.name(),
            seen.events,
            100.0 * seen.on as f64 / seen.events as f64,
            seen.density,
            least,
            most,
            seen.per_active,
            100.0 * seen.single,
            seen.events as f64 / seen.seconds * 1e-6,
            config.duration_us as f64 * 1e-6 / seen.seconds,
        );
    }
}
