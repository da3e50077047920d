//! The bits of a frame's payload.
//!
//! A payload is a sequence of blocks, each of [`BLOCK`] events except the last, which has the rest; the frame's
//! header holds the number of events. Numbers are little-endian. Times are offsets from the window's start.
//!
//! | field | size | |
//! |---|---|---|
//! | header | 2 bytes | bits 0..5 width w of a word; 5 area follows; 6 times step back; 7..16 length |
//! | area | 6 bytes, if bit 5 | x0 (11 bits), columns - 1 (11), y0 (11), rows - 1 (11), zero (4) |
//! | least time | 4 bytes, if bit 6 | |
//! | words | see below | |
//! | upper parts of times | `length` bytes, if not bit 6 | |
//! | times - least time | as words, of width `length`, if bit 6 | |
//!
//! A block without an area has the area of the block before; before the first it is the whole sensor.
//!
//! With `code = ((y - y0) * columns + x - x0) * 2 + polarity` and `codes = 2 * columns * rows`, the quantum of times
//! is `q = floor(2^w / codes)`, at least 1, and `d = t - (time of the event before the block, at first 0)`:
//!
//! - word `i` is `code * q + d mod q`;
//! - `floor(d / q)` is coded by Elias and Fano: bit `floor(d / q) + i` is set, and no others. Bits count from each
//!   byte's lowest; the last byte has one set. `floor(d / q)` is at most 255.
//!
//! Where times step back, or a word would need more than 31 bits, word `i` is `code` and times are at full width.
//!
//! Words of a full block stand in eight lanes: lane l has the words l, l + 8, l + 16, ... one after another from the
//! lowest bit up, 16 w bits. Its 32-bit unit k is at byte `32 k + 4 l`; if w is odd, its last 16 bits are at byte
//! `32 floor(w / 2) + 2 l`. Words of a shorter block stand one after another, from each byte's lowest bit, and the
//! last byte is filled with zeros.

use crate::machine::IS_64_BIT;
use event_types::{Polarity, Sensor};

/// Number of events of a block.
pub const BLOCK: usize = 128;
/// Number of lanes of a block's words.
pub const LANES: usize = 8;
/// Largest width of a word.
pub const WIDTH_MAX: u32 = 31;
/// Largest width of a time where times step back.
pub const TIME_WIDTH_MAX: u32 = 32;
/// Largest upper part of a time.
pub const UPPER_MAX: u32 = 255;
/// Most bytes of the upper parts of times.
pub const UPPER_BYTES_MAX: usize = 3 * BLOCK / 8;
/// Most bytes of header, area and least time.
const HEAD_BYTES_MAX: usize = 12;
/// Most bits of a code.
const CODE_BITS_MAX: usize = 23;

const fn max(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

/// Most bytes of a block, and the room that an encoder is best given.
pub const BLOCK_BYTES_MAX: usize = HEAD_BYTES_MAX
    + max(
        BLOCK / 8 * WIDTH_MAX as usize + UPPER_BYTES_MAX,
        BLOCK / 8 * (CODE_BITS_MAX + TIME_WIDTH_MAX as usize),
    );

/// Returns the number of bytes of `count` words of `width` bits.
#[inline]
#[must_use]
pub const fn packed_bytes(count: usize, width: u32) -> usize {
    (count * width as usize).div_ceil(8)
}

/// Returns the number of bits of `value`, 0 for 0.
#[inline]
#[must_use]
pub const fn bit_length(value: u32) -> u32 {
    u32::BITS - value.leading_zeros()
}

/// A block's first field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// Width of a word, 1 to [`WIDTH_MAX`].
    pub width: u32,
    /// Whether an area follows.
    pub has_area: bool,
    /// Whether times step back.
    pub steps_back: bool,
    /// Bytes of the times' upper parts, or if times step back, their width.
    pub length: u32,
}

impl Header {
    const AREA: u32 = 1 << 5;
    const STEPS_BACK: u32 = 1 << 6;

