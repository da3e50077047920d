//! Codes the events of a window as they come.

use crate::coder::quick::format::{Area, BLOCK, BLOCK_BYTES_MAX, Block, place};
use crate::coder::quick::{Simd, Window};
use event_types::Event;

/// Why events were not coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Error {
    /// An event of the block is not on the sensor or not in the window.
    Outside,
    /// The output is too small.
    NoRoom,
    /// An event was pushed onto a full block.
    Full,
}

/// An event as a window's slots hold it: its time since the window's start in microseconds, then
/// y << 16 | x << 1 | polarity.
pub type Placed = [u32; 2];

/// What of a window was coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Coded {
    /// Bytes of the payload.
    pub bytes: usize,
    /// Events in it, from the front.
    pub events: usize,
}

/// Codes a window's events in blocks, of which it holds one.
///
/// [`push`](Self::push) events; whenever it says that the block is full, and at the end,
/// [`flush_block`](Self::flush_block). After an error the payload is lost: begin with another encoder.
#[derive(Debug, Clone)]
pub struct Encoder {
    window: Window,
    area: Area,
    count: usize,
    block: Block,
}

impl Encoder {
    /// Returns an encoder of the window's events.
    #[must_use]
    pub const fn new(window: Window) -> Self {
        Self {
            window,
            area: Area::whole(window.sensor),
            count: 0,
            block: Block::new(),
        }
    }

    /// Takes an event into the block; returns whether the block is full now.
    ///
    /// # Errors
    /// [`Error::Full`] if it was full, [`Error::Outside`] if the event is not on the sensor or not in the window;
    /// the event is then not taken.
    #[inline]
    pub fn push(&mut self, event: Event) -> Result<bool, Error> {
        let Window {
            sensor, start_us, ..
        } = self.window;
        let offset_us = event.t_us.wrapping_sub(start_us);
        if !sensor.contains(event.x, event.y) || offset_us >= u64::from(self.window.duration_us) {
            return Err(Error::Outside);
        }
        let [_, times @ ..] = &mut self.block.times;
        let (Some(to), Some(place)) = (
            times.get_mut(self.count),
            self.block.places.get_mut(self.count),
        ) else {
            return Err(Error::Full);
        };
        *to = (offset_us as u32).wrapping_sub(self.block.first);
        *place = self::place(event.x, event.y, event.polarity);
        self.count += 1;
        Ok(self.count == BLOCK)
    }

    /// Codes the events of the block, none or more, at the front of `out` and empties it; returns the number of
    /// bytes. Only a window's last block may be flushed before it is full.
    ///
    /// # Errors
    /// [`Error::NoRoom`] if `out` is too small, never with [`BLOCK_BYTES_MAX`]; [`Error::Outside`] if an event is
    /// not on the sensor or not in the window.
    #[inline]
    pub fn flush_block(&mut self, simd: Simd, out: &mut [u8]) -> Result<usize, Error> {
        if self.count == 0 {
            return Ok(0);
        }
        with_room(out, |out| self.code(simd, out))
    }

    #[inline]
    fn code(&mut self, simd: Simd, out: &mut [u8; BLOCK_BYTES_MAX]) -> Result<usize, Error> {
        let Self {
            window,
            area,
            count,
            block,
        } = self;
        let last = block.times.get(*count).copied().unwrap_or_default();
        let bytes = simd.encode_block(block, *count, area, window, out);
        self.go_on(last, bytes)
    }

    /// Codes a block's events, 1 to [`BLOCK`], at the front of `out`. After an error the block and the area are
    /// unset.
    #[inline]
    fn code_placed(
        &mut self,
        simd: Simd,
        events: &[Placed],
        out: &mut [u8],
    ) -> Result<usize, Error> {
        with_room(out, |out| {
            if let (Ok(full), Some([last, _])) = (events.try_into(), events.last()) {
                let first = self.block.first;
                let bytes =
                    simd.encode_placed(full, &mut self.block, &mut self.area, &self.window, out);
                return self.go_on(last.wrapping_sub(first), bytes);
            }
            self.block.fill(events);
            self.count = events.len().min(BLOCK);
            self.code(simd, out)
        })
    }

    /// Empties the block, of which the last time was `last`.
    #[inline]
    fn go_on(&mut self, last: u32, bytes: Option<usize>) -> Result<usize, Error> {
        self.block.first = self.block.first.wrapping_add(last);
        self.count = 0;
        bytes.ok_or(Error::Outside)
    }
}

/// Has `f` write into `out`, or if that might be too small, into memory of its own.
#[inline]
fn with_room(
    out: &mut [u8],
    f: impl FnOnce(&mut [u8; BLOCK_BYTES_MAX]) -> Result<usize, Error>,
) -> Result<usize, Error> {
    if let Some(out) = out.first_chunk_mut() {
        return f(out);
    }
    let mut room = [0; BLOCK_BYTES_MAX];
    let bytes = f(&mut room)?;
    match (out.get_mut(..bytes), room.get(..bytes)) {
        (Some(to), Some(from)) => to.copy_from_slice(from),
        _ => return Err(Error::NoRoom),
    }
    Ok(bytes)
}

/// Codes all events of a window; returns the number of bytes.
///
/// # Errors
/// As [`Encoder::push`] and [`Encoder::flush_block`].
pub fn encode(
    simd: Simd,
    window: Window,
    events: &[Event],
    out: &mut [u8],
) -> Result<usize, Error> {
    let mut encoder = Encoder::new(window);
    let mut bytes = 0;
    for block in events.chunks(BLOCK) {
        for event in block {
            encoder.push(*event)?;
        }
        let out = out.get_mut(bytes..).ok_or(Error::NoRoom)?;
        bytes += encoder.flush_block(simd, out)?;
    }
    Ok(bytes)
}

/// Returns how many events fit into a block of this many bytes, whatever they are: they take at most 55 bits each, a
/// code of 23 and a time of 32, or else a word of 31 and less than 3 bits of the upper parts.
const fn fitting(bytes: usize) -> usize {
    // Header, area, least time, and the last byte of each of two packed parts.
    bytes.saturating_sub(14) * 8 / 55
}

/// Codes events of a window from the front, as far as there is room in `out`: at least one if that has 21 bytes.
///
/// # Errors
/// [`Error::Outside`] if an event is not on the sensor or not in the window.
pub fn encode_placed(
    simd: Simd,
    window: Window,
    events: &[Placed],
    out: &mut [u8],
) -> Result<Coded, Error> {
    let mut encoder = Encoder::new(window);
    let mut coded = Coded::default();
    for block in events.chunks(BLOCK) {
        let before = (encoder.area, encoder.block.first);
        let out = out.get_mut(coded.bytes..).unwrap_or_default();
        match encoder.code_placed(simd, block, out) {
            Ok(bytes) => {
                coded.bytes += bytes;
                coded.events += block.len();
            }
            Err(Error::NoRoom) => {
                // A block that is not full is a payload's last one.
                (encoder.area, encoder.block.first) = before;
                let part = block.get(..fitting(out.len())).unwrap_or_default();
                if !part.is_empty() {
                    coded.bytes += encoder.code_placed(simd, part, out)?;
                    coded.events += part.len();
                }
                break;
            }
            Err(error) => return Err(error),
        }
    }
    Ok(coded)
}
