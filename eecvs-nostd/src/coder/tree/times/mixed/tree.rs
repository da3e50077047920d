//! Which nodes of a tree are occupied.

use super::around::{
    FAR_W, N, NE, NW, Own, Scene, W, count, count_at, distance_class, eighths, few, half_octaves,
    pairs,
};
use super::{ALL, CONTEXT_BITS, HISTOGRAM, NODE_BITS, QUICK, Walk};
use crate::coder::tree::range::BitCoder;
use crate::coder::tree::times::{Nodes, lowest};

impl<C: BitCoder> Walk<'_, '_, C> {
    /// Codes a tree of `levels` (1 to 6), whose leaves have `shift` bits, and which begins at `base` in the window and
    /// `since` after the last event. `set` is the number of its first level.
    #[inline(always)]
    pub(super) fn tree<const FULL: bool>(
        &mut self,
        set: u32,
        scene: &Scene,
        target: Nodes,
        (levels, shift): (u32, u32),
        (since, base): (u32, u32),
        own: &Own,
    ) -> Nodes {
        let mut made = Nodes {
            inner: 2,
            leaves: 0,
        };
        let mut nodes = 1_u64;
        for level in 0..levels {
            let width = 2_u32 << level;
            let is_leaf = level + 1 == levels;
            let mask = lowest(width);
            let pick = |tree: Nodes| {
                if is_leaf {
                    tree.leaves & mask
                } else {
                    tree.inner >> (width & 63) & mask
                }
            };
            let near = scene.near.map(|view| pick(view.tree));
            let row = (pick(scene.row.one), pick(scene.row.two));
            let above = pick(scene.above.one);
            let target = pick(target);
            let few_near = few(near);
            let few_on = few(scene.near.map(|view| pick(view.marks.on)));
            let few_off = few(scene.near.map(|view| pick(view.marks.off)));
            let six = count(near);
            let four = count([near[W], near[N], near[NW], near[NE], 0, 0]);
            // A slot of this level has 2^slot time units.
            let slot = shift + levels - 1 - level;
            let silence = since >> slot;
            let index = (set + level).min(11);
            let mut kids = 0_u64;
            let all = nodes;
            while nodes != 0 {
                let node = nodes.trailing_zeros();
                let i = 2 * node;
                nodes &= nodes - 1;
                // Slots since the pixel's last event so far.
                let before = kids & lowest(i);
                let distance = if before != 0 {
                    i - (63 - before.leading_zeros())
                } else {
                    silence.saturating_add(i + 1)
                };
                let near4 = pairs(few_near, i);
                let rows = pairs(row, i);
                let class = distance_class(distance);
                let early = class.min(3);
                // The pixel's next node of the level above.
                let later = (all >> node) >> 1;
                let next = match later {
                    0 => 0,
                    _ => (1 + later.trailing_zeros()).min(3),
                };
                let (sa, sb) = (count_at(&six, i).min(4), count_at(&six, i + 1).min(4));
                let (fa, fb) = (count_at(&four, i).min(3), count_at(&four, i + 1).min(3));
                let beside = if i == 0 {
                    0
                } else {
                    count_at(&six, i - 1).min(3)
                };
                let after = if i + 2 < width {
                    count_at(&six, i + 2).min(3)
                } else {
                    0
                };
                let each = |k: usize| (near[k] >> i & 3) as u32;
                let units = (u64::from(distance) << slot).min(1 << 30) as u32;
                let interval = u32::from(own.interval) & 15;
                // How much more often the second half was occupied so far in the window than the first.
                let heap = if set == 0 {
                    0
                } else {
                    128 + ((base >> (shift + levels)) << 6)
                };
                let heap = (heap + (2 << level) + i) as usize & (HISTOGRAM - 2);
                let often =
                    |half: usize| eighths(4 * u32::from(self.learned.histogram[heap + half]) + 3);
                let drift = ((often(0) - often(1) + 2) >> 2).clamp(-5, 5) + 5;
                let drift = drift as u32;
                // On which side of the boundary between the halves the next event is expected.
                let middle = (base + ((i + 1) << slot)) as i32;
                let off_by = match scene.expected {
                    (_, 0) => 0,
                    (time, _) => ((time - middle) >> (slot.max(1) - 1)).clamp(-8, 7) + 8,
                } as u32;
                let sides = pairs(few_on, i) | pairs(few_off, i) << 4;
                let parents = (all << 2 >> node & 3) as u32 | ((later & 3) as u32) << 2;
                let any = near4 & 3;
                let contexts: [u32; ALL] = [
                    near4 | (rows & 3) << 4 | class << 6,
                    half_octaves(distance).min(31) | next << 5 | own.last_on << 7 | any << 8,
                    fa | fb << 2 | drift << 4 | rows << 8,
                    sa * 5 + sb + 25 * (beside + 4 * after),
                    each(W) | each(N) << 2 | each(NW) << 4 | each(NE) << 6 | early << 8,
                    half_octaves(units >> 2).min(63) | interval << 6 | next << 10,
                    rows | each(W) << 4 | each(N) << 6 | each(FAR_W) << 8 | early << 10,
                    (sa * 5 + sb) | class << 5 | next.min(2) << 9,
                    sides | own.last_on << 8 | early << 9,
                    off_by | scene.expected.1 << 4 | any << 7 | early << 9,
                    heap as u32 & 63 | any << 6 | own.last_on << 8,
                    parents | class << 4 | own.last_on << 8 | any << 9,
                    (above << 1 >> i & 15) as u32
                        | (rows & 3) << 4
                        | each(W) << 6
                        | each(N) << 8
                        | early << 10,
                    (row.0 << 1 >> i & 15) as u32
                        | ((row.1 << 1 >> i & 15) as u32) << 4
                        | each(W) << 8
                        | any << 10,
                ];
                let mut halves = [false, true];
                for half in 0..2_u32 {
                    if half == 1 && !halves[0] {
                        break;
                    }
                    let kind = index * 2 + half;
                    let at = kind << CONTEXT_BITS;
                    let by_near = kind * 16 + near4;
                    let by_rows = kind << 6 | early << 4 | (drift / 3) << 2 | rows & 3;
                    let sets = [kind, by_near, by_rows];
                    let want = target >> (i + half) & 1 == 1;
                    let mixer = &mut self.learned.nodes;
                    halves[half as usize & 1] = if FULL {
                        let mut contexts = contexts;
                        for (input, context) in (0_u32..).zip(&mut contexts) {
                            *context += (input << NODE_BITS) + at;
                        }
                        mixer.code(self.coder, contexts, sets, by_near, want)
                    } else {
                        let [a, b, c] = QUICK.map(|context| contexts[context] + at);
                        let at = [a, (1 << NODE_BITS) + b, (2 << NODE_BITS) + c];
                        mixer.code(self.coder, at, sets, by_near, want)
                    };
                }
                for (count, half) in self.learned.histogram[heap..].iter_mut().zip(halves) {
                    *count = count.saturating_add(u16::from(half));
                }
                kids |= (u64::from(halves[0]) | u64::from(halves[1]) << 1) << i;
            }
            if is_leaf {
                made.leaves = kids;
            } else {
                made.inner |= kids << (width & 63);
            }
            nodes = kids;
        }
        made
    }
}
