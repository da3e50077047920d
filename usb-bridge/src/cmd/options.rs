//! Flags that several commands share, and the output that they have in common.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use eecvs_cli::codec::CodecOptions;
use eecvs_cli::order::OrderOptions;
use eecvs_cli::output::rows;
use eecvs_nostd::Sensor;
use event_files::output;

use super::warn;
use crate::encoder::{Encoder, Wish};
use crate::peripheral::stream::Pace;
use crate::record::Order;
use crate::session::{Limits, Report, Source};
use crate::source;
use crate::stop::Stop;

/// Flags that select a device.
#[derive(Debug, Clone, Args)]
pub struct PlaceOptions {
    /// Device: usb:BUS-PORT, a serial number or a model, as `list` shows them; serial:PATH for an MCU on a serial
    /// port; replay:FILE.stream; sim:MODEL:FILE for a simulated camera that plays a recording [default: the only
    /// one that is attached]
    #[arg(long, value_name = "ID")]
    device: Option<source::Name>,

    /// Wait until the device is attached
    #[arg(long)]
    wait: bool,

    /// Milliseconds after which an incomplete USB transfer is handed over, as far as it is filled; 0: never [default:
    /// the model's, 100; 0 on QEMU's xHCI, which would lose bytes]
    #[arg(long, value_name = "MS")]
    hand_over_ms: Option<u16>,

    /// Also write every transfer to a file that Wireshark can open
    #[arg(long, value_name = "FILE.pcapng")]
    trace: Option<PathBuf>,
}

impl PlaceOptions {
    /// Returns the name of the device, if one is given.
    #[must_use]
    pub const fn name(&self) -> Option<&source::Name> {
        self.device.as_ref()
    }

    /// Returns the file that is played and the trace file, if they are given.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.file().into_iter().chain(self.trace.as_deref())
    }

    /// Returns whether the trace goes to stdout.
    #[must_use]
    pub fn is_on_stdout(&self) -> bool {
        self.trace.as_deref().is_some_and(output::is_stdout)
    }

    /// Returns the file that is played, if any.
    fn file(&self) -> Option<&Path> {
        match &self.device {
            Some(source::Name::Replay(path) | source::Name::Simulated(_, path)) => Some(path),
            Some(source::Name::Usb(_) | source::Name::Serial(_)) | None => None,
        }
    }

    /// Refuses, before any work is done, a trace file that is also an input or an output, or that exists already.
    ///
    /// # Errors
    /// The trace file is unusable; the message names it.
    pub fn check_trace(&self, overwrite: bool, outputs: &[&Path], inputs: &[&Path]) -> Result<()> {
        let Some(trace) = &self.trace else {
            return Ok(());
        };
        let inputs: Vec<&Path> = inputs.iter().copied().chain(self.file()).collect();
        output::check(trace, output::Kind::Stream, overwrite, &inputs)?;
        for output in outputs {
            ensure!(
                !is_one_place(trace, output),
                "{}: the trace would be the same file as {}: give one of them another name",
                trace.display(),
                output.display()
            );
        }
        Ok(())
    }

    /// Opens the device `name` and identifies it.
    ///
    /// # Errors
    /// No device matches, or it cannot be used; the message says what to do.
    pub fn open(&self, name: Option<&source::Name>, rate: Pace, stop: &Stop) -> Result<Source> {
        let options = source::Options {
            wait: self.wait,
            rate,
            trace: self.trace.clone(),
            hand_over: self.hand_over_ms.map(|ms| Duration::from_millis(ms.into())),
        };
        source::open(name, &options, stop)
    }
}

/// Flags that select a device and set up its stream.
#[derive(Debug, Clone, Args)]
pub struct DeviceOptions {
    #[command(flatten)]
    place: PlaceOptions,

    /// Pace of sim: and replay: devices: real (as recorded), max (as fast as events are taken), N per second, or Fx
    /// (F times as fast as recorded)
    #[arg(long, value_name = "real|max|N|Fx", default_value = "real")]
    rate: Pace,

    /// First set up the encoder (device eecvs) for a sensor of this size, with the options below, and keep its frames
    /// unchanged. Without this flag, an encoder keeps the setup that it has
    #[arg(long, value_name = "WxH", value_parser = size)]
    set_up: Option<Sensor>,
}

impl DeviceOptions {
    /// Opens the device, identifies it, and sets it up according to `codec` if that was requested.
    ///
    /// # Errors
    /// No device matches, it cannot be used, or it refuses the setup; the message says what to do.
    pub fn open(&self, codec: &CodecOptions, stop: &Stop) -> Result<Source> {
        let wish = match self.set_up {
            Some(sensor) => {
                let config = codec.config_of_image(sensor)?;
                Some((config, codec.hot_pixels(sensor)?))
            }
            None => None,
        };
        let source = self.place.open(self.place.name(), self.rate, stop)?;
        match wish {
            Some((config, hot)) => Encoder::begin(source)?.set_up(&Wish { config, hot: &hot }),
            None => Ok(source),
        }
    }

    /// Returns the flags that select the device.
    #[must_use]
    pub const fn place(&self) -> &PlaceOptions {
        &self.place
    }

    /// Returns whether the device is set up to encode by itself, so that its frames are kept unchanged.
    #[must_use]
    pub const fn sets_up(&self) -> bool {
        self.set_up.is_some()
    }
}

/// Returns whether two paths name the same file. Paths of files that do not exist are the same if they have the
/// same name in the same folder.
#[must_use]
pub fn is_one_place(a: &Path, b: &Path) -> bool {
    let place = |path: &Path| {
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
        Some(folder.join(path.file_name()?))
    };
    let places = (place(a), place(b));
    a == b || output::is_same(a, b) || (places.0.is_some() && places.0 == places.1)
}

