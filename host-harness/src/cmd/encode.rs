//! `eecvs encode`: a recording to frames.

use std::fs::Metadata;
use std::iter;
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use eecvs_nostd::{
    Coder, Config, Fidelity, Filter, Hybrid, KEY_WINDOWS, Kernel, Mode, OUTPUT_BYTES_MIN,
    Quantiser, Region, Sensor, Transform, WindowConfig,
};
use serde::Serialize;

use super::options::{FollowOptions, OutputOptions, ReadingOptions, ThresholdOptions, tell_damage};
use super::order::{OrderOptions, SortOptions, tell_disorder};
use super::output::{Place, rows};
use crate::encode::step::quantiser_within;
use crate::encode::{Codec, EncodeSummary, Limits, all_cores, encode, readout};
use crate::formats::findings::Findings;
use crate::formats::growing::open_growing;
use crate::formats::intact::Intact;
use crate::formats::piped::is_stream;
use crate::formats::{self, EventReader};
use crate::hot_pixels;
use crate::output::{Kind, OutputFile};
use crate::progress::Progress;

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

    /// Kernel that computes the coefficients of the DCT and the DTFT; the Haar transform has one
    /// alone, which is exact. A decoder need not know: coefficients differ by the kernel's error
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

    /// Threads that encode; the frames do not depend on it [default: as many as there
    /// are cores; 1 where IN is a pipe, whose windows then do not wait for those behind them]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,

    #[command(flatten)]
    overwrite: OutputOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// How windows are encoded.
#[derive(Debug, Clone, Args)]
pub struct CodecOptions {
    /// What frames hold
    #[arg(long, value_enum, default_value = "hybrid")]
    mode: ModeName,

    /// hybrid: no decoded time is off by more than D microseconds [default: 0, lossless]
    #[arg(long, value_name = "D", conflicts_with = "bins")]
    time_tolerance_us: Option<u32>,

    /// hybrid: only the volume of B bins in time is exact
    #[arg(long, value_name = "B", value_parser = clap::value_parser!(u16).range(1..))]
    bins: Option<u16>,

    /// How events or coefficients become bits [default: fast in mode hybrid, plain in mode transform]
    #[arg(long, value_enum)]
    coder: Option<CoderName>,

    /// dense: windows after which a frame can be decoded without those before it
    #[arg(long, value_name = "N", default_value_t = KEY_WINDOWS,
          value_parser = clap::value_parser!(u16).range(1..=256))]
    key_windows: u16,

    /// hybrid, dense: for sensors that scan, such as DVXplorers, tell times by their scans; auto finds
    /// out from the first events how
    #[arg(long, value_enum, default_value = "auto")]
    scans: ScanName,

    /// Send only the pixels of a rectangle: first column and row, columns, rows
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    region: Option<Region>,

    /// Never send the pixels of a text file of lines x,y
    #[arg(long, value_name = "FILE")]
    hot_pixels: Option<PathBuf>,

    /// Leave out events that are alone: no other in their pixel and its eight neighbours in the window
    #[arg(long)]
    isolated: bool,

    /// hybrid: decode events of equal time in the order of the input, for 0.01 to 1.5 bits per event more.
    /// With a tolerance or bins, equal is what is decoded as equal; with a budget, where there is room
    #[arg(long)]
    keep_order: bool,

    /// hybrid: no second of frames takes more than B bytes. What does not fit is degraded step by step
    /// (tolerances, then bins, then events that are alone, then every second, fourth, ... event), and
    /// each frame says how; one thread encodes
    #[arg(long, value_name = "B")]
    bytes_per_second: Option<NonZeroU32>,

    /// Transform of every window; auto takes the one of its density's regime
    #[arg(long, value_enum, default_value = "auto")]
    transform: TransformName,

    /// Coefficients kept per pixel
    #[arg(short, value_name = "M", default_value = "16",
          value_parser = clap::value_parser!(u8).range(1..=64))]
    m: u8,

    /// Size of the transform's grid [default: M for the DCT, 2M for the others]; the DWT rounds it
    /// up to a power of two
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u16).range(1..=1024))]
    grid: Option<u16>,

    /// log2 of the quantiser's step
    #[arg(long, value_name = "S", default_value = "-6", allow_negative_numbers = true,
          value_parser = clap::value_parser!(i8).range(-15..=8))]
    step_log2: i8,

    /// Largest error of a kept coefficient, of re and im each: takes the largest step that keeps it. The
    /// kernel's own error, up to 2^-14 per event in the pixel, comes on top
    #[arg(long, value_name = "E", conflicts_with = "step_log2")]
    max_error: Option<f64>,

    /// Duration of a window in microseconds
    #[arg(long, value_name = "T", default_value = "32768")]
    window_us: NonZeroU32,

    /// Begin windows at T + i window-us microseconds, for whole i, so that those of several sensors match
    /// [default: with the first event]
    #[arg(long, value_name = "T")]
    origin_us: Option<u64>,

    /// Send a frame for a window without events too, up to 65,536 in a row: 20 to 40 bytes that say that the sensor
    /// is there
    #[arg(long)]
    every_window: bool,

    #[command(flatten)]
    thresholds: ThresholdOptions,
}

