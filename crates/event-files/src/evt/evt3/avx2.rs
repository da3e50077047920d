//! Eight words at a time, by AVX2.

use core::arch::x86_64::{
    __m128i, __m256i, _mm_and_si128, _mm_blendv_epi8, _mm_cmpeq_epi16, _mm_cmpgt_epi16,
    _mm_cvtsi128_si32, _mm_loadu_si128, _mm_movemask_epi8, _mm_or_si128, _mm_packs_epi16,
    _mm_set1_epi16, _mm_shuffle_epi8, _mm_srli_epi16, _mm_srli_si128, _mm_unpackhi_epi16,
    _mm_unpacklo_epi16, _mm256_add_epi64, _mm256_cvtepu16_epi64, _mm256_cvtepu32_epi64,
    _mm256_or_si256, _mm256_permute2x128_si256, _mm256_set1_epi64x, _mm256_slli_epi64,
    _mm256_storeu_si256, _mm256_unpackhi_epi64, _mm256_unpacklo_epi64,
};

use event_types::{Event, Sensor};

use super::{ADDR_X, ADDR_Y, CONTINUED, Decoded, OTHER, Plain, TIME_HIGH, TIME_LOW, TRIGGER};
use crate::evt::lanes::{KEPT, LATEST, of_two_bytes};

/// Words at a time.
const LANES: usize = 8;

static LATEST_WORDS: [[u8; 16]; 256] = of_two_bytes(&LATEST);
static KEPT_WORDS: [[u8; 16]; 256] = of_two_bytes(&KEPT);

/// Proof that the core has AVX2, and counts bits.
#[derive(Debug, Clone, Copy)]
pub struct Avx2(());

impl Avx2 {
    /// Returns the proof if the core has them.
    pub fn detected() -> Option<Self> {
        let has_both = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt");
        has_both.then_some(Self(()))
    }

    /// Decodes words from the front, whole eights of them, up to eight of which one is not plain.
    pub fn decode(self, words: &[[u8; 2]], plain: &mut Plain, events: &mut [Event]) -> Decoded {
        // SAFETY: `self` proves that the core has what the function needs.
        unsafe { decode(words, plain, events) }
    }
}

#[target_feature(enable = "avx2,popcnt")]
fn decode(words: &[[u8; 2]], plain: &mut Plain, events: &mut [Event]) -> Decoded {
    let all = |value: u16| _mm_set1_epi16(value as i16);
    let Sensor { width, height } = plain.sensor;
    // Columns and rows have 11 bits.
    let (width, height) = (all(width.min(1 << 11)), all(height.min(1 << 11)));
    let high = all(TIME_HIGH << 12 | plain.high);
    let high_us = _mm256_set1_epi64x(plain.high_us as i64);
    let (mut row, mut low) = (all(plain.y), all(plain.low));
    let mut decoded = Decoded {
        words: 0,
        events: 0,
        has_others: false,
    };
    let (blocks, _) = words.as_chunks::<LANES>();
    for block in blocks {
        let word = load(block);
        let kind = _mm_srli_epi16::<12>(word);
        let coordinate = _mm_and_si128(word, all(0x7ff));
        let is_x = _mm_and_si128(
            _mm_cmpeq_epi16(kind, all(ADDR_X)),
            _mm_cmpgt_epi16(width, coordinate),
        );
        let is_y = _mm_and_si128(
            _mm_cmpeq_epi16(kind, all(ADDR_Y)),
            _mm_cmpgt_epi16(height, coordinate),
        );
        let is_low = _mm_cmpeq_epi16(kind, all(TIME_LOW));
        let is_known = _mm_or_si128(
            _mm_or_si128(is_x, is_y),
            _mm_or_si128(is_low, _mm_cmpeq_epi16(word, high)),
        );
        let (columns, known) = masks(is_x, is_known);
        if known != 0xFF {
            let is_other = _mm_or_si128(
                _mm_or_si128(
                    _mm_cmpeq_epi16(kind, all(TRIGGER)),
                    _mm_cmpeq_epi16(kind, all(OTHER)),
                ),
                _mm_cmpeq_epi16(_mm_and_si128(kind, all(CONTINUED)), all(CONTINUED)),
            );
            let (_, plain) = masks(is_x, _mm_or_si128(is_known, is_other));
            if plain != 0xFF {
                break;
            }
            decoded.has_others = true;
        }
        let slots = events
            .get_mut(decoded.events..)
            .and_then(<[Event]>::first_chunk_mut::<LANES>);
        let Some(slots) = slots else {
            break;
        };
        let (rows, lows) = masks(is_y, is_low);
        let value = _mm_and_si128(word, all(0xfff));
        let y = stated(coordinate, rows, row);
        let time = stated(value, lows, low);
        (row, low) = (last(y), last(time));
        let kept = table(&KEPT_WORDS, columns);
        let kept_of = |lanes| _mm_shuffle_epi8(lanes, kept);
        let (place, y, time) = (kept_of(value), kept_of(y), kept_of(time));
        let count = columns.count_ones() as usize;
        let (front, back) = slots.split_at_mut(LANES / 2);
        if let Some(front) = front.first_chunk_mut() {
            let place_of_four = _mm_unpacklo_epi16(place, y);
            store(front, place_of_four, _mm256_cvtepu16_epi64(time), high_us);
        }
        if let Some(back) = back.first_chunk_mut().filter(|_| count > LANES / 2) {
            let place_of_four = _mm_unpackhi_epi16(place, y);
            let time = _mm256_cvtepu16_epi64(_mm_srli_si128::<8>(time));
            store(back, place_of_four, time, high_us);
        }
        decoded.events += count;
        decoded.words += LANES;
    }
    (plain.y, plain.low) = (first(row), first(low));
    decoded
}

