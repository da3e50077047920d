//! Effort one: the mean of two predictions, by what is around a node and by how active it has been.

use super::word_of;
use crate::coder::tree::counter::{Counter, LIMIT};
use crate::coder::tree::memory::fetch;
use crate::coder::tree::pyramid::{Level, MARGIN_BYTES, Pyramid, set_word, word_at};
use crate::coder::tree::range::BitCoder;

/// Contexts of a level.
const CONTEXTS: usize = 1 << 10;
/// Levels with contexts of their own; the last has those of all coarser ones.
const CLASSES: usize = 5;
/// Counters of each prediction, a power of two.
const SIZE: usize = 1 << 13;
const _: () = assert!(CLASSES * CONTEXTS <= SIZE);

/// Number of counters.
pub(super) const COUNTERS: usize = 2 * SIZE;

/// What is learned.
#[derive(Debug)]
pub(crate) struct Learned<'m> {
    around: &'m mut [Counter; SIZE],
    activity: &'m mut [Counter; SIZE],
}

impl<'m> Learned<'m> {
    /// Takes its counters from the start of `counters`.
    pub(crate) fn new(counters: &mut &'m mut [Counter]) -> Option<Self> {
        Some(Self {
            around: counters.split_off_mut(..SIZE)?.as_mut_array()?,
            activity: counters.split_off_mut(..SIZE)?.as_mut_array()?,
        })
    }

    pub(crate) fn restart(&mut self) {
        self.around.fill(Counter::EVEN);
        self.activity.fill(Counter::EVEN);
    }
}

/// From five nodes of the window before: bit 2 is the node itself, below it how many of its east and the three to the
/// south are active, up to 3. Bit 0 of the index is the node itself.
const BEFORE: [u8; 32] = {
    let mut table = [0; 32];
    let mut i = 0_u32;
    while i < 32 {
        let others = (i >> 1).count_ones();
        table[i as usize] = ((i & 1) << 2 | if others > 3 { 3 } else { others }) as u8;
        i += 1;
    }
    table
};

/// Number of active nodes of four, up to 3.
const FEW: [u8; 16] = [0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 3];

/// A node's activity is 0 to 255, and moves a quarter of the way to either end with each decision. The tables: after a
/// node that is not active, after one that is, and its class, 0 to 7.
const ACTIVITIES: [[u8; 256]; 3] = {
    let mut table = [[0; 256]; 3];
    let bounds = [2, 8, 16, 32, 64, 112, 160];
    let mut h = 0_usize;
    while h < 256 {
        table[0][h] = (h - ((h + 3) >> 2)) as u8;
        table[1][h] = (h + ((255 - h) >> 2)) as u8;
        let mut class = 0;
        while class < bounds.len() && h >= bounds[class] {
            class += 1;
        }
        table[2][h] = class as u8;
        h += 1;
    }
    table
};

/// Returns bits of a row, from bit `shift` of byte `byte` on.
#[inline(always)]
fn near(row: &[u8], byte: usize, shift: u32) -> u32 {
    match row.get(byte..byte + 2) {
        Some(&[low, high]) => u32::from(u16::from_le_bytes([low, high])) >> shift,
        _ => 0,
    }
}

/// Codes the pyramid `now`, of which a decoder fills all levels; `before` is that of the window before, and
/// `activities` has a byte of each node, or none without history.
#[inline(never)]
pub(crate) fn code<C: BitCoder>(
    coder: &mut C,
    learned: &mut Learned<'_>,
    pyramid: &Pyramid,
    now: &mut [u8],
    before: &[u8],
    activities: &mut [u8],
) {
    pyramid.set_top(now);
    for (k, level, parent) in pyramid.coarse_to_fine() {
        let class = k.min(CLASSES - 1) * CONTEXTS;
        // The coarser level's rows lie behind this one's.
        let at = parent.row(-1);
        let Some((fine, coarse)) = now.split_at_mut_checked(at) else {
            return;
        };
        for y in 0..level.height {
            let parents = coarse.get(parent.row((y / 2) as i32) - at + MARGIN_BYTES..);
            let first = level.nodes_at + (y * level.width) as usize;
            let row = first..first + level.width as usize;
            let activities = activities.get_mut(row).unwrap_or_default();
            code_row(
                coder,
                learned,
                (level, y, class),
                (fine, before, parents.unwrap_or_default()),
                activities,
            );
        }
    }
}

