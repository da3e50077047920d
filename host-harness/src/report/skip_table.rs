//! Tables of what skipping saves: for a terminal, and for METHODOLOGY.md.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;
use eecvs_bench::skips::Row;

/// Markers of the lines in METHODOLOGY.md between which its table goes.
pub const MARKS: Marks = Marks {
    name: "skips",
    command: "eecvs bench --skips --save METHODOLOGY.md",
};
/// Recordings of the table's columns, with their headings.
pub const COLUMNS: [(&str, &str); 5] = [
    ("davis346_building_dense", "davis346, building"),
    ("dvs128_walking_moderate", "dvs128, walking"),
    ("davis346_static_sparse", "davis346, static"),
    ("gen3_vga_dense_evt2", "gen3 vga, dense"),
    ("imx636_sparse_evt3", "imx636, sparse"),
];
const TIME: &str = "us/window";
const BITS: &str = "bits/window";
const BITS_OF_ALL: &str = "bits/recording";
const ALL: &[&str] = &["dct", "dtft", "dwt"];
const DCT: &[&str] = &["dct"];
const DTFT: &[&str] = &["dtft"];
const DWT: &[&str] = &["dwt"];
/// Rows of the table: what is skipped, unit, transforms.
const SHOWN: [(&str, &str, &[&str]); 15] = [
    ("inactive pixels, looked at", TIME, DCT),
    ("inactive pixels, transformed", TIME, ALL),
    ("inactive pixels, told by gaps", BITS, DCT),
    ("empty segments", TIME, DCT),
    ("empty windows", BITS_OF_ALL, DCT),
    ("single events as cells", TIME, ALL),
    ("single events as cells", BITS, ALL),
    ("butterflies of few events", TIME, DWT),
    ("zero coefficients", BITS, DWT),
    ("pruned coefficients", TIME, DTFT),
    ("pruned coefficients", BITS, DTFT),
    ("pruned coefficients", TIME, DWT),
    ("pruned coefficients", BITS, DWT),
    ("everything", TIME, ALL),
    ("nothing", TIME, DCT),
];

/// Formats the table of METHODOLOGY.md, in per cent; `None` if a row is missing.
#[must_use]
pub fn document(rows: &[Row]) -> Option<String> {
    let mut text = String::from("| saved by skipping | transform | of | how |");
    for (_, heading) in COLUMNS {
        let _ = write!(text, " {heading} |");
    }
    text += "\n|---|---|---|---|";
    text += &"---|".repeat(COLUMNS.len());
    text.push('\n');
    for (skip, unit, transforms) in SHOWN {
        for transform in transforms {
            let find = |recording: &str| {
                rows.iter().find(|row| {
                    (row.skip, row.unit, row.transform, row.recording)
                        == (skip, unit, *transform, recording)
                })
            };
            let how = find(COLUMNS[0].0)?.how.name();
            let name = match *transform {
                "dwt" => "Haar".to_owned(),
                other => other.to_uppercase(),
            };
            let of = if unit == TIME { "time" } else { "bits" };
            let _ = write!(text, "| {skip} | {name} | {of} | {how} |");
            for (recording, _) in COLUMNS {
                // Adding 0 turns -0 into 0.
                let saved = find(recording)?.saved_percent.round() + 0.0;
                let _ = write!(text, " {saved:.0} % |");
            }
            text.push('\n');
        }
    }
    Some(text)
}

/// Formats a table in Markdown: what is skipped down, recordings across.
#[must_use]
pub fn table(rows: &[Row]) -> String {
    let mut recordings: Vec<&str> = rows.iter().map(|row| row.recording).collect();
    recordings.dedup();
    let mut text = "| skipped | transform | unit | how |".to_owned();
    for recording in &recordings {
        text += &format!(" {recording} |");
    }
    text += "\n|---|---|---|---|";
    text += &"---|".repeat(recordings.len());
    text.push('\n');
    let key = |row: &Row| (row.skip, row.transform, row.unit);
    let of_first = rows.iter().filter(|row| row.recording == recordings[0]);
    for first in of_first {
        text += &format!(
            "| {} | {} | {} | {} |",
            first.skip,
            first.transform,
            first.unit,
            first.how.name()
        );
        for recording in &recordings {
            let mut same = rows.iter().filter(|row| key(row) == key(first));
            if let Some(row) = same.find(|row| row.recording == *recording) {
                text += &format!(
                    " {} of {}, {:.0} % |",
                    figure(row.with),
                    figure(row.without),
                    row.saved_percent
                );
            }
        }
        text.push('\n');
    }
    text
}

/// Formats three digits, or all digits before the point.
fn figure(value: f64) -> String {
    match value {
        100.0.. => format!("{value:.0}"),
        10.0.. => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use eecvs_bench::marks::of_project;
    use eecvs_bench::skips::How;

    use super::*;

    /// Returns a row of each kind, transform and recording, which are more than the table shows.
    fn rows() -> Vec<Row> {
        let mut rows = Vec::new();
        for (column, (recording, _)) in COLUMNS.into_iter().enumerate() {
            for (skip, unit, _) in SHOWN {
                for transform in ["dct", "dtft", "dwt"] {
                    let how = match (unit, skip) {
                        (TIME, _) => How::Timed,
                        (_, "inactive pixels, told by gaps" | "zero coefficients") => How::Counted,
                        _ => How::Packed,
                    };
                    rows.push(Row {
                        recording,
                        transform,
                        m: 8,
                        skip,
                        unit,
                        with: 50.0,
                        without: 100.0,
                        saved_percent: [50.4, -0.3, -24.5, 0.0, 99.6][column],
                        how,
                        counts: [].into(),
                    });
                }
            }
        }
        rows
    }

    #[test]
    fn cells_are_whole_per_cent() {
        let text = document(&rows()).unwrap();
        let line = text.lines().nth(2).unwrap();
        let cells = "| 50 % | 0 % | -25 % | 0 % | 100 % |";
        let start = "| inactive pixels, looked at | DCT | time | timed ";
        assert_eq!(line, format!("{start}{cells}"));
        let mut rows = rows();
        rows.retain(|row| row.recording != "dvs128_walking_moderate");
        assert_eq!(document(&rows), None);
    }

    #[test]
    fn the_methodology_has_the_marks_and_these_rows() {
        let text = of_project("METHODOLOGY.md");
        let names = |text: &str| -> Vec<String> {
            let lines = text.lines().map(|line| line.split('|').map(str::trim));
            lines
                .map(|cells| cells.take(5).collect::<Vec<_>>().join("|"))
                .collect()
        };
        let content = MARKS.content(&text).unwrap();
        let expected = document(&rows()).unwrap();
        assert_eq!(names(content), names(&expected));
        assert_eq!(content.lines().next(), expected.lines().next());
    }

    #[test]
    fn a_terminal_gets_both_figures() {
        let text = table(&rows());
        assert!(text.contains("| 50.0 of 100, 50 % |"), "{text}");
    }
}
