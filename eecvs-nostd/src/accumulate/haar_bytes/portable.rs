//! Handles one word at a time.

use super::compare::{nonzero, reach};
use super::{ONES, Row, SIGNS, THRESHOLD_OF_WORD, WORDS, thresholds};

/// D_k for K = 4 W, with D_k in byte k.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lanes<const W: usize>([u32; W]);

/// A set of lanes of [`Lanes`], marked by a 1.
#[derive(Debug, Clone, Copy)]
pub struct Flags<const W: usize>([u32; W]);

impl<const W: usize> Flags<W> {
    /// Returns the number of lanes in the set.
    #[inline(always)]
    pub fn count(self) -> u32 {
        let all: u32 = self.0.iter().sum();
        all.wrapping_mul(ONES) >> 24
    }

    /// Returns the set as one bit per lane.
    #[inline(always)]
    pub fn bits(self) -> u32 {
        let words = self.0.iter().rev();
        words.fold(0, |bits, word| (bits << 4) | gather(*word))
    }
}

/// Sets all bits of the lanes whose sign bit is set in `signs`, which has no other bits.
#[inline(always)]
const fn spread_signs(signs: u32) -> u32 {
    (signs >> 7) * 0xff
}

/// Gathers four lanes of 0 or 1 into one bit each.
#[inline(always)]
const fn gather(ones: u32) -> u32 {
    ones.wrapping_mul(0x1020_4080) >> 28
}

impl<const W: usize> Lanes<W> {
    #[inline(always)]
    pub const fn zero() -> Self {
        Self([0; W])
    }

    /// Adds the row if `negative` is 0, or subtracts it if `negative` is all ones.
    #[inline(always)]
    pub fn add(&mut self, row: &Row, negative: u32) {
        for (sum, word) in self.0.iter_mut().zip(row) {
            *sum = sum.wrapping_add((word ^ negative).wrapping_sub(negative));
        }
    }

    /// Converts sums of rows to bytes in two's complement.
    #[inline(always)]
    pub fn bytes(self) -> Self {
        Self(self.0.map(|word| word.wrapping_add(SIGNS) ^ SIGNS))
    }

    /// Returns the lanes that are not 0.
    #[inline(always)]
    pub fn nonzero(self) -> Flags<W> {
        Flags(self.0.map(nonzero))
    }

    /// Returns |D_k|.
    #[inline(always)]
    pub fn magnitudes(self) -> Self {
        Self(self.0.map(|word| {
            let signs = word & SIGNS;
            (word ^ spread_signs(signs)) + (signs >> 7)
        }))
    }

    /// Returns the lanes whose magnitudes are at least `a`.
    #[inline(always)]
    pub fn reach(self, a: u32) -> Flags<W> {
        let thresholds = thresholds(a);
        let mut words = self.0;
        for (i, word) in words.iter_mut().enumerate() {
            *word = reach(*word, thresholds[THRESHOLD_OF_WORD[i % WORDS]]);
        }
        Flags(words)
    }

    /// Clears the lanes that are not in `kept`.
    #[inline(always)]
    pub fn keep(self, kept: u32) -> Self {
        let mut words = self.0;
        for (i, word) in words.iter_mut().enumerate() {
            let kept = (kept >> (4 * (i % WORDS))) & 0xf;
            *word &= (kept.wrapping_mul(0x0020_4081) & ONES) * 0xff;
        }
        Self(words)
    }

    /// Returns the levels: positive differences move down by one.
    #[inline(always)]
    pub fn levels(self) -> Self {
        Self(self.0.map(|word| {
            let positive = ((word & !SIGNS) + !SIGNS) & !word & SIGNS;
            word - (positive >> 7)
        }))
    }

    /// Returns a mask of the bits that differ from the sign bit in at least one lane, except that of c_0.
    #[inline(always)]
    pub fn spread(self) -> u32 {
        let mut spread = 0;
        for (i, word) in self.0.into_iter().enumerate() {
            let folded = word ^ spread_signs(word & SIGNS);
            spread |= if i == 0 { folded & !0xff } else { folded };
        }
        spread |= spread >> 16;
        (spread | (spread >> 8)) & 0xff
    }

    /// Converts sums of rows that started at half of a lane's range.
    #[allow(dead_code, reason = "assembly alone asks")]
    #[inline(always)]
    pub fn of_biased(words: [u32; W]) -> Self {
        Self(words.map(|word| word ^ SIGNS))
    }

    /// Creates lanes from words of bytes.
    #[allow(dead_code, reason = "assembly alone asks")]
    #[inline(always)]
    pub const fn new(words: [u32; W]) -> Self {
        Self(words)
    }

    /// Returns the words of bytes.
    #[allow(dead_code, reason = "assembly alone asks")]
    #[inline(always)]
    pub const fn into_words(self) -> [u32; W] {
        self.0
    }

    /// Returns D_k, or its level, in byte k.
    #[inline(always)]
    pub fn into_bytes(self) -> [[u8; 4]; W] {
        self.0.map(u32::to_le_bytes)
    }
}
