//! Extends the time of a device that counts in few bits, through wraps, resets and losses.
//!
//! ```text
//! time = base + low        low < period, in ticks of the device
//! ```
//!
//! A wrap adds a number of periods to the base. All times have 64 bits: only a stream of 2^62 ticks would stop the
//! clock, which then stays there.
//!
//! | what happens | what the clock does |
//! |---|---|
//! | the stream begins without a word of time | the counter is 0: a device sends no word for that
//! | the device resets its counter | time continues from the last time seen: base = now |
//! | low falls by more than half a period without a wrap | a wrap is missing: base += period |
//! | low falls by less | it is taken as it is: time runs back by at most half a period, until the next time word |
//! | bytes are lost, the host's time is known | the time nearest to it that low allows, or the first wrap after it |
//! | bytes are lost, nothing else is known | the next time that low allows, not before the last one |
//!
//! Some errors cannot be detected without the host's time. A lost or forged wrap shifts what follows by whole
//! periods. A forged reset shifts it by less than one period. If a device was quiet for longer than a period, a
//! lost wrap leaves no trace in what follows. The next loss that comes with the host's time ([`Clock::lose`]) ends
//! the first two errors: the phase from before a reset is kept until then. It is restored if it fits better than
//! the phase after the reset, or if it fits and there were other signs of damage: time that ran back, misaligned
//! words, or a counter that did not restart. A lost reset leaves times up to half a period off. The host's time is
//! accurate enough if it is off by less than half a period, or after a reset by less than a quarter.

/// Largest base; it leaves room for every sum below.
const BASE_MAX: u64 = 1 << 62;

/// A counter of few bits, extended to 64.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    /// Number of ticks after which the counter wraps: a power of two.
    period: u64,
    /// Time at which the counter was 0.
    base: u64,
    /// Latest time.
    now: u64,
    /// Least time that [`Clock::take`] accepts: `now`, or a maximum that forces [`Clock::settle`].
    floor: u64,
    /// Whether the stream has only begun: no time was seen, and nothing was lost.
    begins: bool,
    /// Whether any time was seen.
    seen: bool,
    /// The host's time at a loss.
    anchor: Option<u64>,
    /// State before the first reset since the last comparison with the host's time.
    before_reset: Option<BeforeReset>,
    /// Whether words were damaged since then, so that a reset may be one of them.
    damaged: bool,
}

/// The counter before a reset, in case the reset was forged.
#[derive(Debug, Clone, Copy)]
struct BeforeReset {
    base: u64,
    /// The counter's low part at the reset, until the next low part is compared with it.
    low: Option<u64>,
    /// The counter seems to have run on: resets came in a row, or the low part did not restart.
    ran_on: bool,
}

/// What became of a low part that [`Clock::take`] refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Settled {
    /// It is the first time after a start, a loss or a reset.
    Found,
    /// It fell by more than half a period: a wrap is missing before it.
    Wrapped,
    /// It fell by less, and is taken as it is.
    Back,
}

impl Clock {
    /// Creates a clock for a counter of `bits` bits (1 to 32) that has not been read yet.
    #[must_use]
    pub const fn new(bits: u32) -> Self {
        Self {
            period: 1 << bits,
            base: 0,
            now: 0,
            floor: u64::MAX,
            begins: true,
            seen: false,
            anchor: None,
            before_reset: None,
            damaged: false,
        }
    }

    /// Returns the latest time, in ticks of the device.
    #[must_use]
    pub const fn now(&self) -> u64 {
        self.now
    }

    /// Returns the latest time, in ticks of the device; `None` before the first.
    #[must_use]
    pub const fn time(&self) -> Option<u64> {
        if self.seen { Some(self.now) } else { None }
    }

    /// Returns whether [`Clock::now`] is the time of what follows.
    #[must_use]
    pub const fn is_known(&self) -> bool {
        self.floor != u64::MAX
    }

    /// Takes 0 for the time of what follows if the stream has only begun. Returns whether it has.
    #[cold]
    pub const fn infer_zero(&mut self) -> bool {
        let begins = self.begins;
        if begins {
            self.know(0);
        }
        begins
    }

    /// Returns whether a low part that [`Clock::take`] refused makes time run back.
    #[must_use]
    pub const fn runs_back(&self, low: u64) -> bool {
        self.is_known() && self.base + low < self.now
    }

    /// Takes the next low part. Returns `false` if it was refused and [`Clock::settle`] must take it.
    #[inline(always)]
    pub fn take(&mut self, low: u64) -> bool {
        let time = self.base + low;
        let runs_on = time >= self.floor;
        if runs_on {
            self.now = time;
            self.floor = time;
        }
        runs_on
    }

