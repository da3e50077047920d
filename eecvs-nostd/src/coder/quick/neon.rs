//! NEON, as two vectors of four lanes. Every `aarch64` core has it, so that no intrinsic without a pointer is unsafe.
#![allow(unsafe_code)]

use crate::coder::quick::array::Array;
use crate::coder::quick::format::LANES;
use crate::coder::quick::lanes::Lanes;
use core::arch::aarch64::{
    int16x8_t, uint32x4_t, vaddq_u32, vandq_u32, vcombine_u32, vdupq_n_s32, vdupq_n_u32,
    vget_high_u16, vget_low_s16, vget_low_u16, vget_low_u32, vld1_u8, vld1q_u8, vld1q_u32,
    vld2q_u32, vmaxq_u16, vmaxq_u32, vmaxvq_u32, vminq_u16, vmovl_u8, vmovl_u16, vmovn_u32,
    vmull_high_s16, vmull_high_u32, vmull_s16, vmull_u32, vmulq_u32, vorrq_u32, vpaddq_s32,
    vreinterpretq_s16_u32, vreinterpretq_u8_u32, vreinterpretq_u16_u8, vreinterpretq_u16_u32,
    vreinterpretq_u32_s32, vreinterpretq_u32_u8, vreinterpretq_u32_u16, vshlq_u32, vshrn_n_u64,
    vst1_u16, vst1q_u8, vst1q_u32, vsubq_u32,
};
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

/// Lanes 0 to 3 and 4 to 7.
#[derive(Debug, Clone, Copy)]
pub struct Pair(uint32x4_t, uint32x4_t);

/// Applies an operation to both vectors.
macro_rules! each {
    ($($name:ident: $f:expr,)*) => {$(
        #[inline(always)]
        fn $name(self, a: Pair, b: Pair) -> Pair {
            unsafe { Pair($f(a.0, b.0), $f(a.1, b.1)) }
        }
    )*};
}

#[inline(always)]
fn halves(
    a: uint32x4_t,
    b: uint32x4_t,
    f: impl Fn(
        core::arch::aarch64::uint16x8_t,
        core::arch::aarch64::uint16x8_t,
    ) -> core::arch::aarch64::uint16x8_t,
) -> uint32x4_t {
    // SAFETY: only called with a `Neon`.
    unsafe { vreinterpretq_u32_u16(f(vreinterpretq_u16_u32(a), vreinterpretq_u16_u32(b))) }
}

// SAFETY, of all blocks: `self` proves that the core has NEON; pointers come from references to arrays of as many
// bytes as are read or written.
#[allow(unused_unsafe, clippy::undocumented_unsafe_blocks)]
impl Lanes for Neon {
    type Vector = Pair;

    each! {
        add: vaddq_u32,
        sub: vsubq_u32,
        mul: vmulq_u32,
        and: vandq_u32,
        or: vorrq_u32,
        max: vmaxq_u32,
        min_halves: |a, b| halves(a, b, |a, b| vminq_u16(a, b)),
        max_halves: |a, b| halves(a, b, |a, b| vmaxq_u16(a, b)),
    }

