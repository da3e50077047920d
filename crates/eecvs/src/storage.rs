//! Memory of an encoder on the host.

use std::alloc::{Layout, handle_alloc_error};
use std::num::NonZeroU32;

use eecvs_nostd::coder::arrival_order as arrival;
use eecvs_nostd::coder::coefficients::CoefficientMemory;
use eecvs_nostd::coder::dense::model::Model;
use eecvs_nostd::coder::dense::{DenseMemory, words};
use eecvs_nostd::coder::keys::EncoderMemory;
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
use zerocopy::{AllocError, FromBytes, FromZeros, IntoBytes};

use crate::tree_memory::TreeStorage;

/// Default capacity of a window's buffer on the host, in events.
pub const WINDOW_EVENTS: usize = 1 << 20;

/// Limits on windows, frames and memory of an encoder on the host.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Capacity of a window's buffer, in events.
    pub window_events: usize,
    /// Largest size of a frame in bytes, [`eecvs_nostd::OUTPUT_BYTES_MIN`] to [`eecvs_nostd::FRAME_BYTES_MAX`].
    pub frame_bytes: usize,
    /// Time in microseconds for which events are held back to be sorted. `None` selects
    /// [`REORDER_US`](crate::encode::REORDER_US), or [`REORDER_LIVE_US`](crate::encode::REORDER_LIVE_US) for a live
    /// source.
    pub reorder_us: Option<u32>,
    /// Upper limit on the memory of the dense coder, in 32-bit words.
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

/// Memory of an encoder on the host, with a capacity chosen at run time.
#[derive(Debug)]
pub struct HostStorage {
    window: WindowMemory,
    sums: Vec<Sum>,
    totals: Vec<WideSum>,
    magnitudes: Vec<u32>,
    model: Box<Model>,
    words: Vec<u32>,
    order: Vec<u32>,
    hot: Vec<u32>,
    coefficients: Box<CoefficientMemory>,
    tree: TreeStorage,
    keys: Option<Box<EncoderMemory>>,
}

/// Message for a system that refuses the memory.
pub(crate) const NO_MEMORY: &str = "the system refuses the encoders' memory: use fewer with --threads, or smaller windows with --window-events";

/// Message for an invalid configuration of windows.
pub(crate) const NO_WINDOW: &str = "the window needs a duration of at least 1 us, room for 1 to 2^24 - 1 events and a sensor of 1 to 2048 pixels a side";

/// Buffers of one window.
#[derive(Debug)]
pub(crate) struct WindowMemory {
    /// Slots, stored as words: the system provides these zeroed, and a memory page is allocated only once an event
    /// is stored in it.
    slots: Vec<u32>,
    heads: Vec<Head>,
    bitmap: Vec<u32>,
}

impl WindowMemory {
    /// Allocates memory for the lists of `segments` segments and for `window_events` events.
    pub(crate) fn new(
        segments: usize,
        window_events: usize,
    ) -> std::result::Result<Self, AllocError> {
        let words = window_events.checked_mul(size_of::<Slot>() / size_of::<u32>());
        Ok(Self {
            slots: u32::new_vec_zeroed(words.ok_or(AllocError)?)?,
            heads: Head::new_vec_zeroed(segments)?,
            bitmap: u32::new_vec_zeroed(bitmap_words(segments))?,
        })
    }

    /// Returns the capacity in events.
    fn slots(&self) -> usize {
        self.slots.len() / (size_of::<Slot>() / size_of::<u32>())
    }

    /// Creates a window over this memory; `None` if the configuration is invalid or asks for more than this memory has.
    pub(crate) fn window(&mut self, config: WindowConfig) -> Option<Window<'_>> {
        self.heads.fill(0);
        self.bitmap.fill(0);
        let buffers = WindowBuffers {
            slots: <[Slot]>::mut_from_bytes(self.slots.as_mut_bytes()).ok()?,
            heads: &mut self.heads,
            bitmap: &mut self.bitmap,
        };
        Window::new(config, buffers)
    }
}

/// Bytes of a window's slots and of a frame whose memory pages are allocated before the first event.
const TOUCHED_BYTES: usize = 1 << 17;

/// Allocates the memory pages that nearly every window uses, so that this does not delay encoding the first one.
pub(crate) fn touch(bytes: &mut [u8]) {
    let touched = bytes.len().min(TOUCHED_BYTES);
    // Without `black_box`, a compiler that knows that they are zero may leave the writes out.
    std::hint::black_box(&mut bytes[..touched]).fill(0);
}

/// Allocates room for a frame, zeroed.
///
/// # Errors
/// The system refuses the memory.
#[cfg(feature = "encode")]
pub(crate) fn frame_room(frame_bytes: usize) -> Result<Vec<u8>> {
    u8::new_vec_zeroed(frame_bytes).ok().context(NO_MEMORY)
}

impl HostStorage {
    /// Allocates memory for a sensor, with `window_events` events per window, for any transform and grid size. Ends the
    /// process if the system refuses it.
    #[must_use]
    pub fn new(sensor: Sensor, window_events: usize) -> Self {
        let limits = Limits {
            window_events,
            ..Limits::default()
        };
        Self::with_limits(sensor, limits).unwrap_or_else(|_| {
            let slots = Layout::array::<Slot>(window_events);
            handle_alloc_error(slots.unwrap_or(Layout::new::<Slot>()))
        })
    }

    /// Sets the memory of the dense coder to `words` 32-bit words, as on a microcontroller, where the previous
    /// window fits only for a small sensor.
    #[must_use]
    pub fn with_dense_words(mut self, words: usize) -> Self {
        self.words.resize(words, 0);
        self
    }

