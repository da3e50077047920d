//! The quick coder: codes events in their order of arrival, block by block, and sorts nothing.
//!
//! ```text
//! window's slots -> block of 128 -> bounds, widths -> words packed in lanes, times' upper parts in unary -> payload
//! ```
//!
//! `format` describes the bits. `portable` codes them on any core; `kernel` codes them in vectors of eight lanes
//! (`lanes`): AVX2, NEON, and plain arrays, which are their safe twin under test. All give the same bytes.

#[cfg(any(test, target_arch = "aarch64"))]
mod array;
#[cfg(target_arch = "x86_64")]
mod avx2;
mod decoder;
mod encoder;
mod format;
#[cfg(any(test, target_arch = "x86_64", target_arch = "aarch64"))]
mod kernel;
#[cfg(any(test, target_arch = "x86_64", target_arch = "aarch64"))]
mod lanes;
#[cfg(target_arch = "aarch64")]
mod neon;
mod portable;
#[cfg(test)]
mod tests;

pub use decoder::{Damaged, decode};
pub use encoder::{Coded, EVENT_BYTES_MAX, Outside, encode};
pub use format::Placed;
pub(crate) use format::{place, position};

use crate::coder::quick::format::{Area, BLOCK, Block, Output};
use crate::coder::quick::portable::{Body, Times};
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

    /// Takes a block's events in, 1 to [`BLOCK`], and codes them. Returns the number of bytes, or `None` if an event is
    /// not on the sensor or not in the window.
    #[inline]
    fn encode(
        self,
        events: &[Placed],
        block: &mut Block,
        area: &mut Area,
        window: &Window,
        out: &mut Output,
    ) -> Option<usize> {
        match self.0 {
            Kind::None => portable::encode_block(events, block, area, window, out),
            #[cfg(test)]
            Kind::Array => kernel::encode(array::Array, events, block, area, window, out),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(l) => l.encode(events, block, area, window, out),
            #[cfg(target_arch = "aarch64")]
            Kind::Neon(l) => kernel::encode(l, events, block, area, window, out),
        }
    }

    /// Reads a block of 1 to [`BLOCK`] events, which begins after an event at `first`. `None` as of
    /// [`portable::decode_block`].
    #[inline]
    fn decode(
        self,
        body: &Body<'_>,
        window: &Window,
        first: u32,
        events: &mut [Event],
    ) -> Option<()> {
        // Vectors are for times that ascend, and take longer for few events.
        let is_for_one = self.0 == Kind::None || events.len() < VECTORS_FROM;
        if is_for_one || matches!(body.times, Times::Back { .. }) {
            return portable::decode_block(body, window, first, events);
        }
        if let Ok(full) = events.as_mut().try_into() {
            return self.decode_into(body, window, first, BLOCK, full);
        }
        let mut block = [Event::UNSET; BLOCK];
        self.decode_into(body, window, first, events.len(), &mut block)?;
        events.copy_from_slice(block.get(..events.len())?);
        Some(())
    }

    /// Reads `count` events into the front of `events`; what follows there means nothing.
    #[inline]
    fn decode_into(
        self,
        body: &Body<'_>,
        window: &Window,
        first: u32,
        count: usize,
        events: &mut [Event; BLOCK],
    ) -> Option<()> {
        match self.0 {
            Kind::None => portable::decode_block(body, window, first, events.get_mut(..count)?),
            #[cfg(test)]
            Kind::Array => kernel::decode(array::Array, body, window, first, count, events),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(l) => l.decode(body, window, first, count, events),
            #[cfg(target_arch = "aarch64")]
            Kind::Neon(l) => kernel::decode(l, body, window, first, count, events),
        }
    }
}

/// Fewest events of a block that is read by vectors.
const VECTORS_FROM: usize = 24;
