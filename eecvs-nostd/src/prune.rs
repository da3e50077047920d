//! Which coefficients of a pixel are kept.

use crate::transform::GRID_MAX;

/// A set of grid indices: bit k of its words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kept {
    words: [u32; GRID_MAX / 32],
}

impl Kept {
    /// No index.
    pub const NONE: Self = Self {
        words: [0; GRID_MAX / 32],
    };

    /// Empties the words that a grid of `grid` uses.
    #[inline(always)]
    pub fn clear(&mut self, grid: usize) {
        for word in self.words.iter_mut().take(grid.div_ceil(32)) {
            *word = 0;
        }
    }

    /// Adds `k`, below [`GRID_MAX`].
    #[inline(always)]
    pub fn insert(&mut self, k: usize) {
        self.words[k / 32 % (GRID_MAX / 32)] |= 1 << (k % 32);
    }

    /// Takes `k` out.
    #[inline(always)]
    pub fn remove(&mut self, k: usize) {
        self.words[k / 32 % (GRID_MAX / 32)] &= !(1 << (k % 32));
    }

    /// Whether `k` is among them.
    #[inline(always)]
    #[must_use]
    pub fn contains(&self, k: usize) -> bool {
        (self.words[k / 32 % (GRID_MAX / 32)] >> (k % 32)) & 1 == 1
    }

    /// The words of a grid of `grid`, k = 0 in the lowest bit of the first.
    #[inline(always)]
    #[must_use]
    pub fn words(&self, grid: usize) -> &[u32] {
        self.words.get(..grid.div_ceil(32)).unwrap_or(&self.words)
    }

    /// The same, to be written.
    #[inline(always)]
    pub fn words_mut(&mut self, grid: usize) -> &mut [u32] {
        let words = grid.div_ceil(32).min(GRID_MAX / 32);
        &mut self.words[..words]
    }

    /// How many there are below `grid`.
    #[inline]
    #[must_use]
    pub fn count(&self, grid: usize) -> u32 {
        self.words(grid).iter().map(|word| word.count_ones()).sum()
    }

    /// Calls `each` with every index below `grid`, ascending.
    #[inline(always)]
    pub fn for_each(&self, grid: usize, mut each: impl FnMut(usize)) {
        for (index, word) in self.words(grid).iter().enumerate() {
            let mut word = *word;
            while word != 0 {
                each(index * 32 + word.trailing_zeros() as usize);
                word &= word - 1;
            }
        }
    }
}

/// Adds k = 0..`r` to `kept`.
#[inline(always)]
pub fn low_frequency(r: usize, kept: &mut Kept) {
    let mut left = r;
    for word in &mut kept.words {
        if left < 32 {
            *word |= !(u32::MAX << left);
            break;
        }
        *word = u32::MAX;
        left -= 32;
    }
}

/// Adds the `r` largest of `keys` to `kept`, ties to the lower k.
///
/// Everything above the r-th largest value is kept, and the places left go to its equals from k = 0
/// up. At most 34 passes over the keys.
#[inline(always)]
pub fn largest(keys: &[u32], r: usize, kept: &mut Kept) {
    if r >= keys.len() {
        return low_frequency(keys.len(), kept);
    }
    if r == 0 {
        return;
    }
    if keys.len() <= 32 {
        kept.words[0] |= largest_of_32(keys, r as u32);
    } else {
        largest_of_many(keys, r, kept);
    }
}

/// [`largest`] of up to 32 keys, as a bit per key; `r` is 1 to one less than their number.
///
/// Bisects for a value that exactly `r` of the keys exceed. Counting takes the same few instructions
/// per key whatever they are, where a selection's branches and exchanges take more.
#[inline(never)]
fn largest_of_32(keys: &[u32], r: u32) -> u32 {
    let count = |value: u32| keys.iter().map(|key| u32::from(*key > value)).sum::<u32>();
    let above = |value: u32| {
        let keys = keys.iter().rev();
        keys.fold(0, |bits, key| (bits << 1) | u32::from(*key > value))
    };
    // More than r keys exceed `low`, where it is not 0, and fewer exceed `high`.
    let (mut low, mut high) = (0, keys.iter().fold(0, |most, key| most.max(*key)));
    // Half of a set is often next to its mean.
    let mean = keys
        .iter()
        .fold(0_u32, |sum, key| sum.wrapping_add(key / 32));
    let mut value = mean.saturating_mul(2).min(high);
    while high - low > 1 {
        let count = count(value);
        if count == r {
            return above(value);
        }
        if count > r {
            low = value;
        } else {
            high = value;
        }
        value = low + (high - low) / 2;
    }
    // The places left go to the equals of `high`, or of 0 where fewer than r exceed that.
    let exceed_low = above(low);
    let (mut kept, mut equal) = if exceed_low.count_ones() < r {
        (exceed_low, !exceed_low)
    } else {
        let kept = above(high);
        (kept, exceed_low & !kept)
    };
    for _ in kept.count_ones()..r {
        let lowest = equal & equal.wrapping_neg();
        kept |= lowest;
        equal ^= lowest;
    }
    kept
}

/// [`largest`] of any number.
#[inline(never)]
fn largest_of_many(keys: &[u32], r: usize, kept: &mut Kept) {
    let at_least = |key: u32| keys.iter().filter(|k| **k >= key).count();
    // The r-th largest, bit by bit from the top: the greatest that r of them reach.
    let mut threshold = 0;
    for bit in (0..u32::BITS).rev() {
        let higher = threshold | (1 << bit);
        if at_least(higher) >= r {
            threshold = higher;
        }
    }
    let above = keys.iter().filter(|key| **key > threshold).count();
    let mut ties = r.saturating_sub(above);
    for (k, key) in keys.iter().enumerate() {
        if *key > threshold {
            kept.insert(k);
        } else if *key == threshold && ties > 0 {
            ties -= 1;
            kept.insert(k);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn kept(keys: &[u32], r: usize) -> Vec<usize> {
        let mut kept = Kept::NONE;
        largest(keys, r, &mut kept);
        let mut found = Vec::new();
        kept.for_each(GRID_MAX, |k| found.push(k));
        assert_eq!(kept.count(GRID_MAX) as usize, found.len());
        found
    }

    #[test]
    fn ties_go_to_the_lower_k() {
        assert_eq!(kept(&[1, 1, 1, 1], 2), [0, 1]);
        assert_eq!(kept(&[0, 5, 1, 5, 5], 2), [1, 3]);
        assert_eq!(kept(&[2, 9, 2, 2], 3), [0, 1, 2]);
        assert_eq!(kept(&[7, 8], 5), [0, 1]);
        assert!(kept(&[], 5).is_empty());
        assert!(kept(&[1, 2], 0).is_empty());
    }

    proptest! {
        #[test]
        fn is_the_stable_sort_by_key(
            keys in prop_oneof![
                proptest::collection::vec(0..6_u32, 1..128),
                proptest::collection::vec(0..6_u32, 1..=32),
                proptest::collection::vec(prop_oneof![Just(0), Just(1), Just(u32::MAX)], 1..=32),
                proptest::collection::vec(any::<u32>(), 1..=32),
                proptest::collection::vec(any::<u32>(), 1..128),
            ],
            r in 1..=64_usize,
        ) {
            let mut order: Vec<usize> = (0..keys.len()).collect();
            order.sort_by_key(|k| std::cmp::Reverse(keys[*k]));
            order.truncate(r);
            order.sort_unstable();
            prop_assert_eq!(kept(&keys, r), order);
        }
    }
}