/// How large windows and frames may be.
#[derive(Debug, Clone, Copy, Args)]
pub struct LimitOptions {
    /// Events that a window holds before it closes early
    #[arg(long, value_name = "N", default_value_t = crate::encode::WINDOW_EVENTS as u32,
          value_parser = clap::value_parser!(u32).range(1..=eecvs_nostd::window::EVENTS_MAX as i64))]
    window_events: u32,

    /// Largest frame in bytes; a window that needs more takes several frames
    #[arg(long, value_name = "BYTES", default_value_t = eecvs_nostd::FRAME_BYTES_MAX as u32,
          value_parser = clap::value_parser!(u32)
              .range(OUTPUT_BYTES_MIN as i64..=eecvs_nostd::FRAME_BYTES_MAX as i64))]
    frame_bytes: u32,

    /// What is done about times that run back.
    #[command(flatten)]
    pub order: OrderOptions,
}

/// A mode on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ModeName {
    /// The events, as exactly as is asked; --transform, -m and --grid are then those of the volume
    /// that is decoded from them
    Hybrid,
    /// Every active pixel as its kept coefficients
    Transform,
}

/// A coder of events or coefficients on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum CoderName {
    /// transform: codes that do not adapt, as a microcontroller sends coefficients
    Plain,
    /// For speed; every frame decodes by itself
    Fast,
    /// For size; frames go on from those before, up to the next key frame
    Dense,
}

/// Whether times are told by scans, on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ScanName {
    /// Where they lie on a grid
    Auto,
    /// Never
    Off,
}

/// A transform on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TransformName {
    /// By the window's density
    Auto,
    /// Cosine transform
    Dct,
    /// Fourier transform
    Dtft,
    /// Haar wavelet transform
    Dwt,
}

/// A kernel on the command line, with its error of a coefficient per event in the pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum KernelName {
    /// The encoder's own and the fastest: within 2^-14 per event in the pixel
    Table,
    /// Chebyshev recurrence in fixed point: 2^-16
    Recurrence,
    /// An atom at a time in fixed point: 2^-26
    Precise,
    /// An atom at a time by micromath's f32: 2^-9
    Micromath,
    /// Chebyshev recurrence in f32, seeds by libm: 2^-14
    Libm,
}

/// A rectangle from the command line.
fn region(text: &str) -> Result<Region, String> {
    let numbers: Option<Vec<u16>> = text
        .split(',')
        .map(|part| part.trim().parse().ok())
        .collect();
    match numbers.as_deref() {
        Some(&[x, y, width, height]) if width > 0 && height > 0 => Ok(Region {
            x,
            y,
            width,
            height,
        }),
        _ => Err("four numbers: first column, first row, columns, rows".to_owned()),
    }
}

impl KernelName {
    const fn kernel(self) -> Kernel {
        match self {
            Self::Table => Kernel::Table,
            Self::Recurrence => Kernel::Recurrence,
            Self::Precise => Kernel::Precise,
            Self::Micromath => Kernel::Micromath,
            Self::Libm => Kernel::Libm,
        }
    }
}

