//! `eecvs decode`: frames to events and volumes.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use clap::Args;

use super::output::{print, print_json, rows};
use crate::decode::{DecodeSummary, WindowReader, decode};
use crate::formats;
use crate::frame_file::FrameReader;
use crate::npy::write_planes;
use crate::output_file::{refuse_same_file, remove_partial};
use crate::progress::Progress;
use crate::reconstruct::bins::Bins;
use crate::reconstruct::events::Finder;
use crate::reconstruct::{DecodedWindow, volume};

/// Decode frames into events, a coefficient volume or a volume of time bins
#[derive(Debug, Args)]
pub struct Decode {
    /// File of frames
    #[arg(value_name = "IN.eecvs")]
    input: PathBuf,

    /// Recording to write; the extension names the format
    #[arg(short, long, value_name = "OUT", required_unless_present = "volume")]
    output: Option<PathBuf>,

    /// How event times are found in the coefficients of the DCT and the DTFT (mode transform)
    #[arg(long, value_enum, value_name = "HOW", default_value = "exact")]
    events: Finder,

    /// Write the float32 C x H x W volume of one window: its coefficients, or with --bins its
    /// inverse transform
    #[arg(long, value_name = "V.npy")]
    volume: Option<PathBuf>,

    /// Which window the volume is of, from 0
    #[arg(long, value_name = "I", requires = "volume", default_value = "0")]
    window: u64,

    /// Sample the inverse transform in B time bins instead of writing coefficients
    #[arg(long, value_name = "B", requires = "volume",
          value_parser = clap::value_parser!(u16).range(1..=4096))]
    bins: Option<u16>,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

impl Decode {
    /// Decodes and prints what was done.
    ///
    /// # Errors
    /// A file that cannot be read or holds no frame, a window that is not there, an output that
    /// cannot be written.
    pub fn run(self) -> Result<()> {
        let name = self.input.display();
        for output in self.output.iter().chain(&self.volume) {
            refuse_same_file(&self.input, output)?;
        }
        ensure!(
            self.output.is_none() || self.output != self.volume,
            "{}: -o and --volume are the same file: give one of them another name",
            self.output.as_deref().unwrap_or(&self.input).display()
        );
        let mut windows = WindowReader::new(FrameReader::open(&self.input)?);
        let mut volume_written = false;
        let mut created = false;
        let progress = Progress::new("events");
        let summary = decode(
            &mut windows,
            self.events,
            &mut |sensor| match &self.output {
                Some(path) => {
                    let writer = formats::create(path, sensor)?;
                    created = true;
                    Ok(Some(writer))
                }
                None => Ok(None),
            },
            &mut |index, window| match &self.volume {
                Some(path) if index == self.window => {
                    volume_written = true;
                    write_volume(path, window, self.bins)
                }
                _ => Ok(()),
            },
            &mut |events| progress.set(events),
        );
        drop(progress);
        if summary.is_err() && created {
            self.output.iter().for_each(|path| remove_partial(path));
        }
        let summary = summary?;
        if summary.link.frames == 0 {
            bail!("{name}: no frame found; is it a file that `eecvs encode` wrote?");
        }
        if let Some(warning) = summary.link.warning() {
            eprintln!("eecvs: {name}: {warning}");
        }
        ensure!(
            volume_written || self.volume.is_none(),
            "{name}: there is no window {}: the file has {}, counted from 0",
            self.window,
            summary.windows
        );
        if self.json {
            print_json(&summary)
        } else {
            print(&table(&summary))
        }
    }
}

fn write_volume(path: &Path, window: &DecodedWindow, bins: Option<u16>) -> Result<()> {
    let window = &window.with_pixels()?;
    let sensor = window.header.sensor;
    let (height, width) = (usize::from(sensor.height), usize::from(sensor.width));
    match bins {
        Some(count) => {
            let count = usize::from(count);
            let bins = Bins::new(window.header.transform, window.header.grid, count);
            write_planes(path, [count, height, width], &mut |bin, plane| {
                bins.plane(window, bin, plane);
            })
        }
        None => write_planes(
            path,
            [window.channels(), height, width],
            &mut |channel, plane| {
                volume::plane(window, channel, plane);
            },
        ),
    }
}

/// The summary for people.
fn table(summary: &DecodeSummary) -> String {
    rows([
        ("frames", summary.link.frames.to_string()),
        ("runs", summary.counts.runs.to_string()),
        ("windows", summary.windows.to_string()),
        (
            "  in the order of input",
            summary.counts.windows_in_order.to_string(),
        ),
        (
            "  whose order is lost",
            summary.counts.windows_order_lost.to_string(),
        ),
        ("events", summary.events.to_string()),
        (
            "  late at the encoder",
            summary.counts.events_late.to_string(),
        ),
        ("  filtered", summary.counts.events_filtered.to_string()),
        ("  dropped", summary.counts.events_dropped.to_string()),
        (
            "  left out by the rate control",
            summary.counts.events_thinned.to_string(),
        ),
        ("pixels exact", summary.confidences.pixels_exact.to_string()),
        (
            "  consistent",
            summary.confidences.pixels_consistent.to_string(),
        ),
        (
            "  approximate",
            summary.confidences.pixels_approximate.to_string(),
        ),
        ("frames lost", summary.link.frames_lost.to_string()),
        ("damaged bytes", summary.link.damaged_bytes.to_string()),
        (
            "decoding",
            format!(
                "{:.3} s, {:.2} million events/s",
                summary.decode_s,
                summary.events_per_s / 1e6
            ),
        ),
    ])
}
