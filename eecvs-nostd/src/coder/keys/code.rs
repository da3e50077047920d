//! The prefix codes of symbols, and their description in a slice's header.
//!
//! A symbol is `class << 1 | flip`. Codes are canonical, at most [`LONGEST`] bits, complete, highest bit first.

use crate::coder::keys::bits::{Reader, Writer};

/// Symbols of a context.
pub const SYMBOLS: usize = 128;
/// Most contexts. A symbol with its context is `context << 7 | symbol`.
pub const CONTEXTS: usize = 2;
/// Length of the longest code.
pub const LONGEST: u32 = 10;
/// Continuations of a context: as many as the longest code has.
const ENTRIES: usize = 1 << LONGEST;
/// Length that is expected of a first symbol.
const FIRST: u8 = 5;

/// A code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Code {
    /// Lengths; 0 for symbols without a code.
    pub lengths: [u8; SYMBOLS],
    /// Number of codes of each length; what stands at 0 is of no use.
    numbers: [u8; 16],
    /// First symbol, and the one after the last.
    range: (u8, u8),
}

impl Code {
    /// No code.
    pub const NONE: Self = Self {
        lengths: [0; SYMBOLS],
        numbers: [0; 16],
        range: (0, 0),
    };

    /// Returns the code of these symbols, which follow each other, with their lengths; the first one's flip is 0, and the
    /// last one's is 1.
    pub fn of(symbols: impl Iterator<Item = (usize, u8)>) -> Self {
        let mut code = Self::NONE;
        let (mut first, mut end) = (None, 0);
        for (symbol, length) in symbols {
            code.set(symbol, length);
            first = first.or(Some(symbol as u8));
            end = symbol as u8 + 1;
        }
        code.range = (first.unwrap_or(0), end);
        code
    }

    /// Puts a symbol in.
    #[inline(always)]
    fn set(&mut self, symbol: usize, length: u8) {
        self.lengths[symbol % SYMBOLS] = length;
        self.numbers[usize::from(length & 15)] += 1;
    }

    /// Returns whether the codes fill the table of all continuations.
    fn is_complete(&self) -> bool {
        let sum = |length: u32| usize::from(self.numbers[length as usize]) << (LONGEST - length);
        (1..=LONGEST).map(sum).sum::<usize>() == ENTRIES
    }

    /// Symbols with their lengths.
    #[inline(always)]
    fn symbols(&self) -> impl Iterator<Item = (usize, u8)> {
        let (first, end) = (usize::from(self.range.0), usize::from(self.range.1));
        self.lengths
            .iter()
            .copied()
            .enumerate()
            .take(end)
            .skip(first)
    }
}

/// Returns a code for symbols of these counts, of which one at least is not 0.
pub fn code(counts: &[u16]) -> Code {
    let mut code = Code::NONE;
    // Counts above symbols, ascending.
    let mut sorted = [0_u32; SYMBOLS];
    let mut n = 0;
    for (symbol, &count) in counts.iter().enumerate().take(SYMBOLS) {
        if count > 0 {
            sorted[n] = u32::from(count) << 7 | symbol as u32;
            n += 1;
        }
    }
    sorted[..n].sort_unstable();
    if n < 2 {
        // A code of one symbol gets a second one, so that all codes are complete.
        let symbol = (sorted[0] & 127) as usize;
        code.set(symbol, 1);
        code.set(symbol ^ 1, 1);
        code.range = (symbol as u8 & !1, symbol as u8 | 1);
        code.range.1 += 1;
        return code;
    }
    // Moffat and Katajainen: weights, then parents, then depths, in one array.
    let mut a = [0_u32; SYMBOLS];
    for (a, item) in a.iter_mut().zip(&sorted[..n]) {
        *a = item >> 7;
    }
    let (mut leaf, mut root) = (0, 0);
    for next in 0..n - 1 {
        let mut take = |a: &mut [u32; SYMBOLS], first: u32| {
            let mut value = first;
            if leaf >= n || (root < next && a[root] < a[leaf]) {
                value += a[root];
                a[root] = next as u32;
                root += 1;
            } else {
                value += a[leaf];
                leaf += 1;
            }
            value
        };
        let one = take(&mut a, 0);
        a[next] = take(&mut a, one);
    }
    a[n - 2] = 0;
    for next in (0..n - 2).rev() {
        a[next] = a[a[next] as usize] + 1;
    }
    let (mut available, mut used, mut depth) = (1_i32, 0, 0_u32);
    let (mut root, mut next) = (n as i32 - 2, n as i32 - 1);
    while available > 0 {
        while root >= 0 && a[root as usize] == depth {
            used += 1;
            root -= 1;
        }
        while available > used {
            a[next as usize] = depth;
            next -= 1;
            available -= 1;
        }
        available = 2 * used;
        depth += 1;
        used = 0;
    }
    // Longer codes than allowed are cut, then the rest is made to fit: rare symbols get longer, frequent ones shorter.
    let mut sum = 0;
    for a in &mut a[..n] {
        *a = (*a).min(LONGEST);
        sum += ENTRIES >> *a;
    }
    for a in &mut a[..n] {
        while sum > ENTRIES && *a < LONGEST {
            *a += 1;
            sum -= ENTRIES >> *a;
        }
    }
    while sum < ENTRIES {
        for a in a[..n].iter_mut().rev() {
            if sum + (ENTRIES >> *a) <= ENTRIES {
                sum += ENTRIES >> *a;
                *a -= 1;
            }
        }
    }
    let (mut first, mut last) = (127, 0);
    for (item, a) in sorted[..n].iter().zip(a) {
        let symbol = (item & 127) as u8;
        code.set(usize::from(symbol), a as u8);
        (first, last) = (symbol.min(first), symbol.max(last));
    }
    code.range = (first & !1, (last | 1) + 1);
    code
}

