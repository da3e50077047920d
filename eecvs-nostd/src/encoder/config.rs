//! Configuration of an encoder, the memory lent to it, and the reasons to refuse either.

use core::num::NonZeroU32;

use crate::coder::coefficients::CoefficientMemory;
use crate::coder::dense::DenseMemory;
use crate::coder::key_frames::KEY_WINDOWS;
use crate::coder::keys::EncoderMemory;
use crate::coder::tree::TreeMemory;
use crate::coder::{Coder, Effort, Fidelity, Hybrid, Readout};
use crate::encoder::rate::WINDOW_BYTES_MIN;
use crate::fixed_point::{Sum, WideSum};
use crate::frame::{M_DEFAULT, Mode};
use crate::quantise::Quantiser;
use crate::regime::Thresholds;
use crate::transform::{GRID_MAX, M_MAX, Transform};
use crate::window::filter::Filter;
use crate::window::{HAS_QUICK, WindowConfig};

/// Whether frames can be kept within a budget of bytes; without the feature none of its code is compiled.
pub(crate) const HAS_BUDGET: bool = cfg!(feature = "budget");

/// Whether a mean error of times can be asked for; without the feature none of its code is compiled.
pub(crate) const HAS_MEAN_ERROR: bool = cfg!(feature = "mean-error");

/// Whether windows can keep the order of their events; without the feature none of its code is compiled.
pub(crate) const HAS_ORDER: bool = cfg!(feature = "order");

/// Whether the encoder has mode `transform`; without the feature none of its code is compiled.
pub(crate) const HAS_TRANSFORM: bool = cfg!(feature = "transform");

/// Whether events can be coded by the dense coder; without the feature none of its code is compiled.
pub(crate) const HAS_DENSE: bool = cfg!(feature = "dense");

/// Whether events can be coded by the tree coder; without the feature none of its code is compiled.
pub(crate) const HAS_TREE: bool = cfg!(feature = "tree");

/// Whether events can be coded by the keys coder; without the feature none of its code is compiled.
pub(crate) const HAS_KEYS: bool = cfg!(feature = "keys");

/// Configuration of an encoder, fixed while it runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// Sensor and window duration T.
    pub window: WindowConfig,
    /// Densities that separate the regimes.
    pub thresholds: Thresholds,
    /// One transform for every window, or `None` for the regime's (eq. 3).
    pub transform: Option<Transform>,
    /// Number of coefficients kept, M: 1 to 64.
    pub m: u8,
    /// Size of the grid, K: 1 to 1024; `None` for the transform's default.
    pub grid: Option<u16>,
    /// Quantiser of the coefficients.
    pub quantiser: Quantiser,
    /// Whether pixels of few events are sent as the times of these in mode `transform`, where that takes fewer bits:
    /// [`crate::pack::timed`]. Every coefficient that a decoder computes is within half a step either way.
    pub few_as_times: bool,
    /// Largest mean error of decoded times in microseconds, in a lossless hybrid mode, over the windows from key frame to
    /// key frame, or of each window by coders whose frames depend on none before. The coarsest fidelity for it is chosen
    /// from the windows' own events: see `mean_error.rs`.
    pub max_emd_us: Option<NonZeroU32>,
    /// Content of the frames. In a hybrid mode, transform, M, K and quantiser are those of the volume that a
    /// decoder makes of the events.
    pub mode: Mode,
    /// Number of windows after which the dense coder begins anew with a key frame, so that a decoder that has lost
    /// a frame can go on. [`crate::coder::key_frames::KEY_WINDOWS`] suits files and good links.
    pub key_windows: u16,
    /// How the sensor scans. If a window's times lie on these scans, the dense coder codes them by their scans: in
    /// a lossless mode, and exactly also where the mode's tolerance is below half a period.
    pub readout: Option<Readout>,
    /// What is removed from every window, besides the pixels of [`crate::WindowEncoder::add_hot`].
    pub filter: Filter,
    /// Most bytes that the frames of any second take, in a hybrid mode: see `rate.rs`.
    pub bytes_per_second: Option<NonZeroU32>,
    /// Whether events of equal time are decoded in the order in which they arrived, in a hybrid mode. Times are
    /// equal if they are decoded from the same cell. Under a budget the order is kept where there is room for it.
    /// It needs [`Scratch::order`], but not with the quick coder, which keeps the order in any case.
    pub keep_order: bool,
}

