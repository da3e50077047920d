//! CRC-32 without tables, for a Cortex-M4. Words are added to words a little later and so become zeros, which leave
//! the checksum as it is. The few words at the end that are not zero go through the tables.

#[cfg(test)]
use core::mem;

use crate::checksum::{by_bytes, by_words};

/// 1 + x^145 + x^183 + x^211 + x^300 is a multiple of the checksum's polynomial, in reversed bit order: a bit may
/// be cleared if the bits this many places after it are flipped. Given in whole words and bits.
///
/// No other multiple of so few terms is below x^384.
pub(super) const LATER: [(usize, u32); 4] = [(4, 17), (5, 23), (6, 19), (9, 12)];

/// Number of words after a word that [`LATER`] changes.
const REACH: usize = 10;

/// Words that are cleared at once: as many as a Cortex-M4 has registers for.
pub(super) const BLOCK: usize = 12;

/// Fewest blocks for which that pays.
const BLOCKS_MIN: usize = 8;

pub(super) type Block = [[u8; 4]; BLOCK];

/// Continues the checksum `crc`, without its final inversion, over `bytes`; `fold` clears blocks.
#[inline(always)]
pub(super) fn folded(
    crc: u32,
    bytes: &[u8],
    fold: impl FnOnce(u32, &[Block]) -> [u32; BLOCK],
) -> u32 {
    // Several words at once can only be loaded from a multiple of four.
    let (before, bytes) = bytes.split_at(bytes.as_ptr().align_offset(4).min(bytes.len()));
    let crc = by_bytes(crc, before);
    let (words, rest) = bytes.as_chunks::<4>();
    let (blocks, _) = words.as_chunks::<BLOCK>();
    // Clearing the last words changes the words after them.
    let (blocks, _) = blocks.split_at(blocks.len().saturating_sub(1));
    if blocks.len() < BLOCKS_MIN {
        return by_bytes(by_words(crc, words), rest);
    }
    let mut taken = fold(crc, blocks);
    let after = words.get(BLOCK * blocks.len()..).unwrap_or_default();
    let (changed, after) = after.split_at(REACH.min(after.len()));
    let mut crc = 0;
    for (i, bytes) in changed.iter().enumerate() {
        let word = u32::from_le_bytes(*bytes) ^ later(&taken, i);
        taken[i % BLOCK] = 0;
        crc = by_words(crc, &[word.to_le_bytes()]);
    }
    by_bytes(by_words(crc, after), rest)
}

/// Returns what the cleared words, indexed by their places in their blocks, change the word at `i` by.
#[inline(always)]
fn later(taken: &[u32; BLOCK], i: usize) -> u32 {
    LATER.iter().fold(0, |change, (words, bits)| {
        let whole = taken[(i + BLOCK - words) % BLOCK] << bits;
        change ^ whole ^ (taken[(i + BLOCK - words - 1) % BLOCK] >> (32 - bits))
    })
}

/// Clears `blocks`; the checksum before them is `crc`. Returns the words of the last block as they were when they
/// were cleared.
#[cfg(test)]
fn fold(crc: u32, blocks: &[Block]) -> [u32; BLOCK] {
    let mut taken = [0; BLOCK];
    let mut first = crc;
    for block in blocks {
        for (i, bytes) in block.iter().enumerate() {
            taken[i] = u32::from_le_bytes(*bytes) ^ mem::take(&mut first) ^ later(&taken, i);
        }
    }
    taken
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// From any place within a word, with any number of words and bytes at the end.
        #[test]
        fn blocks_are_bytes(
            bytes in proptest::collection::vec(any::<u8>(), 0..1000),
            crc in any::<u32>(),
            from in 0..8_usize,
        ) {
            let bytes = bytes.get(from..).unwrap_or_default();
            prop_assert_eq!(folded(crc, bytes, fold), by_bytes(crc, bytes));
        }
    }
}
