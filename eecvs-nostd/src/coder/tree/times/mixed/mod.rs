//! Efforts two and three: each decision by several contexts, mixed.

mod around;
mod leaf;
mod tree;

use self::around::{Own, RowTree, Scene, View, few};
use self::leaf::Leaf;
use super::{Clock, Low, Marks, Nodes, Pixel, empty, leaves_within};
use crate::coder::tree::TreeEvent;
use crate::coder::tree::mix::{Mixer, MixerMemory, MixerSizes};
use crate::coder::tree::pyramid::{Columns, Level};
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
        for x in Columns::of(level, now, y) {
            let rest = events.get_mut(done..).unwrap_or_default();
            if rest.is_empty() {
                break;
            }
            done += walk.pixel::<FULL>((x, y), rows, kept, level.width, rest);
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
                let is_of_slot =
                    |event: &&TreeEvent| event.place() == place && event.time >> shift == i;
                let of_slot = rest.iter().take_while(is_of_slot);
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
}
