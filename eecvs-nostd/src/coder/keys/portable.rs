//! The kernels in plain Rust.

use crate::coder::keys::SLICE_EVENTS;
use crate::coder::keys::kernels::{
    AHEAD, Clock, Kernels, ON, PLACE, Pairs, Span, Symbols, TIME, Words, moves,
};
use event_types::{Event, Polarity};

/// One word after the other.
#[derive(Debug, Clone, Copy)]
pub struct Portable;

/// Returns the number of mantissa bits of a symbol.
#[inline(always)]
pub const fn width(symbol: u8) -> u32 {
    ((symbol & 127) >> 1).saturating_sub(1) as u32
}

/// Keys between checks that they are in the span: 2^6 differences below 2^55 do not overflow.
pub const CHECKED: usize = 64;

impl Kernels for Portable {
    #[inline(always)]
    fn sums(self, counts: &mut [u16]) {
        let mut sum = 0_u16;
        for count in counts {
            let next = sum.wrapping_add(*count);
            *count = sum;
            sum = next;
        }
    }

    #[inline(always)]
    fn classes(
        self,
        words: &mut Words,
        count: usize,
        span: Span,
        symbols: &mut Symbols,
        pairs: &mut Pairs,
    ) -> bool {
        let count = count.min(SLICE_EVENTS);
        let symbols = &mut symbols[AHEAD..AHEAD + count];
        let is_fine = Self::classes_from(&mut words[..count], symbols, span, 0);
        Self::pairs_from(
            &words[..count],
            symbols,
            (&mut pairs.bits, &mut pairs.counts),
        );
        is_fine
    }

    #[inline(always)]
    fn words(
        self,
        symbols: &Symbols,
        count: usize,
        mantissas: &[u8],
        span: Span,
        words: &mut Words,
    ) -> bool {
        let count = count.min(SLICE_EVENTS);
        Self::words_from(
            &symbols[AHEAD..AHEAD + count],
            &mut words[..count],
            mantissas,
            span,
            (0, 0),
        )
    }

    #[inline(always)]
    fn insert(self, words: &mut [u64]) -> bool {
        let mut left = moves(words.len());
        (1..words.len()).all(|i| insert_one(words, i, &mut left))
    }

    #[inline(always)]
    fn events(self, words: &Words, width: u16, clock: Clock, events: &mut [Event]) {
        for (event, word) in events.iter_mut().zip(words) {
            *event = self::event(*word, width, clock);
        }
    }
}

impl Portable {
    /// Joins the mantissas of two symbols each.
    #[inline(always)]
    pub fn pairs_from(
        differences: &[u64],
        symbols: &[u8],
        (bits, counts): (&mut [u64], &mut [u8]),
    ) {
        let pairs = differences
            .as_chunks::<2>()
            .0
            .iter()
            .zip(symbols.as_chunks::<2>().0);
        for ((differences, symbols), (bits, count)) in pairs.zip(bits.iter_mut().zip(counts)) {
            let (one, two) = (width(symbols[0]), width(symbols[1]));
            let mantissa = |difference: u64, width: u32| difference & ((1 << width) - 1);
            *bits = mantissa(differences[0], one) | mantissa(differences[1], two) << one;
            *count = (one + two) as u8;
        }
    }

    /// [`Kernels::classes`] of the events after key `before`, which has its polarity in the highest bit.
    #[inline(always)]
    pub fn classes_from(
        words: &mut [u64],
        symbols: &mut [u8],
        span: Span,
        mut before: u64,
    ) -> bool {
        let mut wrong = 0;
        for (word, symbol) in words.iter_mut().zip(symbols) {
            let time = *word & u64::from(u32::MAX);
            let on = *word >> ON & 1;
            let key = (*word >> PLACE)
                .wrapping_mul(u64::from(span.units))
                .wrapping_add(time)
                | on << 63;
            let difference = key.wrapping_sub(before);
            before = key;
            wrong |= difference << 1;
            wrong |= u64::from(span.units - 1).wrapping_sub(time);
            *word = difference;
            let class = u64::BITS - (difference & (u64::MAX >> 1)).leading_zeros();
            *symbol = (class << 1) as u8 | (difference >> 63) as u8;
        }
        wrong >> 63 == 0
    }

    /// [`Kernels::words`] after a key, the next mantissa beginning at bit `at`.
    #[inline(always)]
    pub fn words_from(
        symbols: &[u8],
        words: &mut [u64],
        mantissas: &[u8],
        span: Span,
        (mut at, mut key): (usize, u64),
    ) -> bool {
        for (symbols, words) in symbols.chunks(CHECKED).zip(words.chunks_mut(CHECKED)) {
            for (&symbol, word) in symbols.iter().zip(words.iter_mut()) {
                let width = width(symbol);
                let bits = match mantissas.get(at >> 3..).and_then(|m| m.first_chunk()) {
                    Some(eight) => u64::from_le_bytes(*eight),
                    None => 0,
                };
                let mantissa = (bits >> (at & 7)) & ((1 << width) - 1);
                at += width as usize;
                let base = (1_u64 << (symbol >> 1 & 63)) >> 1;
                let flip = u64::from(symbol) << 63;
                key = key.wrapping_add((base + mantissa) ^ flip);
                *word = key;
            }
            if key & (u64::MAX >> 1) >= span.keys {
                return false;
            }
            for word in &mut words[..symbols.len()] {
                let key = *word & (u64::MAX >> 1);
                let place = key / u64::from(span.units);
                let time = key - place * u64::from(span.units);
                *word = time << TIME | place << 1 | *word >> 63;
            }
        }
        true
    }
}

/// Moves the word at `i` to its place among those before, which are in order of time. Returns false if no moves are
/// left.
#[inline(always)]
pub fn insert_one(words: &mut [u64], i: usize, left: &mut usize) -> bool {
    let word = words[i];
    let mut k = i;
    while k > 0 && words[k - 1] >> TIME > word >> TIME {
        words[k] = words[k - 1];
        k -= 1;
    }
    words[k] = word;
    match left.checked_sub(i - k) {
        Some(rest) => {
            *left = rest;
            true
        }
        None => false,
    }
}

/// Makes an event of a word.
#[inline(always)]
pub fn event(word: u64, width: u16, clock: Clock) -> Event {
    let unit = u64::from(clock.first) + (word >> TIME);
    let offset_us = unit * u64::from(clock.unit_us) + u64::from(clock.unit_us / 2);
    let place = word as u32 >> 1;
    let width = u32::from(width);
    let (y, x) = (place / width, place % width);
    Event {
        t_us: clock
            .start_us
            .wrapping_add(offset_us.min(u64::from(clock.last_us))),
        x: x as u16,
        y: y as u16,
        polarity: Polarity::from_bool(word & 1 == 1),
    }
}