    /// As [`Self::new`], within limits.
    ///
    /// # Errors
    /// The system refuses the memory.
    pub(crate) fn with_limits(sensor: Sensor, limits: Limits) -> Result<Self> {
        let numbers = 2 * GRID_MAX;
        let segments = segments(sensor.width, sensor.height);
        let window = WindowMemory::new(segments, limits.window_events);
        let words = u32::new_vec_zeroed(words(sensor, true).min(limits.dense_words));
        let (Ok(window), Ok(words)) = (window, words) else {
            bail!(Refused, "{NO_MEMORY}");
        };
        Ok(Self {
            window,
            sums: vec![Sum::ZERO; numbers],
            totals: vec![WideSum::ZERO; numbers],
            magnitudes: vec![0; numbers],
            model: Box::new(Model::UNSET),
            words,
            order: Vec::new(),
            hot: Vec::new(),
            coefficients: Box::new(CoefficientMemory::UNSET),
            tree: TreeStorage::default(),
            keys: None,
        })
    }

    /// Creates an encoder over this memory, which is cleared.
    ///
    /// # Errors
    /// Fails if the window has a duration of 0 us or no room for events, or if the configuration is invalid (for
    /// example, M or K is out of range).
    pub fn encoder(&mut self, config: Config) -> Result<Encoder<'_>> {
        self.encoder_without(config, &[])
    }

    /// As [`Self::encoder`], but never sends the pixels `hot`, given as (column, row).
    ///
    /// # Errors
    /// As [`Self::encoder`]; also fails if a pixel is not on the sensor.
    pub fn encoder_without(&mut self, config: Config, hot: &[(u16, u16)]) -> Result<Encoder<'_>> {
        let (window, encoder) = self.parts(config, hot)?;
        Ok(Encoder::new(window, encoder))
    }

    /// Creates a window and its encoder over this memory, which is cleared. Pixels `hot`, given as (column,
    /// row), are never sent.
    ///
    /// # Errors
    /// As [`Self::encoder_without`].
    pub(crate) fn parts<'s>(
        &'s mut self,
        config: Config,
        hot: &[(u16, u16)],
    ) -> Result<(Window<'s>, WindowEncoder<'s>)> {
        if config.has_order_section() {
            let order = u32::new_vec_zeroed(arrival::words(self.window.slots()));
            self.order = order.ok().context(NO_MEMORY)?;
        }
        if let Some(effort) = config.mode.effort() {
            let tree = TreeStorage::new(config.window.sensor, effort, self.window.slots());
            self.tree = tree.ok().context(NO_MEMORY)?;
        }
        if config.mode.has_keys() && self.keys.is_none() {
            self.keys = Some(EncoderMemory::new_box_zeroed().ok().context(NO_MEMORY)?);
        }
        self.hot.resize(hot.len(), 0);
        touch(self.window.slots.as_mut_bytes());
        let window = self.window.window(config.windows()).context(NO_WINDOW)?;
        let scratch = Scratch {
            sums: &mut self.sums,
            totals: &mut self.totals,
            magnitudes: &mut self.magnitudes,
            dense: Some(DenseMemory {
                model: &mut self.model,
                words: &mut self.words,
            }),
            tree: config.mode.effort().map(|_| self.tree.lent()),
            keys: self.keys.as_deref_mut(),
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
                Ok((window, encoder))
            }
            Err(error) => bail!(Refused, "{}", reason(error, &config)),
        }
    }
}

/// Returns a message that says what is wrong with a configuration.
fn reason(error: ConfigError, config: &Config) -> String {
    match error {
        ConfigError::M => format!("M is {}: it must be 1 to 64", config.m),
        ConfigError::Grid => format!(
            "the grid is {}: it must be 1 to 1024",
            config.grid.unwrap_or_default()
        ),
        ConfigError::Bins => "a volume must have one bin or more".to_owned(),
        ConfigError::MeanError => {
            "a largest mean error is possible only in mode hybrid, without a tolerance or bins"
                .to_owned()
        }
        ConfigError::Rate if config.mode.is_transform() => {
            "a byte budget is possible only in mode hybrid: coefficients cannot be thinned"
                .to_owned()
        }
        ConfigError::Rate => format!(
            "a budget of {} bytes a second is too small: the headers of windows of {} us alone take {}: give more, or longer windows",
            config.bytes_per_second.map_or(0, NonZeroU32::get),
            config.window.window_us,
            config.budget_min()
        ),
        ConfigError::Order => {
            "the order of events can be kept only in mode hybrid, and not of spread events"
                .to_owned()
        }
        ConfigError::Keys if config.mode.is_transform() => {
            "the keys coder codes events, in mode hybrid".to_owned()
        }
        ConfigError::Keys => {
            "the keys coder has no order of events of equal time, filter of isolated \
                              events or byte budget"
                .to_owned()
        }
        ConfigError::Quick if config.mode.is_transform() => {
            "the quick coder codes events, in mode hybrid".to_owned()
        }
        ConfigError::Quick if !config.mode.keeps_arrival() => {
            "windows that keep the order of arrival are for the quick and the keys coder".to_owned()
        }
        ConfigError::Quick => {
            "the quick coder is lossless: it has no tolerance, bins, largest mean error, \
                               filter of isolated events or byte budget"
                .to_owned()
        }
        ConfigError::Tree if config.mode.is_transform() => {
            "the tree coder codes events, in mode hybrid".to_owned()
        }
        // These cannot occur, because the memory is allocated for the configuration, and the core has all features.
        ConfigError::Scratch
        | ConfigError::Dense
        | ConfigError::Coefficients
        | ConfigError::Transform
        | ConfigError::Tree => {
            format!("the encoder's memory is too small ({error:?}): please report this")
        }
    }
}
