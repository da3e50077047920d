//! Configuration of an encoder, as C has it.

use core::num::NonZeroU32;

use eecvs_nostd::{
    Coder, Config, Fidelity, Filter, Hybrid, KEY_WINDOWS, Mode, Quantiser, Sensor, Thresholds,
    Transform, WindowConfig,
};

use crate::pointer::is_lent;
use crate::status::EecvsStatus;

/// How windows are coded: values of `eecvs_config.coder`.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EecvsCoder {
    /// The events themselves, quickly.
    Fast = 0,
    /// The events themselves in their order of arrival: the quickest, for more bits. Exact, and without a budget.
    Quick = 1,
    /// The events themselves, in the fewest bits that a microcontroller has room for.
    Dense = 2,
    /// Coefficients of a transform.
    Transform = 3,
}

/// Transforms: values of `eecvs_config.transform`.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EecvsTransform {
    /// Discrete cosine transform.
    Dct = 0,
    /// Discrete-time Fourier transform.
    Dtft = 1,
    /// Haar wavelet transform.
    Dwt = 2,
}

/// Configuration of an encoder. `eecvs_config_init` fills it; change what differs.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EecvsConfig {
    /// Columns of the sensor, 1 to 2048.
    pub width: u16,
    /// Rows of the sensor, 1 to 2048.
    pub height: u16,
    /// Duration of a window in microseconds, at least 1.
    pub window_us: u32,
    /// Most events of a window: a fuller one is closed early. On machines of 32 bits at most 32767.
    pub window_events: u32,
    /// How windows are coded, an `eecvs_coder`.
    pub coder: u8,
    /// The transform, an `eecvs_transform`; also that of the volume that a decoder makes of events.
    pub transform: u8,
    /// Number of coefficients M, 1 to 64.
    pub m: u8,
    /// log2 of the quantiser's step, -15 to 8.
    pub step_log2: i8,
    /// Largest error of a decoded time in microseconds; 0 for exact times, unless a budget asks for less. Of events alone,
    /// not of the quick coder.
    pub tolerance_us: u32,
    /// Most bytes of the frames of any second; 0 for no budget. Of events alone, not of the quick coder. A window that would
    /// take more has its times within a tolerance, up to half a window, then fewer events: `eecvs_losses` counts both.
    pub bytes_per_second: u32,
    /// Room for so many pixels that are never sent: see `eecvs_add_hot`.
    pub hot_pixels: u32,
    /// Number of windows after which the dense coder begins anew, so that a decoder that has lost a frame can go on.
    pub key_windows: u16,
    /// 1 to remove events without another one at their pixel or at a neighbour in the same window, else 0.
    pub remove_isolated: u8,
    /// 1 to send pixels of few events as the times of these in place of coefficients, else 0.
    pub few_as_times: u8,
}

/// The transform does not follow the density.
const ONE_REGIME: Thresholds = match Thresholds::new(0, 0) {
    Some(thresholds) => thresholds,
    None => unreachable!(),
};

impl EecvsConfig {
    /// Returns the encoder's configuration.
    pub(crate) fn parse(&self) -> Result<Config, EecvsStatus> {
        let sensor = Sensor::new(self.width, self.height).ok_or(EecvsStatus::ErrorWindow)?;
        if self.window_us == 0 || self.window_events == 0 {
            return Err(EecvsStatus::ErrorWindow);
        }
        let fidelity = match self.tolerance_us {
            0 => Fidelity::Lossless,
            tolerance_us => Fidelity::ToleranceUs(tolerance_us),
        };
        let coder = match self.coder {
            0 => Some(Coder::Fast),
            1 if cfg!(feature = "quick") => Some(Coder::Quick),
            2 if cfg!(feature = "dense") => Some(Coder::Dense),
            3 if cfg!(feature = "transform") => None,
            _ => return Err(EecvsStatus::ErrorCoder),
        };
        // Of two reasons that refuse it, the budget's is named.
        if self.bytes_per_second > 0 && coder == Some(Coder::Quick) {
            return Err(EecvsStatus::ErrorBudget);
        }
        let mode = match coder {
            Some(coder) => Mode::Hybrid(Hybrid { coder, fidelity }),
            None if self.tolerance_us > 0 => return Err(EecvsStatus::ErrorFidelity),
            None => Mode::Transform,
        };
        let transform = match self.transform {
            0 => Transform::Dct,
            1 => Transform::Dtft,
            2 => Transform::Dwt,
            _ => return Err(EecvsStatus::ErrorCoder),
        };
        let mut config = Config::new(WindowConfig::new(sensor, self.window_us), ONE_REGIME, mode);
        config.transform = Some(transform);
        config.m = self.m;
        config.quantiser = Quantiser::new(self.step_log2).ok_or(EecvsStatus::ErrorCoefficients)?;
        config.few_as_times = flag(self.few_as_times)?;
        config.filter = Filter {
            isolated: flag(self.remove_isolated)?,
            ..Filter::NONE
        };
        config.bytes_per_second = NonZeroU32::new(self.bytes_per_second);
        config.key_windows = self.key_windows;
        Ok(config)
    }
}

const fn flag(byte: u8) -> Result<bool, EecvsStatus> {
    match byte {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(EecvsStatus::ErrorFlag),
    }
}

/// Fills a configuration: the fast coder, exact times, windows of 32,768 us with at most 2,048 events, no budget, no
/// filter; for coefficients the DCT with M = 16 and a step of 2^-6.
///
/// # Safety
/// `config` is null or points to a configuration that can be written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn eecvs_config_init(
    config: *mut EecvsConfig,
    width: u16,
    height: u16,
) -> EecvsStatus {
    if !is_lent(config) {
        return EecvsStatus::ErrorPointer;
    }
    let filled = EecvsConfig {
        width,
        height,
        window_us: 32_768,
        window_events: 2048,
        coder: EecvsCoder::Fast as u8,
        transform: EecvsTransform::Dct as u8,
        m: 16,
        step_log2: Quantiser::DEFAULT.step_log2(),
        tolerance_us: 0,
        bytes_per_second: 0,
        hot_pixels: 0,
        key_windows: KEY_WINDOWS,
        remove_isolated: 0,
        few_as_times: 0,
    };
    // SAFETY: it is not null and aligned, and the caller lends what it points to for the call.
    unsafe { config.write(filled) };
    EecvsStatus::Ok
}
