//! Time fields that are too short for a recording and wrap.

/// Extends a wrapping counter of `bits` bits to 64 bits.
///
/// A value that stands at least half a period below the previous one has wrapped. A value that
/// stands almost a whole period above it (the last 1/256) belongs to the period before: events
/// are not always in order, also around a wrap. Everything else is taken as it is, so a large
/// step forwards stays one.
///
/// Writers hold one too, and ask it what a reader will make of the next value.
#[derive(Debug, Clone)]
pub struct Wrapping {
    period: u64,
    base: u64,
    last: Option<u64>,
}

impl Wrapping {
    /// Largest start of [`Wrapping::new`]: leaves room for every wrap that a file can hold.
    pub const START_MAX: u64 = 1 << 60;

    /// Wraps that [`Wrapping::from_zero`] writes: 19 hours of EVT 3, in 24 kB.
    const WRITTEN_PERIODS_MAX: u64 = 1 << 12;

    /// Periods that [`Wrapping::step`] may cross in one gap; a longer gap is refused.
    const GAP_PERIODS_MAX: u64 = 1 << 16;

    /// A counter of `bits` (1 to 32) bits whose first value lies in the period that holds `start`.
    pub fn new(bits: u32, start: u64) -> Self {
        let period = 1 << bits;
        let start = start.min(Self::START_MAX);
        Self {
            period,
            base: start - start % period,
            last: None,
        }
    }

    /// A counter that reaches `start` by wraps from 0 where these are few enough to be written,
    /// so that any reader knows the absolute time; else one whose first period holds `start`,
    /// which a file's header must tell.
    pub fn from_zero(bits: u32, start: u64) -> Self {
        let mut counter = Self::new(bits, start);
        if counter.base > 0 && counter.base / counter.period <= Self::WRITTEN_PERIODS_MAX {
            counter.base = 0;
        }
        counter
    }

    /// Start of the period of the latest value.
    pub fn base(&self) -> u64 {
        self.base
    }

    /// The latest extended value.
    pub fn last(&self) -> Option<u64> {
        self.last
    }

    /// The counter's value as a file holds it.
    pub fn low(&self, extended: u64) -> u64 {
        extended % self.period
    }

    /// Extends the next value, `low < 2^bits`.
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

    /// Next value to write on the way to `target`, so that a reader follows; `None` where no way
    /// leads there (too far back, or a gap of more than 65,536 periods).
    ///
    /// A wrap is written as the period's last value and then 0, which every known decoder takes.
    pub fn step(&mut self, target: u64) -> Option<u64> {
        let next = match self.last {
            None if target - target % self.period == self.base => target,
            None => self.base,
            Some(last) if target <= last => target,
            Some(last) => {
                if (target - last) / self.period > Self::GAP_PERIODS_MAX {
                    return None;
                }
                let top = last - last % self.period + (self.period - 1);
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
