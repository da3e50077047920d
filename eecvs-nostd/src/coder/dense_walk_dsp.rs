//! The dense coder's walk over the segments of a row and their pixels' events in assembly, with the range
//! coder's state in registers; [`super::dense_dsp`] hands it what it knows.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::mem::offset_of;

use super::dense_dsp::{advance, follow};
use super::dense_times::{COARSE, DISTANCES, FIRST_BITS, FIRST_SYMBOLS, RESTS};
use super::dense_walk_state_dsp::Walk;
use super::range::Probability;
use super::symbols::Symbols;
use crate::group::Entry;
use crate::window::{NEXT_SHIFT, NO_SLOT, SLOTS_MAX, Slot};

/// What the assembly ends with: the columns' end, a column that it leaves to the loop in Rust, the
/// window's last event, and an output that is full.
pub(super) const DONE: u32 = 0;
pub(super) const LEFT: u32 = 1;
pub(super) const OVER: u32 = 2;
pub(super) const FULL: u32 = 3;
/// The same of a row: all its segments, and a segment's flag that is left to the loop in Rust.
pub(super) const ROW: u32 = 4;
pub(super) const FLAG: u32 = 5;

// What the assembly takes for granted.
const _: () = assert!(SLOTS_MAX < 1 << 15 && NO_SLOT >= 1 << 15 && NEXT_SHIFT == 16);
const _: () = assert!(size_of::<Slot>() == 8 && size_of::<Probability>() == 2);
const _: () = assert!(size_of::<Entry>() == 8 && offset_of!(Entry, head) == 0);
const _: () = assert!(COARSE == 15 && RESTS == 6 && FIRST_BITS == 5);

unsafe extern "C" fn renew_first(table: &mut Symbols<FIRST_SYMBOLS>) {
    table.renew();
}

unsafe extern "C" fn renew_distance(table: &mut Symbols<DISTANCES>) {
    table.renew();
}

/// A byte, where the range has become short; overwrites r2.
macro_rules! renew {
    () => {
        "cmp r8, #0x1000000
        bhs 97f
        lsr r2, r9, #24
        strb r2, [r10], #1
        lsls r9, r9, #8
        lsls r8, r8, #8
        97:
        "
    };
}

/// Two of them at the most.
macro_rules! renew_twice {
    () => {
        "cmp r8, #0x1000000
        bhs 97f
        lsr r2, r9, #24
        strb r2, [r10], #1
        lsls r9, r9, #8
        lsls r8, r8, #8
        cmp r8, #0x1000000
        bhs 97f
        lsr r2, r9, #24
        strb r2, [r10], #1
        lsls r9, r9, #8
        lsls r8, r8, #8
        97:
        "
    };
}

/// Adds to the low end; lr is overwritten.
macro_rules! add {
    ($more:literal) => {
        concat!("adds r9, r9, ", $more, "\nbcc 98f\nbl 99f\n98:\n")
    };
}

