//! What an encoder is asked to do, the memory that it is lent, and why it refuses.

use core::num::NonZeroU32;

use crate::coder::coefficients::CoefficientMemory;
use crate::coder::dense::DenseMemory;
use crate::coder::key_frames::KEY_WINDOWS;
use crate::coder::{Fidelity, Hybrid, Readout};
use crate::encoder::rate::WINDOW_BYTES_MIN;
use crate::fixed_point::{Sum, WideSum};
use crate::frame::{M_DEFAULT, Mode};
use crate::quantise::Quantiser;
use crate::regime::Thresholds;
use crate::transform::{GRID_MAX, M_MAX, Transform};
use crate::window::WindowConfig;
use crate::window::filter::Filter;

/// Whether windows can keep the order of their events: without the feature nothing of it is compiled.
pub(crate) const HAS_ORDER: bool = cfg!(feature = "order");

/// What the encoder is asked to do. Fixed while it runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// Sensor and T.
    pub window: WindowConfig,
    /// Densities between the regimes.
    pub thresholds: Thresholds,
    /// One transform for every window, or `None` for the regime's (eq. 3).
    pub transform: Option<Transform>,
    /// M, 1 to 64.
    pub m: u8,
    /// K, 1 to 1024, or `None` for the transform's default.
    pub grid: Option<u16>,
    /// Quantiser of the coefficients.
    pub quantiser: Quantiser,
    /// What frames hold. In a hybrid one transform, M, K and quantiser are those of the volume that a
    /// decoder makes.
    pub mode: Mode,
    /// Windows after which a frame of the dense coder begins anew, so that a decoder that lost one
    /// goes on: [`crate::coder::key_frames::KEY_WINDOWS`] is a choice for files and good links.
    pub key_windows: u16,
    /// How the sensor scans: a window whose times lie on such scans is told by them, by the dense
    /// coder where it is lossless.
    pub readout: Option<Readout>,
    /// What is kept out of every window, beside the pixels of [`crate::WindowEncoder::add_hot`].
    pub filter: Filter,
    /// Bytes that the frames of any second take at the most, of a hybrid mode: see `rate.rs`.
    pub bytes_per_second: Option<NonZeroU32>,
    /// Events of equal time are decoded in the order in which they came, of a hybrid mode; equal is what a
    /// decoder is told as the same cell. Under a budget, where there is room for it. It takes
    /// [`Scratch::order`].
    pub keep_order: bool,
}

/// Why a configuration cannot run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ConfigError {
    /// M is not in 1..=64.
    M,
    /// K is not in 1..=1024.
    Grid,
    /// [`Scratch`] is smaller than the largest grid needs.
    Scratch,
    /// [`Scratch::dense`] is missing or smaller than the sensor needs.
    Dense,
    /// [`Scratch::coefficients`] is missing, or the feature of that name.
    Coefficients,
    /// A volume of no bins.
    Bins,
    /// A budget for coefficients, or of fewer than some 146 bytes a window.
    Rate,
    /// The order of events of mode transform, without memory for it, or without the feature `order`.
    Order,
}

/// Why an encoder cannot be set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SetupError {
    /// [`crate::Window::new`] refuses: the event buffers are empty or too small for the sensor, the sensor
    /// is out of range, or T is 0.
    Window,
    /// The rest of the configuration.
    Config(ConfigError),
}

/// Why a pixel cannot be kept out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HotError {
    /// It is not on the sensor.
    Outside,
    /// [`Scratch::hot`] is full.
    NoRoom,
}

impl Config {
    /// The defaults of everything else: the regime's transform, M = 16, K and quantiser by default, key
    /// frames as files have them, nothing kept out, no budget, no order of equal times.
    #[must_use]
    pub const fn new(window: WindowConfig, thresholds: Thresholds, mode: Mode) -> Self {
        Self {
            window,
            thresholds,
            transform: None,
            m: M_DEFAULT,
            grid: None,
            quantiser: Quantiser::DEFAULT,
            mode,
            key_windows: KEY_WINDOWS,
            readout: None,
            filter: Filter::NONE,
            bytes_per_second: None,
            keep_order: false,
        }
    }

    /// The least budget, bytes a second: what the headers of all windows take, and an eighth more.
    #[must_use]
    pub const fn budget_min(&self) -> u64 {
        let window_us = match NonZeroU32::new(self.window.window_us) {
            Some(window_us) => window_us,
            None => NonZeroU32::MIN,
        };
        let windows = 1_000_000_u32.div_ceil(window_us.get());
        windows as u64 * WINDOW_BYTES_MIN as u64 * 8 / 7
    }

    /// Whether it can run with the memory.
    pub(crate) const fn check(&self, scratch: &Scratch<'_>) -> Result<(), ConfigError> {
        if self.m == 0 || self.m as usize > M_MAX {
            return Err(ConfigError::M);
        }
        if let Some(grid) = self.grid
            && (grid == 0 || grid as usize > GRID_MAX)
        {
            return Err(ConfigError::Grid);
        }
        if let Some(budget) = self.bytes_per_second
            && (self.mode.is_transform() || (budget.get() as u64) < self.budget_min())
        {
            return Err(ConfigError::Rate);
        }
        let has_order = HAS_ORDER && !self.mode.is_transform() && !scratch.order.is_empty();
        if self.keep_order && !has_order {
            return Err(ConfigError::Order);
        }
        match self.mode {
            Mode::Transform | Mode::Coefficients(_) if scratch.numbers() < 2 * self.grid_max() => {
                Err(ConfigError::Scratch)
            }
            Mode::Coefficients(_)
                if !cfg!(feature = "coefficients") || scratch.coefficients.is_none() =>
            {
                Err(ConfigError::Coefficients)
            }
            Mode::Hybrid(Hybrid {
                fidelity: Fidelity::Bins(0),
                ..
            }) => Err(ConfigError::Bins),
            mode if mode.is_dense() => match &scratch.dense {
                Some(memory) if memory.serves(self.window.sensor) => Ok(()),
                _ => Err(ConfigError::Dense),
            },
            _ => Ok(()),
        }
    }

    /// Largest K of any window.
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

/// Memory lent for the coefficients of one pixel, zeroed or not: 2K of each number.
#[derive(Debug)]
pub struct Scratch<'b> {
    /// Sums of a chunk.
    pub sums: &'b mut [Sum],
    /// Sums of a pixel of several chunks.
    pub totals: &'b mut [WideSum],
    /// Magnitudes, and levels once these have told what is kept.
    pub magnitudes: &'b mut [u32],
    /// What the dense coder of hybrid frames remembers; needed for it alone.
    pub dense: Option<DenseMemory<'b>>,
    /// Memory of the adaptive coders of coefficients; needed for them alone.
    pub coefficients: Option<&'b mut CoefficientMemory>,
    /// A word for each pixel that is never sent: see [`crate::WindowEncoder::add_hot`].
    pub hot: &'b mut [u32],
    /// Words for [`Config::keep_order`], [`crate::coder::arrival_order::words`] of a window's slots,
    /// and none without it. A window that filled more slots is sent without its order, which its frames
    /// then do not claim.
    pub order: &'b mut [u32],
}

impl Scratch<'_> {
    /// Numbers that every part has room for.
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
