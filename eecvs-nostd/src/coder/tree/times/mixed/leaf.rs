//! Numbers, times and polarities of the events of a leaf.

use super::around::{N, NE, NW, Own, Scene, View, W, half_octaves};
use super::{CONTEXT_BITS, NEVER, POLARITY_ALL, POLARITY_QUICK, Walk};
use crate::coder::tree::TreeEvent;
use crate::coder::tree::range::BitCoder;
use crate::coder::tree::times::{Marks, Pixel};

/// A leaf of the last tree.
pub(super) struct Leaf {
    /// Number of its leaf of the first tree, and of the last one.
    pub(super) i: u32,
    pub(super) k: u32,
    pub(super) base: u32,
    pub(super) shift: u32,
    /// How many of four neighbours have events in it, up to 2, and whether the leaf before has some.
    pub(super) near: u32,
    pub(super) has_before: bool,
}

impl<C: BitCoder> Walk<'_, '_, C> {
    /// Codes the events of a leaf, at least one; returns how many, and whether ON and OFF ones.
    #[inline(always)]
    pub(super) fn leaf<const FULL: bool>(
        &mut self,
        leaf: &Leaf,
        place: u32,
        (near, scene): (&[Pixel; 6], &Scene),
        own: &mut Own,
        events: &mut [TreeEvent],
    ) -> (usize, bool, bool) {
        let silence = self.clock.at(leaf.base).wrapping_sub(own.last_time) & (NEVER - 1);
        let silence = half_octaves(silence >> 6).min(31);
        let interval = u32::from(own.interval) & 15;
        let mut count = 1_u32;
        while (count as usize) < events.len() {
            let is_more = C::ENCODES
                && events.get(count as usize).is_some_and(|event| {
                    event.place() == place && event.time >> leaf.shift == leaf.base >> leaf.shift
                });
            let k = (count - 1).min(7);
            let around = leaf.near << 4 | u32::from(leaf.has_before) << 3 | k;
            let at = [
                around,
                1 << CONTEXT_BITS | k | silence << 3 | own.last_on << 8,
                2 << CONTEXT_BITS
                    | k.min(3)
                    | interval << 2
                    | own.last_on << 6
                    | (silence >> 1) << 7,
                3 << CONTEXT_BITS | k.min(3) | u32::from(own.polarities & 15) << 2 | leaf.near << 6,
            ];
            let sets = [k, around, silence];
            let mixer = &mut self.learned.more;
            let is_more = if FULL {
                mixer.code(self.coder, at, sets, k, is_more)
            } else {
                let [a, b, c, _] = at;
                mixer.code(self.coder, [a, b, c], sets, k, is_more)
            };
            if !is_more {
                break;
            }
            count += 1;
        }
        let (mut has_on, mut has_off) = (false, false);
        let mut time = 0;
        for (k, event) in (0..count).zip(events) {
            let told = event.time.wrapping_sub(leaf.base);
            let low = &mut self.learned.low;
            let scans = (self.clock.shape.scans.as_ref(), place);
            let within = (leaf.base, leaf.shift);
            time = low.code(self.coder, (k, count), scans, within, told, time);
            let all = (near, scene);
            let on = self.polarity::<FULL>(leaf, (k, time), all, own, event.is_on());
            has_on |= on;
            has_off |= !on;
            if !C::ENCODES {
                *event = TreeEvent::new(leaf.base + time, place, on);
            }
        }
        (count as usize, has_on, has_off)
    }

    /// Codes the polarity of event number `k` of a leaf.
    #[inline(always)]
    fn polarity<const FULL: bool>(
        &mut self,
        leaf: &Leaf,
        (k, time): (u32, u32),
        (near, scene): (&[Pixel; 6], &Scene),
        own: &mut Own,
        is_on: bool,
    ) -> bool {
        let now = self.clock.at(leaf.base + time);
        let since = now.wrapping_sub(own.last_time) & (NEVER - 1);
        let ago = (32 - (since >> 8).leading_zeros()).min(15);
        own.last_time = now;
        let four = [&near[W], &near[N], &near[NW], &near[NE]];
        let on: u32 = four.iter().map(|p| (p.on >> leaf.i & 1) as u32).sum();
        let off: u32 = four.iter().map(|p| (p.off >> leaf.i & 1) as u32).sum();
        let side = match on.cmp(&off) {
            core::cmp::Ordering::Greater => 2,
            core::cmp::Ordering::Less => 1,
            core::cmp::Ordering::Equal => 3 * on.min(1),
        };
        let votes: u32 = four.iter().map(|p| p.last).sum();
        let vote = votes.clamp(2, 6) - 2;
        let score = match side {
            2 => 4,
            1 => 0,
            _ => vote,
        };
        let by_leaf = |k: usize| {
            let Marks { on, off, .. } = scene.near[k].marks;
            (on.leaves >> leaf.k & 1 | (off.leaves >> leaf.k & 1) << 1) as u32
        };
        let by_time = |k: usize| {
            let View { tree, marks } = scene.near[k];
            if tree.leaves == 0 {
                return 0;
            }
            let far = (leaf.base + time).abs_diff(marks.last);
            1 + u32::from(near[k].last == 0) + 2 * (32 - (far >> 6).leading_zeros()).min(6)
        };
        let last = own.last_on;
        let lasts = four.iter().rev().fold(0, |all, p| all << 2 | p.last);
        let polarities = u32::from(own.polarities);
        let before = polarities >> 1 & 1;
        let contexts: [u32; POLARITY_ALL] = [
            last | side << 1 | vote << 3 | ago << 6,
            half_octaves(since >> 4).min(31) | (polarities & 7) << 5 | side << 8 | k.min(3) << 10,
            by_leaf(W)
                | by_leaf(N) << 2
                | by_leaf(NW) << 4
                | by_leaf(NE) << 6
                | last << 8
                | (ago >> 2) << 9,
            lasts | last << 8 | (ago >> 1) << 9,
            by_time(W) | by_time(N) << 4 | last << 8 | (ago >> 1) << 9,
            polarities | side << 8 | vote.min(3) << 10,
            last | score << 1 | ago << 4 | (u32::from(own.area) >> 5) << 8 | before << 11,
            u32::from(own.fine_area) >> 4 | score << 4 | last << 7 | (ago >> 1) << 8 | before << 11,
            own.x >> 4 & 15 | (own.y >> 4 & 15) << 4 | last << 8 | (ago >> 1) << 9,
        ];
        let sets = [
            0,
            contexts[0] & 63 | (ago >> 2) << 6,
            u32::from(own.area) >> 5 | (polarities & 3) << 3,
        ];
        let mixer = &mut self.learned.polarities;
        let on = if FULL {
            let mut at = contexts;
            for (input, at) in (0_u32..).zip(&mut at) {
                *at += input << CONTEXT_BITS;
            }
            mixer.code(self.coder, at, sets, ago, is_on)
        } else {
            let [a, b, c] = POLARITY_QUICK.map(|context| contexts[context]);
            let at = [a, (1 << CONTEXT_BITS) + b, (2 << CONTEXT_BITS) + c];
            mixer.code(self.coder, at, sets, ago, is_on)
        };
        own.last_on = u32::from(on);
        own.polarities = own.polarities << 1 | u8::from(on);
        own.interval = (32 - (since >> 4).leading_zeros()).min(15) as u8;
        let moved = |area: u8| {
            if on {
                area + ((255 - area) >> 3)
            } else {
                area - area.div_ceil(8)
            }
        };
        own.area = moved(own.area);
        own.fine_area = moved(own.fine_area);
        on
    }
}
