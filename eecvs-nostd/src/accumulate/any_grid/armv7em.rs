//! Sums two events at a time, with the same bits, so that sums are loaded and stored half as often.
//!
//! A number takes 5 instructions here, or 4 in a complex pair; the compiler takes 13.

use core::arch::naked_asm;

use heapless::Vec;

use super::{CHUNK_EVENTS, DISTANCE_AT, LINES, ONE, QUARTER, ROW_AT, Sum, Turn};

/// Implements [`super::cosines`].
#[inline(always)]
pub fn cosines(turns: impl Iterator<Item = Turn>, sums: &mut [Sum]) {
    let sums = sums.get_mut(1..).unwrap_or_default();
    let mut all = Vec::new();
    let turns = collect(turns, &mut all);
    if turns.is_empty() {
        return sums.fill(Sum::ZERO);
    }
    // SAFETY: `add_cosines` reads and writes as many turns and sums as the lengths say, all of which exist, and
    // reads lines of rows below `ROWS`. This file is built only for cores that have the instructions.
    unsafe { add_cosines(sums.as_mut_ptr(), sums.len(), turns.as_ptr(), turns.len()) }
}

/// Implements [`super::exponentials`].
#[inline(always)]
pub fn exponentials(turns: impl Iterator<Item = Turn>, sums: &mut [[Sum; 2]]) {
    let sums = sums.get_mut(1..).unwrap_or_default();
    let mut all = Vec::new();
    let turns = collect(turns, &mut all);
    if turns.is_empty() {
        return sums.fill([Sum::ZERO; 2]);
    }
    // SAFETY: as for `cosines`; imaginary parts are in rows below `ROWS + QUARTER`.
    unsafe { add_exponentials(sums.as_mut_ptr(), sums.len(), turns.as_ptr(), turns.len()) }
}

/// Collects the turns in the caller's memory, so that they are not copied.
#[inline(always)]
fn collect(turns: impl Iterator<Item = Turn>, all: &mut Vec<Turn, CHUNK_EVENTS>) -> &[Turn] {
    for turn in turns {
        if all.push(turn).is_err() {
            break;
        }
    }
    all
}

/// Advances `$phase` by `$step`, and leaves the weights in r9 and the row in r7.
macro_rules! advance {
    ($phase:literal, $step:literal) => {
        concat!(
            "add ",
            $phase,
            ", ",
            $phase,
            ", ",
            $step,
            "\n",
            "pkhtb r9, r6, ",
            $phase,
            ", asr #{distance_at}\n",
            "lsr r7, ",
            $phase,
            ", #{row_at}\n",
        )
    };
}

/// Writes sum p exp(-i k a) of two events for every k of `set`, ascending and side by side, with the bits of
/// [`super::exponentials`].
///
/// # Safety
/// `sums` must have room for one pair per k. The core must have the DSP instructions.
#[unsafe(naked)]
pub unsafe extern "C" fn two_exponentials(set: u32, sums: *mut Sum, turns: &[Turn; 2]) {
    naked_asm!(
        "push {{r4-r11, lr}}",
        // The phases of k = -1.
        "ldm r2, {{r2, r3, r12, lr}}",
        "subs r2, r2, r3",
        "sub r12, r12, lr",
        "rbit r0, r0",
        "cmp r0, #0",
        "beq 3f",
        "movw r4, #:lower16:{lines}",
        "movt r4, #:upper16:{lines}",
        "add r5, r4, #{imaginary}",
        "mov r6, #{one}",
        "2:",
        "clz r7, r0",
        "add r7, r7, #1",
        // After the last k nothing is left; no instruction below changes the flags.
        "lsls r0, r0, r7",
        "mla r2, r7, r3, r2",
        "mla r12, r7, lr, r12",
        "lsr r7, r2, #{row_at}",
        "pkhtb r8, r6, r2, asr #{distance_at}",
        "ldr r10, [r4, r7, lsl #2]",
        "ldr r11, [r5, r7, lsl #2]",
        "smuad r10, r10, r8",
        "smuad r11, r11, r8",
        "lsr r7, r12, #{row_at}",
        "pkhtb r9, r6, r12, asr #{distance_at}",
        "ldr r8, [r4, r7, lsl #2]",
        "ldr r7, [r5, r7, lsl #2]",
        "smlad r10, r8, r9, r10",
        "smlad r11, r7, r9, r11",
        "strd r10, r11, [r1], #8",
        "bne 2b",
        "3:",
        "pop {{r4-r11, pc}}",
        lines = sym LINES,
        imaginary = const 4 * QUARTER,
        one = const ONE << 16,
        row_at = const ROW_AT,
        distance_at = const DISTANCE_AT,
    )
}

/// Adds the next number of the turn to `$sum`, or starts the sum with it.
macro_rules! real {
    ($op:literal, $phase:literal, $step:literal, $sum:literal, $plus:literal) => {
        concat!(
            advance!($phase, $step),
            "ldr r7, [r4, r7, lsl #2]\n",
            $op,
            " ",
            $sum,
            ", r7, r9",
            $plus,
            "\n",
        )
    };
}

/// Adds the next pair of the turn to r10 and r11, or starts the sums with it.
macro_rules! complex {
    ($op:literal, $phase:literal, $step:literal, $re:literal, $im:literal) => {
        concat!(
            advance!($phase, $step),
            "ldr r8, [r5, r7, lsl #2]\n",
            "ldr r7, [r4, r7, lsl #2]\n",
            $op,
            " r10, r7, r9",
            $re,
            "\n",
            $op,
            " r11, r8, r9",
            $im,
            "\n",
        )
    };
}

