//! The walk of [`crate::fused`] over the pixels of the Haar transform on 16 bins, with its state in registers, like
//! [`crate::fused::walk_armv7em`] for the eight-coefficient DCT.
//!
//! The 16 differences of a pixel fit four registers, as in [`haar_bytes`]. The DSP instructions' per-byte flags
//! give the lanes that are not 0, and the levels. The loop in Rust serves other processors, and traces that want to
//! know the stage. All give the same bits.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::marker::PhantomData;
use core::mem::offset_of;

use crate::accumulate::haar_bytes;
use crate::accumulate::haar_bytes::{Lanes, Row, Rows};
use crate::fixed_point::CHUNK_EVENTS;
use crate::group::{Entry, Group, Impulses};
use crate::pack::bits_lsb_first::{BitWriter, Position};
use crate::pack::packer::Packer;
use crate::transform::phase::PhaseScale;
use crate::transform::shape::Shape;
use crate::window::{COLUMN_SHIFT, NEXT_SHIFT, NO_SLOT, SLOTS_MAX, Slot, Window};

/// log2 of K.
pub const BINS_LOG2: u32 = 4;
/// Largest number of kept differences: their levels of up to 3 bits fit a word with a 1 above them.
pub const KEPT_MAX: u32 = 10;

/// Returns the divisor of [`walk`] and [`sum`], or `None` for a shape or a window that they do not handle.
pub const fn divisor(shape: Shape, scale: PhaseScale) -> Option<u32> {
    let is_one = match shape.grid {
        16 => shape.r as u32 <= KEPT_MAX,
        haar_bytes::GRID => true,
        _ => false,
    };
    if is_one {
        scale.divisor(haar_bytes::GRID_LOG2)
    } else {
        None
    }
}

/// The state of the assembly. The first part is copied to its stack.
#[repr(C)]
struct Walk<'w, 's, 'o> {
    /// Index of the word from which on the output has no room for another pixel.
    limit: usize,
    rows: *const Rows,
    duration_us: u32,
    cells_log2: u32,
    /// Bits of a single event, not counting its gap.
    single_bits: u32,
    /// Number of differences to keep.
    r: u32,
    /// Raster index of the first column of the current segment.
    base: u32,
    slots: *const Slot,
    packer: *mut Packer,
    entries: *mut Entry,
    position: *mut Position,
    words: *mut [u8; 4],
    /// Columns of the segment that were not visited.
    columns: u32,
    /// Differences for [`prune`], or levels for [`bytes_long`].
    lanes: [u32; 4],
    group: *mut Group,
    window: *mut Window<'s>,
    writer: *mut BitWriter<'o>,
    width: u32,
    /// Ties the pointers to what they point to.
    borrowed: PhantomData<&'w mut ()>,
}

/// Encodes pixels up to the window's last one, up to one of more than [`CHUNK_EVENTS`] events, which the group then
/// returns next, or until the output has less than `room` words left. Returns the number of events and of pixels.
/// `duration_us` must be below 2^28, and `r` at most [`KEPT_MAX`].
pub fn walk(
    (group, window): (&mut Group, &mut Window<'_>),
    duration_us: u32,
    r: u32,
    packer: &mut Packer,
    (writer, room): (&mut BitWriter<'_>, usize),
) -> (u32, u32) {
    let cells_log2 = packer.cells_log2();
    let width = u32::from(window.config().sensor.width);
    let writer: *mut BitWriter<'_> = writer;
    // SAFETY: the pointer is that of the reference; both parts are accessed only through it.
    let (position, words, words_len) = unsafe { BitWriter::raw_parts(writer) };
    let mut walk = Walk {
        limit: words_len.saturating_sub(room),
        rows: haar_bytes::table(),
        duration_us,
        cells_log2,
        single_bits: cells_log2 + 2,
        r,
        base: 0,
        slots: core::ptr::null(),
        packer,
        entries: core::ptr::null_mut(),
        position,
        words,
        columns: 0,
        lanes: [0; 4],
        group,
        window,
        writer,
        width,
        borrowed: PhantomData,
    };
    // SAFETY: the pointers are those of exclusive references that outlive the call. `walk_columns` reads slots at
    // the heads and links of the group's lists, all of which `Group` found to be below the number of slots when it
    // made the lists. It reads and writes entries of columns below 32; reads the table at bins below 16, as offsets
    // are below the duration; and writes words before `limit` plus `room`, which exist. This file is built only for
    // cores that have the instructions.
    let counts = unsafe { walk_columns(&mut walk) };
    group.columns = walk.columns;
    (counts & 0xffff, counts >> 16)
}

// The assembly relies on these: both counts fit half a word, and the sign of a link marks the list's end.
const _: () = assert!(SLOTS_MAX < 0x8000 && NO_SLOT == 0xffff);
const _: () = assert!(size_of::<Slot>() == 8 && NEXT_SHIFT == 16 && CHUNK_EVENTS < 128);
const _: () = assert!(COLUMN_SHIFT == 11);
const _: () = assert!(size_of::<Entry>() == 8 && offset_of!(Entry, tally) == 4);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, base) == 24);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, columns) == 48);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, lanes) == 52);
// The rows of 16 bins are every other row of a table of 32.
const _: () = assert!(size_of::<Row>() == 32 && haar_bytes::GRID_LOG2 == BINS_LOG2 + 1);

