//! The keys coder: sorts a window's events by place and time and codes the differences of their keys.
//!
//! ```text
//! window's slots -> slice of up to 16,384 -> sorted by place, then time -> differences of keys
//!     -> their bit lengths in prefix codes, the bits below the highest as they are -> payload
//! ```
//!
//! `docs/wire-format.md` describes the bits. `sort`, `encoder` and `decoder` are one algorithm, over the loops of
//! `kernels`: in AVX2, in NEON, and in plain Rust (`portable`), which is their safe twin under test. All give the same
//! bytes and the same events, which are decoded into order of time. Tables are for a host: images leave the encoder
//! out, and have [`crate::coder::fast`].

#[cfg(target_arch = "x86_64")]
mod avx2;
mod bits;
mod code;
mod decoder;
mod encoder;
mod head;
mod kernels;
#[cfg(target_arch = "aarch64")]
mod neon;
mod portable;
mod preset;
mod sort;
#[cfg(test)]
mod tests;

pub use decoder::{Damaged, DecoderMemory, decode};
pub use encoder::{Coded, EVENT_BYTES_MAX, EncoderMemory, NotEncoded, encode};
pub(crate) use sort::sort_by_time;

use crate::coder::cells::{Cells, Fidelity};
use crate::coder::keys::portable::Portable;
use event_types::{Event, Sensor};

pub use crate::coder::quick::Placed;

/// Most events of a slice.
pub const SLICE_EVENTS: usize = 1 << 14;

/// Where and when a frame's events can be: the sensor, the window `start_us..start_us + duration_us`, and the cells of
/// its times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Window {
    sensor: Sensor,
    start_us: u64,
    duration_us: u32,
    cells: Cells,
}

impl Window {
    /// Returns a window of a sensor, whose sides count as 1 or [`Sensor::SIDE_MAX`] where they are below or above, as a
    /// duration of 0 counts as 1.
    #[must_use]
    pub const fn new(sensor: Sensor, start_us: u64, duration_us: u32, fidelity: Fidelity) -> Self {
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
            duration_us: if duration_us == 0 { 1 } else { duration_us },
            cells: Cells::new(fidelity, duration_us),
        }
    }

    /// Returns the number of places, at most 2^22.
    const fn places(&self) -> u32 {
        self.sensor.pixels()
    }
}

/// Returns the number of slices of a frame of `events` events.
const fn slices(events: usize) -> usize {
    events.div_ceil(SLICE_EVENTS)
}

/// Returns the first event of a slice.
const fn slice_start(events: usize, slice: usize) -> usize {
    match (events as u64 * slice as u64).checked_div(slices(events) as u64) {
        Some(start) => start as usize,
        None => 0,
    }
}

/// The vectors that events are coded with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Simd(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Plain Rust.
    None,
    #[cfg(target_arch = "x86_64")]
    Avx2(avx2::Avx2),
    #[cfg(target_arch = "aarch64")]
    Neon(neon::Neon),
}

impl Simd {
    /// No vectors.
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

    /// As [`encoder::encode_with`], with the kernels of these vectors.
    fn encode(
        self,
        window: &Window,
        events: &[Placed],
        memory: &mut EncoderMemory,
        out: &mut [u8],
    ) -> Result<usize, encoder::Stop> {
        match self.0 {
            Kind::None => encoder::encode_with(Portable, window, events, memory, out),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(kernels) => kernels.encode(window, events, memory, out),
            #[cfg(target_arch = "aarch64")]
            Kind::Neon(kernels) => encoder::encode_with(kernels, window, events, memory, out),
        }
    }

    /// As [`decoder::decode_with`], with the kernels of these vectors.
    fn decode(
        self,
        window: &Window,
        payload: &[u8],
        memory: &mut DecoderMemory,
        events: &mut [Event],
    ) -> Option<()> {
        match self.0 {
            Kind::None => decoder::decode_with(Portable, window, payload, memory, events),
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(kernels) => kernels.decode(window, payload, memory, events),
            #[cfg(target_arch = "aarch64")]
            Kind::Neon(kernels) => decoder::decode_with(kernels, window, payload, memory, events),
        }
    }
}
