//! How exactly event times are recovered from coefficients: the rows and the document's table.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use crate::marks::Marks;

/// The marks around the table in the document.
pub const MARKS: Marks = Marks {
    name: "exact times",
    command: "cargo xtask record exact-times",
};
/// [`Row::source`] of rows over all emulated scenes.
pub const SCENES: &str = "scenes";
/// The recording shown in the table.
pub const RECORDING: &str = "davis346_building_dense";
/// Size classes of pixels: the smallest and the largest number of events, and the name in the table.
pub const SIZES: [(usize, usize, &str); 7] = [
    (1, 1, "1 event, a cell"),
    (2, 2, "2"),
    (3, 4, "3 and 4"),
    (5, 8, "5 to 8"),
    (9, 24, "9 to 24"),
    (25, usize::MAX, "25 and more"),
    (1, usize::MAX, "all"),
];

/// Errors of the recovered times of all events in pixels of one size class.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// [`SCENES`], or the name of a recording.
    pub source: String,
    /// log2 of the quantiser's step.
    pub step_log2: i8,
    /// Name of the size class, from [`SIZES`].
    pub size: String,
    /// Number of events in pixels of this size.
    pub events: u64,
    /// Number of events recovered within 1 us.
    pub within_1_us: u64,
    /// Number of events recovered within 5 us.
    pub within_5_us: u64,
    /// Mean error of an event's time in us, as earth mover's distance within the pixel.
    pub emd_us: f64,
    /// The same in us if the times are found from the peaks of the summed atoms.
    pub emd_peaks_us: f64,
}

/// Returns the document's table for the step 2^-6, or `None` if a row is missing.
#[must_use]
pub fn document(rows: &[Row]) -> Option<String> {
    let mut text = format!(
        "| events of pixels of | scenes, 2^-6: within 1 us, 5 us; emd, us (peaks) | {RECORDING}, 2^-6 |\n\
         |---|---|---|\n"
    );
    for (.., size) in SIZES {
        let _ = write!(text, "| {size} |");
        for source in [SCENES, RECORDING] {
            let row = rows.iter().find(|row| {
                (row.source.as_str(), row.step_log2, row.size.as_str()) == (source, -6, size)
            })?;
            let share = |count: u64| percent(100.0 * count as f64 / row.events.max(1) as f64);
            let _ = write!(
                text,
                " {}, {}; {} ({}) |",
                share(row.within_1_us),
                share(row.within_5_us),
                figure(row.emd_us),
                figure(row.emd_peaks_us)
            );
        }
        text.push('\n');
    }
    Some(text)
}

/// Formats a percentage, with one decimal from 98 % on. Less than 100 % is never rounded up to 100 %.
fn percent(value: f64) -> String {
    match value {
        100.0.. => "100 %".to_owned(),
        98.0.. => format!("{:.1} %", (value * 10.0).floor() / 10.0),
        _ => format!("{value:.0} %"),
    }
}

/// Formats a time in us with one decimal below 9.95 us, and without decimals from there on.
fn figure(us: f64) -> String {
    if us < 9.95 {
        format!("{us:.1}")
    } else {
        format!("{us:.0}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_all_events_are_all() {
        let shares = [100.0, 99.99, 98.0, 97.96, 5.5].map(percent);
        assert_eq!(shares, ["100 %", "99.9 %", "98.0 %", "98 %", "6 %"]);
        assert_eq!([0.25, 9.96, 117.4].map(figure), ["0.2", "10", "117"]);
        assert_eq!(document(&[]), None);
    }
}
