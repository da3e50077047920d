//! `eecvs bench --pipelines`: measures how many events per second go from recordings into every format that is written.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use eecvs_cli::output::{print, print_json};
use event_files::convert::{Conversion, convert};
use event_files::{FORMATS, Format, Reading};
use serde::Serialize;

/// Number of conversions; the fastest counts.
const REPETITIONS: usize = 3;

/// A recording, converted to a format.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Path of the recording, as it was given.
    pub file: String,
    /// Names of the recording's format and of that written.
    pub from: &'static str,
    pub to: &'static str,
    /// Number of events.
    pub events: u64,
    /// Bytes written.
    pub bytes: u64,
    /// Seconds from opening the recording to the end of the output; the least of all runs.
    pub seconds: f64,
    /// `events / seconds`.
    pub events_per_s: f64,
}

/// Converts each of `files` to each of the `formats`, all that are written if none is named, in a temporary folder, and
/// prints the speed. A format that cannot hold a recording's events is left out, with a notice.
///
/// # Errors
/// Fails if a format is not known, or a recording cannot be read to its end.
pub fn run(files: &[PathBuf], formats: &[String], quick: bool, json: bool) -> Result<()> {
    let written = || FORMATS.iter().filter(|format| format.create.is_some());
    let mut chosen: Vec<&Format> = Vec::new();
    for name in formats {
        let format = written().find(|format| format.name == name);
        chosen.push(format.with_context(|| {
            let names: Vec<&str> = written().map(|format| format.name).collect();
            format!("{name}: is no format that is written: {}", names.join(", "))
        })?);
    }
    if formats.is_empty() {
        chosen.extend(written());
    }
    let folder = tempfile::tempdir().context("a temporary folder cannot be created")?;
    let repetitions = if quick { 1 } else { REPETITIONS };
    let mut rows = Vec::new();
    for file in files {
        for format in &chosen {
            match measure(file, format, folder.path(), repetitions)? {
                Ok(row) => rows.push(row),
                Err(refused) => eecvs_cli::say!("eecvs: left out: {}: {refused:#}", format.name),
            }
        }
    }
    if json {
        return print_json(&rows);
    }
    let mut text = format!(
        "{:<8}{:<9}{:>12}{:>12}{:>13}  file\n",
        "from", "to", "events", "Mevents/s", "bits/event"
    );
    for row in rows {
        let rate = row.events_per_s / 1e6;
        let bits = row.bytes as f64 * 8.0 / row.events.max(1) as f64;
        text += &format!(
            "{:<8}{:<9}{:>12}{rate:>12.1}{bits:>13.2}  {}\n",
            row.from, row.to, row.events, row.file
        );
    }
    print(&text)
}

/// Returns the quickest of some conversions, or why the format cannot hold the events.
fn measure(
    file: &Path,
    format: &'static Format,
    folder: &Path,
    repetitions: usize,
) -> Result<Result<Row, event_files::Error>> {
    let from = event_files::open(file, None)?.format();
    let ending = format.endings.first().copied().unwrap_or_default();
    let output = folder.join(format!("out{ending}"));
    let conversion = Conversion {
        format: Some(format),
        ..Conversion::default()
    };
    let mut quickest: Option<Row> = None;
    for _ in 0..repetitions {
        let start = Instant::now();
        let converted = match convert(file, &output, &Reading::default(), &conversion) {
            Ok(converted) => converted,
            Err(error) if error.kind() == event_files::ErrorKind::CannotHold => {
                return Ok(Err(error));
            }
            Err(error) => return Err(error.into()),
        };
        // If the clock did not advance, the rate would be infinite, which JSON cannot represent.
        let seconds = start.elapsed().as_secs_f64().max(1e-9);
        if let Some(damage) = converted.damage {
            anyhow::bail!("{}: {damage}", file.display());
        }
        let bytes = std::fs::metadata(&output).map_or(0, |file| file.len());
        std::fs::remove_file(&output)
            .with_context(|| format!("{}: cannot be removed", output.display()))?;
        let events = converted.events_out;
        ensure!(
            quickest.as_ref().is_none_or(|row| row.events == events),
            "{}: changed while it was read: wait until it is complete",
            file.display()
        );
        if quickest.as_ref().is_none_or(|row| seconds < row.seconds) {
            quickest = Some(Row {
                file: file.display().to_string(),
                from,
                to: format.name,
                events,
                bytes,
                seconds,
                events_per_s: events as f64 / seconds,
            });
        }
    }
    quickest
        .map(Ok)
        .context("a format is converted to at least once")
}
