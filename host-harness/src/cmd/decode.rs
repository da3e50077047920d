//! `eecvs decode`: decodes frames to events and volumes.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use eecvs::decode::{DecodeSummary, WindowReader, decode};
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::reconstruct::volume::Maker;
use eecvs_cli::memory::look_for;
use eecvs_cli::options::{
    FormatOptions, OutputOptions, TimeOptions, WindowLimitOptions, WorkLimitOptions,
    tell_confidences, tell_link,
};
use eecvs_cli::output::{Place, rows};
use eecvs_cli::progress::Progress;
use eecvs_cli::values::finder;
use eecvs_cli::volume::VolumeOptions;
use event_files::input::piped::{name_of, open_bytes};
use event_files::output::{Kind, is_dash, is_same};

use crate::volume_file::{VolumeFile, times_of};

/// Decode frames into events, a coefficient volume or a volume of time bins
#[derive(Debug, Args)]
pub struct Decode {
    /// File of frames
    #[arg(value_name = "IN.eecvs")]
    input: PathBuf,

    /// Recording to write; the extension names the format
    #[arg(short, long, value_name = "OUT", required_unless_present = "volume")]
    output: Option<PathBuf>,

    /// How to find event times in the coefficients of the DCT and the DTFT (mode transform)
    #[arg(long, value_parser = finder(), value_name = "HOW", default_value = "exact")]
    events: Finder,

    /// Write the float32 C x H x W volume of one window: its coefficients, or its time bins with --bins. An .npz
    /// also holds the window's t0_us and duration_us
    #[arg(long, value_name = "V.npy|V.npz")]
    volume: Option<PathBuf>,

    #[command(flatten)]
    times: TimeOptions,

    /// Number of the window whose volume is written, from 0; windows without events, or outside of the times, are not
    /// counted
    #[arg(long, value_name = "I", requires = "volume", default_value = "0")]
    window: u64,

    /// Write the volumes of all windows as one array, T x C x H x W, with their times: inside the .npz, or beside
    /// the .npy in NAME.times.npy, T x 2
    #[arg(long, requires = "volume", conflicts_with = "window")]
    all_windows: bool,

    #[command(flatten)]
    form: VolumeOptions,

    #[command(flatten)]
    window_limit: WindowLimitOptions,

    #[command(flatten)]
    work_limit: WorkLimitOptions,

    #[command(flatten)]
    format: FormatOptions,

    #[command(flatten)]
    overwrite: OutputOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

impl Decode {
    /// Decodes, writes the outputs and prints a summary.
    ///
    /// # Errors
    /// Fails if a file cannot be read or holds no frame, the window does not exist, or an output cannot be written.
    /// Also fails if frames are damaged or missing, but then the outputs hold everything else.
    pub fn run(self) -> Result<()> {
        self.times.check("eecvs decode");
        let name = name_of(&self.input);
        let volume = self.volume.as_deref();
        // Times that an earlier run left beside an array are not of this one's only window.
        let times = volume.and_then(|volume| times_of(volume, true));
        let times = times.filter(|times| self.all_windows || times.exists());
        for volume in [volume, times.as_deref()].into_iter().flatten() {
            let output = self.output.as_deref();
            ensure!(
                output.is_none_or(|output| output != volume && !is_same(output, volume)),
                "{}: -o and --volume write the same file: give one of them another name",
                volume.display()
            );
        }
        let outputs = [
            (&self.output, self.format.kind()),
            (&self.volume, Kind::Volume),
            (&times, Kind::Volume),
        ];
        for (output, kind) in outputs {
            if let Some(output) = output {
                self.overwrite.check(output, kind, [self.input.as_path()])?;
            }
        }
        let format = match &self.output {
            Some(output) => Some(self.format.of(output)?),
            None => None,
        };
        let mut volumes = match &self.volume {
            Some(path) => Some(VolumeFile::new(path, self.all_windows)?),
            None => {
                self.form.refuse()?;
                None
            }
        };
        let events = || EventDecoder::new(self.events).with_work_limit(self.work_limit.limit());
        let mut maker = Maker::new(self.form.form(), events());
        let windows = WindowReader::new(FrameReader::new(open_bytes(&self.input)?));
        let mut windows = windows.with_limit(self.window_limit.limit());
        if let Some(times) = self.times.times() {
            windows = windows.within(times.clone());
            // Stdin may be a file that is to be read from its middle on.
            if !is_dash(&self.input) {
                windows.seek(times)?;
            }
        }
        let progress = Progress::new("events");
        let summary = decode(
            &mut windows,
            events(),
            &mut |sensor| match self.output.as_ref().zip(format) {
                Some((path, format)) => event_files::create_as(path, format, sensor).map(Some),
                None => Ok(None),
            },
            &mut |index, window| {
                let header = &window.header;
                if index == 0 {
                    look_for(header.sensor, &name).map_err(event_types::stream::Error::other)?;
                }
                match &mut volumes {
                    Some(volumes) if self.all_windows || index == self.window => volumes
                        .append(&maker.volume(window)?, header.t0_us, header.duration_us)
                        .map_err(event_types::stream::Error::other),
                    _ => Ok(()),
                }
            },
            &mut |events| progress.set(events),
        );
        drop(progress);
        let mut summary = summary?;
        // Times may have been found for the events, for the volumes, or for both.
        let over = &mut summary.confidences.pixels_over_work_limit;
        *over = (*over).max(maker.confidences().pixels_over_work_limit);
        if summary.link.frames == 0 {
            bail!("{name}: {}", summary.link.why_empty());
        }
        if let Some(volumes) = volumes {
            ensure!(
                !volumes.is_empty(),
                "{name}: there is no window {}: the file has {}, counted from 0",
                self.window,
                summary.windows
            );
            volumes.finish()?;
            if let Some(times) = times.filter(|_| !self.all_windows) {
                std::fs::remove_file(&times)
                    .with_context(|| format!("{}: cannot be removed", times.display()))?;
            }
        }
        let outputs = [&self.output, &self.volume].into_iter().flatten();
        let place = Place::beside(outputs.map(PathBuf::as_path));
        place.tell(self.json, &summary, || table(&summary))?;
        tell_confidences(&name, &summary.confidences);
        tell_link(&name, &summary.link)
    }
}

/// Formats the summary as a table.
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
        (
            "  beyond the work limit",
            summary.confidences.pixels_over_work_limit.to_string(),
        ),
        ("frames lost", summary.link.frames_lost.to_string()),
        ("damaged bytes", summary.link.damaged_bytes.to_string()),
        (
            "frames without an end mark",
            summary.link.frames_unmarked.to_string(),
        ),
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
