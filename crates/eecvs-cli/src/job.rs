//! Sending a recording through an encoder: the flags and the report shared by `eecvs mcu` and `eecvs-usb mcu`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use eecvs::frame_file::FrameSink;
use eecvs_nostd::{Config, Event, Scan, Sensor, scan};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::content::Rereadable;
use event_files::input::piped::name_of;
use event_files::output::Kind;
use event_files::{EventReader, Skipped};
use event_types::stream::Error;
use mcu_link::{Connection, Job, Outcome};
use serde::Serialize;

use crate::codec::CodecOptions;
use crate::options::{OutputOptions, ReadingOptions};
use crate::output::{Place, frame_file};
use crate::progress::Progress;

/// Scene encoded if no recording is given: a few windows of a small sensor, covering every regime.
const SCENE: SceneConfig = SceneConfig {
    sensor: Sensor {
        width: 128,
        height: 96,
    },
    duration_us: 130_000,
    ..SceneConfig::model_1(Preset::OutdoorWellLitBlur, 3)
};

/// The recording and how it is encoded.
#[derive(Debug, Args)]
pub struct JobOptions {
    /// Recording to encode [default: a small seeded scene]
    #[arg(value_name = "IN")]
    input: Option<PathBuf>,

    /// File for the frames received from the encoder
    #[arg(short, long, value_name = "OUT.eecvs")]
    pub output: Option<PathBuf>,

    #[command(flatten)]
    codec: CodecOptions,

    #[command(flatten)]
    reading: ReadingOptions,

    /// Encode only the first N events
    #[arg(long, value_name = "N")]
    events: Option<u64>,

    /// Let the encoder drop and count events while it has no room, instead of blocking the link; frames are then
    /// unpacked and events accounted for, but not compared
    #[arg(long)]
    drop_when_full: bool,

    /// Whether an existing output may be replaced.
    #[command(flatten)]
    pub overwrite: OutputOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    pub json: bool,
}

/// A reader limited to the first events of a recording.
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

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
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

/// A recording that has been opened and checked, with the configuration for it.
pub struct Prepared<'o> {
    options: &'o JobOptions,
    recording: Option<Rereadable>,
    config: Config,
    hot: Vec<(u16, u16)>,
}

impl JobOptions {
    /// Opens the recording and derives the configuration, before any encoder is started; `files` are further inputs of
    /// the command.
    ///
    /// # Errors
    /// A recording that cannot be read, an output that cannot be written, or options that an encoder on a
    /// microcontroller does not support.
    pub fn prepare<'f>(
        &'f self,
        files: impl IntoIterator<Item = &'f Path>,
    ) -> Result<Prepared<'f>> {
        if let Some(output) = &self.output {
            let inputs = self.inputs().chain(files);
            self.overwrite.check(output, Kind::Frames, inputs)?;
        }
        let recording = match &self.input {
            Some(input) => Some(Rereadable::of(input)?),
            None => None,
        };
        let reader = self.open(recording.as_ref())?;
        let sensor = reader.sensor();
        let config = self.codec.config_of_image(sensor)?;
        let (_, config) = self.codec.look(reader, config);
        Ok(Prepared {
            options: self,
            recording,
            config,
            hot: self.codec.hot_pixels(sensor)?,
        })
    }

    /// Returns the files that are read.
    pub fn inputs(&self) -> impl Iterator<Item = &Path> {
        let input = self.input.iter().map(PathBuf::as_path);
        input.chain(self.codec.files())
    }

    /// Returns the name of the recording for messages.
    #[must_use]
    pub fn name(&self) -> String {
        self.input.as_ref().map_or_else(
            || format!("{}, seed {}", SCENE.preset.name(), SCENE.seed),
            |input| name_of(input),
        )
    }

    /// Returns where to print the report.
    #[must_use]
    pub fn place(&self) -> Place {
        Place::beside(self.output.iter().map(PathBuf::as_path))
    }

    fn open(&self, recording: Option<&Rereadable>) -> Result<Box<dyn EventReader>> {
        let reader = match recording {
            Some(recording) => recording.open(self.reading.reading())?,
            None => Box::new(emulate(SCENE)?),
        };
        Ok(match self.events {
            Some(left) => Box::new(First { reader, left }),
            None => reader,
        })
    }
}