/// Returns the next segment's columns, or 0 after the last, and sets the segment's base, slots and entries.
unsafe extern "C" fn next_segment(walk: &mut Walk<'_, '_, '_>) -> u32 {
    // SAFETY: see `walk`; nothing else has a reference while this runs.
    let (group, window) = unsafe { (&mut *walk.group, &mut *walk.window) };
    let columns = group.enter(window);
    walk.base = u32::from(group.segment_y) * walk.width + u32::from(group.segment_x);
    walk.slots = window.slots().as_ptr();
    walk.entries = group.entries.as_mut_ptr();
    columns
}

/// Packs a single event whose code is longer than 31 bits. `before` is as in [`Packer::single_to`].
unsafe extern "C" fn single_long(walk: &mut Walk<'_, '_, '_>, before: u32, rest: u32) {
    // SAFETY: see `walk`; nothing else has a reference while this runs.
    let (packer, writer) = unsafe { (&mut *walk.packer, &mut *walk.writer) };
    packer.single_to(before, rest, writer);
}

/// Keeps the r largest of the differences in `walk`, clears the others, and returns the set of those kept.
unsafe extern "C" fn prune(walk: &mut Walk<'_, '_, '_>, tally: u32) -> u32 {
    let sums = Lanes::new(walk.lanes);
    let kept = haar_bytes::largest(sums, tally >> 16, walk.r);
    walk.lanes = sums.keep(kept).into_words();
    kept
}

/// Packs a pixel whose levels or whose place do not fit a word; its levels are in `walk`.
unsafe extern "C" fn bytes_long(walk: &mut Walk<'_, '_, '_>, index: u32, tally: u32, kept: u32) {
    // SAFETY: see `walk`; nothing else has a reference while this runs.
    let (packer, writer) = unsafe { (&mut *walk.packer, &mut *walk.writer) };
    let on = tally & 0xffff;
    let [a, b, c, d] = walk.lanes;
    // As for 32 bins: the code for them is in the firmware image anyway.
    let levels = Lanes::new([a, b, c, d, 0, 0, 0, 0]);
    let counts = (on, (tally >> 16) - on);
    packer.bytes_at(index, counts, (kept, levels, levels.spread()), writer);
}

/// Appends `$bits` bits of `$value`, which must have no others; overwrites `$bits` and `$tmp`.
///
/// r9: bits of the next word; lr: how many there are; r12: where the word goes.
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
            // What the word had no room for; 0 if this is a shift by 32.
            "lsr r9, ",
            $value,
            ", ",
            $bits,
            "\n",
            "2:"
        )
    };
}

/// Adds the row of an event to r4 to r7. r1: its offset; lr: its link; r8: table; r9: duration.
macro_rules! event {
    () => {
        concat!(
            "lsls r1, r1, #{bins_log2}\n",
            "udiv r1, r1, r9\n",
            // r10: -1 for ON, 1 for OFF.
            "sbfx r10, lr, #0, #1\n",
            "orr r10, r10, #1\n",
            "add r1, r8, r1, lsl #6\n",
            "ldm r1, {{r1, r2, r3, r12}}\n",
            "mls r4, r1, r10, r4\n",
            "mls r5, r2, r10, r5\n",
            "mls r6, r3, r10, r6\n",
            "mls r7, r12, r10, r7\n",
        )
    };
}

