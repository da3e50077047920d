//! Effort one: each decision by one context, and polarities by the mean of two.

use super::{Clock, Low, Nodes, Pixel, empty, leaves_within, lowest};
use crate::coder::tree::counter::Counter;
use crate::coder::tree::memory::fetch;
use crate::coder::tree::pyramid::{Columns, Level};
use crate::coder::tree::range::{BitCoder, EVEN_P16};
use crate::coder::tree::{Shape, TreeEvent};

/// Contexts of a level and half.
const CONTEXTS: usize = 1 << 10;
/// Levels, of which 12 are in use: those of the first tree, then of the second one from [`SECOND`] on.
const LEVELS: usize = 16;
const SECOND: usize = 6;
const NODES: usize = LEVELS * 2 * CONTEXTS;

/// Number of counters.
pub(super) const COUNTERS: usize = NODES + 64 + 1024 + 2048 + Low::COUNTERS;

/// Limit of the counters of polarities.
const POLARITY_LIMIT: u32 = 30;

/// Bits of a time that is kept, above the polarities.
const TIME_MASK: u32 = (1 << 28) - 1;
const POLARITIES: u32 = 4;
/// Time since the last event where there was none.
const NEVER: u32 = 1 << 27;

/// What is learned.
#[derive(Debug)]
pub(crate) struct Learned<'m> {
    /// By level, half and context.
    nodes: &'m mut [Counter; NODES],
    /// Whether a leaf has a further event.
    more: &'m mut [Counter; 64],
    /// Polarity by the sides around, and by the history.
    sides: &'m mut [Counter; 1024],
    history: &'m mut [Counter; 2048],
    low: Low<'m>,
}

impl<'m> Learned<'m> {
    /// Takes its counters from the start of `counters`.
    pub(crate) fn new(counters: &mut &'m mut [Counter]) -> Option<Self> {
        Some(Self {
            nodes: counters.split_off_mut(..NODES)?.as_mut_array()?,
            more: counters.split_off_mut(..64)?.as_mut_array()?,
            sides: counters.split_off_mut(..1024)?.as_mut_array()?,
            history: counters.split_off_mut(..2048)?.as_mut_array()?,
            low: Low::new(counters)?,
        })
    }

    pub(crate) fn restart(&mut self) {
        self.nodes.fill(Counter::EVEN);
        self.more.fill(Counter::EVEN);
        self.sides.fill(Counter::EVEN);
        self.history.fill(Counter::EVEN);
        self.low.restart();
    }
}

