//! Clocks that are never set, and how far another computer's clock is ahead.
//!
//! Nothing here rests on two computers having the same time. A [`Clock`] takes the computer's time once, when it
//! starts, and runs on steadily; a change of the computer's time does not reach it. [`Ahead`] estimates from round
//! trips how far a sensor's clock is ahead of the observer's, so that latencies can be measured whatever the two
//! clocks show.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::message::now_us;

/// How far two steady clocks may drift apart: one part in this many, 100 ppm.
pub const DRIFT: u64 = 10_000;

/// Interval at which a clock is asked for, and for the first few times.
const ASK: Duration = Duration::from_secs(10);
const ASK_FIRST: Duration = Duration::from_secs(1);

/// Number of answers after which the longer interval applies.
const FEW: usize = 3;

/// Number of round trips that are remembered.
const TRIPS_MAX: usize = 16;

/// Difference between two clocks from which it is worth a word, in microseconds.
const DIFFERENT_US: u64 = 100_000;

/// A clock that is set once, when it starts.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    started: Instant,
    origin_us: u64,
}

impl Clock {
    /// Starts a clock with this computer's time.
    #[must_use]
    pub fn start() -> Self {
        Self::start_ahead(0)
    }

    /// Starts a clock that is ahead of this computer's by so many microseconds, or behind it by a negative number:
    /// for computers whose time is known to be wrong, and for tests.
    #[must_use]
    pub fn start_ahead(ahead_us: i64) -> Self {
        Self {
            started: Instant::now(),
            origin_us: now_us().saturating_add_signed(ahead_us),
        }
    }

    /// Returns what the clock showed when it started, in microseconds since 1970.
    #[must_use]
    pub const fn origin_us(&self) -> u64 {
        self.origin_us
    }

    /// Returns the time since the start, in microseconds.
    #[must_use]
    pub fn up_us(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    /// Returns what the clock shows now, in microseconds since 1970.
    #[must_use]
    pub fn now_us(&self) -> u64 {
        self.origin_us.saturating_add(self.up_us())
    }
}

/// Returns `a - b` as a signed number, the nearest one that fits.
#[must_use]
pub fn difference_us(a: u64, b: u64) -> i64 {
    let difference = i128::from(a) - i128::from(b);
    difference.clamp(i64::MIN.into(), i64::MAX.into()) as i64
}

/// How far a clock is ahead of the observer's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(into = "Told")]
pub struct Estimate {
    /// Microseconds by which the clock is ahead; negative if it is behind.
    pub ahead_us: i64,
    /// Bound of the error in microseconds: half the time of the round trip, and what the clocks may have drifted
    /// since.
    pub error_us: u64,
}

/// An estimate as JSON has it.
#[derive(Serialize)]
struct Told {
    ahead_us: i64,
    error_us: u64,
    is_different: bool,
}

impl From<Estimate> for Told {
    fn from(estimate: Estimate) -> Self {
        Self {
            ahead_us: estimate.ahead_us,
            error_us: estimate.error_us,
            is_different: estimate.is_different(),
        }
    }
}

impl Estimate {
    /// Returns whether the two clocks differ so much that people should know, by a tenth of a second or more.
    #[must_use]
    pub const fn is_different(self) -> bool {
        self.ahead_us.unsigned_abs() >= DIFFERENT_US.saturating_add(self.error_us)
    }

    /// Returns the time from `from_us` by the other clock to `to_us` by the observer's, in microseconds.
    ///
    /// Clocks that agree as far as a round trip can tell are believed: clocks of one computer are compared exactly.
    #[must_use]
    pub fn since_us(self, from_us: u64, to_us: u64) -> i64 {
        self.corrected_us(difference_us(to_us, from_us))
    }

    /// Returns a difference of the observer's time less the other clock's, in microseconds, without the part that
    /// comes from the clocks.
    #[must_use]
    pub const fn corrected_us(self, difference_us: i64) -> i64 {
        if self.ahead_us.unsigned_abs() <= self.error_us {
            return difference_us;
        }
        difference_us.saturating_add(self.ahead_us)
    }
}

/// A question for a sensor's clock, and its answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RoundTrip {
    /// The run that answered.
    pub run: u64,
    /// When the question left, by the observer's clock, in microseconds since 1970.
    pub asked_us: u64,
    /// What the run's clock showed, in microseconds since 1970.
    pub shown_us: u64,
    /// When the answer arrived, by the observer's clock, in microseconds since 1970.
    pub answered_us: u64,
}

#[derive(Debug, Clone, Copy)]
struct Trip {
    answered_us: u64,
    estimate: Estimate,
}

/// Estimates how far a clock is ahead of the observer's, from the shortest of the latest round trips.
#[derive(Debug, Clone, Default)]
pub struct Ahead {
    trips: VecDeque<Trip>,
}

impl Ahead {
    /// Returns how long after one question the clock is asked for again.
    #[must_use]
    pub fn ask_after(&self) -> Duration {
        if self.trips.len() < FEW {
            ASK_FIRST
        } else {
            ASK
        }
    }

