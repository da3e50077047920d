//! `eecvs-usb mcu`: runs a recording through an encoder on USB or on a serial port.

use anyhow::{Context, Result, ensure};
use clap::Args;
use eecvs_cli::job::{self, Account, JobOptions};
use eecvs_cli::output::rows;
use mcu_link::{Outcome, PATIENCE};
use serde::Serialize;

use super::options::PlaceOptions;
use crate::device::mcu::NAME;
use crate::encoder::Encoder;
use crate::peripheral::stream::Pace;
use crate::source::Name;
use crate::stop::Stop;

/// Encode a recording on an encoder's microcontroller and compare its frames with the host's
///
/// Sets the encoder up, sends it the events over USB or a serial port, and checks that every frame is identical to
/// the one that this program's own encoder makes of the same events. Exits with status 1 if a frame differs or is
/// missing, or an event is unaccounted for. `eecvs mcu` does the same in QEMU.
#[derive(Debug, Args)]
pub struct Mcu {
    #[command(flatten)]
    place: PlaceOptions,

    #[command(flatten)]
    job: JobOptions,
}

/// Report of a run; the fields are the JSON keys, one for every row of the table.
#[derive(Debug, Serialize)]
struct Report {
    device: String,
    firmware: String,
    #[serde(flatten)]
    account: Account,
    /// Measured with the encoder's own clock.
    ns_per_event: f64,
    receive_ns_per_event: f64,
    encode_ns_per_event: f64,
    send_ns_per_event: f64,
    stack_bytes: u32,
}

impl Report {
    fn new(device: String, firmware: String, outcome: &Outcome) -> Self {
        let [receive, encode, send] = outcome.ns_per_event();
        Self {
            device,
            firmware,
            account: Account::new(outcome),
            ns_per_event: receive + encode + send,
            receive_ns_per_event: receive,
            encode_ns_per_event: encode,
            send_ns_per_event: send,
            stack_bytes: outcome.status.stack_bytes,
        }
    }
}

impl Mcu {
    /// Runs the recording and prints the report.
    ///
    /// # Errors
    /// The device cannot be used, the recording cannot be read or sent, the encoder refuses or stalls, frames
    /// differ, or events are lost.
    pub fn run(self) -> Result<()> {
        if let Some(Name::Replay(_) | Name::Simulated(..)) = self.place.name() {
            ensure!(
                false,
                "--device: sim: and replay: devices take no events: name an encoder on USB, or serial:PATH"
            );
        }
        let output = self.job.output.as_deref();
        self.place.check_trace(
            self.job.overwrite.overwrite,
            &output.into_iter().collect::<Vec<_>>(),
            &self.job.inputs().collect::<Vec<_>>(),
        )?;
        let prepared = self.job.prepare([])?;
        let only = Name::Usb(NAME.to_owned());
        let name = self.place.name().unwrap_or(&only);
        // Ctrl-C may end the process at once: nothing needs to be finished.
        let source = self.place.open(Some(name), Pace::Max, &Stop::default())?;
        let encoder = Encoder::begin(source)?;
        let device = encoder.name();
        let outcome = prepared
            .run(&mut encoder.connect(PATIENCE)?)
            .with_context(|| device.clone())?;
        let firmware = encoder.source().info.firmware.clone();
        let report = Report::new(device, firmware, &outcome);
        let place = self.job.place();
        place.tell(self.job.json, &report, || table(&report, &outcome))?;
        outcome.verdict().with_context(|| self.job.name())
    }
}

/// Formats the report as a table.
fn table(report: &Report, outcome: &Outcome) -> String {
    let mut lines = vec![
        ("device", report.device.clone()),
        ("firmware", report.firmware.clone()),
    ];
    lines.extend(report.account.rows());
    lines.extend(job::times("ns/event, by its clock", outcome));
    lines.push(("stack", format!("{} bytes", report.stack_bytes)));
    rows(lines)
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::event_link::Status;

    use super::*;

    #[test]
    fn json_has_every_row_of_the_table() {
        let outcome = Outcome {
            events: 1001,
            windows: 1002,
            frames: 1003,
            compared: true,
            frames_identical: 1004,
            frames_different: 1005,
            events_encoded: 1006,
            events_late: 1007,
            events_filtered: 1008,
            events_thinned: 1009,
            events_lost: 1010,
            status: Status {
                hot_pixels: 1011,
                window_events: 1012,
                events: 1,
                receive_ns: 1013,
                encode_ns: 1014,
                send_ns: 1015,
                stack_bytes: 1016,
                ..Status::default()
            },
            bytes: Vec::new(),
            problems: Vec::new(),
        };
        let report = Report::new("place".to_owned(), "0.1.0".to_owned(), &outcome);
        let serde_json::Value::Object(json) = serde_json::to_value(&report).unwrap() else {
            unreachable!();
        };
        let values: Vec<String> = json
            .values()
            .map(|value| match value {
                serde_json::Value::Null => "none".to_owned(),
                value => value.to_string(),
            })
            .collect();
        let table = table(&report, &outcome);
        assert_eq!(table.lines().count(), values.len(), "{table}{json:?}");
        for line in table.lines() {
            let value = line.trim_end_matches(" bytes").rsplit(' ').next().unwrap();
            let quoted = format!("\"{value}\"");
            assert!(
                values
                    .iter()
                    .any(|other| other == value || *other == quoted),
                "{line}"
            );
        }
    }
}
