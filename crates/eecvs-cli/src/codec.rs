//! The codec flags shared by `eecvs encode`, the microcontroller commands, the ROS nodes and the hub.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use eecvs::encode::options::{self, EncodeOptions, TransformChoice};
use eecvs::encode::{Limits, readout};
use eecvs::hot_pixels;
use eecvs_nostd::{Config, KEY_WINDOWS, Kernel, OUTPUT_BYTES_MIN, Region, Sensor, Transform};
use event_files::{ErrorKind, EventReader};

use crate::options::ThresholdOptions;
use crate::order::OrderOptions;
use crate::output::usage;

/// Flags that control how windows are encoded.
#[derive(Debug, Clone, Args)]
pub struct CodecOptions {
    /// Content of the frames
    #[arg(long, value_enum, default_value = "hybrid")]
    mode: ModeName,

    /// hybrid: largest error of a decoded time in microseconds [default: 0, lossless]
    #[arg(long, value_name = "D", conflicts_with = "bins")]
    time_tolerance_us: Option<u32>,

    /// hybrid: keep only the volume of B time bins exact
    #[arg(long, value_name = "B", value_parser = clap::value_parser!(u16).range(1..))]
    bins: Option<u16>,

    /// hybrid: largest mean error of decoded times in microseconds, in every window, or with --coder dense in the
    /// windows from one key frame to the next: the coarsest times within it are chosen for each window, and where it
    /// helps, events of a pixel are spread over the time in which they came. It also holds over whole files
    #[arg(long, value_name = "E", conflicts_with_all = ["time_tolerance_us", "bins"])]
    max_emd_us: Option<NonZeroU32>,

    /// hybrid: largest error of the smoothed volume of any window, above 0 and below 1: sum (S' - S)^2 / sum S^2, where S
    /// are a pixel's signed events, smoothed in time by a Gaussian of 4 ms. The largest tolerance of times found within it
    /// is chosen for each window
    #[arg(
        long,
        value_name = "E",
        value_parser = share,
        conflicts_with_all = ["time_tolerance_us", "bins", "max_emd_us", "bytes_per_second"],
    )]
    max_nmse: Option<f64>,

    /// Entropy coder of events or coefficients [default: fast in mode hybrid, plain in mode transform]
    #[arg(long, value_enum)]
    coder: Option<CoderName>,

    /// hybrid, dense: compute more for fewer bits, from 1 to 3; files of frames then need a reader of wire version 4.
    /// 1 takes 1.1 to 2.5 times as long as 0; 2 some six times and 3 some thirteen times as long as 1
    #[arg(long, value_name = "E", default_value = "0", value_parser = clap::value_parser!(u8).range(0..=3))]
    effort: u8,

    /// dense: send a key frame, which decodes without the frames before it, every N windows
    #[arg(long, value_name = "N", default_value_t = KEY_WINDOWS,
          value_parser = clap::value_parser!(u16).range(1..=256))]
    key_windows: u16,

    /// dense: send a key frame after as many whole windows as fit in T microseconds, 1 to 256, instead of --key-windows: a
    /// moment of a file is decoded from the key frame before it
    #[arg(long, value_name = "T", conflicts_with = "key_windows")]
    key_us: Option<NonZeroU32>,

    /// hybrid, dense: encode times by scans, for sensors that scan, such as the DVXplorer; auto detects from the
    /// first events how the sensor scans
    #[arg(long, value_enum, default_value = "auto")]
    scans: ScanName,

    /// Send only the events inside a rectangle: first column, first row, columns, rows
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    region: Option<Region>,

    /// Text file of hot pixels, one x,y per line; their events are never sent
    #[arg(long, value_name = "FILE")]
    hot_pixels: Option<PathBuf>,

    /// Leave out isolated events: those with no other event in their pixel or its eight neighbours in the window
    #[arg(long)]
    isolated: bool,

    /// hybrid: keep the input order of events of equal time, for 0.01 to 1.5 bits per event more. With a tolerance, a mean
    /// error or bins, times that decode as equal count as equal, so that coarse times make the order dearer, beyond what they
    /// save; with a budget, the order is kept where there is room
    #[arg(long)]
    keep_order: bool,

    /// hybrid: limit the frames of any second to B bytes. What does not fit is degraded step by step (tolerances,
    /// then bins, then removal of isolated events, then every second, fourth, ... event), and each frame states how;
    /// uses one encoding thread
    #[arg(long, value_name = "B")]
    bytes_per_second: Option<NonZeroU32>,

    /// Transform of every window; auto selects it by the regime of the window's density; best is dct with --few-as-times
    #[arg(long, value_enum, default_value = "auto")]
    transform: TransformName,

    /// transform: send a pixel of few events as the times of these, where they take fewer bits unless pixels share their
    /// times: every coefficient that a decoder computes and keeps is as close as by levels
    #[arg(long)]
    few_as_times: bool,

    /// Coefficients kept per pixel
    #[arg(short, value_name = "M", default_value = "16",
          value_parser = clap::value_parser!(u8).range(1..=64))]
    m: u8,

    /// Size of the transform's grid [default: M for the DCT, 2M for the others]; the DWT rounds it up to a power of
    /// two
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u16).range(1..=1024))]
    grid: Option<u16>,

    /// log2 of the quantiser's step
    #[arg(long, value_name = "S", default_value = "-6", allow_negative_numbers = true,
          value_parser = clap::value_parser!(i8).range(-15..=8))]
    step_log2: i8,

    /// Largest quantisation error of a kept coefficient, for re and im each; selects the largest step within it. The
    /// kernel's own error, up to 2^-14 per event in the pixel, comes on top
    #[arg(long, value_name = "E", conflicts_with = "step_log2")]
    max_error: Option<f64>,

    /// Window duration in microseconds
    #[arg(long, value_name = "T", default_value = "32768")]
    window_us: NonZeroU32,

    /// Begin windows at T + i window-us microseconds, for integer i, so that the windows of several sensors match
    /// [default: with the first event]
    #[arg(long, value_name = "T")]
    origin_us: Option<u64>,

    /// Also send a frame for a window without events, up to 65,536 in a row: 20 to 40 bytes that show that the sensor
    /// is present
    #[arg(long)]
    every_window: bool,

    #[command(flatten)]
    thresholds: ThresholdOptions,
}

