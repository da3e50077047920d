//! Cost of moving the events of one recording onto those of the other, pixel by pixel.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use eecvs_nostd::Event;

/// Matches event times at the least cost; holds the buffers between calls.
#[derive(Debug, Default)]
pub struct Matcher {
    few: Vec<u64>,
    many: Vec<u64>,
    below: BinaryHeap<i128>,
    above: BinaryHeap<Reverse<i128>>,
}

impl Matcher {
    /// Sum over the pixels and polarities of a window, in us.
    ///
    /// Per pixel and polarity min(a, b) pairs, chosen so that the sum of |dt| is least; each
    /// pair costs |dt| and each event left over, of either side, `window_us`. Both windows must
    /// be in [`super::frame::pixel_order`]. `emd_pixel_us` = this, summed over the windows,
    /// / events of A.
    ///
    /// Exact; O(n log n) time and O(n) memory for n events of a pixel, whatever their counts.
    #[must_use]
    pub fn window_cost(&mut self, a: &[Event], b: &[Event], window_us: u64) -> u128 {
        let group = |event: &Event| (event.y, event.x, event.polarity);
        let first_group = |events: &[Event]| events.first().map(group);
        let (mut rest_a, mut rest_b) = (a, b);
        let mut cost = 0;
        while let Some(key) = first_group(rest_a)
            .into_iter()
            .chain(first_group(rest_b))
            .min()
        {
            let len_a = rest_a.iter().take_while(|e| group(e) == key).count();
            let len_b = rest_b.iter().take_while(|e| group(e) == key).count();
            let (in_a, after_a) = rest_a.split_at(len_a);
            let (in_b, after_b) = rest_b.split_at(len_b);
            (rest_a, rest_b) = (after_a, after_b);
            cost += len_a.abs_diff(len_b) as u128 * u128::from(window_us);
            if len_a == 0 || len_b == 0 {
                continue;
            }
            self.few.clear();
            self.many.clear();
            let (few, many) = if len_a <= len_b {
                (in_a, in_b)
            } else {
                (in_b, in_a)
            };
            self.few.extend(few.iter().map(|e| e.t_us));
            self.many.extend(many.iter().map(|e| e.t_us));
            cost += self.least_cost();
        }
        cost
    }

    /// Least sum of |dt| that pairs every time of `few` with one of `many`; both are sorted.
    fn least_cost(&mut self) -> u128 {
        if self.few.len() == self.many.len() {
            // On a line the pairs of an optimal assignment do not cross.
            let pairs = self.few.iter().zip(&self.many);
            return pairs.map(|(f, m)| u128::from(f.abs_diff(*m))).sum();
        }
        self.slope_trick()
    }

