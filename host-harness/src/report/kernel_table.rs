//! Tables of run time against error of every kernel: for a terminal, and for a document.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;
use eecvs_bench::mcu::TARGETS;
use eecvs_bench::window::CROWDED_EVENTS;
use eecvs_bench::{M, Row};

/// Markers of the lines in the document between which the host's table goes.
pub const MARKS: Marks = Marks {
    name: "host kernels",
    command: "eecvs bench --save docs/results.md",
};
/// Kernels and peers in the document's table, with their names there.
const KERNELS: [(&str, &str); 7] = [
    ("table", "table"),
    ("recurrence", "recurrence"),
    ("precise", "precise"),
    ("libm", "libm, f32"),
    ("micromath", "micromath, f32"),
    ("binning-fft", "1,024 bins and an FFT"),
    ("oracle-f64", "f64 reference"),
];
/// Columns of the document's table: transform, its name, M.
const COLUMNS: [(&str, &str, u8); 4] = [
    ("dct", "DCT", 8),
    ("dct", "DCT", 16),
    ("dtft", "DTFT", 8),
    ("dtft", "DTFT", 16),
];

/// Formats the host's rows for the document: ns per event, largest error, and `*` on the Pareto front; `None` if a
/// row is missing.
#[must_use]
pub fn document(rows: &[Row]) -> Option<String> {
    let find = |kernel: &str, transform: &str, m: u8| {
        rows.iter().find(|row| {
            (row.kernel, row.transform, row.m, row.target) == (kernel, transform, m, "host")
        })
    };
    let mut text = String::from("| kernel |");
    for (_, name, m) in COLUMNS {
        let _ = write!(text, " {name}, M = {m} |");
    }
    text += "\n|---|---|---|---|---|\n";
    for (kernel, name) in KERNELS {
        let _ = write!(text, "| {name} |");
        for (transform, _, m) in COLUMNS {
            let row = find(kernel, transform, m)?;
            let mark = if row.pareto { " *" } else { "" };
            let _ = write!(text, " {:.1}, {}{mark} |", row.cost, error(row));
        }
        text.push('\n');
    }
    let [m8, m16] = [find("haar", "dwt", 8)?, find("haar", "dwt", 16)?].map(|row| row.cost);
    let _ = writeln!(
        text,
        "\nThe Haar sums are exact: {m8:.1} ns at M = 8, {m16:.1} at M = 16."
    );
    Some(text)
}

/// Formats one table per transform and target, and for crowded pixels: kernels down, M across; `*` marks the Pareto
/// front.
#[must_use]
pub fn table(rows: &[Row]) -> String {
    let mut text = String::new();
    let targets = TARGETS.map(|(name, _)| name);
    for target in std::iter::once("host").chain(targets) {
        for is_crowded in [false, true] {
            for transform in ["dct", "dtft", "dwt", "none"] {
                let here: Vec<&Row> = rows
                    .iter()
                    .filter(|row| (row.target, row.is_crowded) == (target, is_crowded))
                    .filter(|row| row.transform == transform)
                    .collect();
                text += &kernels_table(&here);
            }
        }
    }
    text
}

/// Formats the table of one transform and target; empty without rows.
fn kernels_table(rows: &[&Row]) -> String {
    let Some(first) = rows.first() else {
        return String::new();
    };
    let name = match first.transform {
        "none" => "no transform, M bins",
        transform => transform,
    };
    let crowded = if first.is_crowded {
        format!(", pixels of {CROWDED_EVENTS} events and more")
    } else {
        String::new()
    };
    let mut text = format!(
        "\n{name}, {}{crowded}: {}, largest error\n{:<15}",
        first.target, first.unit, ""
    );
    for m in M {
        text += &format!("{:>22}", format!("M = {m}  "));
    }
    text = text.trim_end().to_owned() + "\n";
    let mut kernels: Vec<&str> = Vec::new();
    for row in rows {
        if !kernels.contains(&row.kernel) {
            kernels.push(row.kernel);
        }
    }
    for kernel in kernels {
        let mut line = format!("{kernel:<15}");
        for m in M {
            let row = rows.iter().find(|row| row.kernel == kernel && row.m == m);
            line += &row.map_or_else(|| " ".repeat(22), |row| cell(row));
        }
        text += line.trim_end();
        text.push('\n');
    }
    text
}

/// Formats cost, error and the mark of the Pareto front, in 22 columns.
fn cell(row: &Row) -> String {
    let mark = if row.pareto { '*' } else { ' ' };
    format!("{:>11.1} {:>8} {mark}", row.cost, error(row))
}

fn error(row: &Row) -> String {
    match row.max_error {
        None => "-".to_owned(),
        Some(0.0) => "0".to_owned(),
        Some(error) => format!("{error:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use eecvs_bench::marks::of_project;

    use super::*;

    fn row(kernel: &'static str, transform: &'static str, m: u8, max_error: f64) -> Row {
        Row {
            kernel,
            transform,
            m,
            target: "host",
            window: "all".into(),
            cost: f64::from(m) + 0.26,
            unit: "ns/event",
            cost_low: 1.0,
            cost_high: 100.0,
            max_error: Some(max_error),
            rms_error: Some(max_error),
            pareto: kernel == "table",
            is_crowded: false,
            events: 100,
            coefficients: 100,
        }
    }

    /// Returns rows of everything; those of a microcontroller come before the host's.
    fn rows() -> Vec<Row> {
        let mut rows = Vec::new();
        for m in M {
            for (kernel, _) in KERNELS {
                for transform in ["dct", "dtft"] {
                    let error = if kernel == "oracle-f64" { 0.0 } else { 1.94e-4 };
                    let host = row(kernel, transform, m, error);
                    rows.push(Row {
                        target: "cortex-m4",
                        cost: 999.0,
                        ..host.clone()
                    });
                    rows.push(host);
                }
            }
            rows.push(row("haar", "dwt", m, 0.0));
        }
        rows
    }

    #[test]
    fn cells_are_cost_error_and_front() {
        let text = document(&rows()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let table = "| table | 8.3, 1.9e-4 * | 16.3, 1.9e-4 * | 8.3, 1.9e-4 * | 16.3, 1.9e-4 * |";
        assert_eq!(lines[2], table);
        assert_eq!(
            lines[8],
            "| f64 reference | 8.3, 0 | 16.3, 0 | 8.3, 0 | 16.3, 0 |"
        );
        let haar = "The Haar sums are exact: 8.3 ns at M = 8, 16.3 at M = 16.";
        assert_eq!(lines[9..], ["", haar]);
        let without = |kernel| {
            let rows = rows().into_iter();
            rows.filter(|row| row.kernel != kernel).collect::<Vec<_>>()
        };
        assert_eq!(document(&without("libm")), None);
        assert_eq!(document(&without("haar")), None);
    }

    #[test]
    fn the_document_has_the_marks_and_these_rows() {
        let results = of_project("docs/results.md");
        let names = |text: &str| -> Vec<String> {
            let lines = text.lines().filter(|line| line.starts_with('|'));
            let cells = lines.map(|line| line.split('|').map(str::trim).collect::<Vec<_>>());
            cells
                .map(|cells| format!("{} {}", cells[1], cells.len()))
                .collect()
        };
        let content = MARKS.content(&results).unwrap();
        let expected = document(&rows()).unwrap();
        assert_eq!(names(content), names(&expected));
        assert_eq!(content.lines().next(), expected.lines().next());
    }
}
