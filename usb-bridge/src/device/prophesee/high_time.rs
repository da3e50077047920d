//! The upper bits of time, which wrap: extended by the receiver, and sent in steps that it can follow.

/// The upper bits of time with wraps included.
///
/// A value is taken as the time nearest to the previous one: time words are frequent, and a transfer that arrives
/// twice or late makes time fall by less than half a period. A value further away than [`HighTime::NEAR`] is
/// doubted: its events get it as their time, but the next value is compared with both, so that one damaged word
/// never shifts the wraps for good.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HighTime<const BITS: u32> {
    /// The last value that agreed with another one, or the time given by a clock.
    trusted: Option<u64>,
    /// A later value that did not agree, if any.
    doubted: Option<u64>,
    /// Whether a value has arrived since the stream began or was resumed.
    is_known: bool,
}

impl<const BITS: u32> HighTime<BITS> {
    /// Number of values after which they wrap.
    pub const PERIOD: u64 = 1 << BITS;
    /// Largest step that is accepted at once.
    pub const NEAR: u64 = Self::PERIOD / 8;
    /// Largest value that a clock may give; it leaves room for every wrap.
    const MAX: u64 = 1 << (60 - BITS);

    /// Starts before the first value, which lies in the first period.
    pub const fn new() -> Self {
        Self {
            trusted: None,
            doubted: None,
            is_known: false,
        }
    }

    /// Returns the latest value; `None` before the first, and between a break and the next value.
    pub const fn last(&self) -> Option<u64> {
        match (self.is_known, self.doubted) {
            (false, _) => None,
            (true, None) => self.trusted,
            (true, doubted) => doubted,
        }
    }

    /// Returns whether the latest value agreed with the one before it.
    pub const fn is_trusted(&self) -> bool {
        self.is_known && self.doubted.is_none()
    }

    /// Records a break: the next value is taken as the one nearest to `now`, or else to the last value.
    pub fn resume(&mut self, now: Option<u64>) {
        self.trusted = now.map(|now| now.min(Self::MAX)).or(self.trusted);
        self.doubted = None;
        self.is_known = false;
    }

    /// Takes the next value, which is below [`HighTime::PERIOD`], and returns it with wraps included.
    pub fn extend(&mut self, low: u64) -> u64 {
        self.is_known = true;
        let near = |to: Option<u64>| {
            let value = nearest::<BITS>(to?, low);
            (value.abs_diff(to?) <= Self::NEAR).then_some(value)
        };
        if let Some(value) = near(self.trusted).or_else(|| near(self.doubted)) {
            self.trusted = Some(value);
            self.doubted = None;
            return value;
        }
        // Two values in a row that agree with nothing: the later one is taken relative to the earlier one.
        let value = match (self.trusted, self.doubted) {
            (None, _) => low,
            (Some(_), Some(before)) => {
                self.trusted = Some(before);
                nearest::<BITS>(before, low)
            }
            (Some(before), None) => nearest::<BITS>(before, low),
        };
        self.doubted = Some(value);
        value
    }
}

/// Returns the value with the lower bits `low` that is nearest to `to` and not negative.
fn nearest<const BITS: u32>(to: u64, low: u64) -> u64 {
    let period = HighTime::<BITS>::PERIOD;
    let ahead = low.wrapping_sub(to) & (period - 1);
    if ahead <= period / 2 || to < period - ahead {
        to + ahead
    } else {
        to - (period - ahead)
    }
}

/// A sender's steps from value to value, such that a receiver's [`HighTime`] follows them.
#[derive(Debug, Clone)]
pub struct Way<const BITS: u32> {
    /// The state of a receiver that got the values sent so far.
    shown: HighTime<BITS>,
}

/// The value cannot be reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooFar;

impl<const BITS: u32> Way<BITS> {
    /// Most steps in one go: 2^16 periods.
    const STEPS_MAX: u64 = (1 << 16) * 8;

    /// Starts before the first value.
    pub const fn new() -> Self {
        Self {
            shown: HighTime::new(),
        }
    }

    /// Returns the latest value that a receiver has seen.
    pub const fn last(&self) -> Option<u64> {
        self.shown.last()
    }

