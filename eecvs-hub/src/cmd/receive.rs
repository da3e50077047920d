//! `eecvs-hub receive`: writes the frames of sensors, received from a hub, into files.

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

/// Receive sensors' frames from a hub, into one file per sensor or only to show statistics; missing frames are
/// requested again
#[derive(Debug, Clone, Args)]
pub struct Receive {
    /// Sensors: door, hall-1/door, or hall-1/** for all in a hall
    #[arg(value_name = "NAMES", default_value = "**", value_parser = |text: &str| names(text))]
    names: Vec<String>,

    #[command(flatten)]
    client: ClientOptions,

    /// Folder for files NAME.eecvs, with dots for slashes; existing files are appended to
    #[arg(long, value_name = "FOLDER")]
    to: Option<PathBuf>,

    /// Take frames as they arrive: those that were missing come after later ones
    #[arg(long)]
    as_they_come: bool,

    /// Also request the frames that sensors still hold from before
    #[arg(long)]
    from_start: bool,

    /// Seconds for which a missing frame may fail to arrive, while its sensor is heard, before it is lost
    #[arg(long, value_name = "S", default_value_t = 60)]
    patience_s: u32,

    /// Maximum size of the queue of arrived messages, and of the frames held until earlier ones arrive, in MiB each
    #[arg(long, value_name = "MIB", default_value_t = 256,
          value_parser = clap::value_parser!(u16).range(1..=16_384))]
    waiting_mib: u16,

    /// End after this many seconds
    #[arg(long, value_name = "S")]
    seconds: Option<u32>,

    /// End after this many seconds without frames, once there was one; if frames are missing, --patience-s later
    #[arg(long, value_name = "S")]
    idle_s: Option<u32>,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// Intervals at which the stop request is checked, and losses are reported.
const LOOK: Duration = Duration::from_millis(100);
const TELL: Duration = Duration::from_secs(5);

impl Receive {
    /// Receives until a stop is requested, or until the set or the idle time is over.
    ///
    /// # Errors
    /// Keys are invalid, or the folder cannot be written.
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

/// What has been reported so far.
#[derive(Default)]
struct Watched {
    told: Option<Instant>,
    lost: u64,
    missing: u64,
    outages: u64,
}

impl Watched {
    /// Prints a line to stderr if something has changed.
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

/// One file per sensor.
struct Files {
    folder: PathBuf,
    open: BTreeMap<Name, BufWriter<File>>,
}

/// Maximum number of files open at once.
const OPEN_MAX: usize = 256;

impl Files {
    fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            open: BTreeMap::new(),
        }
    }

    fn write(&mut self, name: &Name, frame: &[u8]) -> Result<()> {
        // Names contain no dots, so file names are distinct.
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
    /// Returns the report as a table for people to read.
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
