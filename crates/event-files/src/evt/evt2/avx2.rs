//! Eight words at a time, by AVX2.

use core::arch::x86_64::{
    __m128i, __m256i, _mm_loadl_epi64, _mm256_add_epi64, _mm256_and_si256, _mm256_blendv_epi8,
    _mm256_castsi256_ps, _mm256_cmpeq_epi32, _mm256_cmpgt_epi32, _mm256_cvtepi8_epi32,
    _mm256_loadu_si256, _mm256_movemask_ps, _mm256_or_si256, _mm256_permute2x128_si256,
    _mm256_permutevar8x32_epi32, _mm256_set1_epi32, _mm256_set1_epi64x, _mm256_setzero_si256,
    _mm256_slli_epi32, _mm256_slli_epi64, _mm256_srli_epi32, _mm256_storeu_si256, _mm256_sub_epi32,
    _mm256_unpackhi_epi32, _mm256_unpackhi_epi64, _mm256_unpacklo_epi32, _mm256_unpacklo_epi64,
};

use event_types::{Event, Sensor};

use super::{Decoded, HIGH_MASK, TIME_HIGH, TIME_HIGH_BITS, TIME_LOW_BITS};
use crate::evt::lanes::{KEPT, LATEST};

/// Words at a time.
const LANES: usize = 8;

/// Proof that the core has AVX2, and counts bits.
#[derive(Debug, Clone, Copy)]
pub struct Avx2(());

impl Avx2 {
    /// Returns the proof if the core has them.
    pub fn detected() -> Option<Self> {
        let has_both = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt");
        has_both.then_some(Self(()))
    }

    /// Decodes words from the front, whole eights of them, up to eight of which one is neither an event on the sensor nor
    /// a time less than half a period after `high`, the upper bits of time before the words. `zero_us` is the time whose
    /// upper bits are 0.
    pub fn decode(
        self,
        words: &[[u8; 4]],
        zero_us: u64,
        high: u32,
        sensor: Sensor,
        events: &mut [Event],
    ) -> Decoded {
        // SAFETY: `self` proves that the core has what the function needs.
        unsafe { decode(words, zero_us, high, sensor, events) }
    }
}

#[target_feature(enable = "avx2,popcnt")]
fn decode(
    words: &[[u8; 4]],
    zero_us: u64,
    high: u32,
    sensor: Sensor,
    events: &mut [Event],
) -> Decoded {
    let all = |value: u32| _mm256_set1_epi32(value as i32);
    let zero = _mm256_set1_epi64x(zero_us as i64);
    let (width, height) = (all(sensor.width.into()), all(sensor.height.into()));
    let (start, mut high) = (all(high), all(high));
    let side = all(0x7ff);
    let (mut taken, mut count) = (0, 0);
    let (blocks, _) = words.as_chunks::<LANES>();
    for block in blocks {
        let mut word = load(block);
        let (x, y) = (_mm256_srli_epi32::<11>(word), word);
        let is_on_sensor = _mm256_and_si256(
            _mm256_cmpgt_epi32(width, _mm256_and_si256(x, side)),
            _mm256_cmpgt_epi32(height, _mm256_and_si256(y, side)),
        );
        let none = _mm256_setzero_si256();
        let is_event = _mm256_cmpeq_epi32(_mm256_and_si256(word, all(0xE000_0000)), none);
        let is_time = _mm256_cmpeq_epi32(_mm256_srli_epi32::<28>(word), all(TIME_HIGH));
        let upper = _mm256_and_si256(word, all(HIGH_MASK));
        // A step back underflows to more than 2^28.
        let step = _mm256_and_si256(
            _mm256_sub_epi32(upper, start),
            all(u32::MAX << (TIME_HIGH_BITS - 1)),
        );
        let is_plain = _mm256_or_si256(
            _mm256_and_si256(is_event, is_on_sensor),
            _mm256_and_si256(is_time, _mm256_cmpeq_epi32(step, none)),
        );
        let times = mask(is_time);
        let slots = events
            .get_mut(count..)
            .and_then(<[Event]>::first_chunk_mut::<LANES>);
        let Some(slots) = slots.filter(|_| mask(is_plain) == 0xFF) else {
            break;
        };
        let mut highs = high;
        if times > 0 {
            let latest = table(&LATEST, times);
            let stated = _mm256_permutevar8x32_epi32(upper, latest);
            // The sign bit of each lane says whether none was stated.
            let is_none = _mm256_cmpgt_epi32(none, latest);
            highs = _mm256_blendv_epi8(stated, high, is_none);
            high = _mm256_permutevar8x32_epi32(highs, all(LANES as u32 - 1));
            let kept = table(&KEPT, !times & 0xFF);
            word = _mm256_permutevar8x32_epi32(word, kept);
            highs = _mm256_permutevar8x32_epi32(highs, kept);
        }
        store(slots, word, highs, zero);
        taken += LANES;
        count += LANES - times.count_ones() as usize;
    }
    Decoded {
        words: taken,
        events: count,
        high: first(high),
    }
}

