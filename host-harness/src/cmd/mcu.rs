//! `eecvs mcu`: encodes a recording with the firmware image and compares the frames with the host encoder's.

use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::Args;
use eecvs_cli::job::{self, Account, JobOptions, Prepared};
use eecvs_cli::output::rows;
use eecvs_cli::say;
use eecvs_cli::values::machine;
use mcu_link::image::{self, ImageSizes};
use mcu_link::qemu::{Machine, Qemu};
use mcu_link::{Connection, Outcome, PATIENCE};
use serde::Serialize;

/// Time that an emulator needs to exit.
const END: Duration = Duration::from_millis(200);

/// Encode a recording on an emulated microcontroller and compare its frames with the host's
///
/// Builds the firmware image, starts it in QEMU, sends it the events over the UART and checks that every frame is
/// byte for byte what this program's own encoder makes of the same events. Exits with status 1 if a frame differs
/// or is missing, or an event is unaccounted for.
#[derive(Debug, Args)]
pub struct Mcu {
    /// Machine to emulate
    #[arg(long, value_parser = machine(), default_value = "netduinoplus2")]
    machine: Machine,

    /// Image to run [default: the encoder's image, built by firmware/build.sh]
    #[arg(long, value_name = "ELF")]
    image: Option<PathBuf>,

    #[command(flatten)]
    job: JobOptions,

    /// Print the image's whole log to stderr, not only warnings and errors
    #[arg(long)]
    log: bool,
}

/// What `eecvs mcu` reports; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Report {
    machine: &'static str,
    #[serde(flatten)]
    account: Account,
    instructions_per_event: f64,
    receive_instructions_per_event: f64,
    encode_instructions_per_event: f64,
    send_instructions_per_event: f64,
    flash_bytes: u64,
    ram_bytes: u64,
    stack_bytes: u32,
}

impl Mcu {
    /// Encodes the recording on the emulated machine and prints the comparison.
    ///
    /// # Errors
    /// Fails if QEMU or the image is missing, the recording cannot be read or sent, the encoder refuses or stalls,
    /// frames differ, or events are lost.
    pub fn run(self) -> Result<()> {
        let prepared = self.job.prepare(self.image.as_deref())?;
        let image = match &self.image {
            Some(image) => image.clone(),
            None => {
                image::build(self.machine, "encoder").context("no image; name one with --image")?
            }
        };
        let sizes = ImageSizes::read(&image)?;
        let mut qemu = Qemu::start(self.machine, &image, self.log)?;
        let outcome =
            encode(&mut qemu, &prepared).map_err(|error| self.explain(&mut qemu, error))?;
        drop(qemu);
        // QEMU runs one instruction per nanosecond of the machine's clock.
        let [receive, encode, send] = outcome.ns_per_event();
        let report = Report {
            machine: self.machine.name(),
            account: Account::new(&outcome),
            instructions_per_event: receive + encode + send,
            receive_instructions_per_event: receive,
            encode_instructions_per_event: encode,
            send_instructions_per_event: send,
            flash_bytes: sizes.flash_bytes,
            ram_bytes: sizes.ram_bytes,
            stack_bytes: outcome.status.stack_bytes,
        };
        let place = self.job.place();
        place.tell(self.job.json, &report, || table(&report, &outcome))?;
        outcome.verdict().with_context(|| self.job.name())
    }

    /// Adds to `error` how the emulator ended; without `--log`, prints the latest lines of its log.
    fn explain(&self, qemu: &mut Qemu, error: anyhow::Error) -> anyhow::Error {
        // An emulator that exits closes its link first.
        thread::sleep(END);
        let end = qemu.end();
        if !self.log {
            for line in qemu.log().latest() {
                say!("mcu: {line}");
            }
        }
        match end {
            Some(end) => error.context(end),
            None => error,
        }
    }
}

fn encode(qemu: &mut Qemu, prepared: &Prepared<'_>) -> Result<Outcome> {
    let link = qemu.connect()?;
    prepared.run(&mut Connection::new(&link, PATIENCE)?)
}

/// Formats the report as a table.
fn table(report: &Report, outcome: &Outcome) -> String {
    let mut lines = vec![("machine", format!("{} (emulated)", report.machine))];
    lines.extend(report.account.rows());
    lines.extend(job::times("instructions/event", outcome));
    lines.extend([
        ("flash", format!("{} bytes", report.flash_bytes)),
        ("RAM", format!("{} bytes", report.ram_bytes)),
        ("stack", format!("{} bytes", report.stack_bytes)),
    ]);
    rows(lines)
}
