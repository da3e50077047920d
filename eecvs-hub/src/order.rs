//! Tracks which of a sensor's frames have arrived, which are missing, and which are lost.

use std::collections::BTreeMap;

use crate::message::Range;

/// Maximum number of gaps of missing numbers; beyond it, the oldest gap is given up.
pub const GAPS_MAX: usize = 4096;

/// The frame numbers of one run of a sensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Numbers {
    /// Numbers below this one are ignored.
    first: u64,
    /// All numbers below this one have arrived, are missing, or were given up.
    next: u64,
    /// The gaps: first missing number to one past the last; none is empty or touches another.
    missing: BTreeMap<u64, u64>,
    /// Number of missing frames.
    missing_count: u64,
    received: u64,
    needless: u64,
    lost: u64,
    passed: u64,
}

impl Numbers {
    /// Starts to count at a number.
    #[must_use]
    pub const fn from(first: u64) -> Self {
        Self {
            first,
            next: first,
            missing: BTreeMap::new(),
            missing_count: 0,
            received: 0,
            needless: 0,
            lost: 0,
            passed: 0,
        }
    }

    /// Records a frame that has arrived; returns whether it is useful: it had not arrived before and was not given
    /// up.
    pub fn take(&mut self, number: u64) -> bool {
        let is_new = if number >= self.next && number < u64::MAX {
            self.until(number);
            self.next = number + 1;
            true
        } else {
            self.found(number)
        };
        if is_new {
            self.received += 1;
        } else {
            self.needless += 1;
        }
        is_new
    }

    /// Removes a number from the missing ones; returns whether it was among them.
    fn found(&mut self, number: u64) -> bool {
        let Some((&from, &to)) = self.missing.range(..=number).next_back() else {
            return false;
        };
        if number >= to {
            return false;
        }
        self.missing.remove(&from);
        if from < number {
            self.missing.insert(from, number);
        }
        if number + 1 < to {
            self.missing.insert(number + 1, to);
        }
        self.missing_count -= 1;
        self.bound();
        true
    }

    /// Records that all numbers below `next` exist: those that have not arrived are missing.
    pub fn until(&mut self, next: u64) {
        if next <= self.next {
            return;
        }
        match self.missing.last_entry() {
            Some(mut last) if *last.get() == self.next => {
                last.insert(next);
            }
            _ => {
                self.missing.insert(self.next, next);
            }
        }
        self.missing_count += next - self.next;
        self.next = next;
        self.bound();
    }

    fn bound(&mut self) {
        while self.missing.len() > GAPS_MAX {
            let Some((from, to)) = self.missing.pop_first() else {
                return;
            };
            self.missing_count -= to - from;
            self.lost = self.lost.saturating_add(to - from);
        }
    }

    /// Gives up the missing numbers in a range; returns how many there were.
    pub fn give_up(&mut self, range: Range) -> u64 {
        let lost = self.remove(range);
        self.lost = self.lost.saturating_add(lost);
        lost
    }

    /// Passes over the missing numbers in a range, which are no longer wanted and not lost; returns how many there
    /// were.
    pub fn pass(&mut self, range: Range) -> u64 {
        let passed = self.remove(range);
        self.passed = self.passed.saturating_add(passed);
        passed
    }

    /// Removes the numbers in a range from the missing ones; returns how many there were.
    fn remove(&mut self, range: Range) -> u64 {
        let mut removed = 0;
        if range.from >= range.to {
            return 0;
        }
        let start = self.missing.range(..=range.from).next_back();
        let start = start.map_or(range.from, |(&from, _)| from);
        let touched: Vec<(u64, u64)> = self
            .missing
            .range(start..range.to.max(start))
            .map(|(&from, &to)| (from, to))
            .filter(|&(_, to)| to > range.from)
            .collect();
        for (from, to) in touched {
            self.missing.remove(&from);
            if from < range.from {
                self.missing.insert(from, range.from);
            }
            if to > range.to {
                self.missing.insert(range.to, to);
            }
            removed += to.min(range.to) - from.max(range.from);
        }
        self.missing_count -= removed;
        removed
    }

    /// Returns the number below which all frames have arrived or are lost.
    #[must_use]
    pub fn settled(&self) -> u64 {
        self.missing.keys().next().map_or(self.next, |&from| from)
    }

    /// Returns the number after the highest known one.
    #[must_use]
    pub const fn next(&self) -> u64 {
        self.next
    }

    /// Returns the number at which counting began.
    #[must_use]
    pub const fn first(&self) -> u64 {
        self.first
    }

    /// Returns the gaps of missing numbers, the oldest first, at most `most` of them.
    #[must_use]
    pub fn gaps(&self, most: usize) -> Vec<Range> {
        let gaps = self.missing.iter().take(most);
        gaps.map(|(&from, &to)| Range { from, to }).collect()
    }

    /// Returns how many frames have not arrived and were not given up.
    #[must_use]
    pub const fn missing(&self) -> u64 {
        self.missing_count
    }

    /// Returns how many frames have arrived, each counted once.
    #[must_use]
    pub const fn received(&self) -> u64 {
        self.received
    }

    /// Returns how many frames arrived again, after they were given up, or from before the first number.
    #[must_use]
    pub const fn needless(&self) -> u64 {
        self.needless
    }

