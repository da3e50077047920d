//! Recordings, whole and in memory, that studies are made of: files of some folders, or emulated scenes.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::{Event, Sensor};

use crate::formats::{self, BATCH_EVENTS, EventReader, Skipped};
use crate::scene::{self, Preset, SceneConfig};

/// T of every study, in us.
pub const WINDOW_US: u32 = 32_768;

/// Endings that a folder is searched for: what sensors write. Arrays and text in it are most often the
/// same events once more.
const ENDINGS: [&str; 4] = ["aedat4", "aedat", "raw", "evt2"];

/// Endings that count where a folder has none of [`ENDINGS`]: MVSEC and its like are published so. Beside
/// a sensor's own files they are most often the same events once more.
const ARCHIVES: [&str; 2] = ["h5", "hdf5"];

/// In their place where no recording is there: name, scene.
const SCENES: [(&str, Preset); 3] = [
    ("emulated_moderate", Preset::IndoorFlying),
    ("emulated_sparse", Preset::OutdoorDark),
    ("emulated_dense", Preset::Motorcycle),
];

/// A recording.
#[derive(Debug, Clone)]
pub struct Source {
    /// Its name.
    pub name: String,
    /// Every event is inside.
    pub sensor: Sensor,
    /// One or more, in order of time; those of one time as the file has them.
    pub events: Arc<[Event]>,
}

impl Source {
    /// Every event of `reader` inside of the sensor. Readers of windows take events that are late for
    /// theirs as lost, so all are sorted by time first.
    ///
    /// # Errors
    /// A recording that cannot be read, or has no events.
    pub fn new(name: &str, reader: &mut dyn EventReader) -> Result<Self> {
        let sensor = reader.sensor();
        let mut events = Vec::new();
        while reader.read(&mut events)? > 0 {}
        events.retain(|event: &Event| sensor.contains(event.x, event.y));
        ensure!(!events.is_empty(), "no events");
        events.sort_by_key(|event| event.t_us);
        Ok(Self {
            name: name.to_owned(),
            sensor,
            events: events.into(),
        })
    }

    /// An emulated scene of `duration_us`, named as its preset.
    ///
    /// # Errors
    /// A scene without events.
    pub fn scene(preset: Preset, seed: u64, duration_us: u64) -> Result<Self> {
        let mut scene = scene::emulate(SceneConfig {
            duration_us,
            ..SceneConfig::new(preset, seed)
        })?;
        Self::new(preset.name(), &mut scene).with_context(|| format!("the scene {}", preset.name()))
    }

    /// Its time of 0: where the first window begins.
    #[must_use]
    pub fn start_us(&self) -> u64 {
        self.events.first().map_or(0, |event| event.t_us)
    }

    /// Reads it from its first event.
    #[must_use]
    pub fn reader(&self) -> Memory {
        Memory::new(self.sensor, Arc::clone(&self.events))
    }
}

/// Emulated scenes of `duration_us`.
///
/// # Errors
/// None: they are fixed.
pub fn scenes(duration_us: u64) -> Result<Vec<Source>> {
    SCENES
        .into_iter()
        .map(|(name, preset)| {
            let scene = Source::scene(preset, 1, duration_us)?;
            Ok(Source {
                name: name.to_owned(),
                ..scene
            })
        })
        .collect()
}

/// The recordings of some paths, sorted by their paths; a folder stands for the recordings in it and
/// in its folders, without those below, and for its HDF5 files if there are no other recordings.
///
/// # Errors
/// A folder that cannot be listed.
pub fn files(paths: &[PathBuf]) -> Result<Vec<(String, PathBuf)>> {
    let mut found = Vec::new();
    for path in paths {
        if !path.is_dir() {
            found.push((stem(path), path.clone()));
            continue;
        }
        let sensors = recordings_in(path, &ENDINGS)?;
        found.extend(if sensors.is_empty() {
            recordings_in(path, &ARCHIVES)?
        } else {
            sensors
        });
    }
    Ok(found)
}

