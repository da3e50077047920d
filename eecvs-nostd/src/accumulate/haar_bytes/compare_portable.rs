//! Comparisons of the lanes of a word.

use super::SIGNS;

/// A 1 in the lanes that are `threshold` or above; all of both are below 128.
#[inline(always)]
pub(super) const fn reach(word: u32, threshold: u32) -> u32 {
    ((word | SIGNS).wrapping_sub(threshold) & SIGNS) >> 7
}

/// A 1 in the lanes that are not 0.
#[inline(always)]
pub(super) const fn nonzero(word: u32) -> u32 {
    ((((word & !SIGNS) + !SIGNS) | word) & SIGNS) >> 7
}
