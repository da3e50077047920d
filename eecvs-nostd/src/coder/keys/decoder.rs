//! Reads a window's events into order of time.

use crate::coder::keys::code::{LONGEST, Table, fill};
use crate::coder::keys::head::{Head, Model, SECTIONS, section_start, sections};
use crate::coder::keys::kernels::{AHEAD, Clock, Kernels, Span, Symbols, TIME, Words};
use crate::coder::keys::portable::{Portable, width};
use crate::coder::keys::sort::{rank, scatter};
use crate::coder::keys::{SLICE_EVENTS, Simd, Window, slice_start, slices};
use event_types::Event;
use zerocopy::FromZeros;

/// The payload does not hold as many events, in their window, or holds more than these.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Damaged;

/// Most buckets of time.
const BUCKETS: usize = 1 << 16;
/// Buckets an event, at most.
const BUCKETS_PER_EVENT: usize = 4;
/// Most bits of a mantissa: keys are below 2^54.
const MANTISSA_BITS_MAX: usize = 53;
/// Mantissas of a slice at their longest, and a word.
const MANTISSAS: usize = SLICE_EVENTS * MANTISSA_BITS_MAX / 8 + 8;

/// Memory of a decoder.
#[derive(Debug, FromZeros)]
pub struct DecoderMemory {
    symbols: Symbols,
    words: Words,
    other: Words,
    ranks: [u16; SLICE_EVENTS],
    counts: [u16; BUCKETS],
    table: Table,
    /// The payload's last mantissas, with room behind.
    mantissas: [u8; MANTISSAS],
}

/// Reads all events of a window, as many as `events` has room for, from a payload with no others, into order of time;
/// those of equal time in one slice come in order of place. Never panics, whatever the payload, and takes time in
/// proportion to the events.
///
/// # Errors
/// [`Damaged`]. What `events` then holds means nothing.
pub fn decode(
    simd: Simd,
    window: &Window,
    payload: &[u8],
    memory: &mut DecoderMemory,
    events: &mut [Event],
) -> Result<(), Damaged> {
    simd.decode(window, payload, memory, events).ok_or(Damaged)
}

#[inline(always)]
pub fn decode_with<K: Kernels>(
    kernels: K,
    window: &Window,
    payload: &[u8],
    memory: &mut DecoderMemory,
    events: &mut [Event],
) -> Option<()> {
    let n = events.len();
    let (mut at, mut last, mut model) = (0, None, Model::NONE);
    for slice in 0..slices(n) {
        let events = &mut events[slice_start(n, slice)..slice_start(n, slice + 1)];
        let (head, next) = Head::read(payload, at, events.len(), window, last, &mut model)?;
        last = Some(head.first + head.units - 1);
        at = decode_slice(
            kernels,
            window,
            (payload, next),
            (&head, &model),
            memory,
            events,
        )?;
    }
    (at == payload.len()).then_some(())
}