/// Codes row `y` of a level. `parents` begins with the row above it of the coarser level.
#[inline(always)]
fn code_row<C: BitCoder>(
    coder: &mut C,
    learned: &mut Learned<'_>,
    (level, y, class): (&Level, u32, usize),
    (now, before, parents): (&mut [u8], &[u8], &[u8]),
    activities: &mut [u8],
) {
    let at = level.row(y as i32);
    let north_at = level.row(y as i32 - 1);
    let far_at = level.row(if y >= 2 { y as i32 - 2 } else { -1 });
    let Some((upper, here)) = now.split_at_mut_checked(at) else {
        return;
    };
    let (Some(far), Some(north), Some(old), Some(south)) = (
        upper.get(far_at..),
        upper.get(north_at..),
        before.get(at..),
        before.get(at + level.stride..),
    ) else {
        return;
    };
    let is_odd = y & 1;
    let parents_of = |j: usize| match parents.get(4 * j..).and_then(|rest| rest.first_chunk()) {
        Some(word) => u32::from_le_bytes(*word),
        None => 0,
    };
    // The next word with parents.
    let mut ahead = 0;
    // The last two nodes of the word to the west.
    let mut carry = 0_u64;
    for j in 0..level.words() {
        let parents = parents_of(j);
        if parents == 0 {
            if !C::ENCODES {
                // What an earlier window left.
                set_word(here, MARGIN_BYTES + 8 * j, 0);
            }
            carry = 0;
            continue;
        }
        ahead = ahead.max(j + 1);
        while ahead < level.words() && parents_of(ahead) == 0 {
            ahead += 1;
        }
        fetch(activities, 64 * ahead);
        let word = word_of(level, y, j, parents, north, 0);
        let mut todo = word.todo;
        let target = if C::ENCODES {
            word_at(here, MARGIN_BYTES + 8 * j)
        } else {
            0
        };
        let mut made = 0_u64;
        while todo != 0 {
            let i = todo.trailing_zeros();
            todo &= todo - 1;
            let west = made << 1 | carry >> 1;
            if word.is_implied(i, west) {
                made |= 1 << i;
                continue;
            }
            let x = 64 * j as u32 + i;
            let (byte, shift) = (((62 + x) >> 3) as usize, (62 + x) & 7);
            let n = near(north, byte, shift) >> 1 & 7;
            let nn = near(far, byte, shift) >> 2 & 1;
            let old = near(old, byte, shift) >> 2 & 3;
            let south = near(south, byte, shift) >> 1 & 7;
            let before = u32::from(BEFORE[(old | south << 2) as usize & 31]);
            let w = (west >> i & 1) as u32;
            let ww = ((made << 2 | carry) >> i & 1) as u32;
            let place = is_odd << 1 | i & 1;
            let context = place << 8 | w << 7 | n << 4 | (nn | ww) << 3 | before;
            let around = &mut learned.around[(class + context as usize) & (SIZE - 1)];
            let want = target >> i & 1 == 1;
            let bit = if let Some(state) = activities.get_mut(x as usize) {
                let activity = u32::from(ACTIVITIES[2][usize::from(*state)]);
                let few = u32::from(FEW[(w << 3 | n) as usize & 15]);
                let was = before & 4 | u32::from(before & 3 != 0);
                let context = place << 8 | activity << 5 | few << 3 | was;
                let activity = &mut learned.activity[(class + context as usize) & (SIZE - 1)];
                let bit = coder.bit((around.p16() + activity.p16()) >> 1, want);
                activity.learn(bit, LIMIT);
                *state = ACTIVITIES[usize::from(bit)][usize::from(*state)];
                bit
            } else {
                coder.bit(around.p16(), want)
            };
            around.learn(bit, LIMIT);
            made |= u64::from(bit) << i;
        }
        set_word(here, MARGIN_BYTES + 8 * j, made);
        carry = made >> 62;
    }
}
