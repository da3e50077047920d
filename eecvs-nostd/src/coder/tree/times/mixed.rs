//! Efforts two and three: each decision by several contexts, mixed.

use super::{Clock, Low, Marks, Nodes, Pixel, empty, leaves_within, lowest};
use crate::coder::tree::TreeEvent;
use crate::coder::tree::mix::{Mixer, MixerMemory, MixerSizes};
use crate::coder::tree::pyramid::{Level, MARGIN_BYTES, word_at};
use crate::coder::tree::range::BitCoder;

/// Bits of a context of a tree's node, and of its level and half above.
const CONTEXT_BITS: u32 = 12;
const NODE_BITS: u32 = CONTEXT_BITS + 5;
/// Contexts of a node with effort two and three.
const QUICK: [usize; 3] = [12, 5, 2];
const ALL: usize = 14;
/// Contexts of a polarity.
const POLARITY_QUICK: [usize; 3] = [1, 3, 6];
const POLARITY_ALL: usize = 9;
/// Contexts of whether a leaf has a further event.
const MORE_QUICK: usize = 3;
const MORE_ALL: usize = 4;

/// Number of slots that are counted: of first trees, then of second ones.
pub(super) const HISTOGRAM: usize = 1 << 13;

/// Levels of the first tree.
const SECOND: u32 = 6;
/// Time since the last event where there was none; a time that is kept has as many bits and one more.
const NEVER: u32 = 1 << 30;

/// What the mixers need: of nodes, of further events, of polarities.
pub(super) const fn sizes(is_full: bool) -> [MixerSizes; 3] {
    const fn inputs(is_full: bool, quick: usize, all: usize) -> usize {
        if is_full { all } else { quick }
    }
    [
        MixerSizes {
            counters: inputs(is_full, QUICK.len(), ALL) << NODE_BITS,
            weights: [32, 512, 2048],
            curves: 512,
        },
        MixerSizes {
            counters: inputs(is_full, MORE_QUICK, MORE_ALL) << CONTEXT_BITS,
            weights: [8, 128, 64],
            curves: 8,
        },
        MixerSizes {
            counters: inputs(is_full, POLARITY_QUICK.len(), POLARITY_ALL) << CONTEXT_BITS,
            weights: [1, 256, 256],
            curves: 16,
        },
    ]
}

/// What is learned.
#[derive(Debug)]
pub(crate) struct Learned<'m> {
    nodes: Mixer<'m>,
    more: Mixer<'m>,
    polarities: Mixer<'m>,
    low: Low<'m>,
    /// How often each node was occupied so far in this window.
    histogram: &'m mut [u16; HISTOGRAM],
}

impl<'m> Learned<'m> {
    /// Takes its memory from the start of what is given.
    pub(crate) fn new(
        memory: &mut MixerMemory<'m>,
        halves: &mut &'m mut [u16],
        is_full: bool,
    ) -> Option<Self> {
        let [nodes, more, polarities] = sizes(is_full);
        Some(Self {
            nodes: memory.mixer(&nodes, 120)?,
            more: memory.mixer(&more, 100)?,
            polarities: memory.mixer(&polarities, 60)?,
            low: Low::new(&mut memory.counters)?,
            histogram: halves.split_off_mut(..HISTOGRAM)?.as_mut_array()?,
        })
    }

    pub(crate) fn restart(&mut self) {
        self.nodes.restart();
        self.more.restart();
        self.polarities.restart();
        self.low.restart();
    }
}