/// The files of some endings in a folder and in its folders.
fn recordings_in(path: &Path, endings: &[&str]) -> Result<Vec<(String, PathBuf)>> {
    let mut found = Vec::new();
    for entry in entries(path)? {
        if !entry.is_dir() {
            found.extend(has_ending(&entry, endings).then(|| (stem(&entry), entry)));
            continue;
        }
        let mut inside = entries(&entry)?;
        inside.retain(|file| !file.is_dir() && has_ending(file, endings));
        let folder = entry.file_name().unwrap_or_default().to_string_lossy();
        let is_alone = inside.len() == 1;
        found.extend(inside.into_iter().map(|file| {
            let name = if is_alone {
                folder.to_string()
            } else {
                format!("{folder}/{}", stem(&file))
            };
            (name, file)
        }));
    }
    Ok(found)
}

/// Reads one of [`files`].
///
/// # Errors
/// As [`Source::new`]; the message names the file.
pub fn recording(name: &str, path: &Path) -> Result<Source> {
    let mut reader = formats::open(path, None)?;
    Source::new(name, reader.as_mut()).with_context(|| path.display().to_string())
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let listed = || -> std::io::Result<Vec<PathBuf>> {
        let mut entries: Vec<_> = std::fs::read_dir(folder)?
            .map(|entry| entry.map(|entry| entry.path()))
            .collect::<Result<_, _>>()?;
        entries.sort();
        Ok(entries)
    };
    listed().with_context(|| format!("{}: cannot be listed", folder.display()))
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
    endings.iter().any(|known| ending == *known)
}

fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.split('.').next().unwrap_or_default().to_owned()
}

/// Events in memory as a recording.
pub struct Memory {
    sensor: Sensor,
    events: Arc<[Event]>,
    next: usize,
    skipped: Skipped,
}

impl Memory {
    /// Reads `events` from the first.
    #[must_use]
    pub fn new(sensor: Sensor, events: Arc<[Event]>) -> Self {
        Self {
            sensor,
            events,
            next: 0,
            skipped: Skipped::default(),
        }
    }
}

impl EventReader for Memory {
    fn format(&self) -> &'static str {
        "memory"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let rest = self.events.get(self.next..).unwrap_or_default();
        let batch = rest.get(..BATCH_EVENTS).unwrap_or(rest);
        events.extend_from_slice(batch);
        self.next += batch.len();
        Ok(batch.len())
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_searched_two_levels_deep() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["one", "two", "one/deeper"] {
            std::fs::create_dir(at(name)).unwrap();
        }
        for name in [
            "b.aedat4",
            "one/x.raw",
            "one/README.md",
            "one/deeper/y.raw",
            "two/p.aedat",
            "two/q.evt2.raw",
            "two/q.h5",
            "notes.txt",
        ] {
            std::fs::write(at(name), "").unwrap();
        }
        let found = files(&[folder.path().to_owned(), at("notes.txt")]).unwrap();
        let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["b", "one", "two/p", "two/q", "notes"]);
        assert_eq!(found[1].1, at("one/x.raw"));
    }

    #[test]
    fn hdf5_files_count_where_nothing_else_is() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("mvsec")).unwrap();
        for name in ["mvsec/a_data.hdf5", "mvsec/b_data.hdf5", "c.h5", "d.npz"] {
            std::fs::write(at(name), "").unwrap();
        }
        let names = || {
            let found = files(&[folder.path().to_owned()]).unwrap();
            found.into_iter().map(|(name, _)| name).collect::<Vec<_>>()
        };
        assert_eq!(names(), ["c", "mvsec/a_data", "mvsec/b_data"]);
        std::fs::write(at("camera.raw"), "").unwrap();
        assert_eq!(names(), ["camera"]);
        let named = files(&[at("c.h5")]).unwrap();
        assert_eq!(named, [("c".to_owned(), at("c.h5"))]);
    }

    #[test]
    fn a_source_reads_back_in_order_of_time() {
        let mut scene = scenes(20_000).unwrap();
        let source = scene.remove(0);
        let mut again = Source::new("again", &mut source.reader()).unwrap();
        assert_eq!(again.events, source.events);
        let reversed: Vec<Event> = source.events.iter().rev().copied().collect();
        again = Source::new("again", &mut Memory::new(source.sensor, reversed.into())).unwrap();
        assert!(again.events.is_sorted_by_key(|event| event.t_us));
        assert_eq!(again.start_us(), source.start_us());
    }
}
