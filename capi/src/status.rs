//! What functions return.

use core::ffi::{CStr, c_char};

use eecvs_nostd::{ConfigError, HotError, SetupError};

/// What a function returns: 0 and more are no errors.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EecvsStatus {
    /// All was done.
    Ok = 0,
    /// The window is closed, or there are decoded events to take: take the frames or the events, then go on with the
    /// rest of the input.
    Closed = 1,
    /// There is nothing left: no frame of a closed window, no window of the frames so far.
    None = 2,
    /// A pointer is null, or not aligned for what it points to.
    ErrorPointer = -1,
    /// The memory is too small: see `eecvs_encoder_size`.
    ErrorMemory = -2,
    /// The width, the height, the duration or the number of events of windows is 0 or too large.
    ErrorWindow = -3,
    /// The coder or the transform has no such number, or this library was built without it.
    ErrorCoder = -4,
    /// M is not in 1 to 64, or the step is not in 2^-15 to 2^8.
    ErrorCoefficients = -5,
    /// The coder has no tolerance of times, or no filter of isolated events.
    ErrorFidelity = -6,
    /// The budget is too small for the headers of a second's windows, or the coder has none.
    ErrorBudget = -7,
    /// A field that is 0 or 1 is neither.
    ErrorFlag = -8,
    /// The room for a frame is below `EECVS_FRAME_BYTES_MIN`.
    ErrorRoom = -9,
    /// The pixel is not on the sensor.
    ErrorOutside = -10,
    /// There is no room for another hot pixel.
    ErrorHot = -11,
    /// The frames hold no windows, or more than a limit allows.
    ErrorFrames = -12,
    /// The decoder was finished.
    ErrorFinished = -13,
    /// A fault of the library itself: please report it.
    ErrorInternal = -14,
}

/// Every status in a few English words.
const NAMES: [(EecvsStatus, &CStr); 17] = [
    (EecvsStatus::Ok, c"done"),
    (EecvsStatus::Closed, c"take what is ready, then go on"),
    (EecvsStatus::None, c"nothing left"),
    (
        EecvsStatus::ErrorPointer,
        c"a pointer is null or not aligned",
    ),
    (EecvsStatus::ErrorMemory, c"the memory is too small"),
    (EecvsStatus::ErrorWindow, c"sensor or window out of range"),
    (
        EecvsStatus::ErrorCoder,
        c"no such coder or transform in this library",
    ),
    (
        EecvsStatus::ErrorCoefficients,
        c"M or the step is out of range",
    ),
    (
        EecvsStatus::ErrorFidelity,
        c"the coder has no tolerance or no such filter",
    ),
    (
        EecvsStatus::ErrorBudget,
        c"the budget is too small, or the coder has none",
    ),
    (EecvsStatus::ErrorFlag, c"a flag is neither 0 nor 1"),
    (EecvsStatus::ErrorRoom, c"the room for a frame is too small"),
    (EecvsStatus::ErrorOutside, c"the pixel is not on the sensor"),
    (EecvsStatus::ErrorHot, c"no room for another hot pixel"),
    (
        EecvsStatus::ErrorFrames,
        c"the frames hold nothing that can be decoded",
    ),
    (EecvsStatus::ErrorFinished, c"the decoder was finished"),
    (
        EecvsStatus::ErrorInternal,
        c"a fault of the library: please report it",
    ),
];

impl From<SetupError> for EecvsStatus {
    fn from(error: SetupError) -> Self {
        match error {
            SetupError::Window => Self::ErrorWindow,
            SetupError::Config(error) => error.into(),
        }
    }
}

impl From<ConfigError> for EecvsStatus {
    fn from(error: ConfigError) -> Self {
        match error {
            ConfigError::M | ConfigError::Grid => Self::ErrorCoefficients,
            ConfigError::Scratch => Self::ErrorMemory,
            ConfigError::Quick
            | ConfigError::Bins
            | ConfigError::MeanError
            | ConfigError::Order => Self::ErrorFidelity,
            ConfigError::Rate => Self::ErrorBudget,
            ConfigError::Dense
            | ConfigError::Coefficients
            | ConfigError::Tree
            | ConfigError::Keys
            | ConfigError::Transform => Self::ErrorCoder,
        }
    }
}

impl From<HotError> for EecvsStatus {
    fn from(error: HotError) -> Self {
        match error {
            HotError::Outside => Self::ErrorOutside,
            HotError::NoRoom => Self::ErrorHot,
        }
    }
}

/// Returns a status as a few English words, also of numbers that are no status.
#[unsafe(no_mangle)]
pub extern "C" fn eecvs_status_name(status: i32) -> *const c_char {
    let known = NAMES.iter().find(|(known, _)| *known as i32 == status);
    known.map_or(c"unknown status", |(_, name)| name).as_ptr()
}

/// Returns `EECVS_ABI_VERSION` of the library, to be compared with that of the header.
#[unsafe(no_mangle)]
pub extern "C" fn eecvs_abi_version() -> u32 {
    crate::EECVS_ABI_VERSION
}
