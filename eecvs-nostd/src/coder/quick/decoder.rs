//! Reads the events of a window.

use crate::coder::quick::format::{Area, BLOCK, Header, Shape, packed_bytes};
use crate::coder::quick::portable::{Body, Times};
use crate::coder::quick::{Simd, Window};
use event_types::Event;

/// The payload does not hold as many events, in their areas and in the window, or holds more than these.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Damaged;

/// What is left of a payload, and what a block depends on.
struct Decoder<'p> {
    window: Window,
    payload: &'p [u8],
    area: Area,
    /// Time of the last event read.
    first: u32,
}

impl<'p> Decoder<'p> {
    #[inline]
    fn take(&mut self, bytes: usize) -> Option<&'p [u8]> {
        let (taken, rest) = self.payload.split_at_checked(bytes)?;
        self.payload = rest;
        Some(taken)
    }

    /// Reads a block of as many events, 1 to [`BLOCK`]; `None` if it is damaged.
    #[inline]
    fn read(&mut self, simd: Simd, events: &mut [Event]) -> Option<()> {
        let header = u16::from_le_bytes(*self.take(2)?.first_chunk()?);
        let header = Header::from_bits(header.into())?;
        if header.has_area {
            let mut bits = [0; 8];
            let (low, _) = bits.split_at_mut(6);
            low.copy_from_slice(self.take(6)?);
            self.area = Area::from_bits(u64::from_le_bytes(bits), self.window.sensor)?;
        }
        let least = if header.steps_back {
            u32::from_le_bytes(*self.take(4)?.first_chunk()?)
        } else {
            0
        };
        let width = header.width;
        let words = self.take(packed_bytes(events.len(), width))?;
        let times = if header.steps_back {
            Times::Back {
                least,
                width: header.length,
                packed: self.take(packed_bytes(events.len(), header.length))?,
            }
        } else {
            Times::Up {
                quantum: Shape::new(width, 2 * self.area.pixels())?.quantum,
                upper: self.take(header.length as usize)?,
            }
        };
        let body = Body {
            area: self.area,
            words,
            width,
            times,
        };
        simd.decode(&body, &self.window, self.first, events)?;
        self.first = events.last()?.t_us.wrapping_sub(self.window.start_us) as u32;
        Some(())
    }
}

/// Reads all events of a window, as many as `events` has room for, from a payload with no others. Never panics,
/// whatever the payload.
///
/// # Errors
/// [`Damaged`]. What `events` then holds means nothing.
pub fn decode(
    simd: Simd,
    window: Window,
    payload: &[u8],
    events: &mut [Event],
) -> Result<(), Damaged> {
    let mut decoder = Decoder {
        window,
        payload,
        area: Area::whole(window.sensor),
        first: 0,
    };
    for block in events.chunks_mut(BLOCK) {
        decoder.read(simd, block).ok_or(Damaged)?;
    }
    if decoder.payload.is_empty() {
        Ok(())
    } else {
        Err(Damaged)
    }
}
