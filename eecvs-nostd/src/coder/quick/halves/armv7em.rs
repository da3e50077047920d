//! The halves with the DSP instructions of a Cortex-M4 or M7.
#![allow(unsafe_code)]

use core::arch::asm;

/// Widens the bounds of both halves, least and most, by those of `word`.
#[inline(always)]
pub fn widen((mut least, mut most): (u32, u32), word: u32) -> (u32, u32) {
    // SAFETY: works on registers alone; `eecvs_dsp` is set for cores that have these instructions.
    unsafe {
        asm!(
            "usub16 {d}, {most}, {word}",
            "sel {most}, {most}, {word}",
            "usub16 {d}, {word}, {least}",
            "sel {least}, {least}, {word}",
            d = out(reg) _, least = inout(reg) least, most = inout(reg) most, word = in(reg) word,
            options(pure, nomem, nostack),
        );
    }
    (least, most)
}

/// Returns the sum of the products of both halves, all below 2^15.
#[inline(always)]
pub fn dot(a: u32, b: u32) -> u32 {
    let sum;
    // SAFETY: works on registers alone; `eecvs_dsp` is set for cores that have this instruction.
    unsafe {
        asm!(
            "smuad {sum}, {a}, {b}",
            sum = lateout(reg) sum, a = in(reg) a, b = in(reg) b,
            options(pure, nomem, nostack),
        );
    }
    sum
}

/// Returns `sum` plus the sum of the products of both halves, all below 2^15.
#[inline(always)]
pub fn dot_add(a: u32, b: u32, sum: u32) -> u32 {
    let result;
    // SAFETY: works on registers alone; `eecvs_dsp` is set for cores that have this instruction.
    unsafe {
        asm!(
            "smlad {result}, {a}, {b}, {sum}",
            result = lateout(reg) result, a = in(reg) a, b = in(reg) b, sum = in(reg) sum,
            options(pure, nomem, nostack),
        );
    }
    result
}
