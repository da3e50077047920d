//! Encoder with its window: takes events, returns frames.

pub mod config;
mod keys;
mod mean_error;
mod rate;
pub mod storage;
pub mod window_encoder;

use crate::coder::arrival_order;
use crate::encoder::config::{Config, ConfigError, HotError, Scratch, SetupError};
use crate::encoder::window_encoder::{Encoded, WindowEncoder};
use crate::frame::NoRoom;
use crate::stage::Trace;
use crate::window::{Push, Window, WindowBuffers};
use event_types::Event;

/// A window and its encoder: takes events by [`Self::push`], returns frames by [`Self::next_frame`].
///
/// ```
/// # use eecvs_nostd::*;
/// let mut storage: Storage<64, { segments(8, 4) }, { bitmap_words(segments(8, 4)) }, 128> =
///     Storage::new();
/// let window = WindowConfig::new(Sensor::new(8, 4).unwrap(), 1000);
/// let thresholds = Thresholds::new(0, 0).unwrap();
/// let config = Config::new(window, thresholds, Mode::Hybrid(Hybrid::default()));
/// let mut encoder = storage.encoder(config).unwrap();
/// let mut out = [0; 2048];
/// let mut frames = 0;
/// for t_us in [5, 700, 1200] {
///     let event = Event { t_us, x: 3, y: 2, polarity: Polarity::On };
///     while encoder.push(event) == Push::Closed {
///         while let Some(frame) = encoder.next_frame(&mut out).unwrap() {
///             frames += 1; // send &out[frame.range]
///         }
///     }
/// }
/// encoder.flush();
/// while encoder.next_frame(&mut out).unwrap().is_some() {
///     frames += 1;
/// }
/// assert_eq!(frames, 2);
/// ```
#[derive(Debug)]
pub struct Encoder<'b> {
    window: Window<'b>,
    encoder: WindowEncoder<'b>,
}

impl<'b> Encoder<'b> {
    /// Combines a window with an encoder for the same sensor.
    #[must_use]
    pub const fn new(window: Window<'b>, encoder: WindowEncoder<'b>) -> Self {
        Self { window, encoder }
    }

    /// Sets up an encoder in lent memory, which has to be zeroed.
    ///
    /// # Errors
    /// [`SetupError`] if the configuration is invalid or the memory does not suffice for it.
    pub const fn set_up(
        config: Config,
        buffers: WindowBuffers<'b>,
        scratch: Scratch<'b>,
    ) -> Result<Self, SetupError> {
        let slots = buffers.slots.len();
        let Some(window) = Window::new(config.windows(), buffers) else {
            return Err(SetupError::Window);
        };
        if config.has_order_section() && scratch.order.len() < arrival_order::words(slots) {
            return Err(SetupError::Config(ConfigError::Order));
        }
        match WindowEncoder::new(config, scratch) {
            Ok(encoder) => Ok(Self::new(window, encoder)),
            Err(error) => Err(SetupError::Config(error)),
        }
    }

    /// Adds an event. On [`Push::Closed`] take every frame of the closed window, then push the event again.
    #[inline]
    pub fn push(&mut self, event: Event) -> Push {
        self.window.push(event)
    }

    /// Closes the open window, so that its frames can be taken.
    pub fn flush(&mut self) {
        self.window.flush();
    }

    /// Encodes the next frame of the closed window into `out`; `None` if there is none left. See
    /// [`WindowEncoder::next_frame`].
    ///
    /// # Errors
    /// [`NoRoom`] if `out` is too short.
    pub fn next_frame(&mut self, out: &mut [u8]) -> Result<Option<Encoded>, NoRoom> {
        self.encoder.next_frame(&mut self.window, out)
    }

    /// As [`Self::next_frame`], reporting stages to `trace`. See [`WindowEncoder::next_frame_traced`].
    ///
    /// # Errors
    /// [`NoRoom`] if `out` is too short.
    pub fn next_frame_traced(
        &mut self,
        out: &mut [u8],
        trace: &mut impl Trace,
    ) -> Result<Option<Encoded>, NoRoom> {
        self.encoder.next_frame_traced(&mut self.window, out, trace)
    }

    /// Keeps a pixel (column, row) out of all later windows. See [`WindowEncoder::add_hot`].
    ///
    /// # Errors
    /// [`HotError`] if the pixel is not on the sensor, or there is no room for it.
    pub fn add_hot(&mut self, pixel: (u16, u16)) -> Result<usize, HotError> {
        self.encoder.add_hot(pixel)
    }

    /// Returns the window, to count drops or to inspect it.
    pub const fn window(&mut self) -> &mut Window<'b> {
        &mut self.window
    }
}