/// Why a configuration is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ConfigError {
    /// M is not in 1..=64.
    M,
    /// K is not in 1..=1024.
    Grid,
    /// [`Scratch`] is smaller than the largest grid needs.
    Scratch,
    /// [`Scratch::dense`] is missing or too small for the sensor, or the feature `dense` is missing.
    Dense,
    /// [`Scratch::coefficients`] or the feature `coefficients` is missing.
    Coefficients,
    /// [`Scratch::tree`] or the feature `tree` is missing, or the memory is too small for the sensor and the effort;
    /// or the tree coder was asked for coefficients.
    Tree,
    /// The keys coder, which tells no order and removes no isolated events, with either or a budget; or
    /// [`Scratch::keys`] or the feature `keys` is missing, or the coder was asked for coefficients.
    Keys,
    /// The quick coder, which is lossless and removes no isolated events, with a fidelity, a largest mean error, that
    /// filter or a budget;
    /// or the feature `quick` is missing, or the coder was asked for coefficients. Or the window keeps the order of
    /// arrival for a coder other than it and the keys coder.
    Quick,
    /// The volume has no bins.
    Bins,
    /// A largest mean error in mode `transform`, beside a fidelity, or without the feature `mean-error`.
    MeanError,
    /// A budget in mode `transform`, one of fewer than some 146 bytes per window, or one without the feature `budget`.
    Rate,
    /// Mode `transform`, or coefficients, without the feature `transform`.
    Transform,
    /// The order of events in mode `transform` or of spread events, or without memory for it, or without the feature
    /// `order`.
    Order,
}

/// Why an encoder cannot be set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SetupError {
    /// [`crate::Window::new`] fails: the event buffers are empty or too small for the sensor, the sensor is out of
    /// range, or T is 0.
    Window,
    /// The configuration is refused for another reason.
    Config(ConfigError),
}

/// Why a hot pixel is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HotError {
    /// The pixel is not on the sensor.
    Outside,
    /// [`Scratch::hot`] is full.
    NoRoom,
}

impl Config {
    /// Returns a configuration with defaults for all else: the regime's transform, M = 16, default K and quantiser,
    /// key frames spaced as for files, no filter, no budget, and no order of equal times.
    #[must_use]
    pub const fn new(window: WindowConfig, thresholds: Thresholds, mode: Mode) -> Self {
        Self {
            window,
            thresholds,
            transform: None,
            m: M_DEFAULT,
            grid: None,
            quantiser: Quantiser::DEFAULT,
            few_as_times: false,
            max_emd_us: None,
            mode,
            key_windows: KEY_WINDOWS,
            readout: None,
            filter: Filter::NONE,
            bytes_per_second: None,
            keep_order: false,
        }
    }

    /// Returns the configuration of the windows that are encoded: [`Self::window`], and how the coder needs their
    /// events kept. Every window for this configuration has to be created with it.
    #[must_use]
    pub const fn windows(&self) -> WindowConfig {
        WindowConfig {
            keeps_arrival: self.mode.takes_arrival(),
            ..self.window
        }
    }

    /// Returns whether frames have a section that tells the order of events: the quick coder keeps it without one.
    #[must_use]
    pub const fn has_order_section(&self) -> bool {
        self.keep_order && !self.mode.keeps_arrival()
    }

    /// Returns whether the quick coder can code what was asked for, or is not asked.
    const fn is_quick_served(&self) -> bool {
        match self.mode {
            Mode::Hybrid(Hybrid {
                coder: Coder::Quick,
                fidelity,
            }) => {
                HAS_QUICK
                    && matches!(fidelity, Fidelity::Lossless)
                    && self.max_emd_us.is_none()
                    && !self.filter.isolated
                    && self.bytes_per_second.is_none()
            }
            Mode::Coefficients(Coder::Quick) => false,
            mode => mode.has_keys() || !self.window.keeps_arrival,
        }
    }

    /// Returns whether the keys coder can code what was asked for, or is not asked.
    const fn is_keys_served(&self, scratch: &Scratch<'_>) -> bool {
        match self.mode {
            Mode::Hybrid(Hybrid {
                coder: Coder::Keys, ..
            }) => HAS_KEYS && scratch.keys.is_some() && self.suits_keys(),
            Mode::Coefficients(Coder::Keys) => false,
            _ => true,
        }
    }

    /// Returns whether [`Coder::Keys`] can do all that is asked for beside the mode: it has no order of events of equal
    /// time, no filter of isolated events and no byte budget.
    #[must_use]
    pub const fn suits_keys(&self) -> bool {
        !self.keep_order && !self.filter.isolated && self.bytes_per_second.is_none()
    }

    /// Checks that the fidelity goes with what else is asked for.
    const fn check_fidelity(&self) -> Result<(), ConfigError> {
        let fidelity = match self.mode {
            Mode::Hybrid(hybrid) => Some(hybrid.fidelity),
            _ => None,
        };
        match fidelity {
            _ if !HAS_MEAN_ERROR && self.max_emd_us.is_some() => Err(ConfigError::MeanError),
            Some(Fidelity::Bins(0)) => Err(ConfigError::Bins),
            Some(Fidelity::SpreadUs(_)) if self.keep_order => Err(ConfigError::Order),
            Some(Fidelity::Lossless) => Ok(()),
            _ if self.max_emd_us.is_some() => Err(ConfigError::MeanError),
            _ => Ok(()),
        }
    }

