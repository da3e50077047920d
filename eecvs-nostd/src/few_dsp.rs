//! The walk of [`crate::pixel_encoder`] over the pixels of the eight-coefficient DCT, with its state
//! in registers.
//!
//! The compiler's own walk takes twice the instructions: it has fewer registers than the walk has
//! state, and moves that to the stack and back at every pixel. The loop in Rust stays for other
//! processors and for probes, which want to know the stage; all give the same bits.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::marker::PhantomData;
use core::mem::offset_of;

use crate::bits::{BitWriter, Position};
use crate::fixed_point::CHUNK_EVENTS;
use crate::group::{Group, Lists};
use crate::pack::Packer;
use crate::phase::PhaseScale;
use crate::transform::rows::{self, Lines};
use crate::window::{NEXT_SHIFT, NO_SLOT, SLOTS_MAX, Slot, Window};

/// What the assembly knows. The first part is copied to its stack.
#[repr(C)]
struct Walk<'w, 's, 'o> {
    /// Word from which on the output has no room for another pixel.
    limit: usize,
    lines: *const Lines,
    phase_shift: u32,
    reciprocal: u32,
    /// From u / 2 to the cell.
    cell_shift: u32,
    /// Bits of a single event but for its gap.
    single_bits: u32,
    /// From sums to levels.
    level_shift: u32,
    /// Bits of a level of one event, and one.
    level_bits: u32,
    /// Raster index of the first column of the segment at hand.
    base: u32,
    slots: *const Slot,
    packer: *mut Packer,
    lists: *mut Lists,
    position: *mut Position,
    words: *mut [u8; 4],
    /// Columns of the segment that were not visited.
    columns: u32,
    /// Sums that the assembly leaves to [`seven_long`].
    sums: [i32; 7],
    group: *mut Group,
    window: *mut Window<'s>,
    writer: *mut BitWriter<'o>,
    width: u32,
    /// Ties the pointers to what they point to.
    borrowed: PhantomData<&'w mut ()>,
}

/// Encodes pixels up to the window's last, up to one of more than [`CHUNK_EVENTS`] events, which is
/// the group's next then, or until the output has less than `room` words left. Returns events and
/// pixels.
pub fn walk(
    (group, window): (&mut Group, &mut Window<'_>),
    scale: PhaseScale,
    packer: &mut Packer,
    (writer, room): (&mut BitWriter<'_>, usize),
) -> (u32, u32) {
    let (phase_shift, reciprocal) = scale.parts();
    let cells_log2 = packer.cells_log2();
    let (level_shift, level_bits) = packer.level_parts();
    let width = packer.width();
    let writer: *mut BitWriter<'_> = writer;
    // SAFETY: the pointer is that of the reference; both parts are reached through it alone.
    let (position, words, words_len) = unsafe { BitWriter::raw_parts(writer) };
    let mut walk = Walk {
        limit: words_len.saturating_sub(room),
        lines: rows::lines(),
        phase_shift,
        reciprocal,
        cell_shift: 31 - cells_log2,
        single_bits: cells_log2 + 2,
        level_shift,
        level_bits,
        base: 0,
        slots: core::ptr::null(),
        packer,
        lists: core::ptr::null_mut(),
        position,
        words,
        columns: 0,
        sums: [0; 7],
        group,
        window,
        writer,
        width,
        borrowed: PhantomData,
    };
    // SAFETY: the pointers are those of exclusive references that outlive the call. `walk_columns`
    // reads slots at the heads and links of the group's lists, all of which `Group` has found below
    // the number of slots when it made the lists; reads and writes lists at columns below 32; reads
    // the table at rows below 512; and writes words before `limit` plus `room`, which are there.
    // The build script sets `eecvs_dsp` only for cores that have the instructions.
    let counts = unsafe { walk_columns(&mut walk) };
    group.leave(walk.columns);
    (counts & 0xffff, counts >> 16)
}

// What the assembly takes for granted. Both counts fit half a word.
const _: () = assert!(SLOTS_MAX <= 0xffff && NO_SLOT == 0xffff);
const _: () = assert!(size_of::<Slot>() == 8 && NEXT_SHIFT == 16 && CHUNK_EVENTS < 64);
const _: () = assert!(offset_of!(Lists, tallies) == 128 && size_of::<Lists>() == 256);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, base) == 32);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, columns) == 56);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, sums) == 60);

