//! The document's table of long streams.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;
use eecvs_bench::stream::Row;

/// Markers of the lines in the document between which its table goes.
pub const MARKS: Marks = Marks {
    name: "stream",
    command: "cargo xtask record stream",
};

/// Formats the document's table, one line per coder.
#[must_use]
pub fn document(rows: &[Row]) -> String {
    let mut text = String::from(
        "| coder | events | s | bits/event | Mev/s at first | Mev/s at last | MiB at first | MiB at most after |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let mebibytes = |bytes: u64| bytes as f64 / 1_048_576.0;
        let _ = writeln!(
            text,
            "| {} | {} | {:.0} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} |",
            row.coder,
            row.events,
            row.seconds,
            row.bytes as f64 * 8.0 / row.events.max(1) as f64,
            row.first_per_s / 1e6,
            row.last_per_s / 1e6,
            mebibytes(row.first_memory),
            mebibytes(row.most_memory),
        );
    }
    text
}
