//! `eecvs monitor`: prints density and regime per window, and a histogram.

use std::iter;
use std::num::NonZeroU32;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use eecvs::density_series::{WindowDensity, of_frames, of_recording};
use eecvs::frame_file::{FrameReader, LinkReport};
use eecvs_cli::options::{OutputOptions, ReadingOptions, ThresholdOptions, tell_link};
use eecvs_cli::output::{Place, print};
use eecvs_nostd::{Density, Regime, Thresholds};
use event_files::content::Content;
use event_files::input::piped::{is_stream, name_of};
use event_files::output::{self, Kind, is_same};
use serde_json::json;

use crate::report::chart;

/// Columns of a full bar.
const BAR: usize = 40;
/// Rows of the histogram.
const HISTOGRAM_ROWS: usize = 16;

/// Print density and regime of every window, and a histogram of the densities
#[derive(Debug, Args)]
pub struct Monitor {
    /// Recording or file of frames
    #[arg(value_name = "IN")]
    input: PathBuf,

    /// Duration of a window in microseconds; ignored for a file of frames, which has its own windows
    #[arg(long, value_name = "T", default_value = "32768")]
    window_us: NonZeroU32,

    #[command(flatten)]
    thresholds: ThresholdOptions,

    #[command(flatten)]
    reading: ReadingOptions,

    /// Write the density over time as an SVG chart
    #[arg(long, value_name = "FILE.svg")]
    chart: Option<PathBuf>,

    /// Write the histogram as an SVG chart
    #[arg(long, value_name = "FILE.svg")]
    histogram: Option<PathBuf>,

