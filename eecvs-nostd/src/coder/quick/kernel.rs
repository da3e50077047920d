//! Codes blocks in vectors: one algorithm over [`Lanes`].

use crate::coder::quick::Window;
use crate::coder::quick::format::{
    Area, BLOCK, Block, Divisor, LANES, Output, Placed, Plan, Shape, UPPER_BYTES_MAX, last_upper,
    span,
};
use crate::coder::quick::lanes::{Lanes, ROWS};
use crate::coder::quick::portable::{self, Body, Times, encode_times_back, pack_in_turn};
use event_types::Event;

const fn counting() -> [u32; BLOCK] {
    let mut numbers = [0; BLOCK];
    let mut i = 0;
    while i < BLOCK {
        numbers[i] = i as u32;
        i += 1;
    }
    numbers
}

/// 0, 1, 2 and so on.
static NUMBERS: [u32; BLOCK] = counting();

/// Eight words, from row `row` of a block.
#[inline(always)]
fn row<T>(of: &[T; BLOCK], row: usize) -> &[T; LANES] {
    &of.as_chunks().0[row]
}

#[inline(always)]
fn row_mut<T>(of: &mut [T; BLOCK], row: usize) -> &mut [T; LANES] {
    &mut of.as_chunks_mut().0[row]
}

/// Takes a block's events in, 1 to [`BLOCK`], and codes them; as [`portable::encode_block`].
#[inline(always)]
pub fn encode<L: Lanes>(
    l: L,
    events: &[Placed],
    block: &mut Block,
    area: &mut Area,
    window: &Window,
    out: &mut Output,
) -> Option<usize> {
    if let Ok(full) = events.try_into() {
        let bounds = fill(l, full, block);
        encode_block::<_, true>(l, block, BLOCK, bounds, area, window, out)
    } else {
        block.fill(events);
        let bounds = bounds(l, block, events.len());
        encode_block::<_, false>(l, block, events.len(), bounds, area, window, out)
    }
}

/// Takes a full block's events in, as [`Block::fill`]. Returns the bounds of both halves of their places.
#[inline(always)]
fn fill<L: Lanes>(l: L, events: &[Placed; BLOCK], block: &mut Block) -> (u32, u32) {
    let first = l.splat(block.first);
    let [_, times @ ..] = &mut block.times;
    let (mut least, mut most) = (l.splat(u32::MAX), l.splat(0));
    for r in 0..ROWS {
        let (offsets_us, places) = l.load_pairs(row(events, r));
        least = l.min_halves(least, places);
        most = l.max_halves(most, places);
        l.store(row_mut(times, r), l.sub(offsets_us, first));
        l.store(row_mut(&mut block.places, r), places);
    }
    (l.least_halves(least), l.most_halves(most))
}

/// Returns the bounds of both halves of a block's places, and fills its last row up.
#[inline(always)]
fn bounds<L: Lanes>(l: L, block: &mut Block, count: usize) -> (u32, u32) {
    let count = count.clamp(1, BLOCK);
    let (t, place) = (block.times[count], block.places[count - 1]);
    for i in count..count.next_multiple_of(LANES).min(BLOCK) {
        block.times[i + 1] = t;
        block.places[i] = place;
    }
    let (mut least, mut most) = (l.splat(u32::MAX), l.splat(0));
    for r in 0..count.div_ceil(LANES) {
        let place = l.load(row(&block.places, r));
        least = l.min_halves(least, place);
        most = l.max_halves(most, place);
    }
    (l.least_halves(least), l.most_halves(most))
}