impl Prepared<'_> {
    /// Sends the recording to an encoder, receives its frames, and saves them if an output was given.
    ///
    /// # Errors
    /// A recording that cannot be read or sent, an encoder that refuses or stalls, a link that fails, or a file that
    /// cannot be written. Frames that differ and events that are lost are not errors here, see [`Outcome::verdict`].
    pub fn run(&self, connection: &mut Connection) -> Result<Outcome> {
        let options = self.options;
        let open = || {
            let opened = options.open(self.recording.as_ref());
            opened.map_err(Error::other)
        };
        let job = Job {
            open: &open,
            config: self.config,
            hot: &self.hot,
            drop_when_full: options.drop_when_full,
        };
        let progress = Progress::new("events sent");
        let outcome = mcu_link::run(connection, &job, &|events| progress.set(events))
            .with_context(|| options.name())?;
        if let Some(path) = &options.output {
            let (mut out, mut rest) = (frame_file(path)?, outcome.bytes.as_slice());
            while let Scan::Frame(frame) = scan(rest) {
                let (bytes, after) = rest.split_at(frame.bytes);
                out.frame(&frame.header, bytes)?;
                rest = after;
            }
            out.finish()?.finish()?;
        }
        Ok(outcome)
    }
}

/// Counts of events and frames; the fields are the JSON keys, one for each row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Account {
    hot_pixels: u32,
    events: u64,
    events_encoded: u64,
    events_late: u64,
    events_filtered: u64,
    events_thinned: u64,
    events_lost: u64,
    windows: u64,
    window_events: u32,
    frames: u64,
    /// `None` if the host has no frames to compare with.
    frames_identical: Option<u64>,
    frames_different: Option<u64>,
    /// Why the encoder had started again; `None` if its power came.
    last_restart: Option<String>,
}

impl Account {
    /// Creates the account of an encoder's run.
    #[must_use]
    pub fn new(outcome: &Outcome) -> Self {
        let compared = |frames: u64| outcome.compared.then_some(frames);
        Self {
            hot_pixels: outcome.status.hot_pixels,
            events: outcome.events,
            events_encoded: outcome.events_encoded,
            events_late: outcome.events_late,
            events_filtered: outcome.events_filtered,
            events_thinned: outcome.events_thinned,
            events_lost: outcome.events_lost,
            windows: outcome.windows,
            window_events: outcome.status.window_events,
            frames: outcome.frames,
            frames_identical: compared(outcome.frames_identical),
            frames_different: compared(outcome.frames_different),
            last_restart: mcu_link::restart(&outcome.status),
        }
    }

    /// Returns the rows of the printed table.
    #[must_use]
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let compared = |frames: Option<u64>| {
            frames.map_or_else(|| "not compared".to_owned(), |frames| frames.to_string())
        };
        vec![
            ("hot pixels", self.hot_pixels.to_string()),
            ("events", self.events.to_string()),
            ("  encoded", self.events_encoded.to_string()),
            ("  late", self.events_late.to_string()),
            ("  filtered", self.events_filtered.to_string()),
            (
                "  left out by the rate control",
                self.events_thinned.to_string(),
            ),
            ("  lost", self.events_lost.to_string()),
            ("windows", self.windows.to_string()),
            ("  events at most", self.window_events.to_string()),
            ("frames", self.frames.to_string()),
            ("  identical", compared(self.frames_identical)),
            ("  different", compared(self.frames_different)),
            (
                "last restart",
                self.last_restart.as_deref().unwrap_or("none").to_owned(),
            ),
        ]
    }
}

/// Returns the rows of the encoder's time per event in ns, with the sum under `title`, for the printed table.
#[must_use]
pub fn times(title: &'static str, outcome: &Outcome) -> Vec<(&'static str, String)> {
    let [receive, encode, send] = outcome.ns_per_event();
    vec![
        (title, format!("{:.1}", receive + encode + send)),
        ("  receive", format!("{receive:.1}")),
        ("  encode", format!("{encode:.1}")),
        ("  send", format!("{send:.1}")),
    ]
}
