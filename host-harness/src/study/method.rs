//! The ways in which events are encoded and decoded: the codec's and the baselines'.

use std::num::NonZeroU32;

use anyhow::{Context, Result};
use eecvs::reconstruct::events::Finder;
use eecvs_bench::source::Source;
use eecvs_nostd::{Coder, Config, Event, Fidelity, Hybrid, Mode, Thresholds, Transform};

use super::effort::M;
use crate::baseline::{self, Baseline, Stored};
use crate::rate::check::{Promise, check, setting};
use crate::round_trip::{Encoded, config, decode};
use crate::selection::settings::Setting;

/// A way to encode and decode, with its settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Coefficients, as in the paper.
    Transform {
        /// The transform; `None` chooses it by the window's density.
        transform: Option<Transform>,
        /// Number of coefficients kept per pixel.
        m: u8,
        /// How event times are found from the coefficients.
        finder: Finder,
    },
    /// Coefficients by another step, with event times by peaks: what [`crate::selection`] compares.
    Coarse(Setting),
    /// Events with the coarsest times within a mean error (`--max-emd-us`), by the dense coder.
    MeanError {
        /// The largest mean error of times, in us.
        most_us: u32,
    },
    /// Events, as the codec sends them by default.
    Hybrid {
        /// `fast` is the default.
        coder: Coder,
        /// `Lossless` is the default.
        fidelity: Fidelity,
    },
    /// A representation that the paper compares itself with.
    Baseline {
        /// The representation.
        baseline: Baseline,
        /// Number of channels or complex coefficients.
        m: u8,
        /// Type in which its numbers are stored.
        stored: Stored,
    },
}

/// Result of encoding and decoding a source.
#[derive(Debug, Clone)]
pub struct Trip {
    /// Bytes as sent: frames with the mode's default coder, or dense arrays.
    pub bytes: usize,
    /// Bytes when packed best: by the dense coder, or by xz of the active pixels.
    pub packed_bytes: usize,
    /// Time spent encoding on one thread, in seconds.
    pub seconds: f64,
    /// Events decoded.
    pub events: Vec<Event>,
    /// Whether the decoded times are more than a guess.
    pub has_times: bool,
    /// Windows per transform: DCT, DTFT, DWT; all 0 without a transform.
    pub windows: [u64; 3],
}

