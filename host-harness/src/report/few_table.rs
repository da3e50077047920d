//! The table of what few events as times save, for METHODOLOGY.md and for a terminal.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;

use super::selection_table::summary;
use crate::selection::few::{CODERS, Row};

/// Markers of the lines in the document between which the table goes.
pub const MARKS: Marks = Marks {
    name: "few as times",
    command: "eecvs bench --few-as-times --save METHODOLOGY.md",
};

/// Formats the table, one line per transform and M; `None` if nothing was measured.
#[must_use]
pub fn document(rows: &[Row]) -> Option<String> {
    let first = rows.first()?;
    let inputs = rows.iter().filter(|row| setting(row) == setting(first));
    let inputs = inputs.filter(|row| row.coder == first.coder).count();
    let mut text = format!(
        "Bytes saved on {inputs} inputs by sending few events as times, per cent: median, least, and on how many of the \
         inputs more bytes are taken:\n\n| transform | M | {} |\n|{}\n",
        CODERS.map(|(name, _)| name).join(" | "),
        "---|".repeat(CODERS.len() + 2)
    );
    let mut settings: Vec<(&str, u8)> = Vec::new();
    for row in rows {
        if !settings.contains(&setting(row)) {
            settings.push(setting(row));
        }
    }
    for (transform, m) in settings {
        let _ = write!(text, "| {transform} | {m} |");
        for (coder, _) in CODERS {
            let of = rows
                .iter()
                .filter(|row| setting(row) == (transform, m) && row.coder == coder);
            let saved = of
                .map(|row| 100.0 * (1.0 - row.best_bytes as f64 / row.levels_bytes.max(1) as f64));
            let _ = write!(text, " {} |", summary(&saved.collect::<Vec<f64>>()));
        }
        text.push('\n');
    }
    Some(text)
}

fn setting(row: &Row) -> (&str, u8) {
    (&row.transform, row.m)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_a_line_per_setting() {
        let row = |input: &str, coder: &str, best_bytes| Row {
            input: input.to_owned(),
            events: 9,
            transform: "dct".to_owned(),
            m: 8,
            coder: coder.to_owned(),
            levels_bytes: 1000,
            best_bytes,
        };
        let mut rows = Vec::new();
        for (input, plain) in [("a", 800), ("b", 700), ("c", 1001)] {
            rows.extend([
                row(input, "plain", plain),
                row(input, "fast", 900),
                row(input, "dense", 1000),
            ]);
        }
        let text = document(&rows).unwrap();
        assert!(text.starts_with("Bytes saved on 3 inputs"), "{text}");
        let line = "| dct | 8 | 20.0, -0.1, 1 of 3 | 10.0, 10.0, 0 of 3 | 0.0, 0.0, 0 of 3 |\n";
        assert!(text.ends_with(line), "{text}");
        assert_eq!(document(&[]), None);
    }
}
