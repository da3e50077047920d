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
/// The r-th largest value is selected, everything above it is kept, and the places left go to its
/// equals from k = 0 up. O(K) on average, and at worst where K is above 32: 34 passes there.
#[inline(always)]
pub fn largest(keys: &[u32], r: usize, kept: &mut Kept) {
    if r >= keys.len() {
        return low_frequency(keys.len(), kept);
    }
    if r == 0 {
        return;
    }
    if keys.len() <= 32 {
        kept.words[0] |= largest_of_32(keys, r);
    } else {
        largest_of_many(keys, r, kept);
    }
}

/// [`largest`] of up to 32 keys, as a bit per key; `r` is 1 to their number.
#[inline(never)]
fn largest_of_32(keys: &[u32], r: usize) -> u32 {
    let mut work = [0; 32];
    for (place, key) in work.iter_mut().zip(keys) {
        *place = *key;
    }
    let threshold = select(&mut work, keys.len(), r - 1);
    let (mut above, mut equal) = (0, 0);
    for key in keys.iter().rev() {
        above = (above << 1) | u32::from(*key > threshold);
        equal = (equal << 1) | u32::from(*key == threshold);
    }
    for _ in above.count_ones()..r as u32 {
        let lowest = equal & equal.wrapping_neg();
        above |= lowest;
        equal ^= lowest;
    }
    above
}

/// The value at `rank` of the first `len` in descending order, by Hoare's selection.
///
/// Indices are cut to 5 bits, which they never exceed, instead of checked.
#[inline(always)]
fn select(work: &mut [u32; 32], len: usize, rank: usize) -> u32 {
    let at = |index: i32| (index & 31) as usize;
    let rank = rank as i32;
    // Signed: j falls to -1.
    let (mut low, mut high) = (0, len as i32 - 1);
    while low < high {
        let pivot = work[at(rank)];
        let (mut i, mut j) = (low, high);
        while i <= j {
            // Each stops at the pivot or at what the other has moved there.
            while work[at(i)] > pivot {
                i += 1;
            }
            while work[at(j)] < pivot {
                j -= 1;
            }
            if i <= j {
                work.swap(at(i), at(j));
                i += 1;
                j -= 1;
            }
        }
        if j < rank {
            low = i;
        }
        if rank < i {
            high = j;
        }
    }
    work[at(rank)]
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
