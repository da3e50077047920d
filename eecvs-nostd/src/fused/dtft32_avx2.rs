//! Encodes a DTFT pixel of several events on up to 32 frequencies on a processor with AVX2: the stages of
//! [`crate::fused`] with all sums in registers, and without steps that depend on how the magnitudes are
//! distributed.
//!
//! The stages in Rust serve other processors and other grids. All give the same bits.
#![allow(unsafe_code)]

use core::arch::x86_64::{
    __m128i, __m256i, _mm_cvtsi32_si128, _mm_cvtsi128_si64, _mm_movemask_epi8, _mm_or_si128,
    _mm_packs_epi16, _mm_setr_epi8, _mm_shuffle_epi8, _mm_unpackhi_epi64, _mm256_add_epi16,
    _mm256_add_epi64, _mm256_alignr_epi8, _mm256_and_si256, _mm256_blend_epi16, _mm256_blend_epi32,
    _mm256_castsi256_si128, _mm256_cmpeq_epi64, _mm256_cmpgt_epi16, _mm256_extracti128_si256,
    _mm256_mul_epi32, _mm256_or_si256, _mm256_permute2x128_si256, _mm256_set1_epi16,
    _mm256_set1_epi64x, _mm256_setr_epi64x, _mm256_setzero_si256, _mm256_sll_epi32,
    _mm256_slli_epi64, _mm256_sra_epi32, _mm256_srai_epi32, _mm256_srl_epi32, _mm256_srl_epi64,
    _mm256_srli_epi64, _mm256_storeu_si256, _mm256_xor_si256,
};

use crate::accumulate::{any_grid, dtft16};
use crate::encoder::config::Scratch;
use crate::fixed_point::{FRACTION_BITS, Phase};
use crate::fused::{Shared, Way};
use crate::group::Impulse;
use crate::group::{Impulses, Pixel};
use crate::pack::bits_lsb_first::BitWriter;
use crate::pack::packer::Packer;
use crate::prune;
use crate::stage::{Stage, Trace};
use crate::transform::phase::PhaseScale;
use crate::transform::shape::{Packing, Shape, width_of};
use crate::transform::{Dtft, Transform};
use crate::window::Slot;

cpufeatures::new!(detected, "avx2", "bmi1", "bmi2", "popcnt");

/// Largest K that this module handles.
const GRID_MAX: usize = 32;
/// Number of frequencies whose keys fit a vector.
const KEYS: usize = 16;

/// Returns whether [`Waves`] handles this frame on this processor.
pub fn is_for(packing: &Packing) -> bool {
    let Shape { grid, r, .. } = packing.shape();
    packing.transform == Transform::Dtft
        && packing.quantiser.step_log2() <= 0
        && grid <= GRID_MAX
        && (1..grid).contains(&r)
        && detected::get()
}

/// Largest number of words that a pixel takes: counts and gap, 3 * 31 bits and 3; the set, a bit and 32; the
/// levels' width, up to 32; two levels of up to 32 bits for each k; and one word for bits that were pending.
pub const WORDS_MAX: usize = 4 + 2 + 1 + 2 * GRID_MAX + 1;

/// The parameters that the pixels of a frame share.
#[derive(Debug, Clone, Copy)]
pub struct Waves {
    scale: PhaseScale,
    grid: u32,
    r: u32,
    /// Shift from sums to levels.
    shift: u32,
}

/// DTFT coefficients in registers: [`crate::fused::is_waves`].
pub struct InRegisters;

impl Way for InRegisters {
    type Basis = Dtft;
    type Memory<'p> = Waves;

    #[inline(always)]
    fn words_max(_: Shape) -> usize {
        WORDS_MAX
    }

    #[inline(always)]
    fn memory(shared: &Shared, _: &mut Scratch<'_>) -> Option<Waves> {
        Some(Waves::new(shared.shape, shared.scale))
    }

