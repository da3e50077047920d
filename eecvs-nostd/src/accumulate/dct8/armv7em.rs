//! Computes the sums of [`dct8`] and [`dct16`] over a pixel's list with all sums in registers.
//!
//! This leaves a compiler too few registers for the rest: it takes over 50 instructions per event instead of 28,
//! and over 100 instead of 46. The loops in Rust serve other processors, and impulses that are not a list. All give
//! the same bits.
#![allow(unsafe_code)]

use core::arch::naked_asm;

use crate::accumulate::{dct8, dct16};
use crate::fixed_point::{CHUNK_EVENTS, Sum};
use crate::group::Impulses;
use crate::transform::phase::PhaseScale;
use crate::window::{NEXT_SHIFT, NO_SLOT, SLOTS_MAX, Slot};

/// Adds the atoms of the event in slot lr to r4 to r10, or starts the sums with them, as [`dct8::cosines`] does.
/// Leaves the slot's link in lr.
///
/// The stack holds the lines, the slots, and the shift and factor of [`PhaseScale::half`].
macro_rules! event {
    ($begin:literal, $r4:literal, $r5:literal, $r6:literal, $r7:literal, $r8:literal, $r9:literal,
        $r10:literal) => {
        concat!(
            "ldm sp, {{r0, r1, r2, r3}}\n",
            "add r1, r1, lr, lsl #3\n",
            "ldrd r1, lr, [r1]\n",
            // r1: u / 2.
            "lsls r1, r2\n",
            "umull r3, r1, r1, r3\n",
            // r2: all ones in the second half of the window; r1: the distance from the nearer edge.
            "sbfx r2, r1, #30, #1\n",
            "eors r1, r2\n",
            // r3: all ones for an ON event.
            "sbfx r3, lr, #0, #1\n",
            // r12: the weights for even k; r11: for odd k, whose sign the second half changes.
            "ubfx r11, r1, #{distance_at}, #{distance_bits}\n",
            "orr r11, r11, #{one}\n",
            "eor r12, r11, r3\n",
            "ssub16 r12, r12, r3\n",
            "eor r11, r12, r2\n",
            "ssub16 r11, r11, r2\n",
            // r1: the row.
            "ubfx r1, r1, #{row_at}, #{rows_log2}\n",
            "add r1, r0, r1, lsl #5\n",
            "ldm r1!, {{r0, r2, r3}}\n",
            $begin,
            " r4, r0, r11",
            $r4,
            "\n",
            $begin,
            " r5, r2, r12",
            $r5,
            "\n",
            $begin,
            " r6, r3, r11",
            $r6,
            "\n",
            "ldm r1, {{r0, r1, r2, r3}}\n",
            $begin,
            " r7, r0, r12",
            $r7,
            "\n",
            $begin,
            " r8, r1, r11",
            $r8,
            "\n",
            $begin,
            " r9, r2, r12",
            $r9,
            "\n",
            $begin,
            " r10, r3, r11",
            $r10
        )
    };
}
pub(crate) use event;

/// [`dct8::of_list`] for grids of [`dct8::GRID`], and of more, up to [`dct16::GRID`].
#[inline(always)]
pub(crate) fn of_list<'s>(
    impulses: &Impulses<'s>,
    scale: PhaseScale,
    grid: usize,
    sums: &mut [Sum],
    otherwise: impl FnOnce(&mut [Sum]),
) -> Option<Impulses<'s>> {
    if grid == dct8::GRID
        && let Some((_, sums)) = sums.split_first_mut()
        && let Some(sums) = sums.first_chunk_mut()
    {
        return Some(seven(impulses, scale, sums));
    }
    if grid > dct8::GRID
        && grid <= dct16::GRID
        && let Some(sums) = sums.first_chunk_mut()
    {
        return Some(fifteen(impulses, scale, sums));
    }
    otherwise(sums);
    None
}

/// Writes sum p cos(pi k u) for k = 1..8 over the first impulses, at most a chunk of them, with the bits of
/// [`dct8::cosines`]; returns the remaining impulses.
#[inline(always)]
pub fn seven<'s>(
    impulses: &Impulses<'s>,
    scale: PhaseScale,
    sums: &mut [Sum; dct8::GRID - 1],
) -> Impulses<'s> {
    let (slots, next) = impulses.parts();
    if next as usize >= slots.len() {
        *sums = [Sum::ZERO; dct8::GRID - 1];
        return impulses.clone();
    }
    let (shift, reciprocal) = scale.parts();
    // SAFETY: each link of a list of `Impulses` is an existing slot or the list's end. `add_seven` reads those
    // slots and lines of rows below 512, and writes the sums. This file is built only for cores that have the
    // instructions.
    let next = unsafe { add_seven(slots.as_ptr(), next, &[shift, reciprocal], sums) };
    impulses.after(next)
}

