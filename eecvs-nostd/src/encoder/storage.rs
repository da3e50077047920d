//! Static memory for an encoder.

use crate::coder::dense::DenseMemory;
use crate::encoder::Encoder;
use crate::encoder::config::{Config, Scratch, SetupError};
use crate::fixed_point::{Sum, WideSum};
use crate::window::{Head, Slot, WindowBuffers};

/// All buffers of an encoder, zeroed, for `.bss`.
///
/// | parameter | value | bytes each |
/// |---|---|---|
/// | `EVENTS` | events of a window | 8 |
/// | `SEGMENTS` | [`crate::segments`] of the sensor | 2 on a microcontroller, 4 on a host |
/// | `BITMAP` | [`crate::bitmap_words`] of `SEGMENTS` | 4 |
/// | `NUMBERS` | 2K for the largest K in use | 16 |
#[derive(Debug)]
pub struct Storage<
    const EVENTS: usize,
    const SEGMENTS: usize,
    const BITMAP: usize,
    const NUMBERS: usize,
> {
    slots: [Slot; EVENTS],
    heads: [Head; SEGMENTS],
    bitmap: [u32; BITMAP],
    sums: [Sum; NUMBERS],
    totals: [WideSum; NUMBERS],
    magnitudes: [u32; NUMBERS],
}

impl<const EVENTS: usize, const SEGMENTS: usize, const BITMAP: usize, const NUMBERS: usize>
    Storage<EVENTS, SEGMENTS, BITMAP, NUMBERS>
{
    /// Returns zeroed buffers, for a static in `.bss`.
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

    /// Sets up an encoder in these buffers, which are cleared.
    ///
    /// # Errors
    /// [`SetupError`] if the configuration is invalid or the buffers are too small for it.
    pub fn encoder(&mut self, config: Config) -> Result<Encoder<'_>, SetupError> {
        self.encoder_with(config, None)
    }

    /// As [`Self::encoder`], with memory for the dense coder of hybrid frames.
    ///
    /// # Errors
    /// [`SetupError`] if the configuration is invalid or the buffers are too small for it.
    pub fn encoder_with<'b>(
        &'b mut self,
        config: Config,
        dense: Option<DenseMemory<'b>>,
    ) -> Result<Encoder<'b>, SetupError> {
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
            dense,
            tree: None,
            keys: None,
            coefficients: None,
            hot: &mut [],
            order: &mut [],
        };
        Encoder::set_up(config, buffers, scratch)
    }
}

impl<const EVENTS: usize, const SEGMENTS: usize, const BITMAP: usize, const NUMBERS: usize> Default
    for Storage<EVENTS, SEGMENTS, BITMAP, NUMBERS>
{
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encoder::config::ConfigError;
    use crate::encoder::window_encoder::WindowEncoder;
    use crate::window::Window;
    use crate::window::filter::Filter;
    use crate::{
        KEY_WINDOWS, Mode, Quantiser, Sensor, Thresholds, WindowConfig, bitmap_words, segments,
    };

    const SEGMENTS: usize = segments(40, 3);
    const BITMAP: usize = bitmap_words(SEGMENTS);
    type Small = Storage<16, SEGMENTS, BITMAP, 64>;

    static STORAGE: std::sync::Mutex<Small> = std::sync::Mutex::new(Small::new());

    const CONFIG: Config = Config {
        window: WindowConfig::new(
            Sensor {
                width: 40,
                height: 3,
            },
            1000,
        ),
        thresholds: Thresholds::new(0, 0).unwrap(),
        transform: None,
        m: 16,
        grid: None,
        quantiser: Quantiser::DEFAULT,
        few_as_times: false,
        max_emd_us: None,
        mode: Mode::Transform,
        key_windows: KEY_WINDOWS,
        readout: None,
        filter: Filter::NONE,
        bytes_per_second: None,
        keep_order: false,
    };

    /// Anything but zeros would move the buffers from .bss to .data, and so into flash.
    #[test]
    fn a_static_is_all_zero_and_serves_an_encoder() {
        let mut storage = STORAGE.lock().unwrap();
        assert!(storage.slots.iter().all(|slot| *slot == Slot::EMPTY));
        assert_eq!((Slot::EMPTY.offset_us(), Slot::EMPTY.next()), (0, 0));
        assert_eq!((Slot::EMPTY.column(), Slot::EMPTY.is_on()), (0, false));
        assert!(
            storage
                .heads
                .iter()
                .chain(&storage.bitmap)
                .all(|word| *word == 0)
        );
        assert!(storage.sums.iter().all(|sum| sum.to_bits() == 0));
        assert!(storage.totals.iter().all(|total| total.to_bits() == 0));
        assert!(storage.magnitudes.iter().all(|magnitude| *magnitude == 0));
        assert!(storage.encoder(CONFIG).is_ok());
    }

    const BUILT_IN_CONST: bool = {
        let (mut slots, mut heads, mut bitmap) = ([Slot::EMPTY; 1], [0; SEGMENTS], [0; BITMAP]);
        let (mut sums, mut totals) = ([Sum::ZERO; 64], [WideSum::ZERO; 64]);
        let mut magnitudes = [0; 64];
        let buffers = WindowBuffers {
            slots: &mut slots,
            heads: &mut heads,
            bitmap: &mut bitmap,
        };
        let scratch = Scratch {
            sums: &mut sums,
            totals: &mut totals,
            magnitudes: &mut magnitudes,
            dense: None,
            tree: None,
            keys: None,
            coefficients: None,
            hot: &mut [],
            order: &mut [],
        };
        match (
            Window::new(CONFIG.window, buffers),
            WindowEncoder::new(CONFIG, scratch),
        ) {
            (Some(window), Ok(encoder)) => {
                let _encoder = Encoder::new(window, encoder);
                true
            }
            _ => false,
        }
    };

    #[test]
    fn setup_tells_what_does_not_fit() {
        const { assert!(BUILT_IN_CONST) };
        let mut storage = Small::new();
        let mut error = |change: fn(&mut Config)| {
            let mut config = CONFIG;
            change(&mut config);
            storage.encoder(config).err()
        };
        let config = |error| Some(SetupError::Config(error));
        assert_eq!(error(|_| ()), None);
        assert_eq!(error(|c| c.window.window_us = 0), Some(SetupError::Window));
        assert_eq!(
            error(|c| c.window.sensor.height = 5),
            Some(SetupError::Window)
        );
        assert_eq!(
            error(|c| c.window.sensor.width = 0),
            Some(SetupError::Window)
        );
        assert_eq!(error(|c| c.m = 0), config(ConfigError::M));
        assert_eq!(error(|c| c.m = 65), config(ConfigError::M));
        assert_eq!(error(|c| c.m = 17), config(ConfigError::Scratch));
        assert_eq!(error(|c| c.grid = Some(0)), config(ConfigError::Grid));
        assert_eq!(error(|c| c.grid = Some(1025)), config(ConfigError::Grid));
        assert_eq!(error(|c| c.grid = Some(33)), config(ConfigError::Scratch));
        // The buffers suffice, but no reader accepts a frame of this sensor.
        let mut storage = Storage::<1, 4096, 4096, 64>::new();
        let mut config = CONFIG;
        config.window.sensor = Sensor {
            width: Sensor::SIDE_MAX + 1,
            height: 1,
        };
        assert_eq!(storage.encoder(config).err(), Some(SetupError::Window));
    }
}
