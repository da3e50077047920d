//! The quick coder: codes events in their order of arrival, block by block, and sorts nothing.
//!
//! ```text
//! window's slots -> block of 128 -> bounds, widths -> words packed in lanes, times' upper parts in unary -> payload
//! ```
//!
//! `format` describes the bits. `portable` codes them on any core; `kernel` codes them in vectors of eight lanes
//! (`lanes`): AVX2, NEON, and plain arrays as their safe twin under test. All give the same bytes.

#[cfg(any(test, target_arch = "aarch64"))]
mod array;
#[cfg(target_arch = "x86_64")]
mod avx2;
mod decoder;
mod encoder;
mod format;
mod halves;
#[cfg(any(test, target_arch = "x86_64", target_arch = "aarch64"))]
mod kernel;
#[cfg(any(test, target_arch = "x86_64", target_arch = "aarch64"))]
mod lanes;
#[cfg(target_arch = "aarch64")]
mod neon;
mod portable;
#[cfg(test)]
mod tests;

pub use decoder::{Damaged, Decoder, decode};
pub use encoder::{Coded, Encoder, Error, Placed, encode, encode_placed};
pub use format::{BLOCK, BLOCK_BYTES_MAX};
pub(crate) use format::{place, position};

use crate::coder::quick::format::{Area, Block};
use crate::coder::quick::portable::Body;
use event_types::{Event, Sensor};

/// Where and when a frame's events can be: the sensor, and the window `start_us..start_us + duration_us`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Window {
    sensor: Sensor,
    start_us: u64,
    duration_us: u32,
}

impl Window {
    /// Returns a window of a sensor, whose sides count as 1 or [`Sensor::SIDE_MAX`] where they are below or above.
    #[must_use]
    pub const fn new(sensor: Sensor, start_us: u64, duration_us: u32) -> Self {
        const fn side(side: u16) -> u16 {
            match side {
                0 => 1,
                1..Sensor::SIDE_MAX => side,
                _ => Sensor::SIDE_MAX,
            }
        }
        Self {
            sensor: Sensor {
                width: side(sensor.width),
                height: side(sensor.height),
            },
            start_us,
            duration_us,
        }
    }
}

/// The vectors that blocks are coded with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Simd(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// One event at a time.
    None,
    /// Plain arrays of eight lanes.
    #[cfg(test)]
    Array,
    #[cfg(target_arch = "x86_64")]
    Avx2(avx2::Avx2),
    #[cfg(target_arch = "aarch64")]
    Neon(neon::Neon),
}

/// A block's coded bytes.
type Output = [u8; BLOCK_BYTES_MAX];

impl Simd {
    /// No vectors: one event at a time.
    pub const NONE: Self = Self(Kind::None);

    /// Returns the vectors of this core.
    #[inline]
    #[must_use]
    pub fn detected() -> Self {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = avx2::Avx2::detected() {
            return Self(Kind::Avx2(avx2));
        }
        #[cfg(target_arch = "aarch64")]
        return Self(Kind::Neon(neon::Neon::new()));
        #[cfg(not(target_arch = "aarch64"))]
        Self::NONE
    }

    /// Returns whether there are none.
    #[inline]
    fn is_none(self) -> bool {
        self == Self::NONE
    }

    /// Codes the first `count` events of the block. Returns the number of bytes, or `None` if an event is not on the
    /// sensor or not in the window.
    #[inline]
    fn encode_block(
        self,
        block: &mut Block,
        count: usize,
        area: &mut Area,
        window: &Window,
        out: &mut Output,
    ) -> Option<usize> {
        match self.0 {
            Kind::None => portable::encode_block(block, count, area, window, out),
            #[cfg(test)]
            Kind::Array => kernel::encode_any(array::Array, block, count, area, window, out),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(l) => l.encode_block(block, count, area, window, out),
            #[cfg(target_arch = "aarch64")]
            Kind::Neon(l) => kernel::encode_any(l, block, count, area, window, out),
        }
    }

    /// Takes a full block's events and codes them, as [`Self::encode_block`].
    #[inline]
    fn encode_placed(
        self,
        events: &[Placed; BLOCK],
        block: &mut Block,
        area: &mut Area,
        window: &Window,
        out: &mut Output,
    ) -> Option<usize> {
        match self.0 {
            Kind::None => {
                block.fill(events);
                portable::encode_block(block, BLOCK, area, window, out)
            }
            #[cfg(test)]
            Kind::Array => kernel::encode_placed(array::Array, events, block, area, window, out),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(l) => l.encode_placed(events, block, area, window, out),
            #[cfg(target_arch = "aarch64")]
            Kind::Neon(l) => kernel::encode_placed(l, events, block, area, window, out),
        }
    }

    /// Reads a block of `count` events whose times ascend into the front of `events`; what follows there means
    /// nothing. `last` is the offset of the event before and becomes that of the last.
    #[inline]
    fn decode_block(
        self,
        body: &Body<'_>,
        window: &Window,
        last: &mut u32,
        count: usize,
        events: &mut [Event; BLOCK],
    ) -> Option<()> {
        match self.0 {
            Kind::None => portable::decode_block(body, window, last, events.get_mut(..count)?),
            #[cfg(test)]
            Kind::Array => kernel::decode_any(array::Array, body, window, last, count, events),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(l) => l.decode_block(body, window, last, count, events),
            #[cfg(target_arch = "aarch64")]
            Kind::Neon(l) => kernel::decode_any(l, body, window, last, count, events),
        }
    }
}
