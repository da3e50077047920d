//! The recordings used by the studies, held whole in memory: read from files, or emulated scenes.

use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::{Event, Sensor};
use event_emulator::{Preset, SceneConfig};
use event_files::{BATCH_EVENTS, EventReader, Skipped};

/// T in us, the same in every study.
pub const WINDOW_US: u32 = 32_768;

/// Name and preset of the scenes that replace the recordings if none is present.
const SCENES: [(&str, Preset); 3] = [
    ("emulated_moderate", Preset::IndoorFlying),
    ("emulated_sparse", Preset::OutdoorDark),
    ("emulated_dense", Preset::Motorcycle),
];

/// A recording or an emulated scene, whole in memory.
#[derive(Debug, Clone)]
pub struct Source {
    /// Name of the recording or scene.
    pub name: String,
    /// The sensor's size; every event lies inside.
    pub sensor: Sensor,
    /// One or more events in order of time. Events of equal time keep their order in the file.
    pub events: Arc<[Event]>,
}

impl Source {
    /// Reads all events of `reader` that lie inside its sensor, and sorts them by time. Without sorting, an event
    /// that came too late for its window would be lost.
    ///
    /// # Errors
    /// Fails if `reader` fails or has no events inside the sensor.
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

    /// Emulates a scene of `duration_us` in model 1, whose events never change, named after its preset.
    ///
    /// # Errors
    /// As [`Self::emulated`].
    pub fn scene(preset: Preset, seed: u64, duration_us: u64) -> Result<Self> {
        Self::emulated(SceneConfig {
            duration_us,
            ..SceneConfig::model_1(preset, seed)
        })
    }

    /// Emulates a scene, which is named after its preset.
    ///
    /// # Errors
    /// Fails if the scene cannot be emulated or has no events.
    pub fn emulated(config: SceneConfig) -> Result<Self> {
        let name = config.preset.name();
        let mut scene = event_emulator::emulate(config)?;
        Self::new(name, &mut scene).with_context(|| format!("the scene {name}"))
    }

    /// Returns the time of the first event, at which the first window begins.
    #[must_use]
    pub fn start_us(&self) -> u64 {
        self.events.first().map_or(0, |event| event.t_us)
    }

    /// Returns a reader of all events, from the first on.
    #[must_use]
    pub fn reader(&self) -> Memory {
        Memory::new(self.sensor, Arc::clone(&self.events))
    }
}

/// Emulates the scenes that replace missing recordings, each `duration_us` long.
///
/// # Errors
/// Fails if a scene has no events within `duration_us`.
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

/// Reads events from memory as if from a recording.
pub struct Memory {
    sensor: Sensor,
    events: Arc<[Event]>,
    next: usize,
    skipped: Skipped,
}

impl Memory {
    /// Creates a reader of `events`, from the first on.
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

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
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