/// Reads one slice; returns the place after it.
#[inline(always)]
fn decode_slice<K: Kernels>(
    kernels: K,
    window: &Window,
    (payload, mut at): (&[u8], usize),
    (head, model): (&Head, &Model),
    memory: &mut DecoderMemory,
    events: &mut [Event],
) -> Option<usize> {
    let n = events.len();
    fill(&mut memory.table, &model.codes, model.contexts, model.split);
    // Symbols.
    let mut sections: [&[u8]; SECTIONS] = [&[]; SECTIONS];
    for (section, size) in sections
        .iter_mut()
        .zip(head.sections)
        .take(self::sections(n))
    {
        *section = payload.get(at..at + usize::from(size))?;
        at += usize::from(size);
    }
    let symbols = &mut memory.symbols[AHEAD..AHEAD + n];
    if self::sections(n) == SECTIONS {
        let (one, rest) = symbols.split_at_mut(section_start(n, 1));
        let (two, rest) = rest.split_at_mut(section_start(n, 2) - section_start(n, 1));
        let (three, four) = rest.split_at_mut(section_start(n, 3) - section_start(n, 2));
        read_four(sections, [one, two, three, four], &memory.table)?;
    } else {
        if model.is_preset {
            sections[0] = payload.get(at..)?;
        }
        let mut chain = Chain::new(sections[0]);
        chain.read(symbols, &memory.table);
        if model.is_preset {
            chain.bytes = chain.bytes.get(..chain.at.div_ceil(8))?;
            at += chain.bytes.len();
            // Its classes are not those of the span.
            let highest = Span::new(window, head.units).highest();
            if symbols
                .iter()
                .any(|symbol| u32::from(symbol >> 1) > highest)
            {
                return None;
            }
        }
        chain.finish()?;
    }
    // Mantissas.
    let bits: u32 = symbols.iter().map(|&symbol| width(symbol)).sum();
    let bytes = bits.div_ceil(8) as usize;
    let all = payload.get(at..)?;
    let own = all.get(..bytes)?;
    let spare = bits % 8;
    if spare > 0 && own[bytes - 1] >> spare != 0 {
        return None;
    }
    let mantissas = if all.len() >= bytes + 8 {
        &all[..bytes + 8]
    } else {
        // `bits` is at most 53 an event.
        let copy = memory.mantissas.get_mut(..bytes + 8)?;
        copy[..bytes].copy_from_slice(own);
        copy[bytes..].fill(0);
        copy
    };
    let span = Span::new(window, head.units);
    if !kernels.words(&memory.symbols, n, mantissas, span, &mut memory.words) {
        return None;
    }
    // Order of time: by buckets, then by insertion in each.
    let most = (n * BUCKETS_PER_EVENT).min(BUCKETS) as u32;
    let wide = u32::BITS - ((head.units - 1) / most).leading_zeros();
    let counts = &mut memory.counts;
    let buckets = (((head.units - 1) >> wide) as usize + 1)
        .next_multiple_of(16)
        .min(BUCKETS);
    counts[..buckets].fill(0);
    let shift = TIME + wide;
    let bucket = |word: u64| (word >> shift) as usize;
    rank(&memory.words[..n], &mut memory.ranks, counts, bucket);
    kernels.sums(&mut counts[..buckets]);
    scatter(
        &memory.words[..n],
        &memory.ranks,
        &mut memory.other,
        counts,
        bucket,
    );
    if wide > 0 && !kernels.insert(&mut memory.other[..n]) {
        sort_burst(memory, n);
    }
    let clock = match window.cells.width_us() {
        Some(unit_us) => Clock {
            start_us: window.start_us,
            first: head.first,
            unit_us,
            // A cell's middle may lie beyond the last time that a clock shows.
            last_us: u32::try_from(u64::MAX - window.start_us)
                .unwrap_or(u32::MAX)
                .min(window.duration_us - 1),
        },
        // The numbers of units, at first.
        None => Clock {
            start_us: 0,
            first: head.first,
            unit_us: 1,
            last_us: u32::MAX,
        },
    };
    kernels.events(&memory.other, window.sensor.width, clock, events);
    if window.cells.width_us().is_none() {
        for event in events {
            let offset_us = window.cells.offset_us(event.t_us as u32);
            event.t_us = window.start_us.saturating_add(u64::from(offset_us));
        }
    }
    Some(at + bytes)
}

/// Sorts words by time where many share a bucket, so that the work stays linear: by one byte after the other.
#[cold]
#[inline(never)]
fn sort_burst(memory: &mut DecoderMemory, n: usize) {
    let DecoderMemory {
        words,
        other,
        ranks,
        ..
    } = memory;
    for shift in [TIME, TIME + 8, TIME + 16, TIME + 24] {
        let mut counts = [0_u16; 256];
        let digit = |word: u64| (word >> shift) as usize;
        rank(&words[..n], ranks, &mut counts, digit);
        Portable.sums(&mut counts);
        scatter(&words[..n], ranks, other, &counts, digit);
        core::mem::swap(words, other);
    }
    core::mem::swap(words, other);
}

/// Symbols that a word holds.
const BATCH: usize = 5;
const _: () = assert!(BATCH as u32 * LONGEST + 7 < u64::BITS);

/// A section of symbols being read.
#[derive(Clone, Copy)]
struct Chain<'a> {
    bytes: &'a [u8],
    /// Bits read.
    at: usize,
    /// The last table entry, whose high half is the context's start.
    entry: u32,
}