/// What is kept of pixels.
#[derive(Debug)]
pub(crate) struct Kept<'m> {
    /// Three rows, all empty between windows: column x is at x + 2.
    pub(crate) pixels: [&'m mut [Pixel]; 3],
    /// What is beside them.
    pub(crate) marks: [&'m mut [Marks]; 3],
    /// Second trees of the rows, and what is beside them.
    pub(crate) seconds: [&'m mut [Nodes]; 3],
    pub(crate) second_marks: [&'m mut [Marks]; 3],
    /// Last event of each pixel: its time, above its polarity; 0 never.
    pub(crate) lasts: &'m mut [u32],
    /// Class of each pixel's last interval, and its last eight polarities.
    pub(crate) intervals: &'m mut [u8],
    pub(crate) polarities: &'m mut [u8],
    /// How often the last events of each 8 x 8 and 4 x 4 pixels were ON, 0 to 255.
    pub(crate) areas: &'m mut [u8],
    pub(crate) fine_areas: &'m mut [u8],
}

/// Trees of a row: nodes that one pixel or more has occupied, and two or more.
#[derive(Debug, Clone, Copy, Default)]
struct RowTree {
    one: Nodes,
    two: Nodes,
}

impl RowTree {
    #[inline(always)]
    fn add(&mut self, tree: Nodes) {
        self.two.add(self.one.and(tree));
        self.one.add(tree);
    }
}

impl Marks {
    #[inline(always)]
    fn of((on, off): (u64, u64), levels: u32, events: &[TreeEvent]) -> Self {
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
struct View {
    tree: Nodes,
    marks: Marks,
}

/// What is around a tree.
#[derive(Clone, Copy, Default)]
struct Scene {
    /// West, north, north-west, north-east, far west, far north.
    near: [View; 6],
    /// The row so far, and the whole row above.
    row: RowTree,
    above: RowTree,
    /// Where the next event is expected, from the window's start, and by which of seven rules; 0 nowhere.
    expected: (i32, u32),
}

/// Number of each pixel around, in [`Scene::near`].
const W: usize = 0;
const N: usize = 1;
const NW: usize = 2;
const NE: usize = 3;
const FAR_W: usize = 4;
const FAR_N: usize = 5;

impl Scene {
    /// Expects an event on the plane or line through the first events around, or beside one of them.
    #[inline(always)]
    fn expect(&mut self) {
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
struct Own {
    last_on: u32,
    last_time: u32,
    /// Class of its last interval, 0 to 15.
    interval: u8,
    /// Its last eight polarities, the last one as bit 0.
    polarities: u8,
    area: u8,
    fine_area: u8,
    x: u32,
    y: u32,
}

/// Class of a distance in slots, 0 to 10.
#[inline(always)]
const fn distance_class(slots: u32) -> u32 {
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
fn half_octaves(number: u32) -> u32 {
    let number = u64::from(number.max(1));
    63 - (number * number).leading_zeros()
}

/// Eighths of octaves of a number from 1 on, between which it is linear.
#[inline(always)]
fn eighths(number: u32) -> i32 {
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
const fn count(trees: [u64; 6]) -> [u64; 3] {
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
const fn count_at(counts: &[u64; 3], i: u32) -> u32 {
    (counts[0] >> i & 1 | (counts[1] >> i & 1) << 1 | (counts[2] >> i & 1) << 2) as u32
}

/// For each node, whether one or more and whether two or more of four trees have it occupied; a fourth counts as two.
#[inline(always)]
const fn few([w, n, nw, ne, ..]: [u64; 6]) -> (u64, u64) {
    let (a, b) = (w | n, w & n);
    let (c, d) = (nw | ne, nw & ne);
    (a | c, b | d | a & c)
}

/// Bits i and i + 1 of two words: those of the first, then of the second.
#[inline(always)]
const fn pairs((one, two): (u64, u64), i: u32) -> u32 {
    (one >> i & 3 | (two >> i & 3) << 2) as u32
}

/// A leaf of the last tree.
struct Leaf {
    /// Number of its leaf of the first tree, and of the last one.
    i: u32,
    k: u32,
    base: u32,
    shift: u32,
    /// How many of four neighbours have events in it, up to 2, and whether the leaf before has some.
    near: u32,
    has_before: bool,
}

/// State of the walk through a window's pixels.
struct Walk<'w, 'm, C> {
    coder: &'w mut C,
    learned: &'w mut Learned<'m>,
    clock: Clock,
    row: RowTree,
    above: RowTree,
    row_seconds: [RowTree; 64],
    above_seconds: [RowTree; 64],
    /// Leaves whose second tree is set in these.
    row_is_set: u64,
    above_is_set: u64,
    /// Number of second trees of the row.
    seconds: usize,
}

/// As [`super::single::code`]; with `FULL`, effort three.
#[inline(never)]
pub(crate) fn code<C: BitCoder, const FULL: bool>(
    coder: &mut C,
    learned: &mut Learned<'_>,
    kept: &mut Kept<'_>,
    (level, now): (&Level, &[u8]),
    clock: Clock,
    events: &mut [TreeEvent],
) -> usize {
    learned.histogram.fill(0);
    let mut walk = Walk {
        coder,
        learned,
        clock,
        row: RowTree::default(),
        above: RowTree::default(),
        row_seconds: [RowTree::default(); 64],
        above_seconds: [RowTree::default(); 64],
        row_is_set: 0,
        above_is_set: 0,
        seconds: 0,
    };
    let mut done = 0;
    for y in 0..level.height {
        let rows = [0, 2, 1].map(|by| ((y + by) % 3) as usize);
        let begin = level.row(y as i32) + MARGIN_BYTES;
        for j in 0..level.words() {
            let mut todo = word_at(now, begin + 8 * j);
            while todo != 0 {
                let x = 64 * j as u32 + todo.trailing_zeros();
                todo &= todo - 1;
                let rest = events.get_mut(done..).unwrap_or_default();
                if rest.is_empty() {
                    break;
                }
                done += walk.pixel::<FULL>((x, y), rows, kept, level.width, rest);
            }
        }
        walk.end_row();
        // The row two above becomes the next one.
        let [.., far] = rows;
        empty_row(level, now, y.wrapping_sub(2), kept, far);
    }
    for y in level.height.saturating_sub(2)..level.height {
        empty_row(level, now, y, kept, (y % 3) as usize);
    }
    done
}

/// Empties a row, and what is beside its pixels.
#[inline(always)]
fn empty_row(level: &Level, now: &[u8], y: u32, kept: &mut Kept<'_>, row: usize) {
    if let (Some(pixels), Some(marks)) = (kept.pixels.get_mut(row), kept.marks.get_mut(row)) {
        empty(level, now, y, pixels, Pixel::NONE);
        empty(level, now, y, marks, Marks::default());
    }
}

impl<C: BitCoder> Walk<'_, '_, C> {
    fn end_row(&mut self) {
        self.above = self.row;
        self.row = RowTree::default();
        if self.clock.shape.second > 0 {
            core::mem::swap(&mut self.above_seconds, &mut self.row_seconds);
            self.above_is_set = self.row_is_set;
        }
        self.row_is_set = 0;
        self.seconds = 0;
    }

    /// Codes a pixel's events, at the start of `events`, and returns how many there are. `rows` are the numbers of the
    /// row and the two above.
    #[inline(always)]
    fn pixel<const FULL: bool>(
        &mut self,
        (x, y): (u32, u32),
        rows: [usize; 3],
        kept: &mut Kept<'_>,
        width: u32,
        events: &mut [TreeEvent],
    ) -> usize {
        let [here, north, far] = rows;
        let at = x as usize + 2;
        let pixel = |row: usize, at: usize| {
            let row = kept.pixels.get(row);
            row.and_then(|row| row.get(at))
                .copied()
                .unwrap_or(Pixel::NONE)
        };
        let near_at = [
            (here, at - 1),
            (north, at),
            (north, at - 1),
            (north, at + 1),
            (here, at - 2),
            (far, at),
        ];
        let near = near_at.map(|(row, at)| pixel(row, at));
        let mut scene = Scene {
            row: self.row,
            above: self.above,
            ..Scene::default()
        };
        for ((view, pixel), (row, at)) in scene.near.iter_mut().zip(&near).zip(near_at) {
            let marks = kept.marks.get(row).and_then(|row| row.get(at));
            *view = View {
                tree: pixel.nodes(),
                marks: marks.copied().unwrap_or_default(),
            };
        }
        scene.expect();
        let place = TreeEvent::place_of(x, y);
        let clock = self.clock;
        let (shape, start) = (clock.shape, clock.at(0));
        let shift = shape.bits - shape.first;
        let mut target = Nodes::NONE;
        if C::ENCODES {
            target = Nodes::of(
                leaves_within(events, place, shift, shape.first),
                shape.first,
            );
        }
        let index = (y * width + x) as usize;
        let area = ((y >> 3) * width.div_ceil(8) + (x >> 3)) as usize;
        let fine_area = ((y >> 2) * width.div_ceil(4) + (x >> 2)) as usize;
        let byte = |bytes: &[u8], at: usize| bytes.get(at).copied().unwrap_or(0);
        let last = kept.lasts.get(index).copied().unwrap_or(0);
        let since = if last == 0 {
            NEVER
        } else {
            start.wrapping_sub(last >> 1) & (NEVER - 1)
        };
        let mut own = Own {
            last_on: last & 1,
            last_time: start.wrapping_sub(since),
            interval: byte(kept.intervals, index),
            polarities: byte(kept.polarities, index),
            area: byte(kept.areas, area),
            fine_area: byte(kept.fine_areas, fine_area),
            x,
            y,
        };
        let around = few(scene.near.map(|view| view.tree.leaves));
        let levels = (shape.first, shift);
        let from = (clock.units(since), 0);
        let tree = self.tree::<FULL>(0, &scene, target, levels, from, &own);
        self.row.add(tree);
        let mut made = Pixel {
            inner: tree.inner,
            seconds: self.seconds as u32,
            ..Pixel::NONE
        };
        let mut done = 0;
        let mut slots = tree.leaves;
        while slots != 0 {
            let i = slots.trailing_zeros();
            slots &= slots - 1;
            let bit = 1_u64 << i;
            let base = i << shift;
            let rest = events.get_mut(done..).unwrap_or_default();
            if rest.is_empty() {
                break;
            }
            if shape.second == 0 {
                let leaf = Leaf {
                    i,
                    k: i,
                    base,
                    shift,
                    near: (around.0 >> i & 1) as u32 + (around.1 >> i & 1) as u32,
                    has_before: tree.leaves & (bit >> 1) != 0,
                };
                let all = (&near, &scene);
                let (count, on, off) = self.leaf::<FULL>(&leaf, place, all, &mut own, rest);
                made.on |= u64::from(on) << i;
                made.off |= u64::from(off) << i;
                done += count;
                continue;
            }
            let mut inside = Scene::default();
            for ((view, pixel), (row, _)) in inside.near.iter_mut().zip(&near).zip(near_at) {
                if pixel.leaves() & bit != 0 {
                    let at = pixel.second(bit);
                    let tree = kept.seconds.get(row).and_then(|row| row.get(at));
                    let marks = kept.second_marks.get(row).and_then(|row| row.get(at));
                    *view = View {
                        tree: tree.copied().unwrap_or_default(),
                        marks: marks.copied().unwrap_or_default(),
                    };
                }
            }
            let row_second = &mut self.row_seconds[i as usize & 63];
            if self.row_is_set & bit == 0 {
                *row_second = RowTree::default();
                self.row_is_set |= bit;
            }
            inside.row = *row_second;
            if self.above_is_set & bit != 0 {
                inside.above = self.above_seconds[i as usize & 63];
            }
            inside.expect();
            let around = few(inside.near.map(|view| view.tree.leaves));
            let leaf_bits = shape.leaf_bits();
            let mut target = Nodes::NONE;
            if C::ENCODES {
                let of_slot = rest.iter().take_while(|event| event.time >> shift == i);
                let of_slot = of_slot.count();
                let events = rest.get(..of_slot).unwrap_or_default();
                let leaves = leaves_within(events, place, leaf_bits, shape.second);
                target = Nodes::of(leaves, shape.second);
            }
            let since = clock.at(base).wrapping_sub(own.last_time) & (2 * NEVER - 1);
            let since = clock.units(since);
            let levels = (shape.second, leaf_bits);
            let tree = self.tree::<FULL>(SECOND, &inside, target, levels, (since, base), &own);
            self.row_seconds[i as usize & 63].add(tree);
            if let Some(place) = kept.seconds[here].get_mut(self.seconds) {
                *place = tree;
            }
            let first = done;
            let (mut second_on, mut second_off) = (0, 0);
            let mut leaves = tree.leaves;
            while leaves != 0 {
                let k = leaves.trailing_zeros();
                leaves &= leaves - 1;
                let rest = events.get_mut(done..).unwrap_or_default();
                if rest.is_empty() {
                    break;
                }
                let leaf = Leaf {
                    i,
                    k,
                    base: base + (k << leaf_bits),
                    shift: leaf_bits,
                    near: (around.0 >> k & 1) as u32 + (around.1 >> k & 1) as u32,
                    has_before: tree.leaves & (1 << k >> 1) != 0,
                };
                let all = (&near, &inside);
                let (count, on, off) = self.leaf::<FULL>(&leaf, place, all, &mut own, rest);
                made.on |= u64::from(on) << i;
                made.off |= u64::from(off) << i;
                second_on |= u64::from(on) << k;
                second_off |= u64::from(off) << k;
                done += count;
            }
            if let Some(place) = kept.second_marks[here].get_mut(self.seconds) {
                let events = events.get(first..done).unwrap_or_default();
                *place = Marks::of((second_on, second_off), shape.second, events);
            }
            self.seconds += 1;
        }
        let events = events.get(..done).unwrap_or_default();
        let last = events.last().copied().unwrap_or_default();
        made.last = 2 * u32::from(last.is_on());
        if let Some(place) = kept.lasts.get_mut(index) {
            *place = clock.at(last.time) << 1 | u32::from(last.is_on());
        }
        let set = |bytes: &mut [u8], at: usize, byte: u8| {
            if let Some(place) = bytes.get_mut(at) {
                *place = byte;
            }
        };
        set(kept.intervals, index, own.interval);
        set(kept.polarities, index, own.polarities);
        set(kept.areas, area, own.area);
        set(kept.fine_areas, fine_area, own.fine_area);
        if let Some(place) = kept.marks[here].get_mut(at) {
            *place = Marks::of((made.on, made.off), shape.first, events);
        }
        if let Some(place) = kept.pixels[here].get_mut(at) {
            *place = made;
        }
        done
    }

    /// Codes a tree of `levels` (1 to 6), whose leaves have `shift` bits, and which begins at `base` in the window and
    /// `since` after the last event. `set` is the number of its first level.
    #[inline(always)]
    fn tree<const FULL: bool>(
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

    /// Codes the events of a leaf, at least one; returns how many, and whether ON and OFF ones.
    #[inline(always)]
    fn leaf<const FULL: bool>(
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
