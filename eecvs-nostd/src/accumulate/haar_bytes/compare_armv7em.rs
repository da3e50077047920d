//! Compares the four lanes of a word in two instructions.

use super::ONES;

/// Returns a 1 in each lane of `word` that is at least as large as that of `threshold`.
#[inline(always)]
pub fn reach(word: u32, threshold: u32) -> u32 {
    let flags;
    // SAFETY: reads and writes only registers and the flags. This file is built only for cores that have the
    // instructions.
    unsafe {
        core::arch::asm!("usub8 {flags}, {word}, {threshold}", "sel {flags}, {ones}, {zero}",
            flags = out(reg) flags, word = in(reg) word, threshold = in(reg) threshold,
            ones = in(reg) ONES, zero = in(reg) 0, options(pure, nomem, nostack));
    }
    flags
}

/// Returns a 1 in each lane of `word` that is not 0.
#[inline(always)]
pub fn nonzero(word: u32) -> u32 {
    reach(word, ONES)
}
