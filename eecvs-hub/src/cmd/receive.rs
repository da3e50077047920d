//! `eecvs-hub receive`: writes the frames of sensors, received from a hub, into files.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};
use clap::Args;
use eecvs_cli::output::{print, print_json};
use eecvs_cli::say;
use serde::Serialize;
use usb_bridge::stop::Stop;

use super::files::{Files, Written};
use super::options::ClientOptions;
use crate::downlink::{Deliver, Downlink, Options, Report, SensorReport};
use crate::key::names;

/// Receive sensors' frames from a hub, into one file per sensor or only to show statistics; missing frames are
/// requested again
#[derive(Debug, Clone, Args)]
pub struct Receive {
    /// Sensors: door, hall-1/door, or hall-1/** for all in a hall
    #[arg(value_name = "NAMES", default_value = "**", value_parser = |text: &str| names(text))]
    names: Vec<String>,

    #[command(flatten)]
    client: ClientOptions,

    /// Folder for files NAME.eecvs, with dots for slashes; existing files are appended to. If several sensors send
    /// under one name, the second one's file is NAME~2.eecvs
    #[arg(long, value_name = "FOLDER")]
    to: Option<PathBuf>,

    /// Take frames as they arrive: frames that were missing then come after later ones
    #[arg(long)]
    as_they_come: bool,

    /// Also request the frames that sensors still hold from before
    #[arg(long)]
    from_start: bool,

    /// Seconds after which a missing frame is lost if it has not arrived while its sensor is heard
    #[arg(long, value_name = "S", default_value_t = 60)]
    patience_s: u32,

    /// Maximum size of the queue of arrived messages, and of the frames held until earlier ones arrive, in MiB each
    #[arg(long, value_name = "MIB", default_value_t = 256,
          value_parser = clap::value_parser!(u16).range(1..=16_384))]
    waiting_mib: u16,

    /// End after this many seconds
    #[arg(long, value_name = "S")]
    seconds: Option<u32>,

    /// End after this many seconds without frames, once one has arrived; if frames are missing, --patience-s later
    #[arg(long, value_name = "S")]
    idle_s: Option<u32>,

    /// Exit with 0 even if frames were lost, or several sensors sent under one name
    #[arg(long)]
    allow_loss: bool,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// What was received, and the files in which it is; the fields are the JSON keys.
#[derive(Serialize)]
struct Received<'r> {
    #[serde(flatten)]
    report: &'r Report,
    files: Vec<Written>,
}

/// Intervals at which the stop request is checked, and losses are reported.
const LOOK: Duration = Duration::from_millis(100);
const TELL: Duration = Duration::from_secs(5);

