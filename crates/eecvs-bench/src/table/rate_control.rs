//! A flood of events under the budgets of several links: the rows and the document's table.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use crate::marks::Marks;

/// The marks around the table in the document.
pub const MARKS: Marks = Marks {
    name: "rate control",
    command: "cargo xtask record rate-control",
};

/// How a flood's events were encoded under one budget.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Budget of the link in bytes per second.
    pub bytes_per_second: u32,
    /// Name of the coder: `fast` or `dense`.
    pub coder: String,
    /// Number of events of the flood, over all its passes.
    pub events: u64,
    /// Number of events encoded with their exact times.
    pub exact: u64,
    /// Number of events encoded with approximate times.
    pub approximate: u64,
    /// Number of events that the rate control left out.
    pub missing: u64,
    /// Earth mover's distance per pixel in us, as `eecvs compare` reports it, over the last pass.
    pub emd_pixel_us: f64,
    /// Maximum number of bytes in frames whose windows end within one second.
    pub most_in_a_second: u64,
}

/// Returns the document's table, with one line per row; shares are in whole per cent of the events.
#[must_use]
pub fn document(rows: &[Row]) -> String {
    let mut text = String::from(
        "| bytes a second | coder | exact | approximate | missing | `emd_pixel_us` |\n\
         |---|---|---|---|---|---|\n",
    );
    for row in rows {
        let share = |count: u64| {
            let percent = (100.0 * count as f64 / row.events.max(1) as f64).round();
            if percent > 0.0 {
                format!(" {percent:.0} %")
            } else {
                String::new()
            }
        };
        let _ = writeln!(
            text,
            "| {} | {} |{} |{} |{} | {} |",
            grouped(f64::from(row.bytes_per_second)),
            row.coder,
            share(row.exact),
            share(row.approximate),
            share(row.missing),
            grouped(row.emd_pixel_us)
        );
    }
    text
}

/// Formats `value` as a whole number with its digits in groups of three; a negative value becomes 0.
fn grouped(value: f64) -> String {
    let digits = format!("{:.0}", value.max(0.0));
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_whole_per_cent_and_nothing_is_empty() {
        let row = Row {
            bytes_per_second: 12_800_000,
            coder: "fast".to_owned(),
            events: 1000,
            exact: 4,
            approximate: 596,
            missing: 400,
            emd_pixel_us: 19_612.4,
            most_in_a_second: 1,
        };
        let text = document(&[row]);
        assert_eq!(
            text.lines().nth(2),
            Some("| 12,800,000 | fast | | 60 % | 40 % | 19,612 |")
        );
        assert_eq!([0.0, 999.0, 1e6].map(grouped), ["0", "999", "1,000,000"]);
    }
}