/// Codes a block of `count` events, [`BLOCK`] if `FULL`, of which the last row is filled up, and makes its words in
/// its place. Returns the number of bytes, or `None` if an event is not on the sensor or in the window.
#[inline(always)]
fn encode_block<L: Lanes, const FULL: bool>(
    l: L,
    block: &mut Block,
    count: usize,
    bounds: (u32, u32),
    area: &mut Area,
    window: &Window,
    out: &mut Output,
) -> Option<usize> {
    let count = if FULL { BLOCK } else { count.clamp(1, BLOCK) };
    let rows = count.div_ceil(LANES);
    let [_, times @ ..] = &block.times;
    let [times_before @ .., _] = &block.times;
    let mut signs = l.splat(0);
    for r in 0..rows {
        // As `portable::scan`.
        let t = l.load(row(times, r));
        signs = l.or(signs, l.or(t, l.sub(t, l.load(row(times_before, r)))));
    }
    let last = *block.times.get(count)?;
    let span = span(block.first, last, !l.is_zero(l.shr(signs, 31)));
    let plan = Plan::new(bounds, count, span, *area, window.sensor)?;
    *area = plan.area;
    let Some(Shape { width, quantum }) = plan.shape else {
        return encode_times_back(block, count, plan, window, out);
    };
    if block.first.checked_add(span?)? >= window.duration_us {
        return None;
    }

    let mut positions = [0; BLOCK];
    let base = l.splat(plan.base());
    let weights = l.splat((2 * plan.area.columns) << 16 | 1);
    let (q, m) = (l.splat(quantum.value), l.splat(quantum.multiplier));
    for r in 0..rows {
        let d = l.load(row(times, r));
        let high = l.shr(l.mul_high(l.add(d, d), m), quantum.shift);
        let code = l.dot(l.sub(l.load(row(&block.places, r)), base), weights);
        // code q + (d - high q)
        let word = l.add(l.mul(l.sub(code, high), q), d);
        l.store(row_mut(&mut block.places, r), word);
        l.store(
            row_mut(&mut positions, r),
            l.add(high, l.load(row(&NUMBERS, r))),
        );
    }

    let length = (positions[count - 1] as usize + 8) / 8;
    let mut at = plan.write_head(width, length as u32, out);
    let mut marks = [0_u8; 512];
    for position in &positions[..count] {
        marks[*position as usize & 511] = u8::MAX;
    }
    if FULL {
        let bytes = ROWS * width as usize;
        pack_words(l, width, &block.places, out.get_mut(at..at + bytes)?);
        at += bytes;
    } else {
        at += pack_in_turn(&block.places, count, width, out.get_mut(at..)?);
    }
    let upper: &mut [u8; UPPER_BYTES_MAX] = out.get_mut(at..)?.first_chunk_mut()?;
    for (to, marks) in upper.as_chunks_mut().0.iter_mut().zip(marks.as_chunks().0) {
        *to = l.high_bits(marks).to_le_bytes();
    }
    Some(at + length)
}

/// Calls a function with the width as a constant.
macro_rules! for_width {
    ($width:expr, $function:ident::<$l:ty> $arguments:tt, $($w:literal)*) => {
        match $width {
            $($w => $function::<$l, $w> $arguments,)*
            _ => {}
        }
    };
}

#[inline(always)]
fn pack_words<L: Lanes>(l: L, width: u32, words: &[u32; BLOCK], out: &mut [u8]) {
    for_width!(width, pack::<L>(l, words, out),
        1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31);
}

#[inline(always)]
fn unpack_words<L: Lanes>(l: L, width: u32, bytes: &[u8], words: &mut [u32; BLOCK]) {
    for_width!(width, unpack::<L>(l, bytes, words),
        1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31);
}

/// Packs words of W bits, 1 to 31, into 16 W bytes.
#[inline(always)]
fn pack<L: Lanes, const W: u32>(l: L, words: &[u32; BLOCK], out: &mut [u8]) {
    if out.len() != ROWS * W as usize {
        return;
    }
    let (whole, half) = out.as_chunks_mut();
    let mut bits = l.splat(0);
    // Unrolled, so that all shifts are constants.
    macro_rules! rows {
        ($($r:literal)*) => {$({
            let word = l.load(row(words, $r));
            let shift = $r * W % 32;
            bits = if shift == 0 { word } else { l.or(bits, l.shl(word, shift)) };
            if shift + W >= 32 {
                l.store_bytes(&mut whole[($r * W / 32) as usize], bits);
                if shift + W > 32 {
                    bits = l.shr(word, 32 - shift);
                }
            }
        })*};
    }
    rows!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);
    if W % 2 == 1
        && let Some(half) = half.first_chunk_mut()
    {
        l.store_half_bytes(half, bits);
    }
}

/// Unpacks words of W bits, 1 to 31, from 16 W bytes.
#[inline(always)]
fn unpack<L: Lanes, const W: u32>(l: L, bytes: &[u8], words: &mut [u32; BLOCK]) {
    if bytes.len() != ROWS * W as usize {
        return;
    }
    let (whole, half) = bytes.as_chunks();
    let Some(half) = (if W.is_multiple_of(2) {
        Some(&[0; 2 * LANES])
    } else {
        half.first_chunk()
    }) else {
        return;
    };
    macro_rules! unit {
        ($k:expr) => {
            if $k < W / 2 {
                l.load_bytes(&whole[$k as usize])
            } else {
                l.load_half_bytes(half)
            }
        };
    }
    let mask = l.splat((1 << W) - 1);
    let mut bits = unit!(0);
    macro_rules! rows {
        ($($r:literal)*) => {$({
            let shift = $r * W % 32;
            if shift == 0 && $r > 0 {
                bits = unit!($r * W / 32);
            }
            let mut word = if shift == 0 { bits } else { l.shr(bits, shift) };
            if shift + W > 32 {
                bits = unit!($r * W / 32 + 1);
                word = l.or(word, l.shl(bits, 32 - shift));
            }
            l.store(row_mut(words, $r), if shift + W == 32 { word } else { l.and(word, mask) });
        })*};
    }
    rows!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);
}

/// The positions of the bits set in each byte, a byte each, first from the lowest up; then zeros.
static ONES: [u64; 256] = {
    let mut ones = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let (mut bit, mut n) = (0, 0);
        while bit < 8 {
            if byte >> bit & 1 == 1 {
                ones[byte] |= bit << (8 * n);
                n += 1;
            }
            bit += 1;
        }
        byte += 1;
    }
    ones
};

