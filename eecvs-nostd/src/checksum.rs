//! The checksums of frames and packets.
//!
//! CRC-16 (IBM-3740) of headers and packets is the crc crate's. CRC-32 (ISO-HDLC, as in Ethernet and
//! zip) of frames is the crate's on a 64-bit host; its fastest way takes 7 instructions a byte on a
//! Cortex-M4, where four tables of its making, a word at a time, take 3.4. Without tables, words are
//! added to those a little later, by which they become zeros that need no more work: 2.2.

#[cfg(any(test, all(not(target_pointer_width = "64"), not(eecvs_dsp))))]
use core::mem;

use crc::{CRC_16_IBM_3740, CRC_32_ISO_HDLC, Crc, Table};

/// CRC-16 of a frame's header and of a packet.
pub(crate) static CRC_16: Crc<u16, Table<1>> = Crc::<u16, Table<1>>::new(&CRC_16_IBM_3740);

#[cfg(target_pointer_width = "64")]
static CRC_32: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

/// CRC-32 of `bytes`.
#[cfg(target_pointer_width = "64")]
pub(crate) fn crc_32(bytes: &[u8]) -> u32 {
    CRC_32.checksum(bytes)
}

/// CRC-32 of `bytes`.
#[cfg(not(target_pointer_width = "64"))]
pub(crate) fn crc_32(bytes: &[u8]) -> u32 {
    #[cfg(eecvs_dsp)]
    return folded(bytes, arm::fold);
    #[cfg(not(eecvs_dsp))]
    return folded(bytes, fold);
}

/// `TABLES[i][b]` is what a byte b does to the checksum, i bytes later.
#[cfg(any(test, not(target_pointer_width = "64")))]
static TABLES: [[u32; 256]; 4] = {
    const CRC: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);
    let tables = CRC.table();
    [tables[0], tables[1], tables[2], tables[3]]
};

/// 1 + x^145 + x^183 + x^211 + x^300 is a multiple of the checksum's polynomial, back to front: a
/// bit may be taken away where those so many places after it are changed. In whole words and bits.
///
/// No other multiple of so few terms is below x^384, and none of fewer below x^3000.
#[cfg(any(test, not(target_pointer_width = "64")))]
const LATER: [(usize, u32); 4] = [(4, 17), (5, 23), (6, 19), (9, 12)];

/// Words after a word that [`LATER`] changes.
#[cfg(any(test, not(target_pointer_width = "64")))]
const REACH: usize = 10;

/// Words that are taken away at once: as many as a Cortex-M4 has registers for.
#[cfg(any(test, not(target_pointer_width = "64")))]
const BLOCK: usize = 12;

/// Blocks from which on that pays.
#[cfg(any(test, not(target_pointer_width = "64")))]
const BLOCKS_MIN: usize = 8;

#[cfg(any(test, not(target_pointer_width = "64")))]
type Block = [[u8; 4]; BLOCK];

/// CRC-32 of `bytes`, of which `fold` takes away blocks.
#[cfg(any(test, not(target_pointer_width = "64")))]
#[inline(always)]
fn folded(bytes: &[u8], fold: impl FnOnce(u32, &[Block]) -> [u32; BLOCK]) -> u32 {
    // Several words are loaded at once from a multiple of four alone.
    let (before, bytes) = bytes.split_at(bytes.as_ptr().align_offset(4).min(bytes.len()));
    let crc = by_bytes(u32::MAX, before);
    let (words, rest) = bytes.as_chunks::<4>();
    let (blocks, _) = words.as_chunks::<BLOCK>();
    // What is taken away last changes the words after it.
    let (blocks, _) = blocks.split_at(blocks.len().saturating_sub(1));
    if blocks.len() < BLOCKS_MIN {
        return !by_bytes(by_words(crc, words), rest);
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
    !by_bytes(by_words(crc, after), rest)
}

/// What those words that were taken away, by their places in their blocks, change the one at `i` by.
#[cfg(any(test, not(target_pointer_width = "64")))]
#[inline(always)]
fn later(taken: &[u32; BLOCK], i: usize) -> u32 {
    let [a, b, c, d] = LATER;
    let whole = |(words, bits): (usize, u32)| taken[(i + BLOCK - words) % BLOCK] << bits;
    let beyond =
        |(words, bits): (usize, u32)| taken[(i + BLOCK - words - 1) % BLOCK] >> (32 - bits);
    // In this order, in which a compiler sees no rotations.
    (whole(a) ^ whole(b) ^ whole(c) ^ whole(d)) ^ (beyond(a) ^ beyond(b) ^ beyond(c) ^ beyond(d))
}

/// Takes `blocks` away, of which the checksum before them is `crc`; returns what the words of the
/// last one were when they were taken away.
#[cfg(any(test, all(not(target_pointer_width = "64"), not(eecvs_dsp))))]
#[inline(never)]
fn fold(crc: u32, blocks: &[Block]) -> [u32; BLOCK] {
    let mut taken = [0; BLOCK];
    let mut first = crc;
    for block in blocks {
        // One by one, so that each is in a register of its own.
        macro_rules! take {
            ($($i:literal)*) => {$(
                taken[$i] = u32::from_le_bytes(block[$i]) ^ later(&taken, $i);
                if $i == 0 {
                    taken[$i] ^= mem::take(&mut first);
                }
            )*};
        }
        take!(0 1 2 3 4 5 6 7 8 9 10 11);
    }
    taken
}

#[cfg(any(test, not(target_pointer_width = "64")))]
#[inline(always)]
fn by_words(mut crc: u32, words: &[[u8; 4]]) -> u32 {
    let [last, third, second, first] = &TABLES;
    for bytes in words {
        let [a, b, c, d] = (crc ^ u32::from_le_bytes(*bytes)).to_le_bytes();
        crc = first[usize::from(a)]
            ^ second[usize::from(b)]
            ^ third[usize::from(c)]
            ^ last[usize::from(d)];
    }
    crc
}

#[cfg(any(test, not(target_pointer_width = "64")))]
#[inline(never)]
fn by_bytes(crc: u32, bytes: &[u8]) -> u32 {
    bytes.iter().fold(crc, |crc, byte| {
        (crc >> 8) ^ TABLES[0][usize::from(crc as u8 ^ byte)]
    })
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
        if range.start.addr() % 4 == 0 && !blocks.is_empty() {
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

    fn without_tables(bytes: &[u8]) -> u32 {
        folded(bytes, fold)
    }

    #[test]
    fn check_value_of_the_catalogue() {
        assert_eq!(crc_32(b"123456789"), 0xCBF4_3926);
        assert_eq!(without_tables(b"123456789"), 0xCBF4_3926);
    }

    proptest! {
        #[test]
        fn words_are_the_crates(
            bytes in proptest::collection::vec(any::<u8>(), 0..1000),
            from in 0..8_usize,
        ) {
            let bytes = bytes.get(from..).unwrap_or_default();
            prop_assert_eq!(without_tables(bytes), CRC_32.checksum(bytes));
        }
    }
}
