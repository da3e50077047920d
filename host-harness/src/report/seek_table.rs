//! The document's table of single milliseconds of long files.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;
use eecvs_bench::seek::Row;

/// Markers of the lines in the document between which its table goes.
pub const MARKS: Marks = Marks {
    name: "seek",
    command: "cargo xtask record seek",
};

/// Formats the document's table, one line per coder.
#[must_use]
pub fn document(rows: &[Row]) -> String {
    let mut text = String::from(
        "| coder | events | MiB | MiB to open | ms to open | events in 1 ms, at most | KiB for it, at most | ms for it, \
         median | at most |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let mebibytes = |bytes: u64| bytes as f64 / 1_048_576.0;
        let _ = writeln!(
            text,
            "| {} | {} | {:.0} | {:.2} | {:.1} | {} | {:.0} | {:.2} | {:.2} |",
            row.coder,
            row.events,
            mebibytes(row.bytes),
            mebibytes(row.open_bytes),
            row.open_ms,
            row.most_events,
            row.most_bytes as f64 / 1024.0,
            row.median_ms,
            row.most_ms,
        );
    }
    text
}