/// What is kept of pixels.
#[derive(Debug)]
pub(crate) struct Kept<'m> {
    /// Two rows, all empty between windows: column x is at x + 2.
    pub(crate) pixels: [&'m mut [Pixel]; 2],
    /// Second trees of the rows.
    pub(crate) seconds: [&'m mut [Nodes]; 2],
    /// Last event of each pixel: its time, above its last four polarities; 0 never. Empty without history.
    pub(crate) lasts: &'m mut [u32],
    /// How often the last events of each 8 x 8 pixels were ON, 0 to 255.
    pub(crate) areas: &'m mut [u8],
}

/// The same nodes of four trees around: west, north, both further norths, and all of the row so far.
struct Around {
    inner: [u64; 4],
    leaves: [u64; 4],
}

/// Context of the two halves of a node: `at` is the bit of the first one, `own` what the pixel's own tree says.
#[inline(always)]
const fn context([west, north, corners, row]: [u64; 4], at: u32, own: u64) -> usize {
    (west >> at & 3
        | (north >> at & 3) << 2
        | (corners >> at & 3) << 4
        | (row >> at & 3) << 6
        | own << 8) as usize
}

/// Codes which halves of a node are occupied, at least one of them.
#[inline(always)]
fn code_halves<C: BitCoder>(
    coder: &mut C,
    nodes: &mut [Counter; NODES],
    at: usize,
    want: u64,
) -> u64 {
    let at = at & (NODES - 1);
    if nodes[at].code(coder, want & 1 != 0) {
        let at = (at + CONTEXTS) & (NODES - 1);
        1 | u64::from(nodes[at].code(coder, want & 2 != 0)) << 1
    } else {
        2
    }
}

/// Codes a tree of `levels` (1 to 6), whose leaves have `shift` bits, and which begins `since` after the last event.
#[inline(always)]
fn code_tree<C: BitCoder>(
    coder: &mut C,
    nodes: &mut [Counter; NODES],
    first_level: usize,
    around: &Around,
    target: Nodes,
    (levels, shift): (u32, u32),
    since: u32,
) -> Nodes {
    let mut inner = 2_u64;
    let mut slot_bits = shift + levels;
    let mut base = first_level * 2 * CONTEXTS;
    // What stands for the half before in a level's first node: whether the last event was within a slot, or two.
    let silence = |slot_bits: u32| u64::from(2_u32 >> (since >> (slot_bits & 31)).min(31));
    // First node of the level, and while there is a single one, that one.
    let mut first = 1_u32;
    let mut only = 1_u32;
    let last = 1_u32 << (levels - 1);
    while first < last {
        slot_bits -= 1;
        let at = 2 * only;
        let own = if only == first { silence(slot_bits) } else { 0 };
        let context = base + context(around.inner, at & 63, own);
        let halves = code_halves(coder, nodes, context, target.inner >> (at & 63));
        inner |= halves << (at & 63);
        base += 2 * CONTEXTS;
        first *= 2;
        if halves == 3 {
            break;
        }
        only = at | (halves >> 1) as u32;
    }
    while first < last {
        slot_bits -= 1;
        let mut todo = inner & lowest(first) << first;
        let mut own = silence(slot_bits);
        while todo != 0 {
            let at = 2 * todo.trailing_zeros();
            todo &= todo - 1;
            if at > 2 * first {
                own = inner >> ((at - 2) & 63) & 3;
            }
            let context = base + context(around.inner, at & 63, own);
            let halves = code_halves(coder, nodes, context, target.inner >> (at & 63));
            inner |= halves << (at & 63);
        }
        base += 2 * CONTEXTS;
        first *= 2;
    }
    slot_bits -= 1;
    let mut todo = inner >> (first & 63) & lowest(first);
    let mut own = silence(slot_bits);
    let mut leaves = 0_u64;
    while todo != 0 {
        let at = 2 * todo.trailing_zeros();
        todo &= todo - 1;
        if at > 0 {
            own = leaves >> ((at - 2) & 63) & 3;
        }
        let context = base + context(around.leaves, at & 63, own);
        let halves = code_halves(coder, nodes, context, target.leaves >> (at & 63));
        leaves |= halves << (at & 63);
    }
    Nodes { inner, leaves }
}

/// Class of a time since the last event.
#[inline(always)]
const fn ago(units: u32) -> u32 {
    let class = 32 - (units >> 8).leading_zeros();
    if class < 15 { class } else { 15 }
}

/// What is known of the pixel itself.
struct Own {
    last_time: u32,
    /// Its last four polarities, the last one as bit 0.
    polarities: u32,
    /// How often events of its area were ON.
    area: u32,
}

/// Polarities around a pixel: leaves with ON, with OFF events, and the vote of the last ones, 0 (OFF) to 4 (ON).
struct Near {
    on: u64,
    off: u64,
    vote: u32,
}

/// Vote by the sum of four pixels' [`Pixel::last`].
const VOTES: [u8; 16] = [0, 0, 0, 1, 2, 3, 4, 4, 4, 0, 0, 0, 0, 0, 0, 0];

/// By the side of a leaf, ON << 1 | OFF, and the vote: a side that is clear decides.
const SCORES: [u8; 32] = {
    let mut table = [0; 32];
    let mut i = 0;
    while i < 32 {
        let (side, vote) = (i >> 3, (i & 7) as u8);
        table[i] = match side {
            2 => 4,
            1 => 0,
            _ => vote,
        };
        i += 1;
    }
    table
};

/// A leaf of the last tree.
struct Leaf {
    /// Number of its leaf of the first tree.
    i: u32,
    /// Its start from the window's, and its bits.
    base: u32,
    shift: u32,
    /// Context of whether it has a second event: whether neighbours have events in it, and the leaf before.
    context: usize,
}

/// Returns whether each leaf has one event.
fn is_single(shape: Shape, events: &[TreeEvent]) -> bool {
    let shift = shape.leaf_bits();
    events.windows(2).all(|two| match two {
        [a, b] => a.place() != b.place() || a.time >> shift != b.time >> shift,
        _ => true,
    })
}

/// A row and the one above: pixels, and second trees.
struct Rows<'r> {
    here: &'r mut [Pixel],
    north: &'r [Pixel],
    seconds: &'r mut [Nodes],
    north_seconds: &'r [Nodes],
}

