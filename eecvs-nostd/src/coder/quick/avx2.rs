//! AVX2.
#![allow(unsafe_code)]

use core::arch::x86_64::{
    __m128i, __m256i, _mm_cvtsi32_si128, _mm_cvtsi128_si32, _mm_loadl_epi64, _mm_loadu_si128,
    _mm_max_epu16, _mm_min_epu16, _mm_shuffle_epi32, _mm_storeu_si128, _mm256_add_epi32,
    _mm256_add_epi64, _mm256_and_si256, _mm256_blend_epi32, _mm256_castps_si256,
    _mm256_castsi256_ps, _mm256_castsi256_si128, _mm256_cvtepu8_epi32, _mm256_cvtepu16_epi32,
    _mm256_extracti128_si256, _mm256_loadu_si256, _mm256_madd_epi16, _mm256_max_epu16,
    _mm256_max_epu32, _mm256_min_epu16, _mm256_movemask_epi8, _mm256_mul_epu32, _mm256_mullo_epi32,
    _mm256_or_si256, _mm256_packus_epi32, _mm256_permute4x64_epi64, _mm256_set1_epi32,
    _mm256_set1_epi64x, _mm256_setzero_si256, _mm256_shuffle_ps, _mm256_sll_epi32,
    _mm256_srl_epi32, _mm256_srli_epi64, _mm256_storeu_si256, _mm256_sub_epi32, _mm256_testz_si256,
    _mm256_unpackhi_epi32, _mm256_unpackhi_epi64, _mm256_unpacklo_epi32, _mm256_unpacklo_epi64,
};

use crate::coder::quick::Window;
use crate::coder::quick::format::{Area, BLOCK, Block, LANES, Output, Placed};
use crate::coder::quick::kernel;
use crate::coder::quick::lanes::Lanes;
use crate::coder::quick::portable::Body;
use event_types::Event;

cpufeatures::new!(detected, "avx2", "bmi1", "bmi2", "popcnt");

/// Proof that the core has AVX2, BMI1, BMI2 and POPCNT.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Avx2(());

impl Avx2 {
    /// Returns the proof if the core has them.
    #[inline]
    pub fn detected() -> Option<Self> {
        detected::get().then_some(Self(()))
    }

    /// As [`kernel::encode`].
    #[inline]
    pub fn encode(
        self,
        events: &[Placed],
        block: &mut Block,
        area: &mut Area,
        window: &Window,
        out: &mut Output,
    ) -> Option<usize> {
        #[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
        fn inner(
            l: Avx2,
            events: &[Placed],
            block: &mut Block,
            area: &mut Area,
            window: &Window,
            out: &mut Output,
        ) -> Option<usize> {
            kernel::encode(l, events, block, area, window, out)
        }
        // SAFETY: `self` proves that the core has these features.
        unsafe { inner(self, events, block, area, window, out) }
    }

    /// As [`kernel::decode`].
    #[inline]
    pub fn decode(
        self,
        body: &Body<'_>,
        window: &Window,
        first: u32,
        count: usize,
        events: &mut [Event; BLOCK],
    ) -> Option<()> {
        #[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
        fn inner(
            l: Avx2,
            body: &Body<'_>,
            window: &Window,
            first: u32,
            count: usize,
            events: &mut [Event; BLOCK],
        ) -> Option<()> {
            kernel::decode(l, body, window, first, count, events)
        }
        // SAFETY: `self` proves that the core has these features.
        unsafe { inner(self, body, window, first, count, events) }
    }
}

/// Two vectors' even lanes of 32 bits, by halves of 128.
#[inline]
#[target_feature(enable = "avx2")]
fn even(a: __m256i, b: __m256i) -> __m256i {
    _mm256_castps_si256(_mm256_shuffle_ps::<0x88>(
        _mm256_castsi256_ps(a),
        _mm256_castsi256_ps(b),
    ))
}

