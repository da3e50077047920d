//! `eecvs encode`: encodes a recording into frames.

use std::fs::Metadata;
use std::iter;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use eecvs::encode::{Codec, EncodeSummary, all_cores, duration, encode, encode_nothing};
use eecvs_cli::codec::{CodecOptions, KernelName, LimitOptions};
use eecvs_cli::memory::look_for;
use eecvs_cli::options::{FollowOptions, OutputOptions, ReadingOptions, tell_damage};
use eecvs_cli::order::{SortOptions, tell_disorder};
use eecvs_cli::output::{Place, frame_file, rows, usage};
use eecvs_cli::progress::Progress;
use event_files::Intact;
use event_files::findings::Findings;
use event_files::input::growing::open_growing;
use event_files::input::piped::{is_stream, name_of};
use event_files::output::Kind;
use serde::Serialize;

/// Encode a recording into frames
#[derive(Debug, Args)]
pub struct Encode {
    /// Recording to encode
    #[arg(value_name = "IN")]
    input: PathBuf,

    /// File of frames to write
    #[arg(short, long, value_name = "OUT.eecvs")]
    output: PathBuf,

    #[command(flatten)]
    codec: CodecOptions,

    /// hybrid: instead of --window-us, the duration from some 4 ms to 2 s that takes the fewest bytes for the recording's
    /// first events, 262,144 if it has as many; a pipe is read that far before anything is written
    #[arg(long, conflicts_with = "window_us")]
    auto_window: bool,

    /// Kernel that computes the coefficients of the DCT and the DTFT; the Haar transform has a single, exact
    /// kernel. The decoder need not know the kernel: coefficients differ only by the kernel's error
    #[arg(long, value_enum, value_name = "NAME", default_value = "table")]
    kernel: KernelName,

    #[command(flatten)]
    limits: LimitOptions,

    #[command(flatten)]
    sort: SortOptions,

    #[command(flatten)]
    follow: FollowOptions,

    #[command(flatten)]
    reading: ReadingOptions,

    /// Number of encoding threads; the frames do not depend on it [default: the number of cores; 1 if IN is a pipe,
    /// so that no window waits for later ones]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,

    #[command(flatten)]
    overwrite: OutputOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

impl Encode {
    /// Encodes, writes the frames and prints a summary.
    ///
    /// # Errors
    /// Fails if the recording or a settings file cannot be read, the output cannot be written, or, unless loss is
    /// allowed, if events came too late to be in a frame.
    pub fn run(self) -> Result<()> {
        let inputs = iter::once(self.input.as_path()).chain(self.codec.files());
        self.overwrite.check(&self.output, Kind::Frames, inputs)?;
        let reading = self.reading.reading();
        let follow = self.follow.follow()?;
        let reader = match &follow {
            Some(follow) => open_growing(&self.input, &reading, follow)?,
            None => event_files::open(&self.input, &reading)?,
        };
        look_for(reader.sensor(), &name_of(&self.input))?;
        let config = self.codec.config_of_file(reader.sensor())?;
        ensure!(
            !self.auto_window || duration::is_free(&config),
            usage("--auto-window is for --mode hybrid, without --bins and --bytes-per-second")
        );
        let reader = self.sort.apply(reader)?;
        let (reader, config) = self.codec.look(reader, config);
        let hot = self.codec.hot_pixels(reader.sensor())?;
        let codec = Codec {
            hot: &hot,
            budget: None,
            config,
            kernel: self.kernel.kernel(),
            max_nmse: self.codec.max_nmse(),
        };
        let limits = self.limits.limits();
        let (reader, codec) = if self.auto_window {
            let chosen = duration::look(reader, codec, limits, self.threads());
            let (reader, mut config) = chosen.context("--auto-window")?;
            config.key_windows = self.codec.key_windows(config.window.window_us);
            (reader, Codec { config, ..codec })
        } else {
            (reader, codec)
        };
        let mut reader = Intact::new(reader);
        let mut out = frame_file(&self.output)?;
        let progress = Progress::new("events");
        let mut summary = encode(
            &mut reader,
            codec,
            limits,
            self.threads(),
            &mut out,
            &mut |events| {
                progress.set(events);
            },
        )?;
        drop(progress);
        let findings = Findings::of(&reader);
        let damage = reader.damage().map(|error| format!("{error:#}"));
        if summary.frames == 0 && damage.is_none() {
            encode_nothing(codec, limits, &mut out, &mut summary)?;
        }
        summary.set_bytes_out(out.bytes());
        let out = out.finish()?;
        let output = match damage {
            Some(_) if summary.events_in == 0 => {
                return tell_damage(damage.as_deref(), None, &self.output, false);
            }
            Some(_) if follow.is_none() => out.finish_incomplete()?,
            _ => out.finish().map(|()| self.output.clone())?,
        };
        let window_us = codec.config.window.window_us;
        let report = Report::new(&self.input, &output, window_us, &summary, findings);
        let place = Place::beside([self.output.as_path()]);
        place.tell(self.json, &report, || report.table())?;
        tell_damage(
            damage.as_deref(),
            Some(&output),
            &self.output,
            follow.is_some(),
        )?;
        tell_disorder(&self.input, &summary, self.limits.order)
    }
}

impl Encode {
    /// Returns the number asked for. The default for a pipe is one, so that no window waits for later ones.
    fn threads(&self) -> NonZeroUsize {
        let asked = self
            .threads
            .and_then(|threads| NonZeroUsize::new(threads.into()));
        asked.unwrap_or_else(|| {
            if is_stream(&self.input) {
                NonZeroUsize::MIN
            } else {
                all_cores()
            }
        })
    }
}

/// What `eecvs encode` reports; the fields are its JSON keys.
#[derive(Debug, Serialize)]
struct Report<'c> {
    input: String,
    output: String,
    /// Size of the input in bytes, if it is a regular file.
    bytes_in: Option<u64>,
    /// `bytes_in` / `bytes_out`.
    ratio: Option<f64>,
    /// Duration of the windows.
    window_us: u32,
    #[serde(flatten)]
    summary: &'c EncodeSummary,
    events_exact: u64,
    bits_per_encoded_event: f64,
    #[serde(flatten)]
    findings: Findings,
}

