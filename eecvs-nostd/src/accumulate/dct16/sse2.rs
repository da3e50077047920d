//! Sums four atoms at a time, with the same bits: `pmaddwd` is `smlad` without the sum. Every x86-64 has it.

use core::arch::x86_64::{
    __m128i, _mm_add_epi32, _mm_loadu_si128, _mm_madd_epi16, _mm_set1_epi32, _mm_setzero_si128,
    _mm_storeu_si128, _mm_unpackhi_epi32, _mm_unpacklo_epi32,
};

use super::{ATOMS, GRID, Row, Weights};

#[derive(Debug, Clone, Copy)]
pub struct Sums([__m128i; GRID / 4]);

impl Sums {
    #[inline(always)]
    pub fn zero() -> Self {
        // SAFETY: this module exists only if the target has SSE2.
        Self([unsafe { _mm_setzero_si128() }; GRID / 4])
    }

    #[inline(always)]
    pub fn add(&mut self, row: &Row, weights: Weights) {
        // SAFETY: as for `zero`.
        let [odd, even] = [weights.odd, weights.even]
            .map(|weights| unsafe { _mm_set1_epi32(weights.cast_signed()) });
        let (lines, _) = row.as_chunks::<4>();
        let all = self.0.iter_mut().zip(lines).zip([odd, odd, even, even]);
        for ((sum, lines), weights) in all {
            // SAFETY: as for `zero`; four lines are the 16 bytes that are read, at any alignment.
            *sum = unsafe {
                let lines = _mm_loadu_si128(lines.as_ptr().cast());
                _mm_add_epi32(*sum, _mm_madd_epi16(lines, weights))
            };
        }
    }

    /// Returns the sums, k ascending.
    #[inline(always)]
    pub fn into_array(self) -> [i32; ATOMS] {
        let [odd, odd_more, even, even_more] = self.0;
        let mut all = [0_i32; GRID];
        // SAFETY: as for `zero`.
        let fours = unsafe {
            [
                _mm_unpacklo_epi32(odd, even),
                _mm_unpackhi_epi32(odd, even),
                _mm_unpacklo_epi32(odd_more, even_more),
                _mm_unpackhi_epi32(odd_more, even_more),
            ]
        };
        for (to, four) in all.as_chunks_mut::<4>().0.iter_mut().zip(fours) {
            // SAFETY: four numbers are the 16 bytes that are written, at any alignment.
            unsafe { _mm_storeu_si128(to.as_mut_ptr().cast(), four) };
        }
        let [all @ .., _] = all;
        all
    }
}
