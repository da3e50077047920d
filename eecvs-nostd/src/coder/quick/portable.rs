//! Codes blocks one event at a time, on any core.

use crate::coder::quick::Window;
use crate::coder::quick::format::{
    Area, BLOCK, Block, Divisor, LANES, Output, Placed, Plan, Shape, UPPER_BYTES_MAX, bit_length,
    last_upper, packed_bytes, span,
};
use crate::fixed_point::{dot_add, least_halves, most_halves};
use event_types::{Event, Polarity};

/// Words of the upper parts, rounded up to a power of two.
const UPPER_WORDS: usize = (UPPER_BYTES_MAX / 4).next_power_of_two();

/// Returns the sum of the products of both halves, all below 2^15.
#[inline(always)]
fn dot(a: u32, b: u32) -> u32 {
    dot_add(0, a, b) as u32
}

/// Codes a block's events, 1 to [`BLOCK`]; `block` has the time before them, and its words and positions mean nothing
/// afterwards. Returns the number of bytes, or `None` if an event is not on the sensor or in the window.
#[must_use]
pub fn encode_block(
    events: &[Placed],
    block: &mut Block,
    area: &mut Area,
    window: &Window,
    out: &mut Output,
) -> Option<usize> {
    let count = events.len().min(BLOCK);
    let events = events.get(..count)?;
    let (bounds, span) = scan(events, block.first);
    let plan = Plan::new(bounds, count, span, *area, window.sensor)?;
    *area = plan.area;
    match plan.shape {
        Some(_) if block.first.checked_add(span?)? >= window.duration_us => None,
        Some(shape) => Some(encode_times_up(events, block, plan, shape, out)),
        None => {
            block.fill(events);
            encode_times_back(block, count, plan, window, out)
        }
    }
}

/// Returns the bounds of the halves of places, and the time of the last event since `first`: `None` if a time steps
/// back, or is so late that this is of no matter.
#[inline]
fn scan(events: &[Placed], first: u32) -> ((u32, u32), Option<u32>) {
    let (mut least, mut most) = (u32::MAX, 0);
    let (mut before, mut signs) = (0_u32, 0);
    let mut one = |[offset_us, place]: &Placed| {
        least = least_halves(least, *place);
        most = most_halves(most, *place);
        // The highest bits: below 2^31, a difference below 0 is one that has it.
        let d = offset_us.wrapping_sub(first);
        signs |= d | d.wrapping_sub(before);
        before = d;
    };
    let (fours, rest) = events.as_chunks::<4>();
    for four in fours {
        four.iter().for_each(&mut one);
    }
    rest.iter().for_each(one);
    ((least, most), span(first, before, signs >> 31 == 1))
}

#[inline]
fn encode_times_up(
    events: &[Placed],
    block: &mut Block,
    plan: Plan,
    Shape { width, quantum }: Shape,
    out: &mut Output,
) -> usize {
    let Block {
        first,
        places: words,
        ..
    } = block;
    let first = *first;
    let weights = (2 * plan.area.columns) << 16 | 1;
    let base = (dot(plan.base(), weights) as i32).wrapping_neg();
    let mut last = 0;
    // Bits of a word count from the highest here.
    let mut upper = [0_u32; UPPER_WORDS];
    let mut i = 0;
    let mut one = |[offset_us, place]: &Placed, word: &mut u32| {
        let d = offset_us.wrapping_sub(first);
        let high = quantum.quotient(d);
        // code q + (d - high q)
        let code = dot_add(base, *place, weights) as u32;
        *word = (code.wrapping_sub(high))
            .wrapping_mul(quantum.value)
            .wrapping_add(d);
        let position = high.wrapping_add(i);
        upper[(position >> 5) as usize % UPPER_WORDS] |= (1_u32 << 31).rotate_right(position);
        i += 1;
        last = position;
    };
    let (fours, rest) = events.as_chunks::<4>();
    let (word_fours, _) = words.as_chunks_mut::<4>();
    for (four, words) in fours.iter().zip(word_fours) {
        for (event, word) in four.iter().zip(words) {
            one(event, word);
        }
    }
    let word_rest = words.get_mut(4 * fours.len()..).unwrap_or_default();
    for (event, word) in rest.iter().zip(word_rest) {
        one(event, word);
    }
    let length = last as usize / 8 + 1;
    let mut head = plan.write_head(width, length as u32, out);
    let to = out.get_mut(head..).unwrap_or_default();
    head += pack(words, events.len(), width, to);
    let to = out.get_mut(head..).unwrap_or_default();
    let words = upper.iter().take(length.div_ceil(4));
    for (to, word) in to.as_chunks_mut().0.iter_mut().zip(words) {
        *to = word.reverse_bits().to_le_bytes();
    }
    head + length
}

