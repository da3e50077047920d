//! Which pixels have events: the pyramid, level after level from the coarsest, each row by row.
//!
//! Only nodes below an active one are coded, by what is known around them: nodes to the west and north, and the window
//! before. The last of up to four siblings is implied if the others are not active.

pub(super) mod mixed;
pub(super) mod single;

use super::mix::MixerSizes;
use super::pyramid::{Level, MARGIN_BYTES, doubled, word_at};

/// Number of counters that [`single`] has.
pub(super) const COUNTERS_SINGLE: usize = single::COUNTERS;
/// Number of mixers that [`mixed`] has.
pub(super) const MIXERS: usize = 1;

/// Number of each that the mixers of several modules need.
#[derive(Debug, Clone, Copy)]
pub(super) struct MixedSizes {
    pub(super) counters: usize,
    pub(super) weights: usize,
    pub(super) curves: usize,
    pub(super) blocks: usize,
}

impl MixedSizes {
    pub(super) const fn of(mixers: &[MixerSizes]) -> Self {
        let mut sizes = Self {
            counters: 0,
            weights: 0,
            curves: 0,
            blocks: 0,
        };
        let mut i = 0;
        while i < mixers.len() {
            sizes.counters += mixers[i].counters;
            sizes.weights += mixers[i].weights[0] + mixers[i].weights[1] + mixers[i].weights[2];
            sizes.curves += mixers[i].curves;
            sizes.blocks += mixers[i].blocks();
            i += 1;
        }
        sizes
    }
}

/// Number of each that [`mixed`] needs.
pub(super) const fn mixed_sizes(is_full: bool) -> MixedSizes {
    MixedSizes::of(&[mixed::sizes(is_full)])
}

/// 64 nodes of a row.
#[derive(Debug, Clone, Copy)]
struct Word {
    /// Those below an active node.
    todo: u64,
    /// The last of their siblings, where none above is active: they are implied if the one to the west is not.
    open: u64,
}

/// Returns the word number `j` of row `y`; `parents` are the 32 nodes above it, and `north` is where the row above
/// begins.
#[inline(always)]
fn word_of(level: &Level, y: u32, j: usize, parents: u32, bytes: &[u8], north: usize) -> Word {
    let left = level.width - 64 * j as u32;
    let valid = if left >= 64 {
        u64::MAX
    } else {
        (1_u64 << left) - 1
    };
    let is_odd = y & 1 == 1;
    let open = if is_odd || y + 1 == level.height {
        let above = if is_odd {
            word_at(bytes, north + MARGIN_BYTES + 8 * j)
        } else {
            0
        };
        let above = (above | above >> 1) & 0x5555_5555_5555_5555;
        // The right one, or one alone at the edge.
        let mut last = 0xAAAA_AAAA_AAAA_AAAA;
        if left <= 64 {
            last |= 1 << (left - 1);
        }
        !(above | above << 1) & last
    } else {
        0
    };
    Word {
        todo: doubled(parents) & valid,
        open,
    }
}

impl Word {
    /// Returns whether node `i` follows from its siblings; `west` are the nodes to the west, at their east's place.
    #[inline(always)]
    const fn is_implied(&self, i: u32, west: u64) -> bool {
        self.open >> i & 1 == 1 && (i & 1 == 0 || west >> i & 1 == 0)
    }
}
