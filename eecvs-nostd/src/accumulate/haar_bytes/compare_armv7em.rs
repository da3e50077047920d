//! Comparisons of the lanes of a word: two instructions for four.

use super::ONES;

/// A 1 in the lanes of `word` that are as large as those of `threshold`.
#[inline(always)]
pub fn reach(word: u32, threshold: u32) -> u32 {
    let flags;
    // SAFETY: reads and writes registers and the flags alone; this file is
    // only for cores that have the instructions.
    unsafe {
        core::arch::asm!("usub8 {flags}, {word}, {threshold}", "sel {flags}, {ones}, {zero}",
            flags = out(reg) flags, word = in(reg) word, threshold = in(reg) threshold,
            ones = in(reg) ONES, zero = in(reg) 0, options(pure, nomem, nostack));
    }
    flags
}

/// A 1 in the lanes of `word` that are not 0.
#[inline(always)]
pub fn nonzero(word: u32) -> u32 {
    reach(word, ONES)
}