impl<'c> Report<'c> {
    fn new(
        input: &Path,
        output: &Path,
        window_us: u32,
        summary: &'c EncodeSummary,
        findings: Findings,
    ) -> Self {
        let metadata = std::fs::metadata(input).ok().filter(Metadata::is_file);
        let bytes_in = metadata.map(|metadata| metadata.len());
        Self {
            input: input.display().to_string(),
            output: output.display().to_string(),
            bytes_in,
            ratio: bytes_in
                .filter(|_| summary.bytes_out > 0)
                .map(|bytes_in| bytes_in as f64 / summary.bytes_out as f64),
            window_us,
            summary,
            events_exact: summary.events_exact(),
            bits_per_encoded_event: summary.bits_per_encoded_event(),
            findings,
        }
    }

    /// Formats the report as a table.
    fn table(&self) -> String {
        let summary = self.summary;
        let count = |count: u64| count.to_string();
        let mut table = vec![
            ("input", self.input.clone()),
            ("output", self.output.clone()),
        ];
        if let Some((bytes_in, ratio)) = self.bytes_in.zip(self.ratio) {
            table.push(("bytes in", count(bytes_in)));
            table.push((
                "bytes out",
                format!("{}, 1 of {ratio:.2}", summary.bytes_out),
            ));
        } else {
            table.push(("bytes out", count(summary.bytes_out)));
        }
        table.extend([
            ("events in", count(summary.events_in)),
            ("  encoded", count(summary.events_encoded)),
            ("    with exact times", count(self.events_exact)),
            ("  late", count(summary.events_late)),
            ("  filtered", count(summary.events_filtered)),
            ("  dropped", count(summary.events_dropped)),
            (
                "  left out by the rate control",
                count(summary.events_thinned),
            ),
            ("runs", count(summary.runs)),
            ("windows", count(summary.windows)),
            ("  duration", format!("{} us", self.window_us)),
        ]);
        // Only windows coded as coefficients have a transform.
        if summary.windows_as_coefficients > 0 {
            table.extend([
                ("  dct", count(summary.windows_dct)),
                ("  dtft", count(summary.windows_dtft)),
                ("  dwt", count(summary.windows_dwt)),
                ("levels saturated", count(summary.levels_saturated)),
            ]);
        }
        table.extend([
            ("  closed early", count(summary.windows_truncated)),
            ("  in the order of input", count(summary.windows_in_order)),
            ("frames", count(summary.frames)),
            ("bits per event", format!("{:.2}", summary.bits_per_event)),
        ]);
        if summary.events_encoded != summary.events_in {
            let bits = format!("{:.2}", self.bits_per_encoded_event);
            table.push(("bits per encoded event", bits));
        }
        if summary.bytes_order > 0 {
            let bits = format!("{:.3}", summary.order_bits_per_event());
            table.push(("  for the order", bits));
        }
        let speed = summary.events_per_s / 1e6;
        table.extend([
            (
                "encoding",
                format!("{:.3} s, {speed:.2} million events/s", summary.encode_s),
            ),
            ("  threads", summary.threads.to_string()),
            (
                "with reading and writing",
                format!("{:.3} s", summary.wall_s),
            ),
        ]);
        table.extend(self.findings.rows());
        rows(table)
    }
}