/// Codes by symbol with context: the code above its length in the lowest byte.
pub type Codes = [u32; SYMBOLS * CONTEXTS];

/// Returns the codes of the first `contexts` contexts.
pub fn codes(all: &[Code; CONTEXTS], contexts: usize) -> Codes {
    let mut codes = [0; SYMBOLS * CONTEXTS];
    for (codes, code) in codes.chunks_exact_mut(SYMBOLS).zip(all).take(contexts) {
        // Next code of each length.
        let mut next = [0_u32; 16];
        for length in 2..=LONGEST as usize {
            next[length] = (next[length - 1] + u32::from(code.numbers[length - 1])) << 1;
        }
        for (symbol, length) in code.symbols() {
            let next = &mut next[usize::from(length & 15)];
            codes[symbol] = if length > 0 {
                *next << 8 | u32::from(length)
            } else {
                0
            };
            *next += 1;
        }
    }
    codes
}

/// Continuations of each context: symbol with context in the lowest byte, then the code's length, then the first
/// continuation of the next context.
pub type Table = [u32; ENTRIES * CONTEXTS];
/// A table to be filled.
#[cfg(test)]
pub const EMPTY: Table = [0; ENTRIES * CONTEXTS];

/// Fills a table; `split` is the first class after which the second context holds.
pub fn fill(table: &mut Table, codes: &[Code; CONTEXTS], contexts: usize, split: u8) {
    for (context, (table, code)) in table
        .chunks_exact_mut(ENTRIES)
        .zip(codes)
        .take(contexts)
        .enumerate()
    {
        // Symbols by length, those without a code last.
        let mut ordered = [0_u8; 256];
        let mut next = [0_u8; 16];
        for length in 2..=LONGEST as usize + 1 {
            next[length] = next[length - 1] + code.numbers[length - 1];
        }
        let all = next[LONGEST as usize + 1];
        next[0] = all;
        for (symbol, length) in code.symbols() {
            let next = &mut next[usize::from(length & 15)];
            ordered[usize::from(*next)] = symbol as u8;
            *next += 1;
        }
        let mut rest = &mut table[..];
        for &symbol in &ordered[..usize::from(all)] {
            let length = code.lengths[usize::from(symbol % 128)];
            let next = if contexts > 1 && symbol >> 1 >= split {
                ENTRIES
            } else {
                0
            };
            let entry = (next as u32) << 16
                | u32::from(length) << 8
                | (context as u32) << 7
                | u32::from(symbol);
            let size = ENTRIES >> length;
            // What is too much for the symbol is the next one's.
            if let Some(eight) = rest.first_chunk_mut::<8>() {
                *eight = [entry; 8];
            }
            let Some((own, others)) = core::mem::take(&mut rest).split_at_mut_checked(size) else {
                return;
            };
            if size > 8 || others.len() < 8 {
                own.fill(entry);
            }
            rest = others;
        }
    }
}

/// Writes the description of a code.
pub fn describe(code: &Code, writer: &mut Writer<'_>) {
    writer.bits(u32::from(code.range.0) / 2, 6);
    writer.bits(u32::from(code.range.1) / 2 - 1, 6);
    let mut expected = [FIRST; 2];
    for (at, length) in code.symbols() {
        let expected = &mut expected[at % 2];
        // As expected 00, absent 10, one less or more 010 and 011, any 11 and four bits; the first bit is the lowest.
        if length == *expected {
            writer.bits(0b00, 2);
        } else if length == 0 {
            writer.bits(0b01, 2);
        } else if length.abs_diff(*expected) == 1 {
            writer.bits(if length > *expected { 0b110 } else { 0b010 }, 3);
        } else {
            writer.bits(0b11 | u32::from(length) << 2, 6);
        }
        if length > 0 {
            *expected = length;
        }
    }
}