    /// Moves to `target`; `word` is called with each value to send. Forwards through a gap of at most `fine`
    /// values, a value is sent every `step`; through a longer gap, and up to the first value, only as many as a
    /// receiver needs.
    ///
    /// # Errors
    /// [`TooFar`]: `target` is back by more than half a period, or ahead by more than 2^16 periods.
    pub fn go(
        &mut self,
        target: u64,
        (step, fine): (u64, u64),
        mut word: impl FnMut(u64),
    ) -> Result<(), TooFar> {
        let near = HighTime::<BITS>::NEAR;
        let gap = target.saturating_sub(self.last().unwrap_or(0));
        if gap / near > Self::STEPS_MAX {
            return Err(TooFar);
        }
        let step = match self.last() {
            Some(_) if gap <= fine => step.min(near),
            _ => near,
        };
        let mut shown = self.shown.clone();
        while shown.last() != Some(target) {
            let next = match shown.last() {
                None if target < HighTime::<BITS>::PERIOD => target,
                None => 0,
                Some(last) if target < last => target,
                Some(last) => target.min(last + step),
            };
            let low = next % HighTime::<BITS>::PERIOD;
            if shown.extend(low) != next {
                return Err(TooFar);
            }
            word(low);
        }
        self.shown = shown;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NEAR: u64 = HighTime::<12>::NEAR;

    fn at(value: u64) -> HighTime<12> {
        let mut time = HighTime::new();
        time.resume(Some(value));
        assert_eq!(time.last(), None);
        assert_eq!(time.extend(value % 4096), value);
        time
    }

    #[test]
    fn values_are_the_nearest() {
        for (from, low, value) in [
            (4095, 0, 4096),
            (4096, 4095, 4095),
            (0, 4095, 4095),
            (5000, 5000 % 4096, 5000),
            (5000, (5000 + 2048) % 4096, 7048),
            (5000, 2953, 2953),
            (3, 2, 2),
            (2047, 4095, 4095),
            (2048, 4095, 4095),
        ] {
            assert_eq!(nearest::<12>(from, low), value, "{from} {low}");
        }
    }

    #[test]
    fn the_first_value_lies_in_the_first_period() {
        assert_eq!(HighTime::<12>::new().extend(4000), 4000);
    }

    proptest! {
        /// Whatever one word says, the next one is right.
        #[test]
        fn one_damaged_value_moves_nothing(
            start in 4096..1_u64 << 40, damaged in 0..4096_u64, step in 0..=NEAR,
        ) {
            let mut time = at(start);
            time.extend(damaged);
            for after in [start + step, start + step + 1, start + step + 2] {
                prop_assert_eq!(time.extend(after % 4096), after);
            }
            prop_assert!(time.is_trusted());
        }

        /// After a break the wraps follow a clock that is off by less than half a period.
        #[test]
        fn a_clock_tells_the_wrap(
            before in 0..1_u64 << 40, now in 4096..1_u64 << 40, off in -2000..2000_i64,
        ) {
            let mut time = at(before);
            time.resume(Some(now.saturating_add_signed(off)));
            prop_assert_eq!(time.extend(now % 4096), now);
            prop_assert_eq!(time.extend((now + 1) % 4096), now + 1);
            prop_assert!(time.is_trusted());
        }

        #[test]
        fn a_receiver_follows_the_way(
            start in 0..1_u64 << 24,
            steps in proptest::collection::vec(
                prop_oneof![-2040..2040_i64, 0..3_i64, 0..1_000_000_i64], 0..40),
            step in 1..5000_u64,
        ) {
            let (mut way, mut receiver) = (Way::<12>::new(), HighTime::<12>::new());
            let mut target = start;
            for by in std::iter::once(0).chain(steps) {
                let from = target;
                target = target.saturating_add_signed(by);
                let mut last = receiver.last();
                let gone = way.go(target, (step, 1 << 20), |low| last = Some(receiver.extend(low)));
                if gone.is_err() {
                    prop_assert!(target < from);
                    return Ok(());
                }
                prop_assert_eq!(last, Some(target));
            }
        }

        #[test]
        fn any_values_are_survived(
            values in proptest::collection::vec((0..4096_u64, proptest::option::of(any::<u64>())), 0..200),
        ) {
            let mut time = HighTime::<12>::new();
            for (low, now) in values {
                let value = time.extend(low);
                prop_assert_eq!(value % 4096, low);
                prop_assert_eq!(time.last(), Some(value));
                if let Some(now) = now {
                    time.resume(Some(now));
                }
            }
        }
    }

    #[test]
    fn what_is_too_far_is_refused() {
        let mut way = Way::<12>::new();
        assert_eq!(way.go(1 << 40, (1, 1), |_| ()), Err(TooFar));
        assert_eq!(way.go(1 << 20, (1, 1), |_| ()), Ok(()));
        assert_eq!(way.go((1 << 20) - 3000, (1, 1), |_| ()), Err(TooFar));
        // A refused move changes nothing that a receiver would follow.
        assert_eq!(way.last(), Some(1 << 20));
        assert_eq!(way.go((1 << 20) + (1 << 20), (1, 1 << 20), |_| ()), Ok(()));
    }
}