impl<'a> Chain<'a> {
    const fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            at: 0,
            entry: 0,
        }
    }

    /// Returns the bits from here on, at least 56, those beyond the end 0, above a one.
    #[inline(always)]
    fn word(&self) -> u64 {
        let word = match self
            .bytes
            .get(self.at >> 3..)
            .and_then(|bytes| bytes.first_chunk())
        {
            Some(eight) => u64::from_be_bytes(*eight),
            None => self.last_word(),
        };
        word << (self.at & 7) | 1
    }

    #[cold]
    #[inline(never)]
    fn last_word(&self) -> u64 {
        let mut eight = [0; 8];
        if let Some(rest) = self.bytes.get(self.at >> 3..) {
            let n = rest.len().min(8);
            eight[..n].copy_from_slice(&rest[..n]);
        }
        u64::from_be_bytes(eight)
    }

    /// Decodes a symbol; the bits of `word` begin with its code.
    #[inline(always)]
    fn next(&mut self, word: &mut u64, symbol: &mut u8, table: &Table) {
        let index = (*word >> (u64::BITS - LONGEST)) as usize + (self.entry >> 16) as usize;
        self.entry = table[index % table.len()];
        *symbol = self.entry as u8;
        *word <<= self.entry >> 8 & 63;
    }

    /// Takes note of what was read of a word from [`Self::word`]: as many bits as zeros have come in.
    #[inline(always)]
    fn advance(&mut self, word: u64) {
        self.at += word.trailing_zeros() as usize;
    }

    /// Reads symbols.
    #[inline(always)]
    fn read(&mut self, symbols: &mut [u8], table: &Table) {
        let mut batches = symbols.chunks_exact_mut(BATCH);
        for batch in &mut batches {
            let mut word = self.word();
            for symbol in batch {
                self.next(&mut word, symbol, table);
            }
            self.advance(word);
        }
        let mut word = self.word();
        for symbol in batches.into_remainder() {
            self.next(&mut word, symbol, table);
        }
        self.advance(word);
    }

    /// Returns whether all bytes were read, and the rest of the last is zeros.
    #[inline(always)]
    fn finish(&self) -> Option<()> {
        let rest = self.bytes.len() * 8;
        if self.at > rest || rest - self.at > 7 || self.word() != 1 {
            return None;
        }
        Some(())
    }
}

/// Reads four sections side by side, as each symbol waits for the one before.
#[inline(always)]
fn read_four(
    sections: [&[u8]; SECTIONS],
    symbols: [&mut [u8]; SECTIONS],
    table: &Table,
) -> Option<()> {
    let mut chains = sections.map(Chain::new);
    let batches = symbols
        .iter()
        .map(|symbols| symbols.len())
        .min()
        .unwrap_or(0)
        / BATCH;
    let [a, b, c, d] = symbols;
    let (a, a_rest) = a.split_at_mut(batches * BATCH);
    let (b, b_rest) = b.split_at_mut(batches * BATCH);
    let (c, c_rest) = c.split_at_mut(batches * BATCH);
    let (d, d_rest) = d.split_at_mut(batches * BATCH);
    let ab = a
        .as_chunks_mut::<BATCH>()
        .0
        .iter_mut()
        .zip(b.as_chunks_mut::<BATCH>().0);
    let cd = c
        .as_chunks_mut::<BATCH>()
        .0
        .iter_mut()
        .zip(d.as_chunks_mut::<BATCH>().0);
    for ((a, b), (c, d)) in ab.zip(cd) {
        let mut words = [
            chains[0].word(),
            chains[1].word(),
            chains[2].word(),
            chains[3].word(),
        ];
        for i in 0..BATCH {
            chains[0].next(&mut words[0], &mut a[i], table);
            chains[1].next(&mut words[1], &mut b[i], table);
            chains[2].next(&mut words[2], &mut c[i], table);
            chains[3].next(&mut words[3], &mut d[i], table);
        }
        for (chain, word) in chains.iter_mut().zip(words) {
            chain.advance(word);
        }
    }
    for (chain, rest) in chains.iter_mut().zip([a_rest, b_rest, c_rest, d_rest]) {
        chain.read(rest, table);
        chain.finish()?;
    }
    Some(())
}
