//! Codes a window's events: the sort stage, then the code stage.

use crate::coder::keys::code::{CONTEXTS, Codes, LONGEST, SYMBOLS, codes};
use crate::coder::keys::head::{Head, Model, SECTIONS, section_start, sections};
use crate::coder::keys::kernels::{AHEAD, Kernels, Pairs, Span, Symbols, Words};
use crate::coder::keys::portable::width;
use crate::coder::keys::preset::preset;
use crate::coder::keys::sort::Sorter;
use crate::coder::keys::{SLICE_EVENTS, Simd, Window, slice_start, slices};
use crate::coder::quick::Placed;
use zerocopy::FromZeros;

/// Fewer events are not worth the description of a second context.
const TWO_CONTEXTS: usize = 1024;

/// Why events were not coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum NotEncoded {
    /// An event is not on the sensor or not in the window.
    Outside,
    /// Events are not in order of time.
    Unordered,
}

/// Why a number of events was not coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// See [`NotEncoded`].
    Not(NotEncoded),
    /// This many events from the front would need about so many bytes, more than there are.
    Full {
        /// Events from the front, at least 1.
        events: usize,
        /// Bytes, at least 1.
        bytes: u64,
    },
}

/// What of a window was coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Coded {
    /// Bytes of the payload.
    pub bytes: usize,
    /// Events in it, from the front.
    pub events: usize,
}

/// Bytes of room beyond a payload: bits are written as whole words.
const BEYOND: usize = 8;

/// Room in which one event has a payload of its own, whatever it is: flags, two numbers of 5 bytes, a section's size, a
/// code of two symbols in at most 40 bits, a bit, 53 bits of mantissa, and the last word.
pub const EVENT_BYTES_MAX: usize = 1 + 10 + 2 + 5 + SECTIONS + 7 + BEYOND;

/// Memory of an encoder.
#[derive(Debug, FromZeros)]
pub struct EncoderMemory {
    sorter: Sorter,
    symbols: Symbols,
    counts: [[u16; SYMBOLS * CONTEXTS]; 4],
}

/// Codes events of a window, in order of time, from the front as far as there is room in `out`: at least one in
/// [`EVENT_BYTES_MAX`] bytes.
///
/// # Errors
/// [`NotEncoded`]; what `out` then holds means nothing.
pub fn encode(
    simd: Simd,
    window: &Window,
    events: &[Placed],
    memory: &mut EncoderMemory,
    out: &mut [u8],
) -> Result<Coded, NotEncoded> {
    // An event takes a bit at least.
    let mut count = events.len().min(out.len().saturating_mul(8));
    while count > 0 {
        let part = events.get(..count).unwrap_or_default();
        match simd.encode(window, part, memory, out) {
            Ok(bytes) => {
                return Ok(Coded {
                    bytes,
                    events: count,
                });
            }
            Err(Stop::Not(error)) => return Err(error),
            Err(Stop::Full { events, bytes }) => {
                // As many as take the room at this rate, and a little less; never almost as many as before.
                let fitting = events as u64 * out.len() as u64 / bytes.max(1);
                let fitting = fitting - fitting / 32;
                count = (fitting as usize).min(count - count.div_ceil(32));
            }
        }
    }
    Ok(Coded::default())
}

/// Codes all of a window's events, in order of time; returns the bytes of the payload. `out` has to be [`BEYOND`] bytes
/// longer than that.
#[inline(always)]
pub fn encode_with<K: Kernels>(
    kernels: K,
    window: &Window,
    events: &[Placed],
    memory: &mut EncoderMemory,
    out: &mut [u8],
) -> Result<usize, Stop> {
    let n = events.len();
    let all = slices(n);
    let (mut bytes, mut last) = (0, None);
    let cells = window.cells;
    let all_units = cells.count();
    for slice in 0..all {
        let (start, end) = (slice_start(n, slice), slice_start(n, slice + 1));
        let events = &events[start..end];
        let (Some([one, _]), Some([other, _])) = (events.first(), events.last()) else {
            continue;
        };
        if *one.max(other) >= window.duration_us {
            return Err(Stop::Not(NotEncoded::Outside));
        }
        let (mut first, last_unit) = (cells.of(*one), cells.of(*other));
        if last_unit < first || first < last.unwrap_or(0) {
            return Err(Stop::Not(NotEncoded::Unordered));
        }
        let mut units = last_unit - first + 1;
        // A sparse window's span is hardly worth its bytes.
        let spare = events.len() as u64 * u64::from(all_units - units) / 16;
        let tells_times = all > 1 || spare > u64::from(units);
        if !tells_times {
            (first, units) = (0, all_units);
        }
        let (sorter, sensor) = (&mut memory.sorter, window.sensor);
        let is_inside = match cells.width_us() {
            Some(1) => sorter.sort(kernels, events, sensor, |t| t.wrapping_sub(first)),
            Some(width_us) => {
                let unit = |t: u32| (t / width_us).wrapping_sub(first);
                sorter.sort(kernels, events, sensor, unit)
            }
            None => sorter.sort(kernels, events, sensor, |t| cells.of(t).wrapping_sub(first)),
        };
        if !is_inside {
            return Err(Stop::Not(NotEncoded::Outside));
        }
        let span = Span::new(window, units);
        let head = Head {
            first,
            units,
            tells_times,
            sections: [0; SECTIONS],
        };
        let count = events.len();
        let room = out.get_mut(bytes..).unwrap_or_default();
        bytes += match code(kernels, memory, count, (span, head, last), room) {
            Ok(bytes) => bytes,
            Err(NotCoded::Unordered) => return Err(Stop::Not(NotEncoded::Unordered)),
            Err(NotCoded::Full(needed)) => {
                return Err(Stop::Full {
                    events: end,
                    bytes: bytes as u64 + needed,
                });
            }
        };
        last = Some(last_unit);
    }
    Ok(bytes)
}

