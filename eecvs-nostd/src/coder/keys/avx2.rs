//! The kernels with AVX2, and everything else compiled for the same cores.
#![allow(unsafe_code)]

use core::arch::x86_64::{
    __m256i, _mm_cvtsi32_si128, _mm_cvtsi128_si32, _mm_or_si128, _mm_storel_epi64,
    _mm256_add_epi16, _mm256_add_epi64, _mm256_and_si256, _mm256_andnot_si256, _mm256_blend_epi32,
    _mm256_blendv_epi8, _mm256_castpd_si256, _mm256_castsi256_pd, _mm256_castsi256_si128,
    _mm256_cmpgt_epi64, _mm256_cvtepu8_epi64, _mm256_cvtepu32_epi64, _mm256_cvttpd_epi32,
    _mm256_extract_epi16, _mm256_extract_epi64, _mm256_extracti128_si256, _mm256_i64gather_epi64,
    _mm256_loadu_si256, _mm256_movemask_pd, _mm256_mul_epu32, _mm256_mul_pd, _mm256_or_si256,
    _mm256_permute2x128_si256, _mm256_permute4x64_epi64, _mm256_set1_epi16, _mm256_set1_epi64x,
    _mm256_set1_pd, _mm256_setr_epi8, _mm256_setzero_si256, _mm256_shuffle_epi8,
    _mm256_shuffle_epi32, _mm256_slli_epi64, _mm256_slli_si256, _mm256_sllv_epi64,
    _mm256_srl_epi64, _mm256_srli_epi64, _mm256_srlv_epi64, _mm256_storeu_si256, _mm256_sub_epi16,
    _mm256_sub_epi64, _mm256_sub_pd, _mm256_subs_epu16, _mm256_testz_si256, _mm256_unpackhi_epi64,
    _mm256_unpacklo_epi64,
};

use crate::coder::keys::decoder::{DecoderMemory, decode_with};
use crate::coder::keys::encoder::{EncoderMemory, Stop, encode_with};
use crate::coder::keys::kernels::{AHEAD, Clock, Kernels, Pairs, Span, Symbols, Words, moves};
use crate::coder::keys::portable::{self, Portable, width};
use crate::coder::keys::{Placed, SLICE_EVENTS, Window};
use event_types::Event;

cpufeatures::new!(detected, "avx2", "bmi1", "bmi2");

/// Proof that the core has AVX2, BMI1 and BMI2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Avx2(());

impl Avx2 {
    /// Returns the proof if the core has them.
    #[inline]
    pub fn detected() -> Option<Self> {
        detected::get().then_some(Self(()))
    }

    /// As [`encode_with`].
    pub fn encode(
        self,
        window: &Window,
        events: &[Placed],
        memory: &mut EncoderMemory,
        out: &mut [u8],
    ) -> Result<usize, Stop> {
        #[target_feature(enable = "avx2,bmi1,bmi2")]
        fn inner(
            kernels: Avx2,
            window: &Window,
            events: &[Placed],
            memory: &mut EncoderMemory,
            out: &mut [u8],
        ) -> Result<usize, Stop> {
            encode_with(kernels, window, events, memory, out)
        }
        // SAFETY: `self` exists, so the core has these features.
        unsafe { inner(self, window, events, memory, out) }
    }

    /// As [`decode_with`].
    pub fn decode(
        self,
        window: &Window,
        payload: &[u8],
        memory: &mut DecoderMemory,
        events: &mut [Event],
    ) -> Option<()> {
        #[target_feature(enable = "avx2,bmi1,bmi2")]
        fn inner(
            kernels: Avx2,
            window: &Window,
            payload: &[u8],
            memory: &mut DecoderMemory,
            events: &mut [Event],
        ) -> Option<()> {
            decode_with(kernels, window, payload, memory, events)
        }
        // SAFETY: `self` exists, so the core has these features.
        unsafe { inner(self, window, payload, memory, events) }
    }
}

/// Keys below this are exact as doubles.
const EXACT: u64 = 1 << 52;
/// The bits of 2^52 as a double: with an integer below 2^52 in the mantissa, the double 2^52 plus that integer.
const TWO_52: i64 = 0x4330_0000_0000_0000;

