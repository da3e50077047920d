//! `eecvs mcu`: a recording through the firmware image, compared with the host's encoder.

use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::Args;
use eecvs_cli::job::{self, Account, JobOptions, Prepared};
use eecvs_cli::output::rows;
use eecvs_cli::values::machine;
use mcu_link::image::{self, ImageSizes};
use mcu_link::qemu::{Machine, Qemu};
use mcu_link::{Connection, Outcome, PATIENCE};
use serde::Serialize;

/// Time that an emulator takes to end.
const END: Duration = Duration::from_millis(200);

/// Encode a recording on an emulated microcontroller and compare its frames with the host's
///
/// Builds the firmware image, starts it in QEMU, sends it the events over the UART and checks that
/// every frame has the bytes that this program's own encoder makes of the same events. Ends with
/// status 1 if a frame differs or is missing, or an event is unaccounted for.
#[derive(Debug, Args)]
pub struct Mcu {
    /// Machine to emulate
    #[arg(long, value_parser = machine(), default_value = "netduinoplus2")]
    machine: Machine,

    /// Image to run [default: the encoder's, built by firmware/build.sh]
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
    /// Runs the recording and prints what came of it.
    ///
    /// # Errors
    /// No QEMU, no image, a recording that cannot be read or sent, an encoder that refuses or
    /// stalls, frames that differ, events that are lost.
    pub fn run(self) -> Result<()> {
        let prepared = self.job.prepare()?;
        let image = match &self.image {
            Some(image) => image.clone(),
            None => {
                image::build(self.machine, "encoder").context("no image; --image names another")?
            }
        };
        let sizes = ImageSizes::read(&image)?;
        let mut qemu = Qemu::start(self.machine, &image, self.log)?;
        let outcome =
            encode(&mut qemu, &prepared).map_err(|error| self.explain(&mut qemu, error))?;
        drop(qemu);
        // One instruction takes a nanosecond of the machine's time.
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

    /// Adds what the emulator and the image have to say.
    fn explain(&self, qemu: &mut Qemu, error: anyhow::Error) -> anyhow::Error {
        // An emulator that ends closes the link first.
        thread::sleep(END);
        let end = qemu.end();
        if !self.log {
            for line in qemu.log().latest() {
                eprintln!("mcu: {line}");
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

/// The report for people.
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
