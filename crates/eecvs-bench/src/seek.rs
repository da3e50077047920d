//! Reads single milliseconds of a long file: how many bytes and how much time does each take?

use std::cell::Cell;
use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom};
use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use eecvs::decode::WindowReader;
use eecvs::encode::{Limits, encode};
use eecvs::frame_file::{FrameFileWriter, FrameReader};
use eecvs_nostd::{Coder, Event};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

use crate::machine::SEED;
use crate::repeated::Repeated;
use crate::stream;

/// Number of milliseconds that are read, at random times.
const READS: usize = 1000;
/// Duration that is read.
const SPAN_US: u64 = 1000;

/// How a file is encoded.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    /// Name of the coder, and of what differs from the defaults of `eecvs encode`.
    pub name: &'static str,
    /// Coder of the events.
    pub coder: Coder,
    /// Duration of windows that are key frames all, in microseconds; `None` for the defaults of `eecvs encode`.
    pub key_window_us: Option<u32>,
}

/// One file; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the coder.
    pub coder: String,
    /// Number of events in the file.
    pub events: u64,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// Bytes read to open it: its index.
    pub open_bytes: u64,
    /// Time to open it in ms.
    pub open_ms: f64,
    /// Most bytes read for one millisecond.
    pub most_bytes: u64,
    /// Median of the times to decode one millisecond, in ms.
    pub median_ms: f64,
    /// The longest of these times, in ms.
    pub most_ms: f64,
    /// Most events in one millisecond.
    pub most_events: u64,
}

/// A source that counts the bytes read from it.
struct Counted<'c, R> {
    source: R,
    bytes: &'c Cell<u64>,
}

impl<R: Read> Read for Counted<'_, R> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let read = self.source.read(bytes)?;
        self.bytes.set(self.bytes.get() + read as u64);
        Ok(read)
    }
}

impl<R: Seek> Seek for Counted<'_, R> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.source.seek(to)
    }
}

/// Writes a file of `events` events without loss, at `path`, and reads single milliseconds of it.
///
/// # Errors
/// Fails if the file cannot be written or read, or if a millisecond has other events than were encoded.
pub fn measure(case: &Case, events: u64, path: &Path) -> Result<Row> {
    let (scene, mut config) = stream::scene(case.coder)?;
    if let Some(window_us) = case.key_window_us {
        config.window.window_us = window_us;
        config.key_windows = 1;
    }
    let whose = || path.display().to_string();
    let mut frames = FrameFileWriter::new(BufWriter::new(File::create(path).with_context(whose)?));
    let mut reader = Repeated::new(&scene.events, events, scene.sensor);
    let (limits, one) = (Limits::default(), NonZeroUsize::MIN);
    encode(&mut reader, config, limits, one, &mut frames, &mut |_| ()).with_context(whose)?;
    let file = frames.finish().with_context(whose)?;
    let file = file.into_inner().with_context(whose)?;
    file.sync_all().with_context(whose)?;
    let bytes = file.metadata().with_context(whose)?.len();

    let started = Instant::now();
    let read = Cell::new(0);
    let mut windows = WindowReader::new(FrameReader::new(Counted {
        source: File::open(path).with_context(whose)?,
        bytes: &read,
    }));
    ensure!(windows.seek(0..0)?, "{}: no index", whose());
    let open_ms = started.elapsed().as_secs_f64() * 1e3;
    let open_bytes = read.get();

    let end_us = reader.end_us();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(SEED);
    let mut row = Row {
        coder: case.name.to_owned(),
        events,
        bytes,
        open_bytes,
        open_ms,
        most_bytes: 0,
        median_ms: 0.0,
        most_ms: 0.0,
        most_events: 0,
    };
    let mut times_ms = Vec::new();
    for _ in 0..READS {
        let start_us = scene.start_us() + random.next_u64() % (end_us - scene.start_us());
        let times = start_us..start_us + SPAN_US;
        read.set(0);
        let started = Instant::now();
        let found = read_between(&mut windows, &times)?;
        times_ms.push(started.elapsed().as_secs_f64() * 1e3);
        row.most_bytes = row.most_bytes.max(read.get());
        row.most_events = row.most_events.max(found.len() as u64);
        let sum = |events: &[Event]| stream::add(0, events);
        let sent = reader.between(&times);
        ensure!(
            (found.len(), sum(&found)) == (sent.len(), sum(&sent)),
            "{times:?}: {} events came back, of {}",
            found.len(),
            sent.len()
        );
    }
    times_ms.sort_by(f64::total_cmp);
    row.median_ms = times_ms.get(READS / 2).copied().unwrap_or_default();
    row.most_ms = times_ms.last().copied().unwrap_or_default();
    Ok(row)
}

/// Returns the events of these times.
fn read_between<R: Read + Seek>(
    windows: &mut WindowReader<R>,
    times: &Range<u64>,
) -> Result<Vec<Event>> {
    ensure!(windows.seek(times.clone())?, "the index is gone");
    let mut events = Vec::new();
    while let Some(window) = windows.next_window()? {
        let inside = window.events.iter();
        events.extend(inside.filter(|event| times.contains(&event.t_us)));
        windows.reuse(window);
    }
    ensure!(!windows.report().has_loss(), "{:?}", windows.report());
    Ok(events)
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Effort;

    use super::*;

    #[test]
    fn a_millisecond_takes_a_few_windows() {
        let folder = tempfile::tempdir().unwrap();
        for (coder, key_window_us) in [
            (Coder::Keys, None),
            (Coder::Quick, None),
            (Coder::Tree(Effort::One), Some(4_096)),
        ] {
            let path = folder.path().join("long.eecvs");
            let case = Case {
                name: "a coder",
                coder,
                key_window_us,
            };
            let row = measure(&case, 3_000_000, &path).unwrap();
            assert_eq!(row.events, 3_000_000);
            assert!(row.most_events > 0, "{row:?}");
            assert!(row.open_bytes * 200 < row.bytes, "{row:?}");
            assert!(row.most_bytes * 10 < row.bytes, "{row:?}");
        }
    }
}