/// Why a slice was not coded.
enum NotCoded {
    /// Keys do not ascend.
    Unordered,
    /// It needs about so many bytes.
    Full(u64),
}

/// Returns the bits of the codes of symbols, without mantissas.
fn cost(counts: &[u16; SYMBOLS * CONTEXTS], codes: &Codes) -> u32 {
    // At most 2^14 symbols of 10 bits.
    counts
        .iter()
        .zip(codes)
        .map(|(&count, &code)| u32::from(count) * (code & 255))
        .sum()
}

/// The code stage: sorted words of a slice to its bytes, whose number is returned.
#[inline(always)]
fn code<K: Kernels>(
    kernels: K,
    memory: &mut EncoderMemory,
    n: usize,
    (span, mut head, last): (Span, Head, Option<u32>),
    out: &mut [u8],
) -> Result<usize, NotCoded> {
    let n = n.min(SLICE_EVENTS);
    let EncoderMemory {
        sorter,
        symbols,
        counts,
    } = memory;
    if !kernels.classes(&mut sorter.words, n, span, symbols, &mut sorter.pairs) {
        return Err(NotCoded::Unordered);
    }
    // The context of a symbol is whether the class before was that of another place.
    let split = (u32::BITS - (span.units - 1).leading_zeros() + 1).min(63) as u8;
    let contexts = if n < TWO_CONTEXTS { 1 } else { 2 };
    if contexts > 1 {
        for section in 0..sections(n) {
            let mut before = 0;
            for symbol in &mut symbols
                [AHEAD + section_start(n, section)..AHEAD + section_start(n, section + 1)]
            {
                let this = *symbol;
                *symbol |= if before >= split << 1 { 128 } else { 0 };
                before = this;
            }
        }
    }
    *counts = [[0; SYMBOLS * CONTEXTS]; 4];
    let symbols = &symbols[AHEAD..AHEAD + n];
    let [one, two, three, four] = counts;
    let mut fours = symbols.chunks_exact(4);
    for four_symbols in &mut fours {
        one[usize::from(four_symbols[0])] += 1;
        two[usize::from(four_symbols[1])] += 1;
        three[usize::from(four_symbols[2])] += 1;
        four[usize::from(four_symbols[3])] += 1;
    }
    for symbol in fours.remainder() {
        one[usize::from(*symbol)] += 1;
    }
    let mut mantissa_bits = 0;
    for (symbol, one) in one.iter_mut().enumerate() {
        *one += two[symbol] + three[symbol] + four[symbol];
        mantissa_bits += u64::from(*one) * u64::from(width(symbol as u8));
    }
    let mut model = Model {
        contexts,
        split,
        ..Model::NONE
    };
    if contexts > 1 && one[SYMBOLS..].iter().all(|&count| count == 0) {
        model.contexts = 1;
    }
    for (code, counts) in model
        .codes
        .iter_mut()
        .zip(one.chunks_exact(SYMBOLS))
        .take(model.contexts)
    {
        *code = crate::coder::keys::code::code(counts);
    }
    let mut all_codes = codes(&model.codes, model.contexts);
    let mut symbol_bits = cost(one, &all_codes);
    // Sections' sizes are not known yet, but have a fixed place.
    let last = last.unwrap_or(0);
    let mut head_bytes = head.write(n, last, &model, out);
    if sections(n) == 1 {
        let mut other = Model {
            contexts: 1,
            is_preset: true,
            ..Model::NONE
        };
        other.codes[0] = preset(&span, n);
        let other_codes = codes(&other.codes, 1);
        let bits = cost(one, &other_codes);
        let has_all = one
            .iter()
            .zip(&other_codes)
            .all(|(count, code)| *count == 0 || *code > 0);
        let other_bytes = head.write(n, last, &other, &mut []);
        let total = |head: usize, bits: u32| head + bits.div_ceil(8) as usize;
        if has_all && total(other_bytes, bits) <= total(head_bytes, symbol_bits) {
            head_bytes = head.write(n, last, &other, out);
            (model, all_codes, symbol_bits) = (other, other_codes, bits);
        }
    }
    let most = head_bytes as u64
        + u64::from(symbol_bits) / 8
        + SECTIONS as u64
        + mantissa_bits.div_ceil(8)
        + BEYOND as u64;
    if most > out.len() as u64 {
        return Err(NotCoded::Full(most));
    }
    let mut at = head_bytes;
    for section in 0..sections(n) {
        let symbols = &symbols[section_start(n, section)..section_start(n, section + 1)];
        let size = write_symbols(symbols, &all_codes, &mut out[at..]);
        head.sections[section] = size as u16;
        at += size;
    }
    at += write_pairs(symbols, &sorter.words, &sorter.pairs, &mut out[at..]);
    if !model.is_preset {
        head.patch(n, last, out);
    }
    Ok(at)
}