/// Returns the differences of a pixel of `group` on 4 W bins, like [`haar_bytes::sum`].
///
/// # Safety
/// `impulses` must be those of a pixel whose list [`Group`] has made from the slots, and must not be empty.
/// `duration_us` must be below 2^27, and all offsets below `duration_us`.
#[inline(always)]
pub unsafe fn sum<const W: usize>(impulses: &Impulses<'_>, duration_us: u32) -> Lanes<W> {
    let (slots, index) = impulses.parts();
    let mut sums = Sums {
        rows: haar_bytes::table(),
        duration_us,
        words: [0; W],
    };
    let to = (&raw mut sums).cast();
    // SAFETY: by the caller's guarantee, every link is an existing slot or the list's end, and every bin has a row.
    // The functions write W words of `sums`. This file is built only for cores that have the instructions.
    unsafe {
        if W == 4 {
            sum_16(slots.as_ptr(), index, to);
        } else {
            sum_32(slots.as_ptr(), index, to);
        }
    }
    Lanes::of_biased(sums.words)
}

/// Arguments and result of the assembly of [`sum`].
#[repr(C)]
struct Sums<const W: usize> {
    rows: *const Rows,
    duration_us: u32,
    words: [u32; W],
}

const _: () = assert!(offset_of!(Sums<8>, words) == 8);

/// Sums four words, as in the walk.
#[unsafe(naked)]
unsafe extern "C" fn sum_16(slots: *const Slot, index: u32, sums: *mut ()) {
    naked_asm!(
        "push {{r2, r4-r10, r11, lr}}",
        "ldrd r8, r9, [r2]",
        "add r1, r0, r1, lsl #3",
        "ldrd r1, lr, [r1]",
        "ubfx r2, lr, #13, #3",
        "subs r0, r0, r2",
        "mov r4, #0x80808080",
        "mov r5, r4",
        "mov r6, r4",
        "mov r7, r4",
        event!(),
        "cmp lr, #0",
        "bmi 3f",
        "2:",
        "add r1, r0, lr, lsr #13",
        "ldrd r1, lr, [r1]",
        event!(),
        "cmp lr, #0",
        "bpl 2b",
        "3:",
        "pop {{r2}}",
        "adds r2, #8",
        "stm r2, {{r4-r7}}",
        "pop {{r4-r11, pc}}",
        bins_log2 = const BINS_LOG2,
    )
}

/// Sums eight words, which leave no register for the table and the duration: these stay in memory.
#[unsafe(naked)]
unsafe extern "C" fn sum_32(slots: *const Slot, index: u32, sums: *mut ()) {
    naked_asm!(
        "push {{r2, r4-r10, r11, lr}}",
        "ldrd r2, r3, [r2]",
        "push {{r2, r3}}",
        "add r1, r0, r1, lsl #3",
        "ldr lr, [r1, #4]",
        "ubfx r2, lr, #13, #3",
        "subs r0, r0, r2",
        "mov r4, #0x80808080",
        "mov r5, r4",
        "mov r6, r4",
        "mov r7, r4",
        "mov r8, r4",
        "mov r9, r4",
        "mov r10, r4",
        "mov r11, r4",
        "b 3f",
        "2:",
        "add r1, r0, lr, lsr #13",
        "3:",
        "ldrd r1, lr, [r1]",
        "ldrd r2, r3, [sp]",
        "lsls r1, r1, #5",
        "udiv r1, r1, r3",
        "add r1, r2, r1, lsl #5",
        // r12: -1 for ON, 1 for OFF.
        "sbfx r12, lr, #0, #1",
        "orr r12, r12, #1",
        "ldrd r2, r3, [r1]",
        "mls r4, r2, r12, r4",
        "mls r5, r3, r12, r5",
        "ldrd r2, r3, [r1, #8]",
        "mls r6, r2, r12, r6",
        "mls r7, r3, r12, r7",
        "ldrd r2, r3, [r1, #16]",
        "mls r8, r2, r12, r8",
        "mls r9, r3, r12, r9",
        "ldrd r2, r3, [r1, #24]",
        "mls r10, r2, r12, r10",
        "mls r11, r3, r12, r11",
        "cmp lr, #0",
        "bpl 2b",
        "pop {{r1, r2, r3}}",
        "adds r3, #8",
        "stm r3, {{r4-r11}}",
        "pop {{r4-r11, pc}}",
    )
}