/// Two vectors' odd lanes of 32 bits, by halves of 128.
#[inline]
#[target_feature(enable = "avx2")]
fn odd(a: __m256i, b: __m256i) -> __m256i {
    _mm256_castps_si256(_mm256_shuffle_ps::<0xDD>(
        _mm256_castsi256_ps(a),
        _mm256_castsi256_ps(b),
    ))
}

/// Splits two vectors of four pairs into their first and second words.
#[inline]
#[target_feature(enable = "avx2")]
fn split(a: __m256i, b: __m256i) -> (__m256i, __m256i) {
    // The halves of both come in turn: the middle quarters change places.
    (
        _mm256_permute4x64_epi64::<0b11_01_10_00>(even(a, b)),
        _mm256_permute4x64_epi64::<0b11_01_10_00>(odd(a, b)),
    )
}

#[inline]
#[target_feature(enable = "avx2")]
fn store_events(
    events: &mut [Event; LANES],
    start_us: u64,
    t: __m256i,
    place: __m256i,
    polarity: __m256i,
) {
    let zero = _mm256_setzero_si256();
    let start = _mm256_set1_epi64x(start_us as i64);
    let t0 = _mm256_add_epi64(_mm256_unpacklo_epi32(t, zero), start);
    let t1 = _mm256_add_epi64(_mm256_unpackhi_epi32(t, zero), start);
    let r0 = _mm256_unpacklo_epi32(place, polarity);
    let r1 = _mm256_unpackhi_epi32(place, polarity);
    // Events 0 and 4, 1 and 5, 2 and 6, 3 and 7.
    let (e0, e1) = (_mm256_unpacklo_epi64(t0, r0), _mm256_unpackhi_epi64(t0, r0));
    let (e2, e3) = (_mm256_unpacklo_epi64(t1, r1), _mm256_unpackhi_epi64(t1, r1));
    let to: *mut __m128i = events.as_mut_ptr().cast();
    // SAFETY: the reference makes eight events writable. Each gets a time, x and y of any bits, a polarity of 0 or 1
    // (the caller masks it), and zeros as padding; the layout is asserted beside `Event`.
    unsafe {
        for (i, pair) in [e0, e1, e2, e3].into_iter().enumerate() {
            _mm_storeu_si128(to.add(i), _mm256_castsi256_si128(pair));
            _mm_storeu_si128(to.add(i + 4), _mm256_extracti128_si256::<1>(pair));
        }
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn mul_high(a: __m256i, b: __m256i) -> __m256i {
    let even = _mm256_srli_epi64::<32>(_mm256_mul_epu32(a, b));
    let odd = _mm256_mul_epu32(_mm256_srli_epi64::<32>(a), _mm256_srli_epi64::<32>(b));
    _mm256_blend_epi32::<0b1010_1010>(even, odd)
}

/// Folds the halves of the eight lanes.
#[inline]
#[target_feature(enable = "avx2")]
fn fold(v: __m256i, f: impl Fn(__m128i, __m128i) -> __m128i) -> u32 {
    let v = f(_mm256_castsi256_si128(v), _mm256_extracti128_si256::<1>(v));
    let v = f(v, _mm_shuffle_epi32::<0b01_00_11_10>(v));
    let v = f(v, _mm_shuffle_epi32::<0b10_11_00_01>(v));
    _mm_cvtsi128_si32(v) as u32
}

/// Operations on two vectors, each by a function of its own.
macro_rules! each {
    ($($name:ident: $function:ident,)*) => {$(
        #[inline(always)]
        fn $name(self, a: __m256i, b: __m256i) -> __m256i {
            unsafe { $function(a, b) }
        }
    )*};
}

// SAFETY, of all blocks without their own: `self` proves that the core has AVX2; pointers come from references to
// arrays of as many bytes as are read or written.
#[allow(clippy::undocumented_unsafe_blocks)]
impl Lanes for Avx2 {
    type Vector = __m256i;

    each! {
        add: _mm256_add_epi32,
        sub: _mm256_sub_epi32,
        mul: _mm256_mullo_epi32,
        mul_high: mul_high,
        dot: _mm256_madd_epi16,
        and: _mm256_and_si256,
        or: _mm256_or_si256,
        max: _mm256_max_epu32,
        min_halves: _mm256_min_epu16,
        max_halves: _mm256_max_epu16,
    }

    #[inline(always)]
    fn splat(self, value: u32) -> __m256i {
        unsafe { _mm256_set1_epi32(value as i32) }
    }
    #[inline(always)]
    fn load(self, from: &[u32; LANES]) -> __m256i {
        unsafe { _mm256_loadu_si256(from.as_ptr().cast()) }
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; LANES], v: __m256i) {
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), v) }
    }
    #[inline(always)]
    fn load_bytes(self, from: &[u8; 4 * LANES]) -> __m256i {
        unsafe { _mm256_loadu_si256(from.as_ptr().cast()) }
    }
    #[inline(always)]
    fn store_bytes(self, to: &mut [u8; 4 * LANES], v: __m256i) {
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), v) }
    }
    #[inline(always)]
    fn load_single_bytes(self, from: &[u8; LANES]) -> __m256i {
        unsafe { _mm256_cvtepu8_epi32(_mm_loadl_epi64(from.as_ptr().cast())) }
    }
    #[inline(always)]
    fn load_half_bytes(self, from: &[u8; 2 * LANES]) -> __m256i {
        unsafe { _mm256_cvtepu16_epi32(_mm_loadu_si128(from.as_ptr().cast())) }
    }
    #[inline(always)]
    fn store_half_bytes(self, to: &mut [u8; 2 * LANES], v: __m256i) {
        unsafe {
            let halves = _mm256_permute4x64_epi64::<0b1000>(_mm256_packus_epi32(v, v));
            _mm_storeu_si128(to.as_mut_ptr().cast(), _mm256_castsi256_si128(halves));
        }
    }
    #[inline(always)]
    fn shl(self, a: __m256i, count: u32) -> __m256i {
        unsafe { _mm256_sll_epi32(a, _mm_cvtsi32_si128(count as i32)) }
    }
    #[inline(always)]
    fn shr(self, a: __m256i, count: u32) -> __m256i {
        unsafe { _mm256_srl_epi32(a, _mm_cvtsi32_si128(count as i32)) }
    }
    #[inline(always)]
    fn high_bits(self, bytes: &[u8; 4 * LANES]) -> u32 {
        unsafe { _mm256_movemask_epi8(_mm256_loadu_si256(bytes.as_ptr().cast())) as u32 }
    }
    #[inline(always)]
    fn load_pairs(self, from: &[[u32; 2]; LANES]) -> (__m256i, __m256i) {
        let from: *const __m256i = from.as_ptr().cast();
        // SAFETY: the array has 64 bytes, as many as two vectors.
        unsafe { split(_mm256_loadu_si256(from), _mm256_loadu_si256(from.add(1))) }
    }
    #[inline(always)]
    fn store_events(
        self,
        events: &mut [Event; LANES],
        start_us: u64,
        t: __m256i,
        place: __m256i,
        polarity: __m256i,
    ) {
        // SAFETY: and a polarity beyond 1 would be no `Polarity`: masked.
        unsafe {
            let polarity = _mm256_and_si256(polarity, _mm256_set1_epi32(1));
            store_events(events, start_us, t, place, polarity);
        }
    }
    #[inline(always)]
    fn least_halves(self, v: __m256i) -> u32 {
        unsafe { fold(v, |a, b| _mm_min_epu16(a, b)) }
    }
    #[inline(always)]
    fn most_halves(self, v: __m256i) -> u32 {
        unsafe { fold(v, |a, b| _mm_max_epu16(a, b)) }
    }
    #[inline(always)]
    fn is_zero(self, v: __m256i) -> bool {
        unsafe { _mm256_testz_si256(v, v) == 1 }
    }
}