/// Parses the size of a sensor, such as `346x260`.
fn size(text: &str) -> Result<Sensor, String> {
    let sides = text.split_once('x');
    sides
        .and_then(|(width, height)| Sensor::new(width.parse().ok()?, height.parse().ok()?))
        .ok_or_else(|| {
            format!(
                "expected a size such as 320x320, with sides from 1 to {}",
                Sensor::SIDE_MAX
            )
        })
}

/// Flags that limit a stream and its queue.
#[derive(Debug, Clone, Copy, Args)]
pub struct StreamOptions {
    /// End after this many seconds
    #[arg(long, value_name = "S", value_parser = seconds)]
    duration_s: Option<Duration>,

    /// End after this many events and those that arrive with the last of them
    #[arg(long, value_name = "N")]
    events: Option<u64>,

    /// Queue between the link and the processing, in MiB; when it is full, what arrives is dropped and counted
    #[arg(long, value_name = "MIB", default_value_t = 64,
          value_parser = clap::value_parser!(u16).range(1..=4096))]
    queue_mib: u16,

    /// Print one JSON object instead of the table
    #[arg(long)]
    pub json: bool,
}

/// Parses a time in seconds, such as `0.5`.
pub fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    Duration::try_from_secs_f64(seconds).map_err(|error| error.to_string())
}

impl StreamOptions {
    /// Returns the limits at which the stream ends.
    #[must_use]
    pub const fn limits(&self) -> Limits {
        Limits {
            duration: self.duration_s,
            events: self.events,
        }
    }

    /// Returns the size of the queue after the link, in bytes.
    #[must_use]
    pub const fn queue_bytes(&self) -> usize {
        (self.queue_mib as usize) << 20
    }
}

/// Prints a line on stderr if something was lost.
pub fn warn_of_losses(report: &Report) {
    if report.losses.is_empty() {
        return;
    }
    let losses: Vec<String> = report
        .losses
        .iter()
        .map(|(cause, n)| format!("{cause}: {n}"))
        .collect();
    warn(&format!("{}: lost: {}", report.device, losses.join("; ")));
}

/// Prints a line on stderr if the device's clock restarted.
pub fn warn_of_runs(device: &str, order: &Order) {
    if let Some(line) = runs(order) {
        warn(&format!("{device}: {line}"));
    }
}

/// Returns the line about a clock that restarted; `None` if it did not.
fn runs(order: &Order) -> Option<String> {
    (order.runs > 1).then(|| {
        format!(
            "clock restarts: {}; the output has {} runs and holds all events; if the clock did not \
             restart and events only arrived late, a longer --reorder-us puts them in order",
            order.runs - 1,
            order.runs
        )
    })
}

/// Fails if events came too late; only warns if `options` allow late events.
///
/// # Errors
/// Events are in no frame.
pub fn refuse_late(device: &str, order: &Order, options: OrderOptions) -> Result<()> {
    let late = (order.events_late, order.events);
    options.refuse_late(device, late, "a longer --reorder-us", warn)
}

/// Formats the counts of runs and late events as rows of a table.
#[must_use]
pub fn order_rows(order: &Order) -> String {
    rows([
        ("runs of the clock", order.runs.to_string()),
        ("events late", order.events_late.to_string()),
    ])
}

impl Report {
    /// Formats the report as a table.
    #[must_use]
    pub fn table(&self) -> String {
        let clock = match (self.drift_ppm, self.clock_residual_us) {
            (Some(drift_ppm), Some(residual_us)) => {
                format!("{drift_ppm:+.1} ppm against the host's, within {residual_us:.0} us")
            }
            _ => "relation to the host's unknown".to_owned(),
        };
        let mut table = rows([
            ("device", self.device.clone()),
            ("model", self.model.to_owned()),
            ("firmware", self.firmware.clone()),
            ("sensor", format!("{} x {}", self.width, self.height)),
            ("seconds", format!("{:.3}", self.seconds)),
            ("bytes", self.bytes.to_string()),
            ("transfers", self.transfers.to_string()),
            ("events", self.events.to_string()),
            ("events per second", format!("{:.0}", self.events_per_s)),
            ("device's clock", clock),
            ("queue peak, bytes", self.queue_peak_bytes.to_string()),
            ("processor time, s", format!("{:.2}", self.cpu_s)),
        ]);
        for (title, counts) in [("other words", &self.words), ("lost", &self.losses)] {
            if !counts.is_empty() {
                let counts = counts.iter().map(|(name, n)| (*name, n.to_string()));
                table += &format!("{title}\n");
                for line in rows(counts).lines() {
                    table += &format!("  {line}\n");
                }
            }
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disorder_is_told_with_its_counts() {
        let order = |runs, events_late| Order {
            events: 20,
            runs,
            events_late,
        };
        assert_eq!(runs(&order(1, 0)), None);
        let line = runs(&order(3, 4)).unwrap();
        assert!(
            line.contains("clock restarts: 2;") && line.contains("3 runs"),
            "{line}"
        );
        let late = refuse_late("door", &order(3, 4), OrderOptions::default());
        let late = late.unwrap_err().to_string();
        assert!(late.contains("4 of 20 events"), "{late}");
        let table = order_rows(&order(3, 4));
        assert_eq!(table, "runs of the clock  3\nevents late        4\n");
    }

    #[test]
    fn one_place_is_found_before_it_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("sub")).unwrap();
        assert!(is_one_place(&at("a.raw"), &at("sub/../a.raw")));
        assert!(!is_one_place(&at("a.raw"), &at("sub/a.raw")));
        assert!(!is_one_place(&at("none/a.raw"), &at("gone/a.raw")));
    }
}
