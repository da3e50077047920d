//! How exactly event times come back from coefficients, as the README has it.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use crate::marks::Marks;

/// Where the README has its table.
pub const MARKS: Marks = Marks {
    name: "exact times",
    command: "cargo xtask record exact-times",
};
/// What the rows of emulated scenes are of.
pub const SCENES: &str = "scenes";
/// The recording of the table.
pub const RECORDING: &str = "davis346_building_dense";
/// Sizes of pixels, as first and last number of events, and what the table calls them.
pub const SIZES: [(usize, usize, &str); 7] = [
    (1, 1, "1 event, a cell"),
    (2, 2, "2"),
    (3, 4, "3 and 4"),
    (5, 8, "5 to 8"),
    (9, 24, "9 to 24"),
    (25, usize::MAX, "25 and more"),
    (1, usize::MAX, "all"),
];

/// Events of pixels of so many events.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// [`SCENES`], or a recording's name.
    pub source: String,
    /// Of the quantiser.
    pub step_log2: i8,
    /// As in [`SIZES`].
    pub size: String,
    /// In such pixels.
    pub events: u64,
    /// Come back within 1 us.
    pub within_1_us: u64,
    /// Come back within 5 us.
    pub within_5_us: u64,
    /// Mean error of an event's time.
    pub emd_us: f64,
    /// The same by the peaks of the summed atoms.
    pub emd_peaks_us: f64,
}

/// The README's table, of the step 2^-6; `None` where a row is missing.
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

/// With a decimal near to all, where it matters; never rounded up to all.
fn percent(value: f64) -> String {
    match value {
        100.0.. => "100 %".to_owned(),
        98.0.. => format!("{:.1} %", (value * 10.0).floor() / 10.0),
        _ => format!("{value:.0} %"),
    }
}

/// Two digits, or all before the point.
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
