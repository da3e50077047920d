//! Compares the lanes of a word.

use super::SIGNS;

/// Returns a 1 in each lane of `word` that is at least `threshold`; all lanes of both must be below 128.
#[inline(always)]
pub(super) const fn reach(word: u32, threshold: u32) -> u32 {
    ((word | SIGNS).wrapping_sub(threshold) & SIGNS) >> 7
}

/// Returns a 1 in each lane of `word` that is not 0.
#[inline(always)]
pub(super) const fn nonzero(word: u32) -> u32 {
    ((((word & !SIGNS) + !SIGNS) | word) & SIGNS) >> 7
}