    #[inline(always)]
    fn encode<T: Trace>(
        shared: &mut Shared,
        waves: &mut Waves,
        pixel: Pixel,
        slots: &[Slot],
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        // SAFETY: this way is taken only for frames for which [`is_for`] holds.
        unsafe { waves.encode(pixel, slots, &mut shared.packer, writer, trace) }
    }
}

impl Waves {
    /// Creates an instance for a frame for which [`is_for`] holds.
    pub fn new(shape: Shape, scale: PhaseScale) -> Self {
        Self {
            scale,
            grid: shape.grid as u32,
            r: shape.r as u32,
            shift: shape.quantiser.shift(),
        }
    }

    /// Encodes a pixel of 2 events up to a chunk. The output must have room for it.
    ///
    /// # Safety
    /// [`is_for`] must hold for the frame.
    #[inline(always)]
    pub unsafe fn encode<T: Trace>(
        &self,
        pixel: Pixel,
        slots: &[Slot],
        packer: &mut Packer,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        // SAFETY: by the caller's guarantee, the processor has the features that were detected.
        unsafe {
            if self.grid as usize == dtft16::GRID {
                self.encode_of::<4, 1, true, T>(pixel, slots, packer, writer, trace);
            } else if self.grid as usize <= KEYS {
                self.encode_of::<4, 1, false, T>(pixel, slots, packer, writer, trace);
            } else {
                self.encode_of::<8, 2, false, T>(pixel, slots, packer, writer, trace);
            }
        }
    }

    /// Encodes with sums in `V` vectors and keys in `N`, and with atoms of [`dtft16`] if `ROWS`, otherwise of
    /// [`any_grid`].
    #[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
    fn encode_of<const V: usize, const N: usize, const ROWS: bool, T: Trace>(
        &self,
        pixel: Pixel,
        slots: &[Slot],
        packer: &mut Packer,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        trace.enter(Stage::Accumulate);
        let events = pixel.on + pixel.off;
        let scale = self.scale;
        let half = |impulse: Impulse| scale.half(impulse.offset_us);
        let turn = |impulse| Phase::from_bits(half(impulse).to_bits() << 1);
        let impulses = Impulses::new(pixel, slots);
        let mut sums = if ROWS {
            dtft16::sse2::first_exponentials::<V>(impulses, half)
        } else {
            any_grid::avx2::first_exponentials::<V>(impulses, turn)
        };
        let zeroth = (pixel.on as i32 - pixel.off as i32) << FRACTION_BITS;
        let zeroth = _mm256_setr_epi64x(i64::from(zeroth.cast_unsigned()), 0, 0, 0);
        sums[0] = _mm256_blend_epi32::<0b11>(sums[0], zeroth);
        trace.enter(Stage::Prune);
        let kept = self.largest::<V, N>(&sums, events);
        trace.enter(Stage::Quantise);
        let shift = _mm_cvtsi32_si128(self.shift.cast_signed());
        let levels = sums.map(|sum| _mm256_sra_epi32(sum, shift));
        let bits = width_of(spread(&levels, kept & !1)) + 1;
        let mut pairs = [[0_u64; 4]; V];
        for (pairs, levels) in pairs.iter_mut().zip(levels) {
            let levels = side_by_side(levels, bits);
            // SAFETY: four pairs are the 32 bytes that are written, at any alignment.
            unsafe { _mm256_storeu_si256(pairs.as_mut_ptr().cast(), levels) };
        }
        trace.enter(Stage::Pack);
        let position = (pixel.x, pixel.y);
        let counts = (pixel.on, pixel.off);
        packer.pairs(position, counts, (kept, pairs.as_flattened(), bits), writer);
    }

