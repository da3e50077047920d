//! The walk of [`crate::pixel_encoder`] over the pixels of the eight-coefficient DCT, with its state
//! in registers.
//!
//! The compiler's own walk takes twice the instructions: it has fewer registers than the walk has
//! state, and moves that to the stack and back at every pixel. The loop in Rust stays for other
//! processors and for probes, which want to know the stage; all give the same bits.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::mem::offset_of;

use crate::bits::{BitWriter, Position};
use crate::fixed_point::CHUNK_EVENTS;
use crate::group::{Group, Lists};
use crate::pack::{Packer, seven_dsp};
use crate::phase::PhaseScale;
use crate::transform::rows::{Cosines, cosines_dsp};
use crate::window::{NO_SLOT, SLOTS_MAX, Slot, Window};

/// What the assembly knows. The first nine words are copied to its stack.
#[repr(C)]
struct Walk<'w, 's, 'o> {
    position: *mut Position,
    words: *mut [u8; 4],
    /// Word from which on the output has no room for another pixel.
    limit: usize,
    /// Slots of the window.
    len: usize,
    cosines: *mut Cosines,
    phase_shift: u32,
    reciprocal: u32,
    /// From u / 2 to the cell.
    cell_shift: u32,
    /// Bits of a single event but for its gap.
    single_bits: u32,
    packer: *mut Packer,
    /// Raster index of the first column of the segment at hand.
    base: u32,
    slots: *const Slot,
    lists: *mut Lists,
    /// Columns of the segment that were not visited.
    columns: u32,
    group: *mut Group,
    window: *mut Window<'s>,
    writer: *mut BitWriter<'o>,
    width: u32,
    /// Ties the pointers to what they point to.
    borrowed: core::marker::PhantomData<&'w mut ()>,
}

/// Encodes pixels up to the window's last, up to one of more than [`CHUNK_EVENTS`] events, which is
/// the group's next then, or until the output has less than `room` words left. Returns events and
/// pixels.
pub fn walk(
    (group, window): (&mut Group, &mut Window<'_>),
    scale: PhaseScale,
    packer: &mut Packer,
    cosines: &mut Cosines,
    (writer, room): (&mut BitWriter<'_>, usize),
) -> (u32, u32) {
    let (phase_shift, reciprocal) = scale.parts();
    let cells_log2 = packer.cells_log2();
    let len = window.slots().len();
    let width = packer.width();
    let writer: *mut BitWriter<'_> = writer;
    // SAFETY: the pointer is that of the reference; both parts are reached through it alone.
    let (position, words, words_len) = unsafe { BitWriter::raw_parts(writer) };
    let mut walk = Walk {
        position,
        words,
        limit: words_len.saturating_sub(room),
        len,
        cosines,
        phase_shift,
        reciprocal,
        cell_shift: 31 - cells_log2,
        single_bits: cells_log2 + 2,
        packer,
        base: 0,
        slots: core::ptr::null(),
        lists: core::ptr::null_mut(),
        columns: 0,
        group,
        window,
        writer,
        width,
        borrowed: core::marker::PhantomData,
    };
    // SAFETY: the pointers are those of exclusive references that outlive the call. `walk_columns`
    // reads slots at the heads of the group's lists, which `Group` keeps below their number, reads
    // and writes the lists at columns below 32, and writes words before `limit` plus `room`, which
    // are there. The build script sets `eecvs_dsp` only for cores that have the instructions.
    let counts = unsafe { walk_columns(&mut walk) };
    group.leave(walk.columns);
    (counts & 0xffff, counts >> 16)
}

// Both counts fit half a word.
const _: () = assert!(SLOTS_MAX <= 0xffff && NO_SLOT == 0xffff);
const _: () = assert!(size_of::<Slot>() == 8 && CHUNK_EVENTS == 64);
const _: () = assert!(offset_of!(Lists, tallies) == 128 && size_of::<Lists>() == 256);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, packer) == 36);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, base) == 40);
const _: () = assert!(offset_of!(Walk<'_, '_, '_>, columns) == 52);

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

/// A pixel that [`seven_dsp::seven`] leaves to others.
unsafe extern "C" fn seven_long(walk: &mut Walk<'_, '_, '_>, index: u32, tally: u32) {
    // SAFETY: see `walk`; nothing else has a reference while this runs.
    let (packer, cosines, writer) =
        unsafe { (&mut *walk.packer, &*walk.cosines, &mut *walk.writer) };
    let on = tally & 0xffff;
    packer.seven_portable(index, (on, (tally >> 16) - on), cosines, writer);
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
        // At sp: 0 position, 4 words, 8 limit, 12 len, 16 cosines, 20 index, 24 tally, 28 walk,
        // 32 phase_shift, 36 reciprocal, 40 cell_shift, 44 single_bits.
        "push {{r4-r11, lr}}",
        "sub sp, #52",
        "str r0, [sp, #28]",
        "ldm r0!, {{r1-r5}}",
        "stm sp, {{r1-r5}}",
        "mov r9, r1",
        "mov r10, r2",
        "ldm r0!, {{r1-r5}}",
        "add r12, sp, #32",
        "stm r12, {{r1-r4}}",
        "mov r7, r5",
        "mov r11, #0",
        "6:",
        "ldr r0, [sp, #28]",
        "bl {next_segment}",
        "movs r4, r0",
        "beq 8f",
        "ldr r0, [sp, #28]",
        "add r0, r0, #40",
        "ldm r0, {{r5, r6, r8}}",
        "1:",
        // r0: raster index; r1: its list; r2: the first slot; r3: its offset; r12: its link.
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
        "ldrd r1, r2, [sp, #32]",
        "lsls r3, r1",
        "ldr lr, [sp, #40]",
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
        "ldr r2, [sp, #44]",
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
        "ldr r3, [sp, #8]",
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
        "strd r0, r3, [sp, #20]",
        "mov r0, r6",
        "ldrd r1, r3, [sp, #12]",
        "bl {cosines}",
        "mov r0, r7",
        "ldr r3, [sp, #16]",
        "ldrd r1, r2, [sp, #20]",
        "bl {seven}",
        "cbz r0, 9f",
        "3:",
        "ldr r0, [r9]",
        "ldr r1, [sp, #8]",
        "cmp r0, r1",
        "bhs 8f",
        "cmp r4, #0",
        "bne 1b",
        "b 6b",
        "9:",
        "ldr r0, [sp, #28]",
        "ldrd r1, r2, [sp, #20]",
        "bl {seven_long}",
        "b 3b",
        "7:",
        "add r11, r11, #0x10001",
        "mov r1, r0",
        "mov r2, r3",
        "ldr r0, [sp, #28]",
        "bl {single_long}",
        "b 3b",
        // As it was before.
        "5:",
        "str r2, [r1]",
        "subs r0, r0, r5",
        "movs r1, #1",
        "lsls r1, r0",
        "orrs r4, r1",
        "8:",
        "ldr r0, [sp, #28]",
        "str r4, [r0, #52]",
        "mov r0, r11",
        "add sp, #52",
        "pop {{r4-r11, pc}}",
        next_segment = sym next_segment,
        cosines = sym cosines_dsp,
        seven = sym seven_dsp::seven,
        seven_long = sym seven_long,
        single_long = sym single_long,
        crowded = const (CHUNK_EVENTS + 1) << 16,
    )
}
