//! `eecvs-hub simulate`: a fleet in one process.

use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use eecvs_cli::output::{print, print_json, rows};
use eecvs_cli::say;
use eecvs_nostd::Sensor;
use usb_bridge::stop::Stop;

use crate::simulation::{Options, Outcome, simulate};

/// Run many sensors, hubs and receivers in one process, over encrypted links on this computer, stop a hub for a
/// while, and check every frame that is received
#[derive(Debug, Clone, Args)]
pub struct Simulate {
    /// Number of sensors
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    sensors: u32,

    /// Number of hubs
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    hubs: u32,

    /// How long the sensors send, in seconds
    #[arg(long, value_name = "S", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    seconds: u32,

    /// How long the last hub is stopped, in seconds, after a third of the time; 0: not at all
    #[arg(long, value_name = "S", default_value_t = 5)]
    outage_s: u32,

    /// Columns of the sensors
    #[arg(long, value_name = "W", default_value_t = 32, value_parser = clap::value_parser!(u16).range(1..=2048))]
    width: u16,

    /// Rows of the sensors
    #[arg(long, value_name = "H", default_value_t = 24, value_parser = clap::value_parser!(u16).range(1..=2048))]
    height: u16,

    /// Duration of a window, which makes one frame, in microseconds
    #[arg(long, value_name = "T", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1000..=10_000_000))]
    window_us: u32,

    /// Seed of the scenes
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

impl Simulate {
    /// Runs the simulation, and prints the result.
    ///
    /// # Errors
    /// Something cannot be started, or a frame was lost or differed from the one sent.
    pub fn run(self, stop: &Stop) -> Result<()> {
        let sensor = Sensor::new(self.width, self.height);
        let Some(sensor) = sensor else {
            anyhow::bail!("{} x {}: not a valid sensor size", self.width, self.height);
        };
        let options = Options {
            sensors: self.sensors as usize,
            hubs: self.hubs as usize,
            duration: Duration::from_secs(self.seconds.into()),
            outage: Duration::from_secs(self.outage_s.into()),
            sensor,
            window_us: self.window_us,
            seed: self.seed,
        };
        ensure!(
            self.outage_s == 0 || self.seconds / 3 + self.outage_s < self.seconds,
            "an outage of {} s that begins after a third of {} s does not end in time: give more --seconds",
            self.outage_s,
            self.seconds
        );
        let folder =
            std::env::temp_dir().join(format!("eecvs-hub-simulate-{}", std::process::id()));
        let outcome = simulate(options, &folder, stop, &mut |line| {
            say!("eecvs-hub: {line}");
        });
        let removed = std::fs::remove_dir_all(&folder);
        let outcome = outcome?;
        if removed.is_err() {
            say!("eecvs-hub: {}: cannot be removed", folder.display());
        }
        match self.json {
            true => print_json(&outcome)?,
            false => print(&outcome.table())?,
        }
        ensure!(
            stop.is_asked() || outcome.is_whole(),
            "of {} frames, {} were received as they were sent and {} were wrong",
            outcome.expected,
            outcome.delivered,
            outcome.wrong
        );
        Ok(())
    }
}

impl Outcome {
    /// Returns whether every frame was received, once and as it was sent.
    #[must_use]
    pub const fn is_whole(&self) -> bool {
        self.delivered == self.expected && self.wrong == 0 && self.lost == 0
    }

    fn table(&self) -> String {
        let delay = |ms: Option<f64>| ms.map_or("not measured".to_owned(), |ms| format!("{ms:.2}"));
        rows([
            (
                "sensors, hubs, receivers",
                format!("{}, {}, {}", self.sensors, self.hubs, self.receivers),
            ),
            ("connected in, s", format!("{:.1}", self.connecting_s)),
            ("seconds", format!("{:.1}", self.seconds)),
            ("frames sent", self.frames.to_string()),
            ("  per second", format!("{:.0}", self.frames_per_s)),
            ("events", self.events.to_string()),
            ("bytes", self.bytes.to_string()),
            ("  per second", format!("{:.0}", self.bytes_per_s)),
            ("frames expected", self.expected.to_string()),
            ("  received as they were sent", self.delivered.to_string()),
            ("  of these, requested again", self.again.to_string()),
            ("  wrong", self.wrong.to_string()),
            ("  lost", self.lost.to_string()),
            ("links that failed", self.outages.to_string()),
            ("last frame after the end, s", format!("{:.2}", self.late_s)),
            ("delay, median, ms", delay(self.delay_p50_ms)),
            ("  99th percentile", delay(self.delay_p99_ms)),
            ("  longest", delay(self.delay_max_ms)),
            ("cores", format!("{:.2}", self.cores)),
            ("memory, MiB", (self.memory_peak_bytes >> 20).to_string()),
        ])
    }
}