    /// Returns the set of the r largest |c_k| of `events` events, at most a chunk, one bit per k, ties to the lower
    /// k.
    #[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
    fn largest<const V: usize, const N: usize>(&self, sums: &[__m256i; V], events: u32) -> u32 {
        // As in `Coefficient::relative`.
        let width = events.leading_zeros().wrapping_sub(26) & 31;
        let width = _mm_cvtsi32_si128(width.cast_signed());
        let mut keys = sums.map(|sum| squares(_mm256_sll_epi32(sum, width)));
        let all = u32::MAX >> (32_u32.wrapping_sub(self.grid) & 31);
        if (self.grid as usize) < KEYS * N {
            for (v, keys) in keys.iter_mut().enumerate() {
                *keys = _mm256_and_si256(*keys, lanes(all, v));
            }
        }
        let mut upper = [_mm256_setzero_si256(); N];
        for (upper, keys) in upper.iter_mut().zip(keys.as_chunks::<4>().0) {
            *upper = upper_halves(keys);
        }
        let kept = above(&upper, self.r) & all;
        if kept.count_ones() == self.r {
            return kept;
        }
        self.largest_apart(&keys)
    }

    /// Does the same if the upper halves of the keys do not decide.
    #[cold]
    #[inline(never)]
    #[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
    fn largest_apart<const V: usize>(&self, keys: &[__m256i; V]) -> u32 {
        let mut numbers = [[0_u64; 4]; V];
        for (numbers, keys) in numbers.iter_mut().zip(keys) {
            // SAFETY: four numbers are the 32 bytes that are written, at any alignment.
            unsafe { _mm256_storeu_si256(numbers.as_mut_ptr().cast(), *keys) };
        }
        let mut all = [0; GRID_MAX];
        for (key, number) in all.iter_mut().zip(numbers.as_flattened()) {
            *key = *number as u32;
        }
        let keys = all.get(..self.grid as usize).unwrap_or_default();
        prune::largest_bits(keys, self.r)
    }
}

/// Returns re^2 + im^2 of four pairs, each square as computed by `mul_high`, below 2^31.
#[target_feature(enable = "avx2")]
fn squares(pairs: __m256i) -> __m256i {
    let im = _mm256_srli_epi64::<32>(pairs);
    let re = _mm256_srli_epi64::<32>(_mm256_mul_epi32(pairs, pairs));
    _mm256_add_epi64(re, _mm256_srli_epi64::<32>(_mm256_mul_epi32(im, im)))
}

/// Returns the upper 16 of 32 bits of the keys of 16 frequencies; lane 4i + v belongs to k = 4v + i.
#[target_feature(enable = "avx2")]
fn upper_halves([a, b, c, d]: &[__m256i; 4]) -> __m256i {
    let a = _mm256_srli_epi64::<16>(*a);
    let ab = _mm256_blend_epi16::<0b0010_0010>(a, *b);
    let c = _mm256_slli_epi64::<16>(*c);
    let cd = _mm256_blend_epi16::<0b1000_1000>(c, _mm256_slli_epi64::<32>(*d));
    _mm256_blend_epi16::<0b1100_1100>(ab, cd)
}

/// Calls `$each` with every rotation of a vector's 16 lanes except the one by 0.
macro_rules! rotations {
    ($keys:expr, $each:expr) => {{
        let keys = $keys;
        let turned = _mm256_permute2x128_si256::<1>(keys, keys);
        $each(_mm256_alignr_epi8::<2>(turned, keys));
        $each(_mm256_alignr_epi8::<4>(turned, keys));
        $each(_mm256_alignr_epi8::<6>(turned, keys));
        $each(_mm256_alignr_epi8::<8>(turned, keys));
        $each(_mm256_alignr_epi8::<10>(turned, keys));
        $each(_mm256_alignr_epi8::<12>(turned, keys));
        $each(_mm256_alignr_epi8::<14>(turned, keys));
        $each(turned);
        $each(_mm256_alignr_epi8::<2>(keys, turned));
        $each(_mm256_alignr_epi8::<4>(keys, turned));
        $each(_mm256_alignr_epi8::<6>(keys, turned));
        $each(_mm256_alignr_epi8::<8>(keys, turned));
        $each(_mm256_alignr_epi8::<10>(keys, turned));
        $each(_mm256_alignr_epi8::<12>(keys, turned));
        $each(_mm256_alignr_epi8::<14>(keys, turned));
    }};
}

