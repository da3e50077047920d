//! Codes the order in which the events of a group, those of one time, arrived; serves both directions.
//!
//! Both sides know the events of a group, sorted by lines of the sensor (rows or columns) and along the lines. For
//! each event the coder says which of those left came next: the next or the previous one in sorted order, as in
//! most readouts, or any other. The contexts say how near these two candidates are: whether they are on the same
//! line as the last event, and in the same block of eight pixels.
//!
//! A tree of counts finds an event among those left in O(log n), however large the group.

use crate::coder::range::{Binary, Probability};
use crate::coder::scan::Axis;
use event_types::Sensor;

/// Most bytes that an event's place takes, including the bit before the first one.
pub const PLACE_BYTES_MAX: usize = 8;

/// Bits of the position along a line.
const ALONG_BITS: u32 = 11;
const _: () = assert!(Sensor::SIDE_MAX as u32 == 1 << ALONG_BITS);
/// log2 of the number of neighbouring pixels of a line that readouts often read together.
const BLOCK_BITS: u32 = 3;
/// No event of the group has been placed yet.
const NO_PLACE: u32 = u32::MAX;

/// States of a neighbour: none, on another line, on the same line, in the same block.
const NEARNESSES: usize = 4;
/// One context per state of the two neighbours, and one for the start of a group.
const CONTEXTS: usize = NEARNESSES * NEARNESSES + 1;
const START: usize = CONTEXTS - 1;

/// Returns a pixel's position in the order by which a group is sorted: its line, then how far along it is.
#[inline]
#[must_use]
pub const fn place(axis: Axis, (x, y): (u16, u16)) -> u32 {
    match axis {
        Axis::Rows => (y as u32) << ALONG_BITS | x as u32,
        Axis::Columns => (x as u32) << ALONG_BITS | y as u32,
    }
}

/// Converts a place by rows to one by columns.
pub(crate) const fn turned(place: u32) -> u32 {
    (place & ((1 << ALONG_BITS) - 1)) << ALONG_BITS | place >> ALONG_BITS
}

/// Returns how near two places are: 1 to [`NEARNESSES`] - 1.
const fn nearness(a: u32, b: u32) -> usize {
    if a >> ALONG_BITS != b >> ALONG_BITS {
        1
    } else if a >> BLOCK_BITS != b >> BLOCK_BITS {
        2
    } else {
        3
    }
}

/// Returns whether two places by rows are in the same row, and whether in the same column.
pub(crate) const fn share(a: u32, b: u32) -> (bool, bool) {
    let rows = a >> ALONG_BITS == b >> ALONG_BITS;
    let columns = (a ^ b) & ((1 << ALONG_BITS) - 1) == 0;
    (rows, columns)
}

/// A group of which some events have been placed. Its tree, of one word per event, is kept beside it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group {
    left: u32,
    /// Number of events left that come before the last one placed.
    at: u32,
    /// Place of the last one.
    last: u32,
}

impl Group {
    /// A group of which no event is left.
    pub const EMPTY: Self = Self {
        left: 0,
        at: 0,
        last: NO_PLACE,
    };

    /// Starts a group with one event per word of the tree.
    #[must_use]
    pub fn new(tree: &mut [u32]) -> Self {
        for (count, number) in tree.iter_mut().zip(1_u32..) {
            *count = lowest_bit(number);
        }
        Self {
            left: tree.len() as u32,
            ..Self::EMPTY
        }
    }

    /// Returns the number of events not placed yet.
    #[must_use]
    pub const fn left(&self) -> u32 {
        self.left
    }
}

const fn lowest_bit(number: u32) -> u32 {
    number & number.wrapping_neg()
}

/// Returns how many of the events left are below a rank.
fn left_below(tree: &[u32], rank: u32) -> u32 {
    let (mut number, mut below) = (rank, 0);
    while let Some(count) = tree.get(number.wrapping_sub(1) as usize) {
        below += count;
        number -= lowest_bit(number);
    }
    below
}

