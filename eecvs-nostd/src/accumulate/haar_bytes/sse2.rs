//! Handles sixteen lanes at a time, with the same bits. Every x86-64 has SSE2.

use core::arch::x86_64::{
    __m128i, _mm_add_epi8, _mm_add_epi32, _mm_and_si128, _mm_andnot_si128, _mm_cmpeq_epi8,
    _mm_cmpgt_epi8, _mm_cvtsi128_si32, _mm_cvtsi128_si64, _mm_loadu_si128, _mm_movemask_epi8,
    _mm_or_si128, _mm_sad_epu8, _mm_set_epi32, _mm_set1_epi8, _mm_set1_epi16, _mm_set1_epi32,
    _mm_set1_epi64x, _mm_setzero_si128, _mm_shuffle_epi32, _mm_shufflelo_epi16, _mm_storeu_si128,
    _mm_sub_epi8, _mm_sub_epi32, _mm_unpackhi_epi64, _mm_unpacklo_epi8, _mm_xor_si128,
};

use super::{Row, SIGNS, thresholds};

/// Like the portable `Lanes`; the upper half is 0 if W is 4.
#[derive(Debug, Clone, Copy)]
pub struct Lanes<const W: usize>([__m128i; 2]);

/// A set of lanes of [`Lanes`], marked by all ones.
#[derive(Debug, Clone, Copy)]
pub struct Flags<const W: usize>(Lanes<W>);

impl<const W: usize> Flags<W> {
    #[inline(always)]
    pub fn count(self) -> u32 {
        let mut count = 0;
        for half in self.0.0.into_iter().take(Lanes::<W>::HALVES) {
            // SAFETY: the target has SSE2. Each lane in the set counts 1; eight lanes are added at a time.
            count += unsafe {
                let ones = _mm_sub_epi8(_mm_setzero_si128(), half);
                let sums = _mm_sad_epu8(ones, _mm_setzero_si128());
                _mm_cvtsi128_si32(_mm_add_epi32(sums, _mm_unpackhi_epi64(sums, sums)))
            };
        }
        count.cast_unsigned()
    }

    #[inline(always)]
    pub fn bits(self) -> u32 {
        let mut bits = 0;
        for (i, half) in self.0.0.into_iter().enumerate().take(Lanes::<W>::HALVES) {
            // SAFETY: the target has SSE2.
            bits |= unsafe { _mm_movemask_epi8(half) }.cast_unsigned() << (16 * i);
        }
        bits
    }
}

impl<const W: usize> Lanes<W> {
    const HALVES: usize = W / 4;

    #[inline(always)]
    pub fn zero() -> Self {
        // SAFETY: the target has SSE2.
        Self([unsafe { _mm_setzero_si128() }; 2])
    }

    #[inline(always)]
    fn map(self, each: impl Fn(usize, __m128i) -> __m128i) -> Self {
        let mut halves = self.0;
        for (i, half) in halves.iter_mut().enumerate().take(Self::HALVES) {
            *half = each(i, *half);
        }
        Self(halves)
    }

    #[inline(always)]
    pub fn add(&mut self, row: &Row, negative: u32) {
        let (rows, _) = row.as_chunks::<4>();
        // SAFETY: the target has SSE2.
        *self = self.map(|i, sum| unsafe {
            let negative = _mm_set1_epi32(negative.cast_signed());
            // Four words are the 16 bytes that are read, at any alignment.
            let row = _mm_loadu_si128(rows[i].as_ptr().cast());
            _mm_add_epi32(sum, _mm_sub_epi32(_mm_xor_si128(row, negative), negative))
        });
    }

    #[inline(always)]
    pub fn bytes(self) -> Self {
        // SAFETY: the target has SSE2.
        self.map(|_, sum| unsafe {
            let signs = _mm_set1_epi32(SIGNS.cast_signed());
            _mm_xor_si128(_mm_add_epi32(sum, signs), signs)
        })
    }

