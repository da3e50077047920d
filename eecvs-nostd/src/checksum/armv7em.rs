//! The same fold in Thumb-2 instructions, each of which shifts a word and adds it; golden frames were checked with
//! both.

use core::arch::naked_asm;

use super::fold::{BLOCK, Block, LATER};

pub fn fold(crc: u32, blocks: &[Block]) -> [u32; BLOCK] {
    let mut taken = [0; BLOCK];
    let range = blocks.as_ptr_range();
    if range.start.addr().is_multiple_of(4) && !blocks.is_empty() {
        // SAFETY: the blocks from `start` to `end` exist, at least one, and begin at a multiple of four. This file
        // is compiled only for cores that have the instructions.
        unsafe { take_away(crc, range.start, range.end, &mut taken) };
    }
    taken
}

/// Changes the word in `$word` by those four to ten words before it.
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

// Assumptions of the registers in `change`.
const _: () = assert!(
    BLOCK == 12 && LATER[0].0 == 4 && LATER[1].0 == 5 && LATER[2].0 == 6 && LATER[3].0 == 9
);

/// Clears the blocks from `at` to `end`, at least one, as [`super::fold`] does; their words go to `taken`, which
/// has to be 0.
///
/// Restores every register that a callee has to.
///
/// # Safety
/// The blocks have to be readable, `at` a multiple of four, and `taken` readable and writable.
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
