//! The inputs: emulated scenes and recordings, cropped to whole windows.

use anyhow::Result;
use eecvs_bench::source::{Source, WINDOW_US};
use event_emulator::{PRESETS, SceneConfig};

use super::Effort;

/// Seed of the scenes.
const SEED: u64 = 1;

/// Emulates the nine scenes of the paper's table, cropped.
///
/// # Errors
/// Fails if a scene has no events.
pub fn scenes(effort: Effort) -> Result<Vec<Source>> {
    let scene = |preset| -> Result<Source> {
        let scene = Source::emulated(SceneConfig {
            duration_us: effort.scene_us,
            ..SceneConfig::new(preset, SEED)
        })?;
        Ok(crop(scene, effort.events))
    };
    PRESETS.into_iter().map(scene).collect()
}

/// Keeps the first windows of 32,768 us with at most `events` events in all, and the first one in any case.
#[must_use]
pub fn crop(source: Source, events: usize) -> Source {
    let start_us = source.start_us();
    let window = |t_us: u64| (t_us - start_us) / u64::from(WINDOW_US);
    let kept = match source.events.get(events) {
        None => source.events.len(),
        Some(next) => {
            let windows = window(next.t_us).max(1);
            source
                .events
                .partition_point(|event| window(event.t_us) < windows)
        }
    };
    let events = source.events.get(..kept).unwrap_or_default().into();
    Source { events, ..source }
}
