//! AVX2: four events at a time.

use core::arch::asm;
use core::arch::x86_64::{
    __m256i, _mm_cvtsi128_si32, _mm_max_epu32, _mm_unpackhi_epi64, _mm256_add_epi64,
    _mm256_and_si256, _mm256_blend_epi32, _mm256_castsi256_si128, _mm256_cmpgt_epi64,
    _mm256_extracti128_si256, _mm256_max_epu32, _mm256_mullo_epi16, _mm256_or_si256,
    _mm256_permute4x64_epi64, _mm256_set1_epi32, _mm256_set1_epi64x, _mm256_slli_epi64,
    _mm256_storeu_si256, _mm256_subs_epu16, _mm256_testz_si256, _mm256_unpackhi_epi64,
    _mm256_unpacklo_epi64,
};

use crate::window::Slot;
use crate::window::take_events::Bounds;
use event_types::Event;

/// Events at a time.
const LANES: usize = 4;

cpufeatures::new!(detected, "avx2");

/// Proof that the core has AVX2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Avx2(());

impl Avx2 {
    /// Returns the proof if the core has it.
    #[inline]
    pub fn detected() -> Option<Self> {
        detected::get().then_some(Self(()))
    }

    /// As [`super::take_in_order`], but only while there are four events and slots, and leaves all four alone if one
    /// does not lie within `bounds`.
    #[inline]
    pub fn take_in_order(
        self,
        bounds: Bounds,
        slots: &mut [Slot],
        events: &[Event],
        latest_us: &mut u32,
    ) -> usize {
        // SAFETY: `self` proves that the core has AVX2.
        unsafe { take_in_order(bounds, slots, events, latest_us) }
    }
}

#[target_feature(enable = "avx2")]
fn take_in_order(
    bounds: Bounds,
    slots: &mut [Slot],
    events: &[Event],
    latest_us: &mut u32,
) -> usize {
    let Bounds {
        sensor,
        start_us,
        duration_us,
    } = bounds;
    // Offsets of times before the start wrap: they are all beyond the window unless the window ends with the clock.
    if start_us.checked_add(u64::from(u32::MAX)).is_none() {
        return 0;
    }
    let Some(last_us) = duration_us.checked_sub(1) else {
        return 0;
    };
    // The comparison is of signed numbers: 2^63 is added to both of its sides.
    let to_offset = _mm256_set1_epi64x(start_us.wrapping_neg().wrapping_add(1 << 63) as i64);
    let last = _mm256_set1_epi64x(i64::from(last_us).wrapping_add(i64::MIN));
    // Lanes of 16 bits: x, y, the polarity with a byte of padding, and padding.
    let (x, y) = (sensor.width.wrapping_sub(1), sensor.height.wrapping_sub(1));
    let sides = 0xFFFF_FFFF << 32 | u64::from(y) << 16 | u64::from(x);
    let sides = _mm256_set1_epi64x(sides as i64);
    let double_x = _mm256_set1_epi64x(0x0001_0001_0001_0002);
    let without_padding = _mm256_set1_epi64x(0xFF_FFFF_FFFF);
    let mut latest = _mm256_set1_epi32(*latest_us as i32);

    let mut taken = 0;
    let (slots, _) = slots.as_chunks_mut::<LANES>();
    let (events, _) = events.as_chunks::<LANES>();
    for (slots, events) in slots.iter_mut().zip(events) {
        let (first, second) = load(events);
        // Events 0, 2, 1, 3.
        let t = _mm256_unpacklo_epi64(first, second);
        let place = _mm256_unpackhi_epi64(first, second);
        let place = _mm256_and_si256(place, without_padding);
        let offset = _mm256_add_epi64(t, to_offset);
        let outside = _mm256_or_si256(
            _mm256_cmpgt_epi64(offset, last),
            _mm256_subs_epu16(place, sides),
        );
        if _mm256_testz_si256(outside, outside) == 0 {
            break;
        }
        latest = _mm256_max_epu32(latest, _mm256_blend_epi32::<0b1010_1010>(offset, latest));
        // y << 16 | x << 1 in the lower half, the polarity in the upper one, which takes both.
        let place = _mm256_mullo_epi16(place, double_x);
        let place = _mm256_or_si256(place, _mm256_slli_epi64::<32>(place));
        let slot = _mm256_blend_epi32::<0b1010_1010>(offset, place);
        store(slots, _mm256_permute4x64_epi64::<0b11_01_10_00>(slot));
        taken += LANES;
    }
    let half = _mm_max_epu32(
        _mm256_castsi256_si128(latest),
        _mm256_extracti128_si256::<1>(latest),
    );
    let most = _mm_max_epu32(half, _mm_unpackhi_epi64(half, half));
    *latest_us = _mm_cvtsi128_si32(most) as u32;
    taken
}

/// Loads events 0 and 1, and 2 and 3. Their padding has any bits.
#[inline]
#[target_feature(enable = "avx2")]
fn load(events: &[Event; LANES]) -> (__m256i, __m256i) {
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
            options(pure, readonly, nostack, preserves_flags),
        );
    }
    (first, second)
}

/// Writes four slots.
#[inline]
#[target_feature(enable = "avx2")]
fn store(slots: &mut [Slot; LANES], all: __m256i) {
    // SAFETY: the reference makes 32 bytes writable, and a `Slot` is two words of any bits.
    unsafe { _mm256_storeu_si256(slots.as_mut_ptr().cast(), all) }
}
