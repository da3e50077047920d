//! Tells a sensor that was started again from two sensors that have one name.
//!
//! Every message says how long its run had been up when it was sent, so an observer knows by its own clock when the
//! run began, and when it made its latest message. A run that made something after another one had begun is not its
//! predecessor: both were up at once, so two sensors have the name. No clock of a sensor's computer is compared with
//! another's.

use crate::clock::{DRIFT, difference_us};

/// Maximum number of runs that are remembered.
const LIVES_MAX: usize = 16;

/// Runs that overlap by less than this, in microseconds, may follow one another: a message's time is known less well.
const MARGIN_US: i64 = 1_000_000;

/// A run that is up is heard twice a second; one that was not heard for this long, in microseconds, has ended or has
/// no link.
pub const QUIET_US: u64 = 2_500_000;

/// While a run is so much older than when it was first heard, in microseconds, its start is estimated anew.
const BEGINNING_US: u64 = 60_000_000;

/// A run as an observer has heard it; times are of the observer's clock.
#[derive(Debug, Clone, Copy)]
struct Life {
    run: u64,
    /// When the run began: not later than this, except by the drift of the clocks.
    began_us: i64,
    /// How long the run had been up when it was first heard.
    first_up_us: u64,
    /// What the observer's clock shows when the run's time is 0, by the quickest message; it may grow with the drift.
    origin_us: i64,
    /// When the latest message was made.
    made_us: i64,
    /// When the latest message arrived.
    heard_us: u64,
}

/// The runs of one name.
#[derive(Debug, Clone, Default)]
pub struct Lives {
    lives: Vec<Life>,
}

impl Lives {
    /// Records a message of a run that was sent `up_us` after the run's start and arrived at `at_us` of the
    /// observer's clock. Frames that are sent again do not count: another run may send them.
    pub fn hear(&mut self, run: u64, up_us: u64, at_us: u64) {
        let origin_us = difference_us(at_us, up_us);
        let up_i64 = i64::try_from(up_us).unwrap_or(i64::MAX);
        if let Some(life) = self.lives.iter_mut().find(|life| life.run == run) {
            if up_us.saturating_sub(life.first_up_us) < BEGINNING_US {
                life.began_us = life.began_us.min(origin_us);
            }
            let drift_us = at_us.saturating_sub(life.heard_us) / DRIFT;
            let drifted_us = life.origin_us.saturating_add_unsigned(drift_us);
            life.origin_us = drifted_us.min(origin_us);
            let made_us = life.origin_us.saturating_add(up_i64);
            life.made_us = life.made_us.max(made_us);
            life.heard_us = life.heard_us.max(at_us);
            return;
        }
        if self.lives.len() >= LIVES_MAX {
            let oldest = self.lives.iter().enumerate();
            let oldest = oldest.min_by_key(|(_, life)| life.heard_us);
            if let Some((at, _)) = oldest {
                self.lives.remove(at);
            }
        }
        self.lives.push(Life {
            run,
            began_us: origin_us,
            first_up_us: up_us,
            origin_us,
            made_us: origin_us.saturating_add(up_i64),
            heard_us: at_us,
        });
    }

    fn get(&self, run: u64) -> Option<&Life> {
        self.lives.iter().find(|life| life.run == run)
    }

    /// Returns whether a run was heard within [`QUIET_US`] before `now_us`.
    #[must_use]
    pub fn is_heard(&self, run: u64, now_us: u64) -> bool {
        self.get(run).is_some_and(|life| life.is_heard(now_us))
    }

    /// Returns whether two runs were up at once.
    #[must_use]
    pub fn overlap(&self, a: u64, b: u64) -> bool {
        let (Some(a), Some(b)) = (self.get(a), self.get(b)) else {
            return false;
        };
        a.run != b.run && (a.outlives_start(b) || b.outlives_start(a))
    }

    /// Returns how many sensors use the name at `now_us`: 0 if none is heard, and more than 1 if runs that were up at
    /// once are heard.
    #[must_use]
    pub fn at_once(&self, now_us: u64) -> usize {
        let heard = self.lives.iter().filter(|life| life.is_heard(now_us));
        let Some(latest) = heard.clone().max_by_key(|life| life.heard_us) else {
            return 0;
        };
        1 + heard
            .filter(|life| self.overlap(life.run, latest.run))
            .count()
    }
}

impl Life {
    fn is_heard(&self, now_us: u64) -> bool {
        now_us.saturating_sub(self.heard_us) < QUIET_US
    }

