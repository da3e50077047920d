//! Which coefficients of a pixel are kept.

use heapless::Vec;

use crate::transform::M_MAX;

/// Grid indices of the kept coefficients, ascending.
pub type Kept = Vec<u16, M_MAX>;

/// The first `r` coefficients: the rule of the DCT.
pub fn low_frequency(r: usize, kept: &mut Kept) {
    kept.clear();
    kept.extend((0..r.min(M_MAX)).map(|k| k as u16));
}

/// The `r` largest of `magnitudes`, ties to the lower k.
///
/// `work` is as long as `magnitudes` and is overwritten. O(K): the r-th largest value is selected,
/// everything above it is kept, and the places left go to its equals from k = 0 up.
pub fn largest(magnitudes: &[u64], r: usize, work: &mut [u64], kept: &mut Kept) {
    let r = r.min(M_MAX);
    if r >= magnitudes.len() {
        return low_frequency(magnitudes.len(), kept);
    }
    kept.clear();
    if r == 0 {
        return;
    }
    let work = &mut work[..magnitudes.len()];
    work.copy_from_slice(magnitudes);
    let (_, threshold, _) = work.select_nth_unstable_by(r - 1, |a, b| b.cmp(a));
    let threshold = *threshold;
    let above = magnitudes.iter().filter(|m| **m > threshold).count();
    let mut ties = r - above;
    for (k, magnitude) in magnitudes.iter().enumerate() {
        let keep = if *magnitude == threshold && ties > 0 {
            ties -= 1;
            true
        } else {
            *magnitude > threshold
        };
        if keep {
            // Never full: exactly r <= M_MAX are kept.
            let _ = kept.push(k as u16);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn kept(magnitudes: &[u64], r: usize) -> Kept {
        let mut work = [0; 64];
        let mut kept = Kept::new();
        largest(magnitudes, r, &mut work, &mut kept);
        kept
    }

    #[test]
    fn ties_go_to_the_lower_k() {
        assert_eq!(kept(&[1, 1, 1, 1], 2), [0, 1]);
        assert_eq!(kept(&[0, 5, 1, 5, 5], 2), [1, 3]);
        assert_eq!(kept(&[2, 9, 2, 2], 3), [0, 1, 2]);
        assert_eq!(kept(&[7, 8], 5), [0, 1]);
        assert!(kept(&[], 5).is_empty());
    }

    proptest! {
        #[test]
        fn is_the_stable_sort_by_magnitude(
            magnitudes in proptest::collection::vec(0..6_u64, 1..64), r in 1..=64_usize,
        ) {
            let mut order: std::vec::Vec<usize> = (0..magnitudes.len()).collect();
            order.sort_by_key(|k| std::cmp::Reverse(magnitudes[*k]));
            order.truncate(r);
            order.sort_unstable();
            let found: std::vec::Vec<usize> =
                kept(&magnitudes, r).iter().map(|k| usize::from(*k)).collect();
            prop_assert_eq!(found, order);
        }
    }
}
