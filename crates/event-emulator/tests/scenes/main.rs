//! The scenes in model 2: no line of the sampling in the spectrum, lamps at their own times, the same events whoever
//! computes them.

mod bounds;
mod lamps;
mod same;
mod sampling;
mod spectrum;

use event_emulator::{Model, PixelParameters, Preset, SceneConfig, emulate_with};
use event_types::stream::EventReader;
use event_types::{Event, Sensor};

/// A small scene of model 2.
fn small(preset: Preset, seed: u64) -> SceneConfig {
    SceneConfig {
        sensor: Sensor {
            width: 100,
            height: 70,
        },
        duration_us: 100_000,
        ..whole(preset, seed)
    }
}

/// A scene of model 2.
fn whole(preset: Preset, seed: u64) -> SceneConfig {
    SceneConfig {
        model: Model::Physical,
        ..SceneConfig::new(preset, seed)
    }
}

fn events_with(config: SceneConfig, parameters: &PixelParameters) -> Vec<Event> {
    let mut emulator = emulate_with(config, parameters).expect("a scene");
    let mut events = Vec::new();
    while emulator.read(&mut events).expect("events") > 0 {}
    events
}

fn events_of(config: SceneConfig) -> Vec<Event> {
    events_with(config, &PixelParameters::default())
}
