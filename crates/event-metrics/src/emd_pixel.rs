//! Cost of moving the events of one recording onto those of the other, pixel by pixel.
//!
//! For each pixel and polarity, events of A are paired with events of B so as to minimise the sum of |dt| over the
//! pairs, plus T for each event of either side without a partner. Pairs may span windows, so that a constant shift
//! costs exactly that shift per event.
//!
//! Some least-cost matching has no crossing pairs. Walk through the merged times in ascending order, and let w be the
//! number of A's events that wait for a partner, minus the number of B's. While |w| events wait, a gap of length d
//! costs d |w|. An event of A adds 1 to w, an event of B subtracts 1, and a waiting event may give up for a cost of
//! T.
//! The least cost f(w) so far is convex. Its slopes f(w + 1) - f(w) lie within -T..T, because giving up never costs
//! more than T. Only the slopes strictly inside that range are stored, in two stacks:
//!
//! * a gap adds d to the slopes at w >= 0 and subtracts d from those below, clamped to the limits;
//! * an event of A shifts f by 1, so that the uppermost slope below 0 becomes the lowest above: f(0) falls by it;
//! * an event of B shifts f back: f(0) grows by the lowest slope above 0.
//!
//! No event waits at the end, so the cost is f(0). The result is exact and takes O(1) amortised time per event. The
//! state of a pixel can be dropped 2 T after its last event.

use std::collections::{HashMap, VecDeque};

use event_types::{Event, Polarity};

/// A pixel and a polarity.
type Group = (u16, u16, Polarity);

/// Matches event times at the least total cost, over any number of windows.
#[derive(Debug)]
pub struct Matcher {
    /// T, the cost of an event without a partner.
    unmatched_us: u64,
    waiting: HashMap<Group, Waiting>,
    /// Sum of f(0) over all pixels and polarities.
    cost: i128,
    /// Number of groups left after the last call of `forget` that removed groups.
    kept: usize,
}

/// The slopes of f that lie strictly inside -T..T.
#[derive(Debug, Default)]
struct Waiting {
    last_us: u64,
    /// Slopes at w = 0, 1, ..., ascending, with `above_offset` subtracted.
    above: VecDeque<i128>,
    above_offset: i128,
    /// Slopes at w = -1, -2, ..., descending, with `below_offset` subtracted.
    below: VecDeque<i128>,
    below_offset: i128,
}

impl Waiting {
    /// Advances the time to `t_us`.
    fn pass(&mut self, t_us: u64, limit: i128) {
        let gap = i128::from(t_us.saturating_sub(self.last_us));
        self.last_us = self.last_us.max(t_us);
        self.above_offset += gap;
        self.below_offset -= gap;
        let beyond = |slope: &i128| *slope + self.above_offset >= limit;
        while self.above.back().is_some_and(beyond) {
            self.above.pop_back();
        }
        let beyond = |slope: &i128| *slope + self.below_offset <= -limit;
        while self.below.back().is_some_and(beyond) {
            self.below.pop_back();
        }
    }

    /// Adds an event of A or of B and returns the change of f(0).
    fn event(&mut self, is_a: bool, limit: i128) -> i128 {
        if is_a {
            let slope = self.below.pop_front();
            let slope = slope.map_or(-limit, |slope| slope + self.below_offset);
            self.above.push_front(slope - self.above_offset);
            -slope
        } else {
            let slope = self.above.pop_front();
            let slope = slope.map_or(limit, |slope| slope + self.above_offset);
            self.below.push_front(slope - self.below_offset);
            slope
        }
    }
}

impl Matcher {
    /// Creates a matcher in which an event without a partner costs `unmatched_us` (T).
    #[must_use]
    pub fn new(unmatched_us: u64) -> Self {
        Self {
            unmatched_us,
            waiting: HashMap::new(),
            cost: 0,
            kept: 0,
        }
    }

