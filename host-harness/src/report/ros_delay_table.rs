//! The document's table of the delay from a window's end to its frame's arrival on ROS 2.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;
use serde::{Deserialize, Serialize};

/// Markers of the lines in the document between which its table goes.
pub const MARKS: Marks = Marks {
    name: "ros delay",
    command: "cargo xtask record ros-delay",
};

/// Frames of one window duration over one transport, as measured by `eecvs-ros/delay.sh`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// `dds` or `zenoh`.
    pub transport: String,
    /// Duration of the windows.
    pub window_us: u32,
    /// Number of messages with events that did not reach the encoder.
    pub packets_lost: u64,
    /// Number of frames that arrived.
    pub frames: u64,
    /// Number of frames that did not arrive.
    pub frames_lost: u64,
    /// Rate of the events in the frames that arrived.
    pub events_per_s: f64,
    /// Median delay from the end of a window to the arrival of its frame.
    pub delay_p50_ms: f64,
    /// 99th percentile of this delay.
    pub delay_p99_ms: f64,
    /// Largest delay.
    pub delay_max_ms: f64,
}

impl Row {
    fn transport(&self) -> &str {
        match self.transport.as_str() {
            "dds" => "DDS",
            "zenoh" => "Zenoh, two routers",
            other => other,
        }
    }
}

/// Formats the document's table, one line per transport and window.
#[must_use]
pub fn document(rows: &[Row]) -> String {
    let mut text = String::from(
        "| transport | window, us | Mev/s | frames | messages lost | delay, ms: median | 99th percentile | largest |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let _ = writeln!(
            text,
            "| {} | {} | {:.2} | {} | {} | {:.2} | {:.2} | {:.2} |",
            row.transport(),
            row.window_us,
            row.events_per_s / 1e6,
            row.frames,
            row.packets_lost + row.frames_lost,
            row.delay_p50_ms,
            row.delay_p99_ms,
            row.delay_max_ms
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_of_both_topics_are_one_figure() {
        let row = |transport: &str, packets_lost, frames_lost| Row {
            transport: transport.to_owned(),
            window_us: 4000,
            packets_lost,
            frames: 2500,
            frames_lost,
            events_per_s: 5_446_000.0,
            delay_p50_ms: 1.234,
            delay_p99_ms: 5.678,
            delay_max_ms: 12.0,
        };
        let text = document(&[row("dds", 0, 0), row("zenoh", 3, 40)]);
        let lines: Vec<&str> = text.lines().skip(2).collect();
        assert_eq!(
            lines,
            [
                "| DDS | 4000 | 5.45 | 2500 | 0 | 1.23 | 5.68 | 12.00 |",
                "| Zenoh, two routers | 4000 | 5.45 | 2500 | 43 | 1.23 | 5.68 | 12.00 |",
            ]
        );
    }
}