    /// Returns whether this run began before another, and made a message after the other's start.
    fn outlives_start(&self, other: &Self) -> bool {
        let margin_us = MARGIN_US.saturating_add_unsigned(other.first_up_us / DRIFT);
        let drift_us = self.first_up_us / DRIFT;
        self.began_us <= other.began_us.saturating_add_unsigned(drift_us)
            && self.made_us > other.began_us.saturating_add(margin_us)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const S: u64 = 1_000_000;

    /// Messages of a run twice a second from `from_us` to `to_us`, each on its way for `way_us`.
    fn live(lives: &mut Lives, run: u64, began_us: u64, from_us: u64, to_us: u64, way_us: u64) {
        for at_us in (from_us..=to_us).step_by(S as usize / 2) {
            lives.hear(run, at_us - began_us, at_us + way_us);
        }
    }

    #[test]
    fn a_sensor_that_was_started_again_is_one() {
        let mut lives = Lives::default();
        live(&mut lives, 7, 100 * S, 100 * S, 160 * S, 2000);
        // It starts again after a tenth of a second; the run's number says nothing of the order.
        live(
            &mut lives,
            3,
            160 * S + 100_000,
            160 * S + 100_000,
            200 * S,
            2000,
        );
        assert!(!lives.overlap(7, 3) && !lives.overlap(3, 7));
        assert_eq!(lives.at_once(161 * S), 1);
        assert_eq!((lives.at_once(200 * S), lives.at_once(210 * S)), (1, 0));
        assert!(lives.is_heard(3, 201 * S) && !lives.is_heard(7, 201 * S));
    }

    #[test]
    fn two_of_one_name_are_two() {
        for (second_us, way_us) in [(130 * S, 1000), (100 * S + 1, 1000), (40 * S, 400_000)] {
            let mut lives = Lives::default();
            for at_us in (130 * S..150 * S).step_by(S as usize / 2) {
                lives.hear(1, at_us - 100 * S, at_us + 1000);
                if at_us > 130 * S {
                    lives.hear(2, at_us - second_us, at_us + way_us);
                }
            }
            assert!(lives.overlap(1, 2) && lives.overlap(2, 1), "{second_us}");
            assert_eq!(lives.at_once(150 * S), 2);
        }
    }

    #[test]
    fn one_that_comes_back_after_a_break_is_another() {
        let mut lives = Lives::default();
        live(&mut lives, 1, 0, 0, 10 * S, 1000);
        // While the first has no link, another one begins: it may be the first, started again.
        live(&mut lives, 2, 20 * S, 20 * S, 40 * S, 1000);
        assert!(!lives.overlap(1, 2));
        lives.hear(1, 41 * S, 41 * S + 1000);
        assert!(lives.overlap(1, 2));
        assert_eq!(lives.at_once(41 * S + 1000), 2);
    }

    #[test]
    fn many_runs_are_bounded() {
        let mut lives = Lives::default();
        for run in 0..1000 {
            lives.hear(run, 0, run * 10 * S);
        }
        assert_eq!(lives.lives.len(), LIVES_MAX);
        assert_eq!(lives.at_once(9990 * S), 1);
    }

    proptest! {
        /// Of runs that follow one another no two are taken for sensors of their own, whatever their numbers, the
        /// drift of the clock, and the time that messages take.
        #[test]
        fn runs_in_a_row_never_overlap(
            runs in prop::collection::vec((any::<u64>(), 0_u64..3600, 0_u64..20), 2..6),
            ppm in -90_i64..90,
            ways in prop::collection::vec(0_u64..900_000, 8),
        ) {
            let mut lives = Lives::default();
            let mut now_us = 50 * S;
            let mut way = ways.iter().cycle();
            for (index, (_, up_s, off_s)) in runs.iter().enumerate() {
                let began_us = now_us;
                while now_us <= began_us + up_s * S {
                    let up_us = (now_us - began_us) as i64;
                    let up_us = (up_us + up_us * ppm / 1_000_000) as u64;
                    lives.hear(index as u64, up_us, now_us + way.next().unwrap());
                    now_us += S;
                }
                now_us += off_s * S;
            }
            for a in 0..runs.len() as u64 {
                for b in 0..a {
                    prop_assert!(!lives.overlap(a, b), "{a} {b} {lives:?}");
                }
            }
        }

        #[test]
        fn no_time_overflows(messages: Vec<(u64, u64, u64)>) {
            let mut lives = Lives::default();
            for (run, up_us, at_us) in &messages {
                lives.hear(*run, *up_us, *at_us);
                let _ = (lives.at_once(*at_us), lives.overlap(*run, messages[0].0));
            }
        }
    }
}
