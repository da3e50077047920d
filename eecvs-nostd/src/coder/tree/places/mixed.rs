//! Efforts two and three: three and eight predictions, mixed, from a wider surrounding and from how long ago each node
//! was active.

use super::word_of;
use crate::coder::tree::mix::{Mixer, MixerSizes};
use crate::coder::tree::pyramid::{Level, MARGIN_BYTES, Pyramid, near, set_word, word_at};
use crate::coder::tree::range::BitCoder;

/// Bits of a context.
const CONTEXT_BITS: u32 = 16;
/// Contexts in use with effort two.
const QUICK: [usize; 3] = [0, 2, 4];
/// Contexts in use with effort three.
const ALL: usize = 8;

/// Limit of the counters.
pub(crate) const LIMIT: u32 = 120;

/// What the mixer needs.
pub(crate) const fn sizes(is_full: bool) -> MixerSizes {
    MixerSizes {
        counters: if is_full { ALL } else { QUICK.len() } << CONTEXT_BITS,
        weights: [64, 256, 256],
        curves: 64,
    }
}

/// What is kept of each node, and the number of this window, from 1 on.
#[derive(Debug)]
pub(crate) struct History<'m> {
    /// 0 to 255; moves an eighth of the way to either end with each decision.
    pub(crate) activities: &'m mut [u8],
    /// Number of the last window in which it was active; 0 never.
    pub(crate) windows: &'m mut [u16],
    pub(crate) number: u16,
}

/// Class of an age in windows; 7 for never.
const NEVER: u32 = 7;

/// The nodes of one level.
struct Nodes<'h, 'm> {
    history: &'h mut History<'m>,
    level: &'h Level,
}

impl Nodes<'_, '_> {
    /// Index of the node at an offset; `None` beyond the level.
    #[inline(always)]
    fn index(&self, (x, y): (u32, u32), (dx, dy): (i32, i32)) -> Option<usize> {
        let (x, y) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
        let Level { width, height, .. } = *self.level;
        (x < width && y < height).then(|| self.level.nodes_at + (y * width + x) as usize)
    }

    #[inline(always)]
    fn age(&self, at: (u32, u32), by: (i32, i32)) -> u32 {
        let index = self.index(at, by);
        let then = index.and_then(|index| self.history.windows.get(index).copied());
        match then {
            None | Some(0) => NEVER,
            Some(then) => match self.history.number.wrapping_sub(then) {
                age @ 0..=2 => u32::from(age),
                3..=4 => 3,
                5..=8 => 4,
                9..=20 => 5,
                _ => 6,
            },
        }
    }

    #[inline(always)]
    fn activity(&self, at: (u32, u32), by: (i32, i32)) -> u32 {
        let index = self.index(at, by);
        let activity = index.and_then(|index| self.history.activities.get(index).copied());
        u32::from(activity.unwrap_or(0))
    }
}

/// Class of an activity.
#[inline(always)]
const fn octave(activity: u32) -> u32 {
    match activity {
        0 => 0,
        1..4 => 1,
        4..8 => 2,
        8..16 => 3,
        16..32 => 4,
        32..64 => 5,
        64..128 => 6,
        _ => 7,
    }
}

/// As [`super::single::code`]; with `FULL`, effort three.
#[inline(never)]
pub(crate) fn code<C: BitCoder, const FULL: bool>(
    coder: &mut C,
    mixer: &mut Mixer<'_>,
    pyramid: &Pyramid,
    now: &mut [u8],
    before: &[u8],
    history: &mut History<'_>,
) {
    pyramid.set_top(now);
    for (k, level, parent) in pyramid.coarse_to_fine() {
        let nodes = &mut Nodes { history, level };
        for y in 0..level.height {
            code_row::<C, FULL>(coder, mixer, (k as u32, y), parent, now, before, nodes);
        }
    }
}

