//! The kernels with NEON. Classes and words stay plain: NEON has neither leading zeros nor products of 64-bit lanes,
//! and aarch64's own instructions do.
#![allow(unsafe_code)]

use core::arch::aarch64::{
    uint64x2x2_t, vaddq_u16, vaddq_u64, vaddw_u32, vandq_u64, vbslq_u64, vcgtq_u64,
    vdupq_laneq_u16, vdupq_n_s64, vdupq_n_u16, vdupq_n_u64, vextq_u16, vgetq_lane_u16, vld1q_u16,
    vld1q_u64, vmaxvq_u32, vmlal_n_u32, vmovn_u64, vmull_n_u32, vorrq_u64, vreinterpretq_u32_u64,
    vshlq_n_u64, vshlq_u64, vshr_n_u32, vshrq_n_u64, vst1q_u16, vst2q_u64, vsubq_u16,
};

use crate::coder::keys::SLICE_EVENTS;
use crate::coder::keys::kernels::{Clock, Kernels, Pairs, Span, Symbols, TIME, Words, moves};
use crate::coder::keys::portable::{self, Portable};
use event_types::Event;

/// Proof that the core has NEON.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Neon(());

impl Neon {
    /// Returns the proof, which the target is.
    pub const fn new() -> Self {
        Self(())
    }
}

impl Kernels for Neon {
    #[inline(always)]
    fn sums(self, counts: &mut [u16]) {
        let (vectors, rest) = counts.as_chunks_mut::<8>();
        // SAFETY: `self` exists, so the core has NEON; each vector is 8 counts of its own.
        let sum = unsafe {
            let zero = vdupq_n_u16(0);
            let mut carry = zero;
            for vector in vectors {
                let counts = vld1q_u16(vector.as_ptr());
                let mut sums = vaddq_u16(counts, vextq_u16::<7>(zero, counts));
                sums = vaddq_u16(sums, vextq_u16::<6>(zero, sums));
                sums = vaddq_u16(sums, vextq_u16::<4>(zero, sums));
                let all = vdupq_laneq_u16::<7>(sums);
                vst1q_u16(
                    vector.as_mut_ptr(),
                    vsubq_u16(vaddq_u16(sums, carry), counts),
                );
                carry = vaddq_u16(carry, all);
            }
            vgetq_lane_u16::<0>(carry)
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
        Portable.classes(words, count, span, symbols, pairs)
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
        Portable.words(symbols, count, mantissas, span, words)
    }

    #[inline(always)]
    fn insert(self, words: &mut [u64]) -> bool {
        let mut left = moves(words.len());
        let mut i = 0;
        while i + 4 < words.len() {
            // SAFETY: `self` exists, so the core has NEON; words `i` to `i + 4` exist.
            let is_in_order = unsafe {
                let at = words.as_ptr().add(i);
                let low = vcgtq_u64(vld1q_u64(at), vld1q_u64(at.add(1)));
                let high = vcgtq_u64(vld1q_u64(at.add(2)), vld1q_u64(at.add(3)));
                vmaxvq_u32(vreinterpretq_u32_u64(vorrq_u64(low, high))) == 0
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
        let (twos_out, rest_out) = events[..count].as_chunks_mut::<2>();
        let (twos, rest) = words[..count].as_chunks::<2>();
        let bits = u16::BITS - (width - 1).leading_zeros();
        let inverse = (1_u64 << (22 + bits)).div_ceil(u64::from(width)) as u32;
        let last = u64::from(clock.last_us);
        // SAFETY: `self` exists, so the core has NEON; loads and stores are of chunks of 2, and all fields of
        // an event get values of theirs: `Event` is `repr(C)`, 8 bytes of time, 2 of x, 2 of y, 1 of polarity, which
        // is 0 or 1, and 3 bytes of padding.
        unsafe {
            let shift = vdupq_n_s64(-(22 + i64::from(bits)));
            // x + 2^16 y = place + (2^16 - width) y.
            let step = (1 << 16) - u32::from(width);
            for (two, out) in twos.iter().zip(twos_out) {
                let word = vld1q_u64(two.as_ptr());
                let place = vshr_n_u32::<1>(vmovn_u64(word));
                let y = vmovn_u64(vshlq_u64(vmull_n_u32(place, inverse), shift));
                let position = vaddw_u32(vmull_n_u32(y, step), place);
                let on = vshlq_n_u64::<32>(vandq_u64(word, vdupq_n_u64(1)));
                let unit = vaddq_u64(
                    vshrq_n_u64::<{ TIME as i32 }>(word),
                    vdupq_n_u64(u64::from(clock.first)),
                );
                let offset = vmlal_n_u32(
                    vdupq_n_u64(u64::from(clock.unit_us / 2)),
                    vmovn_u64(unit),
                    clock.unit_us,
                );
                let offset = vbslq_u64(
                    vcgtq_u64(offset, vdupq_n_u64(last)),
                    vdupq_n_u64(last),
                    offset,
                );
                let time = vaddq_u64(offset, vdupq_n_u64(clock.start_us));
                vst2q_u64(
                    out.as_mut_ptr().cast(),
                    uint64x2x2_t(time, vorrq_u64(position, on)),
                );
            }
        }
        for (event, word) in rest_out.iter_mut().zip(rest) {
            *event = portable::event(*word, width, clock);
        }
    }
}
