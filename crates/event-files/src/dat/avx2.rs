//! Four records of version 2 at a time, by AVX2: from bytes to events, and back.

use core::arch::asm;
use core::arch::x86_64::{
    __m256i, _mm256_add_epi64, _mm256_and_si256, _mm256_loadu_si256, _mm256_or_si256,
    _mm256_permute2x128_si256, _mm256_set1_epi64x, _mm256_slli_epi64, _mm256_srli_epi64,
    _mm256_storeu_si256, _mm256_sub_epi64, _mm256_subs_epu16, _mm256_testz_si256,
    _mm256_unpackhi_epi64, _mm256_unpacklo_epi64, _mm256_xor_si256,
};

use event_types::{Event, Sensor};

/// Records at a time.
const LANES: usize = 4;

/// Proof that the core has AVX2.
#[derive(Debug, Clone, Copy)]
pub struct Avx2(());

impl Avx2 {
    /// Returns the proof if the core has it.
    pub fn detected() -> Option<Self> {
        is_x86_feature_detected!("avx2").then_some(Self(()))
    }

    /// Decodes records from the front, whole fours of them, up to four of which one needs a closer look: it is not on the
    /// sensor, its time differs from `before` in the highest bit, or its polarity is neither 0 nor 1. `base_us` is added
    /// to the times. Returns how many events it put into `events`.
    pub fn decode(
        self,
        records: &[[u8; 8]],
        base_us: u64,
        before: u32,
        sensor: Sensor,
        events: &mut [Event],
    ) -> usize {
        // SAFETY: `self` proves that the core has AVX2.
        unsafe { decode(records, base_us, before, sensor, events) }
    }

    /// Encodes events from the front, whole fours of them, up to four of which one needs a closer look: it is not on the
    /// sensor, whose sides are at most 2^14, or its time since `base_us` differs from `before` above bit 30. Returns how
    /// many records it put into `records`.
    pub fn encode(
        self,
        events: &[Event],
        base_us: u64,
        before: u32,
        sensor: Sensor,
        records: &mut [[u8; 8]],
    ) -> usize {
        // SAFETY: `self` proves that the core has AVX2.
        unsafe { encode(events, base_us, before, sensor, records) }
    }
}

#[target_feature(enable = "avx2")]
fn decode(
    records: &[[u8; 8]],
    base_us: u64,
    before: u32,
    sensor: Sensor,
    events: &mut [Event],
) -> usize {
    let all = |value: u64| _mm256_set1_epi64x(value as i64);
    let (base, before) = (all(base_us), all(before.into()));
    // Lanes of 16 bits: x, y, the polarity with a byte of padding, and padding.
    let (x, y) = (sensor.width.wrapping_sub(1), sensor.height.wrapping_sub(1));
    let sides = all(0xFFFF_FFFF << 32 | u64::from(y) << 16 | u64::from(x));
    // The time's highest bit, and those of the polarity above the lowest.
    let same = all(0xE000_0000_8000_0000);
    let mut decoded = 0;
    let (records, _) = records.as_chunks::<LANES>();
    let (events, _) = events.as_chunks_mut::<LANES>();
    for (records, events) in records.iter().zip(events) {
        let record = load(records);
        let address = _mm256_srli_epi64::<32>(record);
        let x = _mm256_and_si256(address, all(0x3FFF));
        let y = _mm256_and_si256(_mm256_slli_epi64::<2>(address), all(0x3FFF_0000));
        let polarity = _mm256_and_si256(_mm256_slli_epi64::<4>(address), all(1 << 32));
        let place = _mm256_or_si256(_mm256_or_si256(x, y), polarity);
        let trouble = _mm256_or_si256(
            _mm256_subs_epu16(place, sides),
            _mm256_and_si256(_mm256_xor_si256(record, before), same),
        );
        if _mm256_testz_si256(trouble, trouble) == 0 {
            break;
        }
        let time = _mm256_add_epi64(base, _mm256_and_si256(record, all(0xFFFF_FFFF)));
        // Events 0 and 2, 1 and 3.
        let even = _mm256_unpacklo_epi64(time, place);
        let odd = _mm256_unpackhi_epi64(time, place);
        store(
            events,
            _mm256_permute2x128_si256::<0x20>(even, odd),
            _mm256_permute2x128_si256::<0x31>(even, odd),
        );
        decoded += LANES;
    }
    decoded
}