impl Kernels for Avx2 {
    #[inline(always)]
    fn sums(self, counts: &mut [u16]) {
        let (vectors, rest) = counts.as_chunks_mut::<16>();
        // SAFETY: `self` exists, so the core has AVX2; each vector is 16 counts of its own.
        let sum = unsafe {
            let last = _mm256_set1_epi16(0x0F0E);
            let mut carry = _mm256_setzero_si256();
            for vector in vectors {
                let at = vector.as_mut_ptr().cast::<__m256i>();
                let counts = _mm256_loadu_si256(at);
                let mut sums = _mm256_add_epi16(counts, _mm256_slli_si256::<2>(counts));
                sums = _mm256_add_epi16(sums, _mm256_slli_si256::<4>(sums));
                sums = _mm256_add_epi16(sums, _mm256_slli_si256::<8>(sums));
                // The low half's sum goes to the high half, and both halves' to the next vector.
                let low = _mm256_shuffle_epi8(_mm256_permute2x128_si256::<0x08>(sums, sums), last);
                sums = _mm256_add_epi16(sums, low);
                let all = _mm256_shuffle_epi8(_mm256_permute4x64_epi64::<0xFF>(sums), last);
                let before = _mm256_sub_epi16(_mm256_add_epi16(sums, carry), counts);
                _mm256_storeu_si256(at, before);
                carry = _mm256_add_epi16(carry, all);
            }
            _mm256_extract_epi16::<0>(carry) as u16
        };
        Portable.sums(rest);
        for count in rest {
            *count = count.wrapping_add(sum);
        }
    }

    #[inline(always)]
    fn classes(
        self,
        words: &mut Words,
        count: usize,
        span: Span,
        symbols: &mut Symbols,
        pairs: &mut Pairs,
    ) -> bool {
        if span.keys > EXACT {
            return Portable.classes(words, count, span, symbols, pairs);
        }
        let count = count.min(SLICE_EVENTS);
        let (eights, rest) = words[..count].as_chunks_mut::<8>();
        let (eights_out, rest_out) = symbols[AHEAD..AHEAD + count].as_chunks_mut::<8>();
        let pair_rest = 4 * eights.len();
        let fours = pairs
            .bits
            .as_chunks_mut::<4>()
            .0
            .iter_mut()
            .zip(pairs.counts.as_chunks_mut::<4>().0);
        // SAFETY: `self` exists, so the core has AVX2; loads and stores are of chunks of 8.
        let (before, wrong) = unsafe {
            let units = _mm256_set1_epi64x(i64::from(span.units));
            let last = _mm256_set1_epi64x(i64::from(span.units - 1));
            let low = _mm256_set1_epi64x(0xFFFF_FFFF);
            let sign = _mm256_set1_epi64x(i64::MIN);
            let two_52 = _mm256_set1_epi64x(TWO_52);
            let exponent = _mm256_set1_epi64x(1022);
            let order = _mm256_setr_epi8(
                0, 8, -1, -1, 4, 12, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, //
                -1, -1, 0, 8, -1, -1, 4, 12, -1, -1, -1, -1, -1, -1, -1, -1,
            );
            let pair_order = _mm256_setr_epi8(
                0, -1, 8, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, //
                -1, 0, -1, 8, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1,
            );
            let ones = _mm256_set1_epi64x(-1);
            let one_bit = _mm256_set1_epi64x(1);
            let mut before = _mm256_setzero_si256();
            let mut wrong = _mm256_setzero_si256();
            for ((eight, out), (pair, pair_counts)) in eights.iter_mut().zip(eights_out).zip(fours)
            {
                let at = eight.as_mut_ptr().cast::<__m256i>();
                let mut halves = [before; 2];
                let mut mantissas = [before; 2];
                let mut widths = [before; 2];
                for (half, symbol) in halves.iter_mut().enumerate() {
                    let at = at.add(half);
                    let word = _mm256_loadu_si256(at);
                    let time = _mm256_and_si256(word, low);
                    let key = _mm256_add_epi64(
                        _mm256_mul_epu32(_mm256_srli_epi64::<33>(word), units),
                        time,
                    );
                    let on = _mm256_and_si256(_mm256_slli_epi64::<31>(word), sign);
                    let key = _mm256_or_si256(key, on);
                    let turned = _mm256_permute4x64_epi64::<0b10_01_00_11>(key);
                    let difference =
                        _mm256_sub_epi64(key, _mm256_blend_epi32::<0b11>(turned, before));
                    before = turned;
                    wrong = _mm256_or_si256(wrong, _mm256_add_epi64(difference, difference));
                    wrong = _mm256_or_si256(wrong, _mm256_sub_epi64(last, time));
                    _mm256_storeu_si256(at, difference);
                    let plain = _mm256_andnot_si256(sign, difference);
                    let double = _mm256_sub_pd(
                        _mm256_castsi256_pd(_mm256_or_si256(plain, two_52)),
                        _mm256_castsi256_pd(two_52),
                    );
                    let class = _mm256_subs_epu16(
                        _mm256_srli_epi64::<52>(_mm256_castpd_si256(double)),
                        exponent,
                    );
                    let width = _mm256_subs_epu16(class, one_bit);
                    widths[half] = width;
                    mantissas[half] = _mm256_andnot_si256(_mm256_sllv_epi64(ones, width), plain);
                    *symbol = _mm256_add_epi64(
                        _mm256_add_epi64(class, class),
                        _mm256_srli_epi64::<63>(difference),
                    );
                }
                let [one, two] = halves;
                // Pairs 0, 2, 1, 3 of the eight, in order again in the end.
                let low = _mm256_unpacklo_epi64(mantissas[0], mantissas[1]);
                let high = _mm256_unpackhi_epi64(mantissas[0], mantissas[1]);
                let low_width = _mm256_unpacklo_epi64(widths[0], widths[1]);
                let high_width = _mm256_unpackhi_epi64(widths[0], widths[1]);
                let bits = _mm256_or_si256(low, _mm256_sllv_epi64(high, low_width));
                let counts =
                    _mm256_shuffle_epi8(_mm256_add_epi64(low_width, high_width), pair_order);
                let counts = _mm_or_si128(
                    _mm256_castsi256_si128(counts),
                    _mm256_extracti128_si256::<1>(counts),
                );
                _mm256_storeu_si256(
                    pair.as_mut_ptr().cast(),
                    _mm256_permute4x64_epi64::<0b11_01_10_00>(bits),
                );
                *pair_counts = _mm_cvtsi128_si32(counts).to_le_bytes();
                let both =
                    _mm256_shuffle_epi8(_mm256_or_si256(one, _mm256_slli_epi64::<32>(two)), order);
                let packed = _mm_or_si128(
                    _mm256_castsi256_si128(both),
                    _mm256_extracti128_si256::<1>(both),
                );
                _mm_storel_epi64(out.as_mut_ptr().cast(), packed);
            }
            (
                _mm256_extract_epi64::<0>(before) as u64,
                _mm256_movemask_pd(_mm256_castsi256_pd(wrong)),
            )
        };
        let is_fine = Portable::classes_from(rest, rest_out, span, before) && wrong == 0;
        Portable::pairs_from(
            rest,
            rest_out,
            (&mut pairs.bits[pair_rest..], &mut pairs.counts[pair_rest..]),
        );
        is_fine
    }

