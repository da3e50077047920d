//! What is around a tree, and the classes of its contexts.

use crate::coder::tree::TreeEvent;
use crate::coder::tree::times::{Marks, Nodes};

/// Trees of a row: nodes that one pixel or more has occupied, and two or more.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RowTree {
    pub(super) one: Nodes,
    pub(super) two: Nodes,
}

impl RowTree {
    #[inline(always)]
    pub(super) fn add(&mut self, tree: Nodes) {
        self.two.add(self.one.and(tree));
        self.one.add(tree);
    }
}

impl Marks {
    #[inline(always)]
    pub(super) fn of((on, off): (u64, u64), levels: u32, events: &[TreeEvent]) -> Self {
        Self {
            on: Nodes::of(on, levels),
            off: Nodes::of(off, levels),
            first: events.first().map_or(0, |event| event.time),
            last: events.last().map_or(0, |event| event.time),
        }
    }
}

/// A neighbour's tree.
#[derive(Clone, Copy, Default)]
pub(super) struct View {
    pub(super) tree: Nodes,
    pub(super) marks: Marks,
}

/// What is around a tree.
#[derive(Clone, Copy, Default)]
pub(super) struct Scene {
    /// West, north, north-west, north-east, far west, far north.
    pub(super) near: [View; 6],
    /// The row so far, and the whole row above.
    pub(super) row: RowTree,
    pub(super) above: RowTree,
    /// Where the next event is expected, from the window's start, and by which of seven rules; 0 nowhere.
    pub(super) expected: (i32, u32),
}

/// Number of each pixel around, in [`Scene::near`].
pub(super) const W: usize = 0;
pub(super) const N: usize = 1;
pub(super) const NW: usize = 2;
pub(super) const NE: usize = 3;
pub(super) const FAR_W: usize = 4;
pub(super) const FAR_N: usize = 5;

impl Scene {
    /// Expects an event on the plane or line through the first events around, or beside one of them.
    #[inline(always)]
    pub(super) fn expect(&mut self) {
        let time = |k: usize| self.near[k].marks.first as i32;
        let has = |k: usize| self.near[k].tree.leaves != 0;
        self.expected = if has(W) && has(N) && has(NW) {
            (time(W) + time(N) - time(NW), 1)
        } else if has(W) && has(FAR_W) {
            (2 * time(W) - time(FAR_W), 2)
        } else if has(N) && has(FAR_N) {
            (2 * time(N) - time(FAR_N), 3)
        } else if has(W) {
            (time(W), 4)
        } else if has(N) {
            (time(N), 5)
        } else if has(NE) {
            (time(NE), 6)
        } else if has(NW) {
            (time(NW), 7)
        } else {
            (0, 0)
        };
    }
}

/// What is known of the pixel itself.
#[derive(Clone, Copy, Default)]
pub(super) struct Own {
    pub(super) last_on: u32,
    pub(super) last_time: u32,
    /// Class of its last interval, 0 to 15.
    pub(super) interval: u8,
    /// Its last eight polarities, the last one as bit 0.
    pub(super) polarities: u8,
    pub(super) area: u8,
    pub(super) fine_area: u8,
    pub(super) x: u32,
    pub(super) y: u32,
}

/// Class of a distance in slots, 0 to 10.
#[inline(always)]
pub(super) const fn distance_class(slots: u32) -> u32 {
    const SMALL: [u8; 16] = [0, 1, 2, 3, 4, 4, 5, 5, 6, 6, 6, 6, 7, 7, 7, 7];
    if slots < 16 {
        SMALL[slots as usize] as u32
    } else {
        let class = 35 - slots.leading_zeros();
        if class < 10 { class } else { 10 }
    }
}

/// Half octaves of a number from 1 on: 0 for 1, at most 63.
#[inline(always)]
pub(super) fn half_octaves(number: u32) -> u32 {
    let number = u64::from(number.max(1));
    63 - (number * number).leading_zeros()
}

/// Eighths of octaves of a number from 1 on, between which it is linear.
#[inline(always)]
pub(super) fn eighths(number: u32) -> i32 {
    let number = number.max(1);
    let octave = 31 - number.leading_zeros();
    let part = if octave >= 3 {
        number >> (octave - 3) & 7
    } else {
        number << (3 - octave) & 7
    };
    (8 * octave + part) as i32
}

/// For each node, in how many of six trees it is occupied: the three bits of the number.
#[inline(always)]
pub(super) const fn count(trees: [u64; 6]) -> [u64; 3] {
    const fn add(a: u64, b: u64, c: u64) -> (u64, u64) {
        (a ^ b ^ c, a & b | c & (a ^ b))
    }
    let (ones_a, twos_a) = add(trees[0], trees[1], trees[2]);
    let (ones_b, twos_b) = add(trees[3], trees[4], trees[5]);
    let (ones, twos_c) = (ones_a ^ ones_b, ones_a & ones_b);
    let (twos, fours) = add(twos_a, twos_b, twos_c);
    [ones, twos, fours]
}

/// The number of node i.
#[inline(always)]
pub(super) const fn count_at(counts: &[u64; 3], i: u32) -> u32 {
    (counts[0] >> i & 1 | (counts[1] >> i & 1) << 1 | (counts[2] >> i & 1) << 2) as u32
}

/// For each node, whether one or more and whether two or more of four trees have it occupied; a fourth counts as two.
#[inline(always)]
pub(super) const fn few([w, n, nw, ne, ..]: [u64; 6]) -> (u64, u64) {
    let (a, b) = (w | n, w & n);
    let (c, d) = (nw | ne, nw & ne);
    (a | c, b | d | a & c)
}

/// Bits i and i + 1 of two words: those of the first, then of the second.
#[inline(always)]
pub(super) const fn pairs((one, two): (u64, u64), i: u32) -> u32 {
    (one >> i & 3 | (two >> i & 3) << 2) as u32
}