/// Repeats `$unit` r1 times, three per iteration of the main loop.
macro_rules! units {
    ($unit:expr) => {
        concat!(
            "subs r1, r1, #3\n",
            "blo 3f\n",
            "2:\n",
            $unit,
            $unit,
            $unit,
            "subs r1, r1, #3\n",
            "bhs 2b\n",
            "3:\n",
            "adds r1, r1, #3\n",
            "beq 5f\n",
            "4:\n",
            $unit,
            "subs r1, r1, #1\n",
            "bne 4b\n",
            "5:\n",
        )
    };
}

/// The frame around the loops over coefficients: `$begin_one` and `$begin_two` start the sums with one or two
/// events, `$two` and `$one` add two or one.
///
/// r0: sums; r1: their number; r2 and r3: phase and step of a turn; r12 and lr: those of another; r4: lines; r5:
/// lines of the imaginary parts; r6: [`ONE`] in the upper half. The stack holds the four arguments.
macro_rules! turns {
    ($begin_one:expr, $begin_two:expr, $two:expr, $one:expr) => {
        concat!(
            "push {{r0-r11, lr}}\n",
            "movw r4, #:lower16:{lines}\n",
            "movt r4, #:upper16:{lines}\n",
            "add r5, r4, #{imaginary}\n",
            "mov r6, #{one}\n",
            "mov r7, r2\n",
            "subs r3, r3, #2\n",
            "str r3, [sp, #12]\n",
            "blo 8f\n",
            "ldm r7!, {{r2, r3, r12, lr}}\n",
            "str r7, [sp, #8]\n",
            $begin_two,
            "6:\n",
            "ldrd r7, r3, [sp, #8]\n",
            "ldrd r0, r1, [sp]\n",
            "subs r3, r3, #2\n",
            "str r3, [sp, #12]\n",
            "blo 7f\n",
            "ldm r7!, {{r2, r3, r12, lr}}\n",
            "str r7, [sp, #8]\n",
            $two,
            "b 6b\n",
            // One event is left, or none.
            "7:\n",
            "adds r3, r3, #2\n",
            "beq 9f\n",
            "ldrd r2, r3, [r7]\n",
            $one,
            "b 9f\n",
            "8:\n",
            "ldrd r2, r3, [r7]\n",
            $begin_one,
            "9:\n",
            "add sp, sp, #16\n",
            "pop {{r4-r11, pc}}\n",
        )
    };
}

/// Writes the sums of [`cosines`].
///
/// # Safety
/// `sums` must have `len` numbers and `turns` must have `count`, at least 1. The core must have the DSP
/// instructions.
#[unsafe(naked)]
unsafe extern "C" fn add_cosines(sums: *mut Sum, len: usize, turns: *const Turn, count: usize) {
    naked_asm!(
        turns!(
            units!(concat!(
                real!("smuad", "r2", "r3", "r10", ""),
                "str r10, [r0], #4\n",
            )),
            units!(concat!(
                real!("smuad", "r2", "r3", "r10", ""),
                real!("smlad", "r12", "lr", "r10", ", r10"),
                "str r10, [r0], #4\n",
            )),
            units!(concat!(
                "ldr r10, [r0]\n",
                real!("smlad", "r2", "r3", "r10", ", r10"),
                real!("smlad", "r12", "lr", "r10", ", r10"),
                "str r10, [r0], #4\n",
            )),
            units!(concat!(
                "ldr r10, [r0]\n",
                real!("smlad", "r2", "r3", "r10", ", r10"),
                "str r10, [r0], #4\n",
            ))
        ),
        lines = sym LINES,
        imaginary = const 4 * QUARTER,
        one = const ONE << 16,
        row_at = const ROW_AT,
        distance_at = const DISTANCE_AT,
    )
}

/// Writes the sums of [`exponentials`].
///
/// # Safety
/// As for [`add_cosines`], with pairs in `sums`.
#[unsafe(naked)]
pub unsafe extern "C" fn add_exponentials(
    sums: *mut [Sum; 2],
    len: usize,
    turns: *const Turn,
    count: usize,
) {
    naked_asm!(
        turns!(
            units!(concat!(
                complex!("smuad", "r2", "r3", "", ""),
                "strd r10, r11, [r0], #8\n",
            )),
            units!(concat!(
                complex!("smuad", "r2", "r3", "", ""),
                complex!("smlad", "r12", "lr", ", r10", ", r11"),
                "strd r10, r11, [r0], #8\n",
            )),
            units!(concat!(
                "ldrd r10, r11, [r0]\n",
                complex!("smlad", "r2", "r3", ", r10", ", r11"),
                complex!("smlad", "r12", "lr", ", r10", ", r11"),
                "strd r10, r11, [r0], #8\n",
            )),
            units!(concat!(
                "ldrd r10, r11, [r0]\n",
                complex!("smlad", "r2", "r3", ", r10", ", r11"),
                "strd r10, r11, [r0], #8\n",
            ))
        ),
        lines = sym LINES,
        imaginary = const 4 * QUARTER,
        one = const ONE << 16,
        row_at = const ROW_AT,
        distance_at = const DISTANCE_AT,
    )
}