/// Returns the set of keys with fewer than `r` keys above them, one bit per k. It contains all of the r largest,
/// and only these if it has r elements. Keys are 0 beyond the grid.
#[target_feature(enable = "avx2")]
fn above<const N: usize>(keys: &[__m256i; N], r: u32) -> u32 {
    let mut ranks = [_mm256_setzero_si256(); N];
    for others in keys {
        let mut each = |others: __m256i| {
            for (rank, keys) in ranks.iter_mut().zip(keys) {
                *rank = _mm256_add_epi16(*rank, _mm256_cmpgt_epi16(others, *keys));
            }
        };
        rotations!(*others, each);
        if N > 1 {
            each(*others);
        }
    }
    // Each comparison that holds has subtracted 1.
    let least = _mm256_set1_epi16(-(r as i16));
    let mut bits = 0;
    for (i, rank) in ranks.into_iter().enumerate() {
        bits |= in_order(_mm256_cmpgt_epi16(rank, least)) << (16 * i);
    }
    bits
}

/// Returns a bit for each k from lanes in the order of [`upper_halves`].
#[target_feature(enable = "avx2")]
fn in_order(lanes: __m256i) -> u32 {
    let (low, high) = halves(lanes);
    let both = _mm_packs_epi16(low, high);
    let order = _mm_setr_epi8(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
    _mm_movemask_epi8(_mm_shuffle_epi8(both, order)).cast_unsigned()
}

/// Returns a mask of all bits in those pairs of vector `v` whose k are in `set`.
#[target_feature(enable = "avx2")]
fn lanes(set: u32, v: usize) -> __m256i {
    let own = _mm256_setr_epi64x(1 << (4 * v), 2 << (4 * v), 4 << (4 * v), 8 << (4 * v));
    let set = _mm256_set1_epi64x(i64::from(set));
    _mm256_cmpeq_epi64(_mm256_and_si256(set, own), own)
}

#[target_feature(enable = "avx2")]
fn halves(all: __m256i) -> (__m128i, __m128i) {
    (
        _mm256_castsi256_si128(all),
        _mm256_extracti128_si256::<1>(all),
    )
}

/// Puts the low `bits` bits, up to 32, of both levels of each pair side by side.
#[target_feature(enable = "avx2")]
fn side_by_side(levels: __m256i, bits: u32) -> __m256i {
    let unused = _mm_cvtsi32_si128(32 - bits.cast_signed());
    let clean = _mm256_srl_epi32(_mm256_sll_epi32(levels, unused), unused);
    // Moves the upper level down next to the lower one.
    let upper = _mm256_blend_epi32::<0b0101_0101>(clean, _mm256_setzero_si256());
    let lower = _mm256_xor_si256(clean, upper);
    _mm256_or_si256(lower, _mm256_srl_epi64(upper, unused))
}

/// Returns a mask of the bits that differ from the sign bit in at least one level of the pairs in `kept`.
#[target_feature(enable = "avx2")]
fn spread<const V: usize>(levels: &[__m256i; V], kept: u32) -> u32 {
    let mut all = _mm256_setzero_si256();
    for (v, levels) in levels.iter().enumerate() {
        let folded = _mm256_xor_si256(*levels, _mm256_srai_epi32::<31>(*levels));
        all = _mm256_or_si256(all, _mm256_and_si256(folded, lanes(kept, v)));
    }
    let (low, high) = halves(all);
    let all = _mm_or_si128(low, high);
    let all = _mm_cvtsi128_si64(_mm_or_si128(all, _mm_unpackhi_epi64(all, all))).cast_unsigned();
    all as u32 | (all >> 32) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixed_point::CHUNK_EVENTS;
    use proptest::prelude::*;

    /// Calls `above` with keys that have these upper halves, in the order of the link.
    fn found<const V: usize, const N: usize>(halves: &[u16], r: u32) -> u32 {
        let mut keys = [[0_u64; 4]; V];
        for (key, half) in keys.as_flattened_mut().iter_mut().zip(halves) {
            *key = (u64::from(*half) << 16) | 0xbeef;
        }
        // SAFETY: the caller has checked for the instructions.
        unsafe {
            let keys = keys.map(|[a, b, c, d]| {
                let [a, b, c, d] = [a, b, c, d].map(u64::cast_signed);
                _mm256_setr_epi64x(a, b, c, d)
            });
            let mut upper = [_mm256_setzero_si256(); N];
            for (upper, keys) in upper.iter_mut().zip(keys.as_chunks::<4>().0) {
                *upper = upper_halves(keys);
            }
            above(&upper, r)
        }
    }

    proptest! {
        #[test]
        fn fewer_than_r_are_above_each_that_is_kept(
            halves in prop_oneof![
                proptest::collection::vec(0..0x8000_u16, 32),
                proptest::collection::vec(0..9_u16, 32),
            ],
            r in 1..32_u32,
        ) {
            if !detected::get() {
                return Ok(());
            }
            let expected = |halves: &[u16]| {
                let is_kept = |half: &u16| {
                    (halves.iter().filter(|other| *other > half).count() as u32) < r
                };
                let all = halves.iter().enumerate();
                all.fold(0, |bits, (k, half)| bits | (u32::from(is_kept(half)) << k))
            };
            prop_assert_eq!(found::<8, 2>(&halves, r), expected(&halves));
            prop_assert_eq!(found::<4, 1>(&halves[..16], r), expected(&halves[..16]));
        }

        /// Including ties, compared with the portable search.
        #[test]
        fn the_largest_are_those_of_the_portable_search(
            numbers in proptest::collection::vec(any::<(i32, i32)>(), 32),
            shift in 0..31_u32, events in 2..=CHUNK_EVENTS as u32, grid in 2..=32_u32, r in 1..32_u32,
        ) {
            if !detected::get() {
                return Ok(());
            }
            let r = 1 + r % (grid - 1);
            let most = events << FRACTION_BITS;
            // Fewer values tie more often.
            let number = |x: i32| (x.unsigned_abs() % most) as i32 >> shift << shift;
            let pairs: [[i32; 2]; 32] =
                core::array::from_fn(|k| [number(numbers[k].0), -number(numbers[k].1)]);
            let width = u32::BITS - events.leading_zeros();
            let keys: [u32; 32] = pairs.map(|pair| {
                let squares = pair.map(|x| {
                    let x = x << (6 - width);
                    crate::fixed_point::mul_high(x, x) as u32
                });
                squares[0] + squares[1]
            });
            let expected = prune::largest_bits(&keys[..grid as usize], r);
            let waves = Waves { scale: PhaseScale::new(1), grid, r, shift: 0 };
            let pair = |k: usize| {
                let [re, im] = pairs[k].map(|x| u64::from(x.cast_unsigned()));
                ((im << 32) | re).cast_signed()
            };
            // SAFETY: the processor has the instructions, as checked above.
            unsafe {
                let vector = |v: usize| {
                    _mm256_setr_epi64x(pair(4 * v), pair(4 * v + 1), pair(4 * v + 2), pair(4 * v + 3))
                };
                let sums: [__m256i; 8] = core::array::from_fn(vector);
                prop_assert_eq!(waves.largest::<8, 2>(&sums, events), expected);
                if grid <= 16 {
                    let sums: [__m256i; 4] = core::array::from_fn(vector);
                    prop_assert_eq!(waves.largest::<4, 1>(&sums, events), expected);
                }
            }
        }
    }
}
