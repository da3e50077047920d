//! State of an encoder, as a packet's body.

use serde::{Deserialize, Serialize};

use super::{TooLong, parse_body, write_body};
use crate::encoder::config::{ConfigError, HotError};

/// Why an encoder refuses a setup or hot pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// A side is not 1 to 2048, or the size is not that of the encoder's own sensor.
    Sensor,
    /// tau_low is above tau_high.
    Thresholds,
    /// The code of the transform is unknown.
    Transform,
    /// The quantiser's step is out of range.
    Step,
    /// The mode is unknown or not in this image, or its fidelity is out of range.
    Mode,
    /// The period, slope or axis of the readout is out of range.
    Readout,
    /// A flag is neither 0 nor 1.
    Flag,
    /// M is not 1 to 64.
    M,
    /// K is not 1 to 1024.
    Grid,
    /// There is no memory for so many coefficients.
    Numbers,
    /// There is no memory for the dense coder on this sensor, or the coder is not in this image.
    Dense,
    /// The volume has no bins.
    Bins,
    /// The budget is too small, or is for mode `transform`, which has none.
    Rate,
    /// There is no memory for the windows of this sensor, or a window has 0 us.
    Windows,
    /// A hot pixel is not on the sensor.
    HotOutside,
    /// There are more hot pixels than there is memory for.
    HotRoom,
    /// Hot pixels came before a setup.
    HotUnset,
    /// There is no memory for the order of events, or the mode is `transform`, which keeps none.
    Order,
    /// The firmware has no adaptive coder of coefficients.
    Coefficients,
    /// A largest mean error is for a hybrid mode without a fidelity.
    MeanError,
}

impl From<ConfigError> for Refusal {
    fn from(error: ConfigError) -> Self {
        match error {
            ConfigError::M => Self::M,
            ConfigError::Grid => Self::Grid,
            ConfigError::Scratch => Self::Numbers,
            ConfigError::Dense => Self::Dense,
            ConfigError::Bins => Self::Bins,
            ConfigError::Rate => Self::Rate,
            ConfigError::Order => Self::Order,
            ConfigError::MeanError => Self::MeanError,
            ConfigError::Coefficients => Self::Coefficients,
            // Not every image has it.
            ConfigError::Keys | ConfigError::Quick | ConfigError::Transform | ConfigError::Tree => {
                Self::Mode
            }
        }
    }
}

impl From<HotError> for Refusal {
    fn from(error: HotError) -> Self {
        match error {
            HotError::Outside => Self::HotOutside,
            HotError::NoRoom => Self::HotRoom,
        }
    }
}

/// What ended an encoder before it started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Cause {
    /// The stack left its place.
    StackOverflow,
    /// A fault of the processor.
    Fault,
    /// An interrupt that nothing expects.
    Unexpected,
    /// The program itself: a panic, or a clock that does not start.
    Stopped,
    /// The watchdog: half a second without progress.
    Watchdog,
}

/// How an encoder ended before it started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Restart {
    /// What ended it.
    pub cause: Cause,
    /// Address of the instruction that did not end; 0 if it is not known.
    pub pc: u32,
    /// Where that function was called from; 0 if it is not known.
    pub lr: u32,
}

/// State of an encoder, which it sends after a setup, hot pixels and a flush; written by postcard.
///
/// Counts run since the start of the encoder and wrap; times are in its own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// Kind of the packet that this answers: 1 setup, 3 flush, 5 hot pixels; 0 after a restart.
    pub answers: u8,
    /// Whether an encoder is set up; after a refused setup none is.
    pub running: bool,
    /// Why no encoder is set up, or why not all hot pixels are kept out.
    pub refusal: Option<Refusal>,
    /// Number of pixels that are kept out.
    pub hot_pixels: u32,
    /// Words that the dense coder has for what depends on the sensor, as counted by [`crate::coder::dense::words`];
    /// 0 if it is not set up.
    pub dense_words: u32,
    /// Events that a window holds before it closes early.
    pub window_events: u32,
    /// Largest frame in bytes.
    pub frame_bytes: u32,
    /// Number of events decoded from words.
    pub events: u32,
    /// Events lost on the link in damaged packets, known from the packets' positions.
    pub lost: u32,
    /// Events that arrived while no window was free or no encoder was set up.
    pub dropped: u32,
    /// Words that are neither events nor times, events without a time, and bytes left over.
    pub ignored: u32,
    /// Bytes that belonged to no packet.
    pub damaged_bytes: u32,
    /// Bytes that the UART lost because they were not read in time.
    pub overruns: u32,
    /// Number of windows encoded.
    pub windows: u32,
    /// Number of frames sent.
    pub frames: u32,
    /// Time spent on received bytes, in nanoseconds.
    pub receive_ns: u64,
    /// Time spent encoding, in nanoseconds, interrupts excluded.
    pub encode_ns: u64,
    /// Time spent sending frames, in nanoseconds, interrupts excluded.
    pub send_ns: u64,
    /// Most bytes of the stack that were in use at any time.
    pub stack_bytes: u32,
    /// Why the encoder started again; `None` if its power came or its reset was asked for.
    pub restart: Option<Restart>,
}

impl Status {
    /// Writes the status as a packet's body to the start of `out` and returns its length in bytes.
    ///
    /// # Errors
    /// [`TooLong`] if `out` is too short; [`super::FIELDS_BYTES_MAX`] bytes suffice.
    pub fn write(&self, out: &mut [u8]) -> Result<usize, TooLong> {
        write_body(self, out)
    }

    /// Reads a packet's body; `None` if it is not a status.
    #[must_use]
    pub fn parse(body: &[u8]) -> Option<Self> {
        parse_body(body)
    }
}

#[cfg(test)]
mod tests {
    use super::super::FIELDS_BYTES_MAX;
    use super::*;

    #[test]
    fn the_longest_status_returns() {
        let status = Status {
            answers: u8::MAX,
            running: true,
            refusal: Some(Refusal::HotUnset),
            hot_pixels: u32::MAX,
            dense_words: u32::MAX,
            window_events: u32::MAX,
            frame_bytes: u32::MAX,
            events: u32::MAX,
            lost: u32::MAX,
            dropped: u32::MAX,
            ignored: u32::MAX,
            damaged_bytes: u32::MAX,
            overruns: u32::MAX,
            windows: u32::MAX,
            frames: u32::MAX,
            receive_ns: u64::MAX,
            encode_ns: u64::MAX,
            send_ns: u64::MAX,
            stack_bytes: u32::MAX,
            restart: Some(Restart {
                cause: Cause::Watchdog,
                pc: u32::MAX,
                lr: u32::MAX,
            }),
        };
        let mut out = [0; FIELDS_BYTES_MAX];
        let len = status.write(&mut out).unwrap();
        assert_eq!(Status::parse(&out[..len]), Some(status));
        assert_eq!(Status::parse(&out[..=len]), None);
        assert_eq!(Status::parse(&out[..len - 1]), None);
    }
}
