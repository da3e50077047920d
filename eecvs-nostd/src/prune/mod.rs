//! Selects the coefficients of a pixel that are kept.

#[cfg(eecvs_dsp)]
pub(crate) mod armv7em;

use crate::transform::name::GRID_MAX;

/// A set of grid indices, as bits: bit k of its words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Kept {
    words: [u32; GRID_MAX / 32],
}

impl Kept {
    /// The empty set, without any index.
    pub const NONE: Self = Self {
        words: [0; GRID_MAX / 32],
    };

    /// Empties the words that a grid of size `grid` uses.
    #[inline(always)]
    pub fn clear(&mut self, grid: usize) {
        for word in self.words.iter_mut().take(grid.div_ceil(32)) {
            *word = 0;
        }
    }

    /// Adds `k`, which is below [`GRID_MAX`].
    #[inline(always)]
    pub fn insert(&mut self, k: usize) {
        self.words[k / 32 % (GRID_MAX / 32)] |= 1 << (k % 32);
    }

    /// Removes `k`, which is below [`GRID_MAX`].
    #[inline(always)]
    pub fn remove(&mut self, k: usize) {
        self.words[k / 32 % (GRID_MAX / 32)] &= !(1 << (k % 32));
    }

    /// Returns whether `k` is in the set.
    #[inline(always)]
    #[must_use]
    pub fn contains(&self, k: usize) -> bool {
        (self.words[k / 32 % (GRID_MAX / 32)] >> (k % 32)) & 1 == 1
    }

    /// Returns the words of a grid of size `grid`, with k = 0 in the lowest bit of the first.
    #[inline(always)]
    #[must_use]
    pub fn words(&self, grid: usize) -> &[u32] {
        self.words.get(..grid.div_ceil(32)).unwrap_or(&self.words)
    }

    /// As [`Self::words`], for writing: mutable words.
    #[inline(always)]
    pub fn words_mut(&mut self, grid: usize) -> &mut [u32] {
        let words = grid.div_ceil(32).min(GRID_MAX / 32);
        &mut self.words[..words]
    }

    /// Returns how many indices below `grid` are in the set.
    #[inline]
    #[must_use]
    pub fn count(&self, grid: usize) -> u32 {
        self.words(grid).iter().map(|word| word.count_ones()).sum()
    }