    /// Returns the header's 16 bits.
    #[inline]
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.width
            | if self.has_area { Self::AREA } else { 0 }
            | if self.steps_back { Self::STEPS_BACK } else { 0 }
            | self.length << 7
    }

    /// Reads a header; `None` if no encoder writes these bits.
    #[inline]
    #[must_use]
    pub const fn from_bits(bits: u32) -> Option<Self> {
        let header = Self {
            width: bits & 31,
            has_area: bits & Self::AREA != 0,
            steps_back: bits & Self::STEPS_BACK != 0,
            length: bits >> 7,
        };
        let most = if header.steps_back {
            TIME_WIDTH_MAX
        } else {
            UPPER_BYTES_MAX as u32
        };
        if header.width == 0 || header.length > most {
            None
        } else {
            Some(header)
        }
    }
}

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Area {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Number of columns, at least 1.
    pub columns: u32,
    /// Number of rows, at least 1.
    pub rows: u32,
}

impl Area {
    /// Returns the area of the whole sensor.
    #[inline]
    #[must_use]
    pub const fn whole(sensor: Sensor) -> Self {
        Self {
            x: 0,
            y: 0,
            columns: sensor.width as u32,
            rows: sensor.height as u32,
        }
    }

    /// Returns the number of pixels, at most 2^22.
    #[inline]
    #[must_use]
    pub const fn pixels(self) -> u32 {
        self.columns * self.rows
    }

    /// Returns the least area that holds both.
    #[inline]
    #[must_use]
    fn joined(self, other: Self) -> Self {
        let (x, y) = (self.x.min(other.x), self.y.min(other.y));
        Self {
            x,
            y,
            columns: (self.x + self.columns).max(other.x + other.columns) - x,
            rows: (self.y + self.rows).max(other.y + other.rows) - y,
        }
    }

    /// Returns the area to code `count` events with, which lie in this one, after a block with area `before`: one
    /// that is kept costs no bits, one that is larger costs up to its logarithm per event.
    #[inline]
    #[must_use]
    pub fn to_code(self, before: Self, count: usize) -> Self {
        let joined = self.joined(before);
        if 3 * joined.pixels() <= 4 * self.pixels() {
            return joined;
        }
        if count < AREA_BITS && joined == before {
            let times = joined.pixels().checked_div(self.pixels());
            let more = bit_length(times.unwrap_or(0)) as usize;
            if more * count <= AREA_BITS {
                return joined;
            }
        }
        self
    }

    /// Returns the area's 48 bits.
    #[inline]
    #[must_use]
    pub const fn bits(self) -> u64 {
        self.x as u64
            | (self.columns as u64 - 1) << 11
            | (self.y as u64) << 22
            | (self.rows as u64 - 1) << 33
    }

    /// Reads an area; `None` if it is not on the sensor.
    #[inline]
    #[must_use]
    pub const fn from_bits(bits: u64, sensor: Sensor) -> Option<Self> {
        let area = Self {
            x: bits as u32 & 0x7FF,
            columns: (bits >> 11) as u32 & 0x7FF,
            y: (bits >> 22) as u32 & 0x7FF,
            rows: (bits >> 33) as u32 & 0x7FF,
        };
        if bits >> 44 != 0
            || area.x + area.columns >= sensor.width as u32
            || area.y + area.rows >= sensor.height as u32
        {
            return None;
        }
        Some(Self {
            columns: area.columns + 1,
            rows: area.rows + 1,
            ..area
        })
    }
}

/// Number of bits of an area in a block.
const AREA_BITS: usize = 48;

/// A divisor, as what to multiply by.
///
/// With `s = ceil(log2 divisor)` and `m = ceil(2^(31 + s) / divisor)`, which has 32 bits, `floor(v m / 2^(31 + s))`
/// is the quotient for all `v < 2^31`: m is too large by less than 1, and `v < 2^31 <= 2^(31 + s) / divisor`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Divisor {
    /// The divisor itself, 1 to 2^31.
    pub value: u32,
    /// m.
    pub multiplier: u32,
    /// s.
    pub shift: u32,
}

impl Divisor {
    /// Prepares a division by `value`, 1 to 2^31.
    #[inline]
    #[must_use]
    pub const fn new(value: u32) -> Self {
        let shift = bit_length(value.wrapping_sub(1));
        // 2^(31 + s) / value is 2^63 / top. At most 2^32 - 1: top is above 2^31, but for powers of two.
        let multiplier = if value.is_power_of_two() || value == 0 {
            1 << 31
        } else {
            let top = value << (32 - shift);
            1 + if IS_64_BIT {
                (((1 << 63) - 1) / top as u64) as u32
            } else {
                quotient_by_halves(top)
            }
        };
        Self {
            value,
            multiplier,
            shift,
        }
    }

