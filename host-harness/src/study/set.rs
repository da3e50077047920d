//! Sets of sources on which a study is made, each calibrated by itself.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use eecvs::calibrate::Calibration;
use eecvs::thresholds_file::ThresholdsFile;
use eecvs_bench::source::{Source, WINDOW_US};
use eecvs_nostd::Thresholds;
use event_emulator::{PRESETS, SceneConfig};

use super::effort::Effort;
use crate::recordings::{self, LeftOut};

/// Seed of every scene.
pub const SEED: u64 = 1;
/// Name of the set of emulated scenes.
pub const SCENES: &str = "scenes";
/// Name of the set of recordings.
pub const RECORDINGS: &str = "recordings";

/// Sources that share thresholds.
#[derive(Debug, Clone)]
pub struct Set {
    /// [`SCENES`] or [`RECORDINGS`].
    pub name: &'static str,
    /// The sources, at least one.
    pub sources: Vec<Source>,
    /// Thresholds: the 25th and the 75th percentile of the densities of all windows.
    pub thresholds: Thresholds,
    /// The thresholds in events per pixel per second.
    pub tau: [f64; 2],
}

impl Set {
    /// Emulates the nine scenes of the paper's Table I.
    ///
    /// # Errors
    /// Never fails, since the scenes are fixed.
    pub fn scenes(effort: &Effort) -> Result<Self> {
        let sources = PRESETS.into_iter();
        let sources = sources.map(|preset| {
            Source::emulated(SceneConfig {
                duration_us: effort.scene_us,
                ..SceneConfig::new(preset, SEED)
            })
        });
        Self::new(SCENES, sources.collect::<Result<_>>()?)
    }

    /// Reads the start of every recording in files and folders, and lists what is left out; `None` if there are no
    /// recordings. Calls `progress` with the number read so far.
    ///
    /// # Errors
    /// Fails as [`recordings::read`] does.
    pub fn recordings(
        paths: &[PathBuf],
        effort: &Effort,
        progress: &dyn Fn(usize),
    ) -> Result<(Option<Self>, Vec<LeftOut>)> {
        let found = recordings::read(paths, progress, &mut |source| {
            start(source, effort.events_max)
        })?;
        let taken = found.taken.into_iter().map(|taken| Source {
            name: taken.name,
            ..taken.kept
        });
        let sources: Vec<Source> = taken.collect();
        let set = if sources.is_empty() {
            None
        } else {
            Some(Self::new(RECORDINGS, sources)?)
        };
        Ok((set, found.left_out))
    }

    fn new(name: &'static str, sources: Vec<Source>) -> Result<Self> {
        let window_us = NonZeroU32::new(WINDOW_US).context("a window of 0 us")?;
        let mut calibration = Calibration::new(window_us);
        for source in &sources {
            calibration.add(&mut source.reader(), &mut |_| ())?;
        }
        let file = ThresholdsFile::new(&calibration.thresholds()?, Vec::new());
        let tau = [file.tau_low_pico, file.tau_high_pico].map(|pico| pico as f64 * 1e-12);
        ensure!(!sources.is_empty(), "no sources");
        Ok(Self {
            name,
            sources,
            thresholds: file.thresholds()?,
            tau,
        })
    }
}

/// Keeps as many whole windows from the start as hold at most `events_max` events, and at least one.
fn start(source: Source, events_max: usize) -> Source {
    if source.events.len() <= events_max {
        return source;
    }
    let window = |t_us: u64| (t_us - source.start_us()) / u64::from(WINDOW_US);
    let Some(next) = source.events.get(events_max) else {
        return source;
    };
    let whole = window(next.t_us).max(1);
    let end = source
        .events
        .partition_point(|event| window(event.t_us) < whole);
    let events: Arc<[_]> = source.events.get(..end).unwrap_or_default().into();
    Source { events, ..source }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::{SENSOR, event};

    use super::*;

    #[test]
    fn a_start_is_of_whole_windows() {
        let times = [5, 10, 32_772, 32_773, 32_774, 70_000];
        let source = Source {
            name: "test".to_owned(),
            sensor: SENSOR,
            events: times.map(|t_us| event(t_us, 0, 0, true)).to_vec().into(),
        };
        let events = |most| start(source.clone(), most).events.len();
        assert_eq!(
            [0, 1, 2, 3, 4, 5, 6, 7].map(events),
            [3, 3, 3, 3, 3, 5, 6, 6]
        );
    }

    #[test]
    fn scenes_are_calibrated_on_themselves() {
        let effort = Effort {
            scene_us: 40_000,
            ..Effort::QUICK
        };
        let set = Set::scenes(&effort).unwrap();
        assert_eq!(set.sources.len(), 9);
        assert!(set.tau[0] < set.tau[1]);
    }
}
