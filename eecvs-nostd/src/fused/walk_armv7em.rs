//! The walk of [`crate::fused`] over pixels, with its state in registers. It encodes pixels of the
//! eight-coefficient DCT completely. For the DTFT it splits segments into columns and packs single events, and
//! leaves pixels of several events to [`crate::fused::dtft32_armv7em`].
//!
//! A compiled walk takes nearly twice the instructions: a compiler has fewer registers than the walk has state, and
//! moves state to the stack and back at every pixel. The loop in Rust serves other processors, and traces that want
//! to know the stage. All give the same bits.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::marker::PhantomData;
use core::mem::offset_of;

use crate::accumulate::dct8;
use crate::accumulate::dct8::Lines;
use crate::accumulate::dct8::armv7em::event;
use crate::encoder::config::Scratch;
use crate::fixed_point::CHUNK_EVENTS;
use crate::fused::dtft32_armv7em;
use crate::fused::dtft32_armv7em::Waves;
use crate::fused::{Shared, Way};
use crate::group::source::{Source, next_segments};
use crate::group::{Entry, Group, Impulses, Pixel};
use crate::pack::bits_lsb_first::{BitWriter, Position};
use crate::pack::packer::Packer;
use crate::pack::packer::code_tables_armv7em::{Counts, SIDE_BITS_MAX, TABLES};
use crate::pack::timed::{self, FewCells};
use crate::stage::Trace;
use crate::transform::Dtft;
use crate::transform::phase::PhaseScale;
use crate::transform::shape::Shape;
use crate::window::{COLUMN_BITS, COLUMN_SHIFT, FIRST, Head, NEXT_SHIFT, NO_SLOT, Slot};
use crate::window::{SLOTS_MAX, Window};

/// Largest number of words that a pixel takes in the assembly: 32 bits of place and width, 71 of levels, and 31
/// that were pending. A single event takes fewer, whatever its gap.
const WORDS_MAX: usize = 4;
/// Offset in a slot of the next slot's number.
const NEXT_AT: usize = 6;

/// The state of the assembly. The first part is copied to its stack, and back from `base` on.
#[repr(C)]
struct Walk<'w, 's, 'o> {
    // The four that an event needs come first.
    lines: *const Lines,
    slots: *mut Slot,
    phase_shift: u32,
    reciprocal: u32,
    /// Shift from u / 2 to the cell.
    cell_shift: u32,
    /// 33 plus the bits of a cell.
    single_bits: u32,
    /// From here on the output has no room for another pixel.
    limit: *mut [u8; 4],
    /// Shift from sums to levels.
    level_shift: u32,
    /// Bits of a level of one event, less 2.
    level_bits: u32,
    counts: *const Counts,
    /// Like `limit`, for a pixel that the assembly leaves to [`seven_long`].
    limit_long: *mut [u8; 4],
    heads: *mut Head,
    /// Number of segments in a row, and of the columns that they have beyond the sensor's.
    stride: u32,
    beyond: u32,
    entries: *mut Entry,
    /// Raster index of the first column of the current segment.
    base: u32,
    /// Distance to `base` from the raster index after the last pixel.
    since: u32,
    /// Those of 32 segments that are still to be visited.
    segments: u32,
    /// The first of the 32 segments.
    first_segment: u32,
    /// On return, the raster index after the last pixel.
    next_index: u32,
    /// Columns of the segment that were not visited, the first one highest.
    columns: u32,
    /// Addresses of the first slot's link, and of the next slot's number in it.
    links: *mut u8,
    nexts: *mut u8,
    /// 2 2^g + 1. With twice the gap added, and zeros in front, this is a gap's code of order g.
    gap: u32,
    /// The same as `slots`.
    slots_again: *mut Slot,
    // Not copied.
    position: *mut Position,
    words: *mut [u8; 4],
    /// Sums that the assembly leaves to [`seven_long`].
    sums: [i32; 7],
    /// The assembly does not handle a pixel whose tally is this or more.
    tally_limit: u32,
    /// The assembly leaves a pixel whose tally is this or more to the caller.
    crowded: u32,
    /// Encodes pixels of several events as times, unless it is null.
    few: *const Few,
    /// Encodes the DTFT's pixels of several events.
    waves: *mut Waves<'w>,
    packer: *mut Packer,
    source: Source<'s>,
    writer: *mut BitWriter<'o>,
    /// Ties the pointers to what they point to.
    borrowed: PhantomData<&'w mut ()>,
}

