//! `eecvs-usb mcu`: a recording through an encoder on USB or at a serial port.

use anyhow::{Context, Result, ensure};
use clap::Args;
use host_harness::cmd::job::{self, JobOptions};
use host_harness::cmd::output::{print, print_json, rows};
use host_harness::mcu::{Outcome, PATIENCE};
use serde::Serialize;

use super::options::PlaceOptions;
use crate::device::mcu::NAME;
use crate::encoder::Encoder;
use crate::peripheral::stream::Pace;
use crate::source::Name;
use crate::stop::Stop;

/// Encode a recording on an encoder's microcontroller and compare its frames with the host's
///
/// Sets the encoder up, sends it the events over USB or a serial port, and checks that every frame
/// has the bytes that this program's own encoder makes of the same events. Ends with status 1 if a
/// frame differs or is missing, or an event is unaccounted for. `eecvs mcu` does the same in QEMU.
#[derive(Debug, Args)]
pub struct Mcu {
    #[command(flatten)]
    place: PlaceOptions,

    #[command(flatten)]
    job: JobOptions,
}

/// What it reports; the fields are its JSON keys.
#[derive(Debug, Serialize)]
struct Report {
    device: String,
    firmware: String,
    events: u64,
    windows: u64,
    frames_identical: u64,
    frames_different: u64,
    events_lost: u64,
    /// Of the encoder's own clock.
    ns_per_event: f64,
    stack_bytes: u32,
}

impl Mcu {
    /// Runs the recording and prints what came of it.
    ///
    /// # Errors
    /// A device that cannot be used, a recording that cannot be read or sent, an encoder that refuses
    /// or stalls, frames that differ, events that are lost.
    pub fn run(self) -> Result<()> {
        if let Some(Name::Replay(_) | Name::Simulated(..)) = self.place.name() {
            ensure!(
                false,
                "--device: neither sim: nor replay: takes events: name an encoder on USB or serial:PATH"
            );
        }
        let prepared = self.job.prepare()?;
        let only = Name::Usb(NAME.to_owned());
        let name = self.place.name().unwrap_or(&only);
        // Ctrl-C ends the process: there is nothing to be finished.
        let source = self.place.open(Some(name), Pace::Max, &Stop::default())?;
        let encoder = Encoder::begin(source)?;
        let device = encoder.name();
        let outcome = prepared
            .run(&mut encoder.connect(PATIENCE)?)
            .with_context(|| device.clone())?;
        let report = Report {
            device,
            firmware: encoder.source().info.firmware.clone(),
            events: outcome.events,
            windows: outcome.windows,
            frames_identical: outcome.frames_identical,
            frames_different: outcome.frames_different,
            events_lost: outcome.events_lost,
            ns_per_event: outcome.ns_per_event().iter().sum(),
            stack_bytes: outcome.status.stack_bytes,
        };
        if self.job.json {
            print_json(&report)?;
        } else {
            print(&table(&report, &outcome))?;
        }
        outcome.verdict().with_context(|| self.job.name())
    }
}

/// The report for people.
fn table(report: &Report, outcome: &Outcome) -> String {
    let mut lines = vec![
        ("device", report.device.clone()),
        ("firmware", report.firmware.clone()),
    ];
    lines.extend(job::account(outcome));
    lines.extend(job::times("ns/event, its clock", outcome));
    lines.push(("stack", format!("{} bytes", report.stack_bytes)));
    rows(lines)
}