/// Returns the rank of the event left that has `index` others left before it.
fn rank_of(tree: &[u32], index: u32) -> u32 {
    let (mut rank, mut left) = (0, index);
    let mut step = 1 << (tree.len() as u32 | 1).ilog2();
    while step > 0 {
        if let Some(count) = tree.get((rank + step - 1) as usize)
            && *count <= left
        {
            rank += step;
            left -= count;
        }
        step /= 2;
    }
    rank
}

fn take(tree: &mut [u32], rank: u32) {
    let mut number = rank + 1;
    while let Some(count) = tree.get_mut((number - 1) as usize) {
        *count = count.saturating_sub(1);
        number += lowest_bit(number);
    }
}

/// Probabilities learned from the order since the start of a frame.
#[derive(Debug, Clone)]
pub struct Learned {
    /// Whether the next event of the sorted group comes, and if not, whether the previous one does. For the first
    /// event of a group: whether it is the first of the sorted group, or the last.
    next: [Probability; CONTEXTS],
    previous: [Probability; CONTEXTS],
}

impl Learned {
    /// State at the start of a frame: both outcomes of every decision are equally likely.
    pub const START: Self = Self {
        next: [Probability::EVEN; _],
        previous: [Probability::EVEN; _],
    };

    /// Codes which event came next, by its rank in the sorted group; `place` returns the place of a rank.
    ///
    /// Returns the rank, or `None` if no event is left or a decoder reads a number that is no event. Takes O(log n)
    /// time in a group of n.
    pub fn code<C: Binary>(
        &mut self,
        coder: &mut C,
        (group, tree): (&mut Group, &mut [u32]),
        place: impl Fn(u32) -> u32,
        rank: u32,
    ) -> Option<u32> {
        let index = match group.left {
            0 => return None,
            1 => 0,
            _ => self.index(coder, (group, tree), &place, left_below(tree, rank))?,
        };
        let rank = rank_of(tree, index);
        take(tree, rank);
        *group = Group {
            left: group.left - 1,
            at: index,
            last: place(rank),
        };
        Some(rank)
    }

    /// Codes the event's number among those left, of which there are at least two.
    fn index<C: Binary>(
        &mut self,
        coder: &mut C,
        (group, tree): (&Group, &[u32]),
        place: impl Fn(u32) -> u32,
        told: u32,
    ) -> Option<u32> {
        let Group { left, at, last } = *group;
        let is_start = last == NO_PLACE;
        let next = Some(at).filter(|next| *next < left);
        let previous = if is_start {
            Some(left - 1)
        } else {
            at.checked_sub(1)
        };
        let context = if is_start {
            START
        } else {
            let near = |index: Option<u32>| match index {
                Some(index) => nearness(last, place(rank_of(tree, index))),
                None => 0,
            };
            (NEARNESSES * near(next) + near(previous)).min(START)
        };
        let mut others = left;
        if let Some(next) = next {
            if coder.bit(&mut self.next[context], told == next) {
                return Some(next);
            }
            others -= 1;
        }
        if let Some(previous) = previous {
            // Nothing is coded if it is the only one left.
            if others == 1 || coder.bit(&mut self.previous[context], told == previous) {
                return Some(previous);
            }
            others -= 1;
        }
        // The two candidates are adjacent, except at the start, where one is the first and the other the last.
        let (from, skipped) = if is_start {
            (0, 1)
        } else {
            (at.saturating_sub(1), left - others)
        };
        let number = if told >= from {
            told.wrapping_sub(skipped)
        } else {
            told
        };
        let number = one_of(coder, number, others)?;
        Some(if number >= from {
            number + skipped
        } else {
            number
        })
    }
}