impl CodecOptions {
    /// Configuration of the encoder for a sensor.
    ///
    /// # Errors
    /// A thresholds file that cannot be read, a region outside of the sensor, flags that exclude each other.
    pub fn config(&self, sensor: Sensor) -> Result<Config> {
        let fidelity = match (self.time_tolerance_us, self.bins) {
            (None | Some(0), None) => Fidelity::Lossless,
            (Some(tolerance_us), _) => Fidelity::ToleranceUs(tolerance_us),
            (_, Some(bins)) => Fidelity::Bins(bins),
        };
        let mode = match self.mode {
            ModeName::Hybrid => Mode::Hybrid(Hybrid {
                coder: match self.coder {
                    None | Some(CoderName::Fast) => Coder::Fast,
                    Some(CoderName::Dense) => Coder::Dense,
                    Some(CoderName::Plain) => {
                        bail!("--coder plain is for --mode transform")
                    }
                },
                fidelity,
            }),
            ModeName::Transform => {
                ensure!(
                    !self.keep_order,
                    "--keep-order is for --mode hybrid: coefficients have no order of events"
                );
                ensure!(
                    fidelity == Fidelity::Lossless && self.bytes_per_second.is_none(),
                    "--time-tolerance-us, --bins and --bytes-per-second are for --mode hybrid"
                );
                match self.coder {
                    None | Some(CoderName::Plain) => Mode::Transform,
                    Some(CoderName::Fast) => Mode::Coefficients(Coder::Fast),
                    Some(CoderName::Dense) => Mode::Coefficients(Coder::Dense),
                }
            }
        };
        if let Some(Region {
            x,
            y,
            width,
            height,
        }) = self.region
        {
            let is_inside =
                |from: u16, side: u16, of: u16| u32::from(from) + u32::from(side) <= u32::from(of);
            ensure!(
                is_inside(x, width, sensor.width) && is_inside(y, height, sensor.height),
                "--region {x},{y},{width},{height}: reaches outside of the sensor of {} x {}",
                sensor.width,
                sensor.height
            );
        }
        Ok(Config {
            window: WindowConfig {
                origin_us: self.origin_us,
                every_window: self.every_window,
                ..WindowConfig::new(sensor, self.window_us.get())
            },
            thresholds: self.thresholds.load()?,
            transform: match self.transform {
                TransformName::Auto => None,
                TransformName::Dct => Some(Transform::Dct),
                TransformName::Dtft => Some(Transform::Dtft),
                TransformName::Dwt => Some(Transform::Dwt),
            },
            m: self.m,
            grid: self.grid,
            quantiser: match self.max_error {
                None => Quantiser::new(self.step_log2).context("the step is out of range")?,
                Some(error) => quantiser_within(error).with_context(|| {
                    format!(
                        "--max-error {error}: no step keeps it: ask for 2^-16, 0.0000153, or more"
                    )
                })?,
            },
            mode,
            key_windows: self.key_windows,
            readout: None,
            filter: Filter {
                region: self.region,
                isolated: self.isolated,
            },
            bytes_per_second: self.bytes_per_second,
            keep_order: self.keep_order,
        })
    }
}

impl CodecOptions {
    /// Configuration of an encoder on a microcontroller.
    ///
    /// # Errors
    /// As [`CodecOptions::config`]; what its image cannot do.
    pub fn config_of_image(&self, sensor: Sensor) -> Result<Config> {
        let config = self.config(sensor)?;
        ensure!(
            !config.keep_order,
            "--keep-order is for eecvs encode: the image has no memory for it"
        );
        ensure!(
            config.window.origin_us.is_none() && !config.window.every_window,
            "--origin-us and --every-window are for eecvs encode, eecvs-usb capture and forward: the image's windows \
             begin with the first event"
        );
        Ok(config)
    }

    /// The reader, and the configuration with the readout that its first events show, where it is
    /// looked for.
    #[must_use]
    pub fn look(
        &self,
        reader: Box<dyn EventReader>,
        config: Config,
    ) -> (Box<dyn EventReader>, Config) {
        match self.scans {
            ScanName::Auto => readout::look(reader, config),
            ScanName::Off => (reader, config),
        }
    }