    /// Walks the merged times from left to right. Let v be the number of `few` met so far minus
    /// the number of `many` chosen so far: |v| pairs span the gap to the next time, so the cost
    /// is the sum over the gaps of length * |v|. The least cost f(v) is convex, and only its
    /// slopes f(v+1) - f(v) are kept: those at v < 0 in `below`, those at v >= 0 in `above`, each
    /// with an offset common to all its entries.
    ///
    /// * a gap of length d adds d|v|: -d to `below`, +d to `above`;
    /// * a time of `few` turns f(v) into f(v-1): the largest slope of `below` moves to `above`;
    /// * a time of `many` may be chosen, f(v) = min(f(v), f(v+1)): a slope 0 joins the sorted
    ///   slopes, and `below` gains one entry.
    ///
    /// The answer is `f(0) = f(v_max) - sum of above`, where `v_max` chooses nothing.
    fn slope_trick(&mut self) -> u128 {
        self.below.clear();
        self.above.clear();
        let (mut below_offset, mut above_offset) = (0_i128, 0_i128);
        // Slopes of minus infinity in `above`: values v below the least that can be reached.
        let mut unreachable = 0_usize;
        let mut v_max = 0_i128;
        let mut cost_at_v_max = 0_i128;
        let mut previous = None;
        let (mut few, mut many) = (self.few.iter().peekable(), self.many.iter().peekable());
        loop {
            let (t, is_few) = match (few.peek(), many.peek()) {
                (None, None) => break,
                (Some(f), Some(m)) if f <= m => (**f, true),
                (Some(f), None) => (**f, true),
                (_, Some(m)) => (**m, false),
            };
            let gap = i128::from(t) - i128::from(previous.unwrap_or(t));
            previous = Some(t);
            below_offset -= gap;
            above_offset += gap;
            cost_at_v_max += gap * v_max;
            if is_few {
                few.next();
                v_max += 1;
                match self.below.pop() {
                    Some(slope) => {
                        let slope = slope + below_offset;
                        self.above.push(Reverse(slope - above_offset));
                    }
                    None => unreachable += 1,
                }
                continue;
            }
            many.next();
            if unreachable > 0 {
                unreachable -= 1;
                self.above.push(Reverse(-above_offset));
                continue;
            }
            let least = self.above.peek().map(|slope| slope.0 + above_offset);
            let Some(least) = least.filter(|slope| *slope < 0) else {
                self.below.push(-below_offset);
                continue;
            };
            self.above.pop();
            self.below.push(least - below_offset);
            self.above.push(Reverse(-above_offset));
        }
        let above: i128 = self.above.iter().map(|slope| slope.0 + above_offset).sum();
        (cost_at_v_max - above).unsigned_abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::frame::pixel_order;
    use crate::metrics::memory_reader::event;
    use proptest::prelude::*;

    fn cost(a: &[u64], b: &[u64], window_us: u64) -> u128 {
        let events = |times: &[u64]| {
            let mut events: Vec<_> = times.iter().map(|t| event(*t, 3, 4, true)).collect();
            events.sort_by_key(pixel_order);
            events
        };
        Matcher::default().window_cost(&events(a), &events(b), window_us)
    }

    #[test]
    fn hand_computed() {
        assert_eq!(cost(&[], &[], 1000), 0);
        assert_eq!(cost(&[5], &[], 1000), 1000);
        assert_eq!(cost(&[], &[5, 6], 1000), 2000);
        assert_eq!(cost(&[5], &[9], 1000), 4);
        // In order: 0-10 and 10-20, not 10-10 and 0-20, which costs the same 20.
        assert_eq!(cost(&[0, 10], &[10, 20], 1000), 20);
        // 10 pairs with 11 and 20 with 19: 30 is left over.
        assert_eq!(cost(&[10, 20], &[11, 19, 30], 1000), 1002);
        // The nearest to both 10 and 12 is 11, but it can serve only one of them.
        assert_eq!(cost(&[10, 12], &[11, 100, 200], 1000), 1000 + 1 + 88);
    }

    #[test]
    fn pixels_and_polarities_are_apart() {
        let mut a = [
            event(5, 1, 1, true),
            event(5, 1, 1, false),
            event(9, 2, 1, true),
        ];
        let mut b = [event(7, 1, 1, false), event(9, 1, 2, true)];
        a.sort_by_key(pixel_order);
        b.sort_by_key(pixel_order);
        // OFF: a pair of cost 2. One ON of A in each of two pixels and one of B are left over.
        assert_eq!(Matcher::default().window_cost(&a, &b, 100), 2 + 300);
    }

    #[test]
    fn huge_counts_in_one_pixel_are_exact_and_quick() {
        // B is every A time that is not a multiple of 5, so a perfect matching costs nothing.
        let a: Vec<u64> = (0..65_535).collect();
        let b: Vec<u64> = a.iter().copied().filter(|t| t % 5 != 0).collect();
        let left = (a.len() - b.len()) as u128;
        assert_eq!(cost(&a, &b, 32_768), left * 32_768);
        // All of A at 0 against B at 1, 2, 3, ...: the nearest 40,000 of B are taken.
        let b: Vec<u64> = (1..=65_535).collect();
        let sum = 40_000_u128 * 40_001 / 2;
        assert_eq!(cost(&vec![0; 40_000], &b, 7), sum + 25_535 * 7);
    }

    /// Least cost over every way to choose pairs.
    fn exhaustive(few: &[u64], many: &[u64], used: u32) -> u128 {
        let Some((first, rest)) = few.split_first() else {
            return 0;
        };
        (0..many.len())
            .filter(|i| used & (1 << i) == 0)
            .map(|i| u128::from(first.abs_diff(many[i])) + exhaustive(rest, many, used | (1 << i)))
            .min()
            .unwrap()
    }

    proptest! {
        #[test]
        fn equals_exhaustive_assignment(
            a in proptest::collection::vec(0_u64..40, 0..6),
            b in proptest::collection::vec(0_u64..40, 0..7),
        ) {
            let (few, many) = if a.len() <= b.len() { (&a, &b) } else { (&b, &a) };
            let left = (many.len() - few.len()) as u128 * 1000;
            prop_assert_eq!(cost(&a, &b, 1000), exhaustive(few, many, 0) + left);
        }

        /// D(i, j): the first i of the few matched within the first j of the many.
        #[test]
        fn equals_dynamic_programming(
            a in proptest::collection::vec(0_u64..2000, 0..60),
            b in proptest::collection::vec(0_u64..2000, 0..60),
        ) {
            let (mut few, mut many) = if a.len() <= b.len() { (a, b) } else { (b, a) };
            few.sort_unstable();
            many.sort_unstable();
            let mut best = vec![0_u128; many.len() + 1];
            for (i, f) in few.iter().enumerate() {
                let mut next = vec![u128::MAX / 2; many.len() + 1];
                for j in i + 1..=many.len() {
                    let pair = best[j - 1] + u128::from(f.abs_diff(many[j - 1]));
                    next[j] = pair.min(next[j - 1]);
                }
                best = next;
            }
            let left = (many.len() - few.len()) as u128 * 5000;
            prop_assert_eq!(cost(&few, &many, 5000), best[many.len()] + left);
        }
    }
}