/// Codes one of `count` equally likely numbers; `count` is 1 to 2^24. Returns `None` if a decoder reads a number
/// beyond them.
fn one_of<C: Binary>(coder: &mut C, number: u32, count: u32) -> Option<u32> {
    let last = count.saturating_sub(1);
    let bits = (last | 31).ilog2() - 4;
    let high = coder.one_of(number >> bits, (last >> bits) + 1);
    let low = coder.plain(number & ((1 << bits) - 1), bits);
    Some(high << bits | low).filter(|number| *number <= last)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coder::range::{RangeDecoder, RangeEncoder};
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Codes the ranks in their order. With a decoder, the ranks are zeros.
    fn code(coder: &mut impl Binary, places: &[u32], ranks: &[u32]) -> Option<Vec<u32>> {
        let mut tree = vec![9; places.len()];
        let mut group = Group::new(&mut tree);
        let mut order = Learned::START;
        let place = |rank: u32| places[rank as usize];
        let coded = ranks
            .iter()
            .map(|rank| order.code(coder, (&mut group, &mut tree), place, *rank))
            .collect();
        assert_eq!(group.left, 0);
        coded
    }

    fn written(places: &[u32], ranks: &[u32]) -> Vec<u8> {
        let mut out = vec![0; PLACE_BYTES_MAX * ranks.len() + 4];
        let mut coder = RangeEncoder::new(&mut out);
        assert_eq!(code(&mut coder, places, ranks).as_deref(), Some(ranks));
        let bytes = coder.finish();
        out.truncate(bytes);
        out
    }

    /// Places of a sorted group.
    fn places() -> impl Strategy<Value = Vec<u32>> {
        let place = (0_u16..6, 0_u16..40).prop_map(|at| place(Axis::Columns, at));
        proptest::collection::vec(place, 1..200).prop_map(|mut places| {
            places.sort_unstable();
            places
        })
    }

    proptest! {
        #[test]
        fn every_order_comes_back(
            (places, ranks) in places().prop_flat_map(|places| {
                let ranks: Vec<_> = (0..places.len() as u32).collect();
                (Just(places), Just(ranks).prop_shuffle())
            }),
            turns in 0_usize..3,
        ) {
            // Test partly sorted orders too.
            let mut ranks = ranks;
            let half = ranks.len() / 2;
            match turns {
                0 => {}
                1 => ranks[half..].sort_unstable(),
                _ => ranks[..half].sort_unstable_by(|a, b| b.cmp(a)),
            }
            let bytes = written(&places, &ranks);
            let mut decoder = RangeDecoder::new(&bytes);
            let zeros = vec![0; ranks.len()];
            prop_assert_eq!(code(&mut decoder, &places, &zeros), Some(ranks));
            prop_assert!(decoder.is_spent());
        }

        /// Reading any bytes gives an order of the group, or nothing.
        #[test]
        fn any_bytes_are_an_order_or_none(bytes in any::<Vec<u8>>(), places in places()) {
            let mut tree = vec![0; places.len()];
            let mut group = Group::new(&mut tree);
            let (mut order, mut found) = (Learned::START, vec![]);
            let mut decoder = RangeDecoder::new(&bytes);
            let place = |rank: u32| places[rank as usize];
            while let Some(rank) = order.code(&mut decoder, (&mut group, &mut tree), place, 0) {
                found.push(rank);
            }
            found.sort_unstable();
            found.dedup();
            prop_assert_eq!(found.len() + group.left as usize, places.len());
        }
    }

    /// The module's promise: a readout's own order costs next to nothing, and any other no more than log2 of the
    /// number of orders plus what learning costs.
    #[test]
    fn what_is_in_order_costs_little() {
        let places: Vec<_> = (0..1024)
            .map(|i| place(Axis::Rows, (i % 64, i / 64)))
            .collect();
        let up: Vec<u32> = (0..1024).collect();
        let down: Vec<u32> = (0..1024).rev().collect();
        assert!(written(&places, &up).len() < 16);
        assert!(written(&places, &down).len() < 16);
        let mixed: Vec<u32> = (0..1024).map(|i| i * 421 % 1024).collect();
        let bits = 8 * written(&places, &mixed).len();
        let naive: f64 = (1..=1024).map(|n| f64::from(n).log2()).sum();
        assert!((bits as f64) < 1.03 * naive, "{bits} {naive}");
    }
}