/// State of the walk through a window's pixels.
struct Walk<'w, 'm, C> {
    coder: &'w mut C,
    learned: &'w mut Learned<'m>,
    clock: Clock,
    /// Each leaf has one event.
    is_single: bool,
    has_history: bool,
    /// The tree of each single leaf.
    paths: [u64; 64],
    /// What the row's pixels have so far, in the first tree and in each second one.
    row: Nodes,
    row_seconds: [Nodes; 64],
    /// Leaves whose second tree is set in [`Self::row_seconds`].
    row_is_set: u64,
    /// Number of second trees of the row.
    seconds: usize,
}

/// Codes the events of all pixels of `now`: in raster order, and in a pixel by time. Returns how many there are; stops
/// early at the end of `events`.
#[inline(never)]
pub(crate) fn code<C: BitCoder>(
    coder: &mut C,
    learned: &mut Learned<'_>,
    kept: &mut Kept<'_>,
    (level, now): (&Level, &[u8]),
    clock: Clock,
    events: &mut [TreeEvent],
) -> usize {
    let is_single = C::ENCODES && is_single(clock.shape, events);
    let is_single = coder.bit(EVEN_P16, is_single);
    let mut walk = Walk {
        coder,
        learned,
        clock,
        is_single,
        has_history: !kept.lasts.is_empty(),
        paths: [0; 64],
        row: Nodes::NONE,
        row_seconds: [Nodes::NONE; 64],
        row_is_set: 0,
        seconds: 0,
    };
    for (i, path) in walk.paths.iter_mut().enumerate() {
        *path = Nodes::of(1 << i, clock.shape.first).inner;
    }
    let area_stride = level.width.div_ceil(8);
    let mut done = 0;
    let mut is_empty = [true; 2];
    for y in 0..level.height {
        let mut columns = Columns::of(level, now, y);
        let mut next = columns.next();
        let is_any = next.is_some();
        let (ours, above) = ((y & 1) as usize, (y & 1 ^ 1) as usize);
        if is_any {
            let (here, north) = two(&mut kept.pixels, ours);
            let (seconds, north_seconds) = two(&mut kept.seconds, ours);
            walk.row = Nodes::NONE;
            walk.row_is_set = 0;
            walk.seconds = 0;
            while let Some(x) = next {
                next = columns.next();
                if let Some(x) = next {
                    fetch(kept.lasts, (y * level.width + x) as usize);
                }
                let area = ((y >> 3) * area_stride + (x >> 3)) as usize;
                let rest = events.get_mut(done..).unwrap_or_default();
                let (Some(area), false) = (kept.areas.get_mut(area), rest.is_empty()) else {
                    break;
                };
                let mut none = 0;
                let last = kept.lasts.get_mut((y * level.width + x) as usize);
                let own = (last.unwrap_or(&mut none), area);
                let rows = Rows {
                    here: &mut *here,
                    north,
                    seconds: &mut *seconds,
                    north_seconds,
                };
                done += walk.pixel((x, y), rows, own, rest);
            }
        }
        // The row above becomes the next one.
        if !is_empty[above] {
            empty(
                level,
                now,
                y.wrapping_sub(1),
                kept.pixels[above],
                Pixel::NONE,
            );
        }
        is_empty[above] = true;
        is_empty[ours] = !is_any;
    }
    let last = level.height - 1;
    for y in [last.wrapping_sub(1), last] {
        empty(level, now, y, kept.pixels[(y & 1) as usize], Pixel::NONE);
    }
    done
}

/// Returns the row to be written, and the one above.
#[inline(always)]
fn two<'r, T>([even, odd]: &'r mut [&mut [T]; 2], ours: usize) -> (&'r mut [T], &'r [T]) {
    if ours == 0 { (even, odd) } else { (odd, even) }
}