/// The next segment's columns, 0 where there is none; its base, slots and lists.
unsafe extern "C" fn next_segment(walk: &mut Walk<'_, '_, '_>) -> u32 {
    // SAFETY: see `walk`; nothing else has a reference while this runs.
    let (group, window) = unsafe { (&mut *walk.group, &mut *walk.window) };
    let columns = group.enter(window);
    let (x, y) = group.origin();
    walk.base = u32::from(y) * walk.width + u32::from(x);
    walk.slots = window.slots().as_ptr();
    walk.lists = group.lists();
    columns
}

/// A single event whose code is longer than 31 bits; `before` is what the packer's gap comes to.
unsafe extern "C" fn single_long(walk: &mut Walk<'_, '_, '_>, before: u32, rest: u32) {
    // SAFETY: see `walk`; nothing else has a reference while this runs.
    let (packer, writer) = unsafe { (&mut *walk.packer, &mut *walk.writer) };
    packer.single_to(before, rest, writer);
}

/// A pixel whose levels have over 10 bits or whose place has over 31: its sums are in `walk`;
/// `before` is what the packer's gap began from.
unsafe extern "C" fn seven_long(walk: &mut Walk<'_, '_, '_>, index: u32, tally: u32, before: u32) {
    // SAFETY: see `walk`; nothing else has a reference while this runs.
    let (packer, writer) = unsafe { (&mut *walk.packer, &mut *walk.writer) };
    let on = tally & 0xffff;
    packer.seven_from(before, index, (on, (tally >> 16) - on), &walk.sums, writer);
}

/// Appends `$bits` bits of `$value`, which has no others; overwrites `$bits` and `$tmp`.
///
/// r9: bits of the next word, lr: how many there are, r12: where the word goes.
macro_rules! put {
    ($value:literal, $bits:literal, $tmp:literal) => {
        concat!(
            "lsl ",
            $tmp,
            ", ",
            $value,
            ", lr\n",
            "orr r9, r9, ",
            $tmp,
            "\n",
            "add lr, lr, ",
            $bits,
            "\n",
            "cmp lr, #32\n",
            "blo 2f\n",
            "str r9, [r12], #4\n",
            "sub lr, lr, #32\n",
            "sub ",
            $bits,
            ", ",
            $bits,
            ", lr\n",
            // What the word had no room for; nothing where that is a shift by 32.
            "lsr r9, ",
            $value,
            ", ",
            $bits,
            "\n",
            "2:"
        )
    };
}

/// Adds the atoms of the slot at `$slot` to r4 to r10, or begins with them; lr is its link then. As `rows::cosines` does. r0: slots.
macro_rules! event {
    ($slot:literal, $begin:literal, $r4:literal, $r5:literal, $r6:literal, $r7:literal, $r8:literal, $r9:literal,
        $r10:literal) => {
        concat!(
            // r1: u / 2; lr: the link.
            "add r1, r0, ",
            $slot,
            ", lsl #3\n",
            "ldrd r1, lr, [r1]\n",
            "ldrd r2, r3, [sp, #40]\n",
            "lsls r1, r2\n",
            "umull r3, r1, r1, r3\n",
            // r2: all ones in the second half of the window; r1: from the nearer edge.
            "sbfx r2, r1, #30, #1\n",
            "eors r1, r2\n",
            // r3: all ones where it is ON; r2: where odd k change their sign.
            "sbfx r3, lr, #0, #1\n",
            "eors r2, r3\n",
            // r12: the weights for even k, r11: for odd k.
            "ubfx r11, r1, #{distance_at}, #{distance_bits}\n",
            "orr r11, r11, #{one}\n",
            "eor r12, r11, r3\n",
            "ssub16 r12, r12, r3\n",
            "eor r11, r11, r2\n",
            "ssub16 r11, r11, r2\n",
            // r1: the row.
            "ubfx r1, r1, #{row_at}, #{rows_log2}\n",
            "ldr r2, [sp, #36]\n",
            "add r1, r2, r1, lsl #5\n",
            "ldrd r2, r3, [r1]\n",
            $begin,
            " r4, r2, r11",
            $r4,
            "\n",
            $begin,
            " r5, r3, r12",
            $r5,
            "\n",
            "ldrd r2, r3, [r1, #8]\n",
            $begin,
            " r6, r2, r11",
            $r6,
            "\n",
            $begin,
            " r7, r3, r12",
            $r7,
            "\n",
            "ldrd r2, r3, [r1, #16]\n",
            "ldr r1, [r1, #24]\n",
            $begin,
            " r8, r2, r11",
            $r8,
            "\n",
            $begin,
            " r9, r3, r12",
            $r9,
            "\n",
            $begin,
            " r10, r1, r11",
            $r10
        )
    };
}