    /// Adds the events of the next window of both recordings, each slice in [`super::frame::pixel_order`].
    ///
    /// No event may be earlier than an event of a window added before.
    pub fn add_window(&mut self, a: &[Event], b: &[Event]) {
        let group = |event: &Event| (event.y, event.x, event.polarity);
        let limit = i128::from(self.unmatched_us);
        let (mut rest_a, mut rest_b) = (a, b);
        let mut earliest_us = u64::MAX;
        let first_group = |events: &[Event]| events.first().map(group);
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
            let waiting = self.waiting.entry(key).or_default();
            let (mut in_a, mut in_b) = (in_a.iter().peekable(), in_b.iter().peekable());
            loop {
                let (t_us, is_a) = match (in_a.peek(), in_b.peek()) {
                    (None, None) => break,
                    (Some(a), None) => (a.t_us, true),
                    (Some(a), Some(b)) if a.t_us <= b.t_us => (a.t_us, true),
                    (_, Some(b)) => (b.t_us, false),
                };
                let _ = if is_a { in_a.next() } else { in_b.next() };
                earliest_us = earliest_us.min(t_us);
                waiting.pass(t_us, limit);
                self.cost += waiting.event(is_a, limit);
            }
        }
        self.forget(earliest_us);
    }

    /// Drops pixels in which no event can still be waiting at `t_us`, once these may outnumber the others.
    fn forget(&mut self, t_us: u64) {
        if self.waiting.len() <= 2 * self.kept + 1024 {
            return;
        }
        let limit = i128::from(self.unmatched_us);
        self.waiting.retain(|_, waiting| {
            waiting.pass(t_us, limit);
            !waiting.above.is_empty() || !waiting.below.is_empty()
        });
        self.kept = self.waiting.len();
    }

    /// Returns the cost of the events added so far, in us, as if no more were to come.
    #[must_use]
    pub fn cost(&self) -> u128 {
        self.cost.unsigned_abs()
    }

    /// Ends the current run of the clock: events that still wait stay without a partner.
    pub fn end_run(&mut self) {
        self.waiting.clear();
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::event;
    use proptest::prelude::*;

    use super::*;
    use crate::frame::pixel_order;

    fn cost(a: &[u64], b: &[u64], unmatched_us: u64) -> u128 {
        let events = |times: &[u64]| {
            let mut events: Vec<_> = times.iter().map(|t| event(*t, 3, 4, true)).collect();
            events.sort_by_key(pixel_order);
            events
        };
        let mut matcher = Matcher::new(unmatched_us);
        matcher.add_window(&events(a), &events(b));
        matcher.cost()
    }

    #[test]
    fn hand_computed() {
        assert_eq!(cost(&[], &[], 1000), 0);
        assert_eq!(cost(&[5], &[], 1000), 1000);
        assert_eq!(cost(&[], &[5, 6], 1000), 2000);
        assert_eq!(cost(&[5], &[9], 1000), 4);
        // Paired in order: 0 with 10 and 10 with 20. Pairing 10 with 10 and 0 with 20 costs the same, 20.
        assert_eq!(cost(&[0, 10], &[10, 20], 1000), 20);
        // 10 pairs with 11, 20 with 19, and 30 is left over.
        assert_eq!(cost(&[10, 20], &[11, 19, 30], 1000), 1002);
        // 11 is nearest to both 10 and 12, but it can be paired with only one of them.
        assert_eq!(cost(&[10, 12], &[11, 100, 200], 1000), 1000 + 1 + 88);
        // A pair more than 2 T apart costs more than two events without partners.
        assert_eq!(cost(&[10], &[210], 100), 200);
        assert_eq!(cost(&[10], &[209], 100), 199);
        assert_eq!(cost(&[10], &[9999], 100), 200);
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
        let mut matcher = Matcher::new(100);
        matcher.add_window(&a, &b);
        // OFF: one pair of cost 2. ON: two events of A and one of B, all in different pixels, are left over.
        assert_eq!(matcher.cost(), 2 + 300);
    }

    #[test]
    fn huge_counts_in_one_pixel_are_exact_and_quick() {
        // B holds every time of A that is not a multiple of 5, so a perfect matching of B costs nothing.
        let a: Vec<u64> = (0..65_535).collect();
        let b: Vec<u64> = a.iter().copied().filter(|t| t % 5 != 0).collect();
        let left = (a.len() - b.len()) as u128;
        assert_eq!(cost(&a, &b, 32_768), left * 32_768);
        // All events of A at 0 against B at 1, 2, 3, ...: the nearest 40,000 events of B are paired.
        let b: Vec<u64> = (1..=65_535).collect();
        let sum = 40_000_u128 * 40_001 / 2;
        let far = 1 << 20;
        assert_eq!(
            cost(&vec![0; 40_000], &b, far),
            sum + 25_535 * u128::from(far)
        );
    }

    #[test]
    fn a_shift_costs_itself_across_windows() {
        let (mut matcher, mut times) = (Matcher::new(1000), 0..);
        let times: Vec<u64> = times.by_ref().take(500).map(|i: u64| i * 117).collect();
        for window in 0..60 {
            let inside = |shift_us: u64| -> Vec<Event> {
                let times = times.iter().map(|t| t + shift_us);
                let times = times.filter(|t| t / 1000 == window);
                times.map(|t| event(t, 3, 4, true)).collect()
            };
            matcher.add_window(&inside(0), &inside(50));
        }
        assert_eq!(matcher.cost(), 500 * 50);
    }

    #[test]
    fn nobody_waits_for_another_run() {
        let mut matcher = Matcher::new(1000);
        matcher.add_window(&[event(500, 3, 4, true)], &[]);
        matcher.end_run();
        matcher.add_window(&[], &[event(510, 3, 4, true)]);
        assert_eq!(matcher.cost(), 2000);
    }

    #[test]
    fn pixels_that_are_done_take_no_memory() {
        let mut matcher = Matcher::new(10);
        for window in 0..2000_u64 {
            let (x, y) = ((window % 64) as u16, (window / 64) as u16);
            let events = [event(window * 100, x, y, true)];
            matcher.add_window(&events, &events);
        }
        assert_eq!(matcher.cost(), 0);
        assert!(matcher.waiting.len() < 1100, "{}", matcher.waiting.len());
    }

    /// Least cost over every way to pair events or leave them without a partner.
    fn exhaustive(a: &[u64], b: &[u64], used: u32, unmatched: u128) -> u128 {
        let Some((first, rest)) = a.split_first() else {
            return (b.len() as u128 - u128::from(used.count_ones())) * unmatched;
        };
        let left = unmatched + exhaustive(rest, b, used, unmatched);
        (0..b.len())
            .filter(|i| used & (1 << i) == 0)
            .map(|i| {
                u128::from(first.abs_diff(b[i])) + exhaustive(rest, b, used | (1 << i), unmatched)
            })
            .fold(left, u128::min)
    }

    proptest! {
        #[test]
        fn equals_exhaustive_assignment(
            a in proptest::collection::vec(0_u64..40, 0..6),
            b in proptest::collection::vec(0_u64..40, 0..6),
            unmatched in 0_u64..30,
        ) {
            prop_assert_eq!(cost(&a, &b, unmatched), exhaustive(&a, &b, 0, unmatched.into()));
        }

        /// D(i, j) is the least cost of the first i events of A and the first j of B; any number of windows.
        #[test]
        fn equals_dynamic_programming(
            mut a in proptest::collection::vec(0_u64..2000, 0..60),
            mut b in proptest::collection::vec(0_u64..2000, 0..60),
            unmatched in 1_u64..1500,
            windows in 1_u64..6,
        ) {
            a.sort_unstable();
            b.sort_unstable();
            let mut best: Vec<u64> = (0..=b.len() as u64).map(|j| j * unmatched).collect();
            for t in &a {
                let mut next = vec![best[0] + unmatched];
                for (j, other) in b.iter().enumerate() {
                    let pair = best[j] + t.abs_diff(*other);
                    next.push(pair.min(best[j + 1] + unmatched).min(next[j] + unmatched));
                }
                best = next;
            }
            let mut matcher = Matcher::new(unmatched);
            let length = 2000_u64.div_ceil(windows);
            for window in 0..windows {
                let inside = |times: &[u64]| -> Vec<Event> {
                    let times = times.iter().filter(|t| **t / length == window);
                    times.map(|t| event(*t, 3, 4, true)).collect()
                };
                matcher.add_window(&inside(&a), &inside(&b));
            }
            prop_assert_eq!(matcher.cost(), u128::from(best[b.len()]));
        }
    }
}