/// Codes places and times apart, both at full width.
#[inline(never)]
pub fn encode_times_back(
    block: &mut Block,
    count: usize,
    plan: Plan,
    window: &Window,
    out: &mut Output,
) -> Option<usize> {
    let (base, row) = (plan.base(), 2 * plan.area.columns);
    let Block {
        first,
        times: [_, times @ ..],
        places,
    } = block;
    let (mut least, mut most) = (u32::MAX, 0);
    for (t, place) in times.iter().zip(places.iter_mut()).take(count) {
        let t = first.wrapping_add(*t);
        least = least.min(t);
        most = most.max(t);
        *place = dot(place.wrapping_sub(base), row << 16 | 1);
    }
    if most >= window.duration_us {
        return None;
    }
    let width = bit_length(row * plan.area.rows - 1);
    let time_width = bit_length(most.wrapping_sub(least));
    let mut at = plan.write_head(width, time_width, out);
    if let Some(to) = out.get_mut(at..).and_then(<[u8]>::first_chunk_mut) {
        *to = least.to_le_bytes();
    }
    at += 4;
    at += pack(places, count, width, out.get_mut(at..).unwrap_or_default());
    for (t, word) in times.iter().zip(places.iter_mut()) {
        *word = first.wrapping_add(*t).wrapping_sub(least);
    }
    let out = out.get_mut(at..).unwrap_or_default();
    Some(at + pack(places, count, time_width, out))
}

/// Packs the first `count` words at `width` bits, 1 to 32, one after another; returns the number of bytes. May write
/// up to 3 bytes more.
#[inline]
pub fn pack_in_turn(words: &[u32; BLOCK], count: usize, width: u32, out: &mut [u8]) -> usize {
    let mut to = out.as_chunks_mut().0.iter_mut();
    let (mut bits, mut filled) = (0, 0);
    for word in words.get(..count).unwrap_or_default() {
        bits |= word << filled;
        filled += width;
        if filled >= 32 {
            filled -= 32;
            if let Some(to) = to.next() {
                *to = u32::to_le_bytes(bits);
            }
            bits = word >> 1 >> (width - 1 - filled);
        }
    }
    if let Some(to) = to.next() {
        *to = bits.to_le_bytes();
    }
    packed_bytes(count, width)
}

/// Packs the first `count` words at `width` bits; returns the number of bytes. May write up to 3 bytes more.
#[inline(never)]
fn pack(words: &[u32; BLOCK], count: usize, width: u32, out: &mut [u8]) -> usize {
    if width == 0 {
        return 0;
    }
    if count < BLOCK {
        return pack_in_turn(words, count, width, out);
    }
    let (whole, half) = out
        .split_at_mut_checked(width as usize / 2 * 4 * LANES)
        .unwrap_or_default();
    let mut units = whole.as_chunks_mut::<{ 4 * LANES }>().0.iter_mut();
    let (mut lanes, mut filled) = ([0; LANES], 0);
    // A row of words at a time: in all lanes the same bits are filled.
    for row in words.as_chunks::<LANES>().0 {
        let shift = filled & 31;
        filled += width;
        if filled < 32 {
            for (lane, word) in lanes.iter_mut().zip(row) {
                *lane |= word << shift;
            }
            continue;
        }
        filled -= 32;
        let Some(unit) = units.next() else { continue };
        // Nothing is left of a word of 32 bits, whose shift is 0.
        let over = width - 1 - filled;
        for ((to, lane), word) in unit.as_chunks_mut().0.iter_mut().zip(&mut lanes).zip(row) {
            *to = (*lane | word << shift).to_le_bytes();
            *lane = word >> 1 >> over;
        }
    }
    if filled > 0 {
        for (to, lane) in half.as_chunks_mut().0.iter_mut().zip(lanes) {
            *to = (lane as u16).to_le_bytes();
        }
    }
    packed_bytes(count, width)
}

