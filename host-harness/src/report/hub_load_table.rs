//! The document's table of sensors at full load through a hub.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;
use serde::{Deserialize, Serialize};

/// Markers of the lines in the document between which its table goes.
pub const MARKS: Marks = Marks {
    name: "hub load",
    command: "cargo xtask record hub-load",
};

/// One run of `eecvs-hub/load.sh`, or of `eecvs-hub simulate`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Row {
    /// Sensors, a hub and receivers, each as a program of its own.
    Load {
        /// Whether the hub was killed during the run, and restarted after 5 s.
        killed: bool,
        /// Number of sending programs.
        sensors: u64,
        /// Number of receiving programs.
        receivers: u64,
        /// Duration of sending, in seconds.
        seconds: f64,
        /// Events per second of all sensors together.
        events_per_s: f64,
        /// Bytes of frames per second.
        bytes_per_s: f64,
        /// Whether every event is in a frame, at its exact time.
        events_exact: bool,
        /// Number of frames sent.
        frames: u64,
        /// Number of frames received by all receivers together.
        frames_received: u64,
        /// Number of these that had to be requested again.
        frames_again: u64,
        /// Number of frames that receivers gave up.
        frames_lost: u64,
        /// Median delay from the end of a window to the arrival of its frame, for the slowest sensor and receiver.
        delay_p50_ms: f64,
        /// 99th percentile of this delay, for the slowest sensor and receiver.
        delay_p99_ms: f64,
    },
    /// A simulation in one process.
    Simulation {
        /// Number of sensors.
        sensors: u64,
        /// Number of hubs.
        hubs: u64,
        /// Number of receivers.
        receivers: u64,
        /// Duration of sending, in seconds.
        seconds: f64,
        /// Number of events of all sensors together.
        events: u64,
        /// Bytes of frames per second.
        bytes_per_s: f64,
        /// Number of frames that all receivers together should receive.
        expected: u64,
        /// Number of frames that arrived unchanged.
        delivered: u64,
        /// Number of these that had to be requested again.
        again: u64,
        /// Number of frames that receivers gave up.
        lost: u64,
        /// Number of frames that arrived changed.
        wrong: u64,
        /// Median delay from when a frame was due to its arrival.
        delay_p50_ms: f64,
        /// 99th percentile of this delay.
        delay_p99_ms: f64,
        /// Processor time per time elapsed.
        cores: f64,
        /// Peak resident memory.
        memory_peak_bytes: u64,
    },
}

/// Formats the document's table, one line per run.
#[must_use]
pub fn document(rows: &[Row]) -> String {
    let mut text = String::from(
        "| | Mev/s | MB/s | frames to receive | received | asked for again | lost | delay, ms: median | 99th percentile |\n\
         |---|---|---|---|---|---|---|---|---|\n",
    );
    for row in rows {
        let _ = match row {
            Row::Load {
                killed,
                sensors,
                receivers,
                events_per_s,
                bytes_per_s,
                frames,
                frames_received,
                frames_again,
                frames_lost,
                delay_p50_ms,
                delay_p99_ms,
                ..
            } => writeln!(
                text,
                "| {sensors} sensors, {receivers} receivers{} | {:.1} | {:.1} | {} | {frames_received} | {frames_again} | \
                 {frames_lost} | {delay_p50_ms:.1} | {delay_p99_ms:.1} |",
                if *killed { ", hub killed for 5 s" } else { "" },
                events_per_s / 1e6,
                bytes_per_s / 1e6,
                frames * receivers,
            ),
            Row::Simulation {
                sensors,
                hubs,
                receivers,
                seconds,
                events,
                bytes_per_s,
                expected,
                delivered,
                again,
                lost,
                delay_p50_ms,
                delay_p99_ms,
                cores,
                memory_peak_bytes,
                ..
            } => writeln!(
                text,
                "| {sensors} sensors, {hubs} hubs, {receivers} receivers in one process, a hub stopped for 5 s \
                 ({cores:.1} cores, {} MB) | {:.1} | {:.1} | {expected} | {delivered} | {again} | {lost} | \
                 {delay_p50_ms:.1} | {delay_p99_ms:.1} |",
                memory_peak_bytes / 1_000_000,
                *events as f64 / seconds / 1e6,
                bytes_per_s / 1e6,
            ),
        };
    }
    text
}

/// Counts the runs in which something was lost, wrong or inexact.
#[must_use]
pub fn failures(rows: &[Row]) -> usize {
    let is_whole = |row: &&Row| match row {
        Row::Load {
            receivers,
            events_exact,
            frames,
            frames_received,
            frames_lost,
            ..
        } => *events_exact && *frames_lost == 0 && *frames_received == frames * receivers,
        Row::Simulation {
            expected,
            delivered,
            lost,
            wrong,
            ..
        } => delivered == expected && *lost == 0 && *wrong == 0,
    };
    rows.iter().filter(|row| !is_whole(row)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_what_was_printed() {
        let load = r#"{"load":{"killed":true,"sensors":8,"receivers":3,"seconds":20.0,"events":7,"outages":8,
            "events_per_s":16000000,"bytes_per_s":36300000,"events_exact":true,"frames":100,"frames_received":300,
            "frames_again":40,"frames_lost":0,"delay_p50_ms":1.25,"delay_p99_ms":3.31}}"#;
        let simulation = r#"{"simulation":{"sensors":1000,"hubs":10,"receivers":11,"seconds":30.0,
            "events":108000000,"bytes_per_s":8200000.0,"expected":600,"delivered":599,"again":5,"lost":1,"wrong":0,
            "delay_p50_ms":0.8,"delay_p99_ms":40.0,"cores":1.84,"memory_peak_bytes":660000000}}"#;
        let rows: Vec<Row> = [load, simulation]
            .map(|row| serde_json::from_str(row).unwrap())
            .to_vec();
        let text = document(&rows);
        let lines: Vec<&str> = text.lines().skip(2).collect();
        assert_eq!(
            lines,
            [
                "| 8 sensors, 3 receivers, hub killed for 5 s | 16.0 | 36.3 | 300 | 300 | 40 | 0 | 1.2 | 3.3 |",
                "| 1000 sensors, 10 hubs, 11 receivers in one process, a hub stopped for 5 s (1.8 cores, 660 MB) | 3.6 \
                 | 8.2 | 600 | 599 | 5 | 1 | 0.8 | 40.0 |",
            ]
        );
        assert_eq!(failures(&rows), 1);
    }
}
