//! Sixteen words at a time, by AVX2.

use core::arch::x86_64::{
    __m128i, __m256i, _mm_add_epi16, _mm_add_epi32, _mm_blendv_epi8, _mm_cvtsi128_si32,
    _mm_loadu_si128, _mm_madd_epi16, _mm_set1_epi16, _mm_shuffle_epi8, _mm_srli_si128,
    _mm_unpackhi_epi16, _mm_unpacklo_epi16, _mm256_add_epi64, _mm256_and_si256,
    _mm256_castsi256_si128, _mm256_cmpeq_epi16, _mm256_cmpgt_epi16, _mm256_cvtepu16_epi64,
    _mm256_cvtepu32_epi64, _mm256_extracti128_si256, _mm256_loadu_si256, _mm256_movemask_epi8,
    _mm256_or_si256, _mm256_packs_epi16, _mm256_set1_epi16, _mm256_set1_epi64x,
    _mm256_setzero_si256, _mm256_slli_epi64, _mm256_srli_epi16, _mm256_storeu_si256,
    _mm256_sub_epi16, _mm256_unpackhi_epi64, _mm256_unpacklo_epi64,
};
use std::mem;

use event_types::{Event, Sensor};

use super::{ADDR_X, ADDR_Y, CONTINUED, Decoded, OTHER, Plain, TIME_HIGH, TIME_LOW, TRIGGER};
use crate::evt::lanes::{KEPT, LATEST, of_two_bytes};

/// Words at a time.
const WORDS: usize = super::TOGETHER;

/// Words at a time of which the events are found.
const LANES: usize = 8;

static LATEST_WORDS: [[u8; 16]; 256] = of_two_bytes(&LATEST);
/// Of each four that are kept, the second and the third change places, as unpacking wants them.
static KEPT_WORDS: [[u8; 16]; 256] = unpacked(of_two_bytes(&KEPT));

const fn unpacked(mut tables: [[u8; 16]; 256]) -> [[u8; 16]; 256] {
    let mut mask = 0;
    while mask < tables.len() {
        let mut byte = 0;
        while byte < 2 {
            tables[mask].swap(2 + byte, 4 + byte);
            tables[mask].swap(10 + byte, 12 + byte);
            byte += 1;
        }
        mask += 1;
    }
    tables
}

/// Proof that the core has AVX2, and counts bits.
#[derive(Debug, Clone, Copy)]
pub struct Avx2(());

impl Avx2 {
    /// Returns the proof if the core has them.
    pub fn detected() -> Option<Self> {
        let has_both = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt");
        has_both.then_some(Self(()))
    }

    /// Decodes words from the front, whole sixteens of them, up to sixteen of which one is not plain.
    pub fn decode(self, words: &[[u8; 2]], plain: &mut Plain, events: &mut [Event]) -> Decoded {
        // SAFETY: `self` proves that the core has what the function needs.
        unsafe { decode(words, plain, events) }
    }
}

#[target_feature(enable = "avx2,popcnt")]
fn decode(words: &[[u8; 2]], plain: &mut Plain, mut events: &mut [Event]) -> Decoded {
    let all = |value: u16| _mm256_set1_epi16(value as i16);
    let Sensor { width, height } = plain.sensor;
    // Columns and rows have 11 bits.
    let columns = ADDR_X << 12;
    let columns_end = all(columns + width.min(1 << 11));
    // The type of a row is 0.
    const { assert!(ADDR_Y == 0) };
    let rows_end = all(height.min(1 << 11));
    let high = all(TIME_HIGH << 12 | plain.high);
    let mut stated = Stated {
        row: _mm_set1_epi16(plain.y as i16),
        low: _mm_set1_epi16(plain.low as i16),
        high_us: _mm256_set1_epi64x(plain.high_us as i64),
    };
    let (mut taken, mut count, mut plain_left) = (0, 0, 0);
    let [mut triggers, mut continued, mut others] = [_mm256_setzero_si256(); 3];
    let (blocks, _) = words.as_chunks::<WORDS>();
    for block in blocks {
        let word = load(block);
        let kind = _mm256_srli_epi16::<12>(word);
        let is = |of| _mm256_cmpeq_epi16(kind, all(of));
        // Without the polarity, whose bit has no meaning in a row.
        let place = _mm256_and_si256(word, all(0xf7ff));
        let is_x = _mm256_and_si256(
            _mm256_cmpgt_epi16(place, all(columns - 1)),
            _mm256_cmpgt_epi16(columns_end, place),
        );
        let is_y = _mm256_and_si256(
            _mm256_cmpgt_epi16(place, all(u16::MAX)),
            _mm256_cmpgt_epi16(rows_end, place),
        );
        let is_low = is(TIME_LOW);
        let is_stated = _mm256_or_si256(_mm256_or_si256(is_x, is_y), is_low);
        let is_continued =
            _mm256_cmpeq_epi16(_mm256_and_si256(kind, all(CONTINUED)), all(CONTINUED));
        let (is_trigger, is_other) = (is(TRIGGER), is(OTHER));
        let is_counted = _mm256_or_si256(_mm256_or_si256(is_trigger, is_other), is_continued);
        let is_known = _mm256_or_si256(is_counted, _mm256_cmpeq_epi16(word, high));
        let is_plain = _mm256_movemask_epi8(_mm256_or_si256(is_stated, is_known));
        if is_plain != -1 {
            plain_left = is_plain.trailing_ones() as usize / 2;
            break;
        }
        if events.len() < WORDS {
            break;
        }
        let slots = mem::take(&mut events);
        // A run has too few words for a lane to overflow.
        triggers = _mm256_sub_epi16(triggers, is_trigger);
        continued = _mm256_sub_epi16(continued, is_continued);
        others = _mm256_sub_epi16(others, is_other);
        // Each byte of a mask is of eight words: columns and rows of the first eight, then of the others.
        let places = _mm256_movemask_epi8(_mm256_packs_epi16(is_x, is_y)) as u32;
        let lows = _mm256_movemask_epi8(_mm256_packs_epi16(is_low, is_low)) as u32;
        let value = _mm256_and_si256(word, all(0xfff));
        let front = _mm256_castsi256_si128(value);
        let in_front = stated.emit(front, places, lows, slots);
        let slots = slots.get_mut(in_front..).unwrap_or_default();
        let back = _mm256_extracti128_si256::<1>(value);
        let in_back = stated.emit(back, places >> 16, lows >> 16, slots);
        events = slots.get_mut(in_back..).unwrap_or_default();
        count += in_front + in_back;
        taken += WORDS;
    }
    (plain.y, plain.low) = (first(stated.row) & 0x7ff, first(stated.low));
    Decoded {
        words: taken,
        events: count,
        plain_left,
        skipped: [sum(triggers), sum(continued), sum(others)],
    }
}

