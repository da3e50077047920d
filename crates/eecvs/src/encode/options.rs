//! Everything that can be asked of the encoder, as plain values: the options of `eecvs encode` for programs.
//!
//! ```
//! use eecvs::encode::options::{CoderName, EncodeOptions};
//! use event_types::Sensor;
//!
//! let options = EncodeOptions {
//!     coder: Some(CoderName::Dense),
//!     time_tolerance_us: Some(100),
//!     ..EncodeOptions::default()
//! };
//! let config = options.config_of_file(Sensor::new(346, 260).expect("sides from 1 to 2048"))?;
//! assert!(!config.mode.is_lossless());
//! # Ok::<(), eecvs::Error>(())
//! ```

use std::num::NonZeroU32;

use eecvs_nostd::{
    Coder, Config, Effort, Fidelity, Filter, Hybrid, KEY_WINDOWS, Mode, Quantiser, Region, Sensor,
    Thresholds, Transform, WindowConfig,
};
#[cfg(not(feature = "thresholds"))]
use event_types::error;
use event_types::stream::{Context, ErrorKind, Result};
use event_types::{bail, ensure};

use super::step::quantiser_within;
#[cfg(feature = "thresholds")]
use crate::thresholds_file::ThresholdsFile;

/// Content of the frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ModeName {
    /// The events, as exact as asked for.
    #[default]
    Hybrid,
    /// The kept coefficients of every active pixel.
    Transform,
}

/// Entropy coder of events or coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CoderName {
    /// Non-adaptive codes of coefficients, in mode transform.
    Plain,
    /// For speed.
    Fast,
    /// For the highest speed, in mode hybrid; lossless.
    Quick,
    /// For size.
    Dense,
}

/// Choice of the transform.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum TransformChoice {
    /// By the regime of each window's density.
    #[default]
    Auto,
    /// The cosine transform and the times of events in pixels of few, in mode transform; with a largest error in mode
    /// hybrid, the events.
    Best,
    /// This one.
    Only(Transform),
}

/// Options of an encoder. The default is lossless, with windows of 32,768 us and the fast coder.
#[derive(Debug, Clone)]
pub struct EncodeOptions {
    /// Content of the frames.
    pub mode: ModeName,
    /// Mode hybrid: largest error of a decoded time in microseconds.
    pub time_tolerance_us: Option<u32>,
    /// Mode hybrid: number of time bins of the volume that stays exact, at least 1.
    pub bins: Option<u16>,
    /// Mode hybrid: largest mean error of decoded times in microseconds.
    pub max_emd_us: Option<NonZeroU32>,
    /// Mode hybrid: largest error of the smoothed volume of a window, above 0 and below 1; see
    /// [`Codec::max_nmse`](super::Codec::max_nmse).
    pub max_nmse: Option<f64>,
    /// Entropy coder; `None` is fast in mode hybrid and plain in mode transform.
    pub coder: Option<CoderName>,
    /// Mode hybrid with the dense coder: more work for fewer bits, 0 to 3.
    pub effort: u8,
    /// Dense: number of windows from key frame to key frame, 1 to 256.
    pub key_windows: u16,
    /// Dense: instead of `key_windows`, as many whole windows as fit in this time in microseconds.
    pub key_us: Option<NonZeroU32>,
    /// Only events inside this rectangle.
    pub region: Option<Region>,
    /// Leaves out events without another one in their pixel or its eight neighbours.
    pub isolated: bool,
    /// Mode hybrid: keeps the order of events of equal time.
    pub keep_order: bool,
    /// Mode hybrid: limit of the frames of any second, in bytes.
    pub bytes_per_second: Option<NonZeroU32>,
    /// Transform of every window.
    pub transform: TransformChoice,
    /// Mode transform: sends a pixel of few events as the times of these, where that takes fewer bits.
    pub few_as_times: bool,
    /// Coefficients kept per pixel, 1 to 64.
    pub m: u8,
    /// Size of the transform's grid, 1 to 1024; `None` is M for the DCT and 2M for the others.
    pub grid: Option<u16>,
    /// log2 of the quantiser's step, -15 to 8.
    pub step_log2: i8,
    /// Largest quantisation error of a kept coefficient; it chooses the step in place of `step_log2`.
    pub max_error: Option<f64>,
    /// Duration of a window in microseconds.
    pub window_us: NonZeroU32,
    /// A time at which a window begins; `None` begins with the first event.
    pub origin_us: Option<u64>,
    /// Also sends windows without events.
    pub every_window: bool,
    /// Density thresholds of the regimes; `None` is those of the nine scenes.
    pub thresholds: Option<Thresholds>,
}