    /// Calls `each` with every index of the set below `grid`, ascending.
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

/// Adds the indices of the `r` largest of `keys` to `kept`; ties go to the lower k.
///
/// All keys above the r-th largest value are kept, and the places left go to keys equal to it, from k = 0 up. Takes
/// at most 34 passes over the keys.
#[cfg_attr(eecvs_dsp, inline(never))]
#[cfg_attr(not(eecvs_dsp), inline(always))]
pub fn largest(keys: &[u32], r: usize, kept: &mut Kept) {
    if r >= keys.len() {
        return low_frequency(keys.len(), kept);
    }
    if r == 0 {
        return;
    }
    if keys.len() <= 32 {
        kept.words[0] |= largest_bits(keys, r as u32);
    } else {
        largest_of_many(keys, r, kept);
    }
}

/// As [`largest`], for up to 32 keys: returns a bit per key. `r` is 1 to one less than their number.
#[inline(always)]
#[must_use]
pub(crate) fn largest_bits(keys: &[u32], r: u32) -> u32 {
    // In firmware one function has to do for both sizes, as few pixels come here.
    if !cfg!(eecvs_dsp) && keys.len() <= 16 {
        largest_of::<4>(keys, r)
    } else {
        largest_of::<8>(keys, r)
    }
}

/// As [`largest_bits`], for up to 4W keys.
///
/// Bisects for a value that exactly `r` of the keys reach, on the upper 7 bits of each key, four to a word: after a
/// subtraction the bit above these is left if the key is not below the value. Counting takes the same few
/// instructions whatever the keys are, while the branches and exchanges of a selection take more. Keys whose 7 bits
/// are equal are compared whole.
#[inline(never)]
fn largest_of<const W: usize>(keys: &[u32], r: u32) -> u32 {
    let most = keys.iter().fold(0, |most, key| most | key);
    let shift = 25_u32.saturating_sub(most.leading_zeros());
    let lanes = Lanes::<W>::new(keys, shift);
    // More than r keys reach `low` and fewer reach `high`: all reach 0, and none has an eighth bit.
    let (mut low, mut high) = (0, 128);
    let mut value = FIRST_VALUE;
    loop {
        let reach = lanes.reach(value);
        let count = Lanes::count(&reach);
        if count == r {
            return Lanes::bits(&reach);
        }
        if count > r {
            low = value;
        } else {
            high = value;
        }
        if high - low == 1 {
            break;
        }
        value = low.midpoint(high);
    }
    let mut kept = Lanes::bits(&lanes.reach(high));
    // Lanes without a key reach 0 too.
    let all = u32::MAX >> (32 - keys.len() as u32).min(31);
    let mut equal = Lanes::bits(&lanes.reach(low)) & all & !kept;
    for _ in kept.count_ones()..r {
        let (mut best, mut best_key, mut rest) = (0, 0, equal);
        while rest != 0 {
            let bit = rest & rest.wrapping_neg();
            rest ^= bit;
            let key = keys.get(bit.trailing_zeros() as usize).copied();
            let key = key.unwrap_or_default();
            if best == 0 || key > best_key {
                (best, best_key) = (bit, key);
            }
        }
        kept |= best;
        equal ^= best;
    }
    kept
}

/// First value of the search: squares of magnitudes have their middle far below their largest.
const FIRST_VALUE: u32 = 24;

/// Keys of 7 bits, four to a word, with the highest bit of each byte set.
struct Lanes<const W: usize>([u32; W]);

impl<const W: usize> Lanes<W> {
    const HIGHEST: u32 = 0x8080_8080;

    /// Packs the keys; `shift` leaves 7 bits of each.
    #[inline(always)]
    fn new(keys: &[u32], shift: u32) -> Self {
        let word = |[a, b, c, d]: [u32; 4]| {
            let [a, b, c, d] = [a, b, c, d].map(|key| key >> (shift & 31));
            Self::HIGHEST | a | (b << 8) | (c << 16) | (d << 24)
        };
        let mut words = [Self::HIGHEST; W];
        let (fours, rest) = keys.as_chunks::<4>();
        for (to, keys) in words.iter_mut().zip(fours) {
            *to = word(*keys);
        }
        if !rest.is_empty()
            && let Some(to) = words.get_mut(fours.len())
        {
            let key = |i: usize| rest.get(i).copied().unwrap_or_default();
            *to = word([key(0), key(1), key(2), 0]);
        }
        Self(words)
    }

    /// Returns a 1 in the byte of every key that is at least `value` (0 to 127).
    #[inline(always)]
    fn reach(&self, value: u32) -> [u32; W] {
        let values = value * 0x0101_0101;
        self.0
            .map(|word| (word.wrapping_sub(values) & Self::HIGHEST) >> 7)
    }

    /// Returns how many bytes of `reach` are 1.
    #[inline(always)]
    fn count(reach: &[u32; W]) -> u32 {
        let sum = reach.iter().sum::<u32>();
        sum.wrapping_mul(0x0101_0101) >> 24
    }

    /// Returns a bit for every byte of `reach`.
    #[inline(always)]
    fn bits(reach: &[u32; W]) -> u32 {
        let four = |word: &u32| word.wrapping_mul(0x0102_0408) >> 24;
        reach
            .iter()
            .rev()
            .fold(0, |bits, word| (bits << 4) | four(word))
    }
}

/// As [`largest`], for any number of keys.
#[inline(never)]
fn largest_of_many(keys: &[u32], r: usize, kept: &mut Kept) {
    let at_least = |key: u32| keys.iter().filter(|k| **k >= key).count();
    // Find the r-th largest key bit by bit from the top: the greatest value that r keys reach.
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
