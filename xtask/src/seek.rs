//! Single milliseconds of long files: how many bytes and how much time each takes.

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use eecvs_bench::{record_file, seek};
use eecvs_nostd::{Coder, Effort};

use crate::tree;

/// Events of the files whose record is committed.
pub const EVENTS: u64 = 1_000_000_000;

/// Coders of `eecvs encode`, by the names of its documents, and what part of the events they take: with the last one, a
/// millisecond takes the windows from the key frame before it on, however long the file is.
const CODERS: [(&str, Coder, u64); 3] = [
    ("quick", Coder::Quick, 1),
    ("fast", Coder::Keys, 1),
    ("dense, effort 1", Coder::Tree(Effort::One), 10),
];

/// Measures each coder, prints its row, and writes the record into `folder` as well. The files are gone afterwards.
pub fn run(events: u64, folder: Option<&Path>) -> Result<ExitCode> {
    let place = tree::path("target");
    let files = tempfile::tempdir_in(&place)
        .with_context(|| format!("cannot create a folder in {}", place.display()))?;
    let mut rows = Vec::new();
    for (name, coder, part) in CODERS {
        let events = events.div_ceil(part);
        let row = seek::measure(name, coder, events, &files.path().join("long.eecvs"))?;
        println!(
            "{name}: {events} events in {} bytes; opened by {} bytes in {:.2} ms; a millisecond has {} events at most, and \
             takes {} bytes and {:.2} ms at most, {:.2} ms in the median",
            row.bytes,
            row.open_bytes,
            row.open_ms,
            row.most_events,
            row.most_bytes,
            row.most_ms,
            row.median_ms,
        );
        rows.push(row);
    }
    if let Some(folder) = folder {
        record_file::write(&tree::path(folder), "seek", &rows)?;
    }
    Ok(ExitCode::SUCCESS)
}
