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
    pub(super) started_us: u64,
}

impl Joined {
    /// Whether all of a run is wanted: it began after the receiver.
    pub(super) const fn is_whole(self, run: u64) -> bool {
        self.from_start || run >= self.started_us
    }
}

impl Sensor {
    /// A run, of which `number` has come first; none where too many are newer.
    pub(super) fn run(&mut self, run: u64, number: u64, joined: Joined) -> Option<&mut Run> {
        if !self.runs.contains_key(&run) {
            let is_old = self.runs.keys().next().is_some_and(|first| run < *first);
            if is_old && self.runs.len() >= RUNS_MAX {
                return None;
            }
            self.report.runs += 1;
            let first = if joined.is_whole(run) { 0 } else { number };
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
