//! Checksums of frames and packets.
//!
//! CRC-16 (IBM-3740) of headers and packets is computed by the crc crate; CRC-32 (ISO-HDLC, as in Ethernet and zip)
//! of frames on a 64-bit host by crc32fast, which multiplies without carries in a program that gives it `std`. On a
//! Cortex-M4 the crc crate's fastest way takes 7 instructions per byte; four of its tables, used a word at a time, take
//! 3.6, and three tables for 8, 12 and 12 bits of a word take fewer, as the tables' addresses stay in registers, unlike
//! those of eight or sixteen tables. `fold` takes 2.2, and four tables for what it leaves.

#[cfg(eecvs_dsp)]
#[allow(unsafe_code)]
mod armv7em;
#[cfg(any(test, eecvs_dsp))]
mod fold;

#[cfg(any(test, not(target_pointer_width = "64")))]
use crc::CRC_32_ISO_HDLC;
use crc::{CRC_16_IBM_3740, Crc, Table};

/// CRC-16 of a frame's header and of a packet.
pub(crate) static CRC_16: Crc<u16, Way16> = Crc::<u16, Way16>::new(&CRC_16_IBM_3740);

/// How many of its tables are in the image: headers have few bytes.
type Way16 = Table<{ if cfg!(feature = "small") { 0 } else { 1 } }>;

/// Returns the CRC-32 of `bytes`.
#[cfg(target_pointer_width = "64")]
pub(crate) fn crc_32(bytes: &[u8]) -> u32 {
    crc32fast::hash(bytes)
}

/// Returns the CRC-32 of `bytes`.
#[cfg(all(not(target_pointer_width = "64"), not(eecvs_dsp), feature = "small"))]
pub(crate) fn crc_32(bytes: &[u8]) -> u32 {
    !by_bytes(u32::MAX, bytes)
}

/// Returns the CRC-32 of `bytes`.
#[cfg(all(
    not(target_pointer_width = "64"),
    not(eecvs_dsp),
    not(feature = "small")
))]
pub(crate) fn crc_32(bytes: &[u8]) -> u32 {
    let (words, rest) = bytes.as_chunks::<4>();
    // A Cortex-M0 has little flash.
    #[cfg(eecvs_thumb2)]
    let crc = by_parts(u32::MAX, words);
    #[cfg(not(eecvs_thumb2))]
    let crc = by_words(u32::MAX, words);
    !by_bytes(crc, rest)
}

/// Returns the CRC-32 of `bytes`.
#[cfg(eecvs_dsp)]
pub(crate) fn crc_32(bytes: &[u8]) -> u32 {
    !fold::folded(u32::MAX, bytes, armv7em::fold)
}

/// `TABLES[i][b]` is what a byte b contributes to the checksum, i bytes later.
#[cfg(any(test, not(target_pointer_width = "64")))]
static TABLES: [[u32; 256]; 4] = {
    const CRC: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);
    let tables = CRC.table();
    [tables[0], tables[1], tables[2], tables[3]]
};

/// What the low 8 bits of a word, the 12 above those, and its high 12 contribute to the checksum.
#[cfg(any(test, all(eecvs_thumb2, not(eecvs_dsp))))]
static PARTS: ([u32; 1 << 8], [u32; 1 << 12], [u32; 1 << 12]) = (part(0), part(8), part(20));

#[cfg(any(test, all(eecvs_thumb2, not(eecvs_dsp))))]
const fn part<const N: usize>(shift: u32) -> [u32; N] {
    let [last, third, second, first] = &TABLES;
    let mut table = [0; N];
    let mut i = 0;
    while i < N {
        let [a, b, c, d] = ((i as u32) << shift).to_le_bytes();
        table[i] = first[a as usize] ^ second[b as usize] ^ third[c as usize] ^ last[d as usize];
        i += 1;
    }
    table
}

/// Continues the checksum `crc`, without its final inversion, over `words`; by tables of 33 KiB instead of 4.
#[cfg(any(test, all(eecvs_thumb2, not(eecvs_dsp))))]
#[inline(always)]
fn by_parts(mut crc: u32, words: &[[u8; 4]]) -> u32 {
    let (low, middle, high) = &PARTS;
    let step = |crc, bytes: &[u8; 4]| {
        let word = crc ^ u32::from_le_bytes(*bytes);
        low[word as usize % low.len()]
            ^ middle[(word >> 8) as usize % middle.len()]
            ^ high[(word >> 20) as usize]
    };
    // Rows save what a loop costs per word.
    let (rows, rest) = words.as_chunks::<16>();
    for row in rows {
        crc = row.iter().fold(crc, step);
    }
    rest.iter().fold(crc, step)
}

/// Continues the checksum `crc`, without its final inversion, over `words`.
#[cfg(any(
    test,
    eecvs_dsp,
    not(any(target_pointer_width = "64", eecvs_thumb2, feature = "small"))
))]
#[inline(always)]
pub(crate) fn by_words(mut crc: u32, words: &[[u8; 4]]) -> u32 {
    // One table, then, which `fold` leaves little to.
    if cfg!(feature = "small") {
        return by_bytes(crc, words.as_flattened());
    }
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

/// As [`by_words`], over bytes.
#[cfg(any(test, not(target_pointer_width = "64")))]
#[inline(never)]
pub(crate) fn by_bytes(crc: u32, bytes: &[u8]) -> u32 {
    // Each table is of its own, as the linker keeps or drops one as a whole.
    if cfg!(feature = "small") {
        return by_halves(crc, bytes);
    }
    static TABLE: [u32; 256] = TABLES[0];
    bytes.iter().fold(crc, |crc, byte| {
        (crc >> 8) ^ TABLE[usize::from(crc as u8 ^ byte)]
    })
}

/// As [`by_bytes`], 4 bits at a time, by a table of 64 bytes.
#[cfg(any(test, not(target_pointer_width = "64")))]
#[inline(always)]
fn by_halves(crc: u32, bytes: &[u8]) -> u32 {
    static TABLE: [u32; 16] = {
        let mut table = [0; 16];
        let mut i = 0;
        while i < table.len() {
            table[i] = TABLES[0][i << 4];
            i += 1;
        }
        table
    };
    bytes.iter().fold(crc, |crc, byte| {
        let crc = crc ^ u32::from(*byte);
        let crc = (crc >> 4) ^ TABLE[(crc & 0xF) as usize];
        (crc >> 4) ^ TABLE[(crc & 0xF) as usize]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    static CRC_32: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

    fn by_tables(bytes: &[u8]) -> u32 {
        let (words, rest) = bytes.as_chunks::<4>();
        !by_bytes(by_words(u32::MAX, words), rest)
    }

    #[test]
    fn check_value_of_the_catalogue() {
        assert_eq!(crc_32(b"123456789"), 0xCBF4_3926);
        assert_eq!(by_tables(b"123456789"), 0xCBF4_3926);
    }

    proptest! {
        #[test]
        fn words_are_the_crates(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            prop_assert_eq!(crc_32(&bytes), CRC_32.checksum(&bytes));
            prop_assert_eq!(by_tables(&bytes), CRC_32.checksum(&bytes));
            let (words, rest) = bytes.as_chunks::<4>();
            prop_assert_eq!(!by_bytes(by_parts(u32::MAX, words), rest), CRC_32.checksum(&bytes));
            prop_assert_eq!(!by_halves(u32::MAX, &bytes), CRC_32.checksum(&bytes));
        }
    }
}
