//! Memory of an encoder on the host.

use std::num::NonZeroU32;

use eecvs_nostd::coder::arrival_order as arrival;
use eecvs_nostd::coder::coefficients::CoefficientMemory;
use eecvs_nostd::coder::dense::model::Model;
use eecvs_nostd::coder::dense::{DenseMemory, words};
use eecvs_nostd::encoder::config::ConfigError;
use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::transform::GRID_MAX;
use eecvs_nostd::window::Head;
use eecvs_nostd::{
    Config, Encoder, Scratch, Sensor, Slot, Window, WindowBuffers, WindowConfig, WindowEncoder,
    bitmap_words, segments,
};
use event_types::stream::{Context, Result};
use event_types::{bail, ensure};
use zerocopy::{FromBytes, IntoBytes};

/// Events that the host's window buffer holds.
pub const WINDOW_EVENTS: usize = 1 << 20;

/// How a recording is cut into windows and frames.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Events of a window's buffer.
    pub window_events: usize,
    /// Bytes of a frame, [`eecvs_nostd::OUTPUT_BYTES_MIN`] to [`eecvs_nostd::FRAME_BYTES_MAX`].
    pub frame_bytes: usize,
    /// Time for which events are put in order; none: [`REORDER_US`](crate::encode::REORDER_US), or [`REORDER_LIVE_US`](crate::encode::REORDER_LIVE_US) of a live source.
    pub reorder_us: Option<u32>,
    /// Words of the dense coder's rows, where that is less than it has use for.
    pub dense_words: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            window_events: WINDOW_EVENTS,
            frame_bytes: eecvs_nostd::FRAME_BYTES_MAX,
            reorder_us: None,
            dense_words: usize::MAX,
        }
    }
}

/// Memory of an encoder on the host, whose capacity is chosen at run time.
#[derive(Debug)]
pub struct HostStorage {
    windows: Vec<WindowMemory>,
    sums: Vec<Sum>,
    totals: Vec<WideSum>,
    magnitudes: Vec<u32>,
    model: Box<Model>,
    words: Vec<u32>,
    order: Vec<u32>,
    hot: Vec<u32>,
    coefficients: Box<CoefficientMemory>,
}

/// Buffers of a window.
#[derive(Debug)]
struct WindowMemory {
    /// Slots, as words: these the system hands out zeroed, and a page of memory is only taken when
    /// an event comes to lie in it.
    slots: Vec<u32>,
    heads: Vec<Head>,
    bitmap: Vec<u32>,
}

impl WindowMemory {
    fn new(sensor: Sensor, window_events: usize) -> Self {
        let segments = segments(sensor.width, sensor.height);
        Self {
            slots: vec![0; window_events * (size_of::<Slot>() / size_of::<u32>())],
            heads: vec![0; segments],
            bitmap: vec![0; bitmap_words(segments)],
        }
    }

    /// Events that it holds.
    fn slots(&self) -> usize {
        self.slots.len() / (size_of::<Slot>() / size_of::<u32>())
    }

    fn window(&mut self, config: WindowConfig) -> Option<Window<'_>> {
        self.heads.fill(0);
        self.bitmap.fill(0);
        touch(self.slots.as_mut_bytes());
        let buffers = WindowBuffers {
            slots: <[Slot]>::mut_from_bytes(self.slots.as_mut_bytes()).ok()?,
            heads: &mut self.heads,
            bitmap: &mut self.bitmap,
        };
        Window::new(config, buffers)
    }
}

/// Bytes of a window's slots and of a frame that are taken before the first event.
const TOUCHED_BYTES: usize = 1 << 17;

/// Takes the pages of what nearly every window fills, which else happens while the first is encoded.
pub(crate) fn touch(bytes: &mut [u8]) {
    let touched = bytes.len().min(TOUCHED_BYTES);
    // A compiler that knows that they are zero may leave it out.
    std::hint::black_box(&mut bytes[..touched]).fill(0);
}

impl HostStorage {
    /// Memory for a sensor and `window_events` events of a window, for any transform and grid.
    #[must_use]
    pub fn new(sensor: Sensor, window_events: usize) -> Self {
        let limits = Limits {
            window_events,
            ..Limits::default()
        };
        Self::with_windows(1, sensor, limits)
    }

    /// With no more words for the dense coder than a microcontroller has: the window before fits for
    /// a small sensor alone.
    #[must_use]
    pub fn with_dense_words(mut self, words: usize) -> Self {
        self.words.resize(words, 0);
        self
    }