/// Returns the bytes from `at`, with zeros for those that are missing.
#[inline]
fn bytes_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let from = bytes.get(at..).unwrap_or_default();
    if let Some(whole) = from.first_chunk() {
        return *whole;
    }
    let mut part = [0; N];
    for (to, from) in part.iter_mut().zip(from) {
        *to = *from;
    }
    part
}

/// The bits of words that follow each other.
struct Bits {
    width: u32,
    mask: u32,
    bits: u32,
    filled: u32,
}

impl Bits {
    /// Returns an empty one, for words of 1 to 32 bits.
    #[inline(always)]
    fn new(width: u32) -> Self {
        Self {
            width,
            mask: u32::MAX >> ((32 - width) & 31),
            bits: 0,
            filled: 0,
        }
    }

    /// Takes the next word; `unit` reads 32 more bits.
    #[inline(always)]
    fn take(&mut self, unit: impl FnOnce() -> u32) -> u32 {
        let word;
        if self.filled >= self.width {
            word = self.bits & self.mask;
            self.filled -= self.width;
            self.bits = self.bits >> 1 >> (self.width - 1);
        } else {
            let unit = unit();
            word = (self.bits | unit << self.filled) & self.mask;
            let used = self.width - self.filled;
            self.bits = unit >> 1 >> (used - 1);
            self.filled = 32 - used;
        }
        word
    }
}

/// Unpacks `count` words of `width` bits, 1 to 32, one after another.
#[inline(always)]
pub fn unpack_in_turn(bytes: &[u8], count: usize, width: u32, mut f: impl FnMut(usize, u32)) {
    let mut bits = Bits::new(width);
    let mut at = 0;
    for i in 0..count {
        let word = bits.take(|| {
            at += 4;
            u32::from_le_bytes(bytes_at(bytes, at - 4))
        });
        f(i, word);
    }
}

/// Unpacks `count` words of `width` bits, at most 32, and has `f` take each with its number.
#[inline(always)]
fn unpack(bytes: &[u8], count: usize, width: u32, mut f: impl FnMut(usize, u32)) {
    if width == 0 {
        for i in 0..count {
            f(i, 0);
        }
        return;
    }
    if count < BLOCK {
        return unpack_in_turn(bytes, count, width, f);
    }
    let (whole, half) = bytes
        .split_at_checked(width as usize / 2 * 4 * LANES)
        .unwrap_or_default();
    for lane in 0..LANES {
        let mut bits = Bits::new(width);
        let mut units = whole.as_chunks::<{ 4 * LANES }>().0.iter();
        for i in (lane..BLOCK).step_by(LANES) {
            let word = bits.take(|| match units.next() {
                Some(unit) => u32::from_le_bytes(unit.as_chunks().0[lane]),
                None => half
                    .as_chunks()
                    .0
                    .get(lane)
                    .map_or(0, |half| u16::from_le_bytes(*half).into()),
            });
            f(i, word);
        }
    }
}

/// The fields of a block that hold its events.
#[derive(Debug, Clone, Copy)]
pub struct Body<'p> {
    /// Area of the places.
    pub area: Area,
    /// Packed words.
    pub words: &'p [u8],
    /// Width of a word.
    pub width: u32,
    /// The times.
    pub times: Times<'p>,
}

/// Times of a block.
#[derive(Debug, Clone, Copy)]
pub enum Times<'p> {
    /// Upper parts, and the quantum of the lower.
    Up {
        /// Quantum of times.
        quantum: Divisor,
        /// Bits of the upper parts.
        upper: &'p [u8],
    },
    /// All at full width.
    Back {
        /// Least time.
        least: u32,
        /// Width of a time.
        width: u32,
        /// Packed times.
        packed: &'p [u8],
    },
}