/// The position of each byte's lowest bit, eight times, modulo 256.
static STARTS: [u64; UPPER_BYTES_MAX] = {
    let mut starts = [0; UPPER_BYTES_MAX];
    let mut i = 0;
    while i < UPPER_BYTES_MAX {
        starts[i] = ((8 * i as u64) & 255) * 0x0101_0101_0101_0101;
        i += 1;
    }
    starts
};

/// Finds the bits that are set, modulo 256; `None` if there are not `count`.
#[inline(always)]
fn positions(upper: &[u8], count: usize, positions: &mut [u8; BLOCK + 8]) -> Option<()> {
    let mut found = 0_usize;
    macro_rules! find {
        ($byte:expr, $start:expr) => {
            // The last byte has a bit set: where this wraps, too many will be found.
            let to: &mut [u8; 8] = positions[found & (BLOCK - 1)..].first_chunk_mut()?;
            *to = (ONES[*$byte as usize] | $start).to_le_bytes();
            found += $byte.count_ones() as usize;
        };
    }
    let (fours, rest) = upper.as_chunks();
    let (starts, _) = STARTS.as_chunks();
    for ([a, b, c, d], [p, q, r, s]) in fours.iter().zip(starts) {
        find!(a, p);
        find!(b, q);
        find!(c, r);
        find!(d, s);
    }
    for (byte, start) in rest.iter().zip(STARTS.get(4 * fours.len()..)?) {
        find!(byte, start);
    }
    (found == count).then_some(())
}

/// Reads the events of a block of `count`, 1 to [`BLOCK`], and anything after them; as [`portable::decode_block`], for
/// times that ascend.
#[inline(always)]
pub fn decode<L: Lanes>(
    l: L,
    body: &Body<'_>,
    window: &Window,
    first: u32,
    count: usize,
    events: &mut [Event; BLOCK],
) -> Option<()> {
    // Two calls: one by a pointer would not be inlined, and vectors outside of their features are calls themselves.
    if count == BLOCK {
        decode_block::<L, true>(l, body, window, first, count, events)
    } else {
        decode_block::<L, false>(l, body, window, first, count, events)
    }
}

#[inline(always)]
fn decode_block<L: Lanes, const FULL: bool>(
    l: L,
    body: &Body<'_>,
    window: &Window,
    first: u32,
    count: usize,
    events: &mut [Event; BLOCK],
) -> Option<()> {
    let Times::Up { quantum, upper } = body.times else {
        return None;
    };
    let Window {
        start_us,
        duration_us,
        ..
    } = *window;
    let count = if FULL { BLOCK } else { count.clamp(1, BLOCK) };
    let rows = count.div_ceil(LANES);
    let highest = last_upper(upper, count)?;
    let mut found = [0; BLOCK + 8];
    positions(upper, count, &mut found)?;
    for i in count..rows * LANES {
        // Stands for no upper part.
        found[i & (BLOCK - 1)] = i as u8;
    }
    let found: &[u8; BLOCK] = found.first_chunk()?;
    if u64::from(highest) * u64::from(quantum.value) >= 1 << 31 {
        return None;
    }
    let mut words = [0; BLOCK];
    if FULL {
        unpack_words(l, body.width, body.words, &mut words);
    } else {
        portable::unpack_in_turn(body.words, count, body.width, |i, word| {
            words[i & (BLOCK - 1)] = word;
        });
    }

    let (q, m) = (l.splat(quantum.value), l.splat(quantum.multiplier));
    let columns = Divisor::new(2 * body.area.columns);
    let (row_q, row_m) = (l.splat(columns.value), l.splat(columns.multiplier));
    let (one, byte, start) = (l.splat(1), l.splat(255), l.splat(first));
    let base = l.splat(body.area.y << 16 | body.area.x);
    let (mut most_y, mut most_d) = (l.splat(0), l.splat(0));
    for r in 0..rows {
        let word = l.load(row(&words, r));
        let code = l.shr(l.mul_high(l.add(word, word), m), quantum.shift);
        let at = l.load_single_bytes(row(found, r));
        let high = l.and(l.sub(at, l.load(row(&NUMBERS, r))), byte);
        // high q + (word - code q), below 2^31 + 2^31
        let d = l.add(l.mul(l.sub(high, code), q), word);
        // Below 2 rows, as q is more than half of 2^w / codes.
        let y = l.shr(l.mul_high(code, row_m), columns.shift - 1);
        let rest = l.sub(code, l.dot(y, row_q));
        most_y = l.max(most_y, y);
        most_d = l.max(most_d, d);
        let place = l.add(l.or(l.shl(y, 16), l.shr(rest, 1)), base);
        l.store_events(
            row_mut(events, r),
            start_us,
            l.add(d, start),
            place,
            l.and(rest, one),
        );
    }
    let is_inside = u64::from(first) + u64::from(l.most(most_d)) < u64::from(duration_us);
    (is_inside && l.most(most_y) < body.area.rows).then_some(())
}
