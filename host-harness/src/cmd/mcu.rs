//! `eecvs mcu`: a recording through the firmware image, compared with the host's encoder.

use std::path::PathBuf;
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use clap::Args;
use eecvs_nostd::{Event, Sensor};
use serde::Serialize;

use super::encode::CodecOptions;
use super::options::SizeOptions;
use super::output::{print, print_json, rows};
use crate::formats::{self, EventReader, Skipped};
use crate::mcu::image::{self, ImageSizes};
use crate::mcu::qemu::{Machine, Qemu};
use crate::mcu::{self, Connection, Job, Outcome, PATIENCE};
use crate::progress::Progress;
use crate::scene::{Preset, SceneConfig, emulate};

/// What is encoded unless a recording is given: a few windows of a small sensor, of every regime.
const SCENE: SceneConfig = SceneConfig {
    preset: Preset::OutdoorWellLitBlur,
    sensor: Sensor {
        width: 128,
        height: 96,
    },
    duration_us: 130_000,
    start_us: 0,
    seed: 3,
};

/// Time that an emulator takes to end.
const END: Duration = Duration::from_millis(200);

/// Encode a recording on an emulated microcontroller and compare its frames with the host's
///
/// Builds the firmware image, starts it in QEMU, sends it the events over the UART and checks that
/// every frame has the bytes that this program's own encoder makes of the same events. Ends with
/// status 1 if a frame differs or is missing, or an event is unaccounted for.
#[derive(Debug, Args)]
pub struct Mcu {
    /// Recording to encode [default: a small seeded scene]
    #[arg(value_name = "IN")]
    input: Option<PathBuf>,

    /// Machine to emulate
    #[arg(long, value_enum, default_value = "netduinoplus2")]
    machine: Machine,

    /// Image to run [default: the encoder's, built by firmware/build.sh]
    #[arg(long, value_name = "ELF")]
    image: Option<PathBuf>,

    #[command(flatten)]
    codec: CodecOptions,

    #[command(flatten)]
    size: SizeOptions,

    /// Encode the first N events alone
    #[arg(long, value_name = "N")]
    events: Option<u64>,

    /// Let the encoder drop and count events while it has no room, rather than hold the link; then
    /// frames are unpacked and events accounted for, but not compared
    #[arg(long)]
    drop_when_full: bool,

    /// Print the image's whole log to stderr, not only warnings and errors
    #[arg(long)]
    log: bool,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// What `eecvs mcu` reports; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Report {
    machine: &'static str,
    events: u64,
    windows: u64,
    frames_identical: u64,
    frames_different: u64,
    events_lost: u64,
    instructions_per_event: f64,
    flash_bytes: u64,
    ram_bytes: u64,
    stack_bytes: u32,
}

/// The first events of a recording.
struct First {
    reader: Box<dyn EventReader>,
    left: u64,
}

impl EventReader for First {
    fn format(&self) -> &'static str {
        self.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.reader.sensor()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        if self.left == 0 {
            return Ok(0);
        }
        let before = events.len();
        let read = self.reader.read(events)? as u64;
        let taken = read.min(self.left);
        self.left -= taken;
        events.truncate(before + taken as usize);
        Ok(taken as usize)
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }
}

impl Mcu {
    /// Runs the recording and prints what came of it.
    ///
    /// # Errors
    /// No QEMU, no image, a recording that cannot be read or sent, an encoder that refuses or
    /// stalls, frames that differ, events that are lost.
    pub fn run(self) -> Result<()> {
        let open = || self.open();
        let reader = open()?;
        let sensor = reader.sensor();
        let (_, config) = self.codec.look(reader, self.codec.config(sensor)?);
        ensure!(
            !config.keep_order,
            "--keep-order is for eecvs encode: the image has no memory for it"
        );
        let job = Job {
            open: &open,
            config,
            hot: &self.codec.hot_pixels(sensor)?,
            drop_when_full: self.drop_when_full,
        };
        let image = match &self.image {
            Some(image) => image.clone(),
            None => {
                image::build(self.machine, "encoder").context("no image; --image names another")?
            }
        };
        let sizes = ImageSizes::read(&image)?;
        let mut qemu = Qemu::start(self.machine, &image, self.log)?;
        let outcome = self
            .encode(&mut qemu, &job)
            .map_err(|error| self.explain(&mut qemu, error))?;
        drop(qemu);
        let report = Report {
            machine: self.machine.name(),
            events: outcome.events,
            windows: outcome.windows,
            frames_identical: outcome.frames_identical,
            frames_different: outcome.frames_different,
            events_lost: outcome.events_lost,
            // One instruction takes a nanosecond of the machine's time.
            instructions_per_event: outcome.ns_per_event().iter().sum(),
            flash_bytes: sizes.flash_bytes,
            ram_bytes: sizes.ram_bytes,
            stack_bytes: outcome.status.stack_bytes,
        };
        if self.json {
            print_json(&report)?;
        } else {
            print(&table(&report, &outcome))?;
        }
        outcome.verdict().with_context(|| self.name())
    }

    /// What messages call the recording.
    fn name(&self) -> String {
        self.input.as_ref().map_or_else(
            || format!("{}, seed {}", SCENE.preset.name(), SCENE.seed),
            |input| input.display().to_string(),
        )
    }

    fn open(&self) -> Result<Box<dyn EventReader>> {
        let reader = match &self.input {
            Some(input) => formats::open(input, self.size.sensor())?,
            None => Box::new(emulate(SCENE)?),
        };
        Ok(match self.events {
            Some(left) => Box::new(First { reader, left }),
            None => reader,
        })
    }

    fn encode(&self, qemu: &mut Qemu, job: &Job<'_>) -> Result<Outcome> {
        let link = qemu.connect()?;
        let mut connection = Connection::new(&link, PATIENCE)?;
        let progress = Progress::new("events sent");
        mcu::run(&mut connection, job, &|events| progress.set(events)).with_context(|| self.name())
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

/// The report for people.
fn table(report: &Report, outcome: &Outcome) -> String {
    let [receive, encode, send] = outcome.ns_per_event();
    let status = &outcome.status;
    let compared = |frames: u64| match outcome.compared {
        true => frames.to_string(),
        false => "not compared".to_owned(),
    };
    rows([
        ("machine", format!("{} (emulated)", report.machine)),
        ("hot pixels", status.hot_pixels.to_string()),
        ("events", report.events.to_string()),
        ("  encoded", outcome.events_encoded.to_string()),
        ("  late", outcome.events_late.to_string()),
        ("  filtered", outcome.events_filtered.to_string()),
        (
            "  left out by the rate control",
            outcome.events_thinned.to_string(),
        ),
        ("  lost", report.events_lost.to_string()),
        ("windows", report.windows.to_string()),
        ("  events at most", status.window_events.to_string()),
        ("frames", outcome.frames.to_string()),
        ("  identical", compared(report.frames_identical)),
        ("  different", compared(report.frames_different)),
        (
            "instructions/event",
            format!("{:.1}", report.instructions_per_event),
        ),
        ("  receive", format!("{receive:.1}")),
        ("  encode", format!("{encode:.1}")),
        ("  send", format!("{send:.1}")),
        ("flash", format!("{} bytes", report.flash_bytes)),
        ("RAM", format!("{} bytes", report.ram_bytes)),
        ("stack", format!("{} bytes", report.stack_bytes)),
    ])
}
