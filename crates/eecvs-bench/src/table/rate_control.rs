//! A flood under the budgets of links, as the README has it.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use crate::marks::Marks;

/// Where the README has its table.
pub const MARKS: Marks = Marks {
    name: "rate control",
    command: "cargo xtask record rate-control",
};

/// What became of a flood's events under a budget.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Of the link.
    pub bytes_per_second: u32,
    /// `fast` or `dense`.
    pub coder: String,
    /// Of the flood, over all its passes.
    pub events: u64,
    /// Told exactly.
    pub exact: u64,
    /// Told, their times not exactly.
    pub approximate: u64,
    /// Left out by the rate control.
    pub missing: u64,
    /// As `eecvs compare` has it, of the last pass.
    pub emd_pixel_us: f64,
    /// Most bytes of frames whose windows end within a second.
    pub most_in_a_second: u64,
}

/// The README's table.
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

/// A whole number, its digits in groups of three.
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
