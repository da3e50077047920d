//! `eecvs calibrate`: computes density thresholds from recordings.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use eecvs::calibrate::{CalibratedThresholds, Calibration};
use eecvs::exact_density::decimal;
use eecvs::thresholds_file::ThresholdsFile;
use eecvs_cli::options::{OutputOptions, ReadingOptions};
use eecvs_cli::output::{print, print_json};
use eecvs_cli::progress::Progress;
use event_emulator::{PRESETS, SceneConfig, emulate};
use event_files::EventReader;
use event_files::output::{self, Kind};
use serde_json::json;

/// Seed of the emulated scenes.
const SCENE_SEED: u64 = 1;

/// Compute the density thresholds of a set of recordings
///
/// Takes the 25th and the 75th percentile of events per pixel per second over all windows, including empty ones,
/// and writes them to a file for `eecvs encode --thresholds`.
#[derive(Debug, Args)]
pub struct Calibrate {
    /// Recordings of the calibration set, of any sensor size
    #[arg(required_unless_present = "scenes", value_name = "FILE")]
    files: Vec<PathBuf>,

    /// Add the nine emulated scenes from which the program's built-in thresholds were computed
    #[arg(long)]
    scenes: bool,

    /// Duration of a window in microseconds
    #[arg(long, value_name = "T", default_value = "32768")]
    window_us: NonZeroU32,

    #[command(flatten)]
    reading: ReadingOptions,

    /// Thresholds file to write, in TOML
    #[arg(short, long, value_name = "thresholds.toml")]
    output: PathBuf,

    #[command(flatten)]
    overwrite: OutputOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

impl Calibrate {
    /// Reads the recordings, writes the thresholds file and prints the result.
    ///
    /// # Errors
    /// Fails if a recording cannot be read to its end, no recording has events, or the output cannot be written;
    /// the message names the file.
    pub fn run(self) -> anyhow::Result<()> {
        let inputs = self.files.iter().map(PathBuf::as_path);
        self.overwrite.check(&self.output, Kind::Settings, inputs)?;
        let reading = self.reading.reading();
        let mut calibration = Calibration::new(self.window_us);
        let mut skipped: BTreeMap<&'static str, u64> = BTreeMap::new();
        let progress = Progress::new("events");
        let mut add = |recording: &mut dyn EventReader| -> anyhow::Result<()> {
            calibration.add(recording, &mut |events| progress.advance(events))?;
            for (kind, n) in recording.skipped().iter() {
                *skipped.entry(kind).or_default() += n;
            }
            Ok(())
        };
        for file in &self.files {
            add(event_files::open(file, &reading)?.as_mut())?;
        }
        if self.scenes {
            for preset in PRESETS {
                add(&mut emulate(SceneConfig::model_1(preset, SCENE_SEED))?)?;
            }
        }
        drop(progress);
        let thresholds = calibration
            .thresholds()
            .with_context(|| self.file_names().join(", "))?;
        let file = ThresholdsFile::new(&thresholds, self.file_names());
        output::write(&self.output, file.to_toml())?;
        if self.json {
            print_json(&self.json_object(&thresholds, &skipped))
        } else {
            print(&self.table(&thresholds, &skipped))
        }
    }

    fn file_names(&self) -> Vec<String> {
        let files = self.files.iter().map(|file| file.display().to_string());
        let scenes = PRESETS.iter().filter(|_| self.scenes);
        files
            .chain(scenes.map(|preset| format!("scene {}, seed {SCENE_SEED}", preset.name())))
            .collect()
    }

    fn json_object(
        &self,
        thresholds: &CalibratedThresholds,
        skipped: &BTreeMap<&'static str, u64>,
    ) -> serde_json::Value {
        json!({
            "tau_low": thresholds.tau_low_pico as f64 / 1e12,
            "tau_high": thresholds.tau_high_pico as f64 / 1e12,
            "tau_low_pico": thresholds.tau_low_pico,
            "tau_high_pico": thresholds.tau_high_pico,
            "window_us": thresholds.window_us,
            "windows": thresholds.windows,
            "windows_empty": thresholds.windows_empty,
            "events": thresholds.events,
            "events_late": thresholds.events_late,
            "skipped": skipped,
            "sources": self.file_names(),
            "output": self.output.display().to_string(),
        })
    }

