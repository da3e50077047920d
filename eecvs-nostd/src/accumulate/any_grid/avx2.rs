//! Sums eight numbers at a time, with the same bits: `pmaddwd` is `smlad` without the sum. Lines are loaded one by
//! one, which takes half as long as the processor's gather instruction.

use core::arch::x86_64::{
    __m256i, _mm256_add_epi32, _mm256_blend_epi16, _mm256_madd_epi16, _mm256_mullo_epi32,
    _mm256_set1_epi32, _mm256_setr_epi32, _mm256_setr_epi64x, _mm256_setzero_si256,
    _mm256_srli_epi32, _mm256_storeu_si256,
};

use super::{
    CHUNK_EVENTS, DISTANCE_AT, Impulse, LINES, Line, ONE, Phase, QUARTER, ROW_AT, ROWS, Sum, Turn,
};

cpufeatures::new!(detected, "avx2");

/// Returns whether this processor has AVX2; looked up once.
#[inline(always)]
pub fn is_there() -> bool {
    detected::get()
}

/// Number of coefficients per pass over the events.
const BLOCK: usize = 16;

/// The lines of the imaginary part above those of the real part, so that one load fetches both.
static PAIRS: [u64; ROWS] = pairs();

const fn pairs() -> [u64; ROWS] {
    let mut pairs = [0; ROWS];
    let mut row = 0;
    while row < ROWS {
        pairs[row] = ((LINES[row + QUARTER] as u64) << 32) | LINES[row] as u64;
        row += 1;
    }
    pairs
}

#[inline(always)]
fn row(phase: u32) -> usize {
    (phase >> ROW_AT) as usize
}

/// Implements [`super::cosines`].
pub fn cosines(turns: &(impl Iterator<Item = Turn> + Clone), sums: &mut [Sum]) {
    let line = |phase| {
        let line: Line = LINES[row(phase)];
        line.cast_signed()
    };
    // SAFETY: called only if `is_there`.
    unsafe {
        add::<{ BLOCK / 8 }, 8>(turns, sums, [0, 1, 2, 3, 4, 5, 6, 7], |phases| {
            let [a, b, c, d, e, f, g, h] = phases.map(line);
            _mm256_setr_epi32(a, b, c, d, e, f, g, h)
        });
    }
}

/// Implements [`super::exponentials`].
pub fn exponentials(turns: &(impl Iterator<Item = Turn> + Clone), sums: &mut [[Sum; 2]]) {
    let sums = sums.as_flattened_mut();
    // SAFETY: as for `cosines`.
    unsafe {
        add::<{ BLOCK / 4 }, 4>(turns, sums, [0, 0, 1, 1, 2, 2, 3, 3], |phases| {
            let [a, b, c, d] = phases.map(|phase| PAIRS[row(phase)].cast_signed());
            _mm256_setr_epi64x(a, b, c, d)
        });
    }
}

/// Returns sum p exp(-i k a) for k in 0..4 V like [`super::exponentials`], with four pairs of real and imaginary
/// part in each vector. The pair of k = 0 is arbitrary.
#[target_feature(enable = "avx2")]
#[inline]
pub fn first_exponentials<const V: usize>(
    impulses: impl Iterator<Item = Impulse>,
    step: impl Fn(Impulse) -> Phase,
) -> [__m256i; V] {
    let mut sums = [_mm256_setzero_si256(); V];
    let ramp = _mm256_setr_epi32(0, 0, 1, 1, 2, 2, 3, 3);
    for impulse in impulses.take(CHUNK_EVENTS) {
        let turn = Turn::new(step(impulse), impulse.is_on);
        add_pairs(turn, ramp, &mut sums);
    }
    sums
}

/// Adds the pairs of one event.
#[target_feature(enable = "avx2")]
#[inline]
fn add_pairs<const V: usize>(Turn { start, step }: Turn, ramp: __m256i, sums: &mut [__m256i; V]) {
    let one = _mm256_set1_epi32(ONE << 16);
    let mut at = start;
    let mut phase = _mm256_add_epi32(
        _mm256_set1_epi32(start.cast_signed()),
        _mm256_mullo_epi32(_mm256_set1_epi32(step.cast_signed()), ramp),
    );
    let further = _mm256_set1_epi32(step.wrapping_mul(4).cast_signed());
    for sum in sums {
        let distances = _mm256_srli_epi32::<{ DISTANCE_AT as i32 }>(phase);
        let weights = _mm256_blend_epi16::<0b1010_1010>(distances, one);
        let [a, b, c, d] = core::array::from_fn(|_| {
            let pair = PAIRS[row(at)];
            at = at.wrapping_add(step);
            pair.cast_signed()
        });
        let lines = _mm256_setr_epi64x(a, b, c, d);
        *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(lines, weights));
        phase = _mm256_add_epi32(phase, further);
    }
}

/// Writes the sums, `V` vectors at a time. A vector holds `K` coefficients; its number i belongs to coefficient
/// `ramp[i]`.
#[target_feature(enable = "avx2")]
fn add<const V: usize, const K: usize>(
    turns: &(impl Iterator<Item = Turn> + Clone),
    sums: &mut [Sum],
    ramp: [i32; 8],
    lines: impl Fn([u32; K]) -> __m256i,
) {
    let zeroth: [Option<Sum>; 2] = [0, 1].map(|i| sums.get(i).copied());
    let [a, b, c, d, e, f, g, h] = ramp;
    let ramp = _mm256_setr_epi32(a, b, c, d, e, f, g, h);
    let one = _mm256_set1_epi32(ONE << 16);
    for (block, sums) in sums.chunks_mut(8 * V).enumerate() {
        let first = (block * BLOCK) as u32;
        let mut all = [_mm256_setzero_si256(); V];
        for Turn { start, step } in turns.clone() {
            let mut at = start.wrapping_add(step.wrapping_mul(first));
            let mut phase = _mm256_add_epi32(
                _mm256_set1_epi32(at.cast_signed()),
                _mm256_mullo_epi32(_mm256_set1_epi32(step.cast_signed()), ramp),
            );
            let further = step.wrapping_mul(K as u32).cast_signed();
            let further = _mm256_set1_epi32(further);
            for sum in &mut all {
                let distances = _mm256_srli_epi32::<{ DISTANCE_AT as i32 }>(phase);
                let weights = _mm256_blend_epi16::<0b1010_1010>(distances, one);
                let lines = lines(core::array::from_fn(|_| {
                    let phase = at;
                    at = at.wrapping_add(step);
                    phase
                }));
                *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(lines, weights));
                phase = _mm256_add_epi32(phase, further);
            }
        }
        let mut numbers = [[0_i32; 8]; V];
        for (numbers, sum) in numbers.iter_mut().zip(all) {
            // SAFETY: eight numbers are the 32 bytes that are written, at any alignment.
            unsafe { _mm256_storeu_si256(numbers.as_mut_ptr().cast(), sum) };
        }
        for (sum, number) in sums.iter_mut().zip(numbers.as_flattened()) {
            *sum = Sum::from_bits(*number);
        }
    }
    // The sum of k = 0 must be left as it was.
    for (sum, zeroth) in sums.iter_mut().zip(zeroth).take(8 / K) {
        *sum = zeroth.unwrap_or_default();
    }
}