/// What the words so far have stated, in all lanes.
struct Stated {
    /// The row, in the lower 11 bits.
    row: __m128i,
    /// Lower bits of time.
    low: __m128i,
    high_us: __m256i,
}

impl Stated {
    /// Writes the events of eight words to the front of `slots`, of which it may overwrite eight, and returns their number.
    /// `places` says which words are columns, in its lowest byte, and which are rows; `lows` which are lower bits of time.
    #[inline]
    #[target_feature(enable = "avx2,popcnt")]
    fn emit(&mut self, value: __m128i, places: u32, lows: u32, slots: &mut [Event]) -> usize {
        let (columns, rows, lows) = (places & 0xff, places >> 8 & 0xff, lows & 0xff);
        let y = stated(value, rows, self.row);
        let time = stated(value, lows, self.low);
        (self.row, self.low) = (last(y), last(time));
        let kept = table(&KEPT_WORDS, columns);
        let count = columns.count_ones() as usize;
        let place = _mm_shuffle_epi8(value, kept);
        let (y, time) = (_mm_shuffle_epi8(y, kept), _mm_shuffle_epi8(time, kept));
        if let Some((front, back)) = slots.split_first_chunk_mut() {
            let place_of_four = _mm_unpacklo_epi16(place, y);
            store(
                front,
                place_of_four,
                _mm256_cvtepu16_epi64(time),
                self.high_us,
            );
            if count > LANES / 2
                && let Some(back) = back.first_chunk_mut()
            {
                let place_of_four = _mm_unpackhi_epi16(place, y);
                let time = _mm256_cvtepu16_epi64(_mm_srli_si128::<8>(time));
                store(back, place_of_four, time, self.high_us);
            }
        }
        count
    }
}

/// Writes four events: `place` has polarity and column in 12 bits, then the row in 11, `low_us` the lower bits of time.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn store(slots: &mut [Event; LANES / 2], place: __m128i, low_us: __m256i, high_us: __m256i) {
    let lanes = _mm256_cvtepu32_epi64(place);
    let mask = |lanes, bits: i64| _mm256_and_si256(lanes, _mm256_set1_epi64x(bits));
    let polarity = mask(_mm256_slli_epi64::<21>(lanes), 1 << 32);
    let event = _mm256_or_si256(mask(lanes, 0x07FF_07FF), polarity);
    let time = _mm256_add_epi64(low_us, high_us);
    // Events 0 and 1, 2 and 3: they come in the order 0, 2, 1, 3.
    let front = _mm256_unpacklo_epi64(time, event);
    let back = _mm256_unpackhi_epi64(time, event);
    let to: *mut __m256i = slots.as_mut_ptr().cast();
    // SAFETY: the reference makes four events writable. Each gets a time, x and y of any bits, a polarity of 0 or 1, and
    // zeros as padding; the layout is asserted beside `Event`.
    unsafe {
        _mm256_storeu_si256(to, front);
        _mm256_storeu_si256(to.add(1), back);
    }
}

/// Returns for each lane the value of the last lane of `mask` at or before it, or `before` if there is none.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn stated(values: __m128i, mask: u32, before: __m128i) -> __m128i {
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

/// Returns the sum of all lanes, which is below 2^15.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn sum(lanes: __m256i) -> u16 {
    let halves = _mm_add_epi16(
        _mm256_castsi256_si128(lanes),
        _mm256_extracti128_si256::<1>(lanes),
    );
    let pairs = _mm_madd_epi16(halves, _mm_set1_epi16(1));
    let pairs = _mm_add_epi32(pairs, _mm_srli_si128::<8>(pairs));
    first(_mm_add_epi32(pairs, _mm_srli_si128::<4>(pairs)))
}

/// Returns the bytes of a table for a mask below 256.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn table(table: &[[u8; 16]; 256], mask: u32) -> __m128i {
    let bytes = &table[(mask & 0xFF) as usize];
    // SAFETY: the reference makes 16 bytes readable.
    unsafe { _mm_loadu_si128(bytes.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx2,popcnt")]
fn load(block: &[[u8; 2]; WORDS]) -> __m256i {
    // SAFETY: the reference makes 32 bytes readable.
    unsafe { _mm256_loadu_si256(block.as_ptr().cast()) }
}