/// Default duration of a window in microseconds.
const WINDOW_US: NonZeroU32 = NonZeroU32::new(32_768).unwrap();

/// Default log2 of the quantiser's step.
const STEP_LOG2: i8 = -6;

impl Default for EncodeOptions {
    fn default() -> Self {
        Self {
            mode: ModeName::Hybrid,
            time_tolerance_us: None,
            bins: None,
            max_emd_us: None,
            max_nmse: None,
            coder: None,
            effort: 0,
            key_windows: KEY_WINDOWS,
            key_us: None,
            region: None,
            isolated: false,
            keep_order: false,
            bytes_per_second: None,
            transform: TransformChoice::Auto,
            few_as_times: false,
            m: 16,
            grid: None,
            step_log2: STEP_LOG2,
            max_error: None,
            window_us: WINDOW_US,
            origin_us: None,
            every_window: false,
            thresholds: None,
        }
    }
}

impl EncodeOptions {
    /// Returns the configuration of an encoder for a sensor.
    ///
    /// # Errors
    /// [`ErrorKind::Refused`] for options that exclude each other or are out of range; [`ErrorKind::Other`] for a region outside the sensor, a
    /// `max_error` that no step meets, and a step out of range.
    pub fn config(&self, sensor: Sensor) -> Result<Config> {
        self.check()?;
        let mode = self.mode()?;
        let is_best = self.transform == TransformChoice::Best;
        ensure!(
            mode.is_transform() || !is_best || self.max_emd_us.is_some() || self.max_nmse.is_some(),
            Refused,
            "--transform best is for --mode transform, or with --max-emd-us or --max-nmse for --mode hybrid"
        );
        ensure!(
            mode.is_transform() || !self.few_as_times,
            Refused,
            "--few-as-times is for --mode transform"
        );
        self.check_region(sensor)?;
        Ok(Config {
            window: WindowConfig {
                origin_us: self.origin_us,
                every_window: self.every_window,
                ..WindowConfig::new(sensor, self.window_us.get())
            },
            thresholds: self.thresholds()?,
            transform: match self.transform {
                TransformChoice::Auto => None,
                TransformChoice::Best if !mode.is_transform() => None,
                TransformChoice::Best => Some(Transform::Dct),
                TransformChoice::Only(transform) => Some(transform),
            },
            m: self.m,
            grid: self.grid,
            quantiser: self.quantiser()?,
            few_as_times: mode.is_transform() && (self.few_as_times || is_best),
            max_emd_us: self.max_emd_us,
            mode,
            key_windows: self.key_windows(self.window_us.get()),
            readout: None,
            filter: Filter {
                region: self.region,
                isolated: self.isolated,
            },
            bytes_per_second: self.bytes_per_second,
            keep_order: self.keep_order,
        })
    }

    /// Returns the configuration of an encoder for a file, on a host: that of [`EncodeOptions::config`], with the keys
    /// coder in place of the fast one where it does all that is asked for. A byte budget cannot be set later then.
    ///
    /// # Errors
    /// As for [`EncodeOptions::config`].
    pub fn config_of_file(&self, sensor: Sensor) -> Result<Config> {
        let mut config = self.config(sensor)?;
        let suits_keys = config.suits_keys();
        if let Mode::Hybrid(hybrid) = &mut config.mode
            && hybrid.coder == Coder::Fast
            && suits_keys
        {
            hybrid.coder = Coder::Keys;
        }
        Ok(config)
    }

    /// Returns the number of windows of that duration after which a key frame follows, 1 to 256.
    #[must_use]
    pub fn key_windows(&self, window_us: u32) -> u16 {
        self.key_us.map_or(self.key_windows, |key_us| {
            (key_us.get() / window_us.max(1)).clamp(1, 256) as u16
        })
    }