/// Limits on the size of windows and frames.
#[derive(Debug, Clone, Copy, Args)]
pub struct LimitOptions {
    /// Largest number of events in a window; a full window closes early
    #[arg(long, value_name = "N", default_value_t = eecvs::encode::WINDOW_EVENTS as u32,
          value_parser = clap::value_parser!(u32).range(1..=eecvs_nostd::window::EVENTS_MAX as i64))]
    window_events: u32,

    /// Largest frame in bytes; a window that needs more is split into several frames
    #[arg(long, value_name = "BYTES", default_value_t = eecvs_nostd::FRAME_BYTES_MAX as u32,
          value_parser = clap::value_parser!(u32)
              .range(OUTPUT_BYTES_MIN as i64..=eecvs_nostd::FRAME_BYTES_MAX as i64))]
    frame_bytes: u32,

    /// How times that run backwards are handled.
    #[command(flatten)]
    pub order: OrderOptions,
}

/// Name of a mode on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ModeName {
    /// The events, as exact as requested; --transform, -m and --grid then apply to the volume decoded from them
    Hybrid,
    /// The kept coefficients of every active pixel
    Transform,
}

/// Name of a coder of events or coefficients on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum CoderName {
    /// transform: non-adaptive codes, as a microcontroller uses for coefficients
    Plain,
    /// For speed; every frame decodes on its own. hybrid: eecvs encode and eecvs-usb capture sort whole windows by place
    /// and time for it, for the fewest bytes at this speed, unless --keep-order, --isolated or --bytes-per-second is
    /// given. Files of frames then need a reader of wire version 4
    Fast,
    /// hybrid: for the highest speed, at some more bytes; lossless, keeps the order of events of equal time by itself,
    /// without --isolated and --bytes-per-second. Files of frames then need a reader of wire version 4
    Quick,
    /// For size; a frame depends on those before it, back to the last key frame
    Dense,
}

/// Whether times are encoded by scans, on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ScanName {
    /// If the times lie on a grid
    Auto,
    /// Never
    Off,
}

/// Name of a transform on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TransformName {
    /// Selected by the window's density
    Auto,
    /// transform: the cosine transform, and the times of events in pixels of few; hybrid: with --max-emd-us or
    /// --max-nmse, the events
    Best,
    /// Cosine transform
    Dct,
    /// Fourier transform
    Dtft,
    /// Haar wavelet transform
    Dwt,
}

/// Name of a kernel on the command line; the help gives its coefficient error per event in the pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum KernelName {
    /// The encoder's own and the fastest: within 2^-14 per event in the pixel
    Table,
    /// Chebyshev recurrence in fixed point: 2^-16
    Recurrence,
    /// One atom at a time in fixed point: 2^-26
    Precise,
    /// One atom at a time in micromath's f32: 2^-9
    Micromath,
    /// Chebyshev recurrence in f32, seeded by libm: 2^-14
    Libm,
}

/// Parses a rectangle `X,Y,W,H`.
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
        _ => Err("expected four numbers: first column, first row, columns, rows".to_owned()),
    }
}

impl KernelName {
    /// Returns the core's kernel of this name.
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

/// Parses a share of a volume, above 0 and below 1.
fn share(text: &str) -> std::result::Result<f64, String> {
    match text.parse() {
        Ok(share) if share > 0.0 && share < 1.0 => Ok(share),
        _ => Err("a number above 0 and below 1".to_owned()),
    }
}

/// Makes flags that exclude each other an error of the command line.
fn flags(error: event_files::Error) -> anyhow::Error {
    match error.kind() {
        ErrorKind::Refused => usage(&error.to_string()).into(),
        _ => error.into(),
    }
}

impl CodecOptions {
    /// Returns the configuration of the encoder for a sensor.
    ///
    /// # Errors
    /// A thresholds file that cannot be read, a region outside the sensor, a `--max-error` that no step meets, or
    /// flags that exclude each other.
    pub fn config(&self, sensor: Sensor) -> Result<Config> {
        self.options()?.config(sensor).map_err(flags)
    }