impl Method {
    /// Returns the name of the representation: `dct`, `dtft`, `dwt`, `auto`, `best`, `hybrid-fast`, `hybrid-dense`, or
    /// the baseline's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Transform { transform, .. } | Self::Coarse(Setting { transform, .. }) => {
                match transform {
                    Some(transform) => transform.name(),
                    None => "auto",
                }
            }
            Self::MeanError { .. } => "best",
            Self::Hybrid { coder, .. } => match coder {
                Coder::Fast => "hybrid-fast",
                Coder::Keys => "hybrid-keys",
                Coder::Quick => "hybrid-quick",
                Coder::Dense => "hybrid-dense",
                Coder::Tree(_) => "hybrid-tree",
            },
            Self::Baseline { baseline, .. } => baseline.name(),
        }
    }

    /// Returns the setting: `exact`, `peaks`; `2^-1, peaks`; `32 us on average`; `lossless`, `50 us`, `8 bins`; `f32`,
    /// `8 bits`.
    #[must_use]
    pub fn setting(self) -> String {
        match self {
            Self::Transform { finder, .. } => match finder {
                Finder::Exact => "exact".to_owned(),
                Finder::Peaks => "peaks".to_owned(),
            },
            Self::Coarse(Setting { step_log2, .. }) => format!("2^{step_log2}, peaks"),
            Self::MeanError { most_us } => format!("{most_us} us on average"),
            Self::Hybrid { fidelity, .. } => setting(fidelity),
            Self::Baseline { stored, .. } => stored.name().to_owned(),
        }
    }

    /// Returns the number of coefficients or channels per pixel; 0 if events are sent.
    #[must_use]
    pub const fn m(self) -> u8 {
        match self {
            Self::Transform { m, .. }
            | Self::Baseline { m, .. }
            | Self::Coarse(Setting { m, .. }) => m,
            Self::MeanError { .. } | Self::Hybrid { .. } => 0,
        }
    }

    /// Returns a text that identifies the method and its settings.
    #[must_use]
    pub fn key(self) -> String {
        format!("{} {} {}", self.name(), self.m(), self.setting())
    }

    /// Returns roughly how long an event takes, in units of the fastest method.
    #[must_use]
    pub const fn cost(self) -> u64 {
        match self {
            Self::Transform {
                transform,
                m,
                finder,
            } => {
                let m = m as u64;
                match (transform, finder) {
                    (Some(Transform::Dwt), _) => 1,
                    (_, Finder::Peaks) => m / 4 + 1,
                    (Some(Transform::Dct), Finder::Exact) => m * m / 4 + 1,
                    (_, Finder::Exact) => m * m + 1,
                }
            }
            Self::Baseline {
                baseline: Baseline::Ces,
                m,
                ..
            } => m as u64 * 4,
            Self::Coarse(Setting { m, .. }) => m as u64 / 4 + 1,
            Self::MeanError { .. } | Self::Hybrid { .. } | Self::Baseline { .. } => 1,
        }
    }

    /// Returns whether the errors of its times are reported: those of the methods in Table I.
    #[must_use]
    pub const fn has_time_errors(self) -> bool {
        match self {
            Self::Transform { m, .. } => m == M,
            Self::Coarse(_) | Self::MeanError { .. } => false,
            Self::Hybrid { coder, .. } => matches!(coder, Coder::Dense),
            Self::Baseline {
                m,
                stored,
                baseline,
            } => {
                (m == M || matches!(baseline, Baseline::TimeSurface))
                    && matches!(stored, Stored::F32)
            }
        }
    }

    /// Returns whether perception is measured on its decoded events: Tables IV and V.
    #[must_use]
    pub const fn has_perception(self) -> bool {
        match self {
            Self::Transform { m, finder, .. } => m >= M && matches!(finder, Finder::Exact),
            Self::Coarse(_) | Self::MeanError { .. } => false,
            Self::Hybrid { coder, fidelity } => {
                matches!(coder, Coder::Dense)
                    && matches!(fidelity, Fidelity::ToleranceUs(_) | Fidelity::Bins(_))
            }
            Self::Baseline { m, stored, .. } => (m >= M || m == 2) && matches!(stored, Stored::F32),
        }
    }

    /// Encodes a source and decodes it again. `thresholds` separate the regimes for the choice by density.
    ///
    /// # Errors
    /// Fails if the decoded events break the method's promise; the message names the source and the method.
    pub fn round_trip(self, source: &Source, thresholds: Thresholds) -> Result<Trip> {
        self.trip(source, thresholds)
            .with_context(|| format!("{}, {}", source.name, self.key()))
    }

    fn trip(self, source: &Source, thresholds: Thresholds) -> Result<Trip> {
        match self {
            Self::Baseline {
                baseline,
                m,
                stored,
            } => {
                let decoded = baseline::round_trip(baseline, source, m, stored)?;
                Ok(Trip {
                    bytes: decoded.array_bytes,
                    packed_bytes: decoded.packed_bytes,
                    seconds: decoded.seconds,
                    events: decoded.events,
                    has_times: decoded.has_times,
                    windows: [0; 3],
                })
            }
            Self::Hybrid { coder, fidelity } => {
                let promise = Promise::of(fidelity);
                let mode = Mode::Hybrid(Hybrid { coder, fidelity });
                let encoded = Encoded::new(source, config(source, thresholds, mode, None, M))?;
                let events = decode(&encoded.file, Finder::Exact, &mut |_| Ok(()))?;
                check(promise, &source.events, &events)?;
                Ok(Trip {
                    bytes: encoded.file.len(),
                    packed_bytes: encoded.file.len(),
                    seconds: encoded.seconds,
                    events,
                    has_times: true,
                    windows: [0; 3],
                })
            }
            Self::MeanError { most_us } => {
                let mode = Mode::Hybrid(Hybrid {
                    coder: Coder::Dense,
                    fidelity: Fidelity::Lossless,
                });
                let config = Config {
                    max_emd_us: NonZeroU32::new(most_us),
                    ..config(source, thresholds, mode, None, M)
                };
                let encoded = Encoded::new(source, config)?;
                let events = decode(&encoded.file, Finder::Exact, &mut |_| Ok(()))?;
                check(Promise::Counts, &source.events, &events)?;
                Ok(Trip {
                    bytes: encoded.file.len(),
                    packed_bytes: encoded.file.len(),
                    seconds: encoded.seconds,
                    events,
                    has_times: true,
                    windows: [0; 3],
                })
            }
            Self::Transform {
                transform,
                m,
                finder,
            } => coefficients(source, finder, &|mode| {
                Ok(config(source, thresholds, mode, transform, m))
            }),
            Self::Coarse(setting) => coefficients(source, Finder::Peaks, &|mode| {
                setting.config(config(
                    source,
                    thresholds,
                    mode,
                    setting.transform,
                    setting.m,
                ))
            }),
        }
    }
}

/// Encodes a source's coefficients with the configuration of each mode, and decodes them.
fn coefficients(
    source: &Source,
    finder: Finder,
    config: &dyn Fn(Mode) -> Result<Config>,
) -> Result<Trip> {
    let plain = Encoded::new(source, config(Mode::Transform)?)?;
    // The dense coder keeps these coefficients bit for bit, so they need not be decoded again.
    let dense = Encoded::new(source, config(Mode::Coefficients(Coder::Dense))?)?;
    let events = decode(&plain.file, finder, &mut |_| Ok(()))?;
    check(Promise::Counts, &source.events, &events)?;
    Ok(Trip {
        bytes: plain.file.len(),
        packed_bytes: dense.file.len().min(plain.file.len()),
        seconds: plain.seconds,
        events,
        has_times: true,
        windows: plain.windows,
    })
}