    #[inline(always)]
    fn splat(self, value: u32) -> Pair {
        unsafe { Pair(vdupq_n_u32(value), vdupq_n_u32(value)) }
    }
    #[inline(always)]
    fn load(self, from: &[u32; LANES]) -> Pair {
        let from = from.as_ptr();
        unsafe { Pair(vld1q_u32(from), vld1q_u32(from.add(4))) }
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; LANES], v: Pair) {
        let to = to.as_mut_ptr();
        unsafe {
            vst1q_u32(to, v.0);
            vst1q_u32(to.add(4), v.1);
        }
    }
    #[inline(always)]
    fn load_bytes(self, from: &[u8; 4 * LANES]) -> Pair {
        let from = from.as_ptr();
        unsafe {
            Pair(
                vreinterpretq_u32_u8(vld1q_u8(from)),
                vreinterpretq_u32_u8(vld1q_u8(from.add(16))),
            )
        }
    }
    #[inline(always)]
    fn store_bytes(self, to: &mut [u8; 4 * LANES], v: Pair) {
        let to = to.as_mut_ptr();
        unsafe {
            vst1q_u8(to, vreinterpretq_u8_u32(v.0));
            vst1q_u8(to.add(16), vreinterpretq_u8_u32(v.1));
        }
    }
    #[inline(always)]
    fn load_single_bytes(self, from: &[u8; LANES]) -> Pair {
        unsafe {
            let halves = vmovl_u8(vld1_u8(from.as_ptr()));
            Pair(
                vmovl_u16(vget_low_u16(halves)),
                vmovl_u16(vget_high_u16(halves)),
            )
        }
    }
    #[inline(always)]
    fn load_half_bytes(self, from: &[u8; 2 * LANES]) -> Pair {
        unsafe {
            let halves = vreinterpretq_u16_u8(vld1q_u8(from.as_ptr()));
            Pair(
                vmovl_u16(vget_low_u16(halves)),
                vmovl_u16(vget_high_u16(halves)),
            )
        }
    }
    #[inline(always)]
    fn store_half_bytes(self, to: &mut [u8; 2 * LANES], v: Pair) {
        let (low, high) = to.split_at_mut(LANES);
        unsafe {
            // `u16` stores: the pointers need no alignment.
            vst1_u16(low.as_mut_ptr().cast(), vmovn_u32(v.0));
            vst1_u16(high.as_mut_ptr().cast(), vmovn_u32(v.1));
        }
    }
    #[inline(always)]
    fn mul_high(self, a: Pair, b: Pair) -> Pair {
        let high = |a, b| unsafe {
            let low = vshrn_n_u64::<32>(vmull_u32(vget_low_u32(a), vget_low_u32(b)));
            vcombine_u32(low, vshrn_n_u64::<32>(vmull_high_u32(a, b)))
        };
        Pair(high(a.0, b.0), high(a.1, b.1))
    }
    #[inline(always)]
    fn dot(self, a: Pair, b: Pair) -> Pair {
        let dot = |a, b| unsafe {
            let (a, b): (int16x8_t, int16x8_t) =
                (vreinterpretq_s16_u32(a), vreinterpretq_s16_u32(b));
            let low = vmull_s16(vget_low_s16(a), vget_low_s16(b));
            vreinterpretq_u32_s32(vpaddq_s32(low, vmull_high_s16(a, b)))
        };
        Pair(dot(a.0, b.0), dot(a.1, b.1))
    }
    #[inline(always)]
    fn shl(self, a: Pair, count: u32) -> Pair {
        unsafe {
            let count = vdupq_n_s32(count as i32);
            Pair(vshlq_u32(a.0, count), vshlq_u32(a.1, count))
        }
    }
    #[inline(always)]
    fn shr(self, a: Pair, count: u32) -> Pair {
        unsafe {
            let count = vdupq_n_s32(-(count as i32));
            Pair(vshlq_u32(a.0, count), vshlq_u32(a.1, count))
        }
    }
    #[inline(always)]
    fn high_bits(self, bytes: &[u8; 4 * LANES]) -> u32 {
        // Each byte is 0 or 255: keeps a bit of its own and adds those of eight.
        use core::arch::aarch64::{vaddv_u8, vand_u8};
        const BITS: [u8; 8] = [1, 2, 4, 8, 16, 32, 64, 128];
        let (eights, _) = bytes.as_chunks::<8>();
        let mut bits = [0; 4];
        for (to, eight) in bits.iter_mut().zip(eights) {
            *to = unsafe { vaddv_u8(vand_u8(vld1_u8(eight.as_ptr()), vld1_u8(BITS.as_ptr()))) };
        }
        u32::from_le_bytes(bits)
    }
    #[inline(always)]
    fn load_pairs(self, from: &[[u32; 2]; LANES]) -> (Pair, Pair) {
        let from: *const u32 = from.as_ptr().cast();
        let (low, high) = unsafe { (vld2q_u32(from), vld2q_u32(from.add(LANES))) };
        (Pair(low.0, high.0), Pair(low.1, high.1))
    }
    #[inline(always)]
    fn store_events(
        self,
        events: &mut [Event; LANES],
        start_us: u64,
        t: Pair,
        place: Pair,
        polarity: Pair,
    ) {
        let array = |v| {
            let mut lanes = [0; LANES];
            self.store(&mut lanes, v);
            lanes
        };
        Array.store_events(events, start_us, array(t), array(place), array(polarity));
    }
    #[inline(always)]
    fn most(self, v: Pair) -> u32 {
        unsafe { vmaxvq_u32(vmaxq_u32(v.0, v.1)) }
    }
    #[inline(always)]
    fn is_zero(self, v: Pair) -> bool {
        unsafe { vmaxvq_u32(vorrq_u32(v.0, v.1)) == 0 }
    }
}