    /// Returns the options as the codec takes them.
    fn options(&self) -> Result<EncodeOptions> {
        Ok(EncodeOptions {
            mode: match self.mode {
                ModeName::Hybrid => options::ModeName::Hybrid,
                ModeName::Transform => options::ModeName::Transform,
            },
            time_tolerance_us: self.time_tolerance_us,
            bins: self.bins,
            max_emd_us: self.max_emd_us,
            max_nmse: self.max_nmse,
            coder: self.coder.map(|coder| match coder {
                CoderName::Plain => options::CoderName::Plain,
                CoderName::Fast => options::CoderName::Fast,
                CoderName::Quick => options::CoderName::Quick,
                CoderName::Dense => options::CoderName::Dense,
            }),
            effort: self.effort,
            key_windows: self.key_windows,
            key_us: self.key_us,
            region: self.region,
            isolated: self.isolated,
            keep_order: self.keep_order,
            bytes_per_second: self.bytes_per_second,
            transform: match self.transform {
                TransformName::Auto => TransformChoice::Auto,
                TransformName::Best => TransformChoice::Best,
                TransformName::Dct => TransformChoice::Only(Transform::Dct),
                TransformName::Dtft => TransformChoice::Only(Transform::Dtft),
                TransformName::Dwt => TransformChoice::Only(Transform::Dwt),
            },
            few_as_times: self.few_as_times,
            m: self.m,
            grid: self.grid,
            step_log2: self.step_log2,
            max_error: self.max_error,
            window_us: self.window_us,
            origin_us: self.origin_us,
            every_window: self.every_window,
            thresholds: Some(self.thresholds.load()?),
        })
    }

    /// Returns the largest error of the smoothed volume, which is not part of a [`Config`]: an encoder on a host chooses
    /// tolerances by it.
    #[must_use]
    pub const fn max_nmse(&self) -> Option<f64> {
        self.max_nmse
    }

    /// Returns the number of windows of that duration after which a key frame follows.
    #[must_use]
    pub fn key_windows(&self, window_us: u32) -> u16 {
        EncodeOptions {
            key_windows: self.key_windows,
            key_us: self.key_us,
            ..EncodeOptions::default()
        }
        .key_windows(window_us)
    }

    /// Returns the configuration of an encoder for a file, on a host: that of [`CodecOptions::config`], with the keys
    /// coder in place of the fast one where it does all that is asked for. A byte budget cannot be set later then.
    ///
    /// # Errors
    /// As for [`CodecOptions::config`].
    pub fn config_of_file(&self, sensor: Sensor) -> Result<Config> {
        self.options()?.config_of_file(sensor).map_err(flags)
    }

    /// Returns the configuration of an encoder on a microcontroller.
    ///
    /// # Errors
    /// As for [`CodecOptions::config`], and flags that the firmware image does not support.
    pub fn config_of_image(&self, sensor: Sensor) -> Result<Config> {
        let config = self.config(sensor)?;
        ensure!(
            self.effort == 0,
            usage("--effort is for eecvs encode: the image has no memory for it")
        );
        ensure!(
            self.max_nmse.is_none(),
            usage(
                "--max-nmse is for encoders on a host: give the image --time-tolerance-us or --max-emd-us"
            )
        );
        ensure!(
            !config.has_order_section(),
            usage(
                "--keep-order is for eecvs encode: the image has no memory for it; --coder quick keeps the order of \
                 arrival"
            )
        );
        ensure!(
            config.window.origin_us.is_none() && !config.window.every_window,
            usage(
                "--origin-us and --every-window are for eecvs encode, eecvs-usb capture and forward: the image's windows \
             begin with the first event"
            )
        );
        Ok(config)
    }

    /// Returns the reader, and the configuration with the readout detected from its first events, unless `--scans` is
    /// off.
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

    /// Returns the files to be read: hot pixels and thresholds.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let hot = self.hot_pixels.iter().map(PathBuf::as_path);
        hot.chain(self.thresholds.files())
    }

    /// Returns the hot pixels as (column, row); empty if no file was given.
    ///
    /// # Errors
    /// A file that cannot be read, or an invalid file.
    pub fn hot_pixels(&self, sensor: Sensor) -> Result<Vec<(u16, u16)>> {
        match &self.hot_pixels {
            Some(path) => Ok(hot_pixels::read(path, sensor)?),
            None => Ok(Vec::new()),
        }
    }
}

impl LimitOptions {
    /// Returns the limits for the encoder.
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
