//! Plain arrays: the safe twin of the vectors.

use crate::coder::quick::format::LANES;
use crate::coder::quick::lanes::{Lanes, halves};
use event_types::{Event, Polarity};

/// Plain arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Array;

type V = [u32; LANES];

#[inline(always)]
fn each(a: V, b: V, f: impl Fn(u32, u32) -> u32) -> V {
    core::array::from_fn(|i| f(a[i], b[i]))
}

impl Lanes for Array {
    type Vector = V;

    #[inline(always)]
    fn splat(self, value: u32) -> V {
        [value; LANES]
    }
    #[inline(always)]
    fn load(self, from: &[u32; LANES]) -> V {
        *from
    }
    #[inline(always)]
    fn store(self, to: &mut [u32; LANES], v: V) {
        *to = v;
    }
    #[inline(always)]
    fn load_bytes(self, from: &[u8; 4 * LANES]) -> V {
        let (words, _) = from.as_chunks();
        core::array::from_fn(|i| u32::from_le_bytes(words[i]))
    }
    #[inline(always)]
    fn store_bytes(self, to: &mut [u8; 4 * LANES], v: V) {
        let (words, _) = to.as_chunks_mut();
        for (to, v) in words.iter_mut().zip(v) {
            *to = v.to_le_bytes();
        }
    }
    #[inline(always)]
    fn load_single_bytes(self, from: &[u8; LANES]) -> V {
        from.map(u32::from)
    }
    #[inline(always)]
    fn load_half_bytes(self, from: &[u8; 2 * LANES]) -> V {
        let (halves, _) = from.as_chunks();
        core::array::from_fn(|i| u16::from_le_bytes(halves[i]).into())
    }
    #[inline(always)]
    fn store_half_bytes(self, to: &mut [u8; 2 * LANES], v: V) {
        let (halves, _) = to.as_chunks_mut();
        for (to, v) in halves.iter_mut().zip(v) {
            *to = (v as u16).to_le_bytes();
        }
    }
    #[inline(always)]
    fn add(self, a: V, b: V) -> V {
        each(a, b, u32::wrapping_add)
    }
    #[inline(always)]
    fn sub(self, a: V, b: V) -> V {
        each(a, b, u32::wrapping_sub)
    }
    #[inline(always)]
    fn mul(self, a: V, b: V) -> V {
        each(a, b, u32::wrapping_mul)
    }
    #[inline(always)]
    fn mul_high(self, a: V, b: V) -> V {
        each(a, b, |a, b| ((u64::from(a) * u64::from(b)) >> 32) as u32)
    }
    #[inline(always)]
    fn dot(self, a: V, b: V) -> V {
        each(a, b, |a, b| {
            let low = i32::from(a as i16) * i32::from(b as i16);
            let high = i32::from((a >> 16) as i16) * i32::from((b >> 16) as i16);
            low.wrapping_add(high) as u32
        })
    }
    #[inline(always)]
    fn and(self, a: V, b: V) -> V {
        each(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn or(self, a: V, b: V) -> V {
        each(a, b, |a, b| a | b)
    }
    #[inline(always)]
    fn shl(self, a: V, count: u32) -> V {
        a.map(|a| a << count)
    }
    #[inline(always)]
    fn shr(self, a: V, count: u32) -> V {
        a.map(|a| a >> count)
    }
    #[inline(always)]
    fn max(self, a: V, b: V) -> V {
        each(a, b, u32::max)
    }
    #[inline(always)]
    fn min_halves(self, a: V, b: V) -> V {
        each(a, b, |a, b| halves(a, b, u16::min))
    }
    #[inline(always)]
    fn max_halves(self, a: V, b: V) -> V {
        each(a, b, |a, b| halves(a, b, u16::max))
    }
    #[inline(always)]
    fn high_bits(self, bytes: &[u8; 4 * LANES]) -> u32 {
        (0..)
            .zip(bytes)
            .fold(0, |bits, (i, byte)| bits | u32::from(byte >> 7) << i)
    }
    #[inline(always)]
    fn load_pairs(self, from: &[[u32; 2]; LANES]) -> (V, V) {
        (from.map(|[first, _]| first), from.map(|[_, second]| second))
    }
    #[inline(always)]
    fn store_events(self, events: &mut [Event; LANES], start_us: u64, t: V, place: V, polarity: V) {
        for (((event, t), place), polarity) in events.iter_mut().zip(t).zip(place).zip(polarity) {
            *event = Event {
                t_us: start_us.wrapping_add(t.into()),
                x: place as u16,
                y: (place >> 16) as u16,
                polarity: Polarity::from_bool(polarity == 1),
            };
        }
    }
}
