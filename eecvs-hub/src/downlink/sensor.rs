//! What a receiver knows of a sensor: its runs, and what it is asked.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::SensorReport;
use crate::latency::Latencies;
use crate::message::Stamp;
use crate::order::Numbers;

/// Runs of a sensor of which something may be missing.
pub(super) const RUNS_MAX: usize = 8;

/// How often it is asked who has answered nothing.
pub(super) const WISH_AGAIN: Duration = Duration::from_millis(250);

/// Answers that do not come for so long have got lost, the next ones after twice that, up to the longest wait.
pub(super) const ANSWER: Duration = Duration::from_millis(500);

pub(crate) const ANSWER_MAX: Duration = Duration::from_secs(2);

#[derive(Default)]
pub(super) struct Sensor {
    pub(super) report: SensorReport,
    pub(super) runs: BTreeMap<u64, Run>,
    pub(super) delays: Latencies,
    pub(super) asking: Asking,
    /// Frames lost of runs that are forgotten.
    pub(super) lost_before: u64,
    /// When something has come of it last.
    pub(super) heard: Option<Instant>,
    /// By how much its clock is ahead of the receiver's, as its last message shows; less by what that took.
    pub(super) ahead_us: i64,
}

/// What is asked of a sensor.
#[derive(Default)]
pub(super) struct Asking {
    /// The wish that is under way.
    pub(super) wish: Option<u64>,
    /// When it was asked last, and when something came of that.
    pub(super) asked: Option<Instant>,
    pub(super) heard: Option<Instant>,
    /// Wishes in a row of which nothing came.
    pub(super) in_vain: u32,
}

impl Asking {
    /// Something that was asked for has come.
    pub(super) fn hear(&mut self) {
        self.heard = Some(Instant::now());
        self.in_vain = 0;
    }

    /// Whether to ask now.
    pub(super) fn is_due(&self) -> bool {
        let Some(latest) = self.asked.max(self.heard) else {
            return true;
        };
        let is_heard = self.heard > self.asked;
        let wait = match (self.wish, is_heard) {
            (None, true) => Duration::ZERO,
            (None, false) => WISH_AGAIN,
            (Some(_), _) => (ANSWER * (1 << self.in_vain.min(8))).min(ANSWER_MAX),
        };
        latest.elapsed() >= wait
    }

    pub(super) fn ask(&mut self, wish: u64) {
        if self.asked.is_some() && self.heard <= self.asked {
            self.in_vain += 1;
        }
        self.wish = Some(wish);
        self.asked = Some(Instant::now());
    }
}

pub(super) struct Run {
    pub(super) numbers: Numbers,
    /// In order: frames that wait for others.
    pub(super) held: BTreeMap<u64, (Stamp, Vec<u8>)>,
    /// When something that was missing has come last, or has begun to be missing.
    pub(super) progress: Instant,
    /// How long it was waited for since, while the sensor was heard.
    pub(super) waited: Duration,
}

/// From where on a run counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joined {
    pub(super) from_start: bool,
    /// When the receiver began, by its own clock.
    pub(super) started_us: u64,
}

impl Sensor {
    /// Notes that its clock showed `sensor_us` at `at_us` of the receiver's or shortly before.
    pub(super) fn note_clock(&mut self, sensor_us: u64, at_us: u64) {
        let ahead_us = i128::from(sensor_us) - i128::from(at_us);
        self.ahead_us = ahead_us.clamp(i64::MIN.into(), i64::MAX.into()) as i64;
    }

    /// Whether all of a run is wanted: it began after the receiver. A run is named by the time of its start by
    /// the sensor's clock, which may be hours off.
    pub(super) fn is_whole(&self, run: u64, joined: Joined) -> bool {
        let began_us = i128::from(run) - i128::from(self.ahead_us);
        joined.from_start || began_us >= i128::from(joined.started_us)
    }

    /// A run, of which `number` has come first; none where too many are newer.
    pub(super) fn run(&mut self, run: u64, number: u64, joined: Joined) -> Option<&mut Run> {
        if !self.runs.contains_key(&run) {
            let is_old = self.runs.keys().next().is_some_and(|first| run < *first);
            if is_old && self.runs.len() >= RUNS_MAX {
                return None;
            }
            self.report.runs += 1;
            let first = if self.is_whole(run, joined) {
                0
            } else {
                number
            };
            let new = Run {
                numbers: Numbers::from(first),
                held: BTreeMap::new(),
                progress: Instant::now(),
                waited: Duration::ZERO,
            };
            self.runs.insert(run, new);
        }
        self.runs.get_mut(&run)
    }
}

impl Run {
    fn go_on(&mut self) {
        self.progress = Instant::now();
        self.waited = Duration::ZERO;
    }

    /// Takes a frame; whether it is of use.
    pub(super) fn take(&mut self, number: u64) -> bool {
        let missing = self.numbers.missing();
        let is_new = self.numbers.take(number);
        if is_new && (missing == 0 || self.numbers.missing() < missing) {
            self.go_on();
        }
        is_new
    }

    /// All below a number exist.
    pub(super) fn until(&mut self, next: u64) {
        if self.numbers.missing() == 0 {
            self.go_on();
        }
        self.numbers.until(next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a sensor made before its link came is wanted of a run that began after the receiver, whatever the
    /// sensor's clock shows; of one that began before, only what comes from now on.
    #[test]
    fn a_clock_that_is_off_changes_nothing_of_what_is_wanted() {
        const HOUR: i64 = 3_600_000_000;
        let now_us = 1_800_000_000_000_000_u64;
        for ahead_us in [-HOUR, -1, 0, 1, HOUR, -(now_us as i64)] {
            let on_sensor = |t_us: u64| t_us.saturating_add_signed(ahead_us);
            for (began_us, missing) in [
                (now_us - 4_000_000, 245),
                (now_us - 5_000_000, 245),
                (now_us - 5_100_000, 0),
                (now_us - 2 * HOUR as u64, 0),
            ] {
                let joined = Joined {
                    from_start: false,
                    started_us: now_us - 5_000_000,
                };
                let mut sensor = Sensor::default();
                // Half a millisecond on its way.
                sensor.note_clock(on_sensor(now_us - 500), now_us);
                let run = on_sensor(began_us);
                if run == 0 {
                    continue;
                }
                let first = sensor.run(run, 245, joined).unwrap();
                first.until(245);
                assert_eq!(
                    first.numbers.missing(),
                    missing,
                    "{ahead_us} us ahead, begun {began_us}"
                );
                let all = Joined {
                    from_start: true,
                    ..joined
                };
                assert!(sensor.is_whole(run, all));
            }
        }
    }
}
