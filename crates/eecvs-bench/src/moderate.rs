//! The events and the window on which the whole encoder is measured, in time and in instructions.
//!
//! The scene is a moderate one of 346 x 260 pixels. The window holds as many events as the windows of the paper's
//! Table III.

use anyhow::{Result, ensure};
use eecvs_nostd::{
    Config, Encoder, Event, Mode, Push, Sensor, Thresholds, Transform, WindowConfig,
};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;

const PRESET: Preset = Preset::OutdoorWellLitBlur;
/// The scene's sensor.
pub const SENSOR: Sensor = PRESET.sensor();
/// Number of events in the window.
pub const EVENTS: usize = 3200;
/// T in us. The events span less than this.
pub const WINDOW_US: u32 = 32_768;
/// Time in us from which on the window's events are taken.
const START_US: u64 = 100_000;

/// Emulates the scene and returns all its events.
///
/// # Errors
/// Passes on the emulator's errors, which this fixed scene does not cause.
pub fn scene() -> Result<Vec<Event>> {
    let mut emulator = emulate(SceneConfig::model_1(PRESET, 1))?;
    let mut events = Vec::new();
    while emulator.read(&mut events)? > 0 {}
    Ok(events)
}

/// Returns the [`EVENTS`] events of the window, which are part of the events of [`scene`].
///
/// # Errors
/// Fails if `scene` does not contain as many events within one [`WINDOW_US`], and so is not that scene.
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

/// Returns the configuration of an encoder of the window, in mode transform.
#[must_use]
pub const fn config(transform: Transform, m: u8) -> Config {
    Config {
        transform: Some(transform),
        m,
        ..Config::new(
            WindowConfig::new(SENSOR, WINDOW_US),
            // Unused, because the transform is fixed.
            Thresholds::new(0, 0).unwrap(),
            Mode::Transform,
        )
    }
}

/// Pushes the events of one window, encodes them and returns the frame. This is what is measured.
///
/// # Panics
/// Panics if the events do not form one window, or if `out` has no room for its frame.
pub fn encode<'o>(encoder: &mut Encoder<'_>, events: &[Event], out: &'o mut [u8]) -> &'o [u8] {
    for event in events {
        assert_eq!(encoder.push(*event), Push::Stored);
    }
    encoder.flush();
    let frame = encoder.next_frame(out).expect("there is room");
    assert_eq!(encoder.next_frame(out), Ok(None));
    &out[frame.expect("a frame").range]
}
