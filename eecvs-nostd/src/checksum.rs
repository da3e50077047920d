//! The checksums of frames and packets.
//!
//! CRC-16 (IBM-3740) of headers and packets is the crc crate's. CRC-32 (ISO-HDLC, as in Ethernet and
//! zip) of frames is the crate's on a 64-bit host; its fastest way takes 7 instructions a byte on a
//! Cortex-M4, where four tables of its making, a word at a time, take 3.4: the tables' addresses
//! stay in registers, as those of eight or sixteen tables do not. In assembly, which loads four words
//! at once, they take 3.2.

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
#[cfg(all(not(target_pointer_width = "64"), not(eecvs_dsp)))]
pub(crate) fn crc_32(bytes: &[u8]) -> u32 {
    by_words(bytes)
}

/// CRC-32 of `bytes`.
#[cfg(eecvs_dsp)]
pub(crate) fn crc_32(bytes: &[u8]) -> u32 {
    arm::by_blocks(bytes)
}

/// `TABLES[i][b]` is what a byte b does to the checksum, i bytes later.
#[cfg(any(test, not(target_pointer_width = "64")))]
static TABLES: [[u32; 256]; 4] = {
    const CRC: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);
    let tables = CRC.table();
    [tables[0], tables[1], tables[2], tables[3]]
};

#[cfg(any(test, all(not(target_pointer_width = "64"), not(eecvs_dsp))))]
fn by_words(bytes: &[u8]) -> u32 {
    let [last, third, second, first] = &TABLES;
    let mut crc = u32::MAX;
    let mut word = |bytes: [u8; 4]| {
        let [a, b, c, d] = (crc ^ u32::from_le_bytes(bytes)).to_le_bytes();
        crc = first[usize::from(a)]
            ^ second[usize::from(b)]
            ^ third[usize::from(c)]
            ^ last[usize::from(d)];
    };
    let (words, rest) = bytes.as_chunks::<4>();
    let (blocks, words) = words.as_chunks::<8>();
    for block in blocks {
        for bytes in block {
            word(*bytes);
        }
    }
    for bytes in words {
        word(*bytes);
    }
    for byte in rest {
        crc = (crc >> 8) ^ last[usize::from(crc as u8 ^ byte)];
    }
    !crc
}

/// The same bits with Thumb-2 instructions; golden frames have been checked with both.
#[cfg(eecvs_dsp)]
#[allow(unsafe_code)]
mod arm {
    use core::arch::naked_asm;

    use super::TABLES;

    /// Bytes that [`blocks`] takes at once.
    const BLOCK_BYTES: usize = 32;

    pub fn by_blocks(bytes: &[u8]) -> u32 {
        // Several words are loaded at once from a multiple of four alone.
        let (before, rest) = bytes.split_at(bytes.as_ptr().align_offset(4).min(bytes.len()));
        let mut crc = single(u32::MAX, before);
        let count = rest.len() / BLOCK_BYTES;
        if count > 0 {
            // SAFETY: the first `count` blocks of `rest` are there, and it begins at a multiple of
            // four: `align_offset` has no other answer here, or one past the end, which leaves no
            // block. `eecvs_dsp` is set for cores that have the instructions.
            crc = unsafe { blocks(crc, rest.as_ptr(), count, &TABLES) };
        }
        !single(crc, rest.get(count * BLOCK_BYTES..).unwrap_or_default())
    }

    #[inline(never)]
    fn single(crc: u32, bytes: &[u8]) -> u32 {
        bytes.iter().fold(crc, |crc, byte| {
            (crc >> 8) ^ TABLES[0][usize::from(crc as u8 ^ byte)]
        })
    }

    /// The word in `$word`. r0: the checksum; r4 to r7: the tables.
    macro_rules! word {
        ($word:literal) => {
            concat!(
                "eor r0, r0, ",
                $word,
                "
                uxtb r3, r0
                ldr r3, [r7, r3, lsl #2]
                ubfx r12, r0, #8, #8
                ldr r12, [r6, r12, lsl #2]
                ubfx lr, r0, #16, #8
                ldr lr, [r5, lr, lsl #2]
                lsr r0, r0, #24
                ldr r0, [r4, r0, lsl #2]
                eor r3, r3, r12
                eor r0, r0, lr
                eor r0, r0, r3
                "
            )
        };
    }

    /// The checksum `crc` and `count` blocks further.
    ///
    /// Restores every register that a callee must.
    ///
    /// # Safety
    /// `count` blocks, one at the least, are at `bytes`, a multiple of four.
    #[unsafe(naked)]
    unsafe extern "C" fn blocks(
        crc: u32,
        bytes: *const u8,
        count: usize,
        tables: &[[u32; 256]; 4],
    ) -> u32 {
        naked_asm!(
            "push {{r4-r11, lr}}",
            "mov r4, r3",
            "add r5, r4, #1024",
            "add r6, r5, #1024",
            "add r7, r6, #1024",
            "2:",
            "ldm r1!, {{r8-r11}}",
            word!("r8"),
            word!("r9"),
            word!("r10"),
            word!("r11"),
            "ldm r1!, {{r8-r11}}",
            word!("r8"),
            word!("r9"),
            word!("r10"),
            word!("r11"),
            "subs r2, r2, #1",
            "bne 2b",
            "pop {{r4-r11, pc}}",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn check_value_of_the_catalogue() {
        assert_eq!(crc_32(b"123456789"), 0xCBF4_3926);
        assert_eq!(by_words(b"123456789"), 0xCBF4_3926);
    }

    proptest! {
        #[test]
        fn words_are_the_crates(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            prop_assert_eq!(by_words(&bytes), CRC_32.checksum(&bytes));
        }
    }
}
