//! The flags of the codec, which `eecvs encode`, the microcontroller's commands, the ROS nodes and the hub share.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use eecvs::encode::step::quantiser_within;
use eecvs::encode::{Limits, readout};
use eecvs::hot_pixels;
use eecvs_nostd::{
    Coder, Config, Fidelity, Filter, Hybrid, KEY_WINDOWS, Kernel, Mode, OUTPUT_BYTES_MIN,
    Quantiser, Region, Sensor, Transform, WindowConfig,
};
use event_files::EventReader;

use crate::options::ThresholdOptions;
use crate::order::OrderOptions;

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
    #[arg(long, value_name = "N", default_value_t = eecvs::encode::WINDOW_EVENTS as u32,
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
pub enum KernelName {
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
    /// The core's kernel of that name.
    #[must_use]
    pub const fn kernel(self) -> Kernel {
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
            Some(path) => Ok(hot_pixels::read(path, sensor)?),
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
