//! Times of a pixel in assembly: contexts, and all events of a pixel in a row that follows. It codes the same as
//! [`times`](crate::coder::dense::times), to the bit. [`walk`](super::walk) calls it with the range coder's state
//! in registers.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::mem::offset_of;

use crate::coder::dense::armv7em::state::{DONE, FULL, OVER, Walk};
use crate::coder::dense::times::{
    DISTANCES, FIRST_BITS, FIRST_SYMBOLS, LENGTHS, LOOK_AHEAD, LearnedTimes, NEARS,
    PREFIX_CONTEXTS, PREFIX_FIRST, PREFIX_LENGTHS, TRIAL_LENGTH, TRIALS_MAX,
};
use crate::coder::range::armv7em::{
    at, carry, learn, one, plain, renew, renew_twice, symbol, zero,
};
use crate::coder::range::symbols::Symbols;
use crate::coder::range::{PLAIN_BITS, Probability};

const PREFIX_BYTES: usize = PREFIX_CONTEXTS * size_of::<Probability>();

// Assumptions of the assembly.
const _: () = assert!(LENGTHS == 16 && NEARS == 9 && LOOK_AHEAD == 4);
const _: () = assert!(PREFIX_LENGTHS.0 == 4 && PREFIX_LENGTHS.1 == 13 && TRIAL_LENGTH == 6);

pub(crate) unsafe extern "C" fn renew_first(table: &mut Symbols<FIRST_SYMBOLS>) {
    table.renew();
}

pub(crate) unsafe extern "C" fn renew_distance(table: &mut Symbols<DISTANCES>) {
    table.renew();
}

/// Completes the context of whether there is another event, a part of which is in r1. The probability is then number
/// r0 of those from lr on.
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
            "lsrs r2, r7, #1\n",
            "adc r0, r1, r1\n",
            "ldr lr, [r11, #{more}]\n",
        )
    };
}

/// Loads six times the context of what is left of the window into r1.
macro_rules! rest {
    () => {
        concat!(
            "ldrd r1, r2, [r11, #{cells}]\n",
            "subs r1, r1, r6\n",
            "clz r1, r1\n",
            "ldrb r1, [r2, r1]\n",
        )
    };
}

pub(crate) use {more, rest};

/// Moves a neighbour's slot in a register (0 for none) beyond cell r6. r12: slots. Overwrites r2 and r3.
macro_rules! after {
    ($near:literal) => {
        concat!(
            concat!(
                "cmp ",
                $near,
                ", #0\nbeq 92f\n91:\nldrd r2, r3, [",
                $near,
                "]\n"
            ),
            "cmp r2, r6\nbhi 92f\nasrs r3, r3, #16\n",
            concat!(
                "add ",
                $near,
                ", r12, r3, lsl #3\nbpl 91b\nmovs ",
                $near,
                ", #0\n92:\n"
            ),
        )
    };
}

/// From a neighbour's slot in a register (0 for none), computes in r2 the distance to its next event of r7's
/// polarity, and branches to label 24 if that has as many bits as r5. r12: slots. Overwrites r3 and lr.
macro_rules! like {
    ($near:literal) => {
        concat!(
            concat!("cmp ", $near, ", #0\nbeq 93f\nmov lr, #4\n91:\n"),
            concat!("ldrd r2, r3, [", $near, "]\nasr ", $near, ", r3, #16\n"),
            "eors r3, r7\nlsls r3, r3, #31\nbmi 92f\n",
            "subs r2, r2, r6\nclz r3, r2\ncmp r3, r0\nbeq 24f\nb 93f\n92:\n",
            concat!(
                "cmp ",
                $near,
                ", #0\nblt 93f\nadd ",
                $near,
                ", r12, ",
                $near,
                ", lsl #3\n"
            ),
            "subs lr, lr, #1\nbne 91b\n93:\n",
        )
    };
}

