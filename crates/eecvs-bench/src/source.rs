//! Recordings, whole and in memory, that studies are made of: read from files, or emulated scenes.

use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::{Event, Sensor};
use event_emulator::{Preset, SceneConfig};
use event_files::{BATCH_EVENTS, EventReader, Skipped};

/// T of every study, in us.
pub const WINDOW_US: u32 = 32_768;

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
        let mut scene = event_emulator::emulate(SceneConfig {
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