    /// Adds a round trip; one whose answer came before its question is ignored.
    pub fn add(&mut self, trip: RoundTrip) {
        let RoundTrip {
            asked_us,
            shown_us,
            answered_us,
            ..
        } = trip;
        let Some(took_us) = answered_us.checked_sub(asked_us) else {
            return;
        };
        let error_us = took_us.div_ceil(2);
        let trip = Trip {
            answered_us,
            estimate: Estimate {
                ahead_us: difference_us(shown_us, asked_us + took_us / 2),
                error_us,
            },
        };
        // A clock that stood still while its computer slept agrees with none of the earlier trips.
        self.trips.retain(|earlier| {
            let earlier = earlier.at(answered_us);
            let apart_us = earlier.ahead_us.abs_diff(trip.estimate.ahead_us);
            apart_us <= earlier.error_us.saturating_add(error_us)
        });
        self.trips.push_back(trip);
        if self.trips.len() > TRIPS_MAX {
            self.trips.pop_front();
        }
    }

    /// Returns the best estimate at a time of the observer's clock; `None` before the first round trip.
    #[must_use]
    pub fn at(&self, now_us: u64) -> Option<Estimate> {
        let estimates = self.trips.iter().map(|trip| trip.at(now_us));
        estimates.min_by_key(|estimate| estimate.error_us)
    }

    /// Returns the number of round trips that agree with the latest one.
    #[must_use]
    pub fn trips(&self) -> usize {
        self.trips.len()
    }
}

impl Trip {
    /// Returns the estimate with the drift since the trip in its error.
    const fn at(self, now_us: u64) -> Estimate {
        let drift_us = now_us.saturating_sub(self.answered_us) / DRIFT;
        Estimate {
            ahead_us: self.estimate.ahead_us,
            error_us: self.estimate.error_us.saturating_add(drift_us),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn add(ahead: &mut Ahead, asked_us: u64, shown_us: u64, answered_us: u64) {
        ahead.add(RoundTrip {
            run: 0,
            asked_us,
            shown_us,
            answered_us,
        });
    }

    #[test]
    fn a_clock_runs_on_from_where_it_was_set() {
        let clock = Clock::start_ahead(-3_600_000_000);
        let shown_us = now_us();
        assert!(clock.origin_us() <= shown_us - 3_600_000_000);
        assert!(clock.origin_us() > shown_us - 3_700_000_000);
        std::thread::sleep(Duration::from_millis(20));
        let up_us = clock.up_us();
        assert!(up_us >= 20_000);
        assert!(clock.now_us() >= clock.origin_us() + up_us);
        assert_eq!(Clock::start_ahead(i64::MIN).origin_us(), 0);
    }

    #[test]
    fn the_shortest_trip_counts_until_it_is_too_old() {
        let mut ahead = Ahead::default();
        assert_eq!(ahead.at(0), None);
        // The clock is 1000 us ahead. A slow answer, then a quick one, then a slow one.
        add(&mut ahead, 0, 1100, 800);
        add(&mut ahead, 10_000, 11_010, 10_020);
        add(&mut ahead, 20_000, 21_700, 20_800);
        let estimate = ahead.at(20_800).unwrap();
        assert_eq!((estimate.ahead_us, estimate.error_us), (1000, 11));
        assert_eq!(estimate.since_us(5_000, 6_000), 2000);
        // After 10 s, the drift of the quick one is more than the error of the slow one.
        let later = ahead.at(10_000_000).unwrap();
        assert_eq!(later.ahead_us, 1000);
        assert_eq!(later.error_us, 10 + 998);
        // The other computer slept for a minute.
        add(&mut ahead, 90_000_000, 30_001_010, 90_000_020);
        assert_eq!(ahead.trips(), 1);
        assert_eq!(ahead.at(90_000_020).unwrap().ahead_us, 1000 - 60_000_000);
        // The answer comes before the question.
        add(&mut ahead, 90_000_030, 0, 90_000_020);
        assert_eq!(ahead.trips(), 1);
    }

    #[test]
    fn clocks_that_agree_are_believed() {
        let mut ahead = Ahead::default();
        add(&mut ahead, 0, 230, 400);
        let estimate = ahead.at(400).unwrap();
        assert!(!estimate.is_different());
        assert_eq!(estimate.since_us(1000, 1500), 500);
    }

    proptest! {
        /// Whatever a clock shows, and however unevenly a trip goes there and back, the latency is right within the
        /// error that is stated.
        #[test]
        fn latencies_are_right_within_their_error(
            ahead_us in -2_000_000_000_000_i64..2_000_000_000_000,
            there_us in 0_u64..50_000,
            back_us in 0_u64..50_000,
            latency_us in 0_u64..1_000_000,
        ) {
            let asked_us = 4_000_000_000_000_u64;
            let shown = |at_us: u64| at_us.saturating_add_signed(ahead_us);
            let mut ahead = Ahead::default();
            let answered_us = asked_us + there_us + back_us;
            add(&mut ahead, asked_us, shown(asked_us + there_us), answered_us);
            let estimate = ahead.at(answered_us).unwrap();
            let found_us = estimate.since_us(shown(asked_us), asked_us + latency_us);
            prop_assert!(found_us.abs_diff(latency_us as i64) <= 2 * estimate.error_us + 1, "{found_us} {estimate:?}");
        }

        #[test]
        fn no_time_overflows(a: u64, b: u64, c: u64, d: u64) {
            let mut ahead = Ahead::default();
            add(&mut ahead, a, b, c);
            add(&mut ahead, b, c, d);
            if let Some(estimate) = ahead.at(a) {
                let _ = (estimate.since_us(c, d), estimate.is_different());
            }
        }
    }
}