    /// As [`Self::new`], with buffers for several windows.
    #[must_use]
    pub(crate) fn with_windows(windows: usize, sensor: Sensor, limits: Limits) -> Self {
        let numbers = 2 * GRID_MAX;
        Self {
            windows: (0..windows)
                .map(|_| WindowMemory::new(sensor, limits.window_events))
                .collect(),
            sums: vec![Sum::ZERO; numbers],
            totals: vec![WideSum::ZERO; numbers],
            magnitudes: vec![0; numbers],
            model: Box::new(Model::UNSET),
            words: vec![0; words(sensor, true).min(limits.dense_words)],
            order: Vec::new(),
            hot: Vec::new(),
            coefficients: Box::new(CoefficientMemory::UNSET),
        }
    }

    /// An encoder over this memory, which is cleared.
    ///
    /// # Errors
    /// A window of 0 us or of no events, M or K out of range.
    pub fn encoder(&mut self, config: Config) -> Result<Encoder<'_>> {
        self.encoder_without(config, &[])
    }

    /// The same without the pixels `hot`, columns and rows.
    ///
    /// # Errors
    /// As [`Self::encoder`]; a pixel that is not on the sensor.
    pub fn encoder_without(&mut self, config: Config, hot: &[(u16, u16)]) -> Result<Encoder<'_>> {
        let (mut windows, encoder) = self.parts(config, hot)?;
        let window = windows.pop().context("the memory has no window")?;
        Ok(Encoder::new(window, encoder))
    }

    /// Every window, and the encoder of them, over this memory, which is cleared; without the pixels
    /// `hot`, columns and rows.
    ///
    /// # Errors
    /// As [`Self::encoder`].
    pub(crate) fn parts<'s>(
        &'s mut self,
        config: Config,
        hot: &[(u16, u16)],
    ) -> Result<(Vec<Window<'s>>, WindowEncoder<'s>)> {
        if config.keep_order {
            let slots = self.windows.first().map_or(0, WindowMemory::slots);
            self.order = vec![0; arrival::words(slots)];
        }
        self.hot.resize(hot.len(), 0);
        let windows: Option<Vec<_>> = self
            .windows
            .iter_mut()
            .map(|memory| memory.window(config.window))
            .collect();
        let windows = windows.context(
            "the window needs a duration of at least 1 us, room for 1 to 2^24 - 1 events and a \
             sensor of 1 to 2048 pixels a side",
        )?;
        let scratch = Scratch {
            sums: &mut self.sums,
            totals: &mut self.totals,
            magnitudes: &mut self.magnitudes,
            dense: Some(DenseMemory {
                model: &mut self.model,
                words: &mut self.words,
            }),
            coefficients: Some(&mut self.coefficients),
            hot: &mut self.hot,
            order: &mut self.order,
        };
        match WindowEncoder::new(config, scratch) {
            Ok(mut encoder) => {
                for (x, y) in hot {
                    ensure!(
                        encoder.add_hot((*x, *y)).is_ok(),
                        Refused,
                        "the hot pixel {x},{y} is not on the sensor"
                    );
                }
                Ok((windows, encoder))
            }
            Err(error) => bail!(Refused, "{}", reason(error, &config)),
        }
    }
}

/// What is wrong with a configuration.
fn reason(error: ConfigError, config: &Config) -> String {
    match error {
        ConfigError::M => format!("M is {}: it must be 1 to 64", config.m),
        ConfigError::Grid => format!(
            "the grid is of {}: it must be of 1 to 1024",
            config.grid.unwrap_or_default()
        ),
        ConfigError::Bins => "a volume has one bin or more".to_owned(),
        ConfigError::Rate if config.mode.is_transform() => {
            "a budget of bytes is for mode hybrid: coefficients cannot be thinned".to_owned()
        }
        ConfigError::Rate => format!(
            "a budget of {} bytes a second is too small: the headers of windows of {} us alone take {}",
            config.bytes_per_second.map_or(0, NonZeroU32::get),
            config.window.window_us,
            config.budget_min()
        ),
        ConfigError::Order => "the order of events is for mode hybrid".to_owned(),
        // The memory is made for the configuration.
        ConfigError::Scratch | ConfigError::Dense | ConfigError::Coefficients => {
            format!("the encoder's memory is too small ({error:?}): please report this")
        }
    }
}
