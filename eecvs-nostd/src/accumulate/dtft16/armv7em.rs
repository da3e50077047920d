//! Computes the sums of [`dtft16`] over a pixel's list, and those of two events, with as many sums at a time as fit
//! the registers.
//!
//! The loops in Rust serve other processors, and impulses that are not a list. All give the same bits.
#![allow(unsafe_code)]

use core::arch::naked_asm;

use crate::accumulate::any_grid::Turn;
use crate::accumulate::dtft16;
use crate::accumulate::dtft16::{GRID, place};
use crate::fixed_point::{CHUNK_EVENTS, Sum};
use crate::group::Impulses;
use crate::transform::phase::PhaseScale;
use crate::window::{NEXT_SHIFT, NO_SLOT, SLOTS_MAX, Slot};

/// [`dtft16::of_list`] for the grid of [`GRID`].
#[inline(always)]
pub(crate) fn of_list<'s>(
    impulses: &Impulses<'s>,
    scale: PhaseScale,
    grid: usize,
    sums: &mut [Sum],
    otherwise: impl FnOnce(&mut [Sum]),
) -> Option<Impulses<'s>> {
    if grid == GRID
        && let Some(pairs) = sums.as_chunks_mut::<2>().0.first_chunk_mut()
    {
        return Some(exponentials(impulses, scale, pairs));
    }
    otherwise(sums);
    None
}

/// Writes sum p exp(-i 2 pi k u) for k = 1..16 over the first impulses, at most a chunk of them, with the bits of
/// [`dtft16::exponentials`]; returns the remaining impulses. The sum of k = 0 is left as it is.
#[inline(always)]
pub fn exponentials<'s>(
    impulses: &Impulses<'s>,
    scale: PhaseScale,
    sums: &mut [[Sum; 2]; GRID],
) -> Impulses<'s> {
    let (slots, next) = impulses.parts();
    if next as usize >= slots.len() {
        sums[1..].fill([Sum::ZERO; 2]);
        return impulses.clone();
    }
    let (shift, reciprocal) = scale.parts();
    // SAFETY: each link of a list of `Impulses` is an existing slot or the list's end. This file is built only for
    // cores that have the instructions.
    let next = unsafe { add(slots.as_ptr(), next, &[shift, reciprocal], sums) };
    impulses.after(next)
}

// The assembly relies on these: the sign of a link marks the list's end, which then gives an address below the
// slots, and the three bits below the next slot's number are bits of the column, which all slots of a list share.
const _: () = assert!(SLOTS_MAX < 0x8000 && NO_SLOT == 0xffff && NEXT_SHIFT == 16);
const _: () = assert!(size_of::<Slot>() == 8 && size_of::<Sum>() == 4 && size_of::<Turn>() == 8);
// Seven lines for even k on either side of a place in the row, then eight for odd k in the same way.
const _: () = assert!(place(2) == 0 && place(8) + 1 == EVEN_LINES);
const _: () = assert!(place(1) == 2 * EVEN_LINES && place(9) == place(1) + ODD_LINES);

/// Number of lines in a pass over even k, and in one over odd k.
const EVEN_LINES: usize = 7;
const ODD_LINES: usize = 8;
/// Number of bytes of a row.
const ROW: usize = 8 * (GRID - 1);
/// Bytes from the start of a row to the middle of the lines for even k, and from there to the middle of those for
/// odd k.
const EVEN_AT: usize = 4 * EVEN_LINES;
const ODD_AFTER: usize = 4 * (EVEN_LINES + ODD_LINES);

/// Bytes that an event takes between the passes: the weights for even k, the addresses of the middle of its lines
/// for even k and for odd k, and the weights for odd k. Weights of 0 follow the last event.
const WEIGHED: usize = 16;
/// Number of events between two checks of the event count.
const ROUND: usize = 7;
const _: () = assert!(CHUNK_EVENTS.is_multiple_of(ROUND));