/// How pixels of few events are sent as times.
struct Few {
    cells: FewCells,
    scale: PhaseScale,
}

/// DTFT coefficients and the output's state in registers: [`crate::fused::is_waves`].
pub struct InRegisters;

impl Way for InRegisters {
    type Basis = Dtft;
    type Memory<'p> = Waves<'p>;

    const HAS_WALK: bool = true;

    #[inline(always)]
    fn words_max(shape: Shape) -> usize {
        dtft32_armv7em::words_max(shape)
    }

    #[inline(always)]
    fn memory<'p>(shared: &Shared, scratch: &'p mut Scratch<'_>) -> Option<Waves<'p>> {
        let memory = (&mut *scratch.sums, &mut *scratch.magnitudes);
        Waves::new(shared.shape, shared.scale, memory, &shared.packer)
    }

    #[inline(always)]
    fn walk(
        shared: &mut Shared,
        waves: &mut Waves<'_>,
        input: (&mut Group, &mut Window<'_>),
        output: (&mut BitWriter<'_>, usize),
    ) -> (u32, u32) {
        walk(input, shared.scale, &mut shared.packer, output, Some(waves))
    }

    #[inline(always)]
    fn encode<T: Trace>(
        shared: &mut Shared,
        waves: &mut Waves<'_>,
        pixel: Pixel,
        slots: &[Slot],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        let gap = 2 * shared.packer.step((pixel.x, pixel.y)) + 1;
        let tally = ((pixel.on + pixel.off) << 16) | pixel.on;
        let impulses = Impulses::new(pixel, slots);
        waves.encode((gap, tally), &impulses, &shared.packer, writer, trace);
    }
}

/// Encodes pixels up to the window's last one, up to one of more than [`CHUNK_EVENTS`] events, which the group then
/// returns next, or until the output has less than `room` words left. Returns the number of events and of pixels.
/// `waves` is given for the DTFT only.
pub fn walk(
    input: (&mut Group, &mut Window<'_>),
    scale: PhaseScale,
    packer: &mut Packer,
    output: (&mut BitWriter<'_>, usize),
    waves: Option<&mut Waves<'_>>,
) -> (u32, u32) {
    let crowded = (CHUNK_EVENTS as u32 + 1) << 16;
    let (tally_limit, waves): (_, *mut Waves<'_>) = match waves {
        Some(waves) => (2 << 16, waves),
        None => (crowded, core::ptr::null_mut()),
    };
    let limits = (tally_limit, crowded);
    walk_to(limits, input, (scale, packer), output, (waves.cast(), None))
}

/// As [`walk`], for pixels of the DCT or the DTFT that are sent as times: up to one that is not.
pub fn walk_times(
    input: (&mut Group, &mut Window<'_>),
    (scale, cells): (PhaseScale, FewCells),
    packer: &mut Packer,
    output: (&mut BitWriter<'_>, usize),
) -> (u32, u32) {
    let crowded = (u32::from(packer.packing.timed.events_max()) + 1) << 16;
    let few = Few { cells, scale };
    let ways = (core::ptr::null_mut(), Some(&few));
    walk_to((2 << 16, crowded), input, (scale, packer), output, ways)
}

/// Encodes pixels up to the window's last one or one whose tally is `crowded` or more, or until the output has less
/// than `room` words left. Pixels whose tally is `tally_limit` or more are encoded by one of the ways.
#[inline(never)]
fn walk_to(
    (tally_limit, crowded): (u32, u32),
    (group, window): (&mut Group, &mut Window<'_>),
    (scale, packer): (PhaseScale, &mut Packer),
    (writer, room): (&mut BitWriter<'_>, usize),
    (waves, few): (*mut Waves<'_>, Option<&Few>),
) -> (u32, u32) {
    let (phase_shift, reciprocal) = scale.parts();
    let cells_log2 = packer.cells_log2();
    let (level_shift, one_bits) = packer.level_parts();
    let (order, next_index) = packer.gap_parts();
    let width = u32::from(window.config().sensor.width);
    let (x, y) = (group.segment_x, group.segment_y);
    let columns = group.columns.reverse_bits();
    let base = if columns == 0 {
        next_index
    } else {
        u32::from(y) * width + u32::from(x)
    };
    let (slots, heads, stride) = window.parts();
    let slots_at: *mut u8 = slots.as_mut_ptr().cast();
    let writer: *mut BitWriter<'_> = writer;
    // SAFETY: the pointer is that of the reference; both parts are accessed only through it.
    let (position, words, words_len) = unsafe { BitWriter::raw_parts(writer) };
    let mut walk = Walk {
        lines: &dct8::LINES,
        slots: slots.as_mut_ptr(),
        phase_shift,
        reciprocal,
        cell_shift: 31 - cells_log2,
        single_bits: 33 + cells_log2,
        limit: words.wrapping_add(words_len.saturating_sub(WORDS_MAX)),
        level_shift,
        level_bits: one_bits.wrapping_sub(2),
        counts: &TABLES.counts,
        limit_long: words.wrapping_add(words_len.saturating_sub(room)),
        heads: heads.as_mut_ptr(),
        stride: stride.get(),
        beyond: (stride.get() << COLUMN_BITS) - width,
        entries: group.entries.as_mut_ptr(),
        base,
        since: base.wrapping_sub(next_index),
        segments: group.segments,
        first_segment: group.first_segment,
        next_index,
        columns,
        links: slots_at.wrapping_add(NEXT_AT - 2),
        nexts: slots_at.wrapping_add(NEXT_AT),
        gap: (2 << order) + 1,
        slots_again: slots.as_mut_ptr(),
        position,
        words,
        tally_limit,
        crowded,
        few: few.map_or(core::ptr::null(), core::ptr::from_ref),
        sums: [0; 7],
        waves,
        packer,
        source: Source { group, window },
        writer,
        borrowed: PhantomData,
    };
    // SAFETY: the pointers are those of exclusive references that outlive the call, but for `few`, whose reference is
    // shared, and which is only read. `walk_columns` reads and writes
    // heads of segments that the window's bitmap has, and slots at heads and links; `Window` has made all of these
    // from slots that it has filled, or `Group` or this walk from entries made of those. It reads and writes
    // entries of columns below 32; reads the tables at rows below 512 and at counts up to a chunk's; and writes
    // words before `limit` plus `room`, which exist. This file is built only for cores that have the instructions.
    let counts = unsafe { walk_columns(&mut walk) };
    // SAFETY: the references from which the pointers were made are not used before this.
    let (group, packer) = unsafe { (&mut *walk.source.group, &mut *walk.packer) };
    group.segments = walk.segments;
    group.first_segment = walk.first_segment;
    group.columns = walk.columns.reverse_bits();
    if walk.columns != 0 {
        // Never 0; the checked division leaves no panic in the code.
        let y = walk.base.checked_div(width).unwrap_or(0);
        (group.segment_x, group.segment_y) = ((walk.base - y * width) as u16, y as u16);
    }
    packer.go_to(walk.next_index);
    (counts & 0xffff, counts >> 16)
}

// The assembly relies on these: both counts fit half a word, and the sign of a link marks the list's end.
const _: () = assert!(SLOTS_MAX < 0x8000 && NO_SLOT >= 0x8000);
const _: () = assert!(size_of::<Slot>() == 8 && NEXT_SHIFT == 16 && CHUNK_EVENTS < 64);
const _: () = assert!(size_of::<Entry>() == 8 && offset_of!(Entry, tally) == 4);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, base) == 60);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, counts) == 36);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, position) == 100);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, sums) == 108);
const _: () =
    assert!(offset_of!(Walk<'_, '_, '_>, few) == offset_of!(Walk<'_, '_, '_>, crowded) + 4);

/// Packs a single event whose code is longer than 31 bits. `gap` is twice the sum of its gap and 2^g, plus 1.
unsafe extern "C" fn single_long(walk: &mut Walk<'_, '_, '_>, gap: u32, rest: u32) {
    // SAFETY: see `walk_to`; nothing else has a reference while this runs.
    let (packer, writer) = unsafe { (&mut *walk.packer, &mut *walk.writer) };
    packer.single_after(gap >> 1, rest, writer);
}

/// Packs a pixel whose levels have more than 10 bits or whose place has more than 31. Its sums are in `walk`; `gap`
/// is as in [`single_long`].
unsafe extern "C" fn seven_long(walk: &mut Walk<'_, '_, '_>, gap: u32, tally: u32) {
    // SAFETY: see `walk_to`; nothing else has a reference while this runs.
    let (packer, writer) = unsafe { (&mut *walk.packer, &mut *walk.writer) };
    let on = tally & 0xffff;
    packer.seven_after(gap >> 1, (on, (tally >> 16) - on), &walk.sums, writer);
}

/// Returns the kept coefficients of a DTFT pixel of two events up to a chunk, whose list begins at `head`. Leaves
/// its sums where [`dtft32_armv7em::put`] reads them.
unsafe extern "C" fn choose(walk: &mut Walk<'_, '_, '_>, tally: u32, head: u32) -> u32 {
    // SAFETY: see `walk_to`; nothing else has a reference while this runs, and this is called only if there are
    // `Waves`.
    let (waves, window) = unsafe { (&mut *walk.waves, &mut *walk.source.window) };
    waves.choose_largest((tally, head), window.slots(), &mut ())
}

/// Packs a pixel of few events as their times; `gap` is as in [`single_long`], and the pixel's list begins at `head`.
unsafe extern "C" fn times(walk: &mut Walk<'_, '_, '_>, gap: u32, tally: u32, head: u32) {
    // SAFETY: see `walk_to`; nothing else has a reference while this runs, and this is called only if there is a `Few`.
    let (few, packer, window) = unsafe { (&*walk.few, &*walk.packer, &mut *walk.source.window) };
    // SAFETY: as above.
    let writer = unsafe { &mut *walk.writer };
    let events = tally >> 16;
    let on = tally & 0xffff;
    let counts = (on, events - on);
    packer.place_after(gap >> 1, counts, writer);
    let impulses = Impulses::from_slot(window.slots(), head);
    timed::put_pixel(&impulses, counts, (few.cells.of(events), few.scale), writer);
}

/// Packs a DTFT pixel that [`dtft32_armv7em::put`] does not handle; `gap` is as in [`single_long`].
unsafe extern "C" fn wave_long(walk: &mut Walk<'_, '_, '_>, gap: u32, tally: u32, kept: u32) {
    // SAFETY: as for `choose`.
    let (waves, packer) = unsafe { (&mut *walk.waves, &*walk.packer) };
    // SAFETY: as above.
    let writer = unsafe { &mut *walk.writer };
    waves.put_long((gap >> 1, tally), kept, packer, writer);
}

/// Appends `$value`, which must have no bits beyond its `$bits`, at most 32; overwrites `$bits`.
///
/// r9: bits of the next word; r8: 0; `$at`: the bit where the value goes; `$to`: the bit after the value, in
/// another register; r12: where the word goes.
macro_rules! put {
    ($value:literal, $bits:literal, $at:literal, $to:literal) => {
        concat!(
            // r8 holds what the word has no room for.
            "umlal r9, r8, ",
            $value,
            ", ",
            $at,
            "\n",
            "lsls ",
            $to,
            ", ",
            $at,
            ", ",
            $bits,
            "\n",
            "bne 2f\n",
            "str r9, [r12], #4\n",
            "mov r9, r8\n",
            "mov r8, #0\n",
            "rsb ",
            $bits,
            ", ",
            $bits,
            ", #0\n",
            "ror ",
            $to,
            ", ",
            $at,
            ", ",
            $bits,
            "\n",
            "2:"
        )
    };
}

/// Converts the sums in r4 to r10 to levels; r2 holds the shift.
macro_rules! levels {
    () => {
        "asr r4, r4, r2
        asr r5, r5, r2
        asr r6, r6, r2
        asr r7, r7, r2
        asr r8, r8, r2
        asr r9, r9, r2
        asr r10, r10, r2"
    };
}

/// Walks the columns; returns pixels << 16 plus events.
///
/// # Safety
/// All pointers in `walk` must be valid as described in [`walk`].
#[unsafe(naked)]
unsafe extern "C" fn walk_columns(walk: &mut Walk<'_, '_, '_>) -> u32 {
    naked_asm!(
        // | r4 | r5 | r6 | r7 | r8 | r9 | r10 | r11 | r12 |
        // |---|---|---|---|---|---|---|---|---|
        // | columns from r7's on, the first one highest | gap | slots | next entry | 0 | bits of the
        // next word | the bit after them | pixels, events and 2^15 | where the word goes |
        //
        // At sp: the walk's first part; 100: r1 and r3 to lr; 148: code, 152: its bits; 156: walk.
        "push {{r4-r11, lr}}",
        "sub sp, #164",
        "str r0, [sp, #156]",
        "mov lr, sp",
        "ldm r0!, {{r1-r11}}",
        "stm lr!, {{r1-r11}}",
        "ldm r0!, {{r1-r11}}",
        "stm lr!, {{r1-r11}}",
        "ldm r0, {{r1-r3}}",
        "stm lr, {{r1-r3}}",
        "ldr r1, [r0, #{tally_limit} - {copied}]",
        "str r1, [sp, #160]",
        "ldr r1, [r0, #{waves} - {copied}]",
        "adds r1, #{common}",
        "str r1, [sp, #132]",
        "bl 40f",
        "mov r11, #0x8000",
        "mov r8, #0",
        "ldrd r5, r6, [sp, #92]",
        "ldr r7, [sp, #56]",
        "ldr r4, [sp, #80]",
        "cmp r4, #0",
        "bne 13f",
        // The next segment. r1: segments; r2: the first segment, then this one; r4: raster index after the last
        // pixel.
        "6:",
        "ldrd r0, r1, [sp, #56]",
        "subs r7, r7, r0",
        "add r4, r1, r7, lsr #3",
        "ldrd r1, r2, [sp, #68]",
        "15:",
        "mov lr, #{first}",
        "clz r3, r1",
        "adds r2, r2, r3",
        "lsrs r3, lr, r3",
        "beq 14f",
        "eors r1, r3",
        "str r1, [sp, #68]",
        "ldrd r0, r1, [sp, #44]",
        "udiv r3, r2, r1",
        "ldrh r5, [r0, r2, lsl #1]",
        "strh r11, [r0, r2, lsl #1]",
        "ldrd r0, r7, [sp, #52]",
        "lsls r2, r2, #{column_bits}",
        "mls r2, r3, r0, r2",
        "subs r4, r2, r4",
        "strd r2, r4, [sp, #60]",
        // Its list, newest first, is split into the columns' lists, oldest first. r5: slot; r3: its link.
        "mov r4, #0",
        "ldrd r6, r8, [sp, #84]",
        "3:",
        "ldr r3, [r6, r5, lsl #3]",
        "ubfx r0, r3, #{column_at}, #{column_bits}",
        "add r1, r7, r0, lsl #3",
        "ror r0, lr, r0",
        "orr r4, r4, r0",
        "ldrd r0, r2, [r1]",
        "uxtab r2, r2, r3",
        "add r2, r2, #0x10000",
        "strd r5, r2, [r1]",
        "strh r0, [r8, r5, lsl #3]",
        "asrs r5, r3, #16",
        "bpl 3b",
        "ldrd r5, r6, [sp, #92]",
        "mov r8, #0",
        // The first pixel of a segment.
        "13:",
        "ldr r2, [sp, #64]",
        "clz r0, r4",
        "lsl r4, r4, r0",
        "add r7, r7, r0, lsl #3",
        "adds r0, r0, r2",
        "add r1, r5, r0, lsl #1",
        "b 4f",
        // The next pixel of a segment.
        "1:",
        "clz r0, r4",
        "lsl r4, r4, r0",
        "add r7, r7, r0, lsl #3",
        "add r1, r5, r0, lsl #1",
        // r1: the gap's code without its zeros; lr: first slot; r3: tally. The entry is emptied: 2^15 as its head
        // ends a list.
        "4:",
        "ldrd lr, r3, [r7], #8",
        "strd r11, r8, [r7, #-8]",
        "cmp r3, #0x20000",
        "bhs 5f",
        // One event. r3: the cell, and the polarity in the lowest bit.
        "ldr r2, [r6, lr, lsl #3]",
        "ldrd r0, lr, [sp, #8]",
        "lsls r2, r0",
        "umull r0, r2, r2, lr",
        "ldrd r0, lr, [sp, #16]",
        "lsrs r2, r0",
        "bfi r3, r2, #1, #31",
        // r0: the gap's code, with the 1 above it that is n's; r2: 32 less the bits of both, by which the rest is
        // rotated right to follow them; lr: bits of all.
        "clz r0, r5",
        "clz r2, r1",
        "subs r0, r0, r2",
        "subs r2, r2, r0",
        "lsl r0, r1, r0",
        "rors r3, r2",
        "orrs r0, r3",
        "sub lr, lr, r2",
        "lsls r2, r10, lr",
        "beq 2f",
        "umlal r9, r8, r0, r10",
        "mov r10, r2",
        "add r11, r11, #0x10001",
        "lsls r4, r4, #1",
        "bne 1b",
        "b 6b",
        // A word is complete: what it has no room for begins the next word.
        "2:",
        "cmp lr, #31",
        "bhi 7f",
        "umlal r9, r8, r0, r10",
        "add r11, r11, #0x10001",
        "str r9, [r12], #4",
        "mov r9, r8",
        "mov r8, #0",
        "rsb lr, lr, #0",
        "ror r10, r10, lr",
        "ldr r0, [sp, #24]",
        "cmp r12, r0",
        "bhs 12f",
        "lsls r4, r4, #1",
        "bne 1b",
        "b 6b",
        // Several events. r2: n.
        "5:",
        "ldr r2, [sp, #160]",
        "cmp r3, r2",
        "bhs 16f",
        "add r11, r11, #0x10000",
        "lsrs r2, r3, #16",
        "add r11, r11, r2",
        "add r0, sp, #100",
        "stm r0, {{r1, r3-r12, lr}}",
        // r4: the gap's code; r6: its bits.
        "clz r6, r5",
        "clz r7, r1",
        "subs r6, r6, r7",
        "lsl r4, r1, r6",
        "subs r7, r7, r6",
        "rsb r6, r7, #31",
        // The counts after it. r8: bits of everything and of the levels' width, without the leading zeros of the
        // widest level and without its 1, which comes with the levels.
        "ldrd r8, r9, [sp, #32]",
        "add r9, r9, r2, lsl #3",
        "ldrd r9, r10, [r9]",
        "smlabt r3, r3, r9, r10",
        "lsls r3, r6",
        "adds r4, r4, r3",
        "sub r8, r8, r7",
        "uxtah r8, r8, r9",
        "strd r4, r8, [sp, #148]",
        event!("smuad", "", "", "", "", "", "", ""),
        "asr lr, lr, #16",
        "3:",
        event!("smlad", ", r4", ", r5", ", r6", ", r7", ", r8", ", r9", ", r10"),
        // A negative link ends the list.
        "asrs lr, lr, #16",
        "bpl 3b",
        // r1: leading zeros of the mask of bits that differ from the sign bit in at least one level.
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
        "ldr r2, [sp, #28]",
        "lsrs r0, r2",
        "clz r1, r0",
        // r0: bits of a level; r3: the code; lr: its bits.
        "ldrd r3, lr, [sp, #148]",
        "rsb r0, r1, #33",
        "add lr, lr, r1",
        "cmp r0, #{side_bits_max}",
        "bhi 11f",
        "rsbs r1, lr, #32",
        "blo 9f",
        // The carry is 1 from here on.
        levels!(),
        // r1: 2^bits; r2 and r11: the highest bit of each of three fields and of four.
        "ldr r2, [sp, #36]",
        "sub r2, r2, r0, lsl #4",
        "ldm r2, {{r1, r2, r11}}",
        // Three levels side by side in r4, four in r7.
        "mla r5, r6, r1, r5",
        "mla r4, r5, r1, r4",
        "mla r9, r10, r1, r9",
        "mla r8, r9, r1, r8",
        "mla r7, r8, r1, r7",
        // A negative level has borrowed from its neighbour; adding half a range gives that back.
        "add r4, r4, r2",
        "eor r4, r4, r2",
        "add r7, r7, r11",
        "eor r7, r7, r11",
        // The 1 of the levels' width goes before the three levels.
        "adc r4, r4, r4",
        "adc r5, r0, r0, lsl #1",
        "add r1, sp, #124",
        "ldm r1, {{r8-r12}}",
        put!("r3", "lr", "r10", "r1"),
        put!("r4", "r5", "r1", "r2"),
        "lsls r0, r0, #2",
        put!("r7", "r0", "r2", "r10"),
        "17:",
        "add r0, sp, #108",
        "ldm r0, {{r4-r7}}",
        "ldr r1, [sp, #24]",
        "cmp r12, r1",
        "bhs 12f",
        "lsls r4, r4, #1",
        "bne 1b",
        "b 6b",
        // Four levels of more than 8 bits exceed a word: three go to r7 and one to r6.
        "11:",
        "cmp r0, #10",
        "bhi 9f",
        "rsbs r1, lr, #32",
        "blo 9f",
        levels!(),
        // r1: 2^bits; r11: half of it.
        "mov r11, #1",
        "lsl r1, r11, r0",
        "lsr r11, r1, #1",
        "mla r5, r6, r1, r5",
        "mla r4, r5, r1, r4",
        "mla r6, r11, r1, r11",
        "mla r6, r6, r1, r11",
        "mla r8, r9, r1, r8",
        "mla r7, r8, r1, r7",
        "add r4, r4, r6",
        "eor r4, r4, r6",
        "add r7, r7, r6",
        "eor r7, r7, r6",
        "add r6, r10, r11",
        "eor r6, r6, r11",
        "adc r4, r4, r4",
        "adc r5, r0, r0, lsl #1",
        "add r1, sp, #124",
        "ldm r1, {{r8-r12}}",
        put!("r3", "lr", "r10", "r1"),
        "sub lr, r5, #1",
        put!("r4", "r5", "r1", "r2"),
        put!("r7", "lr", "r2", "r1"),
        put!("r6", "r0", "r1", "r10"),
        "b 17b",
        // Rare: wide levels or a long place.
        "9:",
        "ldr r0, [sp, #156]",
        "adds r0, #{sums}",
        "stm r0, {{r4-r10}}",
        "add r0, sp, #108",
        "ldm r0, {{r4-r12}}",
        "ldr r0, [sp, #40]",
        "cmp r12, r0",
        "bhs 19f",
        "bl 41f",
        "ldr r0, [sp, #156]",
        "ldrd r1, r2, [sp, #100]",
        "bl {seven_long}",
        "b 10f",
        // A long gap. r3 is restored to its value before it was rotated.
        "7:",
        "ldr r2, [sp, #20]",
        "sub r2, lr, r2",
        "rors r3, r2",
        "strd r1, r3, [sp, #100]",
        "add r11, r11, #0x10001",
        "bl 41f",
        "ldr r0, [sp, #156]",
        "ldrd r1, r2, [sp, #100]",
        "bl {single_long}",
        "10:",
        "bl 40f",
        "ldr r0, [sp, #24]",
        "cmp r12, r0",
        "bhs 12f",
        "lsls r4, r4, #1",
        "bne 1b",
        "b 6b",
        // The next 32 segments.
        "14:",
        "str r12, [sp, #140]",
        "ldr r0, [sp, #156]",
        "adds r0, #{source}",
        "add r1, sp, #72",
        "bl {next_segments}",
        "ldr r12, [sp, #140]",
        "ldr r2, [sp, #72]",
        "movs r1, r0",
        "bne 15b",
        "strd r4, r1, [sp, #76]",
        "b 18f",
        // Not enough room, if the pixel should be the longest possible.
        "19:",
        "ldrd r1, r3, [sp, #100]",
        "ldr lr, [sp, #144]",
        "sub r11, r11, #0x10000",
        "sub r11, r11, r3, lsr #16",
        "b 20f",
        // Another transform's pixel. r3: tally; lr: first slot.
        "16:",
        "ldr r2, [sp, #156]",
        "ldrd r0, r2, [r2, #{crowded}]",
        "cmp r3, r0",
        "bhs 20f",
        "ldr r0, [sp, #40]",
        "cmp r12, r0",
        "bhs 20f",
        "add r11, r11, #0x10000",
        "add r11, r11, r3, lsr #16",
        "add r0, sp, #100",
        "stm r0, {{r1, r3, r4, r7, r11, r12, lr}}",
        "cmp r2, #0",
        "bne 24f",
        "ldr r7, [sp, #132]",
        "cmp r3, #0x30000",
        "bhs 22f",
        "mov r0, r7",
        "mov r1, r6",
        "mov r2, lr",
        "bl {two}",
        "bne 23f",
        "22:",
        "ldr r0, [sp, #156]",
        "ldr r1, [sp, #104]",
        "ldr r2, [sp, #124]",
        "bl {choose}",
        "23:",
        "mov r3, r0",
        "mov r0, r7",
        "ldrd r1, r2, [sp, #100]",
        "ldr r12, [sp, #120]",
        "bl {put}",
        "ldrd r5, r6, [sp, #92]",
        "add r1, sp, #108",
        "ldm r1, {{r4, r7, r11}}",
        "beq 21f",
        "ldr r0, [sp, #24]",
        "cmp r12, r0",
        "bhs 12f",
        "lsls r4, r4, #1",
        "bne 1b",
        "b 6b",
        // r3 as `put` has left it.
        "21:",
        "str r3, [sp, #128]",
        "bl 41f",
        "ldr r0, [sp, #156]",
        "ldrd r1, r2, [sp, #100]",
        "ldr r3, [sp, #128]",
        "bl {wave_long}",
        "b 10b",
        // Few events, as times. What a call does not preserve is the writer's.
        "24:",
        "bl 41f",
        "ldr r0, [sp, #156]",
        "ldrd r1, r2, [sp, #100]",
        "ldr r3, [sp, #124]",
        "bl {times}",
        "b 10b",
        // More events than a chunk: restore the state before this pixel.
        "20:",
        "strd lr, r3, [r7, #-8]!",
        "subs r1, r1, r5",
        "rsb r5, r1, #0",
        "asrs r5, r5, #1",
        "b 8f",
        // After a pixel.
        "12:",
        "lsls r4, r4, #1",
        "movs r5, #0",
        "8:",
        "ldrd r0, r1, [sp, #56]",
        "subs r7, r7, r0",
        "lsrs r7, r7, #3",
        "adds r5, r5, r7",
        "adds r1, r1, r5",
        "lsrs r4, r7",
        "strd r1, r4, [sp, #76]",
        "18:",
        "bl 41f",
        "ldr r0, [sp, #156]",
        "adds r0, #60",
        "add r1, sp, #60",
        "ldm r1, {{r1-r6}}",
        "stm r0, {{r1-r6}}",
        "sub r0, r11, #0x8000",
        "add sp, #164",
        "pop {{r4-r11, pc}}",
        // Loads r9, r10 and r12 from the writer's position.
        "40:",
        "ldr r0, [sp, #156]",
        "ldrd r1, r2, [r0, #{position}]",
        "ldm r1, {{r1, r9, r10}}",
        "add r12, r2, r1, lsl #2",
        "rsb r10, r10, #32",
        "movs r0, #1",
        "lsl r10, r0, r10",
        "bx lr",
        // Stores them back.
        "41:",
        "ldr r0, [sp, #156]",
        "ldrd r1, r2, [r0, #{position}]",
        "sub r2, r12, r2",
        "lsrs r2, r2, #2",
        "rbit r3, r10",
        "clz r3, r3",
        "rsb r3, r3, #32",
        "str r2, [r1]",
        "strd r9, r3, [r1, #4]",
        "bx lr",
        next_segments = sym next_segments,
        source = const offset_of!(Walk<'_, '_, '_>, source),
        seven_long = sym seven_long,
        choose = sym choose,
        wave_long = sym wave_long,
        put = sym dtft32_armv7em::put,
        two = sym dtft32_armv7em::two,
        waves = const offset_of!(Walk<'_, '_, '_>, waves),
        common = const offset_of!(Waves<'_>, common),
        tally_limit = const offset_of!(Walk<'_, '_, '_>, tally_limit),
        copied = const offset_of!(Walk<'_, '_, '_>, position) - 12,
        single_long = sym single_long,
        crowded = const offset_of!(Walk<'_, '_, '_>, crowded),
        times = sym times,
        first = const FIRST,
        column_at = const COLUMN_SHIFT,
        column_bits = const COLUMN_BITS,
        position = const offset_of!(Walk<'_, '_, '_>, position),
        sums = const offset_of!(Walk<'_, '_, '_>, sums),
        side_bits_max = const SIDE_BITS_MAX,
        distance_at = const dct8::DISTANCE_AT,
        distance_bits = const dct8::DISTANCE_BITS,
        one = const dct8::ONE << 16,
        row_at = const dct8::ROW_AT,
        rows_log2 = const dct8::ROWS_LOG2,
    )
}