/// Writes sum p cos(pi k u) for k = 1..16 over the first impulses, at most a chunk of them, with the bits of
/// [`dct16::cosines`]; returns the remaining impulses. The sum of k = 0 is left as it is.
#[inline(always)]
pub fn fifteen<'s>(
    impulses: &Impulses<'s>,
    scale: PhaseScale,
    sums: &mut [Sum; dct16::GRID],
) -> Impulses<'s> {
    let (slots, next) = impulses.parts();
    if next as usize >= slots.len() {
        sums[1..].fill(Sum::ZERO);
        return impulses.clone();
    }
    let (shift, reciprocal) = scale.parts();
    // SAFETY: as for `seven`; rows are below 1,024.
    let next = unsafe { add_fifteen(slots.as_ptr(), next, &[shift, reciprocal], sums) };
    impulses.after(next)
}

// The assembly relies on these: the sign of a link marks the list's end, and the three bits below the next slot's
// number are bits of the column, which all slots of a list share.
const _: () = assert!(SLOTS_MAX < 0x8000 && NO_SLOT >= 0x8000 && NEXT_SHIFT == 16);
const _: () = assert!(size_of::<Slot>() == 8 && size_of::<Sum>() == 4);

/// Handles an event and steps to the next, or leaves the loop at the end of the list: 27 instructions.
macro_rules! event_and_next {
    () => {
        concat!(
            event!(
                "smlad", ", r4", ", r5", ", r6", ", r7", ", r8", ", r9", ", r10"
            ),
            "\n",
            "asrs lr, lr, #16\n",
            "bmi 3f\n",
        )
    };
}

/// Number of events between two checks of the event count.
const ROUND: usize = 8;
// The first round is one event short.
const _: () = assert!((CHUNK_EVENTS + 1).is_multiple_of(ROUND));

/// Writes the seven sums over a list; returns the next slot.
///
/// # Safety
/// The slot at `index` and the slots that its list links must exist. The core must have the DSP instructions.
#[unsafe(naked)]
unsafe extern "C" fn add_seven(
    slots: *const Slot,
    index: u32,
    scale: &[u32; 2],
    sums: &mut [Sum; dct8::GRID - 1],
) -> u32 {
    naked_asm!(
        "push {{r3-r11, lr}}",
        "mov lr, r1",
        "mov r1, r0",
        "ldrd r2, r3, [r2]",
        "movw r0, #:lower16:{lines}",
        "movt r0, #:upper16:{lines}",
        "movs r4, #{rounds}",
        "push {{r0-r4}}",
        "movs r4, #0",
        "movs r5, #0",
        "movs r6, #0",
        "movs r7, #0",
        "mov r8, r4",
        "mov r9, r4",
        "mov r10, r4",
        "b 5f",
        "2:",
        event_and_next!(),
        "5:",
        event_and_next!(),
        event_and_next!(),
        event_and_next!(),
        event_and_next!(),
        event_and_next!(),
        event_and_next!(),
        event_and_next!(),
        "ldr r0, [sp, #16]",
        "subs r0, #1",
        "str r0, [sp, #16]",
        "bne 2b",
        "3:",
        "add sp, #20",
        "pop {{r0}}",
        "stm r0, {{r4-r10}}",
        "mov r0, lr",
        "pop {{r4-r11, pc}}",
        lines = sym dct8::LINES,
        rounds = const CHUNK_EVENTS.div_ceil(ROUND),
        distance_at = const dct8::DISTANCE_AT,
        distance_bits = const dct8::DISTANCE_BITS,
        one = const dct8::ONE << 16,
        row_at = const dct8::ROW_AT,
        rows_log2 = const dct8::ROWS_LOG2,
    )
}

/// Bytes that an event takes between the passes: its row and both weights.
const WEIGHED: usize = 12;

/// Adds the atoms of odd k for the event at r0 to r4 to r11, or starts the sums with them.
macro_rules! odd {
    ($op:literal, $r4:literal, $r5:literal, $r6:literal, $r7:literal, $r8:literal, $r9:literal,
        $r10:literal, $r11:literal) => {
        concat!(
            "ldm r0!, {{r1, r2, r3}}\n",
            "ldrd r3, lr, [r1, #-32]\n",
            $op,
            " r4, r3, r2",
            $r4,
            "\n",
            $op,
            " r5, lr, r2",
            $r5,
            "\n",
            "ldrd r3, lr, [r1, #-24]\n",
            $op,
            " r6, r3, r2",
            $r6,
            "\n",
            $op,
            " r7, lr, r2",
            $r7,
            "\n",
            "ldrd r3, lr, [r1, #-16]\n",
            $op,
            " r8, r3, r2",
            $r8,
            "\n",
            $op,
            " r9, lr, r2",
            $r9,
            "\n",
            "ldrd r3, lr, [r1, #-8]\n",
            $op,
            " r10, r3, r2",
            $r10,
            "\n",
            $op,
            " r11, lr, r2",
            $r11,
            "\n",
        )
    };
}