/// Weighs the event at r4 and stores the result; jumps to 4 if it is the last event.
///
/// r0: slots, less the column's upper bits, which `lr, asr #13` includes; r1 and r2: shift and factor of the
/// offsets; r3: middle of the first row's lines for even k; r11: where the result is stored; r12: bytes of a row.
/// Leaves the link in lr.
macro_rules! weigh {
    () => {
        "ldrd r4, lr, [r4]
        lsls r4, r1
        umull r5, r4, r4, r2
        ubfx r6, r4, #{distance_at}, #{distance_bits}
        movt r6, #{one}
        ubfx r7, r4, #{row_at}, #{rows_log2}
        mla r7, r7, r12, r3
        sbfx r8, lr, #0, #1
        eor r6, r6, r8
        ssub16 r6, r6, r8
        sbfx r5, r4, #30, #1
        eor r9, r6, r5
        ssub16 r9, r9, r5
        add r8, r7, #{odd_after}
        stm r11!, {{r6, r7, r8, r9}}
        adds r4, r0, lr, asr #13
        bcs 4f
        "
    };
}

/// Adds a number of an event to `$sum`, or starts the sum with it. r1: weights.
macro_rules! number {
    (first $sum:literal, $line:literal) => {
        concat!("smuad ", $sum, ", ", $line, ", r1\n")
    };
    (more $sum:literal, $line:literal) => {
        concat!("smlad ", $sum, ", ", $line, ", r1, ", $sum, "\n")
    };
}

/// Adds the seven lines below r2.
macro_rules! even_below {
    ($how:ident) => {
        concat!(
            "ldmdb r2!, {{r3, r11, r12, lr}}\n",
            number!($how "r7", "r3"),
            number!($how "r8", "r11"),
            number!($how "r9", "r12"),
            number!($how "r10", "lr"),
            "ldmdb r2, {{r3, r11, r12}}\n",
            number!($how "r4", "r3"),
            number!($how "r5", "r11"),
            number!($how "r6", "r12"),
        )
    };
}

/// Adds the seven lines from r2 on.
macro_rules! even_above {
    ($how:ident) => {
        concat!(
            "ldmia r2!, {{r3, r11, r12, lr}}\n",
            number!($how "r4", "r3"),
            number!($how "r5", "r11"),
            number!($how "r6", "r12"),
            number!($how "r7", "lr"),
            "ldmia r2, {{r3, r11, r12}}\n",
            number!($how "r8", "r3"),
            number!($how "r9", "r11"),
            number!($how "r10", "r12"),
        )
    };
}

/// Adds the eight lines below r2.
macro_rules! odd_below {
    ($how:ident) => {
        concat!(
            "ldmdb r2!, {{r3, r12, lr}}\n",
            number!($how "r9", "r3"),
            number!($how "r10", "r12"),
            number!($how "r11", "lr"),
            "ldmdb r2!, {{r3, r12, lr}}\n",
            number!($how "r6", "r3"),
            number!($how "r7", "r12"),
            number!($how "r8", "lr"),
            "ldmdb r2, {{r3, r12}}\n",
            number!($how "r4", "r3"),
            number!($how "r5", "r12"),
        )
    };
}

/// Adds the eight lines from r2 on.
macro_rules! odd_above {
    ($how:ident) => {
        concat!(
            "ldmia r2!, {{r3, r12, lr}}\n",
            number!($how "r4", "r3"),
            number!($how "r5", "r12"),
            number!($how "r6", "lr"),
            "ldmia r2!, {{r3, r12, lr}}\n",
            number!($how "r7", "r3"),
            number!($how "r8", "r12"),
            number!($how "r9", "lr"),
            "ldmia r2, {{r3, r12}}\n",
            number!($how "r10", "r3"),
            number!($how "r11", "r12"),
        )
    };
}

/// Sums the lines `$lines` of all events in r4 and the registers after it, and leaves the sums' address in r1.
/// `$begin` sets r0 to the first event; `$load` loads an event's weights and lines.
macro_rules! pass {
    ($begin:literal, $load:literal, $lines:ident) => {
        concat!(
            $begin,
            "\n",
            $load,
            "\n",
            $lines!(first),
            $load,
            "\n",
            // The remaining events, modulo four, come first.
            "ldr r3, [sp, #{count_at}]\n",
            "lsls r3, r3, #27\n",
            "bcs 9f\n",
            "bmi 7f\n",
            "b 8f\n",
            "9:\n",
            "bpl 6f\n",
            "b 5f\n",
            "4:\n",
            $lines!(more),
            $load,
            "\n",
            "5:\n",
            $lines!(more),
            $load,
            "\n",
            "6:\n",
            $lines!(more),
            $load,
            "\n",
            "7:\n",
            $lines!(more),
            $load,
            "\n",
            "8:\n",
            "cmp r1, #0\n",
            "bne 4b\n",
            "ldr r1, [sp, #{sums_at}]\n",
        )
    };
}