/// Reads a description of a code of classes up to `highest`; `None` if it is not one.
pub fn read(reader: &mut Reader<'_>, highest: u32) -> Option<Code> {
    let (low, high) = (reader.bits(6)?, reader.bits(6)?);
    if high > highest {
        return None;
    }
    let mut code = Code::NONE;
    let mut expected = [FIRST; 2];
    for at in 2 * low as usize..2 * high as usize + 2 {
        let expected = &mut expected[at % 2];
        let bits = reader.peek_six();
        let (count, length) = match bits & 3 {
            0b00 => (2, *expected),
            0b01 => (2, 0),
            0b10 => (3, (*expected + (bits >> 1 & 2) as u8).wrapping_sub(1)),
            _ => (6, (bits >> 2) as u8),
        };
        reader.skip(count)?;
        if u32::from(length) > LONGEST {
            return None;
        }
        code.set(at, length);
        *expected = if length > 0 { length } else { *expected };
    }
    code.range = (2 * low as u8, (2 * high as u8 + 2).max(2 * low as u8));
    code.is_complete().then_some(code)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip(counts: &[u16; SYMBOLS]) {
        let code = code(counts);
        assert!(code.is_complete());
        assert!(
            counts
                .iter()
                .zip(&code.lengths)
                .all(|(&count, &length)| count == 0 || length > 0)
        );
        let mut out = [0; 200];
        let mut writer = Writer::new(&mut out);
        describe(&code, &mut writer);
        writer.align();
        let bytes = writer.bytes();
        let mut reader = Reader::new(&out, 0);
        let back = read(&mut reader, 63).unwrap();
        assert_eq!((back.lengths, back.range), (code.lengths, code.range));
        assert_eq!(back.numbers[1..], code.numbers[1..]);
        reader.align().unwrap();
        assert_eq!(reader.at(), bytes);
        // The table gives each symbol back, after any bits that follow its code.
        let both = [code, code];
        let codes = codes(&both, 2);
        let mut table = EMPTY;
        fill(&mut table, &both, 2, 9);
        for context in 0..CONTEXTS {
            for symbol in 0..SYMBOLS {
                let code = codes[context * SYMBOLS + symbol];
                let length = code & 255;
                if length == 0 {
                    continue;
                }
                for rest in [0, (1 << (LONGEST - length)) - 1] {
                    let index = (code >> 8 << (LONGEST - length) | rest) as usize;
                    let next = if symbol >> 1 >= 9 { ENTRIES as u32 } else { 0 };
                    let entry = next << 16 | length << 8 | (context << 7 | symbol) as u32;
                    assert_eq!(table[context * ENTRIES + index], entry);
                }
            }
        }
    }

    #[test]
    fn codes_come_back() {
        let mut counts = [0; SYMBOLS];
        counts[7] = 1;
        round_trip(&counts);
        counts[6] = 16384;
        round_trip(&counts);
        // Fibonacci numbers make the deepest tree.
        let (mut a, mut b) = (1, 1);
        for count in counts.iter_mut().step_by(5).take(20) {
            *count = a;
            (a, b) = (b, a + b);
        }
        round_trip(&counts);
        round_trip(&[1; SYMBOLS]);
        let mut state = 1_u32;
        for _ in 0..500 {
            for count in &mut counts {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *count = if state >> 30 == 0 {
                    0
                } else {
                    (state >> 16 >> (state >> 28)) as u16 / 8
                };
            }
            round_trip(&counts);
        }
    }

    #[test]
    fn equal_counts_get_equal_lengths_and_frequent_symbols_shorter_ones() {
        let mut counts = [0; SYMBOLS];
        counts[..4].fill(9);
        assert_eq!(code(&counts).lengths[..5], [2, 2, 2, 2, 0]);
        counts[0] = 100;
        assert_eq!(code(&counts).lengths[..4], [1, 3, 3, 2]);
    }

    #[test]
    fn codes_that_are_not_complete_are_refused() {
        let mut wrong = Code {
            range: (0, 2),
            ..Code::NONE
        };
        wrong.set(0, 1);
        wrong.set(1, 2);
        let mut out = [0; 64];
        let mut writer = Writer::new(&mut out);
        describe(&wrong, &mut writer);
        writer.align();
        assert_eq!(read(&mut Reader::new(&out, 0), 63), None);
    }
}