/// Returns pixels << 16 and events.
///
/// # Safety
/// As `walk` has it.
#[unsafe(naked)]
unsafe extern "C" fn walk_columns(walk: &mut Walk<'_, '_, '_>) -> u32 {
    naked_asm!(
        // r4: columns; r5: base; r6: slots; r7: packer; r8: lists; r9: position; r10: words;
        // r11: the counts.
        // At sp: 0 to 20 r5 to r10; 24 r4, 28 r11; 32 limit, 36 lines, 40 phase_shift,
        // 44 reciprocal, 48 cell_shift, 52 single_bits, 56 level_shift, 60 level_bits; 64 walk;
        // 68 index, 72 tally, 76 the gap before; 80 code, 84 its bits but for the levels' width.
        "push {{r4-r11, lr}}",
        "sub sp, #92",
        "str r0, [sp, #64]",
        "ldm r0, {{r1-r8}}",
        "add r12, sp, #32",
        "stm r12, {{r1-r8}}",
        "mov r11, #0",
        // The next segment.
        "6:",
        "ldr r0, [sp, #64]",
        "bl {next_segment}",
        "movs r4, r0",
        "beq 8f",
        "ldr r0, [sp, #64]",
        "adds r0, #32",
        "ldm r0, {{r5-r10}}",
        "stm sp, {{r5-r10}}",
        // The next pixel. r0: raster index; r1: its list; r2: the first slot; r3: its offset;
        // r12: its link.
        "1:",
        "rbit r0, r4",
        "clz r0, r0",
        "add r1, r8, r0, lsl #2",
        "ldr r2, [r1]",
        "subs r3, r4, #1",
        "ands r4, r3",
        "adds r0, r0, r5",
        "add r3, r6, r2, lsl #3",
        "ldrd r3, r12, [r3]",
        "movw lr, #0xffff",
        "str lr, [r1]",
        "cmp lr, r12, lsr #16",
        "bne 4f",
        // One event.
        "movs r2, #0",
        "str r2, [r1, #128]",
        // r3: the cell; and beside it, lowest, the polarity.
        "ldrd r1, r2, [sp, #40]",
        "lsls r3, r1",
        "ldr lr, [sp, #48]",
        "umull r1, r3, r3, r2",
        "lsr r3, r3, lr",
        "and r12, r12, #1",
        "add r3, r12, r3, lsl #1",
        // r1: the gap's code, a 1 above it, which is that of n; lr: its bits.
        "ldm r7, {{r1, r2, r12, lr}}",
        "subs r1, r0, r1",
        "subs r0, r0, r2",
        "clz r2, r1",
        "sub r12, r12, r2",
        "sub lr, lr, r2, lsl #1",
        "adds r1, r1, r1",
        "adds r1, #1",
        "lsl r1, r1, r12",
        "add r12, lr, #1",
        "lsl r12, r3, r12",
        "add r1, r1, r12",
        "ldr r2, [sp, #52]",
        "add r2, r2, lr",
        "cmp r2, #31",
        "bhi 7f",
        "str r0, [r7]",
        "ldm r9, {{r0, r3, r12}}",
        "add r11, r11, #0x10001",
        "rsb lr, r12, #32",
        "lsl lr, r1, lr",
        "orr r3, r3, lr",
        "subs r2, r12, r2",
        "bls 2f",
        "strd r3, r2, [r9, #4]",
        "cmp r4, #0",
        "bne 1b",
        "b 6b",
        // A word is complete: what it had no room for begins the next.
        "2:",
        "str r3, [r10, r0, lsl #2]",
        "ldr r3, [sp, #32]",
        "adds r0, #1",
        "lsr r1, r1, r12",
        "adds r2, #32",
        "stm r9, {{r0, r1, r2}}",
        "cmp r0, r3",
        "bhs 8f",
        "cmp r4, #0",
        "bne 1b",
        "b 6b",
        // Several events; r3: the tally.
        "4:",
        "ldr r3, [r1, #128]",
        "cmp r3, #{crowded}",
        "bhs 5f",
        "mov r12, #0",
        "str r12, [r1, #128]",
        "add r11, r11, #0x10000",
        "add r11, r11, r3, lsr #16",
        "strd r4, r11, [sp, #24]",
        "strd r0, r3, [sp, #68]",
        // r4: the code; r8: its bits. The gap first, and a 1 above it.
        "ldm r7, {{r4, r5, r6, r8}}",
        "str r4, [sp, #76]",
        "subs r4, r0, r4",
        "subs r0, r0, r5",
        "str r0, [r7]",
        "clz r5, r4",
        "subs r6, r6, r5",
        "sub r8, r8, r5, lsl #1",
        "mov r12, #1",
        "add r4, r12, r4, lsl #1",
        "lsls r4, r6",
        // n, whose code has its 1 from the gap's; r3: n, r9: ON events.
        "uxth r9, r3",
        "lsrs r3, r3, #16",
        "clz r5, r3",
        "rsb r5, r5, #31",
        "add r6, r12, r3, lsl #1",
        "lsls r6, r5",
        "subs r6, #1",
        "lsl r6, r6, r8",
        "adds r4, r4, r6",
        "add r8, r8, r5, lsl #1",
        "add r8, r8, #1",
        // ON events, with the 1 above n's code taken off.
        "sub r9, r9, #1",
        "lsl r9, r9, r8",
        "add r4, r4, r9",
        "add r8, r8, r5",
        // The levels' width has as many bits as the widest possible has more than the widest one,
        // and one: bits of a level of one event, less the leading zeros of n - 1, plus those of the
        // widest one.
        "subs r3, #1",
        "clz r5, r3",
        "ldr r6, [sp, #60]",
        "sub r8, r8, r5",
        "add r8, r8, r6",
        "strd r4, r8, [sp, #80]",
        "ldr r0, [sp, #4]",
        event!("r2", "smuad", "", "", "", "", "", "", ""),
        "lsr lr, lr, #16",
        "3:",
        event!("lr", "smlad", ", r4", ", r5", ", r6", ", r7", ", r8", ", r9", ", r10"),
        // The carry tells the end of the list.
        "adds r2, lr, #0x10000",
        "lsr lr, lr, #16",
        "bcc 3b",
        // r1: leading zeros of the bits that are not copies of the sign, of any of the levels.
        "eor r0, r4, r4, asr #31",
        "eor r1, r5, r5, asr #31",
        "orrs r0, r1",
        "eor r1, r6, r6, asr #31",
        "orrs r0, r1",
        "eor r1, r7, r7, asr #31",
        "orrs r0, r1",
        "eor r1, r8, r8, asr #31",
        "orrs r0, r1",
        "eor r1, r9, r9, asr #31",
        "orrs r0, r1",
        "eor r1, r10, r10, asr #31",
        "orrs r0, r1",
        "ldr r2, [sp, #56]",
        "lsrs r0, r2",
        "clz r1, r0",
        // r0: bits of a level; r3: the code with the levels' width; r11: its bits.
        "ldrd r3, r11, [sp, #80]",
        "rsb r0, r1, #33",
        "add r11, r11, r1",
        "cmp r0, #10",
        "bhi 9f",
        "cmp r11, #32",
        "bhi 9f",
        "movs r1, #1",
        "sub r12, r11, #1",
        "lsl r12, r1, r12",
        "orr r3, r3, r12",
        "asrs r4, r2",
        "asrs r5, r2",
        "asrs r6, r2",
        "asrs r7, r2",
        "asr r8, r8, r2",
        "asr r9, r9, r2",
        "asr r10, r10, r2",
        // Three levels side by side in r4; r1: 2^bits, r2: half of it, r6: the highest bit of each.
        "lsls r1, r0",
        "lsrs r2, r1, #1",
        "mla r5, r6, r1, r5",
        "mla r6, r2, r1, r2",
        "mla r4, r5, r1, r4",
        "mla r6, r6, r1, r2",
        // A negative level has borrowed from its neighbour, which half of a range more gives back.
        "adds r4, r4, r6",
        "eors r4, r6",
        "cmp r0, #8",
        "bhi 11f",
        // The other four in r7.
        "mla r9, r10, r1, r9",
        "mla r6, r6, r1, r2",
        "mla r8, r9, r1, r8",
        "mla r7, r8, r1, r7",
        "ldrd r5, r12, [sp, #16]",
        "adds r7, r7, r6",
        "eors r7, r6",
        "ldm r5, {{r8, r9, r10}}",
        "add r12, r12, r8, lsl #2",
        "rsb lr, r10, #32",
        put!("r3", "r11", "r1"),
        "add r11, r0, r0, lsl #1",
        put!("r4", "r11", "r1"),
        "lsl r11, r0, #2",
        put!("r7", "r11", "r1"),
        "3:",
        "ldr r1, [sp, #20]",
        "sub r12, r12, r1",
        "lsr r8, r12, #2",
        "rsb r10, lr, #32",
        "stm r5, {{r8, r9, r10}}",
        "ldr r1, [sp, #32]",
        "cmp r8, r1",
        "ldm sp, {{r5-r10}}",
        "ldrd r4, r11, [sp, #24]",
        "bhs 8f",
        "cmp r4, #0",
        "bne 1b",
        "b 6b",
        // Four of over 8 bits are more than a word: three in r7 and one in r6.
        "11:",
        "mla r8, r9, r1, r8",
        "mla r7, r8, r1, r7",
        "ldrd r5, r12, [sp, #16]",
        "adds r7, r7, r6",
        "eors r7, r6",
        "add r6, r10, r2",
        "eors r6, r2",
        "ldm r5, {{r8, r9, r10}}",
        "add r12, r12, r8, lsl #2",
        "rsb lr, r10, #32",
        put!("r3", "r11", "r1"),
        "add r11, r0, r0, lsl #1",
        "mov r10, r11",
        put!("r4", "r11", "r1"),
        put!("r7", "r10", "r1"),
        put!("r6", "r0", "r1"),
        "b 3b",
        // Rarely: wide levels or a long place.
        "9:",
        "ldr r0, [sp, #64]",
        "add r1, r0, #60",
        "stm r1, {{r4-r10}}",
        "add r1, sp, #68",
        "ldm r1, {{r1-r3}}",
        "bl {seven_long}",
        "ldm sp, {{r5-r10}}",
        "ldrd r4, r11, [sp, #24]",
        "b 10f",
        // A long gap.
        "7:",
        "add r11, r11, #0x10001",
        "mov r1, r0",
        "mov r2, r3",
        "ldr r0, [sp, #64]",
        "bl {single_long}",
        "10:",
        "ldr r0, [r9]",
        "ldr r1, [sp, #32]",
        "cmp r0, r1",
        "bhs 8f",
        "cmp r4, #0",
        "bne 1b",
        "b 6b",
        // More events than a chunk: as it was before.
        "5:",
        "str r2, [r1]",
        "subs r0, r0, r5",
        "movs r1, #1",
        "lsls r1, r0",
        "orrs r4, r1",
        "8:",
        "ldr r0, [sp, #64]",
        "str r4, [r0, #56]",
        "mov r0, r11",
        "add sp, #92",
        "pop {{r4-r11, pc}}",
        next_segment = sym next_segment,
        seven_long = sym seven_long,
        single_long = sym single_long,
        crowded = const (CHUNK_EVENTS + 1) << 16,
        distance_at = const rows::DISTANCE_AT,
        distance_bits = const rows::DISTANCE_BITS,
        one = const rows::ONE << 16,
        row_at = const rows::ROW_AT,
        rows_log2 = const rows::ROWS_LOG2,
    )
}