    #[inline(always)]
    fn words(
        self,
        symbols: &Symbols,
        count: usize,
        mantissas: &[u8],
        span: Span,
        words: &mut Words,
    ) -> bool {
        if span.keys > EXACT {
            return Portable.words(symbols, count, mantissas, span, words);
        }
        let count = count.min(SLICE_EVENTS);
        let symbols = &symbols[AHEAD..AHEAD + count];
        let (fours, rest) = symbols.as_chunks::<4>();
        let (fours_out, rest_out) = words[..count].as_chunks_mut::<4>();
        // The loop reads a word at the end of each mantissa but the last at most.
        let bits: usize = fours
            .as_flattened()
            .iter()
            .map(|&symbol| width(symbol) as usize)
            .sum();
        assert!(bits / 8 + 8 <= mantissas.len());
        let inverse = 1.0 / f64::from(span.units) * (1.0 - 1.0 / (1_u64 << 50) as f64);
        // SAFETY: `self` exists, so the core has AVX2; a gathered word begins at most `bits / 8` bytes into the
        // mantissas, as `at` goes up to the sum of widths, and the assertion leaves 8 bytes there. All else is of
        // chunks of 4.
        let (at, key, wrong) = unsafe {
            let zero = _mm256_setzero_si256();
            let ones = _mm256_set1_epi64x(-1);
            let one = _mm256_set1_epi64x(1);
            let class_mask = _mm256_set1_epi64x(63);
            let seven = _mm256_set1_epi64x(7);
            let sign = _mm256_set1_epi64x(i64::MIN);
            let two_52 = _mm256_set1_epi64x(TWO_52);
            let units = _mm256_set1_epi64x(i64::from(span.units));
            let last_unit = _mm256_set1_epi64x(i64::from(span.units) - 1);
            let last_key = _mm256_set1_epi64x(span.keys as i64 - 1);
            let inverse = _mm256_set1_pd(inverse);
            let mut at = zero;
            let mut key = zero;
            let mut wrong = zero;
            // Sums of the lanes up to each.
            let up_to = |x: __m256i| {
                let pairs = _mm256_add_epi64(x, _mm256_slli_si256::<8>(x));
                let low = _mm256_blend_epi32::<0b1111>(
                    _mm256_permute4x64_epi64::<0b01_01_00_00>(pairs),
                    zero,
                );
                _mm256_add_epi64(pairs, low)
            };
            for (four, out) in fours.iter().zip(fours_out) {
                let symbol = _mm256_cvtepu8_epi64(_mm_cvtsi32_si128(i32::from_le_bytes(*four)));
                let class = _mm256_and_si256(_mm256_srli_epi64::<1>(symbol), class_mask);
                let width = _mm256_subs_epu16(class, one);
                let widths = up_to(width);
                let from = _mm256_add_epi64(at, _mm256_sub_epi64(widths, width));
                at = _mm256_add_epi64(at, _mm256_permute4x64_epi64::<0xFF>(widths));
                let bits = _mm256_i64gather_epi64::<1>(
                    mantissas.as_ptr().cast(),
                    _mm256_srli_epi64::<3>(from),
                );
                let bits = _mm256_srlv_epi64(bits, _mm256_and_si256(from, seven));
                let mantissa = _mm256_andnot_si256(_mm256_sllv_epi64(ones, width), bits);
                let base = _mm256_srli_epi64::<1>(_mm256_sllv_epi64(one, class));
                let flip = _mm256_slli_epi64::<63>(symbol);
                let difference = _mm256_add_epi64(_mm256_add_epi64(base, mantissa), flip);
                let keys = _mm256_add_epi64(up_to(difference), key);
                key = _mm256_permute4x64_epi64::<0xFF>(keys);
                let plain = _mm256_andnot_si256(sign, keys);
                wrong = _mm256_or_si256(wrong, _mm256_sub_epi64(last_key, plain));
                let double = _mm256_sub_pd(
                    _mm256_castsi256_pd(_mm256_or_si256(plain, two_52)),
                    _mm256_castsi256_pd(two_52),
                );
                // At most one too small.
                let place =
                    _mm256_cvtepu32_epi64(_mm256_cvttpd_epi32(_mm256_mul_pd(double, inverse)));
                let time = _mm256_sub_epi64(plain, _mm256_mul_epu32(place, units));
                let over = _mm256_cmpgt_epi64(time, last_unit);
                let place = _mm256_sub_epi64(place, over);
                let time = _mm256_sub_epi64(time, _mm256_and_si256(over, units));
                let on = _mm256_srli_epi64::<63>(keys);
                let position = _mm256_or_si256(_mm256_add_epi64(place, place), on);
                let word = _mm256_or_si256(_mm256_slli_epi64::<32>(time), position);
                _mm256_storeu_si256(out.as_mut_ptr().cast(), word);
            }
            let wrong = _mm256_movemask_pd(_mm256_castsi256_pd(wrong));
            (
                _mm256_extract_epi64::<0>(at) as usize,
                _mm256_extract_epi64::<0>(key) as u64,
                wrong,
            )
        };
        wrong == 0 && Portable::words_from(rest, rest_out, mantissas, span, (at, key))
    }