    /// Refuses values out of range and tolerances of which only one can hold.
    fn check(&self) -> Result<()> {
        let errors = [
            (self.time_tolerance_us.is_some(), "--time-tolerance-us"),
            (self.bins.is_some(), "--bins"),
            (self.max_emd_us.is_some(), "--max-emd-us"),
            (self.max_nmse.is_some(), "--max-nmse"),
        ];
        let mut given = errors.iter().filter(|(is_given, _)| *is_given);
        if let (Some((_, one)), Some((_, other))) = (given.next(), given.next()) {
            bail!(Refused, "{other} cannot be given with {one}");
        }
        if let Some(share) = self.max_nmse {
            ensure!(
                share > 0.0 && share < 1.0,
                Refused,
                "--max-nmse {share}: it must be above 0 and below 1"
            );
            ensure!(
                self.bytes_per_second.is_none(),
                Refused,
                "--bytes-per-second cannot be given with --max-nmse"
            );
        }
        for (value, range, name) in [
            (u32::from(self.effort), 0..=3, "--effort"),
            (u32::from(self.key_windows), 1..=256, "--key-windows"),
            (u32::from(self.m), 1..=64, "-m"),
            (u32::from(self.grid.unwrap_or(1)), 1..=1024, "--grid"),
            (u32::from(self.bins.unwrap_or(1)), 1..=65_535, "--bins"),
        ] {
            ensure!(
                range.contains(&value),
                Refused,
                "{name} {value}: it must be {} to {}",
                range.start(),
                range.end()
            );
        }
        Ok(())
    }

    fn mode(&self) -> Result<Mode> {
        let fidelity = match (self.time_tolerance_us, self.bins) {
            (None | Some(0), None) => Fidelity::Lossless,
            (Some(tolerance_us), _) => Fidelity::ToleranceUs(tolerance_us),
            (_, Some(bins)) => Fidelity::Bins(bins),
        };
        let has_error = self.max_emd_us.is_some() || self.max_nmse.is_some();
        let is_exact = fidelity == Fidelity::Lossless && !has_error;
        ensure!(
            self.effort == 0
                || (self.mode == ModeName::Hybrid && self.coder == Some(CoderName::Dense)),
            Refused,
            "--effort is for --coder dense in --mode hybrid"
        );
        if self.mode == ModeName::Transform {
            ensure!(
                !self.keep_order,
                Refused,
                "--keep-order is for --mode hybrid: coefficients have no order of events"
            );
            ensure!(
                is_exact && self.bytes_per_second.is_none(),
                Refused,
                "--time-tolerance-us, --bins, --max-emd-us, --max-nmse and --bytes-per-second are for --mode hybrid"
            );
            return match self.coder {
                None | Some(CoderName::Plain) => Ok(Mode::Transform),
                Some(CoderName::Fast) => Ok(Mode::Coefficients(Coder::Fast)),
                Some(CoderName::Quick) => bail!(Refused, "--coder quick is for --mode hybrid"),
                Some(CoderName::Dense) => Ok(Mode::Coefficients(Coder::Dense)),
            };
        }
        let coder = match self.coder {
            None | Some(CoderName::Fast) => Coder::Fast,
            Some(CoderName::Quick) => {
                ensure!(
                    is_exact && !self.isolated && self.bytes_per_second.is_none(),
                    Refused,
                    "--coder quick is lossless: it excludes --time-tolerance-us, --bins, --max-emd-us, --max-nmse, \
                     --isolated and --bytes-per-second"
                );
                Coder::Quick
            }
            Some(CoderName::Dense) => {
                Effort::from_number(self.effort).map_or(Coder::Dense, Coder::Tree)
            }
            Some(CoderName::Plain) => bail!(Refused, "--coder plain is for --mode transform"),
        };
        Ok(Mode::Hybrid(Hybrid { coder, fidelity }))
    }

    fn check_region(&self, sensor: Sensor) -> Result<()> {
        let Some(region) = self.region else {
            return Ok(());
        };
        let Region {
            x,
            y,
            width,
            height,
        } = region;
        let is_inside =
            |from: u16, side: u16, of: u16| u32::from(from) + u32::from(side) <= u32::from(of);
        ensure!(
            is_inside(x, width, sensor.width) && is_inside(y, height, sensor.height),
            Other,
            "--region {x},{y},{width},{height}: reaches outside the sensor of {} x {}",
            sensor.width,
            sensor.height
        );
        Ok(())
    }

    fn quantiser(&self) -> Result<Quantiser> {
        let quantiser = match self.max_error {
            None => Quantiser::new(self.step_log2).context("the quantiser step is out of range"),
            Some(error) => quantiser_within(error).with_context(|| {
                format!(
                    "--max-error {error}: no quantiser step meets it: give 2^-16 (0.0000153) or more"
                )
            }),
        };
        quantiser.map_err(|error| error.of_kind(ErrorKind::Other))
    }

