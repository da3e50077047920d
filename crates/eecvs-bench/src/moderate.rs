//! The events and the window that a whole encoder is measured on, by time and by instructions.
//!
//! A moderate 346 x 260 scene; the window holds as many events as those of the paper's Table III.

use anyhow::{Result, ensure};
use eecvs_nostd::{
    Config, Encoder, Event, Mode, Push, Sensor, Thresholds, Transform, WindowConfig,
};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;

const PRESET: Preset = Preset::OutdoorWellLitBlur;
/// Sensor of the scene.
pub const SENSOR: Sensor = PRESET.sensor();
/// Events of the window.
pub const EVENTS: usize = 3200;
/// T: no event of the window comes later.
pub const WINDOW_US: u32 = 32_768;
/// The window lies some way into the scene.
const START_US: u64 = 100_000;

/// All events of the scene.
///
/// # Errors
/// None: the scene is fixed.
pub fn scene() -> Result<Vec<Event>> {
    let mut emulator = emulate(SceneConfig::new(PRESET, 1))?;
    let mut events = Vec::new();
    while emulator.read(&mut events)? > 0 {}
    Ok(events)
}

/// The window's events of those of [`scene`].
///
/// # Errors
/// Other events than those.
pub fn window(scene: &[Event]) -> Result<&[Event]> {
    let first = scene.partition_point(|event| event.t_us < START_US);
    let events = scene.get(first..first + EVENTS).unwrap_or_default();
    ensure!(
        events
            .first()
            .zip(events.last())
            .is_some_and(|(first, last)| {
                last.t_us.saturating_sub(first.t_us) < u64::from(WINDOW_US)
            }),
        "not the events of the scene"
    );
    Ok(events)
}

/// The encoder of the window.
#[must_use]
pub const fn config(transform: Transform, m: u8) -> Config {
    Config {
        transform: Some(transform),
        m,
        ..Config::new(
            WindowConfig::new(SENSOR, WINDOW_US),
            // Unused, since the transform is given.
            Thresholds::new(0, 0).unwrap(),
            Mode::Transform,
        )
    }
}

/// Pushes and encodes the window: what is measured. Returns the frame.
///
/// # Panics
/// Where the events are not one window, or `out` has no room for its frame.
pub fn encode<'o>(encoder: &mut Encoder<'_>, events: &[Event], out: &'o mut [u8]) -> &'o [u8] {
    for event in events {
        assert_eq!(encoder.push(*event), Push::Stored);
    }
    encoder.flush();
    let frame = encoder.next_frame(out).expect("there is room");
    assert_eq!(encoder.next_frame(out), Ok(None));
    &out[frame.expect("a frame").range]
}