impl<C: BitCoder> Walk<'_, '_, C> {
    /// Codes a pixel's events, at the start of `events`, and returns how many there are.
    #[inline(always)]
    fn pixel(
        &mut self,
        (x, y): (u32, u32),
        rows: Rows<'_>,
        (last, area): (&mut u32, &mut u8),
        events: &mut [TreeEvent],
    ) -> usize {
        let Rows {
            here,
            north,
            seconds,
            north_seconds,
        } = rows;
        let (Some([nw, n, ne]), Some([w, own_place])) = (
            north.get(x as usize + 1..).and_then(|s| s.first_chunk()),
            here.get_mut(x as usize + 1..)
                .and_then(|s| s.first_chunk_mut()),
        ) else {
            return 0;
        };
        let place = TreeEvent::place_of(x, y);
        let clock = self.clock;
        let shape = clock.shape;
        let shift = shape.bits - shape.first;
        let mut target = Nodes::NONE;
        if C::ENCODES {
            for event in events.iter().take_while(|event| event.place() == place) {
                let leaf = event.time >> shift & 63;
                target.inner |= self.paths[leaf as usize];
                target.leaves |= 1 << leaf;
            }
        }
        let mut own = Own {
            last_time: *last >> POLARITIES,
            polarities: *last & 15,
            area: u32::from(*area),
        };
        let start = clock.at(0);
        let mut since = start.wrapping_sub(own.last_time) & TIME_MASK;
        if *last == 0 {
            since = NEVER;
            own.last_time = start.wrapping_sub(NEVER);
        }
        let since = clock.units(since);
        let row = if self.has_history {
            self.row
        } else {
            Nodes::NONE
        };
        let around = Around {
            inner: [w.inner, n.inner, nw.inner | ne.inner, row.inner],
            leaves: [
                w.leaves(),
                n.leaves(),
                nw.leaves() | ne.leaves(),
                row.leaves,
            ],
        };
        let levels = (shape.first, shift);
        let nodes = &mut *self.learned.nodes;
        let tree = code_tree(self.coder, nodes, 0, &around, target, levels, since);
        self.row.add(tree);
        let near = Near {
            on: w.on | n.on | nw.on | ne.on,
            off: w.off | n.off | nw.off | ne.off,
            vote: u32::from(VOTES[(w.last + n.last + nw.last + ne.last) as usize & 15]),
        };
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
                let is_near = (near.on | near.off) >> i & 1;
                let leaf = Leaf {
                    i,
                    base,
                    shift,
                    context: (is_near << 1 | tree.leaves << 1 >> i & 1) as usize,
                };
                let (count, on, off) = self.leaf(&leaf, place, &near, &mut own, rest);
                made.on |= on << i;
                made.off |= off << i;
                done += count;
                continue;
            }
            let find = |pixel: &Pixel, trees: &[Nodes]| {
                if pixel.leaves() & bit == 0 {
                    return Nodes::NONE;
                }
                trees.get(pixel.second(bit)).copied().unwrap_or(Nodes::NONE)
            };
            let (w, n) = (find(w, seconds), find(n, north_seconds));
            let (nw, ne) = (find(nw, north_seconds), find(ne, north_seconds));
            let row = &mut self.row_seconds[i as usize & 63];
            if self.row_is_set & bit == 0 {
                *row = Nodes::NONE;
                self.row_is_set |= bit;
            }
            let around = Around {
                inner: [w.inner, n.inner, nw.inner | ne.inner, row.inner],
                leaves: [w.leaves, n.leaves, nw.leaves | ne.leaves, row.leaves],
            };
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
            let since = clock.at(base).wrapping_sub(own.last_time) & TIME_MASK;
            let since = clock.units(since);
            let levels = (shape.second, leaf_bits);
            let nodes = &mut *self.learned.nodes;
            let tree = code_tree(self.coder, nodes, SECOND, &around, target, levels, since);
            row.add(tree);
            if let Some(place) = seconds.get_mut(self.seconds) {
                *place = tree;
            }
            self.seconds += 1;
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
                    base: base + (k << leaf_bits),
                    shift: leaf_bits,
                    context: 4 + (tree.leaves << 1 >> k & 1) as usize,
                };
                let (count, on, off) = self.leaf(&leaf, place, &near, &mut own, rest);
                made.on |= on << i;
                made.off |= off << i;
                done += count;
            }
        }
        made.last = (own.polarities & 1) << 1;
        *last = own.last_time << POLARITIES | own.polarities;
        *area = own.area as u8;
        *own_place = made;
        done
    }

    /// Codes the events of a leaf, at least one; returns how many, and whether ON and OFF ones.
    #[inline(always)]
    fn leaf(
        &mut self,
        leaf: &Leaf,
        place: u32,
        near: &Near,
        own: &mut Own,
        events: &mut [TreeEvent],
    ) -> (usize, u64, u64) {
        let mut count = 1_u32;
        while !self.is_single && (count as usize) < events.len() {
            let is_more = C::ENCODES
                && events.get(count as usize).is_some_and(|event| {
                    event.place() == place && event.time >> leaf.shift == leaf.base >> leaf.shift
                });
            let context = leaf.context << 3 | (count - 1).min(7) as usize;
            if !self.learned.more[context & 63].code(self.coder, is_more) {
                break;
            }
            count += 1;
        }
        if count > 1 {
            return self.several(leaf, place, near, own, events, count);
        }
        let Some(event) = events.first_mut() else {
            return (0, 0, 0);
        };
        let told = event.time.wrapping_sub(leaf.base);
        let time = match &self.clock.shape.scans {
            None => self.coder.raw(told, leaf.shift),
            scans => {
                let (scans, low) = (scans.as_ref(), &mut self.learned.low);
                let leaf = (leaf.base, leaf.shift);
                low.code(self.coder, (0, 1), (scans, place), leaf, told, 0)
            }
        };
        let on = self.polarity(leaf, place, time, near, own, event);
        (1, u64::from(on), u64::from(!on))
    }

    /// Codes the times and polarities of a leaf of several events.
    #[inline(never)]
    fn several(
        &mut self,
        leaf: &Leaf,
        place: u32,
        near: &Near,
        own: &mut Own,
        events: &mut [TreeEvent],
        count: u32,
    ) -> (usize, u64, u64) {
        let (mut on, mut off) = (0, 0);
        let mut time = 0;
        for (k, event) in (0..count).zip(events) {
            let told = event.time.wrapping_sub(leaf.base);
            let low = &mut self.learned.low;
            let scans = (self.clock.shape.scans.as_ref(), place);
            let within = (leaf.base, leaf.shift);
            time = low.code(self.coder, (k, count), scans, within, told, time);
            let is_on = self.polarity(leaf, place, time, near, own, event);
            on |= u64::from(is_on);
            off |= u64::from(!is_on);
        }
        (count as usize, on, off)
    }

    /// Codes an event's polarity and completes the event, whose time in the leaf is `time`.
    #[inline(always)]
    fn polarity(
        &mut self,
        leaf: &Leaf,
        place: u32,
        time: u32,
        near: &Near,
        own: &mut Own,
        event: &mut TreeEvent,
    ) -> bool {
        let now = self.clock.at(leaf.base + time) & TIME_MASK;
        let ago = ago(now.wrapping_sub(own.last_time) & TIME_MASK);
        own.last_time = now;
        let side = (near.on >> leaf.i & 1) as u32 * 2 + (near.off >> leaf.i & 1) as u32;
        let score = u32::from(SCORES[(side << 3 | near.vote) as usize & 31]);
        let (last, before) = (own.polarities & 1, own.polarities >> 1 & 1);
        let sides = last | side << 1 | near.vote << 3 | ago << 6;
        let history = last | score << 1 | ago << 4 | (own.area >> 6) << 8 | before << 10;
        let sides = &mut self.learned.sides[sides as usize & 1023];
        let history = &mut self.learned.history[history as usize & 2047];
        let on = self
            .coder
            .bit((sides.p16() + history.p16()) >> 1, event.is_on());
        sides.learn(on, POLARITY_LIMIT);
        history.learn(on, POLARITY_LIMIT);
        own.polarities = (own.polarities << 1 | u32::from(on)) & 15;
        own.area = if on {
            own.area + ((255 - own.area) >> 3)
        } else {
            own.area - ((own.area + 7) >> 3)
        };
        if !C::ENCODES {
            *event = TreeEvent::new(leaf.base + time, place, on);
        }
        on
    }
}