/// Symbols whose codes fit a word with what was pending.
const BATCH: usize = 5;
const _: () = assert!(BATCH as u32 * LONGEST + 7 <= u64::BITS);

/// Writes codes, highest bit first; returns the number of bytes, of which the last is filled with zeros.
#[inline(always)]
fn write_symbols(symbols: &[u8], codes: &Codes, out: &mut [u8]) -> usize {
    let (mut pending, mut count, mut at) = (0_u64, 0_u32, 0_usize);
    let mut batches = symbols.chunks_exact(BATCH);
    let mut put = |pending: u64, count: u32| {
        // The first bit is the highest.
        let word = if count == 0 {
            0
        } else {
            pending << (64 - count)
        };
        if let Some(eight) = out.get_mut(at..).and_then(|out| out.first_chunk_mut()) {
            *eight = word.to_be_bytes();
        }
        at += (count >> 3) as usize;
        at
    };
    for batch in &mut batches {
        for &symbol in batch {
            let code = codes[usize::from(symbol)];
            pending = pending << (code & 63) | u64::from(code >> 8);
            // Lengths add up in the lowest byte.
            count = count.wrapping_add(code);
        }
        put(pending, count & 255);
        count &= 7;
    }
    for &symbol in batches.remainder() {
        let code = codes[usize::from(symbol)];
        pending = pending << (code & 63) | u64::from(code >> 8);
        count += code & 63;
    }
    put(pending, count) + usize::from(count & 7 > 0)
}

/// Most bits of a pair that a word holds with what was pending.
const PAIR: u32 = 56;

/// Writes the bits below the highest of differences, lowest first; returns the number of bytes.
#[inline(always)]
fn write_pairs(symbols: &[u8], differences: &Words, pairs: &Pairs, out: &mut [u8]) -> usize {
    let mut bits = Mantissas {
        out,
        pending: 0,
        count: 0,
        at: 0,
    };
    let (twos, rest) = symbols.as_chunks::<2>();
    for ((two, differences), (&pair, &count)) in twos
        .iter()
        .zip(differences.as_chunks::<2>().0)
        .zip(pairs.bits.iter().zip(&pairs.counts))
    {
        let count = u32::from(count);
        if count <= PAIR {
            bits.put(pair, count);
        } else {
            bits.put_one(two[0], differences[0]);
            bits.put_one(two[1], differences[1]);
        }
    }
    if let [symbol] = rest {
        bits.put_one(*symbol, differences[symbols.len() - 1]);
    }
    bits.at + usize::from(bits.count > 0)
}

struct Mantissas<'a> {
    out: &'a mut [u8],
    pending: u64,
    count: u32,
    at: usize,
}

impl Mantissas<'_> {
    /// Writes up to [`PAIR`] bits.
    #[inline(always)]
    fn put(&mut self, bits: u64, count: u32) {
        self.pending |= bits << self.count;
        self.count += count;
        if let Some(eight) = self
            .out
            .get_mut(self.at..)
            .and_then(|out| out.first_chunk_mut())
        {
            *eight = self.pending.to_le_bytes();
        }
        self.at += (self.count >> 3) as usize;
        self.pending >>= self.count & 56;
        self.count &= 7;
    }

    #[cold]
    #[inline(never)]
    fn put_one(&mut self, symbol: u8, difference: u64) {
        let width = width(symbol);
        self.put(difference & ((1 << width) - 1), width);
    }
}
