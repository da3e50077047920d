//! [`Packer::seven`] with its state in registers.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::mem::offset_of;

use crate::accumulate::dct8::Cosines;
use crate::pack::bits_lsb_first::{BitWriter, Position};
use crate::pack::packer::{GapCode, Packer};

/// Most words that [`put`] writes: 32 bits, 70 of levels, and 31 that were pending.
const WORDS_MAX: usize = 5;

/// Writes the same bits as [`Packer::seven_portable`]. Returns `false`, with nothing changed, if levels have over
/// 10 bits, the place and the levels' width take over 32, or the output is nearly full.
#[inline(always)]
pub fn put(
    packer: &mut Packer,
    index: u32,
    (on, off): (u32, u32),
    cosines: &Cosines,
    writer: &mut BitWriter<'_>,
) -> bool {
    if !writer.has_words(WORDS_MAX) {
        return false;
    }
    let counts = ((on + off) << 16) | on;
    // SAFETY: the pointer comes from the reference. `seven` writes `before` of `packer`, the position, and up to
    // `WORDS_MAX` words from there on, which exist. This file is compiled only for cores that have the
    // instructions.
    unsafe {
        let (position, words, _) = BitWriter::raw_parts(writer);
        seven(packer, index, counts, cosines, &mut *position, words)
    }
}

const _: () = assert!(offset_of!(Packer, gap) == 0 && offset_of!(GapCode, before) == 0);
const _: () = assert!(offset_of!(Packer, one_bits) == 16 && offset_of!(Packer, shift) == 20);
/// Writes the pixel; `counts` is n (2 to 63) << 16 plus the number of ON events.
///
/// # Safety
/// There have to be at least `WORDS_MAX` words from `position.words` on.
#[unsafe(naked)]
unsafe extern "C" fn seven(
    packer: &mut Packer,
    index: u32,
    counts: u32,
    cosines: &Cosines,
    position: &mut Position,
    words: *mut [u8; 4],
) -> bool {
    // Appends `$bits` bits of `$value`, which is below 2^`$bits`; overwrites `$bits` and `$tmp`. r12: bits of the
    // next word; lr: how many there are; r11: where the word goes.
    macro_rules! put {
        ($value:literal, $bits:literal, $tmp:literal) => {
            concat!(
                "lsl ",
                $tmp,
                ", ",
                $value,
                ", lr\n",
                "orr r12, r12, ",
                $tmp,
                "\n",
                "add lr, ",
                $bits,
                "\n",
                "cmp lr, #32\n",
                "blo 2f\n",
                "str r12, [r11], #4\n",
                "sub lr, #32\n",
                "sub ",
                $bits,
                ", ",
                $bits,
                ", lr\n",
                // The bits that the word had no room for; none if that is a shift by 32.
                "lsr r12, ",
                $value,
                ", ",
                $bits,
                "\n",
                "2:"
            )
        };
    }
    naked_asm!(
        "push {{r4-r11, lr}}",
        // r4: the code; r7: its bits. First the gap, with a 1 above it.
        "ldm r0, {{r4-r7}}",
        "subs r4, r1, r4",
        "subs r1, r1, r5",
        "clz r5, r4",
        "subs r6, r6, r5",
        "sub r7, r7, r5, lsl #1",
        "adds r4, r4, r4",
        "adds r4, #1",
        "lsls r4, r6",
        // n, whose code takes its 1 from the gap's; r2: n; r12: ON events.
        "uxth r12, r2",
        "lsrs r2, r2, #16",
        "clz r5, r2",
        "rsb r5, r5, #31",
        "adds r6, r2, r2",
        "adds r6, #1",
        "lsls r6, r5",
        "subs r6, #1",
        "lsls r6, r7",
        "adds r4, r4, r6",
        "adds r7, #1",
        "add r7, r7, r5, lsl #1",
        // ON events, with the 1 above n's code subtracted.
        "sub r12, r12, #1",
        "lsl r12, r12, r7",
        "add r4, r4, r12",
        "adds r7, r7, r5",
        "adds r7, #1",
        // r5: most bits that a level can have; r6: bits of the widest level.
        "subs r2, #1",
        "clz r5, r2",
        "ldrd r6, r8, [r0, #16]",
        "rsb r5, r5, #32",
        "adds r5, r5, r6",
        "ldr r6, [r3, #{spread_at}]",
        "lsrs r6, r8",
        "clz r6, r6",
        "rsb r6, r6, #33",
        "cmp r6, r5",
        "it hi",
        "movhi r6, r5",
        "cmp r6, #10",
        "bhi 4f",
        "subs r5, r5, r6",
        "adds r7, r7, r5",
        "movs r9, #1",
        "lsl r5, r9, r7",
        "orrs r4, r5",
        "adds r7, #1",
        "cmp r7, #32",
        "bhi 4f",
        // From here on nothing is undone.
        "str r1, [r0]",
        "ldrd r10, r0, [sp, #36]",
        "ldm r10, {{r11, r12, lr}}",
        "add r11, r0, r11, lsl #2",
        "rsb lr, lr, #32",
        put!("r4", "r7", "r5"),
        // The first three levels; r9: 2^bits; r5: half of it; r4: the highest bit of each.
        "add r10, r3, #{sums_at}",
        "ldm r10!, {{r1-r3}}",
        "asrs r1, r8",
        "asrs r2, r8",
        "asrs r3, r8",
        "lsl r9, r9, r6",
        "lsr r5, r9, #1",
        "mla r2, r3, r9, r2",
        "mla r4, r5, r9, r5",
        "mla r1, r2, r9, r1",
        "mla r4, r4, r9, r5",
        // A negative level has borrowed from the field above it: adding half of a field's range gives that back.
        "adds r1, r1, r4",
        "eors r1, r4",
        "add r7, r6, r6, lsl #1",
        put!("r1", "r7", "r2"),
        "cmp r6, #8",
        "bhi 3f",
        // The other four.
        "ldm r10, {{r1, r2, r3, r7}}",
        "asrs r1, r8",
        "asrs r2, r8",
        "asrs r3, r8",
        "asrs r7, r8",
        "mla r3, r7, r9, r3",
        "mla r4, r4, r9, r5",
        "mla r2, r3, r9, r2",
        "mla r1, r2, r9, r1",
        "adds r1, r1, r4",
        "eors r1, r4",
        "lsls r7, r6, #2",
        put!("r1", "r7", "r2"),
        "5:",
        "ldrd r10, r0, [sp, #36]",
        "sub r11, r11, r0",
        "lsr r11, r11, #2",
        "rsb lr, lr, #32",
        "stm r10, {{r11, r12, lr}}",
        "movs r0, #1",
        "pop {{r4-r11, pc}}",
        // Four levels of over 8 bits do not fit a word: three, then one.
        "3:",
        "ldm r10!, {{r1-r3}}",
        "asrs r1, r8",
        "asrs r2, r8",
        "asrs r3, r8",
        "mla r2, r3, r9, r2",
        "mla r1, r2, r9, r1",
        "adds r1, r1, r4",
        "eors r1, r4",
        "add r7, r6, r6, lsl #1",
        put!("r1", "r7", "r2"),
        "ldr r1, [r10]",
        "asrs r1, r8",
        "adds r1, r1, r5",
        "eors r1, r5",
        put!("r1", "r6", "r2"),
        "b 5b",
        "4:",
        "movs r0, #0",
        "pop {{r4-r11, pc}}",
        sums_at = const Cosines::SUMS_AT,
        spread_at = const Cosines::SUMS_AT + 28,
    )
}
