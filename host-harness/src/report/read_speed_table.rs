//! The document's table of the speed at which this project and other libraries read recordings.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;
use serde::{Deserialize, Serialize};

/// Markers of the lines in the document between which its table goes.
pub const MARKS: Marks = Marks {
    name: "read speed",
    command: "cargo xtask record read-speed",
};

/// Name of this project among the libraries.
const HERE: &str = "eecvs";

/// A recording read by a library.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the file, whose extension identifies the format.
    pub file: String,
    /// `eecvs`, or the name of another library.
    pub library: String,
    /// Version of the other library.
    pub version: Option<String>,
    /// Number of events.
    pub events: u64,
    /// Seconds from opening to the end of the file on one thread; the least of all runs.
    pub seconds: f64,
}

impl Row {
    /// Returns the million events read per second.
    #[must_use]
    pub fn rate_mev_s(&self) -> f64 {
        self.events as f64 / self.seconds / 1e6
    }
}

/// Formats the document's table: one line per file, one column per library.
#[must_use]
pub fn document(rows: &[Row]) -> String {
    let mut libraries: Vec<&str> = vec![HERE];
    for row in rows {
        if !libraries.contains(&row.library.as_str()) {
            libraries.push(&row.library);
        }
    }
    let mut text = String::from("| file | events |");
    for library in &libraries {
        let version = rows.iter().find(|row| row.library == *library);
        let version = version.and_then(|row| row.version.as_deref());
        let version = version.map_or_else(String::new, |version| format!(" {version}"));
        let _ = write!(text, " {library}{version} |");
    }
    text += "\n|---|---|";
    text += &"---|".repeat(libraries.len());
    text.push('\n');
    for rows in rows.chunk_by(|a, b| a.file == b.file) {
        let Some(first) = rows.first() else { continue };
        let _ = write!(
            text,
            "| {} | {:.1} M |",
            first.file,
            first.events as f64 / 1e6
        );
        for library in &libraries {
            let row = rows.iter().find(|row| row.library == *library);
            let rate = row.map_or_else(String::new, |row| format!(" {:.0}", row.rate_mev_s()));
            let _ = write!(text, "{rate} |");
        }
        text.push('\n');
    }
    text
}

/// Returns the files that another library reads faster, with the name of that library.
#[must_use]
pub fn slower(rows: &[Row]) -> Vec<(&str, &str)> {
    let here = |file: &str| {
        rows.iter()
            .find(|row| row.file == file && row.library == HERE)
    };
    let others = rows.iter().filter(|row| {
        let here = here(&row.file);
        here.is_none_or(|here| here.rate_mev_s() < row.rate_mev_s())
    });
    others
        .map(|row| (row.file.as_str(), row.library.as_str()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(file: &str, library: &str, seconds: f64) -> Row {
        Row {
            file: file.to_owned(),
            library: library.to_owned(),
            version: (library != HERE).then(|| "1.2".to_owned()),
            events: 1_500_000,
            seconds,
        }
    }

    #[test]
    fn a_file_has_a_line_and_a_library_a_column() {
        let rows = [
            row("a.dat", "eecvs", 0.01),
            row("a.dat", "other", 0.02),
            row("b.raw", "eecvs", 0.03),
            row("b.raw", "third", 0.015),
        ];
        let text = document(&rows);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            lines,
            [
                "| file | events | eecvs | other 1.2 | third 1.2 |",
                "|---|---|---|---|---|",
                "| a.dat | 1.5 M | 150 | 75 | |",
                "| b.raw | 1.5 M | 50 | | 100 |",
            ]
        );
        assert_eq!(slower(&rows), [("b.raw", "third")]);
    }
}