#[target_feature(enable = "avx2")]
fn encode(
    events: &[Event],
    base_us: u64,
    before: u32,
    sensor: Sensor,
    records: &mut [[u8; 8]],
) -> usize {
    let all = |value: u64| _mm256_set1_epi64x(value as i64);
    let (base, before) = (all(base_us), all(before.into()));
    let (x, y) = (sensor.width.wrapping_sub(1), sensor.height.wrapping_sub(1));
    let sides = all(0xFFFF_FFFF << 32 | u64::from(y) << 16 | u64::from(x));
    let mut encoded = 0;
    let (events, _) = events.as_chunks::<LANES>();
    let (records, _) = records.as_chunks_mut::<LANES>();
    for (events, records) in events.iter().zip(records) {
        let (front, back) = load_events(events);
        // Events 0 and 2, 1 and 3.
        let even = _mm256_permute2x128_si256::<0x20>(front, back);
        let odd = _mm256_permute2x128_si256::<0x31>(front, back);
        let time = _mm256_sub_epi64(_mm256_unpacklo_epi64(even, odd), base);
        let place = _mm256_unpackhi_epi64(even, odd);
        let trouble = _mm256_or_si256(
            _mm256_subs_epu16(place, sides),
            _mm256_and_si256(_mm256_xor_si256(time, before), all(!0x7FFF_FFFF)),
        );
        if _mm256_testz_si256(trouble, trouble) == 0 {
            break;
        }
        let x = _mm256_slli_epi64::<32>(_mm256_and_si256(place, all(0x3FFF)));
        let y = _mm256_slli_epi64::<30>(_mm256_and_si256(place, all(0x3FFF_0000)));
        let polarity = _mm256_slli_epi64::<28>(_mm256_and_si256(place, all(1 << 32)));
        let address = _mm256_or_si256(_mm256_or_si256(x, y), polarity);
        store_records(records, _mm256_or_si256(address, time));
        encoded += LANES;
    }
    encoded
}

/// Loads events 0 and 1, and 2 and 3. Their padding has any bits.
#[inline]
#[target_feature(enable = "avx2")]
fn load_events(events: &[Event; LANES]) -> (__m256i, __m256i) {
    let (first, second);
    // SAFETY: the reference makes 64 bytes readable; the layout of an `Event` is asserted beside it. Instructions may read
    // padding, which Rust's own loads of integers may not: whatever it holds, the registers then hold some bits.
    unsafe {
        asm!(
            "vmovdqu {first}, [{events}]",
            "vmovdqu {second}, [{events} + 32]",
            events = in(reg) events,
            first = out(ymm_reg) first,
            second = lateout(ymm_reg) second,
            options(pure, readonly, nostack, preserves_flags)
        );
    }
    (first, second)
}

#[inline]
#[target_feature(enable = "avx2")]
fn store_records(records: &mut [[u8; 8]; LANES], lanes: __m256i) {
    // SAFETY: the reference makes 32 bytes writable.
    unsafe { _mm256_storeu_si256(records.as_mut_ptr().cast(), lanes) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn load(records: &[[u8; 8]; LANES]) -> __m256i {
    // SAFETY: the reference makes 32 bytes readable.
    unsafe { _mm256_loadu_si256(records.as_ptr().cast()) }
}

/// Writes events 0 and 1, and 2 and 3.
#[inline]
#[target_feature(enable = "avx2")]
fn store(events: &mut [Event; LANES], first: __m256i, second: __m256i) {
    let to: *mut __m256i = events.as_mut_ptr().cast();
    // SAFETY: the reference makes four events writable. Each gets a time, x and y of any bits, a polarity of 0 or 1, and
    // zeros as padding; the layout is asserted beside `Event`.
    unsafe {
        _mm256_storeu_si256(to, first);
        _mm256_storeu_si256(to.add(1), second);
    }
}