    fn table(
        &self,
        thresholds: &CalibratedThresholds,
        skipped: &BTreeMap<&'static str, u64>,
    ) -> String {
        let mut rows = vec![
            (
                "tau_low",
                format!("{} events/pixel/s", decimal(thresholds.tau_low_pico)),
            ),
            (
                "tau_high",
                format!("{} events/pixel/s", decimal(thresholds.tau_high_pico)),
            ),
            ("window_us", thresholds.window_us.to_string()),
            ("windows", thresholds.windows.to_string()),
            ("windows_empty", thresholds.windows_empty.to_string()),
            ("events", thresholds.events.to_string()),
            ("events_late", thresholds.events_late.to_string()),
        ];
        rows.extend(
            skipped
                .iter()
                .map(|(kind, n)| ("skipped", format!("{n} {kind}"))),
        );
        rows.push(("written to", self.output.display().to_string()));
        rows.iter()
            .map(|(key, value)| format!("{key:<14} {value}\n"))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use clap::{Parser, error::ErrorKind};

    use super::*;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        calibrate: Calibrate,
    }

    fn parse(arguments: &str) -> Result<Calibrate, ErrorKind> {
        Command::try_parse_from(format!("calibrate {arguments}").split_whitespace())
            .map(|command| command.calibrate)
            .map_err(|error| error.kind())
    }

    #[test]
    fn flags() {
        let c = parse("a.raw b.raw -o t.toml").unwrap();
        assert_eq!(c.file_names(), ["a.raw", "b.raw"]);
        assert_eq!(
            (c.window_us.get(), c.reading.width, c.reading.height, c.json),
            (32_768, None, None, false)
        );
        let c = parse("a --window-us 1 --width 640 --height 2048 --json -o t").unwrap();
        assert_eq!(
            (c.window_us.get(), c.reading.width, c.reading.height),
            (1, Some(640), Some(2048))
        );
        assert!(c.json);
    }

    #[test]
    fn bad_usage() {
        for (arguments, kind) in [
            ("-o t.toml", ErrorKind::MissingRequiredArgument),
            ("a.raw", ErrorKind::MissingRequiredArgument),
            ("a.raw -o t --width 640", ErrorKind::MissingRequiredArgument),
            (
                "a.raw -o t --width 0 --height 1",
                ErrorKind::ValueValidation,
            ),
            (
                "a.raw -o t --width 1 --height 2049",
                ErrorKind::ValueValidation,
            ),
            ("a.raw -o t --window-us 0", ErrorKind::ValueValidation),
            (
                "a.raw -o t --window-us 4294967296",
                ErrorKind::ValueValidation,
            ),
        ] {
            assert_eq!(parse(arguments).unwrap_err(), kind, "{arguments}");
        }
    }

    #[test]
    fn a_file_that_cannot_be_read_is_named_and_nothing_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("t.toml");
        let command = Calibrate {
            files: vec![folder.path().join("missing.raw")],
            window_us: NonZeroU32::MIN,
            scenes: false,
            reading: ReadingOptions::default(),
            output: output.clone(),
            overwrite: OutputOptions::default(),
            json: false,
        };
        let message = format!("{:#}", command.run().unwrap_err());
        assert!(message.contains("missing.raw"), "{message}");
        assert!(!output.exists());
    }

    #[test]
    fn results_carry_the_thresholds_and_every_count() {
        let command = parse("a.raw -o t.toml").unwrap();
        let thresholds = CalibratedThresholds {
            tau_low_pico: 123_000_000_000,
            tau_high_pico: 10_100_000_000_001,
            window_us: command.window_us,
            windows: 329,
            windows_empty: 31,
            events: 1_218_618,
            events_late: 17,
        };
        let skipped = BTreeMap::from([("frames", 5)]);
        let object = command.json_object(&thresholds, &skipped);
        assert_eq!(object["tau_low"], 0.123);
        assert_eq!(object["tau_high_pico"], 10_100_000_000_001_u64);
        assert_eq!(object["windows_empty"], 31);
        assert_eq!(object["events_late"], 17);
        assert_eq!(object["skipped"]["frames"], 5);
        assert_eq!(object["window_us"], 32_768);
        let table = command.table(&thresholds, &skipped);
        for part in [
            "tau_high       10.100000000001 ",
            "skipped        5 frames",
            "t.toml",
        ] {
            assert!(table.contains(part), "{table}");
        }
    }
}
