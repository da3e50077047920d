//! The recordings on which skipping is measured, divided into windows.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::{Event, Sensor};
use event_emulator::{Preset, SceneConfig};
use event_files::EventReader;

/// T in us.
pub const WINDOW_US: u32 = 32_768;

/// Name of each recording, and its file below the folder of recordings.
const RECORDINGS: [(&str, &str); 5] = [
    (
        "davis346_building_dense",
        "davis346_building_dense/davis.aedat4",
    ),
    (
        "dvs128_walking_moderate",
        "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
    ),
    (
        "davis346_static_sparse",
        "davis346_static_sparse/davis346.aedat4",
    ),
    ("gen3_vga_dense_evt2", "gen3_vga_dense_evt2/evt2.raw"),
    ("imx636_sparse_evt3", "imx636_sparse_evt3/evt3.raw"),
];

/// Name and preset of the scenes that replace the recordings if none is present.
const SCENES: [(&str, Preset); 3] = [
    ("emulated_moderate", Preset::IndoorFlying),
    ("emulated_sparse", Preset::OutdoorDark),
    ("emulated_dense", Preset::Motorcycle),
];
const SCENE_US: u64 = 200_000;

/// The events of a recording or an emulated scene, divided into windows.
#[derive(Debug, Clone)]
pub struct Source {
    /// Name of the recording or scene.
    pub name: &'static str,
    /// The sensor's size; every event lies inside.
    pub sensor: Sensor,
    /// The windows that have events, one or more, in order of time.
    pub windows: Vec<Window>,
    /// Number of windows without events between the first and the last window.
    pub empty_windows: u64,
}

/// The events of one window.
#[derive(Debug, Clone)]
pub struct Window {
    /// Start t0 in us.
    pub start_us: u64,
    /// One or more events, in order of arrival.
    pub events: Vec<Event>,
}

/// Reads the recordings that are present in `folder`; missing ones are left out.
///
/// # Errors
/// Fails if a recording cannot be read or has no events.
pub fn recordings(folder: &Path) -> Result<Vec<Source>> {
    RECORDINGS
        .into_iter()
        .map(|(name, file)| (name, folder.join(file)))
        .filter(|(_, path)| path.exists())
        .map(|(name, path)| {
            let mut reader = event_files::open(&path, None)?;
            source(name, reader.as_mut()).with_context(|| path.display().to_string())
        })
        .collect()
}

/// Emulates the scenes that replace missing recordings.
///
/// # Errors
/// Passes on the emulator's errors, which these fixed scenes do not cause.
pub fn scenes() -> Result<Vec<Source>> {
    SCENES
        .into_iter()
        .map(|(name, preset)| {
            let mut scene = event_emulator::emulate(SceneConfig {
                duration_us: SCENE_US,
                ..SceneConfig::model_1(preset, 1)
            })?;
            source(name, &mut scene)
        })
        .collect()
}

/// Divides a recording into windows as the encoder does: aligned to the first event, without the events that are
/// older than the window in which they arrive.
fn source(name: &'static str, reader: &mut dyn EventReader) -> Result<Source> {
    let sensor = reader.sensor();
    let mut events = Vec::new();
    while reader.read(&mut events)? > 0 {}
    events.retain(|event: &Event| sensor.contains(event.x, event.y));
    let mut windows: Vec<Window> = Vec::new();
    let mut empty_windows = 0;
    for event in events {
        let last = windows.last_mut();
        let start_us = last.as_ref().map_or(event.t_us, |window| window.start_us);
        let Some(since_us) = event.t_us.checked_sub(start_us) else {
            continue;
        };
        let later = since_us / u64::from(WINDOW_US);
        match last {
            Some(window) if later == 0 => window.events.push(event),
            _ => {
                empty_windows += later.saturating_sub(1);
                windows.push(Window {
                    start_us: start_us + later * u64::from(WINDOW_US),
                    events: vec![event],
                });
            }
        }
    }
    ensure!(!windows.is_empty(), "no events");
    Ok(Source {
        name,
        sensor,
        windows,
        empty_windows,
    })
}