/// One more in the last of the bytes written.
macro_rules! carry {
    () => {
        "99:
        push {{r0, r1, r2}}
        mov r0, r10
        ldr r2, [r11, #{start}]
        89:
        cmp r0, r2
        beq 88f
        ldrb r1, [r0, #-1]!
        adds r1, #1
        strb r1, [r0]
        lsls r1, r1, #24
        beq 89b
        88:
        pop {{r0, r1, r2}}
        bx lr"
    };
}

/// A decision of which the probability is at r0; r1 to r3 and r12 are overwritten.
macro_rules! one {
    () => {
        concat!(
            "ldrh r1, [r0]\n",
            "lsr r2, r8, #13\n",
            "lsr r3, r1, #3\n",
            "and r12, r1, #7\n",
            "mul r8, r2, r3\n",
            "ldrh r12, [r11, r12, lsl #1]\n",
            "rsb r2, r3, #8192\n",
            "mul r2, r2, r12\n",
            "add r3, r3, r2, lsr #16\n",
            "bfi r12, r3, #3, #13\n",
            "strh r12, [r0]\n",
            renew!(),
        )
    };
}

/// The same of a zero, and lr.
macro_rules! zero {
    () => {
        concat!(
            "ldrh r1, [r0]\n",
            "lsr r2, r8, #13\n",
            "lsr r3, r1, #3\n",
            "and r12, r1, #7\n",
            "mul r2, r2, r3\n",
            "ldrh r12, [r11, r12, lsl #1]\n",
            "sub r8, r8, r2\n",
            add!("r2"),
            "mul r2, r3, r12\n",
            "sub r3, r3, r2, lsr #16\n",
            "bfi r12, r3, #3, #13\n",
            "strh r12, [r0]\n",
            renew!(),
        )
    };
}

/// What column r5 sees, at the top of which `$quiet` is where it goes on if that is nothing; r0: context
/// of whether it has events.
macro_rules! see {
    ($quiet:literal, $old:expr) => {
        concat!(
            "ldmdb r11, {{r0, r1, r2, r3, r12, lr}}\n",
            "lsls lr, r5\n",
            "bpl ",
            $quiet,
            "\n",
            "lsr r0, r0, r5\n",
            "and r0, r0, #3\n",
            "lsr r1, r1, r5\n",
            "bfi r0, r1, #2, #1\n",
            "lsr r2, r2, r5\n",
            "bfi r0, r2, #3, #1\n",
            "lsr r3, r3, r5\n",
            "bfi r0, r3, #4, #1\n",
            "lsr r12, r12, r5\n",
            "bfi r0, r12, #5, #1\n",
            $old,
        )
    };
}

/// From its share of a symbol's table on: r12 is its begin and r2 its end, the range that of a share.
macro_rules! symbol {
    () => {
        concat!(
            "sub r2, r2, r12\n",
            "mul r12, r12, r8\n",
            "mul r8, r8, r2\n",
            add!("r12"),
            renew_twice!(),
        )
    };
}

/// The lowest r3 bits of a register, as they are; overwrites r2.
macro_rules! plain {
    ($value:literal) => {
        concat!(
            "lsr r2, ",
            $value,
            ", r3\n",
            "lsls r2, r3\n",
            "sub r2, ",
            $value,
            ", r2\n",
            "lsrs r8, r3\n",
            "mul r2, r2, r8\n",
            add!("r2"),
            renew_twice!(),
        )
    };
}

/// Learns from symbol r1 of table r0.
macro_rules! learn {
    ($counts:literal, $left:literal, $renew:literal) => {
        concat!(
            "add r1, r1, r0\n",
            "ldrb r2, [r1, #",
            $counts,
            "]\n",
            "adds r2, #1\n",
            "strb r2, [r1, #",
            $counts,
            "]\n",
            "ldrb r2, [r0, #",
            $left,
            "]\n",
            "subs r2, #1\n",
            "strb r2, [r0, #",
            $left,
            "]\n",
            "bne 95f\n",
            "bl ",
            $renew,
            "\n",
            "95:\n",
        )
    };
}

/// From a part of the context of whether there is another event in r1 to its probability's place in r0.
macro_rules! more {
    () => {
        concat!(
            "ldrd r2, r3, [r11, #{west_last}]\n",
            "lsl r12, r6, #1\n",
            "add r12, r12, #2\n",
            "cmp r3, r12\n",
            "adcs r1, r1\n",
            "cmp r2, r12\n",
            "adcs r1, r1\n",
            "lsrs r0, r7, #1\n",
            "adcs r1, r1\n",
            "ldr r0, [r11, #{more}]\n",
            "add r0, r0, r1, lsl #1\n",
        )
    };
}

/// Six times what is left of the window, in r1.
macro_rules! rest {
    () => {
        concat!(
            "ldrd r2, r1, [r11, #{half}]\n",
            "subs r1, r1, r6\n",
            "clz r1, r1\n",
            // Of all of a window whose cells are a power of two, there is one less.
            "subs r1, r1, r2\n",
            "usat r1, #4, r1\n",
            "rsb r1, r1, #{rests} - 1\n",
            "usat r1, #5, r1\n",
            "add r1, r1, r1, lsl #1\n",
            "lsls r1, r1, #1\n",
        )
    };
}

const fn at(offset: usize) -> usize {
    offset - offset_of!(Walk, rates)
}

/// A decision.
///
/// # Safety
/// There is room for a byte at `walk.out`.
#[unsafe(naked)]
pub(super) unsafe extern "C" fn decide(walk: &mut Walk, probability: &mut Probability, bit: u32) {
    naked_asm!(
        "push {{r8-r11, lr}}",
        "add r11, r0, #{rates}",
        "mov r0, r1",
        "ldrd r8, r9, [r11, #{range}]",
        "ldr r10, [r11, #{out}]",
        "cmp r2, #0",
        "bne 1f",
        zero!(),
        "b 2f",
        "1:",
        one!(),
        "2:",
        "strd r8, r9, [r11, #{range}]",
        "str r10, [r11, #{out}]",
        "pop {{r8-r11, pc}}",
        carry!(),
        rates = const offset_of!(Walk, rates),
        range = const at(offset_of!(Walk, range)),
        out = const at(offset_of!(Walk, out)),
        start = const at(offset_of!(Walk, start)),
    )
}

/// Adds to the first register what a word in the second has of bits: 0, 1, 2 to 3, or more, as 0 to 3;
/// r12 and lr are overwritten.
macro_rules! few {
    ($few:literal, $word:literal) => {
        concat!(
            concat!("cmp ", $word, ", #0\nbeq 90f\nsub r12, ", $word, ", #1\n"),
            concat!("adds ", $few, ", #1\nands r12, r12, ", $word, "\nbeq 90f\n"),
            concat!("adds ", $few, ", #1\n"),
            "sub lr, r12, #1
            ands r12, r12, lr
            beq 90f
            sub lr, r12, #1
            ands r12, r12, lr
            beq 90f\n",
            concat!("adds ", $few, ", #1\n90:\n"),
        )
    };
}

/// A row's segments.
macro_rules! row {
    ($any_old:expr, $few_old:expr, $sees_old:expr, $put_old:expr) => {
        concat!(
            "50:\n",
            "ldr r12, [r11, #{pixel_room}]\n",
            "cmp r10, r12\n",
            "bhi 58f\n",
            "ldrd r5, r6, [r11, #{segment}]\n",
            "ldr r7, [r11, #{north_row}]\n",
            "add r7, r7, r5, lsl #2\n",
            "ldr r0, [r7]\n",
            "movs r1, #0\n",
            "cmp r5, r6\n",
            "it ne\n",
            "ldrne r1, [r7, #4]\n",
            "strd r0, r1, [r11, #{north_here}]\n",
            "ldr r2, [r11, #{made}]\n",
            "movs r3, #0\n",
            "orr r12, r0, r1\n",
            $any_old,
            "orrs r12, r12, r2\n",
            "beq 51f\n",
            few!("r3", "r2"),
            "lsls r3, r3, #2\n",
            few!("r3", "r0"),
            $few_old,
            few!("r3", "r1"),
            // r3: context of its flag.
            "51:\n",
            "ldrd r2, r1, [r11, #{ahead}]\n",
            "add r0, r1, r3, lsl #1\n",
            "cmp r5, r2\n",
            "beq 52f\n",
            zero!(),
            "movs r0, #0\n",
            "movs r1, #0\n",
            "strd r0, r1, [r11, #{made}]\n",
            // It was made so.
            "53:\n",
            "ldrd r2, r3, [r11, #{here_row}]\n",
            "str r0, [r2, r5, lsl #2]\n",
            "str r1, [r3, r5, lsl #2]\n",
            $put_old,
            "cmp r5, r6\n",
            "beq 59f\n",
            "adds r5, #1\n",
            "str r5, [r11, #{segment}]\n",
            "b 50b\n",
            "58:\n",
            "movs r0, #{flag}\n",
            "b 75f\n",
            "59:\n",
            "movs r0, #{row_end}\n",
            "b 75f\n",
            // One that has events: what its columns see.
            "52:\n",
            one!(),
            "ldr r0, [r11, #{columns_told}]\n",
            "ldr r0, [r0]\n",
            "str r0, [r11, #{told}]\n",
            "str r0, [r11, #{told_all}]\n",
            "ldrd r1, r2, [r11, #{made}]\n",
            "ands r2, r1\n",
            "lsrs r2, r2, #31\n",
            "movs r3, #0\n",
            "strd r3, r2, [r11, #{first_on}]\n",
            "lsrs r2, r1, #30\n",
            "orr r2, r2, r0, lsl #2\n",
            "ldr r3, [r11, #{north_here}]\n",
            "orr r7, r1, r3\n",
            "movs r1, #0\n",
            few!("r1", "r7"),
            "ldr r7, [r11, #{crowds}]\n",
            "add r7, r7, r1, lsl #4\n",
            "str r7, [r11, #{runs}]\n",
            "ldr r12, [r11, #{north_next}]\n",
            "ldr r1, [r11, #{north_row}]\n",
            "add r1, r1, r5, lsl #2\n",
            "movs r7, #0\n",
            "cmp r5, #0\n",
            "it ne\n",
            "ldrne r7, [r1, #-4]\n",
            "lsls r1, r3, #1\n",
            "orr r1, r1, r7, lsr #31\n",
            "lsr lr, r3, #1\n",
            "orr lr, lr, r12, lsl #31\n",
            "ldr r6, [r11, #{far_north_row}]\n",
            "ldr r6, [r6, r5, lsl #2]\n",
            "str r2, [r11, #-24]\n",
            "str r1, [r11, #-20]\n",
            "str r3, [r11, #-16]\n",
            "str lr, [r11, #-12]\n",
            "str r6, [r11, #-8]\n",
            "orrs r1, r3\n",
            "orr r1, r1, lr\n",
            "orrs r1, r6\n",
            $sees_old,
            "orr r6, r2, r2, lsr #1\n",
            "orrs r6, r1\n",
            "rbit r6, r6\n",
            "str r6, [r11, #-4]\n",
            // r1: what is seen.
            "ldr r6, [r11, #{segment} + 4]\n",
            "movs r2, #32\n",
            "cmp r5, r6\n",
            "it eq\n",
            "ldreq r2, [r11, #{last_columns}]\n",
            "subs r6, r2, #1\n",
            "strd r2, r6, [r11, #{columns}]\n",
            "rbit r1, r1\n",
            "mvns r1, r1\n",
            "mov r6, #-1\n",
            "lsrs r6, r2\n",
            "bics r1, r6\n",
            "str r1, [r11, #{quiet}]\n",
            // Polarities above.
            "ldr r1, [r11, #{north_on_row}]\n",
            "add r1, r1, r5, lsl #2\n",
            "ldr r2, [r1]\n",
            "ands r2, r3\n",
            "cmp r7, #0\n",
            "it ne\n",
            "ldrne r6, [r1, #-4]\n",
            "ands r6, r7\n",
            "cmp r12, #0\n",
            "it ne\n",
            "ldrne lr, [r1, #4]\n",
            "and lr, lr, r12\n",
            "lsls r0, r2, #1\n",
            "orr r0, r0, r6, lsr #31\n",
            "lsrs r6, r2, #1\n",
            "orr r6, r6, lr, lsl #31\n",
            "str r0, [r11, #{north_west_on}]\n",
            "strd r2, r6, [r11, #{north_on}]\n",
            "ldrd r0, r1, [r11, #{all_lists}]\n",
            "add r0, r0, r5, lsl #7\n",
            "add r1, r1, r5, lsl #7\n",
            "strd r0, r1, [r11, #{lists}]\n",
            "b 5b\n",
            // On to the next.
            "55:\n",
            "ldr r0, [r11, #{columns_told}]\n",
            "movs r1, #0\n",
            "str r1, [r0]\n",
            "ldr r0, [r11, #{advance_to}]\n",
            "ldr r1, [r11, #{told_all}]\n",
            "bl {advance}\n",
            "str r0, [r11, #{ahead}]\n",
            "ldrd r5, r6, [r11, #{segment}]\n",
            "ldr r0, [r11, #{told_all}]\n",
            "ldr r1, [r11, #{first_on}]\n",
            "strd r0, r1, [r11, #{made}]\n",
            "b 53b\n",
        )
    };
}

macro_rules! walk_row {
    ($name:ident, $see_old:expr, $polarity_old:expr, $last_old:expr, $row:expr) => {
/// # Safety
/// As `walk` has it.
#[unsafe(naked)]
pub(super) unsafe extern "C" fn $name(walk: &mut Walk) -> u32 {
    naked_asm!(
        // | r4 | r5 | r6 | r7 | r8 | r9 | r10 | r11 |
        // |---|---|---|---|---|---|---|---|
        // | left | column | the next with events | its slot | range | low | out | rates |
        "push {{r3-r11, lr}}",
        "add r11, r0, #{rates}",
        "ldrd r8, r9, [r11, #{range}]",
        "ldr r10, [r11, #{out}]",
        "ldr r4, [r11, #{left}]",
                "b 50f",
        "5:",
        "movs r5, #0",
        // The next pixel.
        "1:",
        "ldr r2, [r11, #{told}]",
        "rbit r6, r2",
        "clz r6, r6",
        "cmp r2, #0",
        "beq 2f",
        "ldrd r0, r3, [r11, #{entries}]",
        "add r0, r0, r6, lsl #3",
        "ldr r1, [r0]",
        "add r7, r3, r1, lsl #3",
        "ldr r12, [r7, #4]",
        "asrs r12, r12, #16",
        "bpl 60f",
        "3:",
        "ldr r12, [r11, #{pixel_room}]",
        "cmp r10, r12",
        "bhi 70f",
        "movw r2, #{no_slot}",
        "movs r3, #0",
        "strd r2, r3, [r0]",
        "ldr r0, [r11, #{lists}]",
        "ldr r2, [r0, r6, lsl #2]",
        "str r1, [r0, r6, lsl #2]",
        "str r2, [r11, #{north_list}]",
        // A column without events.
        "4:",
        "cmp r5, r6",
        "bhs 20f",
        see!("10f", $see_old),
        "ldr r1, [r11, #{pixels}]",
        "add r0, r1, r0, lsl #1",
        zero!(),
        "adds r5, #1",
        "b 4b",
        // No pixel is left.
        "2:",
        "ldr r6, [r11, #{columns}]",
        "movs r7, #0",
        "b 4b",
        // A quiet run. r1: how long.
        "10:",
        "ldr r1, [r11, #{quiet}]",
        "lsls r1, r5",
        "mvns r1, r1",
        "clz r1, r1",
        "clz r2, r1",
        "ldr r0, [r11, #{runs}]",
        "sub r0, r0, r2, lsl #1",
        "add lr, r5, r1",
        "cmp lr, r6",
        "bhi 11f",
        "mov r5, lr",
        zero!(),
        "b 4b",
        // The pixel is in it.
        "11:",
        "ldr r2, [r11, #{columns}]",
        "cmp lr, r2",
        "mov lr, r1",
        "beq 63f",
        "12:",
        one!(),
        "13:",
        "mov r0, #65536",
        "udiv r0, r0, lr",
        "lsrs r8, r8, #16",
        "mul r8, r8, r0",
        "subs r0, r6, r5",
        "mul r0, r0, r8",
        add!("r0"),
        renew!(),
        "mov r5, r6",
        "ldr r0, [r11, #{west_on}]",
        "lsrs r0, r5",
        "and r0, r0, #1",
        "movs r1, #162",
        "ldr r2, [r11, #{polarities}]",
        "mla r0, r0, r1, r2",
        "movs r2, #0",
        "movs r3, #0",
        "b 30f",
        // The next column with events.
        "20:",
        "cmp r7, #0",
        "beq 71f",
        see!("10b", $see_old),
        "mov lr, r0",
        "ldr r1, [r11, #{last_column}]",
        "cmp r1, r5",
        "beq 62f",
        "22:",
        "ldr r1, [r11, #{pixels}]",
        "add r0, r1, lr, lsl #1",
        one!(),
        // Its polarity's context. lr: that of the column.
        "21:",
        "ldrd r3, r1, [r11, #{west_on}]",
        "ldrd r2, r12, [r11, #{north_on}]",
        "lsrs r3, r5",
        "and r3, r3, #1",
        "lsrs r1, r5",
        "bfi r3, r1, #1, #1",
        "lsrs r2, r5",
        "bfi r3, r2, #2, #1",
        "lsr r12, r12, r5",
        "bfi r3, r12, #3, #1",
        "add r3, r3, r11",
        "ldrb r3, [r3, #{weights}]",
        "ubfx r0, lr, #1, #4",
        "add r0, r0, r11",
        "ldrb r0, [r0, #{weights}]",
        "adds r0, r0, r3",
        $polarity_old,
        "ldr r1, [r11, #{polarities}]",
        "add r0, r1, r0, lsl #1",
        "ldr r1, [r11, #{lasts}]",
        "add r1, r1, r5, lsl #2",
        "movs r2, #0",
        "movs r3, #0",
        "tst lr, #2",
        "it ne",
        "ldrne r2, [r1, #-4]",
        "tst lr, #8",
        "it ne",
        "ldrne r3, [r1]",
        // A pixel: r0: its polarity's probability; r2 and r3: the neighbours' last events.
        "30:",
        "strd r2, r3, [r11, #{west_last}]",
        "ldrd r6, r7, [r7]",
        "ldr r1, [r11, #{told}]",
        "subs r2, r1, #1",
        "ands r1, r2",
        "str r1, [r11, #{told}]",
        "lsls r1, r7, #31",
        "bmi 31f",
        zero!(),
        "b 32f",
        "31:",
        one!(),
        "movs r1, #1",
        "lsls r1, r5",
        "ldrd r2, r3, [r11, #{first_on}]",
        "orrs r2, r1",
        "orr r3, r3, r1, lsl #1",
        "strd r2, r3, [r11, #{first_on}]",
        // r6: cell; r7: link.
        "32:",
        "ldr r1, [r11, #{follows}]",
        "cmp r1, #0",
        "bne 80f",
        "ldrd r0, r3, [r11, #{first}]",
        "lsr r1, r6, r3",
        "add r2, r0, r1, lsl #1",
        "ldrh r12, [r2]",
        "ldrh r2, [r2, #2]",
        "lsrs r8, r8, #15",
        symbol!(),
        plain!("r6"),
        learn!("{first_counts}", "{first_left}", "{renew_first}"),
        "subs r4, #1",
        "beq 72f",
        "ldr r1, [r11, #{room}]",
        "cmp r10, r1",
        "bhi 73f",
        rest!(),
        more!(),
        "asrs r1, r7, #16",
        "bpl 40f",
        zero!(),
        // The pixel's end.
        "34:",
        "lsrs r0, r7, #1",
        "adc r0, r6, r6",
        "ldr r1, [r11, #{lasts}]",
        "str r0, [r1, r5, lsl #2]",
        $last_old,
        "adds r5, #1",
        "b 1b",
        // Further events.
        "40:",
        "str r5, [r11, #{column}]",
        one!(),
        "movs r1, #6",
        "movs r2, #36",
        "strd r1, r2, [r11, #{before}]",
        // Its polarity. r5: slot.
        "41:",
        "asrs r1, r7, #16",
        "ldr r2, [r11, #{slots}]",
        "add r5, r2, r1, lsl #3",
        "ldrd r0, r1, [r11, #{last_length}]",
        "lsrs r2, r7, #1",
        "adcs r0, r0",
        "add r0, r0, r0, lsl #3",
        "adds r0, r0, r1",
        "ldrd r1, r2, [r11, #{west_last}]",
        "lsls r3, r6, #1",
        "adds r3, #2",
        "cmp r1, r3",
        "bhs 42f",
        "cmp r2, r3",
        "blo 43f",
        "mov r1, r2",
        "42:",
        "and r1, r1, #1",
        "adds r0, #1",
        "adds r0, r0, r1",
        "43:",
        "ldr r1, [r11, #{flips}]",
        "add r0, r1, r0, lsl #1",
        "ldr r1, [r5, #4]",
        "lsls r1, r1, #31",
        "bmi 44f",
        zero!(),
        "b 45f",
        "44:",
        one!(),
        // Its distance: r5; r12: leading zeros of what is left of the window.
        "45:",
        "and r2, r7, #1",
        "add r1, r2, r2, lsl #1",
        "str r1, [r11, #{before}]",
        "ldrd r5, r7, [r5]",
        "and r1, r7, #1",
        "eors r2, r1",
        "subs r5, r5, r6",
        "ldrd r12, r3, [r11, #{half}]",
        "subs r3, r3, r6",
        "clz r1, r3",
        "cmp r1, r12",
        "ldr r1, [r11, #{last_length}]",
        "it hi",
        "addhi r1, #16",
        "add r1, r1, r11",
        "ldrb r1, [r1, #{of_last}]",
        "adds r1, r1, r2",
        "ldr r0, [r11, #{distances}]",
        "movs r2, #{distances_bytes}",
        "mla r0, r1, r2, r0",
        // r12: what lies within the window.
        "ldrd r2, lr, [r11, #{fine}]",
        "subs r3, #1",
        "clz r12, r3",
        "rsb r12, r12, #32",
        "cmp r12, r2",
        "blo 46f",
        "sub r1, r12, #4",
        "lsrs r3, r1",
        "add r12, r3, r12, lsl #3",
        "sub r12, r12, lr",
        "46:",
        "add r12, r0, r12, lsl #1",
        "ldrh r12, [r12, #2]",
        "udiv r8, r8, r12",
        // r1: symbol; r3: the bits below.
        "clz r1, r5",
        "rsb r1, r1, #32",
        "usat r3, #4, r1",
        "str r3, [r11, #{last_length}]",
        "subs r3, r1, #1",
        "cmp r1, r2",
        "blo 47f",
        "subs r3, #3",
        "lsr r12, r5, r3",
        "add r1, r12, r1, lsl #3",
        "sub r1, r1, lr",
        "47:",
        "usat r3, #4, r3",
        "add r2, r0, r1, lsl #1",
        "ldrh r12, [r2]",
        "ldrh r2, [r2, #2]",
        symbol!(),
        plain!("r5"),
        learn!("{distance_counts}", "{distance_left}", "{renew_distance}"),
        "add r6, r6, r5",
        "subs r4, #1",
        "beq 76f",
        "ldr r1, [r11, #{room}]",
        "cmp r10, r1",
        "bhi 74f",
        rest!(),
        "ldr r2, [r11, #{last_length}]",
        "add r2, r2, r11",
        "ldrb r2, [r2, #{of_last_more}]",
        "adds r1, r1, r2",
        "ldr r2, [r11, #{number}]",
        "adds r1, r1, r2",
        "movs r2, #72",
        "str r2, [r11, #{number}]",
        more!(),
        "asrs r1, r7, #16",
        "bpl 48f",
        zero!(),
        "ldr r5, [r11, #{column}]",
        "b 34b",
        "48:",
        one!(),
        "b 41b",
        // The events of a pixel in a row that follows.
        "80:",
        "strd r8, r9, [r11, #{range}]",
        "str r10, [r11, #{out}]",
        "str r4, [r11, #{left}]",
        "str r5, [r11, #{column}]",
        "ldr r0, [r11, #{advance_to}]",
        "sub r1, r11, #{rates}",
        "mov r2, r6",
        "mov r3, r7",
        "bl {follow}",
        "ldrd r8, r9, [r11, #{range}]",
        "ldr r10, [r11, #{out}]",
        "ldr r4, [r11, #{left}]",
        "cmp r0, #0",
        "bne 75f",
        "adds r5, #1",
        "b 1b",
        // Whether a pixel's events are in order. r12: the next slot; r2: time of the one before.
        "60:",
        "ldr r2, [r7]",
        "61:",
        "add r12, r3, r12, lsl #3",
        "ldrd lr, r12, [r12]",
        "cmp lr, r2",
        "blo 70f",
        "mov r2, lr",
        "asrs r12, r12, #16",
        "bpl 61b",
        "b 3b",
        // The last column: where no other has events it does.
        "62:",
        "ldrd r2, r3, [r11, #{told}]",
        "cmp r2, r3",
        "beq 21b",
        "b 22b",
        "63:",
        "ldrd r2, r3, [r11, #{told}]",
        "cmp r2, r3",
        "beq 13b",
        "b 12b",
        "70:",
        "movs r0, #{left_to}",
        "str r5, [r11, #{column}]",
        "b 75f",
        $row,
        "71:",
                "b 55b",
        "72:",
        "str r5, [r11, #{column}]",
        "76:",
        "movs r0, #{over}",
        "b 77f",
        "73:",
        "str r5, [r11, #{column}]",
        "74:",
        "movs r0, #{full}",
        "77:",
        "str r7, [r11, #{link}]",
        "75:",
        "strd r8, r9, [r11, #{range}]",
        "str r10, [r11, #{out}]",
        "str r4, [r11, #{left}]",
        "pop {{r3-r11, pc}}",
        carry!(),
        renew_first = sym renew_first,
        renew_distance = sym renew_distance,
        rates = const offset_of!(Walk, rates),
        no_slot = const NO_SLOT,
        left_to = const LEFT,
        over = const OVER,
        full = const FULL,
        first_counts = const Symbols::<FIRST_SYMBOLS>::COUNTS_AT,
        first_left = const Symbols::<FIRST_SYMBOLS>::LEFT_AT,
        distance_counts = const Symbols::<DISTANCES>::COUNTS_AT,
        distance_left = const Symbols::<DISTANCES>::LEFT_AT,
        distances_bytes = const size_of::<Symbols<DISTANCES>>(),
        weights = const at(offset_of!(Walk, weights)),
        of_last = const at(offset_of!(Walk, of_last)),
        of_last_more = const at(offset_of!(Walk, of_last_more)),
        range = const at(offset_of!(Walk, range)),
        out = const at(offset_of!(Walk, out)),
        start = const at(offset_of!(Walk, start)),
        room = const at(offset_of!(Walk, room)),
        pixel_room = const at(offset_of!(Walk, pixel_room)),
        told = const at(offset_of!(Walk, told)),
        quiet = const at(offset_of!(Walk, quiet)),
        columns = const at(offset_of!(Walk, columns)),
        last_column = const at(offset_of!(Walk, last_column)),
        entries = const at(offset_of!(Walk, entries)),
        slots = const at(offset_of!(Walk, slots)),
        lists = const at(offset_of!(Walk, lists)),
        lasts = const at(offset_of!(Walk, lasts)),
        pixels = const at(offset_of!(Walk, pixels)),
        runs = const at(offset_of!(Walk, runs)),
        polarities = const at(offset_of!(Walk, polarities)),
        more = const at(offset_of!(Walk, more)),
        flips = const at(offset_of!(Walk, flips)),
        first = const at(offset_of!(Walk, first)),
        distances = const at(offset_of!(Walk, distances)),
        half = const at(offset_of!(Walk, half)),
        rests = const RESTS,
        fine = const at(offset_of!(Walk, fine)),
        old = const at(offset_of!(Walk, old)),
        later = const at(offset_of!(Walk, later)),
        old_on = const at(offset_of!(Walk, old_on)),
        south_row = const at(offset_of!(Walk, south_row)),
                last_on_row = const at(offset_of!(Walk, last_on_row)),
                last_on = const at(offset_of!(Walk, last_on)),
        first_on = const at(offset_of!(Walk, first_on)),
        west_on = const at(offset_of!(Walk, west_on)),
        north_on = const at(offset_of!(Walk, north_on)),
        west_last = const at(offset_of!(Walk, west_last)),
        last_length = const at(offset_of!(Walk, last_length)),
        before = const at(offset_of!(Walk, before)),
        number = const at(offset_of!(Walk, number)),
        column = const at(offset_of!(Walk, column)),
        link = const at(offset_of!(Walk, link)),
        told_all = const at(offset_of!(Walk, told_all)),
        north_west_on = const at(offset_of!(Walk, north_west_on)),
        segment = const at(offset_of!(Walk, segment)),
        last_columns = const at(offset_of!(Walk, last_columns)),
        ahead = const at(offset_of!(Walk, ahead)),
        north_row = const at(offset_of!(Walk, north_row)),
        far_north_row = const at(offset_of!(Walk, far_north_row)),
        north_on_row = const at(offset_of!(Walk, north_on_row)),
        here_row = const at(offset_of!(Walk, here_row)),
        made = const at(offset_of!(Walk, made)),
        north_here = const at(offset_of!(Walk, north_here)),
        north_next = const at(offset_of!(Walk, north_next)),
        crowds = const at(offset_of!(Walk, crowds)),
        all_lists = const at(offset_of!(Walk, all_lists)),
        columns_told = const at(offset_of!(Walk, columns_told)),
        advance_to = const at(offset_of!(Walk, advance)),
        advance = sym advance,
        follow = sym follow,
        follows = const at(offset_of!(Walk, follows)),
        north_list = const at(offset_of!(Walk, north_list)),
        row_end = const ROW,
        flag = const FLAG,
        left = const at(offset_of!(Walk, left)),
    )
}
    };
}

walk_row!(
    walk_row,
    "",
    "/* {old} {later} {old_on} {last_on} {south_row} {last_on_row} */",
    "",
    row!("", "lsls r3, r3, #4\n", "", "")
);
walk_row!(
    walk_row_after,
    concat!(
        "ldrd r1, r2, [r11, #{old}]\n",
        "ldr r3, [r11, #{later} + 4]\n",
        "lsrs r1, r5\n",
        "bfi r0, r1, #6, #1\n",
        "lsrs r2, r5\n",
        "bfi r0, r2, #7, #1\n",
        "lsrs r3, r5\n",
        "bfi r0, r3, #8, #1\n",
    ),
    concat!(
        "ldr r1, [r11, #{old_on}]\n",
        "lsrs r1, r5\n",
        "and r1, r1, #1\n",
        "adds r0, r0, r1\n",
        "ubfx r1, lr, #6, #1\n",
        "adds r0, r0, r1\n",
    ),
    concat!(
        "and r2, r7, #1\n",
        "lsls r2, r5\n",
        "ldr r3, [r11, #{last_on}]\n",
        "orrs r3, r2\n",
        "str r3, [r11, #{last_on}]\n",
    ),
    row!(
        concat!(
            "ldr r7, [r11, #{here_row}]\n",
            "ldr r7, [r7, r5, lsl #2]\n",
            "orr r12, r12, r7\n",
        ),
        concat!("lsls r3, r3, #2\n", few!("r3", "r7"), "lsls r3, r3, #2\n"),
        concat!(
            "push {{r1, r2, r3, r7, r12}}\n",
            "ldr r6, [r11, #{here_row}]\n",
            "add r6, r6, r5, lsl #2\n",
            "ldr r0, [r6]\n",
            "ldr r3, [r11, #{segment} + 4]\n",
            "movs r2, #0\n",
            "mov r12, #0\n",
            "cmp r5, r3\n",
            "it ne\n",
            "ldrne r2, [r6, #4]\n",
            "ldr r6, [r11, #{south_row}]\n",
            "add r6, r6, r5, lsl #2\n",
            "ldr r7, [r6]\n",
            "it ne\n",
            "ldrne r12, [r6, #4]\n",
            "movs r1, #0\n",
            "cmp r5, #0\n",
            "it ne\n",
            "ldrne r1, [r6, #-4]\n",
            // To the east, and of the row below in the south-west, south and south-east.
            "lsr lr, r0, #1\n",
            "orr lr, lr, r2, lsl #31\n",
            "lsrs r1, r1, #31\n",
            "orr r1, r1, r7, lsl #1\n",
            "lsrs r2, r7, #1\n",
            "orr r2, r2, r12, lsl #31\n",
            // How many of the four.
            "eor r3, lr, r1\n",
            "and lr, lr, r1\n",
            "eor r1, r7, r2\n",
            "ands r7, r2\n",
            "eor r2, r3, r1\n",
            "and r12, lr, r7\n",
            "orr r2, r2, r12\n",
            "orr lr, lr, r7\n",
            "ands r3, r1\n",
            "orr r3, r3, lr\n",
            "strd r0, r2, [r11, #{old}]\n",
            "ldr r1, [r11, #{last_on_row}]\n",
            "ldr r1, [r1, r5, lsl #2]\n",
            "ands r1, r0\n",
            "strd r3, r1, [r11, #{later} + 4]\n",
            "orrs r2, r0\n",
            "orr lr, r2, r3\n",
            "pop {{r1, r2, r3, r7, r12}}\n",
            "orr r1, r1, lr\n",
        ),
        concat!(
            "ldr r2, [r11, #{last_on}]\n",
            "ldr r3, [r11, #{last_on_row}]\n",
            "str r2, [r3, r5, lsl #2]\n",
            "movs r2, #0\n",
            "str r2, [r11, #{last_on}]\n",
        )
    )
);