    /// Takes a low part that [`Clock::take`] refused.
    #[cold]
    pub fn settle(&mut self, low: u64) -> Settled {
        let settled = if self.is_known() && !self.runs_back(low) {
            self.compare_reset(low);
            Settled::Found
        } else if self.is_known() {
            self.damaged = true;
            if self.now - (self.base + low) > self.period / 2 {
                self.base += self.period;
                Settled::Wrapped
            } else {
                Settled::Back
            }
        } else {
            self.find(low, false);
            Settled::Found
        };
        self.know(self.base + low);
        settled
    }

    /// Records that the counter wrapped `count` times.
    #[cold]
    pub fn wrap(&mut self, count: u64) {
        // A counter that restarted does not wrap so soon after its reset.
        if let Some(before) = &mut self.before_reset
            && let Some(last) = before.low.take()
        {
            before.ran_on |= count == 1 && last > self.period / 2;
        }
        if self.is_known() || self.begins {
            self.base = (self.base + count * self.period).min(BASE_MAX);
            self.know(self.base.max(self.now));
        } else if let Some(anchor) = self.anchor {
            // The counter is 0 now. The wrap before this one was at the anchor at the latest, so this wrap is in
            // (anchor, anchor + period], or later by one period for each further wrap it counts.
            let ticks = (count * self.period).saturating_sub(self.period / 2 - 1);
            self.anchor = Some((anchor + ticks).min(BASE_MAX));
            self.find(0, true);
            self.now = self.base;
            self.seen = true;
        } else {
            self.base = (self.base + count * self.period).min(BASE_MAX);
            self.now = self.now.max(self.base);
        }
    }

    /// Records that the counter restarts at 0 now.
    #[cold]
    pub fn reset(&mut self) {
        if let Some(before) = &mut self.before_reset {
            before.ran_on = true;
        } else if self.seen {
            self.before_reset = Some(BeforeReset {
                base: self.base,
                low: self.is_known().then(|| self.now - self.base),
                // A reset between a loss and the next time is likely part of the damage.
                ran_on: !self.is_known(),
            });
        }
        if let Some(anchor) = self.anchor.take() {
            self.now = anchor;
        }
        self.base = self.now.min(BASE_MAX);
        self.know(self.base);
        // Forces the next low part through `settle`.
        self.floor = u64::MAX - 1;
    }

    /// Records a loss: time is unknown until the next low part. `host` is the device time by the host's clock.
    #[cold]
    pub fn lose(&mut self, host: Option<u64>) {
        self.begins = false;
        self.floor = u64::MAX;
        if let Some(host) = host {
            self.anchor = Some(host.min(BASE_MAX));
        }
    }

    /// Records that words were misaligned: time is unknown. What this clock took from them has been undone.
    #[cold]
    pub fn lose_misaligned(&mut self) {
        self.damaged = true;
        self.lose(None);
    }

    const fn know(&mut self, time: u64) {
        self.begins = false;
        self.now = time;
        self.floor = time;
        self.seen = true;
    }

    /// Compares the first low part after a reset with the last one before it: if the counter restarted, it is
    /// nearer to 0; if it ran on, it is nearer to the previous one.
    fn compare_reset(&mut self, low: u64) {
        let period = self.period;
        if let Some(before) = &mut self.before_reset
            && let Some(last) = before.low.take()
        {
            before.ran_on |= low.wrapping_sub(last) % period < low;
        }
    }

    /// Sets the base from the first low part after a loss, or from a wrap (low part 0).
    fn find(&mut self, low: u64, is_wrap: bool) {
        let Some(anchor) = self.anchor.take() else {
            let time = self.base + low;
            let missing = self.now.saturating_sub(time).div_ceil(self.period);
            self.base = (self.base + missing * self.period).min(BASE_MAX);
            return;
        };
        let mut time = self.nearest(self.base.wrapping_add(low), anchor);
        let damaged = std::mem::take(&mut self.damaged);
        if let Some(before) = self.before_reset.take() {
            let other = self.nearest(before.base.wrapping_add(low), anchor);
            let off = other.abs_diff(anchor);
            // A reset with nothing between it and the loss is taken as part of the damage.
            let doubted = before.ran_on || before.low.is_some() || damaged;
            let may_be = doubted && (is_wrap || off <= self.period / 4);
            if may_be || off < time.abs_diff(anchor) {
                time = other;
            }
        }
        // There is no time before the counter's own 0.
        if time < low {
            time += self.period;
        }
        self.base = time - low;
    }