/// Walks the columns; returns pixels << 16 plus events.
///
/// # Safety
/// All pointers in `walk` must be valid as described in [`walk`].
#[unsafe(naked)]
unsafe extern "C" fn walk_columns(walk: &mut Walk<'_, '_, '_>) -> u32 {
    naked_asm!(
        // r4: columns; r5: base; r6: slots; r7: packer; r8: entries; r9: position; r10: words; r11: the counts. At
        // sp: 0 to 20: r5 to r10; 24: r4; 28: r11; 32: limit; 36: rows; 40: duration; 44: cells_log2; 48:
        // single_bits; 52: r; 56: walk; 60: index; 64: tally; 68 to 83: the levels, the last k first.
        "push {{r4-r11, lr}}",
        "sub sp, #84",
        "str r0, [sp, #56]",
        "ldm r0, {{r1-r6}}",
        "add r12, sp, #32",
        "stm r12, {{r1-r6}}",
        "mov r11, #0",
        // The next segment.
        "6:",
        "ldr r0, [sp, #56]",
        "bl {next_segment}",
        "movs r4, r0",
        "beq 8f",
        "ldr r0, [sp, #56]",
        "adds r0, #24",
        "ldm r0, {{r5-r10}}",
        "stm sp, {{r5-r10}}",
        // The next pixel. r0: raster index; r1: its list; r2: the first slot; r3: its offset; r12: its link.
        "1:",
        "rbit r0, r4",
        "clz r0, r0",
        "add r1, r8, r0, lsl #3",
        "ldr r2, [r1]",
        "subs r3, r4, #1",
        "ands r4, r3",
        "adds r0, r0, r5",
        "add r3, r6, r2, lsl #3",
        "ldrd r3, r12, [r3]",
        "movw lr, #0xffff",
        "str lr, [r1]",
        "cmp r12, #0",
        "bpl 4f",
        // One event.
        "movs r2, #0",
        "str r2, [r1, #4]",
        // r3: the cell, with the polarity in the lowest bit.
        "ldrd r1, r2, [sp, #40]",
        "lsls r3, r2",
        "udiv r3, r3, r1",
        "and r12, r12, #1",
        "add r3, r12, r3, lsl #1",
        // r1: the gap's code, with the 1 above it that is n's; lr: its bits.
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
        "ldr r2, [sp, #48]",
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
        // A word is complete: what it had no room for begins the next word.
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
        // Several events; lr: the tally.
        "4:",
        "ldr lr, [r1, #4]",
        "cmp lr, #{crowded}",
        "bhs 5f",
        "movs r2, #0",
        "str r2, [r1, #4]",
        "add r11, r11, #0x10000",
        "add r11, r11, lr, lsr #16",
        "strd r4, r11, [sp, #24]",
        "strd r0, lr, [sp, #60]",
        "mov r1, r3",
        "mov lr, r12",
        // r0: slots, less the column's upper bits, which `lr, lsr #13` includes.
        "ubfx r12, r12, #13, #3",
        "sub r0, r6, r12",
        "ldrd r8, r9, [sp, #36]",
        // The sums start at half of a lane's range.
        "mov r4, #0x80808080",
        "mov r5, r4",
        "mov r6, r4",
        "mov r7, r4",
        event!(),
        "3:",
        "add r1, r0, lr, lsr #13",
        "ldrd r1, lr, [r1]",
        event!(),
        // A negative link ends the list.
        "cmp lr, #0",
        "bpl 3b",
        // D_k in two's complement; r0: the lanes that are not 0.
        "mov r8, #0x80808080",
        "eor r4, r4, r8",
        "eor r5, r5, r8",
        "eor r6, r6, r8",
        "eor r7, r7, r8",
        "mov r9, #0xffffffff",
        "movw r10, #0x0201",
        "movt r10, #0x0804",
        "lsl r11, r10, #4",
        "mov r12, #0",
        "uadd8 r0, r4, r9",
        "sel r0, r10, r12",
        "uadd8 r1, r5, r9",
        "sel r1, r11, r12",
        "orr r0, r0, r1",
        "uadd8 r1, r6, r9",
        "sel r1, r10, r12",
        "uadd8 r2, r7, r9",
        "sel r2, r11, r12",
        "orr r1, r1, r2",
        "usad8 r0, r0, r12",
        "usad8 r1, r1, r12",
        "orr r0, r0, r1, lsl #8",
        // r3: their number.
        "and r1, r0, #0x55555555",
        "and r2, r0, #0xaaaaaaaa",
        "add r1, r1, r2, lsr #1",
        "and r2, r1, #0x33333333",
        "and r3, r1, #0xcccccccc",
        "add r2, r2, r3, lsr #2",
        "add r2, r2, r2, lsr #4",
        "and r2, r2, #0x0f0f0f0f",
        "usad8 r3, r2, r12",
        "ldr r1, [sp, #52]",
        "cmp r3, r1",
        "bhi 12f",
        "10:",
        // The levels: positive differences move down by one.
        "mov r8, #0x01010101",
        "ssub8 r1, r4, r8",
        "sel r4, r1, r4",
        "ssub8 r1, r5, r8",
        "sel r5, r1, r5",
        "ssub8 r1, r6, r8",
        "sel r6, r1, r6",
        "ssub8 r1, r7, r8",
        "sel r7, r1, r7",
        // Mask of the places where a bit differs from the one below it, in any level but c_0's; pairs of bits that
        // cross lanes are cleared.
        "eor r1, r4, r4, lsl #1",
        "bic r1, r1, #0xff",
        "eor r2, r5, r5, lsl #1",
        "orrs r1, r2",
        "eor r2, r6, r6, lsl #1",
        "orrs r1, r2",
        "eor r2, r7, r7, lsl #1",
        "orrs r1, r2",
        "bics r1, r8",
        "orr r1, r1, r1, lsr #16",
        "orr r1, r1, r1, lsr #8",
        "uxtb r1, r1",
        "orr r1, r1, #1",
        // r2: bits of a level.
        "clz r1, r1",
        "rsb r2, r1, #32",
        // r8: mask of the lowest bits of each lane; levels cut to them go to the stack.
        "lsl r3, r8, r2",
        "sub r8, r3, r8",
        "and r3, r7, r8",
        "and r9, r6, r8",
        "and r10, r5, r8",
        "and r11, r4, r8",
        "rev r3, r3",
        "rev r9, r9",
        "rev r10, r10",
        "rev r11, r11",
        "add r12, sp, #68",
        "stm r12, {{r3, r9, r10, r11}}",
        // r10: the levels, from the last on, below a 1, or 0 if there are none; r3: 2^bits.
        "movs r1, #1",
        "lsl r3, r1, r2",
        "mov r10, #0",
        "mov r11, r10",
        "bics r9, r0, r1",
        "beq 14f",
        "mov r10, r1",
        "sub r12, r12, #16",
        "mov r8, #0x80000000",
        "cmp r2, #4",
        "bhs 9f",
        "13:",
        "clz r1, r9",
        "lsr lr, r8, r1",
        "ldrb r1, [r12, r1]",
        "mla r10, r10, r3, r1",
        "bics r9, r9, lr",
        "bne 13b",
        // r11: bits of the code of the levels' width: one more than the difference between the widest possible
        // level and the widest one, that is, 2 and the bits of n - 1, less the bits of a level.
        "ldr r1, [sp, #64]",
        "lsrs r1, r1, #16",
        "subs r1, #1",
        "clz r1, r1",
        "rsb r11, r1, #34",
        "sub r11, r11, r2",
        // The 1 above the levels must not be lost.
        "clz r1, r10",
        "cmp r1, r11",
        "blo 9f",
        // r10: width and levels, with a 1 above them; r11: their bits.
        "sub r3, r11, #1",
        "lsl r10, r10, r11",
        "movs r2, #1",
        "lsls r2, r3",
        "orr r10, r10, r2",
        "sub r1, r1, r11",
        "lsr r8, r8, r1",
        "eor r10, r10, r8",
        "rsb r11, r1, #31",
        "14:",
        // r3: the code; r8: its bits; r9: the packer's `before` after this pixel. The gap comes first, with a 1 above
        // it.
        "ldrd r1, r2, [sp, #60]",
        "ldr lr, [sp, #8]",
        "ldm lr, {{r3, r9, r12}}",
        "ldr r8, [lr, #12]",
        "subs r3, r1, r3",
        "sub r9, r1, r9",
        "clz lr, r3",
        "sub r12, r12, lr",
        "sub r8, r8, lr, lsl #1",
        "adds r3, r3, r3",
        "adds r3, #1",
        "lsl r3, r3, r12",
        // r2: n, whose code takes its 1 from the gap's code; r1: ON events.
        "uxth r1, r2",
        "lsrs r2, r2, #16",
        "clz lr, r2",
        "rsb lr, lr, #31",
        "adds r2, r2, r2",
        "adds r2, #1",
        "lsl r2, r2, lr",
        "subs r2, #1",
        "lsl r2, r2, r8",
        "adds r3, r3, r2",
        "add r8, r8, lr, lsl #1",
        "add r8, r8, #1",
        // ON events, less the 1 above n's code.
        "subs r1, #1",
        "lsl r1, r1, r8",
        "adds r3, r3, r1",
        "add r8, r8, lr",
        "add r8, r8, #1",
        "cmp r8, #31",
        "bhi 9f",
        // The state is changed from here on.
        "ldr r1, [sp, #8]",
        "str r9, [r1]",
        "ldrd r5, r12, [sp, #16]",
        "ldm r5, {{r6, r9, lr}}",
        "add r12, r12, r6, lsl #2",
        "rsb lr, lr, #32",
        "cmp r8, #16",
        "bls 15f",
        put!("r3", "r8", "r1"),
        "movs r3, #0",
        "mov r8, #0",
        "15:",
        "lsl r0, r0, r8",
        "orrs r3, r0",
        "add r8, r8, #16",
        put!("r3", "r8", "r1"),
        put!("r10", "r11", "r1"),
        "ldr r1, [sp, #20]",
        "sub r12, r12, r1",
        "lsr r8, r12, #2",
        "rsb r10, lr, #32",
        "str r8, [r5]",
        "strd r9, r10, [r5, #4]",
        "ldr r1, [sp, #32]",
        "cmp r8, r1",
        "ldm sp, {{r5-r10}}",
        "ldrd r4, r11, [sp, #24]",
        "bhs 8f",
        "cmp r4, #0",
        "bne 1b",
        "b 6b",
        // More differences than are kept.
        "12:",
        "ldr r0, [sp, #56]",
        "add r1, r0, #52",
        "stm r1, {{r4-r7}}",
        "ldr r1, [sp, #64]",
        "bl {prune}",
        "ldr r1, [sp, #56]",
        "adds r1, #52",
        "ldm r1, {{r4-r7}}",
        "b 10b",
        // Rare: wide levels or a long place.
        "9:",
        "mov r3, r0",
        "ldr r0, [sp, #56]",
        "add r1, r0, #52",
        "stm r1, {{r4-r7}}",
        "ldrd r1, r2, [sp, #60]",
        "bl {bytes_long}",
        "ldm sp, {{r5-r10}}",
        "ldrd r4, r11, [sp, #24]",
        "b 16f",
        // A long gap.
        "7:",
        "add r11, r11, #0x10001",
        "mov r1, r0",
        "mov r2, r3",
        "ldr r0, [sp, #56]",
        "bl {single_long}",
        "16:",
        "ldr r0, [r9]",
        "ldr r1, [sp, #32]",
        "cmp r0, r1",
        "bhs 8f",
        "cmp r4, #0",
        "bne 1b",
        "b 6b",
        // More events than a chunk: restore the state before this pixel.
        "5:",
        "str r2, [r1]",
        "subs r0, r0, r5",
        "movs r1, #1",
        "lsls r1, r0",
        "orrs r4, r1",
        "8:",
        "ldr r0, [sp, #56]",
        "str r4, [r0, #48]",
        "mov r0, r11",
        "add sp, #84",
        "pop {{r4-r11, pc}}",
        next_segment = sym next_segment,
        single_long = sym single_long,
        bytes_long = sym bytes_long,
        prune = sym prune,
        crowded = const (CHUNK_EVENTS + 1) << 16,
        bins_log2 = const BINS_LOG2,
    )
}