/// Codes the events of a pixel, after the polarity of the first.
///
/// r4 to r11 are as in the walk, r6 the first event's cell and r7 its link. Returns in r0 how it ended; r6 and r7
/// are then those of the last event, and r5 is overwritten.
///
/// # Safety
/// As for the walk, whose `rates` r11 points to.
#[unsafe(naked)]
pub(crate) unsafe extern "C" fn follow() {
    naked_asm!(
        "push {{r3, lr}}",
        // The neighbours' first events: r0 and r1.
        "ldr r12, [r11, #{slots}]",
        "movs r0, #0",
        "movs r1, #0",
        "ldr r2, [r11, #{west}]",
        "lsrs r2, r5",
        "lsls r2, r2, #30",
        "bpl 1f",
        "ldr r2, [r11, #{lists}]",
        "add r2, r2, r5, lsl #2",
        "ldr r0, [r2, #-4]",
        "add r0, r12, r0, lsl #3",
        "1:",
        "ldr r2, [r11, #{north}]",
        "lsrs r2, r5",
        "lsls r2, r2, #31",
        "bpl 2f",
        "ldr r1, [r11, #{north_list}]",
        "add r1, r12, r1, lsl #3",
        "2:",
        "strd r0, r1, [r11, #{near}]",
        "cbz r0, 3f",
        "ldrd r2, r3, [r0]",
        "eors r3, r7",
        "lsls r3, r3, #31",
        "bpl 4f",
        "3:",
        "cbz r1, 5f",
        "ldrd r2, r3, [r1]",
        "eors r3, r7",
        "lsls r3, r3, #31",
        "bmi 5f",
        // By the first of them with its polarity. r2: that event's cell.
        "4:",
        "ldr r0, [r11, #{prefixes}]",
        "add r0, r0, #{first_prefix}",
        "ldr r3, [r11, #{first} + 4]",
        "adds r3, #{first_bits}",
        "mov r12, r6",
        "movs r1, #1",
        "bl {prefix}",
        "b 6f",
        "5:",
        "ldrd r0, r3, [r11, #{first}]",
        "lsr r1, r6, r3",
        "add r2, r0, r1, lsl #1",
        "ldrh r12, [r2]",
        "ldrh r2, [r2, #2]",
        "lsrs r8, r8, #15",
        symbol!(),
        plain!("r6"),
        learn!("{first_counts}", "{first_left}", "{renew_first}"),
        "6:",
        "subs r4, #2",
        "blo 30f",
        "ldr r1, [r11, #{room}]",
        "cmp r10, r1",
        "bhi 31f",
        rest!(),
        more!(),
        "asrs r1, r7, #16",
        "bpl 7f",
        zero!("lr"),
        "movs r0, #{done}",
        "pop {{r3, pc}}",
        "7:",
        one!("lr"),
        "movs r1, #6",
        "movs r2, #36",
        "strd r1, r2, [r11, #{before}]",
        // The next event's polarity. r5: slot; r3: prediction from the neighbours' next events.
        "8:",
        "ldr r12, [r11, #{slots}]",
        "asrs r1, r7, #16",
        "add r5, r12, r1, lsl #3",
        "ldrd r0, r1, [r11, #{near}]",
        after!("r0"),
        after!("r1"),
        "strd r0, r1, [r11, #{near}]",
        "movs r3, #0",
        "cbnz r0, 9f",
        "mov r0, r1",
        "cbz r0, 10f",
        "9:",
        "ldr r3, [r0, #4]",
        "and r3, r3, #1",
        "adds r3, #1",
        "10:",
        "ldrd r0, r1, [r11, #{last_length}]",
        "lsrs r2, r7, #1",
        "adcs r0, r0",
        "add r0, r0, r0, lsl #3",
        "adds r0, r0, r1",
        "adds r0, r0, r3",
        "ldr lr, [r11, #{flips}]",
        "ldr r1, [r5, #4]",
        "lsls r1, r1, #31",
        "bmi 11f",
        zero!("lr"),
        "b 12f",
        "11:",
        one!("lr"),
        // Its distance: r5. lr: whether the polarity flips.
        "12:",
        "and r2, r7, #1",
        "add r1, r2, r2, lsl #1",
        "str r1, [r11, #{before}]",
        "ldrd r5, r7, [r5]",
        "and r1, r7, #1",
        "eor lr, r2, r1",
        "subs r5, r5, r6",
        // r2: distance to the nearer of the neighbours' next events, 0 for none.
        "ldrd r0, r1, [r11, #{near}]",
        "movs r2, #0",
        "cbz r0, 13f",
        "ldr r2, [r0]",
        "subs r2, r2, r6",
        "cbz r1, 14f",
        "ldr r3, [r1]",
        "subs r3, r3, r6",
        "cmp r3, r2",
        "it lo",
        "movlo r2, r3",
        "b 14f",
        "13:",
        "cbz r1, 14f",
        "ldr r2, [r1]",
        "subs r2, r2, r6",
        "14:",
        // r6: the tree of its length.
        "clz r2, r2",
        "rsbs r2, r2, #32",
        "cmp r2, #16",
        "it hi",
        "movhi r2, #16",
        "add r2, r2, r11",
        "ldrb r2, [r2, #{of_near}]",
        "ldr r1, [r11, #{last_length}]",
        "add r1, r1, r11",
        "ldrb r1, [r1, #{of_last}]",
        "add r1, r1, r1, lsl #3",
        "add r2, r2, lr",
        "adds r1, r1, r2",
        "ldr r0, [r11, #{lengths}]",
        "push {{r6, r7}}",
        "add r6, r0, r1, lsl #5",
        // r7: the length in its four low bits, and a one above.
        "clz r1, r5",
        "ldr r2, [r11, #{short}]",
        "rsb r1, r1, #32",
        "subs r1, r1, r2",
        "it lo",
        "movlo r1, #0",
        "orr r7, r1, #16",
        "mov lr, #4",
        "15:",
        "lsrs r0, r7, lr",
        "add r0, r6, r0, lsl #1",
        "bcs 16f",
        zero!(),
        "subs lr, lr, #1",
        "bne 15b",
        "b 17f",
        "16:",
        one!(),
        "subs lr, lr, #1",
        "bne 15b",
        "17:",
        "lsls r0, r7, #28",
        "pop {{r6, r7}}",
        "bne 18f",
        // Shorter than any distance whose length is coded.
        "ldr r3, [r11, #{short}]",
        "lsrs r8, r3",
        "umlal r9, r4, r5, r8",
        renew_twice!(),
        "b 28f",
        // Find an event among the neighbours' next ones at a distance of its length. r0: leading zeros.
        "18:",
        "ldr r12, [r11, #{slots}]",
        "clz r0, r5",
        "ldr r1, [r11, #{near}]",
        like!("r1"),
        "ldr r1, [r11, #{near} + 4]",
        like!("r1"),
        // None: a tree of three bits.
        "rsb r3, r0, #31",
        "bl 40f",
        "movs r1, #0",
        "b 27f",
        "24:",
        "rsb r3, r0, #31",
        "bl 40f",
        "ldr r1, [r11, #{tries}]",
        "cbz r1, 26f",
        "cmp r3, #{trial_length} - 1",
        "blo 26f",
        // Count whether following was right.
        "ldr r1, [r11, #{trials}]",
        "ldrh r12, [r1]",
        "ldrh lr, [r1, #{matches}]",
        "add r12, r12, #1",
        "cmp r2, r5",
        "it eq",
        "addeq lr, lr, #1",
        "cmp r12, #{trials_max}",
        "itt hs",
        "lsrhs r12, r12, #1",
        "lsrhs lr, lr, #1",
        "strh r12, [r1]",
        "strh lr, [r1, #{matches}]",
        "26:",
        "movs r1, #1",
        "27:",
        "mov r12, r5",
        "bl {prefix}",
        "28:",
        "clz r1, r5",
        "rsb r1, r1, #32",
        "usat r2, #4, r1",
        "str r2, [r11, #{last_length}]",
        "add r6, r6, r5",
        "subs r4, #2",
        "blo 30f",
        "ldr r1, [r11, #{room}]",
        "cmp r10, r1",
        "bhi 31f",
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
        "bpl 29f",
        zero!("lr"),
        "movs r0, #{done}",
        "pop {{r3, pc}}",
        "29:",
        one!("lr"),
        "b 8b",
        "30:",
        "movs r0, #{over}",
        "pop {{r3, pc}}",
        "31:",
        "movs r0, #{full}",
        "pop {{r3, pc}}",
        // r0: contexts of the r3 bits below the highest.
        "40:",
        "subs r1, r3, #3",
        "it lt",
        "movlt r1, #0",
        "cmp r1, #9",
        "it hi",
        "movhi r1, #9",
        "ldr r0, [r11, #{prefixes}]",
        "mov r12, #{prefix_bytes}",
        "mla r0, r1, r12, r0",
        "bx lr",
        renew_first = sym renew_first,
        carry = sym carry,
        prefix = sym prefix,
        done = const DONE,
        over = const OVER,
        full = const FULL,
        slots = const at(offset_of!(Walk, slots)),
        west = const offset_of!(Walk, west) as isize - offset_of!(Walk, rates) as isize,
        north = const offset_of!(Walk, north) as isize - offset_of!(Walk, rates) as isize,
        lists = const at(offset_of!(Walk, lists)),
        north_list = const at(offset_of!(Walk, north_list)),
        near = const at(offset_of!(Walk, near)),
        prefixes = const at(offset_of!(Walk, prefixes)),
        lengths = const at(offset_of!(Walk, lengths)),
        tries = const at(offset_of!(Walk, tries)),
        short = const at(offset_of!(Walk, short)),
        of_near = const at(offset_of!(Walk, of_near)),
        prefix_bytes = const PREFIX_BYTES,
        first_prefix = const PREFIX_FIRST * PREFIX_BYTES,
        trials = const at(offset_of!(Walk, trials)),
        matches = const offset_of!(LearnedTimes, matches) as isize - offset_of!(LearnedTimes, trials) as isize,
        trial_length = const TRIAL_LENGTH,
        first_bits = const FIRST_BITS,
        trials_max = const TRIALS_MAX,
        first = const at(offset_of!(Walk, first)),
        first_counts = const Symbols::<FIRST_SYMBOLS>::COUNTS_AT,
        first_left = const Symbols::<FIRST_SYMBOLS>::LEFT_AT,
        room = const at(offset_of!(Walk, room)),
        cells = const at(offset_of!(Walk, cells)),
        more = const at(offset_of!(Walk, more)),
        flips = const at(offset_of!(Walk, flips)),
        west_last = const at(offset_of!(Walk, west_last)),
        last_length = const at(offset_of!(Walk, last_length)),
        before = const at(offset_of!(Walk, before)),
        number = const at(offset_of!(Walk, number)),
        of_last = const at(offset_of!(Walk, of_last)),
        of_last_more = const at(offset_of!(Walk, of_last_more)),
    )
}