/// Codes row `y` of level `k`.
#[inline(always)]
fn code_row<C: BitCoder, const FULL: bool>(
    coder: &mut C,
    mixer: &mut Mixer<'_>,
    (k, y): (u32, u32),
    parent: &Level,
    now: &mut [u8],
    before: &[u8],
    nodes: &mut Nodes<'_, '_>,
) {
    let level = nodes.level;
    let here = level.row(y as i32);
    let north = level.row(y as i32 - 1);
    let far = level.row(if y >= 2 { y as i32 - 2 } else { -1 });
    let south = level.row(y as i32 + 1);
    let parent_row = parent.row((y / 2) as i32);
    let parent_south = (y / 2 + 1 < parent.height).then(|| parent.row((y / 2 + 1) as i32));
    // The finest eight levels have contexts of their own.
    let class = k.min(7);
    let is_odd = y & 1;
    let mut carry = 0_u64;
    for j in 0..level.words() {
        let at = MARGIN_BYTES + 8 * j;
        let parents = word_at(now, parent_row + MARGIN_BYTES + 4 * j) as u32;
        if parents == 0 {
            if !C::ENCODES {
                set_word(now, here + at, 0);
            }
            carry = 0;
            continue;
        }
        let word = word_of(level, y, j, parents, now, north);
        let mut todo = word.todo;
        let target = if C::ENCODES {
            word_at(now, here + at)
        } else {
            0
        };
        let mut made = 0_u64;
        while todo != 0 {
            let i = todo.trailing_zeros();
            todo &= todo - 1;
            let x = 64 * j as u32 + i;
            let index = level.nodes_at + (y * level.width + x) as usize;
            let west = made << 1 | carry >> 1;
            if word.is_implied(i, west) {
                made |= 1 << i;
                if let Some(window) = nodes.history.windows.get_mut(index) {
                    *window = nodes.history.number;
                }
                continue;
            }
            let w = (west >> i & 1) as u32;
            let ww = ((made << 2 | carry) >> i & 1) as u32;
            let n = near(now, north, x) >> 1 & 7;
            let nn = near(now, far, x) >> 2 & 1;
            let old = near(before, here, x) >> 1 & 7;
            let old_south = near(before, south, x) >> 1 & 7;
            let later = ((old >> 2) + old_south.count_ones()).min(3);
            let place = is_odd << 1 | i & 1;
            let few = (w + n.count_ones()).min(3);
            let pe = near(now, parent_row, x / 2) >> 3 & 1;
            let ps = parent_south.map_or(0, |row| near(now, row, x / 2) >> 2 & 1);
            let around = w << 7 | n << 4 | (nn | ww) << 3 | (old >> 1 & 1) << 2 | later;
            let pattern = w << 1 | ww | n << 2 | nn << 5;

            let age = |dx, dy| nodes.age((x, y), (dx, dy));
            let (own, e, s, sw, se) = (age(0, 0), age(1, 0), age(0, 1), age(-1, 1), age(1, 1));
            let youngest = e.min(s).min(sw).min(se);
            let activity = |dx, dy| nodes.activity((x, y), (dx, dy));
            let h = activity(0, 0);
            let ahead = (activity(1, 0) + activity(0, 1) + activity(-1, 1) + activity(1, 1)) >> 2;
            let behind =
                (activity(-1, 0) + activity(0, -1) + activity(-1, -1) + activity(1, -1)) >> 2;

            let base = class << 13;
            // Blocks of 16 x 16 nodes.
            let block = (x >> 4) * 31 + (y >> 4) * 1021;
            let hash = (class * 7919)
                .wrapping_add(block * 8)
                .wrapping_add(place * 2)
                .wrapping_mul(0x9E37_79B1);
            let contexts: [u32; ALL] = [
                base + (place << 8 | around),
                base + (place << 8 | pattern << 2 | pe << 1 | ps),
                base + (place << 11
                    | own << 8
                    | few << 6
                    | w << 5
                    | nn << 4
                    | later << 2
                    | (pe + ps)),
                base + (place << 9 | own << 6 | youngest << 3 | few << 1 | (ww | nn)),
                base + (place << 11 | (h >> 3) << 6 | octave(ahead) << 3 | few << 1),
                hash >> 16,
                base + (place << 11
                    | own.min(3) << 9
                    | e.min(3) << 7
                    | s.min(3) << 5
                    | sw.min(3) << 3
                    | se.min(3) << 1
                    | u32::from(few > 0)),
                base + (place << 11
                    | octave(ahead) << 8
                    | octave(behind) << 5
                    | octave(h) << 2
                    | few.min(2)),
            ];
            let sets = [
                class << 2 | place,
                few << 4 | own.min(3) << 2 | later,
                octave(ahead) << 3 | octave(h),
            ];
            let curve = few << 2 | own.min(3);
            let want = target >> i & 1 == 1;
            let bit = if FULL {
                let mut at = contexts;
                for (input, at) in (0_u32..).zip(&mut at) {
                    *at += input << CONTEXT_BITS;
                }
                mixer.code(coder, at, sets, curve, want)
            } else {
                let [a, b, c] = QUICK.map(|context| contexts[context]);
                let at = [a, (1 << CONTEXT_BITS) + b, (2 << CONTEXT_BITS) + c];
                mixer.code(coder, at, sets, curve, want)
            };
            if let Some(state) = nodes.history.activities.get_mut(index) {
                *state = if bit {
                    h + ((255 - h) >> 3)
                } else {
                    h - ((h + 7) >> 3)
                } as u8;
            }
            if bit && let Some(window) = nodes.history.windows.get_mut(index) {
                *window = nodes.history.number;
            }
            made |= u64::from(bit) << i;
        }
        set_word(now, here + at, made);
        carry = made >> 62;
    }
}
