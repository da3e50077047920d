//! Time of a device that counts in few bits: wraps, resets, losses.
//!
//! ```text
//! time = base + low        low < period, in ticks of the device
//! ```
//!
//! A wrap adds its multiplier of periods to the base. All is 64 bits: a stream would have to hold
//! 2^62 ticks to stop the clock, and then it stays there.
//!
//! | what happens | what the clock does |
//! |---|---|
//! | the device resets its counter | time goes on from the last time seen: base = now |
//! | low falls by more than half a period, without a wrap | a wrap is missing: base += period |
//! | low falls by less | taken as it is: output runs back by less than half a period, until the next word of time |
//! | bytes are lost, the host's time is known | the time nearest to it that the next low allows; a wrap that comes first is the next one after it |
//! | bytes are lost, nothing else is known | the next time that low allows, not before the last one |
//!
//! What cannot be known without the host's time: a wrap that was lost or forged shifts what follows
//! by whole periods; a reset that was forged shifts it by less than one; where a device was quiet for
//! longer than a period, a lost wrap leaves no trace in what follows. The next loss that comes with
//! the host's time ([`Clock::lose`]) ends the first two: the phase from before a reset is kept until
//! then, and taken again where it fits better than the one after it, or where it fits and there were
//! other signs of damage: time that ran back, misaligned words, or a counter that did not begin anew. A
//! reset that was lost itself leaves times up to half a period off. A host's time is good enough if it
//! is off by less than half a period, after a reset by less than a quarter.

/// Largest base: leaves room for every sum below.
const BASE_MAX: u64 = 1 << 62;

/// A counter of few bits, extended to 64.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    /// Ticks after which the counter begins anew: a power of two.
    period: u64,
    /// Time at which the counter was 0.
    base: u64,
    /// Latest time.
    now: u64,
    /// Least time that is taken without a question: `now`, or the maximum while time is not known.
    floor: u64,
    /// Whether any time was seen.
    seen: bool,
    /// Time of the host at a loss.
    anchor: Option<u64>,
    /// What was before the first reset since the host's time was last compared.
    before_reset: Option<BeforeReset>,
    /// Words were damaged since then: a reset may be one of them.
    damaged: bool,
}

/// The counter before a reset, should that have been none.
#[derive(Debug, Clone, Copy)]
struct BeforeReset {
    base: u64,
    /// Its low part at the reset, until the next one is compared with it.
    low: Option<u64>,
    /// The counter seems to have run on: resets came in a row, or the low part did not begin anew.
    ran_on: bool,
}

/// What became of a low part that [`Clock::take`] had a question about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Settled {
    /// The first time after a start, a loss or a reset.
    Found,
    /// It fell by more than half a period: a wrap belongs between.
    Wrapped,
    /// It fell by less, and is taken as it is.
    Back,
}

impl Clock {
    /// A counter of `bits` bits (1 to 32) that was never read.
    #[must_use]
    pub const fn new(bits: u32) -> Self {
        Self {
            period: 1 << bits,
            base: 0,
            now: 0,
            floor: u64::MAX,
            seen: false,
            anchor: None,
            before_reset: None,
            damaged: false,
        }
    }

    /// Latest time.
    #[must_use]
    pub const fn now(&self) -> u64 {
        self.now
    }

    /// Latest time, once there was one.
    #[must_use]
    pub const fn time(&self) -> Option<u64> {
        if self.seen { Some(self.now) } else { None }
    }

    /// Whether [`Clock::now`] is the time of what comes next.
    #[must_use]
    pub const fn is_known(&self) -> bool {
        self.floor != u64::MAX
    }

    /// Whether a low part that [`Clock::take`] does not take runs back.
    #[must_use]
    pub const fn runs_back(&self, low: u64) -> bool {
        self.is_known() && self.base + low < self.now
    }

    /// Takes the next low part; `false` where [`Clock::settle`] has to.
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

    /// Takes a low part that [`Clock::take`] did not.
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

    /// Adds `count` periods.
    #[cold]
    pub fn wrap(&mut self, count: u64) {
        // Soon after a reset only a counter that ran on wraps.
        if let Some(before) = &mut self.before_reset
            && let Some(last) = before.low.take()
        {
            before.ran_on |= count == 1 && last > self.period / 2;
        }
        if self.is_known() {
            self.base = (self.base + count * self.period).min(BASE_MAX);
            self.know(self.base.max(self.now));
        } else if let Some(anchor) = self.anchor {
            // The counter is 0 now. The wrap before this one was at the anchor at the latest, so this
            // one is in (anchor, anchor + period], or as many periods later as it counts more.
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

    /// The counter begins at 0 now.
    #[cold]
    pub fn reset(&mut self) {
        if let Some(before) = &mut self.before_reset {
            before.ran_on = true;
        } else if self.seen {
            self.before_reset = Some(BeforeReset {
                base: self.base,
                low: self.is_known().then(|| self.now - self.base),
                // Between a loss and the next time it is as likely a part of the damage.
                ran_on: !self.is_known(),
            });
        }
        if let Some(anchor) = self.anchor.take() {
            self.now = anchor;
        }
        self.base = self.now.min(BASE_MAX);
        self.know(self.base);
        // The next low part is looked at: `settle` has to take it.
        self.floor = u64::MAX - 1;
    }

    /// Time is not known until the next low part; `host` is what the host's clock says it is.
    #[cold]
    pub fn lose(&mut self, host: Option<u64>) {
        self.floor = u64::MAX;
        if let Some(host) = host {
            self.anchor = Some(host.min(BASE_MAX));
        }
    }

    /// Words were found misaligned: what this clock took from them was undone, and time is not known.
    #[cold]
    pub fn lose_misaligned(&mut self) {
        self.damaged = true;
        self.lose(None);
    }

    fn know(&mut self, time: u64) {
        self.now = time;
        self.floor = time;
        self.seen = true;
    }

    /// Compares the first low part after a reset with the last one before it: a counter that began
    /// anew is nearer to 0, one that ran on nearer to where it was.
    fn compare_reset(&mut self, low: u64) {
        let period = self.period;
        if let Some(before) = &mut self.before_reset
            && let Some(last) = before.low.take()
        {
            before.ran_on |= low.wrapping_sub(last) % period < low;
        }
    }

    /// Sets the base by the next low part after a loss, or by that of a wrap.
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
            // A reset with nothing after it but the loss is taken as a part of the damage.
            let doubted = before.ran_on || before.low.is_some() || damaged;
            let may_be = doubted && (is_wrap || off <= self.period / 4);
            if may_be || off < time.abs_diff(anchor) {
                time = other;
            }
        }
        // Before the counter's own 0 there was no time.
        if time < low {
            time += self.period;
        }
        self.base = time - low;
    }

    /// The time nearest to `anchor` that is `any` up to whole periods.
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
            // Before its own 0 there is no time.
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
        // The host's time is nearer to what the forged resets make of it.
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
