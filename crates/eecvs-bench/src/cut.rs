//! The cuts on which the kernels are measured: events taken from recordings or from emulated scenes.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::{Event, Sensor};
use event_emulator::{Preset, SceneConfig};
use event_files::EventReader;

/// Maximum number of events in a cut, so that a microcontroller's window holds them all.
pub const EVENTS: usize = 8192;
/// T of the cuts with several windows, in us.
const WINDOW_US: u32 = 32_768;

/// Events of one window or of several, aligned to the first event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cut {
    /// Name, unique among the cuts of the same origin.
    pub name: &'static str,
    /// The sensor's size; every event lies inside.
    pub sensor: Sensor,
    /// T in us.
    pub window_us: u32,
    /// One to [`EVENTS`] events, in order of arrival.
    pub events: Vec<Event>,
}

/// Which events a cut takes.
#[derive(Debug, Clone, Copy)]
enum Take {
    /// One window of the [`EVENTS`] events that follow the first `skip`. Its T is their time span.
    OneWindow { skip: usize },
    /// The whole windows of [`WINDOW_US`] from the start that together hold at most [`EVENTS`].
    Windows,
}

/// Name, file below the folder of recordings, sensor, and what to take.
const RECORDINGS: [(&str, &str, [u16; 2], Take); 3] = [
    (
        "davis346",
        "davis346_building_dense/davis.aedat4",
        [320, 320],
        Take::OneWindow { skip: 50_000 },
    ),
    (
        "sparse",
        "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
        [128, 128],
        Take::Windows,
    ),
    (
        "dense",
        "gen3_vga_dense_evt2/evt2.raw",
        [640, 480],
        Take::OneWindow { skip: 100_000 },
    ),
];

/// Name, scene, sensor, and what to take.
const SCENES: [(&str, Preset, [u16; 2], Take); 3] = [
    (
        "moderate",
        Preset::IndoorFlying,
        [320, 320],
        Take::OneWindow { skip: 0 },
    ),
    ("sparse", Preset::IndoorDarkHdr, [128, 128], Take::Windows),
    (
        "dense",
        Preset::Motorcycle,
        [96, 72],
        Take::OneWindow { skip: 20_000 },
    ),
];

/// Returns the name of every cut of a recording, with the recording's file below the folder of recordings.
pub fn recordings() -> impl Iterator<Item = (&'static str, &'static str)> {
    RECORDINGS.iter().map(|(name, file, ..)| (*name, *file))
}

/// Reads the recordings in `folder` and returns all their cuts.
///
/// # Errors
/// Fails if a recording is missing, cannot be read, or has no whole window of at most [`EVENTS`] events.
pub fn of_recordings(folder: &Path) -> Result<Vec<Cut>> {
    recordings()
        .map(|(name, _)| of_recording(folder, name))
        .collect()
}

/// Reads the cut `name` from its recording in `folder`.
///
/// # Errors
/// As for [`of_recordings`]; also fails if no cut of [`recordings`] has this name.
pub fn of_recording(folder: &Path, name: &str) -> Result<Cut> {
    let (name, file, [width, height], take) = RECORDINGS
        .into_iter()
        .find(|(cut, ..)| *cut == name)
        .with_context(|| format!("{name}: no cut of a recording has this name"))?;
    let path = folder.join(file);
    let mut reader = event_files::open(&path, None)?;
    let sensor = Sensor { width, height };
    cut(name, reader.as_mut(), sensor, take).with_context(|| path.display().to_string())
}

/// Emulates the scenes and returns their cuts.
///
/// # Errors
/// Fails if a scene has no whole window of at most [`EVENTS`] events.
pub fn of_scenes() -> Result<Vec<Cut>> {
    SCENES
        .into_iter()
        .map(|(name, preset, [width, height], take)| {
            let sensor = Sensor { width, height };
            let mut scene = event_emulator::emulate(SceneConfig {
                sensor,
                ..SceneConfig::model_1(preset, 1)
            })?;
            cut(name, &mut scene, sensor, take).context(preset.name())
        })
        .collect()
}

fn cut(
    name: &'static str,
    reader: &mut dyn EventReader,
    sensor: Sensor,
    take: Take,
) -> Result<Cut> {
    let skip = match take {
        Take::OneWindow { skip } => skip,
        Take::Windows => 0,
    };
    let mut events: Vec<Event> = Vec::new();
    // One event more than a cut holds shows where the last whole window ends.
    while events.len() <= skip + EVENTS && reader.read(&mut events)? > 0 {
        events.retain(|event| sensor.contains(event.x, event.y));
    }
    events.drain(..skip.min(events.len()));
    let first = events.first().context("the recording has no events")?.t_us;
    let window_us = match take {
        Take::OneWindow { .. } => {
            events.truncate(EVENTS);
            let last = events.iter().map(|event| event.t_us).max();
            u32::try_from(
                last.map_or(0, |last| last.saturating_sub(first))
                    .saturating_add(1),
            )
            .context("its events span over an hour")?
        }
        Take::Windows => {
            if let Some(over) = events.get(EVENTS) {
                let within = over.t_us.saturating_sub(first) % u64::from(WINDOW_US);
                let end = over.t_us - within;
                events.retain(|event| event.t_us < end);
            }
            WINDOW_US
        }
    };
    ensure!(
        !events.is_empty() && events.len() <= EVENTS,
        "no whole window fits {EVENTS} events"
    );
    Ok(Cut {
        name,
        sensor,
        window_us,
        events,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_give_their_cuts() {
        let cuts = of_scenes().unwrap();
        assert_eq!(cuts.len(), SCENES.len());
        for cut in cuts {
            assert!(cut.events.len() > EVENTS / 2, "{}", cut.name);
            let sensor = cut.sensor;
            assert!(cut.events.iter().all(|e| sensor.contains(e.x, e.y)));
        }
    }

    #[test]
    fn what_is_absent_is_named() {
        let error = of_recordings(Path::new("/nowhere")).unwrap_err();
        assert!(format!("{error:#}").contains("davis.aedat4"), "{error:#}");
        assert!(of_recording(Path::new("."), "another").is_err());
    }
}