/// Codes the low r3 bits of r12. If r1 is not 0, candidate r2 may share the upper ones. r0: contexts.
///
/// # Safety
/// As for [`follow`].
#[unsafe(naked)]
unsafe extern "C" fn prefix() {
    naked_asm!(
        "push {{r5, r6, r7, lr}}",
        "mov lr, r3",
        "rsb r3, r3, #32",
        "lsl r5, r12, r3",
        "cmp lr, #0",
        "beq 20f",
        "cmp r1, #0",
        "beq 11f",
        // Follow the candidate as long as it is right. r5: the bits, the next at the top; r6: where the candidate
        // differs; lr: how many are left; r7: contexts, less the two of a place.
        "lsls r2, r3",
        "eor r6, r5, r2",
        "subs r7, r0, #4",
        "1:",
        "eor r3, r5, r6",
        "usat r0, #4, lr",
        "sub lr, lr, #1",
        "lsls r3, r3, #1",
        "adcs r0, r0",
        "add r0, r7, r0, lsl #1",
        "lsls r5, r5, #1",
        "bcs 2f",
        zero!(),
        "lsls r6, r6, #1",
        "bcs 6f",
        "cmp lr, #0",
        "bne 1b",
        "b 20f",
        "2:",
        one!(),
        "lsls r6, r6, #1",
        "bcs 3f",
        "cmp lr, #0",
        "bne 1b",
        "b 20f",
        // Just above the candidate: zeros, up to a one. r6: its bits.
        "3:",
        "eors r6, r5",
        "adds r7, #68",
        "orr lr, lr, #0x300",
        "4:",
        "lsls r0, lr, #24",
        "beq 20f",
        "movs r0, #0",
        "lsls r6, r6, #1",
        "adcs r0, r0",
        "add r0, r7, r0, lsl #1",
        "adds r7, #8",
        "subw lr, lr, #0x101",
        "lsls r5, r5, #1",
        "bcs 5f",
        zero!(),
        "lsrs r0, lr, #8",
        "bne 4b",
        "b 15f",
        "5:",
        one!(),
        "b 15f",
        // Just below the candidate: ones, up to a zero.
        "6:",
        "eors r6, r5",
        "adds r7, #64",
        "orr lr, lr, #0x300",
        "7:",
        "lsls r0, lr, #24",
        "beq 20f",
        "movs r0, #0",
        "lsls r6, r6, #1",
        "adcs r0, r0",
        "add r0, r7, r0, lsl #1",
        "adds r7, #8",
        "subw lr, lr, #0x101",
        "lsls r5, r5, #1",
        "bcs 8f",
        zero!(),
        "b 15f",
        "8:",
        one!(),
        "lsrs r0, lr, #8",
        "bne 7b",
        "b 15f",
        // Without a candidate: a tree of three bits. r6: its node.
        "11:",
        "add r7, r0, #84",
        "movs r6, #1",
        "12:",
        "add r0, r7, r6, lsl #1",
        "sub lr, lr, #1",
        "lsls r6, r6, #1",
        "lsls r5, r5, #1",
        "bcs 13f",
        zero!(),
        "b 14f",
        "13:",
        one!(),
        "adds r6, #1",
        "14:",
        "cmp lr, #0",
        "beq 20f",
        "cmp r6, #8",
        "blo 12b",
        // The rest as plain bits.
        "15:",
        "uxtb lr, lr",
        "16:",
        "cmp lr, #0",
        "beq 20f",
        "mov r3, lr",
        "cmp r3, #{plain_bits}",
        "it hi",
        "movhi r3, #{plain_bits}",
        "sub lr, lr, r3",
        "rsb r0, r3, #32",
        "lsr r2, r5, r0",
        "lsls r5, r3",
        "lsrs r8, r3",
        "umlal r9, r4, r2, r8",
        renew_twice!(),
        "b 16b",
        "20:",
        "pop {{r5, r6, r7, pc}}",
        carry = sym carry,
        plain_bits = const PLAIN_BITS,
    )
}
