//! Sums four or eight numbers at a time, with the same bits: `pmaddwd` is `smlad` without the sum. Every x86-64 has
//! it.

use core::arch::x86_64::{
    __m128i, __m256i, _mm_add_epi32, _mm_loadu_si128, _mm_madd_epi16, _mm_set1_epi32,
    _mm_setzero_si128, _mm_storeu_si128, _mm_sub_epi16, _mm_xor_si128, _mm256_add_epi32,
    _mm256_broadcastsi128_si256, _mm256_loadu_si256, _mm256_madd_epi16, _mm256_setzero_si256,
};

use super::{CHUNK_EVENTS, GRID, Impulse, Phase, Place, Row, Sum};

/// Masks that negate the weights of an even and of an odd k. The index is 2 for ON, plus 1 in the second half of
/// the window.
static SIGNS: [[u32; 4]; 4] = [
    [0; 4],
    [0, 0, u32::MAX, u32::MAX],
    [u32::MAX; 4],
    [u32::MAX, u32::MAX, 0, 0],
];

/// Returns the lines of an event, and the weights of an even and an odd k.
#[inline(always)]
fn weigh(half: Phase, is_on: bool) -> (&'static Row, __m128i) {
    let at = Place::new(half);
    let signs = &SIGNS[((u32::from(is_on) << 1) | (at.late & 1)) as usize];
    // SAFETY: this module exists only if the target has SSE2; four numbers are the 16 bytes that are read, at any
    // alignment.
    let weights = unsafe {
        let signs = _mm_loadu_si128(signs.as_ptr().cast());
        let weights = _mm_set1_epi32(at.weights.cast_signed());
        _mm_sub_epi16(_mm_xor_si128(weights, signs), signs)
    };
    (at.lines(), weights)
}

/// Implements [`super::exponentials`]. Out of line, so that the loop has all registers to itself.
#[inline(never)]
pub fn exponentials(
    impulses: impl Iterator<Item = Impulse>,
    half: impl Fn(Impulse) -> Phase,
    sums: &mut [[Sum; 2]; GRID],
) {
    // SAFETY: this module exists only if the target has SSE2.
    let mut all = [unsafe { _mm_setzero_si128() }; GRID / 2];
    for impulse in impulses {
        let (lines, weights) = weigh(half(impulse), impulse.is_on);
        for (sum, lines) in all.iter_mut().zip(lines.as_chunks::<4>().0) {
            // SAFETY: as above; two pairs are the 16 bytes that are read, at any alignment.
            *sum = unsafe {
                let lines = _mm_loadu_si128(lines.as_ptr().cast());
                _mm_add_epi32(*sum, _mm_madd_epi16(lines, weights))
            };
        }
    }
    let zeroth = sums[0];
    for (sums, all) in sums.as_chunks_mut::<2>().0.iter_mut().zip(all) {
        let mut numbers = [[0_i32; 2]; 2];
        // SAFETY: as above, and written.
        unsafe { _mm_storeu_si128(numbers.as_mut_ptr().cast(), all) };
        *sums = numbers.map(|pair| pair.map(Sum::from_bits));
    }
    sums[0] = zeroth;
}

/// Returns the sums of k = 0..16 as vectors, four pairs of real and imaginary part in each of `V` vectors. The sum
/// of k = 0 is 0.
#[target_feature(enable = "avx2")]
#[inline]
pub fn first_exponentials<const V: usize>(
    impulses: impl Iterator<Item = Impulse>,
    half: impl Fn(Impulse) -> Phase,
) -> [__m256i; V] {
    let mut sums = [_mm256_setzero_si256(); V];
    for impulse in impulses.take(CHUNK_EVENTS) {
        let (lines, weights) = weigh(half(impulse), impulse.is_on);
        let weights = _mm256_broadcastsi128_si256(weights);
        for (sum, lines) in sums.iter_mut().zip(lines.as_chunks::<8>().0) {
            // SAFETY: four pairs are the 32 bytes that are read, at any alignment.
            let lines = unsafe { _mm256_loadu_si256(lines.as_ptr().cast()) };
            *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(lines, weights));
        }
    }
    sums
}