    /// Returns the time nearest to `anchor` that differs from `any` by whole periods.
    fn nearest(&self, any: u64, anchor: u64) -> u64 {
        let above = anchor.wrapping_sub(any) % self.period;
        if above > self.period / 2 || above > anchor {
            anchor + (self.period - above)
        } else {
            anchor - above
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn low(clock: &mut Clock, low: u64) -> u64 {
        if !clock.take(low) {
            clock.settle(low);
        }
        clock.now()
    }

    #[test]
    fn wraps_add_their_multiplier() {
        let mut clock = Clock::new(15);
        assert_eq!(clock.time(), None);
        assert_eq!(low(&mut clock, 5), 5);
        clock.wrap(4095);
        clock.wrap(2);
        assert_eq!(clock.now(), 4097 << 15);
        assert_eq!(low(&mut clock, 7), (4097 << 15) + 7);
        for _ in 0..10 {
            clock.wrap(u64::from(u32::MAX));
        }
        assert_eq!(
            low(&mut clock, 7),
            (4097 << 15) + ((10 * u64::from(u32::MAX)) << 15) + 7
        );
    }

    #[test]
    fn a_reset_goes_on_from_the_last_time() {
        let mut clock = Clock::new(15);
        assert_eq!(low(&mut clock, 1000), 1000);
        clock.reset();
        assert_eq!(clock.now(), 1000);
        assert_eq!(low(&mut clock, 3), 1003);
    }

    #[test]
    fn a_fall_is_a_missing_wrap_or_taken_as_it_is() {
        let mut clock = Clock::new(15);
        low(&mut clock, 30_000);
        assert!(!clock.take(10) && clock.settle(10) == Settled::Wrapped);
        assert_eq!(clock.now(), 32_768 + 10);
        low(&mut clock, 10_000);
        assert!(!clock.take(9_990) && clock.settle(9_990) == Settled::Back);
        assert_eq!(clock.now(), 32_768 + 9_990);
    }

    #[test]
    fn after_a_loss_time_is_the_nearest_to_the_hosts() {
        for (before, host, next, want) in [
            (0, 0, 40, 40),
            (100, 5 << 15, 40, (5 << 15) + 40),
            (100, (5 << 15) + 40, 32_767, (5 << 15) - 1),
            (100, (5 << 15) - 40, 10, (5 << 15) + 10),
            // There is no time before the counter's own 0.
            (100, 10, 32_767, 32_767),
            (9, 1 << 40, 3, (1 << 40) + 3),
        ] {
            let mut clock = Clock::new(15);
            low(&mut clock, before);
            clock.lose(Some(host));
            assert!(!clock.is_known());
            assert_eq!(low(&mut clock, next), want);
        }
    }

    #[test]
    fn without_the_hosts_time_it_goes_on() {
        let mut clock = Clock::new(15);
        low(&mut clock, 100);
        clock.lose(None);
        assert_eq!(low(&mut clock, 90), 32_768 + 90);
        clock.lose(None);
        assert_eq!(low(&mut clock, 91), 32_768 + 91);
    }

    #[test]
    fn the_hosts_time_undoes_forged_wraps_and_resets() {
        let mut clock = Clock::new(15);
        low(&mut clock, 20_000);
        clock.wrap(345);
        clock.reset();
        low(&mut clock, 20_010);
        clock.lose(Some(20_300));
        assert_eq!(low(&mut clock, 20_020), 20_020);
        // A true reset fits better than the phase before it.
        clock.reset();
        low(&mut clock, 5);
        clock.lose(Some(20_020 + 9));
        assert_eq!(low(&mut clock, 8), 20_020 + 8);
    }

    #[test]
    fn a_counter_that_ran_on_is_known_by_its_low_part() {
        // The host's time is nearer to the time that the forged resets yield.
        for (resets, next) in [(1, 1_100), (3, 2)] {
            let mut clock = Clock::new(15);
            low(&mut clock, 1_000);
            for _ in 0..resets {
                clock.reset();
            }
            low(&mut clock, next);
            clock.lose(Some(2_200));
            assert_eq!(low(&mut clock, 1_200), 1_200);
        }
    }

    #[test]
    fn a_wrap_after_a_loss_is_a_word_of_time() {
        let mut clock = Clock::new(15);
        low(&mut clock, 20_000);
        for (host, wraps, want) in [
            ((9 << 15) - 100, 1, 9 << 15),
            ((9 << 15) - 32_760, 1, 9 << 15),
            (9 << 15, 1, 10 << 15),
            ((9 << 15) + 5, 70, 79 << 15),
        ] {
            clock.lose(Some(host));
            clock.wrap(wraps);
            assert!(!clock.is_known());
            assert_eq!(low(&mut clock, 50), want + 50);
        }
    }

    #[test]
    fn the_end_of_time_is_no_panic() {
        let mut clock = Clock::new(32);
        for _ in 0..20 {
            low(&mut clock, 0xFFFF_FFFF);
            clock.wrap(u64::from(u32::MAX) >> 1);
            clock.reset();
            clock.lose(Some(u64::MAX));
            clock.wrap(3);
            low(&mut clock, 1);
            clock.lose(None);
            low(&mut clock, 0);
        }
        assert!(clock.now() >= 1 << 61);
    }
}
