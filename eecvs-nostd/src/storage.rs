//! Static memory of an encoder.

use crate::encoder::{Config, ConfigError, Encoder, Scratch, WindowEncoder};
use crate::fixed_point::{Sum, WideSum};
use crate::window::{Slot, Window, WindowBuffers};

/// Every buffer of an encoder, zeroed, for `.bss`.
///
/// `EVENTS` of a window: 8 bytes each. `SEGMENTS` = [`crate::segments`] of the sensor: 4 bytes
/// each. `BITMAP` = [`crate::bitmap_words`] of them: 4 bytes each. `NUMBERS` = 2K for the largest
/// K in use: 20 bytes each.
#[derive(Debug)]
pub struct Storage<
    const EVENTS: usize,
    const SEGMENTS: usize,
    const BITMAP: usize,
    const NUMBERS: usize,
> {
    slots: [Slot; EVENTS],
    heads: [u32; SEGMENTS],
    bitmap: [u32; BITMAP],
    sums: [Sum; NUMBERS],
    totals: [WideSum; NUMBERS],
    magnitudes: [u64; NUMBERS],
}

/// Why an encoder cannot be set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SetupError {
    /// The event buffers are empty or too small for the sensor, or T is 0.
    Window,
    /// The rest of the configuration.
    Config(ConfigError),
}

impl<const EVENTS: usize, const SEGMENTS: usize, const BITMAP: usize, const NUMBERS: usize>
    Storage<EVENTS, SEGMENTS, BITMAP, NUMBERS>
{
    /// Zeroed buffers.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            slots: [Slot::EMPTY; EVENTS],
            heads: [0; SEGMENTS],
            bitmap: [0; BITMAP],
            sums: [Sum::ZERO; NUMBERS],
            totals: [WideSum::ZERO; NUMBERS],
            magnitudes: [0; NUMBERS],
        }
    }

    /// An encoder over these buffers, which are cleared.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn encoder(&mut self, config: Config) -> Result<Encoder<'_>, SetupError> {
        self.heads.fill(0);
        self.bitmap.fill(0);
        let buffers = WindowBuffers {
            slots: &mut self.slots,
            heads: &mut self.heads,
            bitmap: &mut self.bitmap,
        };
        let scratch = Scratch {
            sums: &mut self.sums,
            totals: &mut self.totals,
            magnitudes: &mut self.magnitudes,
        };
        let window = Window::new(config.window, buffers).ok_or(SetupError::Window)?;
        let encoder = WindowEncoder::new(config, scratch).map_err(SetupError::Config)?;
        Ok(Encoder::new(window, encoder))
    }
}

impl<const EVENTS: usize, const SEGMENTS: usize, const BITMAP: usize, const NUMBERS: usize> Default
    for Storage<EVENTS, SEGMENTS, BITMAP, NUMBERS>
{
    fn default() -> Self {
        Self::new()
    }
}