    #[inline(always)]
    pub fn nonzero(self) -> Flags<W> {
        // SAFETY: the target has SSE2.
        Flags(self.map(|_, half| unsafe {
            let zero = _mm_cmpeq_epi8(half, _mm_setzero_si128());
            _mm_xor_si128(zero, _mm_set1_epi8(-1))
        }))
    }

    #[inline(always)]
    pub fn magnitudes(self) -> Self {
        // SAFETY: the target has SSE2.
        self.map(|_, half| unsafe {
            let negative = _mm_cmpgt_epi8(_mm_setzero_si128(), half);
            _mm_sub_epi8(_mm_xor_si128(half, negative), negative)
        })
    }

    #[inline(always)]
    pub fn reach(self, a: u32) -> Flags<W> {
        let [low, second, third, fourth] = thresholds(a).map(u32::cast_signed);
        // SAFETY: the target has SSE2.
        Flags(self.map(|i, half| unsafe {
            let thresholds = if i == 0 {
                _mm_set_epi32(third, third, second, low)
            } else {
                _mm_set1_epi32(fourth)
            };
            // Magnitudes and thresholds are below 128.
            _mm_cmpgt_epi8(half, _mm_sub_epi8(thresholds, _mm_set1_epi8(1)))
        }))
    }

    #[inline(always)]
    pub fn keep(self, kept: u32) -> Self {
        // SAFETY: the target has SSE2.
        self.map(|i, half| unsafe {
            // Copies one byte of `kept` to each half of the lanes; each lane then tests its own bit.
            let kept = _mm_set1_epi16((kept >> (16 * i)) as i16);
            let kept = _mm_shufflelo_epi16::<0b0101_0000>(_mm_unpacklo_epi8(kept, kept));
            let kept = _mm_shuffle_epi32::<0b0101_0000>(kept);
            let own = _mm_set1_epi64x(0x8040_2010_0804_0201_u64.cast_signed());
            _mm_and_si128(half, _mm_cmpeq_epi8(_mm_and_si128(kept, own), own))
        })
    }

    #[inline(always)]
    pub fn levels(self) -> Self {
        // SAFETY: the target has SSE2.
        self.map(|_, half| unsafe { _mm_add_epi8(half, _mm_cmpgt_epi8(half, _mm_setzero_si128())) })
    }

    #[inline(always)]
    pub fn spread(self) -> u32 {
        // SAFETY: the target has SSE2.
        let mut spread = unsafe { _mm_setzero_si128() };
        for (i, half) in self.0.into_iter().enumerate().take(Self::HALVES) {
            // SAFETY: the target has SSE2.
            unsafe {
                let negative = _mm_cmpgt_epi8(_mm_setzero_si128(), half);
                let mut folded = _mm_xor_si128(half, negative);
                if i == 0 {
                    folded = _mm_andnot_si128(_mm_set_epi32(0, 0, 0, 0xff), folded);
                }
                spread = _mm_or_si128(spread, folded);
            }
        }
        // SAFETY: the target has SSE2.
        let spread = unsafe {
            let spread = _mm_or_si128(spread, _mm_unpackhi_epi64(spread, spread));
            _mm_cvtsi128_si64(spread).cast_unsigned()
        };
        let spread = spread as u32 | (spread >> 32) as u32;
        let spread = spread | (spread >> 16);
        (spread | (spread >> 8)) & 0xff
    }

    #[inline(always)]
    pub fn into_bytes(self) -> [[u8; 4]; W] {
        let mut bytes = [[0; 4]; W];
        let (halves, _) = bytes.as_chunks_mut::<4>();
        for (place, half) in halves.iter_mut().zip(self.0) {
            // SAFETY: four words are the 16 bytes that are written, at any alignment.
            unsafe { _mm_storeu_si128(place.as_mut_ptr().cast(), half) };
        }
        bytes
    }
}