    #[inline(always)]
    fn insert(self, words: &mut [u64]) -> bool {
        let mut left = moves(words.len());
        // Neighbours that are out of order change places, even ones first, without a branch on each. Words of one
        // time and place stay as they are.
        for start in [0, 1] {
            let (fours, _) = words
                .get_mut(start..)
                .unwrap_or(&mut [])
                .as_chunks_mut::<4>();
            for four in fours {
                let at = four.as_mut_ptr().cast::<__m256i>();
                // SAFETY: `self` exists, so the core has AVX2; `at` is a chunk of 4.
                unsafe {
                    let word = _mm256_loadu_si256(at);
                    let other = _mm256_shuffle_epi32::<0b01_00_11_10>(word);
                    let above = _mm256_cmpgt_epi64(
                        _mm256_srli_epi64::<1>(word),
                        _mm256_srli_epi64::<1>(other),
                    );
                    let both = _mm256_unpacklo_epi64(above, above);
                    _mm256_storeu_si256(at, _mm256_blendv_epi8(word, other, both));
                }
            }
        }
        let mut i = 0;
        while i + 4 < words.len() {
            // SAFETY: `self` exists, so the core has AVX2; words `i` to `i + 4` exist.
            let is_in_order = unsafe {
                let at = words.as_ptr().add(i).cast::<__m256i>();
                let (one, next) = (
                    _mm256_loadu_si256(at),
                    _mm256_loadu_si256(at.cast::<u64>().add(1).cast()),
                );
                // Where times are equal, places ascend already, or the words are of one place and time.
                _mm256_testz_si256(_mm256_cmpgt_epi64(one, next), _mm256_cmpgt_epi64(one, next))
                    == 1
            };
            if !is_in_order && !(i + 1..i + 5).all(|k| portable::insert_one(words, k, &mut left)) {
                return false;
            }
            i += 4;
        }
        (i + 1..words.len()).all(|k| portable::insert_one(words, k, &mut left))
    }

