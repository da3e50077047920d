//! Time counters that are too short for a recording and therefore wrap.

/// Extends a wrapping counter to 64 bits.
///
/// A value at least half a period below the previous one has wrapped. A value more than 255/256 of a period above
/// it belongs to the previous period, since events are not always in order, also around a wrap. Every other value
/// is taken as it is, so a large step forwards stays one.
///
/// Writers use one, too, to find out how a reader will interpret the next value.
#[derive(Debug, Clone)]
pub struct Wrapping {
    /// A power of two.
    period: u64,
    base: u64,
    last: Option<u64>,
}

impl Wrapping {
    /// Largest start that [`Wrapping::new`] takes; it leaves room for every wrap that a file can hold.
    pub const START_MAX: u64 = 1 << 60;

    /// Largest number of wraps that [`Wrapping::from_zero`] makes a writer write: 19 hours of EVT 3, in 24 kB.
    const WRITTEN_PERIODS_MAX: u64 = 1 << 12;

    /// Largest number of periods that [`Wrapping::step`] may cross in one gap; a longer gap is refused.
    const GAP_PERIODS_MAX: u64 = 1 << 16;

    /// Creates a counter of `bits` (1 to 32) bits whose first value lies in the period that contains `start`.
    pub fn new(bits: u32, start: u64) -> Self {
        let period = 1 << bits;
        let start = start.min(Self::START_MAX);
        Self {
            period,
            base: start - start % period,
            last: None,
        }
    }

    /// Creates a writer's counter for times from `start` on. If few enough wraps lead from 0 to `start`, they are
    /// written, so that any reader gets absolute times; otherwise the first period contains `start`, and a file's
    /// header must state it.
    pub fn from_zero(bits: u32, start: u64) -> Self {
        let mut counter = Self::new(bits, start);
        if counter.base > 0 && counter.base / counter.period <= Self::WRITTEN_PERIODS_MAX {
            counter.base = 0;
        }
        counter
    }

    /// Returns the start of the current period.
    pub fn base(&self) -> u64 {
        self.base
    }

    /// Returns the latest extended value; `None` before the first.
    pub fn last(&self) -> Option<u64> {
        self.last
    }

    /// Returns the counter's value in the file for an extended value.
    pub fn low(&self, extended: u64) -> u64 {
        // A division takes many times as long, and writers ask for every value.
        extended & (self.period - 1)
    }

    /// Extends the counter's next value, which must be below 2^`bits`.
    pub fn extend(&mut self, low: u64) -> u64 {
        let value = self.base + low;
        if let Some(last) = self.last {
            if value + self.period / 2 <= last {
                self.base += self.period;
            } else if value > last + (self.period - self.period / 256) && self.base >= self.period {
                self.base -= self.period;
            }
        }
        let value = self.base + low;
        self.last = Some(value);
        value
    }

    /// Returns the next value to write on the way to `target` such that a reader follows. Returns `None` if
    /// `target` cannot be reached: it is too far back, or after a gap of more than 65,536 periods.
    ///
    /// A wrap is written as the period's last value followed by 0, which every known decoder accepts.
    pub fn step(&mut self, target: u64) -> Option<u64> {
        let next = match self.last {
            None if target - self.low(target) == self.base => target,
            None => self.base,
            Some(last) if target <= last => target,
            Some(last) => {
                if (target - last) >> self.period.trailing_zeros() > Self::GAP_PERIODS_MAX {
                    return None;
                }
                let top = last | (self.period - 1);
                if last == top {
                    top + 1
                } else {
                    target.min(top).min(last + self.period / 2)
                }
            }
        };
        (self.extend(self.low(next)) == next).then_some(next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extends_over_wraps_and_small_steps_back() {
        let mut counter = Wrapping::new(12, 0);
        let lows = [4000, 4095, 0, 4094, 3, 2048, 100, 4000];
        let want = [4000, 4095, 4096, 4094, 4099, 6144, 4196, 8096];
        assert_eq!(lows.map(|low| counter.extend(low)), want);
    }

    #[test]
    fn before_the_first_period_nothing_is_unwrapped() {
        let mut counter = Wrapping::new(12, 0);
        assert_eq!([0, 4095].map(|low| counter.extend(low)), [0, 4095]);
    }

    #[test]
    fn few_wraps_are_written_from_zero() {
        let mut writer = Wrapping::from_zero(12, 3 * 4096 + 7);
        let mut reader = Wrapping::new(12, 0);
        while writer.last() != Some(3 * 4096 + 7) {
            let next = writer.step(3 * 4096 + 7).expect("a way leads there");
            assert_eq!(reader.extend(next % 4096), next);
        }
        assert_eq!(Wrapping::from_zero(12, (1 << 40) + 7).base(), 1 << 40);
    }

    #[test]
    fn every_step_is_understood() {
        for (from, to) in [
            (0, 4096),
            (5, 100_000),
            (4095, 4096),
            (8192, 8191),
            (9000, 8999),
        ] {
            let mut writer = Wrapping::new(12, from);
            let mut reader = Wrapping::new(12, from);
            assert_eq!(writer.step(from), Some(from));
            reader.extend(from % 4096);
            while writer.last() != Some(to) {
                let next = writer.step(to).expect("a way leads there");
                assert_eq!(reader.extend(next % 4096), next);
            }
        }
        let mut writer = Wrapping::new(12, 10_000);
        writer.step(10_000);
        assert_eq!(writer.step(5000), None);
        let mut writer = Wrapping::new(12, 0);
        writer.step(0);
        assert_eq!(writer.step(u64::MAX), None);
    }
}
