//! `eecvs-hub receive`: frames of sensors, from a hub into files.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use clap::Args;
use eecvs_cli::output::{print, print_json};
use usb_bridge::stop::Stop;

use super::options::ClientOptions;
use crate::downlink::{Deliver, Downlink, Options, Report};
use crate::key::{Name, names};

/// Take sensors' frames from a hub, into a file for each or to see what comes; frames that are missing are asked for
/// again
#[derive(Debug, Clone, Args)]
pub struct Receive {
    /// Sensors: door, hall-1/door, all of a hall by hall-1/**
    #[arg(value_name = "NAMES", default_value = "**", value_parser = |text: &str| names(text))]
    names: Vec<String>,

    #[command(flatten)]
    client: ClientOptions,

    /// A folder for files NAME.eecvs, with dots for slashes; what is there already is gone on with
    #[arg(long, value_name = "FOLDER")]
    to: Option<PathBuf>,

    /// Take frames as they come: those that were missing come behind later ones
    #[arg(long)]
    as_they_come: bool,

    /// Ask for what sensors still have of before, too
    #[arg(long)]
    from_start: bool,

    /// What is missing, and does not come for so many seconds while its sensor is heard, is lost
    #[arg(long, value_name = "S", default_value_t = 60)]
    patience_s: u32,

    /// Bytes that wait to be taken, and for others before them, in MiB each
    #[arg(long, value_name = "MIB", default_value_t = 256,
          value_parser = clap::value_parser!(u16).range(1..=16_384))]
    waiting_mib: u16,

    /// End after so many seconds
    #[arg(long, value_name = "S")]
    seconds: Option<u32>,

    /// End after so many seconds without frames, when something is missing after as many more as --patience-s; of none at
    /// all, never
    #[arg(long, value_name = "S")]
    idle_s: Option<u32>,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// How often it is looked whether to stop, and losses are told.
const LOOK: Duration = Duration::from_millis(100);
const TELL: Duration = Duration::from_secs(5);

impl Receive {
    /// Receives until it is to stop.
    ///
    /// # Errors
    /// Keys, or a folder that cannot be written.
    pub fn run(self, stop: &Stop) -> Result<()> {
        let options = Options {
            names: self.names.clone(),
            as_they_come: self.as_they_come,
            from_start: self.from_start,
            patience: Duration::from_secs(self.patience_s.into()),
            waiting_bytes: usize::from(self.waiting_mib) << 20,
        };
        let deliver: Deliver = match &self.to {
            None => Box::new(|_| Ok(())),
            Some(folder) => {
                fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
                let mut files = Files::new(folder);
                Box::new(move |delivered| files.write(delivered.name, delivered.frame))
            }
        };
        let downlink = Downlink::start(options, &self.client.links(), deliver)?;
        let started = Instant::now();
        let seconds = |s: Option<u32>| s.map(|s| Duration::from_secs(s.into()));
        let (most, idle) = (seconds(self.seconds), seconds(self.idle_s));
        let (mut frames, mut latest) = (0, Instant::now());
        let mut watched = Watched::default();
        while !stop.is_asked() && !downlink.has_ended() {
            thread::sleep(LOOK);
            let report = downlink.report()?;
            watched.tell(&report);
            let now: u64 = report.sensors.iter().map(|sensor| sensor.frames).sum();
            let missing: u64 = report.sensors.iter().map(|sensor| sensor.missing).sum();
            if now != frames {
                (frames, latest) = (now, Instant::now());
            }
            let more = match missing {
                0 => Duration::ZERO,
                _ => Duration::from_secs(self.patience_s.into()),
            };
            let is_idle = frames > 0 && idle.is_some_and(|idle| latest.elapsed() >= idle + more);
            if is_idle || most.is_some_and(|most| started.elapsed() >= most) {
                break;
            }
        }
        let report = downlink.finish()?;
        if self.json {
            return print_json(&report);
        }
        print(&report.table())
    }
}

/// What was said.
#[derive(Default)]
struct Watched {
    told: Option<Instant>,
    lost: u64,
    missing: u64,
    outages: u64,
}

impl Watched {
    /// One line on stderr where something has changed.
    fn tell(&mut self, report: &Report) {
        if report.outages > self.outages {
            eprintln!("eecvs-hub: the hub does not answer; it is tried again");
            self.outages = report.outages;
        }
        if self.told.is_some_and(|told| told.elapsed() < TELL) {
            return;
        }
        let lost = report.sensors.iter().map(|sensor| sensor.lost).sum();
        let missing = report.sensors.iter().map(|sensor| sensor.missing).sum();
        if (lost, missing) != (self.lost, self.missing) {
            eprintln!("eecvs-hub: {missing} frames are missing and asked for, {lost} are lost");
            (self.lost, self.missing) = (lost, missing);
            self.told = Some(Instant::now());
        }
    }
}

/// A file for each sensor.
struct Files {
    folder: PathBuf,
    open: BTreeMap<Name, BufWriter<File>>,
}

/// Files that are open at once.
const OPEN_MAX: usize = 256;

impl Files {
    fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            open: BTreeMap::new(),
        }
    }

    fn write(&mut self, name: &Name, frame: &[u8]) -> Result<()> {
        // A name has no dots.
        let path = || {
            self.folder
                .join(format!("{}.eecvs", name.as_str().replace('/', ".")))
        };
        if !self.open.contains_key(name) {
            if self.open.len() >= OPEN_MAX
                && let Some((_, mut oldest)) = self.open.pop_first()
            {
                oldest
                    .flush()
                    .with_context(|| self.folder.display().to_string())?;
            }
            let file = OpenOptions::new().create(true).append(true).open(path());
            let file = file.with_context(|| path().display().to_string())?;
            self.open.insert(name.clone(), BufWriter::new(file));
        }
        match self.open.get_mut(name) {
            Some(file) => file
                .write_all(frame)
                .with_context(|| path().display().to_string()),
            None => Ok(()),
        }
    }
}

impl Report {
    /// For people.
    #[must_use]
    pub fn table(&self) -> String {
        let head = [
            "sensor", "frames", "events", "bytes", "again", "missing", "lost", "damaged", "p50 ms",
            "p99 ms",
        ];
        let mut lines = vec![head.map(str::to_owned)];
        lines.extend(self.sensors.iter().map(|sensor| {
            [
                sensor.name.clone(),
                sensor.frames.to_string(),
                sensor.events.to_string(),
                sensor.bytes.to_string(),
                sensor.again.to_string(),
                sensor.missing.to_string(),
                sensor.lost.to_string(),
                sensor.damaged.to_string(),
                format!("{:.2}", sensor.delay_p50_ms),
                format!("{:.2}", sensor.delay_p99_ms),
            ]
        }));
        let width = |column: usize| {
            lines
                .iter()
                .map(|line| line[column].len())
                .max()
                .unwrap_or(0)
        };
        let widths: Vec<usize> = (0..head.len()).map(width).collect();
        let mut table = String::new();
        for line in &lines {
            for (column, (cell, &width)) in line.iter().zip(&widths).enumerate() {
                match column {
                    0 => table += &format!("{cell:<width$}"),
                    _ => table += &format!("  {cell:>width$}"),
                }
            }
            table.push('\n');
        }
        table
            + &format!(
                "without a link {} times; {} frames found no room at first; {} messages of no sensor\n",
                self.outages, self.no_room, self.refused
            )
    }
}
