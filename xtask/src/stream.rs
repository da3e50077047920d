//! Long streams of events through encoder and decoder, and whether their rate and memory stay as they are at first.

use std::path::Path;
use std::process::ExitCode;

use anyhow::Result;
use eecvs_bench::{record_file, stream};
use eecvs_nostd::{Coder, Effort};

use crate::tree;

/// Events of the streams whose record is committed.
pub const EVENTS: u64 = 2_000_000_000;

/// Coders of `eecvs encode`, by the names of its documents, and how many times the events they take: the quicker ones
/// take minutes too then, and more events than 32 bits count.
const CODERS: [(&str, Coder, u64); 3] = [
    ("quick", Coder::Quick, 5),
    ("fast", Coder::Keys, 5),
    ("dense, effort 1", Coder::Tree(Effort::One), 1),
];

/// Measures each coder, prints its row, and writes the record into `folder` as well.
pub fn run(events: u64, folder: Option<&Path>) -> Result<ExitCode> {
    let mut rows = Vec::new();
    for (name, coder, times) in CODERS {
        let events = events.saturating_mul(times);
        let row = stream::measure(name, coder, events)?;
        println!(
            "{name}: {events} events came back in {:.1} s; in parts of {:.1} s at first {:.2}, at last {:.2} Mev/s; \
             {:.1} MiB at first, {:.1} MiB at most after",
            row.seconds,
            row.part_s,
            row.first_per_s / 1e6,
            row.last_per_s / 1e6,
            row.first_memory as f64 / 1_048_576.0,
            row.most_memory as f64 / 1_048_576.0,
        );
        rows.push(row);
    }
    if let Some(folder) = folder {
        record_file::write(&tree::path(folder), "stream", &rows)?;
    }
    Ok(ExitCode::SUCCESS)
}