/// Reads the events of a block into `events`, at most [`BLOCK`]; `first` is the time of the event before. `None` if
/// the bits are not those of as many events in the area and the window.
#[must_use]
pub fn decode_block(
    body: &Body<'_>,
    &Window {
        start_us,
        duration_us,
        ..
    }: &Window,
    first: u32,
    events: &mut [Event],
) -> Option<()> {
    let count = events.len().min(BLOCK);
    match body.times {
        Times::Up { quantum, upper } => {
            let highest = last_upper(upper, count)?;
            let latest = u64::from(highest) * u64::from(quantum.value);
            if latest >= 1 << 31 {
                return None;
            }
            let mut highs = [0; BLOCK];
            uppers(upper, highs.get_mut(..count)?)?;
            let end = u64::from(duration_us);
            // What was found ascends: all times but those of the last upper part are below this one.
            let least = u64::from(first) + latest;
            let is_near_end = least + u64::from(quantum.value) > end;
            let mut is_outside = is_near_end && least >= end;
            let mut words = [0; BLOCK];
            unpack(body.words, count, body.width, |i, word| {
                if let Some(to) = words.get_mut(i) {
                    *to = word;
                }
            });
            let mut pixels = Pixels::new(body.area);
            for ((event, word), high) in events.iter_mut().zip(&words).zip(&highs) {
                let code = quantum.quotient(*word);
                // Below 2^31 + 2^31.
                let d = u32::from(*high) * quantum.value + (*word - code * quantum.value);
                if is_near_end {
                    is_outside |= u64::from(first) + u64::from(d) >= end;
                }
                let t = first.wrapping_add(d);
                pixels.place(code, start_us.wrapping_add(t.into()), event);
            }
            (!is_outside && pixels.are_inside()).then_some(())
        }
        Times::Back {
            least,
            width,
            packed,
        } => {
            let mut pixels = Pixels::new(body.area);
            unpack(body.words, count, body.width, |i, code| {
                if let Some(event) = events.get_mut(i) {
                    pixels.place(code, 0, event);
                }
            });
            let mut most = 0;
            unpack(packed, count, width, |i, t| {
                most = t.max(most);
                if let Some(event) = events.get_mut(i) {
                    event.t_us = start_us.wrapping_add(least.wrapping_add(t).into());
                }
            });
            let is_outside = u64::from(least) + u64::from(most) >= u64::from(duration_us);
            (!is_outside && pixels.are_inside()).then_some(())
        }
    }
}

/// Turns codes into pixels.
struct Pixels {
    area: Area,
    row: Divisor,
    /// The lowest row.
    lowest: u32,
}

impl Pixels {
    #[inline(always)]
    fn new(area: Area) -> Self {
        Self {
            area,
            row: Divisor::new(2 * area.columns),
            lowest: 0,
        }
    }

    #[inline(always)]
    fn place(&mut self, code: u32, t_us: u64, event: &mut Event) {
        let y = self.row.quotient(code);
        self.lowest = y.max(self.lowest);
        let rest = code - y * self.row.value;
        *event = Event {
            t_us,
            x: (self.area.x + rest / 2) as u16,
            y: (self.area.y.wrapping_add(y)) as u16,
            polarity: Polarity::from_bool(rest & 1 == 1),
        };
    }

    /// Returns whether all pixels lie in the area.
    #[inline(always)]
    fn are_inside(&self) -> bool {
        self.lowest < self.area.rows
    }
}

/// Finds the bits that are set, less their number; `None` if there are not as many as places for them.
#[inline]
fn uppers(upper: &[u8], uppers: &mut [u8]) -> Option<()> {
    let mut to = uppers.iter_mut();
    let mut start = 0_u32;
    for from in upper.chunks(4) {
        let mut bits = u32::from_le_bytes(bytes_at(from, 0));
        while bits != 0 {
            // At most the last one, which is a byte.
            *to.next()? = start.wrapping_add(bits.trailing_zeros()) as u8;
            start = start.wrapping_sub(1);
            bits &= bits - 1;
        }
        start = start.wrapping_add(32);
    }
    to.next().is_none().then_some(())
}
