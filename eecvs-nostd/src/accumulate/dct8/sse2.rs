//! Sums four atoms at a time, with the same bits: `pmaddwd` is `smlad` without the sum. Every x86-64 has it.

use core::arch::x86_64::{
    __m128i, _mm_add_epi32, _mm_cvtsi32_si128, _mm_cvtsi128_si64, _mm_loadu_si128, _mm_madd_epi16,
    _mm_or_si128, _mm_set_epi32, _mm_setzero_si128, _mm_sll_epi32, _mm_slli_epi64, _mm_sra_epi32,
    _mm_srai_epi32, _mm_srl_epi32, _mm_srl_epi64, _mm_srli_epi64, _mm_storeu_si128,
    _mm_unpackhi_epi64, _mm_xor_si128,
};

use super::{ATOMS, GRID, Weighted, Weights};

#[derive(Debug, Clone, Copy)]
pub struct Sums([__m128i; 2]);

impl Sums {
    #[inline(always)]
    pub fn zero() -> Self {
        // SAFETY: this module exists only if the target has SSE2.
        Self([unsafe { _mm_setzero_si128() }; 2])
    }

    #[inline(always)]
    pub fn add(&mut self, event: Weighted) {
        let Weights { even, odd } = event.weights;
        let (odd, even) = (odd.cast_signed(), even.cast_signed());
        // SAFETY: as for `zero`. k = 1 is the lowest.
        let weights = unsafe { _mm_set_epi32(even, odd, even, odd) };
        let (lines, _) = event.lines.as_chunks::<4>();
        for (sum, lines) in self.0.iter_mut().zip(lines) {
            // SAFETY: as for `zero`; four lines are the 16 bytes that are read, at any alignment.
            *sum = unsafe {
                let lines = _mm_loadu_si128(lines.as_ptr().cast());
                _mm_add_epi32(*sum, _mm_madd_epi16(lines, weights))
            };
        }
    }

    /// Returns floor(sum / 2^`shift`) for each sum.
    #[inline(always)]
    pub fn levels(self, shift: u32) -> Self {
        // SAFETY: as for `zero`.
        Self(
            self.0
                .map(|sums| unsafe { _mm_sra_epi32(sums, _mm_cvtsi32_si128(shift.cast_signed())) }),
        )
    }

    /// Returns a mask of the bits that differ from the sign bit in at least one sum.
    #[inline(always)]
    pub fn spread(self) -> u32 {
        // SAFETY: as for `zero`.
        let both = unsafe {
            let [low, high] = self
                .0
                .map(|sums| _mm_xor_si128(sums, _mm_srai_epi32::<31>(sums)));
            let all = _mm_or_si128(low, high);
            _mm_cvtsi128_si64(_mm_or_si128(all, _mm_unpackhi_epi64(all, all))).cast_unsigned()
        };
        both as u32 | (both >> 32) as u32
    }

    /// Returns the low `bits` bits, up to 32, of each number, two side by side per word; the last word has only
    /// one.
    #[inline(always)]
    pub fn pairs(self, bits: u32) -> [u64; GRID / 2] {
        // SAFETY: as for `zero`.
        let [[a, b], [c, d]] = self.0.map(|numbers| unsafe {
            let unused = _mm_cvtsi32_si128(32 - bits.cast_signed());
            let clean = _mm_srl_epi32(_mm_sll_epi32(numbers, unused), unused);
            // Moves the upper number down next to the lower one.
            let upper = _mm_slli_epi64::<32>(_mm_srli_epi64::<32>(clean));
            let pairs = _mm_or_si128(_mm_xor_si128(clean, upper), _mm_srl_epi64(upper, unused));
            let high = _mm_unpackhi_epi64(pairs, pairs);
            [pairs, high].map(|pair| _mm_cvtsi128_si64(pair).cast_unsigned())
        });
        [a, b, c, d]
    }

    #[inline(always)]
    pub fn into_array(self) -> [i32; ATOMS] {
        let mut all = [[0_i32; 4]; GRID / 4];
        for (four, sum) in all.iter_mut().zip(self.0) {
            // SAFETY: the four are the 16 bytes that are written, at any alignment.
            unsafe { _mm_storeu_si128(four.as_mut_ptr().cast(), sum) };
        }
        let [[a, b, c, d], [e, f, g, _]] = all;
        [a, b, c, d, e, f, g]
    }
}