/// Writes the sums over a list; returns the next slot.
///
/// Walks the list once and stores weights and addresses of lines on the stack; from there each quarter of the lines
/// is added to its sums. Takes 63 instructions per event.
///
/// # Safety
/// The slot at `index` and the slots that its list links must exist. The core must have the DSP instructions.
#[unsafe(naked)]
pub unsafe extern "C" fn add(
    slots: *const Slot,
    index: u32,
    scale: &[u32; 2],
    sums: &mut [[Sum; 2]; GRID],
) -> u32 {
    naked_asm!(
        // The stack holds the events, then the last one's link, then the byte count, then the address of the sums.
        "push {{r3-r11, lr}}",
        "sub sp, sp, #{sums_at}",
        "add r4, r0, r1, lsl #3",
        "ldr lr, [r4, #4]",
        "ubfx lr, lr, #13, #3",
        "sub r0, r0, lr",
        "ldrd r1, r2, [r2]",
        "movw r3, #:lower16:({lines} + {even_at})",
        "movt r3, #:upper16:({lines} + {even_at})",
        "mov r12, #{row}",
        "mov r11, sp",
        "add r10, sp, #{events_end}",
        "2:",
        weigh!(),
        weigh!(),
        weigh!(),
        weigh!(),
        weigh!(),
        weigh!(),
        weigh!(),
        "cmp r11, r10",
        "bne 2b",
        "4:",
        "movs r4, #0",
        "str r4, [r11]",
        "str r4, [r11, #12]",
        // Bytes of all events but the first.
        "mov r4, sp",
        "sub r4, r11, r4",
        "subs r4, #{weighed}",
        "str lr, [sp, #{link_at}]",
        "str r4, [sp, #{count_at}]",
        pass!("mov r0, sp", "ldrd r1, r2, [r0], #{weighed}", even_below),
        "strd r4, r5, [r1, #16]",
        "strd r6, r7, [r1, #32]",
        "strd r8, r9, [r1, #48]",
        "str r10, [r1, #64]",
        pass!("mov r0, sp", "ldrd r1, r2, [r0], #{weighed}", even_above),
        "str r4, [r1, #68]",
        "strd r5, r6, [r1, #80]",
        "strd r7, r8, [r1, #96]",
        "strd r9, r10, [r1, #112]",
        pass!("add r0, sp, #8", "ldrd r2, r1, [r0], #{weighed}", odd_below),
        "strd r4, r5, [r1, #8]",
        "strd r6, r7, [r1, #24]",
        "strd r8, r9, [r1, #40]",
        "strd r10, r11, [r1, #56]",
        pass!("add r0, sp, #8", "ldrd r2, r1, [r0], #{weighed}", odd_above),
        "strd r4, r5, [r1, #72]",
        "strd r6, r7, [r1, #88]",
        "strd r8, r9, [r1, #104]",
        "strd r10, r11, [r1, #120]",
        "ldr r0, [sp, #{link_at}]",
        "lsrs r0, r0, #16",
        "add sp, sp, #{sums_at} + 4",
        "pop {{r4-r11, pc}}",
        lines = sym dtft16::LINES,
        row = const ROW,
        even_at = const EVEN_AT,
        odd_after = const ODD_AFTER,
        weighed = const WEIGHED,
        events_end = const CHUNK_EVENTS * WEIGHED,
        link_at = const (CHUNK_EVENTS + 1) * WEIGHED,
        count_at = const (CHUNK_EVENTS + 1) * WEIGHED + 4,
        sums_at = const (CHUNK_EVENTS + 1) * WEIGHED + 8,
        distance_at = const dtft16::DISTANCE_AT,
        distance_bits = const dtft16::DISTANCE_BITS,
        one = const dtft16::ONE,
        row_at = const dtft16::ROW_AT,
        rows_log2 = const dtft16::ROWS_LOG2,
    )
}

