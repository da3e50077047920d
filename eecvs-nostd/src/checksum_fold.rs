//! CRC-32 without tables, for a Cortex-M4: words are added to those a little later, by which they become
//! zeros, which leave the checksum as it is. The few at the end that are no zeros go through the tables.

#[cfg(test)]
use core::mem;

use crate::checksum::{by_bytes, by_words};

/// 1 + x^145 + x^183 + x^211 + x^300 is a multiple of the checksum's polynomial, back to front: a
/// bit may be taken away where those so many places after it are changed. In whole words and bits.
///
/// No other multiple of so few terms is below x^384.
const LATER: [(usize, u32); 4] = [(4, 17), (5, 23), (6, 19), (9, 12)];

/// Words after a word that [`LATER`] changes.
const REACH: usize = 10;

/// Words that are taken away at once: as many as a Cortex-M4 has registers for.
const BLOCK: usize = 12;

/// Blocks from which on that pays.
const BLOCKS_MIN: usize = 8;

type Block = [[u8; 4]; BLOCK];

/// The checksum `crc`, not turned over at its end, and `bytes` further.
#[cfg(eecvs_dsp)]
pub(crate) fn crc_32(crc: u32, bytes: &[u8]) -> u32 {
    folded(crc, bytes, arm::fold)
}

/// The same, with `fold` to take blocks away.
#[inline(always)]
fn folded(crc: u32, bytes: &[u8], fold: impl FnOnce(u32, &[Block]) -> [u32; BLOCK]) -> u32 {
    // Several words are loaded at once from a multiple of four alone.
    let (before, bytes) = bytes.split_at(bytes.as_ptr().align_offset(4).min(bytes.len()));
    let crc = by_bytes(crc, before);
    let (words, rest) = bytes.as_chunks::<4>();
    let (blocks, _) = words.as_chunks::<BLOCK>();
    // What is taken away last changes the words after it.
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

/// What those words that were taken away, by their places in their blocks, change the one at `i` by.
#[inline(always)]
fn later(taken: &[u32; BLOCK], i: usize) -> u32 {
    LATER.iter().fold(0, |change, (words, bits)| {
        let whole = taken[(i + BLOCK - words) % BLOCK] << bits;
        change ^ whole ^ (taken[(i + BLOCK - words - 1) % BLOCK] >> (32 - bits))
    })
}

/// Takes `blocks` away, of which the checksum before them is `crc`; returns what the words of the
/// last one were when they were taken away.
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

/// The same bits with Thumb-2 instructions, of which a bit's change is one; golden frames have been
/// checked with both.
#[cfg(eecvs_dsp)]
#[allow(unsafe_code)]
mod arm {
    use core::arch::naked_asm;

    use super::{BLOCK, Block, LATER};

    pub fn fold(crc: u32, blocks: &[Block]) -> [u32; BLOCK] {
        let mut taken = [0; BLOCK];
        let range = blocks.as_ptr_range();
        if range.start.addr().is_multiple_of(4) && !blocks.is_empty() {
            // SAFETY: the blocks from `start` to `end` are there, one at the least, and begin at a
            // multiple of four. `eecvs_dsp` is set for cores that have the instructions.
            unsafe { take_away(crc, range.start, range.end, &mut taken) };
        }
        taken
    }

    /// Changes the word in `$word` by those that were four to ten words before it.
    macro_rules! change {
        ($word:literal, $four:literal, $five:literal, $six:literal, $seven:literal, $nine:literal,
            $ten:literal) => {
            concat!(
                "eor ",
                $word,
                ", ",
                $word,
                ", ",
                $four,
                ", lsl #{b0}\n",
                "eor ",
                $word,
                ", ",
                $word,
                ", ",
                $five,
                ", lsr #32 - {b0}\n",
                "eor ",
                $word,
                ", ",
                $word,
                ", ",
                $five,
                ", lsl #{b1}\n",
                "eor ",
                $word,
                ", ",
                $word,
                ", ",
                $six,
                ", lsr #32 - {b1}\n",
                "eor ",
                $word,
                ", ",
                $word,
                ", ",
                $six,
                ", lsl #{b2}\n",
                "eor ",
                $word,
                ", ",
                $word,
                ", ",
                $seven,
                ", lsr #32 - {b2}\n",
                "eor ",
                $word,
                ", ",
                $word,
                ", ",
                $nine,
                ", lsl #{b3}\n",
                "eor ",
                $word,
                ", ",
                $word,
                ", ",
                $ten,
                ", lsr #32 - {b3}\n",
            )
        };
    }

    // What the registers of `change` take for granted.
    const _: () = assert!(
        BLOCK == 12 && LATER[0].0 == 4 && LATER[1].0 == 5 && LATER[2].0 == 6 && LATER[3].0 == 9
    );

    /// [`super::fold`] of the blocks from `at` to `end`, one at the least, into `taken`, which is 0.
    ///
    /// Restores every register that a callee must.
    ///
    /// # Safety
    /// The blocks can be read, `at` is a multiple of four, and `taken` can be read and written.
    #[unsafe(naked)]
    unsafe extern "C" fn take_away(
        crc: u32,
        at: *const Block,
        end: *const Block,
        taken: &mut [u32; BLOCK],
    ) {
        naked_asm!(
            // r1: at; r2 to r12 and lr: words; at sp: end, taken.
            "push {{r2-r11, lr}}",
            "mov r2, r3",
            "ldm r2, {{r2-r12, lr}}",
            "ldrd r2, r3, [r1], #8",
            "eor r2, r2, r0",
            "b 3f",
            "2:",
            "ldrd r2, r3, [r1], #8",
            "3:",
            change!("r2", "r10", "r9", "r8", "r7", "r5", "r4"),
            change!("r3", "r11", "r10", "r9", "r8", "r6", "r5"),
            "ldrd r4, r5, [r1], #8",
            change!("r4", "r12", "r11", "r10", "r9", "r7", "r6"),
            change!("r5", "lr", "r12", "r11", "r10", "r8", "r7"),
            "ldrd r6, r7, [r1], #8",
            change!("r6", "r2", "lr", "r12", "r11", "r9", "r8"),
            change!("r7", "r3", "r2", "lr", "r12", "r10", "r9"),
            "ldrd r8, r9, [r1], #8",
            change!("r8", "r4", "r3", "r2", "lr", "r11", "r10"),
            change!("r9", "r5", "r4", "r3", "r2", "r12", "r11"),
            "ldrd r10, r11, [r1], #8",
            change!("r10", "r6", "r5", "r4", "r3", "lr", "r12"),
            change!("r11", "r7", "r6", "r5", "r4", "r2", "lr"),
            "ldrd r12, lr, [r1], #8",
            change!("r12", "r8", "r7", "r6", "r5", "r3", "r2"),
            change!("lr", "r9", "r8", "r7", "r6", "r4", "r3"),
            "ldr r0, [sp]",
            "cmp r1, r0",
            "bne 2b",
            "ldr r0, [sp, #4]",
            "stm r0, {{r2-r12, lr}}",
            "pop {{r2-r11, pc}}",
            b0 = const LATER[0].1,
            b1 = const LATER[1].1,
            b2 = const LATER[2].1,
            b3 = const LATER[3].1,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// At any place of a word, with any number of words and bytes at the end.
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
