//! `eecvs bench --read`: measures how many events per second are read from recordings.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use eecvs_cli::output::{print, print_json};
use event_files::BATCH_EVENTS;
use serde::Serialize;

/// Least number of times that each file is read; the fastest run counts.
const REPETITIONS: usize = 7;

/// Least time for which each file is read again and again: the first milliseconds are slower than all later ones.
const DURATION: Duration = Duration::from_millis(500);

/// Reading speed of one recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Path, as it was given.
    pub file: String,
    /// Name of the format.
    pub format: &'static str,
    /// Number of events.
    pub events: u64,
    /// Seconds from opening to the end of the file; the least of all runs.
    pub seconds: f64,
    /// `events / seconds`.
    pub events_per_s: f64,
}

/// Reads each of `files` on one thread, one batch of events at a time, and prints the speed.
///
/// # Errors
/// Fails if a recording cannot be read to its end, or yields another number of events in a later run.
pub fn run(files: &[PathBuf], quick: bool, json: bool) -> Result<()> {
    let (repetitions, duration) = if quick {
        (1, Duration::ZERO)
    } else {
        (REPETITIONS, DURATION)
    };
    let rows: Result<Vec<Row>> = files
        .iter()
        .map(|file| measure(file, repetitions, duration))
        .collect();
    let rows = rows?;
    if json {
        return print_json(&rows);
    }
    let mut text = format!("{:<8}{:>12}{:>12}  file\n", "format", "events", "Mevents/s");
    for row in rows {
        let rate = row.events_per_s / 1e6;
        text += &format!(
            "{:<8}{:>12}{rate:>12.1}  {}\n",
            row.format, row.events, row.file
        );
    }
    print(&text)
}

fn measure(file: &Path, repetitions: usize, duration: Duration) -> Result<Row> {
    let start = Instant::now();
    let mut quickest = read(file)?;
    let mut readings = 1;
    while readings < repetitions || start.elapsed() < duration {
        let row = read(file)?;
        ensure!(
            quickest.events == row.events,
            "{}: changed while it was read: wait until it is complete",
            file.display()
        );
        if row.seconds < quickest.seconds {
            quickest = row;
        }
        readings += 1;
    }
    Ok(quickest)
}

fn read(file: &Path) -> Result<Row> {
    let start = Instant::now();
    let mut reader = event_files::open(file, None)?;
    let mut batch = Vec::with_capacity(BATCH_EVENTS);
    let mut events = 0;
    loop {
        batch.clear();
        let read = reader.read(&mut batch)?;
        if read == 0 {
            break;
        }
        events += read as u64;
        // Keeps the compiler from removing the writes of the events to memory.
        black_box(batch.as_slice());
    }
    // If the clock did not advance, the rate would be infinite, which JSON cannot represent.
    let seconds = start.elapsed().as_secs_f64().max(1e-9);
    Ok(Row {
        file: file.display().to_string(),
        format: reader.format(),
        events,
        seconds,
        events_per_s: events as f64 / seconds,
    })
}
