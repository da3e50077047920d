//! Reads the events of a window.

use crate::coder::quick::format::{Area, BLOCK, Header, Shape, packed_bytes};
use crate::coder::quick::portable::{self, Body, Times};
use crate::coder::quick::{Simd, Window};
use event_types::{Event, Polarity};

/// Takes the place of an event before it is read.
const UNREAD: Event = Event {
    t_us: 0,
    x: 0,
    y: 0,
    polarity: Polarity::Off,
};

/// The payload is damaged: no encoder writes it for this window and number of events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Damaged;

/// Reads a window's events block by block. Never panics, whatever the payload.
#[derive(Debug, Clone)]
pub struct Decoder<'p> {
    window: Window,
    payload: &'p [u8],
    /// Number of events not read yet.
    left: usize,
    area: Area,
    /// Time of the last event read.
    last: u32,
}

impl<'p> Decoder<'p> {
    /// Returns a decoder of a payload with `count` events.
    #[must_use]
    pub const fn new(window: Window, payload: &'p [u8], count: usize) -> Self {
        Self {
            window,
            payload,
            left: count,
            area: Area::whole(window.sensor),
            last: 0,
        }
    }

    /// Returns the number of events that are left to read.
    #[inline]
    #[must_use]
    pub const fn left(&self) -> usize {
        self.left
    }

    /// Returns the part of the payload that was not read yet.
    #[inline]
    #[must_use]
    pub const fn rest(&self) -> &'p [u8] {
        self.payload
    }

    /// Reads a block's events into the front of `events`; returns their number, 0 at the end. Reads nothing if
    /// `events` has no room for a block or for those left.
    ///
    /// # Errors
    /// [`Damaged`] if no encoder writes such a payload. What `events` then holds means nothing.
    #[inline]
    pub fn next_block(&mut self, simd: Simd, events: &mut [Event]) -> Result<usize, Damaged> {
        let count = self.left.min(BLOCK);
        let Some(events) = events.get_mut(..count) else {
            return Ok(0);
        };
        if count == 0 {
            return Ok(0);
        }
        self.read(simd, events).ok_or(Damaged)?;
        self.left -= count;
        Ok(count)
    }

    #[inline]
    fn take(&mut self, bytes: usize) -> Option<&'p [u8]> {
        let (taken, rest) = self.payload.split_at_checked(bytes)?;
        self.payload = rest;
        Some(taken)
    }

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
        let last = &mut self.last;
        let count = events.len();
        let is_for_one = simd.is_none() || count < VECTORS_FROM;
        if is_for_one || matches!(times, Times::Back { .. }) {
            return portable::decode_block(&body, &self.window, last, events);
        }
        if let Ok(events) = events.try_into() {
            return simd.decode_block(&body, &self.window, last, count, events);
        }
        let mut block = [UNREAD; BLOCK];
        simd.decode_block(&body, &self.window, last, count, &mut block)?;
        events.copy_from_slice(block.get(..count)?);
        Some(())
    }
}

/// Vectors take longer for fewer events than these.
const VECTORS_FROM: usize = 24;

/// Reads all events of a window, as many as `events` has room for, from a payload with no others.
///
/// # Errors
/// [`Damaged`] if no encoder writes such a payload. What `events` then holds means nothing.
pub fn decode(
    simd: Simd,
    window: Window,
    payload: &[u8],
    mut events: &mut [Event],
) -> Result<(), Damaged> {
    let mut decoder = Decoder::new(window, payload, events.len());
    while decoder.left() > 0 {
        let count = decoder.next_block(simd, events)?;
        events = events.get_mut(count..).ok_or(Damaged)?;
    }
    if decoder.rest().is_empty() {
        Ok(())
    } else {
        Err(Damaged)
    }
}