    /// Files that it reads.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let hot = self.hot_pixels.iter().map(PathBuf::as_path);
        hot.chain(self.thresholds.files())
    }

    /// The pixels that are never sent.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn hot_pixels(&self, sensor: Sensor) -> Result<Vec<(u16, u16)>> {
        match &self.hot_pixels {
            Some(path) => hot_pixels::read(path, sensor),
            None => Ok(Vec::new()),
        }
    }
}

impl LimitOptions {
    /// Sizes of windows and frames.
    #[must_use]
    pub const fn limits(self) -> Limits {
        Limits {
            window_events: self.window_events as usize,
            frame_bytes: self.frame_bytes as usize,
            reorder_us: self.order.reorder_us,
            dense_words: usize::MAX,
        }
    }
}

impl Encode {
    /// Encodes and prints what was done.
    ///
    /// # Errors
    /// A recording that cannot be read, an output that cannot be written.
    pub fn run(self) -> Result<()> {
        let inputs = iter::once(self.input.as_path()).chain(self.codec.files());
        self.overwrite.check(&self.output, Kind::Frames, inputs)?;
        let reading = self.reading.reading();
        let follow = self.follow.follow()?;
        let reader = match &follow {
            Some(follow) => open_growing(&self.input, &reading, follow)?,
            None => formats::open(&self.input, &reading)?,
        };
        let config = self.codec.config(reader.sensor())?;
        let reader = self.sort.apply(reader)?;
        let (reader, config) = self.codec.look(reader, config);
        let mut reader = Intact::new(reader);
        let hot = self.codec.hot_pixels(reader.sensor())?;
        let codec = Codec {
            hot: &hot,
            budget: None,
            config,
            kernel: self.kernel.kernel(),
        };
        let mut out = OutputFile::create(&self.output)?;
        let progress = Progress::new("events");
        let summary = encode(
            &mut reader,
            codec,
            self.limits.limits(),
            self.threads(),
            &mut out,
            &mut |events| {
                progress.set(events);
            },
        )?;
        drop(progress);
        let findings = Findings::of(&reader);
        let damage = reader.damage().map(|error| format!("{error:#}"));
        let output = match damage {
            Some(_) if summary.events_in == 0 => {
                return tell_damage(damage.as_deref(), None, &self.output, false);
            }
            Some(_) if follow.is_none() => out.finish_incomplete()?,
            _ => out.finish().map(|()| self.output.clone())?,
        };
        if summary.events_in == 0 {
            eprintln!(
                "eecvs: {}: holds no events: {} has no frame and cannot be decoded",
                self.input.display(),
                self.output.display()
            );
        }
        let report = Report::new(&self.input, &output, &summary, findings);
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
    /// As many as were asked for. Of a pipe one, so that no window waits for those behind it.
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
    /// Bytes of the recording's file, where it is one.
    bytes_in: Option<u64>,
    /// `bytes_in` / `bytes_out`.
    ratio: Option<f64>,
    #[serde(flatten)]
    summary: &'c EncodeSummary,
    events_exact: u64,
    bits_per_encoded_event: f64,
    #[serde(flatten)]
    findings: Findings,
}

impl<'c> Report<'c> {
    fn new(input: &Path, output: &Path, summary: &'c EncodeSummary, findings: Findings) -> Self {
        let metadata = std::fs::metadata(input).ok().filter(Metadata::is_file);
        let bytes_in = metadata.map(|metadata| metadata.len());
        Self {
            input: input.display().to_string(),
            output: output.display().to_string(),
            bytes_in,
            ratio: bytes_in
                .filter(|_| summary.bytes_out > 0)
                .map(|bytes_in| bytes_in as f64 / summary.bytes_out as f64),
            summary,
            events_exact: summary.events_exact(),
            bits_per_encoded_event: summary.bits_per_encoded_event(),
            findings,
        }
    }

    /// For people.
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
        ]);
        // Events have no transform.
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