/// Computes the row `$row` and the weights for even and for odd k from the phase u in `$u` and the polarity in
/// `$sign`. r12: bytes of a row; lr: the table.
macro_rules! weigh_turn {
    ($sign:literal, $u:literal, $row:literal, $even:literal, $odd:literal) => {
        concat!(
            "ubfx ",
            $even,
            ", ",
            $u,
            ", #{distance_at} + 1, #{distance_bits}\n",
            "movt ",
            $even,
            ", #{one}\n",
            "ubfx ",
            $row,
            ", ",
            $u,
            ", #{row_at} + 1, #{rows_log2}\n",
            "mla ",
            $row,
            ", ",
            $row,
            ", r12, lr\n",
            "asrs ",
            $sign,
            ", ",
            $sign,
            ", #31\n",
            "eor ",
            $even,
            ", ",
            $even,
            ", ",
            $sign,
            "\n",
            "ssub16 ",
            $even,
            ", ",
            $even,
            ", ",
            $sign,
            "\n",
            // All ones in the second half of the window.
            "asrs ",
            $u,
            ", ",
            $u,
            ", #31\n",
            "eor ",
            $odd,
            ", ",
            $even,
            ", ",
            $u,
            "\n",
            "ssub16 ",
            $odd,
            ", ",
            $odd,
            ", ",
            $u,
            "\n",
        )
    };
}

/// If the set contains k, whose lines are `$at` lines after a row's start, stores its pair of sums. `$a` and `$b`:
/// weights of the two events; r0: the set from k on; r2 and r3: rows.
macro_rules! one {
    (even $at:literal) => {
        one!($at, "r8", "r10")
    };
    (odd $at:literal) => {
        one!($at, "r9", "r11")
    };
    ($at:literal, $a:literal, $b:literal) => {
        concat!(
            "lsrs r0, r0, #1\n",
            "bcc 2f\n",
            "ldrd r4, r5, [r2, #4 * ",
            $at,
            "]\n",
            "ldrd r6, r7, [r3, #4 * ",
            $at,
            "]\n",
            "smuad r4, r4, ",
            $a,
            "\n",
            "smuad r5, r5, ",
            $a,
            "\n",
            "smlad r4, r6, ",
            $b,
            ", r4\n",
            "smlad r5, r7, ",
            $b,
            ", r5\n",
            "strd r4, r5, [r1], #8\n",
            "2:\n",
        )
    };
}

/// Writes sum p exp(-i 2 pi k u) of two events for every k of `set` except 0, ascending and side by side.
///
/// # Safety
/// `set` must have no k above 15, and `sums` must have room for one pair per k. The core must have the DSP
/// instructions.
#[unsafe(naked)]
pub unsafe extern "C" fn two_exponentials(set: u32, sums: *mut Sum, turns: &[Turn; 2]) {
    naked_asm!(
        "push {{r4-r11, lr}}",
        "ldm r2, {{r4, r5, r6, r7}}",
        "movw lr, #:lower16:{lines}",
        "movt lr, #:upper16:{lines}",
        "mov r12, #{row}",
        weigh_turn!("r4", "r5", "r2", "r8", "r9"),
        weigh_turn!("r6", "r7", "r3", "r10", "r11"),
        "lsrs r0, r0, #1",
        one!(odd "14"),
        one!(even "0"),
        one!(odd "16"),
        one!(even "2"),
        one!(odd "18"),
        one!(even "4"),
        one!(odd "20"),
        one!(even "6"),
        one!(odd "22"),
        one!(even "8"),
        one!(odd "24"),
        one!(even "10"),
        one!(odd "26"),
        one!(even "12"),
        one!(odd "28"),
        "pop {{r4-r11, pc}}",
        lines = sym dtft16::LINES,
        row = const ROW,
        distance_at = const dtft16::DISTANCE_AT,
        distance_bits = const dtft16::DISTANCE_BITS,
        one = const dtft16::ONE,
        row_at = const dtft16::ROW_AT,
        rows_log2 = const dtft16::ROWS_LOG2,
    )
}