    /// Returns how many frames were given up.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// Returns how many frames were passed over.
    #[must_use]
    pub const fn passed(&self) -> u64 {
        self.passed
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn what_comes_late_is_not_missing() {
        let mut numbers = Numbers::from(5);
        assert!(numbers.take(5) && numbers.take(9));
        assert_eq!(numbers.gaps(9), [Range { from: 6, to: 9 }]);
        assert_eq!((numbers.missing(), numbers.settled()), (3, 6));
        assert!(numbers.take(7) && !numbers.take(7) && !numbers.take(2));
        let gaps = [Range { from: 6, to: 7 }, Range { from: 8, to: 9 }];
        assert_eq!(numbers.gaps(9), gaps);
        assert_eq!(numbers.gaps(1), gaps[..1]);
        assert_eq!(numbers.give_up(Range { from: 0, to: 7 }), 1);
        assert_eq!((numbers.lost(), numbers.settled()), (1, 8));
        assert_eq!(numbers.give_up(Range { from: 9, to: 7 }), 0);
        assert!(numbers.take(8) && !numbers.take(6));
        assert_eq!(
            (numbers.settled(), numbers.received(), numbers.needless()),
            (10, 4, 3)
        );
        numbers.until(12);
        assert_eq!(numbers.gaps(9), [Range { from: 10, to: 12 }]);
        numbers.until(13);
        assert_eq!(numbers.gaps(9), [Range { from: 10, to: 13 }]);
    }

    #[test]
    fn no_number_overflows() {
        let mut numbers = Numbers::from(0);
        assert!(!numbers.take(u64::MAX));
        assert!(numbers.take(u64::MAX - 1));
        numbers.until(u64::MAX);
        assert_eq!(numbers.missing(), u64::MAX - 1);
        let all = Range {
            from: 0,
            to: u64::MAX,
        };
        assert_eq!(numbers.give_up(all), u64::MAX - 1);
        assert_eq!(numbers.lost(), u64::MAX - 1);
    }

    #[test]
    fn gaps_are_bounded() {
        let mut numbers = Numbers::from(0);
        for number in 0..3 * GAPS_MAX as u64 {
            numbers.take(2 * number + 1);
        }
        assert_eq!(numbers.gaps(usize::MAX).len(), GAPS_MAX);
        assert_eq!(numbers.lost(), 2 * GAPS_MAX as u64);
        assert_eq!(numbers.missing(), GAPS_MAX as u64);
    }

    #[derive(Debug, Clone)]
    enum Step {
        Take(u64),
        Until(u64),
        GiveUp(u64, u64),
        Pass(u64, u64),
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            4 => (0_u64..60).prop_map(Step::Take),
            1 => (0_u64..60).prop_map(Step::Until),
            1 => (0_u64..60, 0_u64..9).prop_map(|(from, more)| Step::GiveUp(from, from + more)),
            1 => (0_u64..60, 0_u64..9).prop_map(|(from, more)| Step::Pass(from, from + more)),
        ]
    }

    proptest! {
        /// Compares the gaps with plain sets of numbers.
        #[test]
        fn numbers_are_accounted_for(first in 0_u64..20, steps in prop::collection::vec(step(), 0..80)) {
            let mut numbers = Numbers::from(first);
            let (mut missing, mut come, mut lost) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
            let mut passed = BTreeSet::new();
            let mut next = first;
            for step in steps {
                match step {
                    Step::Take(number) => {
                        let is_new = number >= next || missing.contains(&number);
                        missing.extend(next..number);
                        next = next.max(number + 1);
                        missing.remove(&number);
                        prop_assert_eq!(numbers.take(number), is_new);
                        if is_new { come.insert(number); }
                    }
                    Step::Until(to) => {
                        missing.extend(next..to);
                        next = next.max(to);
                        numbers.until(to);
                    }
                    Step::GiveUp(from, to) => {
                        let given: Vec<u64> = missing.range(from..to).copied().collect();
                        prop_assert_eq!(numbers.give_up(Range { from, to }), given.len() as u64);
                        for number in given { missing.remove(&number); lost.insert(number); }
                    }
                    Step::Pass(from, to) => {
                        let given: Vec<u64> = missing.range(from..to).copied().collect();
                        prop_assert_eq!(numbers.pass(Range { from, to }), given.len() as u64);
                        for number in given { missing.remove(&number); passed.insert(number); }
                    }
                }
                let gaps: BTreeSet<u64> = numbers.gaps(usize::MAX).iter()
                    .flat_map(|range| range.from..range.to).collect();
                prop_assert_eq!(&gaps, &missing);
                prop_assert_eq!(numbers.missing(), missing.len() as u64);
                prop_assert_eq!(numbers.received(), come.len() as u64);
                prop_assert_eq!(numbers.lost(), lost.len() as u64);
                prop_assert_eq!(numbers.settled(), missing.first().copied().unwrap_or(next));
                prop_assert_eq!(numbers.next(), next);
                prop_assert_eq!(numbers.passed(), passed.len() as u64);
                let known = numbers.received() + numbers.missing() + numbers.lost() + numbers.passed();
                prop_assert_eq!(known, next - first);
            }
        }
    }
}