    #[command(flatten)]
    overwrite: OutputOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

impl Monitor {
    /// Prints the windows and the histogram of their densities, and writes the charts.
    ///
    /// # Errors
    /// Fails if an input cannot be read or a chart cannot be written; also, after printing, if frames are damaged
    /// or missing.
    pub fn run(self) -> Result<()> {
        for chart in self.chart.iter().chain(&self.histogram) {
            let inputs = iter::once(self.input.as_path()).chain(self.thresholds.files());
            self.overwrite.check(chart, Kind::Chart, inputs)?;
        }
        if let (Some(chart), Some(histogram)) = (&self.chart, &self.histogram) {
            ensure!(
                chart != histogram && !is_same(chart, histogram),
                "{}: --chart and --histogram write the same file: give one of them another name",
                chart.display()
            );
        }
        let thresholds = self.thresholds.load()?;
        let name = name_of(&self.input);
        let is_live = is_stream(&self.input) && !self.json;
        let mut rows = Rows::default();
        let mut windows = Vec::new();
        let mut link = LinkReport::default();
        let mut keep = |window| {
            if is_live {
                print(&rows.row(&window, rows.most.max(window.density_per_px_s)))?;
            }
            windows.push(window);
            Ok::<_, anyhow::Error>(())
        };
        match Content::of(&self.input)? {
            Content::Frames(source) => {
                let mut frames = FrameReader::new(source);
                of_frames(&mut frames, thresholds, &mut keep).with_context(|| name.clone())?;
                link = frames.report().clone();
                ensure!(link.frames > 0, "{name}: {}", link.why_empty());
            }
            Content::Recording(recording) => {
                let mut reader = recording.open(&self.reading.reading())?;
                of_recording(reader.as_mut(), self.window_us, thresholds, &mut keep)?;
            }
        }
        let marks = chart_thresholds(thresholds);
        if let Some(path) = &self.chart {
            let svg = chart::density_over_time("Event density", &points(&windows), marks)?.svg;
            output::write(path, svg)?;
        }
        if let Some(path) = &self.histogram {
            let densities: Vec<f64> = windows.iter().map(|w| w.density_per_px_s).collect();
            let svg = chart::density_histogram("Event density", &densities, marks)?.svg;
            output::write(path, svg)?;
        }
        let place = Place::beside(
            self.chart
                .iter()
                .chain(&self.histogram)
                .map(PathBuf::as_path),
        );
        let report = json!({
            "tau_low": marks.tau_low,
            "tau_high": marks.tau_high,
            "windows": windows,
        });
        place.tell(self.json, &report, || {
            // A live source has had its windows printed already.
            let shown = if is_live {
                String::new()
            } else {
                table(&windows)
            };
            shown + &totals(&windows, thresholds)
        })?;
        tell_link(&name, &link)
    }
}

/// Converts the thresholds to events per pixel per second.
#[must_use]
pub fn chart_thresholds(thresholds: Thresholds) -> chart::Thresholds {
    let per_px_s = |pico: u64| pico as f64 / Density::PICO as f64;
    chart::Thresholds {
        tau_low: per_px_s(thresholds.tau_low_pico()),
        tau_high: per_px_s(thresholds.tau_high_pico()),
    }
}

/// Returns the points of the density chart; time starts at the first window.
#[must_use]
pub fn points(windows: &[WindowDensity]) -> Vec<chart::DensityPoint> {
    let start_us = windows.first().map_or(0, |window| window.t0_us);
    windows
        .iter()
        .map(|window| chart::DensityPoint {
            time_s: window.t0_us.saturating_sub(start_us) as f64 * 1e-6,
            density: window.density_per_px_s,
        })
        .collect()
}

fn bar(share: f64) -> String {
    "#".repeat((share * BAR as f64).round() as usize)
}

/// Prints rows of windows, the titles before the first one.
#[derive(Debug, Default)]
struct Rows {
    count: u64,
    /// Largest density so far.
    most: f64,
}

impl Rows {
    /// Formats one window; its bar is full at `full` events per pixel per second.
    fn row(&mut self, window: &WindowDensity, full: f64) -> String {
        let mut text = String::new();
        if self.count == 0 {
            text += &format!(
                "{:>17} {:>9} {:>8} {:>12} {:8} {}\n",
                "t0_us", "dur_us", "events", "ev/px/s", "regime", "transform"
            );
        }
        self.count += 1;
        self.most = self.most.max(window.density_per_px_s);
        if window.empty_before > 0 {
            text += &format!("{:>17} {} empty windows\n", "...", window.empty_before);
        }
        text + &format!(
            "{:>17} {:>9} {:>8} {:>12.4} {:8} {:4} {}\n",
            window.t0_us,
            window.duration_us,
            window.events,
            window.density_per_px_s,
            window.regime.name(),
            window.regime.transform().name(),
            bar(window.density_per_px_s / full.max(f64::MIN_POSITIVE)),
        )
    }
}

fn most(windows: &[WindowDensity]) -> f64 {
    let densities = windows.iter().map(|window| window.density_per_px_s);
    densities.fold(0.0, f64::max)
}

fn table(windows: &[WindowDensity]) -> String {
    let mut rows = Rows::default();
    let full = most(windows);
    let rows = windows.iter().map(|window| rows.row(window, full));
    rows.collect()
}

/// Formats the number of windows per regime, and the histogram of the densities.
fn totals(windows: &[WindowDensity], thresholds: Thresholds) -> String {
    let marks = chart_thresholds(thresholds);
    let mut text = format!(
        "\ntau_low {} tau_high {} events/px/s\n",
        marks.tau_low, marks.tau_high
    );
    for regime in Regime::ALL {
        let count = windows
            .iter()
            .filter(|window| window.regime == regime)
            .count();
        text += &format!("{:8} {count} windows\n", regime.name());
    }
    text + &histogram(windows, most(windows))
}

/// Formats counts of windows in equal steps of density, up to `most`.
fn histogram(windows: &[WindowDensity], most: f64) -> String {
    if most <= 0.0 {
        return String::new();
    }
    let mut counts = [0_usize; HISTOGRAM_ROWS];
    for window in windows {
        let row = (window.density_per_px_s / most * HISTOGRAM_ROWS as f64) as usize;
        counts[row.min(HISTOGRAM_ROWS - 1)] += 1;
    }
    let fullest = counts.iter().copied().max().unwrap_or(1).max(1);
    let mut text = "\nev/px/s from   windows\n".to_owned();
    for (row, count) in counts.iter().enumerate() {
        let from = most * row as f64 / HISTOGRAM_ROWS as f64;
        text += &format!(
            "{from:>12.4} {count:>9} {}\n",
            bar(*count as f64 / fullest as f64)
        );
    }
    text
}
