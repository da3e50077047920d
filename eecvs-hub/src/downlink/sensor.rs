//! What a receiver knows of a sensor: its runs, and the requests to it.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::SensorReport;
use crate::latency::Latencies;
use crate::message::Stamp;
use crate::order::Numbers;

/// Maximum number of a sensor's runs that are tracked.
pub(super) const RUNS_MAX: usize = 8;

/// Wait before a sensor that has answered nothing is asked again.
pub(super) const WISH_AGAIN: Duration = Duration::from_millis(250);

/// Time after which answers count as lost; it doubles with every request in vain, up to the longest wait.
pub(super) const ANSWER: Duration = Duration::from_millis(500);

pub(crate) const ANSWER_MAX: Duration = Duration::from_secs(2);

#[derive(Default)]
pub(super) struct Sensor {
    pub(super) report: SensorReport,
    pub(super) runs: BTreeMap<u64, Run>,
    pub(super) delays: Latencies,
    pub(super) asking: Asking,
    /// Frames lost in runs that are no longer tracked.
    pub(super) lost_before: u64,
    /// Time of the sensor's latest message.
    pub(super) heard: Option<Instant>,
    /// How far the sensor's clock is ahead of the receiver's, according to its latest message; too low by the
    /// message's travel time.
    pub(super) ahead_us: i64,
}

/// The state of the requests to a sensor.
#[derive(Default)]
pub(super) struct Asking {
    /// Number of the request in progress.
    pub(super) wish: Option<u64>,
    /// Time of the latest request, and of the latest answer.
    pub(super) asked: Option<Instant>,
    pub(super) heard: Option<Instant>,
    /// Number of consecutive requests without an answer.
    pub(super) in_vain: u32,
}

impl Asking {
    /// Records that an answer has arrived.
    pub(super) fn hear(&mut self) {
        self.heard = Some(Instant::now());
        self.in_vain = 0;
    }

    /// Returns whether to send a request now.
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
    /// Frames that wait for earlier ones, for delivery in order.
    pub(super) held: BTreeMap<u64, (Stamp, Vec<u8>)>,
    /// When the latest missing frame arrived, or when frames began to be missing.
    pub(super) progress: Instant,
    /// Time waited since then, while the sensor was heard.
    pub(super) waited: Duration,
}

/// From where on a receiver wants the frames of a run.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joined {
    pub(super) from_start: bool,
    /// When the receiver started, by its own clock.
    pub(super) started_us: u64,
}

impl Sensor {
    /// Records that the sensor's clock showed `sensor_us` at `at_us` of the receiver's clock, or shortly before.
    pub(super) fn note_clock(&mut self, sensor_us: u64, at_us: u64) {
        let ahead_us = i128::from(sensor_us) - i128::from(at_us);
        self.ahead_us = ahead_us.clamp(i64::MIN.into(), i64::MAX.into()) as i64;
    }

    /// Returns whether all of a run is wanted: always with `from_start`, otherwise if the run began after the
    /// receiver. A run is identified by its start time on the sensor's clock, which may be hours off.
    pub(super) fn is_whole(&self, run: u64, joined: Joined) -> bool {
        let began_us = i128::from(run) - i128::from(self.ahead_us);
        joined.from_start || began_us >= i128::from(joined.started_us)
    }

    /// Returns a run, newly tracked if `number` is the first of it to be known; `None` if the run is older than all
    /// those tracked and there are too many.
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

    /// Records a frame; returns whether it is useful.
    pub(super) fn take(&mut self, number: u64) -> bool {
        let missing = self.numbers.missing();
        let is_new = self.numbers.take(number);
        if is_new && (missing == 0 || self.numbers.missing() < missing) {
            self.go_on();
        }
        is_new
    }

    /// Records that all frames below a number exist.
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

    /// For a run that began after the receiver, everything is wanted that the sensor made before its link existed,
    /// whatever its clock shows; for a run that began before, only what arrives from now on.
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
                // The message travelled for half a millisecond.
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