    /// Returns floor(v / value), for v < 2^31.
    #[inline]
    #[must_use]
    pub const fn quotient(self, v: u32) -> u32 {
        (((v << 1) as u64 * self.multiplier as u64) >> 32) as u32 >> self.shift
    }
}

/// Returns the upper part of the last of `count` times; `None` if the last byte is empty or this is no upper part.
#[inline]
#[must_use]
pub fn last_upper(upper: &[u8], count: usize) -> Option<u32> {
    let last = bit_length((*upper.last()?).into());
    let bits = 8 * (upper.len() as u32 - 1) + last;
    let highest = bits.checked_sub(count as u32)?;
    (last > 0 && highest <= UPPER_MAX).then_some(highest)
}

/// Returns floor((2^63 - 1) / divisor) for a divisor above 2^31, by two divisions of 32 bits: for cores on which one
/// of 64 bits takes a loop.
#[inline]
const fn quotient_by_halves(divisor: u32) -> u32 {
    // The highest bit is set: so said, a compiler knows that nothing is divided by 0.
    let (high, low) = (divisor >> 16 | 1 << 15, divisor & 0xFFFF);
    let mut rest = u32::MAX >> 1;
    let mut quotient = 0;
    let mut step = 0;
    while step < 2 {
        // At most 2 too large.
        let mut q = rest / high;
        let mut over = rest - q * high;
        while q >> 16 != 0 || q * low > (over << 16 | 0xFFFF) {
            q -= 1;
            over += high;
            if over >> 16 != 0 {
                break;
            }
        }
        rest = (rest << 16 | 0xFFFF).wrapping_sub(q.wrapping_mul(divisor));
        quotient = quotient << 16 | q;
        step += 1;
    }
    quotient
}

/// How a block's words are made of codes and times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Width of a word.
    pub width: u32,
    /// Quantum of times.
    pub quantum: Divisor,
}

impl Shape {
    /// Returns the quantum at `width` bits, 1 to 31, for `codes` codes; `None` if not even a code fits.
    #[inline]
    #[must_use]
    pub const fn new(width: u32, codes: u32) -> Option<Self> {
        match (1_u32 << (width & 31)).checked_div(codes) {
            None | Some(0) => None,
            Some(quantum) => Some(Self {
                width,
                quantum: Divisor::new(quantum),
            }),
        }
    }

    /// Returns the shape for `count` events, the last of them `span` after the event before the block: the least
    /// width at which the upper parts take less than 2 zeros an event, which is also where the bits are fewest, as
    /// one bit more of width halves the zeros. `None` if that is more than [`WIDTH_MAX`] bits.
    #[inline]
    #[must_use]
    pub const fn choose(codes: u32, count: usize, span: u32) -> Option<Self> {
        if span >= 1 << 31 {
            return None;
        }
        // floor(span / q) < 2 count holds from this quantum on.
        let Some(least) = span.checked_div(2 * count as u32) else {
            return None;
        };
        let least = least + 1;
        let values = codes as u64 * least as u64 - 1;
        let width = u64::BITS - values.leading_zeros();
        if width > WIDTH_MAX {
            return None;
        }
        Self::new(width, codes)
    }
}

/// An event as a window's slots hold it: its time since the window's start in microseconds, then its place.
pub type Placed = [u32; 2];

/// A block's coded bytes.
pub type Output = [u8; BLOCK_BYTES_MAX];

/// The events of a block as an encoder holds them.
#[derive(Debug, Clone)]
pub struct Block {
    /// Time of the event before the block, 0 in a window's first.
    pub first: u32,
    /// 0, then the time of each event since `first`.
    pub times: [u32; BLOCK + 1],
    /// Place and polarity of each event: y << 16 | x << 1 | polarity.
    pub places: [u32; BLOCK],
}

impl Block {
    /// Returns a block that comes first in its window.
    #[inline]
    #[must_use]
    pub const fn new() -> Self {
        Self {
            first: 0,
            times: [0; BLOCK + 1],
            places: [0; BLOCK],
        }
    }