/// Writes four events: `place` has polarity and column in 12 bits, then the row, `low_us` the lower bits of time.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn store(slots: &mut [Event; LANES / 2], place: __m128i, low_us: __m256i, high_us: __m256i) {
    let lanes = _mm256_cvtepu32_epi64(place);
    let mask =
        |lanes, bits: i64| core::arch::x86_64::_mm256_and_si256(lanes, _mm256_set1_epi64x(bits));
    let polarity = mask(_mm256_slli_epi64::<21>(lanes), 1 << 32);
    let event = _mm256_or_si256(mask(lanes, 0xFFFF_07FF), polarity);
    let time = _mm256_add_epi64(low_us, high_us);
    // Events 0 and 2, 1 and 3.
    let even = _mm256_unpacklo_epi64(time, event);
    let odd = _mm256_unpackhi_epi64(time, event);
    let to: *mut __m256i = slots.as_mut_ptr().cast();
    // SAFETY: the reference makes four events writable. Each gets a time, x and y of any bits, a polarity of 0 or 1, and
    // zeros as padding; the layout is asserted beside `Event`.
    unsafe {
        _mm256_storeu_si256(to, _mm256_permute2x128_si256::<0x20>(even, odd));
        _mm256_storeu_si256(to.add(1), _mm256_permute2x128_si256::<0x31>(even, odd));
    }
}

/// Returns for each lane the value of the last lane of `mask` at or before it, or `before` if there is none.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn stated(values: __m128i, mask: usize, before: __m128i) -> __m128i {
    let latest = table(&LATEST_WORDS, mask);
    // The highest bit of a byte of the table says that there is none.
    _mm_blendv_epi8(_mm_shuffle_epi8(values, latest), before, latest)
}

/// Returns the last lane in all lanes.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn last(lanes: __m128i) -> __m128i {
    _mm_shuffle_epi8(lanes, _mm_set1_epi16(0x0F0E))
}

#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn first(lanes: __m128i) -> u16 {
    _mm_cvtsi128_si32(lanes) as u16
}

/// Returns which lanes of `a`, and of `b`, are set.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn masks(a: __m128i, b: __m128i) -> (usize, usize) {
    let both = _mm_movemask_epi8(_mm_packs_epi16(a, b)) as usize;
    (both & 0xFF, both >> 8)
}

/// Returns the bytes of a table for a mask below 256.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn table(table: &[[u8; 16]; 256], mask: usize) -> __m128i {
    let bytes = &table[mask & 0xFF];
    // SAFETY: the reference makes 16 bytes readable.
    unsafe { _mm_loadu_si128(bytes.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn load(block: &[[u8; 2]; LANES]) -> __m128i {
    // SAFETY: the reference makes 16 bytes readable.
    unsafe { _mm_loadu_si128(block.as_ptr().cast()) }
}
