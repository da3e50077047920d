//! What an encoder says of itself.

use serde::{Deserialize, Serialize};

use super::{TooLong, parse_body, write_body};
use crate::encoder::config::{ConfigError, HotError};

/// Why an encoder refuses a setup, or hot pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// A side that is not 1 to 2048, or another size than that of the encoder's own sensor.
    Sensor,
    /// tau_low above tau_high.
    Thresholds,
    /// No such transform.
    Transform,
    /// The quantiser's step.
    Step,
    /// No such mode, or a fidelity that it has not.
    Mode,
    /// A period, slope or axis that no readout has.
    Readout,
    /// Neither 0 nor 1 where these are all there is.
    Flag,
    /// M is not 1 to 64.
    M,
    /// K is not 1 to 1024.
    Grid,
    /// No memory for so many coefficients.
    Numbers,
    /// No memory for the dense coder on this sensor.
    Dense,
    /// A volume of no bins.
    Bins,
    /// A budget that is too small, or for coefficients.
    Rate,
    /// No memory for the windows of this sensor, or windows of 0 us.
    Windows,
    /// A hot pixel that is not on the sensor.
    HotOutside,
    /// More hot pixels than there is memory for.
    HotRoom,
    /// Hot pixels before a setup.
    HotUnset,
    /// No memory for the order of events, or coefficients, which have none.
    Order,
    /// The image has no adaptive coder of coefficients.
    Coefficients,
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
            ConfigError::Coefficients => Self::Coefficients,
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

/// What an encoder says of itself, after a setup, hot pixels and a flush; postcard writes it.
///
/// Counts run since the start of the encoder and wrap; times are of its own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// Kind of the packet that this answers: 1 setup, 3 flush, 5 hot pixels; 0 after a restart.
    pub answers: u8,
    /// Whether an encoder is set up; a refused setup leaves none.
    pub running: bool,
    /// Why not, or why not all hot pixels are kept out.
    pub refusal: Option<Refusal>,
    /// Pixels that are kept out.
    pub hot_pixels: u32,
    /// Words that the dense coder has for what is not the same for every sensor, as `words` of
    /// `coder/dense.rs` counts them; 0 where it is not set up.
    pub dense_words: u32,
    /// Events that a window holds before it closes early.
    pub window_events: u32,
    /// Largest frame in bytes.
    pub frame_bytes: u32,
    /// Events decoded from words.
    pub events: u32,
    /// Events that were lost on the link: in damaged packets, by the packets' positions.
    pub lost: u32,
    /// Events that came while no window was free, or while no encoder was set up.
    pub dropped: u32,
    /// Words that were no events and no times, events without a time, bytes left over.
    pub ignored: u32,
    /// Bytes that belonged to no packet.
    pub damaged_bytes: u32,
    /// Bytes that the UART lost because they were not read in time.
    pub overruns: u32,
    /// Windows encoded.
    pub windows: u32,
    /// Frames sent.
    pub frames: u32,
    /// Time spent on received bytes, in nanoseconds.
    pub receive_ns: u64,
    /// Time spent encoding, in nanoseconds, interrupts excluded.
    pub encode_ns: u64,
    /// Time spent sending frames, in nanoseconds, interrupts excluded.
    pub send_ns: u64,
    /// Bytes of the stack that were ever used.
    pub stack_bytes: u32,
}

impl Status {
    /// Writes it as a packet's body to the start of `out` and returns its length.
    ///
    /// # Errors
    /// [`TooLong`]: `out` is too short; [`super::FIELDS_BYTES_MAX`] are enough.
    pub fn write(&self, out: &mut [u8]) -> Result<usize, TooLong> {
        write_body(self, out)
    }

    /// Reads a packet's body; `None` where it is none.
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
        };
        let mut out = [0; FIELDS_BYTES_MAX];
        let len = status.write(&mut out).unwrap();
        assert_eq!(Status::parse(&out[..len]), Some(status));
        assert_eq!(Status::parse(&out[..=len]), None);
        assert_eq!(Status::parse(&out[..len - 1]), None);
    }
}