/// Adds the atoms of even k for the event at r0 to r4 to r10, or starts the sums with them.
macro_rules! even {
    ($op:literal, $r4:literal, $r5:literal, $r6:literal, $r7:literal, $r8:literal, $r9:literal,
        $r10:literal) => {
        concat!(
            "ldm r0!, {{r1, r2, r3}}\n",
            "ldm r1!, {{r2, r11, lr}}\n",
            $op,
            " r4, r2, r3",
            $r4,
            "\n",
            $op,
            " r5, r11, r3",
            $r5,
            "\n",
            $op,
            " r6, lr, r3",
            $r6,
            "\n",
            "ldm r1, {{r1, r2, r11, lr}}\n",
            $op,
            " r7, r1, r3",
            $r7,
            "\n",
            $op,
            " r8, r2, r3",
            $r8,
            "\n",
            $op,
            " r9, r11, r3",
            $r9,
            "\n",
            $op,
            " r10, lr, r3",
            $r10,
            "\n",
        )
    };
}

/// Writes the fifteen sums over a list; returns the next slot.
///
/// Walks the list once and stores rows and weights on the stack; from there each half of a row is added to its
/// sums. Takes 46 instructions per event.
///
/// # Safety
/// As for [`add_seven`].
#[unsafe(naked)]
unsafe extern "C" fn add_fifteen(
    slots: *const Slot,
    index: u32,
    scale: &[u32; 2],
    sums: &mut [Sum; dct16::GRID],
) -> u32 {
    naked_asm!(
        // r4: slots, less the column's upper bits, which `lr, lsr #13` includes; r5 and r6: shift and factor of the
        // offsets; r7: lines of even k; r8: where the event is stored; r9: how many more events are allowed, less
        // 1. The stack holds the events, then the last one's link, then the address of the sums.
        "push {{r3-r11, lr}}",
        "sub sp, sp, #{link_at} + 4",
        "ldrd r5, r6, [r2]",
        "movw r7, #:lower16:({lines} + 32)",
        "movt r7, #:upper16:({lines} + 32)",
        "mov r8, sp",
        "mov r9, #{more}",
        "add r1, r0, r1, lsl #3",
        "ldr lr, [r1, #4]",
        "ubfx lr, lr, #13, #3",
        "sub r4, r0, lr",
        "b 3f",
        "2:",
        "add r1, r4, lr, lsr #13",
        "3:",
        "ldrd r0, lr, [r1]",
        // r0: u / 2.
        "lsls r0, r5",
        "umull r1, r0, r0, r6",
        // r1: all ones in the second half of the window; r0: the distance from the nearer edge.
        "sbfx r1, r0, #30, #1",
        "eors r0, r1",
        // r2: all ones for an ON event.
        "sbfx r2, lr, #0, #1",
        // r3: the weights for even k; r2: for odd k, whose sign the second half changes.
        "ubfx r3, r0, #{distance_at}, #{distance_bits}",
        "movt r3, #{one}",
        "eors r3, r2",
        "ssub16 r3, r3, r2",
        "eor r2, r3, r1",
        "ssub16 r2, r2, r1",
        // r1: the row.
        "ubfx r0, r0, #{row_at}, #{rows_log2}",
        "add r1, r7, r0, lsl #6",
        "stm r8!, {{r1, r2, r3}}",
        // Ends if either is negative.
        "subs r9, #1",
        "orrs r10, r9, lr",
        "bpl 2b",
        "str lr, [sp, #{link_at}]",
        // r12: end of the events.
        "mov r12, r8",
        "mov r0, sp",
        odd!("smuad", "", "", "", "", "", "", "", ""),
        "cmp r0, r12",
        "beq 5f",
        "4:",
        odd!("smlad", ", r4", ", r5", ", r6", ", r7", ", r8", ", r9", ", r10", ", r11"),
        "cmp r0, r12",
        "bne 4b",
        "5:",
        "ldr r0, [sp, #{link_at} + 4]",
        "str r4, [r0, #4]",
        "str r5, [r0, #12]",
        "str r6, [r0, #20]",
        "str r7, [r0, #28]",
        "str r8, [r0, #36]",
        "str r9, [r0, #44]",
        "str r10, [r0, #52]",
        "str r11, [r0, #60]",
        "mov r0, sp",
        even!("smuad", "", "", "", "", "", "", ""),
        "cmp r0, r12",
        "beq 5f",
        "4:",
        even!("smlad", ", r4", ", r5", ", r6", ", r7", ", r8", ", r9", ", r10"),
        "cmp r0, r12",
        "bne 4b",
        "5:",
        "ldrd r1, r0, [sp, #{link_at}]",
        "str r4, [r0, #8]",
        "str r5, [r0, #16]",
        "str r6, [r0, #24]",
        "str r7, [r0, #32]",
        "str r8, [r0, #40]",
        "str r9, [r0, #48]",
        "str r10, [r0, #56]",
        "lsrs r0, r1, #16",
        "add sp, sp, #{link_at} + 8",
        "pop {{r4-r11, pc}}",
        lines = sym dct16::LINES,
        link_at = const CHUNK_EVENTS * WEIGHED,
        more = const CHUNK_EVENTS - 1,
        distance_at = const dct16::DISTANCE_AT,
        distance_bits = const dct8::DISTANCE_BITS,
        one = const dct16::ONE,
        row_at = const dct16::ROW_AT,
        rows_log2 = const dct16::ROWS_LOG2,
    )
}
