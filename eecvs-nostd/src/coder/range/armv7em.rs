//! Steps of the range coder in assembly, for walks that keep its state in registers. They write the same bits as
//! [`range`](super).
//!
//! | r4 | r8 | r9 | r10 | r11 |
//! |---|---|---|---|---|
//! | lowest bit: carry of low | range | low | address of the next byte | address of the walk's `rates` |
//!
//! Low plus range is below 2^33, so low carries at most once between two bytes: the carry waits in r4 until the
//! next byte is written.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::mem::offset_of;

use crate::coder::dense::armv7em::state::Walk;

/// Returns a field's offset from r11.
pub(crate) const fn at(offset: usize) -> usize {
    offset - offset_of!(Walk, rates)
}

/// Writes a byte if the range has become short. Overwrites r2.
macro_rules! renew {
    () => {
        "cmp r8, #0x1000000
        bhs 97f
        lsls r2, r4, #31
        bpl 96f
        push {{lr}}
        bl {carry}
        pop {{lr}}
        96:
        lsr r2, r9, #24
        strb r2, [r10], #1
        lsls r9, r9, #8
        lsls r8, r8, #8
        97:
        "
    };
}

/// Writes up to two bytes, while the range is short. Overwrites r2.
macro_rules! renew_twice {
    () => {
        "cmp r8, #0x1000000
        bhs 97f
        lsls r2, r4, #31
        bpl 96f
        push {{lr}}
        bl {carry}
        pop {{lr}}
        96:
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

/// Codes a one. Its probability is at address r0, or is number r0 of those from a register on. Overwrites r1 to r3
/// and r12.
macro_rules! one {
    () => {
        one!(@ "[r0]")
    };
    ($from:literal) => {
        one!(@ concat!("[", $from, ", r0, lsl #1]"))
    };
    (@ $place:expr) => {
        concat!(
            concat!("ldrh r1, ", $place, "\n"),
            "lsr r2, r8, #13\n",
            "lsr r3, r1, #3\n",
            "and r12, r1, #7\n",
            "mul r8, r2, r3\n",
            "ldrh r12, [r11, r12, lsl #1]\n",
            "rsb r2, r3, #8192\n",
            "smlawb r3, r12, r2, r3\n",
            "bfi r12, r3, #3, #13\n",
            concat!("strh r12, ", $place, "\n"),
            renew!(),
        )
    };
}

/// Codes a zero, with operands and overwritten registers as in `one`.
macro_rules! zero {
    () => {
        zero!(@ "[r0]")
    };
    ($from:literal) => {
        zero!(@ concat!("[", $from, ", r0, lsl #1]"))
    };
    (@ $place:expr) => {
        concat!(
            concat!("ldrh r1, ", $place, "\n"),
            "lsr r2, r8, #13\n",
            "lsr r3, r1, #3\n",
            "and r12, r1, #7\n",
            "mls r8, r2, r3, r8\n",
            "ldrh r12, [r11, r12, lsl #1]\n",
            "umlal r9, r4, r2, r3\n",
            "mul r2, r3, r12\n",
            "sub r3, r3, r2, lsr #16\n",
            "bfi r12, r3, #3, #13\n",
            concat!("strh r12, ", $place, "\n"),
            renew!(),
        )
    };
}

/// Codes a symbol by its share: r12 is the share's begin, r2 its end, and r8 the range per unit of share.
macro_rules! symbol {
    () => {
        concat!(
            "sub r2, r2, r12\n",
            "umlal r9, r4, r12, r8\n",
            "mul r8, r8, r2\n",
            renew_twice!(),
        )
    };
}

/// Codes the lowest r3 bits of a register as plain bits. Overwrites r2.
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
            "umlal r9, r4, r2, r8\n",
            renew_twice!(),
        )
    };
}

/// Counts symbol r1 in table r0.
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

pub(crate) use {learn, one, plain, renew, renew_twice, symbol, zero};

/// Adds one to the last of the bytes written and clears r4's lowest bit. Overwrites only r2 and lr.
///
/// Low carries only after a byte was written, as the number is below 1.
#[unsafe(naked)]
pub(crate) unsafe extern "C" fn carry() {
    naked_asm!(
        "bic r4, r4, #1",
        "ldrb r2, [r10, #-1]",
        "adds r2, #1",
        "strb r2, [r10, #-1]",
        "lsls r2, r2, #24",
        "beq 1f",
        "bx lr",
        "1:",
        "push {{r0, r1}}",
        "sub r0, r10, #1",
        "ldr r2, [r11, #{start}]",
        "2:",
        "cmp r0, r2",
        "beq 3f",
        "ldrb r1, [r0, #-1]!",
        "adds r1, #1",
        "strb r1, [r0]",
        "lsls r1, r1, #24",
        "beq 2b",
        "3:",
        "pop {{r0, r1}}",
        "bx lr",
        start = const at(offset_of!(Walk, start)),
    )
}