    /// Takes events in, at most [`BLOCK`]: times since the window's start, and places.
    #[inline]
    pub fn fill(&mut self, events: &[Placed]) {
        let Self {
            first,
            times: [_, times @ ..],
            places,
        } = self;
        for ((to, to_place), [offset_us, place]) in times.iter_mut().zip(places).zip(events) {
            *to = offset_us.wrapping_sub(*first);
            *to_place = *place;
        }
    }
}

/// Returns `last`, the time of a block's last event since `first`, that of the event before the block, if no time steps
/// back: `steps_back` says whether one does within the block.
#[inline]
#[must_use]
pub const fn span(first: u32, last: u32, steps_back: bool) -> Option<u32> {
    // A time before `first` has wrapped, and would wrap again.
    if steps_back || first.checked_add(last).is_none() {
        None
    } else {
        Some(last)
    }
}

/// Returns the place and polarity of an event: y << 16 | x << 1 | polarity.
#[inline]
#[must_use]
pub const fn place(x: u16, y: u16, polarity: Polarity) -> u32 {
    (y as u32) << 16 | (x as u32) << 1 | polarity as u32
}

/// Returns column and row of an event's [`place`].
#[inline]
#[must_use]
pub const fn position(place: u32) -> (u16, u16) {
    ((place >> 1) as u16 & 0x7FFF, (place >> 16) as u16)
}

/// How to code a block.
#[derive(Debug, Clone, Copy)]
pub struct Plan {
    /// Area of the places.
    pub area: Area,
    /// Whether the area is coded.
    pub has_area: bool,
    /// Width and quantum; `None` if times step back or take too many bits.
    pub shape: Option<Shape>,
}

impl Plan {
    /// Plans a block of `count` events: `least` and `most` hold the bounds of both halves of its places, `before` is
    /// the area of the block before, `span` what the last time is after the time before the block, if no time steps
    /// back. `None` if an event is not on the sensor.
    #[inline]
    #[must_use]
    pub fn new(
        (least, most): (u32, u32),
        count: usize,
        span: Option<u32>,
        before: Area,
        sensor: Sensor,
    ) -> Option<Self> {
        let (x, y) = ((least & 0xFFFF) >> 1, least >> 16);
        let (x_most, y_most) = ((most & 0xFFFF) >> 1, most >> 16);
        if x_most >= u32::from(sensor.width) || y_most >= u32::from(sensor.height) {
            return None;
        }
        let area = Area {
            x,
            y,
            columns: x_most - x + 1,
            rows: y_most - y + 1,
        }
        .to_code(before, count);
        Some(Self {
            area,
            has_area: area != before,
            shape: span.and_then(|span| Shape::choose(2 * area.pixels(), count, span)),
        })
    }

    /// Returns the least place of the area.
    #[inline]
    #[must_use]
    pub const fn base(&self) -> u32 {
        self.area.y << 16 | self.area.x << 1
    }

    /// Writes the header for `length` and the area; returns the number of bytes.
    #[inline]
    pub fn write_head(&self, width: u32, length: u32, out: &mut Output) -> usize {
        let header = Header {
            width,
            has_area: self.has_area,
            steps_back: self.shape.is_none(),
            length,
        };
        let bits = u64::from(header.bits()) | self.area.bits() << 16;
        if let Some(to) = out.first_chunk_mut() {
            *to = bits.to_le_bytes();
        }
        if self.has_area { 8 } else { 2 }
    }
}

#[cfg(test)]
mod tests {
    use super::quotient_by_halves;

    #[test]
    fn halves_divide_as_whole() {
        let mut state = 0x1234_5678_9ABC_DEF1_u64;
        for i in 0..1_000_000_u32 {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            let bits = match i % 4 {
                0 => i,
                1 => u32::MAX - i,
                2 => state as u32 & 0xFFFF_0000 | i & 1,
                _ => state as u32,
            };
            let divisor = bits | 1 << 31;
            assert_eq!(
                u64::from(quotient_by_halves(divisor)),
                ((1 << 63) - 1) / u64::from(divisor),
                "{divisor}"
            );
        }
    }
}
