//! The cost of keeping the order of events: the rows and the document's table.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use crate::marks::Marks;

/// The marks around the table in the document.
pub const MARKS: Marks = Marks {
    name: "keep order",
    command: "cargo xtask record keep-order",
};

/// Cost of keeping the order of one recording's events with one coder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the recording.
    pub recording: String,
    /// Name of the coder: `fast` or `dense`.
    pub coder: String,
    /// 8 `bytes_order` / `events_in` of the summary of `encode`.
    pub order_bits_per_event: f64,
}

/// Returns the document's table, with one line per recording: the larger cost of the two coders.
///
/// The rows of a recording must follow each other.
#[must_use]
pub fn document(rows: &[Row]) -> String {
    let mut text = String::from("| recording | `--keep-order`, bits per event |\n|---|---|\n");
    for rows in rows.chunk_by(|a, b| a.recording == b.recording) {
        let most = rows
            .iter()
            .map(|row| row.order_bits_per_event)
            .fold(0.0, f64::max);
        if let Some(row) = rows.first() {
            let _ = writeln!(text, "| {} | {most:.2} |", row.recording);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_has_a_line() {
        let row = |recording: &str, order_bits_per_event| Row {
            recording: recording.to_owned(),
            coder: "fast".to_owned(),
            order_bits_per_event,
        };
        let text = document(&[row("a", 0.121), row("a", 0.119), row("b", 1.446)]);
        let lines: Vec<&str> = text.lines().skip(2).collect();
        assert_eq!(lines, ["| a | 0.12 |", "| b | 1.45 |"]);
    }
}