    #[inline(always)]
    fn events(self, words: &Words, width: u16, clock: Clock, events: &mut [Event]) {
        let count = events.len().min(SLICE_EVENTS);
        let (fours_out, rest_out) = events[..count].as_chunks_mut::<4>();
        let (fours, rest) = words[..count].as_chunks::<4>();
        // y = place * inverse >> shift, for places below 2^22.
        let shift = 22 + u16::BITS - (width - 1).leading_zeros();
        let inverse = (1_u64 << shift).div_ceil(u64::from(width));
        // SAFETY: `self` exists, so the core has AVX2; loads and stores are of chunks of 4, and all fields of
        // an event get values of theirs: `Event` is `repr(C)`, 8 bytes of time, 2 of x, 2 of y, 1 of polarity, which
        // is 0 or 1, and 3 bytes of padding.
        unsafe {
            let place_mask = _mm256_set1_epi64x(0x7FFF_FFFF);
            let one = _mm256_set1_epi64x(1);
            let inverse = _mm256_set1_epi64x(inverse as i64);
            let shift = _mm_cvtsi32_si128(shift as i32);
            // x + 2^16 y = place + (2^16 - width) y.
            let step = _mm256_set1_epi64x((1 << 16) - i64::from(width));
            let first = _mm256_set1_epi64x(i64::from(clock.first));
            let unit_us = _mm256_set1_epi64x(i64::from(clock.unit_us));
            let half = _mm256_set1_epi64x(i64::from(clock.unit_us / 2));
            let last = _mm256_set1_epi64x(i64::from(clock.last_us));
            let t0 = _mm256_set1_epi64x(clock.start_us as i64);
            let start =
                _mm256_set1_epi64x((clock.start_us.wrapping_add(u64::from(clock.first))) as i64);
            for (four, out) in fours.iter().zip(fours_out) {
                let word = _mm256_loadu_si256(four.as_ptr().cast());
                let place = _mm256_and_si256(_mm256_srli_epi64::<1>(word), place_mask);
                let y = _mm256_srl_epi64(_mm256_mul_epu32(place, inverse), shift);
                let position = _mm256_add_epi64(place, _mm256_mul_epu32(y, step));
                let on = _mm256_slli_epi64::<32>(_mm256_and_si256(word, one));
                let position = _mm256_or_si256(position, on);
                let unit = _mm256_srli_epi64::<32>(word);
                let time = if clock.unit_us == 1 {
                    _mm256_add_epi64(unit, start)
                } else {
                    let offset = _mm256_mul_epu32(_mm256_add_epi64(unit, first), unit_us);
                    let offset = _mm256_add_epi64(offset, half);
                    let late = _mm256_cmpgt_epi64(offset, last);
                    _mm256_add_epi64(_mm256_blendv_epi8(offset, last, late), t0)
                };
                let (even, odd) = (
                    _mm256_unpacklo_epi64(time, position),
                    _mm256_unpackhi_epi64(time, position),
                );
                let at = out.as_mut_ptr().cast::<__m256i>();
                _mm256_storeu_si256(at, _mm256_permute2x128_si256::<0x20>(even, odd));
                _mm256_storeu_si256(at.add(1), _mm256_permute2x128_si256::<0x31>(even, odd));
            }
        }
        for (event, word) in rest_out.iter_mut().zip(rest) {
            *event = portable::event(*word, width, clock);
        }
    }
}
