//! The document's table of the speed at which this project and other libraries convert recordings.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;
use serde::{Deserialize, Serialize};

/// Markers of the lines in the document between which its table goes.
pub const MARKS: Marks = Marks {
    name: "pipelines",
    command: "cargo xtask record pipelines",
};

/// Name of this project among the libraries.
const HERE: &str = "eecvs";

/// A recording converted by a library.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the format that is read.
    pub from: String,
    /// Name of the format that is written.
    pub to: String,
    /// `eecvs`, or the name of another library.
    pub library: String,
    /// Processors that it may use.
    pub threads: usize,
    /// Version of the other library.
    pub version: Option<String>,
    /// Number of events.
    pub events: u64,
    /// Seconds from opening the recording to the end of the output; the least of all runs.
    pub seconds: f64,
}

impl Row {
    /// Returns the million events converted per second.
    #[must_use]
    pub fn rate_mev_s(&self) -> f64 {
        self.events as f64 / self.seconds / 1e6
    }
}

/// Formats the document's table: one line per pair of formats, one column per library.
#[must_use]
pub fn document(rows: &[Row]) -> String {
    let mut columns: Vec<(&str, usize)> = vec![(HERE, 1)];
    let mut others: Vec<(&str, usize)> = Vec::new();
    for row in rows {
        let column = (row.library.as_str(), row.threads);
        let list = if row.library == HERE {
            &mut columns
        } else {
            &mut others
        };
        if !list.contains(&column) {
            list.push(column);
        }
    }
    columns.append(&mut others);
    let mut text = String::from("| from | to |");
    for (library, threads) in &columns {
        let version = rows.iter().find(|row| row.library == *library);
        let version = version.and_then(|row| row.version.as_deref());
        let version = version.map_or_else(String::new, |version| format!(" {version}"));
        let threads = match threads {
            1 => String::new(),
            threads => format!(", {threads} threads"),
        };
        let _ = write!(text, " {library}{version}{threads} |");
    }
    text += "\n|---|---|";
    text += &"---|".repeat(columns.len());
    text.push('\n');
    let mut pairs: Vec<(&str, &str)> = Vec::new();
    for row in rows {
        let pair = (row.from.as_str(), row.to.as_str());
        if !pairs.contains(&pair) {
            pairs.push(pair);
        }
    }
    for (from, to) in pairs {
        let _ = write!(text, "| {from} | {to} |");
        for column in &columns {
            let row = rows.iter().find(|row| {
                (row.from.as_str(), row.to.as_str()) == (from, to)
                    && (row.library.as_str(), row.threads) == *column
            });
            let rate = row.map_or_else(String::new, |row| format!(" {:.0}", row.rate_mev_s()));
            let _ = write!(text, "{rate} |");
        }
        text.push('\n');
    }
    text
}

/// Returns the pairs of formats that another library converts more quickly on one processor, with its name.
#[must_use]
pub fn slower(rows: &[Row]) -> Vec<(&str, &str, &str)> {
    let here = |other: &Row| {
        rows.iter().find(|row| {
            row.library == HERE && row.threads == 1 && row.from == other.from && row.to == other.to
        })
    };
    rows.iter()
        .filter(|row| {
            row.library != HERE && here(row).is_none_or(|here| here.rate_mev_s() < row.rate_mev_s())
        })
        .map(|row| (row.from.as_str(), row.to.as_str(), row.library.as_str()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(from: &str, to: &str, library: &str, threads: usize, seconds: f64) -> Row {
        Row {
            from: from.to_owned(),
            to: to.to_owned(),
            library: library.to_owned(),
            threads,
            version: (library != HERE).then(|| "1.2".to_owned()),
            events: 3_000_000,
            seconds,
        }
    }

    #[test]
    fn a_pair_has_a_line_and_a_library_a_column() {
        let rows = [
            row("dat", "csv", "eecvs", 1, 0.03),
            row("dat", "csv", "other", 1, 0.02),
            row("dat", "npz", "eecvs", 1, 0.3),
            row("dat", "npz", "eecvs", 2, 0.2),
        ];
        let text = document(&rows);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            lines,
            [
                "| from | to | eecvs | eecvs, 2 threads | other 1.2 |",
                "|---|---|---|---|---|",
                "| dat | csv | 100 | | 150 |",
                "| dat | npz | 10 | 15 | |",
            ]
        );
        assert_eq!(slower(&rows), [("dat", "csv", "other")]);
    }
}
