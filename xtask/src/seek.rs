//! Single milliseconds of long files: how many bytes and how much time each takes.

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use eecvs_bench::record_file;
use eecvs_bench::seek::{self, Case};
use eecvs_nostd::{Coder, Effort};

use crate::tree;

/// Events of the files whose record is committed.
pub const EVENTS: u64 = 1_000_000_000;

/// Files, and what part of the events each takes: where a millisecond takes the windows from the key frame before it on,
/// it takes them however long the file is.
const CASES: [(Case, u64); 4] = [
    (case("quick", Coder::Quick, None), 1),
    (case("fast", Coder::Keys, None), 1),
    (case("dense, effort 1", Coder::Tree(Effort::One), None), 10),
    (
        case(
            "dense, effort 1, --window-us 4096 --key-windows 1",
            Coder::Tree(Effort::One),
            Some(4_096),
        ),
        1,
    ),
];

const fn case(name: &'static str, coder: Coder, key_window_us: Option<u32>) -> Case {
    Case {
        name,
        coder,
        key_window_us,
    }
}

/// Measures each file, prints its row, and writes the record into `folder` as well. The files are gone afterwards.
pub fn run(events: u64, folder: Option<&Path>) -> Result<ExitCode> {
    let place = tree::path("target");
    let files = tempfile::tempdir_in(&place)
        .with_context(|| format!("cannot create a folder in {}", place.display()))?;
    let mut rows = Vec::new();
    for (case, part) in CASES {
        let (name, events) = (case.name, events.div_ceil(part));
        let row = seek::measure(&case, events, &files.path().join("long.eecvs"))?;
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