/// Writes the events of eight words with these upper time bits. What it writes for a word that is none has a time, x and
/// y, and a polarity of 0 or 1, too.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn store(slots: &mut [Event; LANES], word: __m256i, highs: __m256i, zero_us: __m256i) {
    let all = |value: u32| _mm256_set1_epi32(value as i32);
    let none = _mm256_setzero_si256();
    let low = _mm256_and_si256(_mm256_srli_epi32::<22>(word), all(0x3f));
    let x = _mm256_and_si256(_mm256_srli_epi32::<11>(word), all(0x7ff));
    let y = _mm256_and_si256(_mm256_slli_epi32::<16>(word), all(0x7ff_0000));
    let place = _mm256_or_si256(x, y);
    let polarity = _mm256_and_si256(_mm256_srli_epi32::<28>(word), all(1));
    let time = |high: __m256i, low: __m256i| {
        let high_us = _mm256_slli_epi64::<{ TIME_LOW_BITS as i32 }>(high);
        _mm256_add_epi64(zero_us, _mm256_or_si256(high_us, low))
    };
    // Events 0 and 1 with 4 and 5, 2 and 3 with 6 and 7.
    let front_us = time(
        _mm256_unpacklo_epi32(highs, none),
        _mm256_unpacklo_epi32(low, none),
    );
    let back_us = time(
        _mm256_unpackhi_epi32(highs, none),
        _mm256_unpackhi_epi32(low, none),
    );
    let front = _mm256_unpacklo_epi32(place, polarity);
    let back = _mm256_unpackhi_epi32(place, polarity);
    // Events 0 and 4, 1 and 5, 2 and 6, 3 and 7.
    let even = _mm256_unpacklo_epi64(front_us, front);
    let odd = _mm256_unpackhi_epi64(front_us, front);
    let even_back = _mm256_unpacklo_epi64(back_us, back);
    let odd_back = _mm256_unpackhi_epi64(back_us, back);
    let to: *mut __m256i = slots.as_mut_ptr().cast();
    // SAFETY: the reference makes eight events writable. Each gets a time, x and y of any bits, a polarity of 0 or 1, and
    // zeros as padding; the layout is asserted beside `Event`.
    unsafe {
        _mm256_storeu_si256(to, _mm256_permute2x128_si256::<0x20>(even, odd));
        _mm256_storeu_si256(
            to.add(1),
            _mm256_permute2x128_si256::<0x20>(even_back, odd_back),
        );
        _mm256_storeu_si256(to.add(2), _mm256_permute2x128_si256::<0x31>(even, odd));
        _mm256_storeu_si256(
            to.add(3),
            _mm256_permute2x128_si256::<0x31>(even_back, odd_back),
        );
    }
}

/// Returns which lanes have their highest bit set.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn mask(lanes: __m256i) -> u32 {
    _mm256_movemask_ps(_mm256_castsi256_ps(lanes)) as u32
}

/// Returns the first lane.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn first(lanes: __m256i) -> u32 {
    core::arch::x86_64::_mm256_cvtsi256_si32(lanes) as u32
}

/// Returns the lanes of a table for a mask below 256.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn table(table: &[[u8; LANES]; 256], mask: u32) -> __m256i {
    let lanes = &table[mask as usize & 0xFF];
    // SAFETY: the reference makes eight bytes readable.
    let lanes: __m128i = unsafe { _mm_loadl_epi64(lanes.as_ptr().cast()) };
    _mm256_cvtepi8_epi32(lanes)
}

#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn load(block: &[[u8; 4]; LANES]) -> __m256i {
    // SAFETY: the reference makes 32 bytes readable.
    unsafe { _mm256_loadu_si256(block.as_ptr().cast()) }
}