    /// Returns the smallest budget in bytes per second: the headers of all windows and a seventh more.
    #[must_use]
    pub const fn budget_min(&self) -> u64 {
        let window_us = match NonZeroU32::new(self.window.window_us) {
            Some(window_us) => window_us,
            None => NonZeroU32::MIN,
        };
        let windows = 1_000_000_u32.div_ceil(window_us.get());
        windows as u64 * WINDOW_BYTES_MIN as u64 * 8 / 7
    }

    /// Checks that the configuration is valid and can run with the memory.
    pub(crate) const fn check(&self, scratch: &Scratch<'_>) -> Result<(), ConfigError> {
        if self.m == 0 || self.m as usize > M_MAX {
            return Err(ConfigError::M);
        }
        if let Some(grid) = self.grid
            && (grid == 0 || grid as usize > GRID_MAX)
        {
            return Err(ConfigError::Grid);
        }
        if !self.is_quick_served() {
            return Err(ConfigError::Quick);
        }
        if !self.is_keys_served(scratch) {
            return Err(ConfigError::Keys);
        }
        if let Err(error) = self.check_fidelity() {
            return Err(error);
        }
        if let Some(budget) = self.bytes_per_second
            && (!HAS_BUDGET
                || self.mode.is_transform()
                || (budget.get() as u64) < self.budget_min())
        {
            return Err(ConfigError::Rate);
        }
        let has_order = HAS_ORDER && !self.mode.is_transform() && !scratch.order.is_empty();
        if self.has_order_section() && !has_order {
            return Err(ConfigError::Order);
        }
        match self.mode {
            Mode::Transform | Mode::Coefficients(_) if !HAS_TRANSFORM => {
                Err(ConfigError::Transform)
            }
            Mode::Coefficients(Coder::Tree(_)) => Err(ConfigError::Tree),
            Mode::Transform | Mode::Coefficients(_) if scratch.numbers() < 2 * self.grid_max() => {
                Err(ConfigError::Scratch)
            }
            Mode::Coefficients(_)
                if !cfg!(feature = "coefficients") || scratch.coefficients.is_none() =>
            {
                Err(ConfigError::Coefficients)
            }
            Mode::Hybrid(Hybrid {
                coder: Coder::Tree(effort),
                ..
            }) if !scratch.has_tree(self, effort) => Err(ConfigError::Tree),
            mode if mode.is_dense() => match &scratch.dense {
                Some(memory) if HAS_DENSE && memory.serves(self.window.sensor) => Ok(()),
                _ => Err(ConfigError::Dense),
            },
            _ => Ok(()),
        }
    }

    /// Returns the largest K of any window.
    const fn grid_max(&self) -> usize {
        let mut most = 0;
        let mut i = 0;
        while i < Transform::ALL.len() {
            let transform = Transform::ALL[i];
            let used = match self.transform {
                Some(only) => only as u8 == transform as u8,
                None => true,
            };
            let grid = transform.grid_size(self.m, self.grid) as usize;
            if used && grid > most {
                most = grid;
            }
            i += 1;
        }
        most
    }
}

/// Memory lent for the coefficients of one pixel, 2K of each number. It need not be zeroed.
#[derive(Debug)]
pub struct Scratch<'b> {
    /// Sums of a chunk of events.
    pub sums: &'b mut [Sum],
    /// Sums of a pixel with several chunks of events.
    pub totals: &'b mut [WideSum],
    /// Magnitudes, and then levels, once the magnitudes have decided which coefficients are kept.
    pub magnitudes: &'b mut [u32],
    /// State of the dense coder; needed for that coder only.
    pub dense: Option<DenseMemory<'b>>,
    /// State of the tree coder; needed for that coder only, beside [`Self::dense`].
    pub tree: Option<TreeMemory<'b>>,
    /// State of the keys coder; needed for that coder only.
    pub keys: Option<&'b mut EncoderMemory>,
    /// State of the adaptive coders of coefficients; needed for these coders only.
    pub coefficients: Option<&'b mut CoefficientMemory>,
    /// One word for each pixel that is never sent: see [`crate::WindowEncoder::add_hot`].
    pub hot: &'b mut [u32],
    /// Words for [`Config::keep_order`], [`crate::coder::arrival_order::words`] for a window's slots; empty without
    /// it. A window that filled more slots is sent without its order, and its frames do not claim one.
    pub order: &'b mut [u32],
}

impl Scratch<'_> {
    /// Returns whether the tree coder has memory for the sensor and some events.
    const fn has_tree(&self, config: &Config, effort: Effort) -> bool {
        match &self.tree {
            Some(memory) if HAS_TREE => memory.serves(config.window.sensor, effort),
            _ => false,
        }
    }

    /// Returns how many numbers each part has room for.
    const fn numbers(&self) -> usize {
        let mut least = self.sums.len();
        if self.totals.len() < least {
            least = self.totals.len();
        }
        if self.magnitudes.len() < least {
            least = self.magnitudes.len();
        }
        least
    }
}