    #[cfg(feature = "thresholds")]
    fn thresholds(&self) -> Result<Thresholds> {
        match self.thresholds {
            Some(thresholds) => Ok(thresholds),
            None => ThresholdsFile::scenes()?.thresholds(),
        }
    }

    #[cfg(not(feature = "thresholds"))]
    fn thresholds(&self) -> Result<Thresholds> {
        self.thresholds.ok_or_else(|| {
            error!(
                Undecided,
                "density thresholds are needed: those of the nine scenes are the feature `thresholds`"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 346,
        height: 260,
    };

    #[test]
    fn the_default_is_lossless_by_the_keys_coder() {
        let config = EncodeOptions::default().config_of_file(SENSOR).unwrap();
        let lossless = Hybrid {
            coder: Coder::Keys,
            fidelity: Fidelity::Lossless,
        };
        assert_eq!(config.mode, Mode::Hybrid(lossless));
        let order = EncodeOptions {
            keep_order: true,
            ..EncodeOptions::default()
        };
        let config = order.config_of_file(SENSOR).unwrap();
        let Mode::Hybrid(hybrid) = config.mode else {
            panic!("not hybrid");
        };
        assert_eq!(hybrid.coder, Coder::Fast);
    }

    #[test]
    fn options_that_exclude_each_other_are_refused() {
        let base = EncodeOptions::default;
        let transform = || EncodeOptions {
            mode: ModeName::Transform,
            ..base()
        };
        for (options, word) in [
            (
                EncodeOptions {
                    effort: 1,
                    ..base()
                },
                "--effort",
            ),
            (
                EncodeOptions {
                    coder: Some(CoderName::Plain),
                    ..base()
                },
                "plain",
            ),
            (
                EncodeOptions {
                    few_as_times: true,
                    ..base()
                },
                "--few-as-times",
            ),
            (
                EncodeOptions {
                    transform: TransformChoice::Best,
                    ..base()
                },
                "best",
            ),
            (
                EncodeOptions {
                    coder: Some(CoderName::Quick),
                    bins: Some(4),
                    ..base()
                },
                "quick",
            ),
            (
                EncodeOptions {
                    bins: Some(4),
                    time_tolerance_us: Some(1),
                    ..base()
                },
                "--bins",
            ),
            (
                EncodeOptions {
                    max_nmse: Some(1.5),
                    ..base()
                },
                "--max-nmse",
            ),
            (
                EncodeOptions {
                    key_windows: 0,
                    ..base()
                },
                "--key-windows",
            ),
            (
                EncodeOptions {
                    coder: Some(CoderName::Dense),
                    effort: 4,
                    ..base()
                },
                "--effort",
            ),
            (
                EncodeOptions {
                    bins: Some(0),
                    ..base()
                },
                "--bins",
            ),
            (EncodeOptions { m: 65, ..base() }, "-m"),
            (
                EncodeOptions {
                    keep_order: true,
                    ..transform()
                },
                "--keep-order",
            ),
            (
                EncodeOptions {
                    bins: Some(3),
                    ..transform()
                },
                "--bins",
            ),
            (
                EncodeOptions {
                    coder: Some(CoderName::Quick),
                    ..transform()
                },
                "quick",
            ),
        ] {
            let error = options.config(SENSOR).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Refused);
            assert!(error.to_string().contains(word), "{error}");
        }
        let outside = EncodeOptions {
            region: Some(Region {
                x: 300,
                y: 0,
                width: 47,
                height: 1,
            }),
            ..base()
        };
        let error = outside.config(SENSOR).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Other);
        let finest = EncodeOptions {
            max_error: Some(1e-9),
            ..base()
        };
        assert!(finest.config(SENSOR).is_err());
    }

    #[test]
    fn key_frames_follow_by_windows_or_by_time() {
        let options = EncodeOptions {
            key_us: NonZeroU32::new(100_000),
            ..EncodeOptions::default()
        };
        assert_eq!(options.key_windows(32_768), 3);
        assert_eq!(options.key_windows(1_000_000), 1);
        assert_eq!(options.key_windows(1), 256);
        assert_eq!(EncodeOptions::default().key_windows(1), KEY_WINDOWS);
    }
}