impl Receive {
    /// Receives until a stop is requested, or until the set or the idle time is over.
    ///
    /// # Errors
    /// Keys are invalid, or the folder cannot be written; also, unless that is allowed, if frames were lost or several
    /// sensors sent under one name.
    pub fn run(self, stop: &Stop) -> Result<()> {
        let options = Options {
            names: self.names.clone(),
            as_they_come: self.as_they_come,
            from_start: self.from_start,
            patience: Duration::from_secs(self.patience_s.into()),
            waiting_bytes: usize::from(self.waiting_mib) << 20,
        };
        let mut files = None;
        let deliver: Deliver = match &self.to {
            None => Box::new(|_| Ok(())),
            Some(folder) => {
                fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
                let own = Arc::new(Mutex::new(Files::new(folder)));
                files = Some(Arc::clone(&own));
                Box::new(move |delivered| {
                    let mut files = own.lock().unwrap_or_else(PoisonError::into_inner);
                    files.write(delivered.name, delivered.lane, delivered.frame)
                })
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
            let now = report.sum(|sensor| sensor.frames);
            let missing = report.sum(|sensor| sensor.missing);
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
        watched.tell_names(&report);
        let files = match files {
            None => Vec::new(),
            Some(files) => {
                let mut files = files.lock().unwrap_or_else(PoisonError::into_inner);
                files.finish()?
            }
        };
        match self.json {
            true => print_json(&Received {
                report: &report,
                files,
            })?,
            false => print(&report.table())?,
        }
        let wrong = report.wrong();
        if wrong.is_empty() {
            return Ok(());
        }
        let wrong = wrong.join("; ");
        if !self.allow_loss {
            bail!("{wrong}; with --allow-loss this is not an error");
        }
        say!("eecvs-hub: {wrong}");
        Ok(())
    }
}

/// What has been reported so far.
#[derive(Default)]
struct Watched {
    told: Option<Instant>,
    lost: u64,
    missing: u64,
    outages: u64,
    /// The number of sensors of each name, where there are several.
    at_once: BTreeMap<String, u64>,
}

impl Watched {
    /// Prints a line to stderr for each name under which several sensors send.
    fn tell_names(&mut self, report: &Report) {
        for sensor in report.shared_names() {
            let SensorReport { name, at_once, .. } = sensor;
            if self.at_once.insert(name.clone(), *at_once) != Some(*at_once) {
                say!(
                    "eecvs-hub: {name}: {at_once} sensors send under this name at once, and each is kept apart: give \
                     each a name of its own"
                );
            }
        }
    }

    /// Prints a line to stderr if something has changed.
    fn tell(&mut self, report: &Report) {
        self.tell_names(report);
        if report.outages > self.outages {
            say!("eecvs-hub: the hub does not answer; trying again");
            self.outages = report.outages;
        }
        if self.told.is_some_and(|told| told.elapsed() < TELL) {
            return;
        }
        let lost = report.sum(|sensor| sensor.lost);
        let missing = report.sum(|sensor| sensor.missing);
        if (lost, missing) != (self.lost, self.missing) {
            say!(
                "eecvs-hub: {missing} frames are missing and have been requested, {lost} are lost"
            );
            (self.lost, self.missing) = (lost, missing);
            self.told = Some(Instant::now());
        }
    }
}

impl Report {
    /// Returns the sum of a figure over all sensors.
    fn sum(&self, of: impl Fn(&SensorReport) -> u64) -> u64 {
        self.sensors.iter().map(of).fold(0, u64::saturating_add)
    }

    /// Returns the sensors whose name several sensors have had at once.
    fn shared_names(&self) -> impl Iterator<Item = &SensorReport> {
        self.sensors.iter().filter(|sensor| sensor.at_once > 1)
    }

    /// Returns what went wrong, in words.
    fn wrong(&self) -> Vec<String> {
        let mut wrong = Vec::new();
        let lost = self.sum(|sensor| sensor.lost);
        if lost > 0 {
            wrong.push(format!("{lost} frames are lost"));
        }
        if self.refused > 0 {
            wrong.push(format!(
                "{} messages have no valid name of a sensor, or are from sensors that there is no room for",
                self.refused
            ));
        }
        for sensor in self.shared_names() {
            wrong.push(format!(
                "{}: {} sensors sent under this name at once",
                sensor.name, sensor.at_once
            ));
        }
        wrong
    }

    /// Returns the report as a table for people to read.
    #[must_use]
    pub fn table(&self) -> String {
        let head = [
            "sensor", "frames", "events", "bytes", "again", "before", "missing", "lost", "damaged",
            "p50 ms", "p99 ms",
        ];
        let delay = |ms: Option<f64>| ms.map_or("unknown".to_owned(), |ms| format!("{ms:.2}"));
        let mut lines = vec![head.map(str::to_owned)];
        lines.extend(self.sensors.iter().map(|sensor| {
            [
                sensor.name.clone(),
                sensor.frames.to_string(),
                sensor.events.to_string(),
                sensor.bytes.to_string(),
                sensor.again.to_string(),
                sensor.before.to_string(),
                sensor.missing.to_string(),
                sensor.lost.to_string(),
                sensor.damaged.to_string(),
                delay(sensor.delay_p50_ms),
                delay(sensor.delay_p99_ms),
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
        for sensor in &self.sensors {
            table += &sensor.remarks();
        }
        table
            + &format!(
                "without a link {} times; {} frames found no room at first; {} messages \
                 without a valid name of a sensor, or from sensors that there is no room for\n",
                self.outages, self.no_room, self.refused
            )
    }
}

impl SensorReport {
    /// Returns lines about what is unusual of the sensor's clock and name.
    fn remarks(&self) -> String {
        let Self { name, .. } = self;
        let mut remarks = String::new();
        match self.clock {
            Some(clock) if clock.is_different() => {
                let side = if clock.ahead_us > 0 {
                    "ahead of"
                } else {
                    "behind"
                };
                remarks += &format!(
                    "{name}: its clock is {:.3} s {side} this computer's, within {:.1} ms: the \
                     delays are corrected for this\n",
                    clock.ahead_us.unsigned_abs() as f64 * 1e-6,
                    clock.error_us as f64 * 1e-3,
                );
            }
            None if self.frames > 0 => {
                remarks +=
                    &format!("{name}: its clock did not answer, so the delays are unknown\n");
            }
            _ => {}
        }
        if self.at_once > 1 {
            remarks += &format!(
                "{name}: {} sensors sent under this name at once\n",
                self.at_once
            );
        }
        remarks
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::{Ahead, RoundTrip};

    fn sensor(name: &str, ahead_us: Option<i64>) -> SensorReport {
        let clock = ahead_us.and_then(|ahead_us| {
            let mut ahead = Ahead::default();
            ahead.add(RoundTrip {
                run: 1,
                asked_us: 5_000_000_000,
                shown_us: 5_000_000_200_u64.saturating_add_signed(ahead_us),
                answered_us: 5_000_000_400,
            });
            ahead.at(5_000_000_400)
        });
        SensorReport {
            name: name.to_owned(),
            frames: 9,
            at_once: 1,
            delay_p50_ms: clock.map(|_| 1.5),
            delay_p99_ms: clock.map(|_| 2.5),
            clock,
            ..SensorReport::default()
        }
    }

    #[test]
    fn the_table_says_what_delays_are_of() {
        let report = Report {
            sensors: vec![
                sensor("ahead", Some(3_600_000_000)),
                sensor("behind", Some(-1_500_000)),
                sensor("right", Some(100)),
                sensor("silent", None),
            ],
            ..Report::default()
        };
        let table = report.table();
        for line in [
            "ahead: its clock is 3600.000 s ahead of this computer's, within 0.2 ms: the delays \
             are corrected for this",
            "behind: its clock is 1.500 s behind this computer's, within 0.2 ms: the delays are \
             corrected for this",
            "silent: its clock did not answer, so the delays are unknown",
        ] {
            assert!(table.lines().any(|other| other == line), "{line}: {table}");
        }
        assert!(!table.contains("right: "), "{table}");
        let cells = |name: &str| {
            let line = table.lines().find(|line| line.starts_with(name)).unwrap();
            let cells: Vec<&str> = line.split_whitespace().collect();
            [cells[cells.len() - 2], cells[cells.len() - 1]].map(str::to_owned)
        };
        assert_eq!(cells("right"), ["1.50", "2.50"]);
        assert_eq!(cells("silent "), ["unknown", "unknown"]);
        assert!(report.wrong().is_empty());
    }

    #[test]
    fn losses_and_shared_names_are_wrong() {
        let mut door = sensor("door", Some(0));
        (door.lost, door.at_once) = (3, 2);
        let report = Report {
            sensors: vec![door, sensor("gate", Some(0))],
            refused: 4,
            ..Report::default()
        };
        assert_eq!(
            report.wrong(),
            [
                "3 frames are lost",
                "4 messages have no valid name of a sensor, or are from sensors that there is no room for",
                "door: 2 sensors sent under this name at once"
            ]
        );
        assert!(
            report
                .table()
                .contains("door: 2 sensors sent under this name at once\n")
        );
    }
}
