//! What a receiver knows of a name: the runs of its sensor, or of its sensors, and the requests to them.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use super::SensorReport;
use crate::clock::{Ahead, DRIFT, RoundTrip};
use crate::key::Name;
use crate::latency::Latencies;
use crate::lives::Lives;
use crate::message::{Held, Stamp};
use crate::order::Numbers;

/// Maximum number of a name's runs that are tracked.
pub(super) const RUNS_MAX: usize = 8;

/// Maximum number of runs that are remembered once they are no longer tracked, so that they are not requested anew.
const FORGOTTEN_MAX: usize = 256;

/// Wait before a sensor that has answered nothing is asked again.
pub(super) const WISH_AGAIN: Duration = Duration::from_millis(250);

/// Time after which answers count as lost; it doubles with every request in vain, up to the longest wait.
pub(super) const ANSWER: Duration = Duration::from_millis(500);

pub(crate) const ANSWER_MAX: Duration = Duration::from_secs(2);

/// A new run is asked more often for this time.
const CLOCK_NEW: Duration = Duration::from_secs(3);

/// Longest time for which it may be open whether a run belongs to the sensor that was heard before.
const OPEN: Duration = Duration::from_secs(5);

/// Maximum number of delays that wait for the first answer of a sensor's clock.
const DELAYS_MAX: usize = 8192;

#[derive(Default)]
pub(super) struct Sensor {
    pub(super) report: SensorReport,
    /// The runs, the earlier ones first as far as that is known.
    pub(super) runs: Vec<Run>,
    /// Runs that are no longer tracked.
    forgotten: VecDeque<u64>,
    /// Which of the runs were up at once.
    pub(super) lives: Lives,
    pub(super) delays: Latencies,
    pub(super) asking: Asking,
    /// When the sensors of this name were last asked for their clocks.
    clock_asked: Option<Instant>,
    /// Frames lost in runs that are no longer tracked.
    pub(super) lost_before: u64,
    /// Frames that were not wanted of runs that are no longer tracked.
    unwanted_before: u64,
    /// Frames of other runs that the sensor's store holds and that are not wanted, by its latest status.
    pub(super) unwanted_held: u64,
    /// The same for wanted ones that are tracked only when there is room.
    pub(super) postponed: u64,
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
    pub(super) id: u64,
    pub(super) numbers: Numbers,
    /// Frames below this number were made before the receiver was there.
    pub(super) joined: u64,
    /// Frames that wait for earlier ones, or for the run's lane.
    pub(super) held: BTreeMap<u64, (Stamp, Vec<u8>)>,
    /// When the latest missing frame arrived, or when frames began to be missing.
    pub(super) progress: Instant,
    /// Time waited since then, while the sensor was heard.
    pub(super) waited: Duration,
    /// Which of the sensors of this name has made the run: runs of one lane follow one another. `None` while that is
    /// open.
    pub(super) lane: Option<usize>,
    /// The run in whose store this one is; `None` if it was heard itself.
    holder: Option<u64>,
    /// Since when the lane is open.
    open: Instant,
    ahead: Ahead,
    /// Differences between the clocks at a frame's arrival and at its window's end, for which the difference of the
    /// clocks is not known yet.
    delays: Vec<i64>,
}

/// From where on a receiver wants the frames of a run.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joined {
    pub(super) from_start: bool,
    /// How long the receiver has been there, in microseconds.
    pub(super) up_us: u64,
}

impl Joined {
    /// Returns whether a run that began so many microseconds ago began after the receiver. Both times are lengths, so
    /// nothing of a clock matters but its pace.
    const fn is_after(self, ago_us: u64) -> bool {
        ago_us.saturating_sub(ago_us / DRIFT) <= self.up_us
    }
}

impl Sensor {
    /// Begins to know a name.
    pub(super) fn new(name: &Name) -> Self {
        Self {
            report: SensorReport {
                name: name.to_string(),
                ..SensorReport::default()
            },
            ..Self::default()
        }
    }

    /// Records a message that a run sent `up_us` after its start and that arrived at `at_us`.
    pub(super) fn hear(&mut self, id: u64, up_us: u64, at_us: u64) {
        self.lives.hear(id, up_us, at_us);
        let at_once = self.lives.at_once(at_us) as u64;
        self.report.at_once = self.report.at_once.max(at_once);
        let Some(run) = self.runs.iter().position(|run| run.id == id) else {
            return;
        };
        self.runs[run].holder = None;
        // A run that was taken for an earlier one of the same sensor, and is up again, is another sensor's.
        let lane = self.runs[run].lane;
        let is_doubled = lane.is_some()
            && self
                .runs
                .iter()
                .any(|other| other.lane == lane && self.lives.overlap(other.id, id));
        if is_doubled {
            self.runs[run].lane = None;
            self.runs[run].open = Instant::now();
        }
    }

    /// Returns a tracked run.
    pub(super) fn run(&mut self, id: u64) -> Option<&mut Run> {
        self.runs.iter_mut().find(|run| run.id == id)
    }

    /// Returns whether a run is tracked.
    pub(super) fn tracks(&self, id: u64) -> bool {
        self.runs.iter().any(|run| run.id == id)
    }

    /// Tracks a run that was heard `up_us` after its start, if it is not tracked yet: all of it if it is wanted, or
    /// from `number` on.
    pub(super) fn begin(&mut self, id: u64, number: u64, up_us: u64, joined: Joined) -> &mut Run {
        let at = match self.runs.iter().position(|run| run.id == id) {
            Some(at) => at,
            None => {
                let is_known = self.forgotten.contains(&id);
                let is_after = !is_known && joined.is_after(up_us);
                let is_whole = is_after || (joined.from_start && !is_known);
                let first = if is_whole { 0 } else { number };
                let joined = if is_after { 0 } else { number };
                self.report.runs += 1;
                self.runs.push(Run::new(id, first, joined, None));
                self.runs.len() - 1
            }
        };
        &mut self.runs[at]
    }

    /// Returns whether frames of an earlier run that a sensor's store holds are wanted: of a run that is tracked, and
    /// of one that began after the receiver, or may have.
    pub(super) fn wants(&self, held: &Held, joined: Joined) -> bool {
        let is_after = held.ago_us.is_none_or(|ago_us| joined.is_after(ago_us));
        self.tracks(held.run) || joined.from_start || is_after
    }

    /// Tracks an earlier run of which the store of another one, its holder, has frames, if it is not tracked yet.
    pub(super) fn begin_held(&mut self, held: &Held, holder: u64, joined: Joined) -> &mut Run {
        let at = match self.runs.iter().position(|run| run.id == held.run) {
            Some(at) => at,
            None => {
                let is_after = held.ago_us.is_none_or(|ago_us| joined.is_after(ago_us));
                let joined = if is_after { 0 } else { u64::MAX };
                self.report.runs += 1;
                let later = self.runs.iter().position(|run| run.id == holder);
                let at = later.unwrap_or(self.runs.len());
                let run = Run::new(held.run, 0, joined, Some(holder));
                self.runs.insert(at, run);
                at
            }
        };
        &mut self.runs[at]
    }

    /// Returns whether a run was tracked and is not any more.
    pub(super) fn has_forgotten(&self, id: u64) -> bool {
        self.forgotten.contains(&id)
    }

    /// Returns whether another run can be tracked.
    pub(super) fn has_room(&self) -> bool {
        self.runs.len() < RUNS_MAX
    }

    /// Returns the first run that is not heard, and of which nothing is missing or held.
    pub(super) fn complete(&self, now_us: u64) -> Option<usize> {
        self.runs.iter().position(|run| {
            run.numbers.missing() == 0
                && run.held.is_empty()
                && !self.lives.is_heard(run.id, now_us)
        })
    }

    /// Returns the run that is given up if there has to be room for another.
    pub(super) fn oldest(&self, now_us: u64) -> usize {
        let mut runs = self.runs.iter();
        let quiet = runs.position(|run| !self.lives.is_heard(run.id, now_us));
        self.complete(now_us).or(quiet).unwrap_or(0)
    }

    /// Forgets a run, of which nothing is missing or held any more.
    pub(super) fn forget(&mut self, at: usize) {
        let run = self.runs.remove(at);
        self.lost_before = self.lost_before.saturating_add(run.numbers.lost());
        self.unwanted_before = self.unwanted_before.saturating_add(run.unwanted());
        self.forgotten.push_back(run.id);
        if self.forgotten.len() > FORGOTTEN_MAX {
            self.forgotten.pop_front();
        }
    }

    /// Returns how many frames were not wanted, or not held any more by when they were, because they are from before
    /// the receiver.
    pub(super) fn unwanted(&self) -> u64 {
        let runs = self.runs.iter().map(Run::unwanted);
        let before = self.unwanted_before.saturating_add(self.unwanted_held);
        runs.fold(before, u64::saturating_add)
    }

    /// Returns whether the sensor that made a run, or its successor, was heard just now.
    pub(super) fn is_heard(&self, run: &Run, now_us: u64) -> bool {
        let mut runs = self.runs.iter();
        runs.any(|other| {
            let is_same = run.lane.is_none() || other.lane == run.lane;
            is_same && self.lives.is_heard(other.id, now_us)
        })
    }

    /// Returns whether the run `by` may say that frames of another run are gone: it is that run, or that of the same
    /// sensor, started again.
    pub(super) fn may_say_gone(&self, id: u64, by: u64, now_us: u64) -> bool {
        by == id || !(self.lives.overlap(by, id) || self.lives.is_heard(id, now_us))
    }

    /// Finds out which sensor has made the runs for which that is open. A run whose predecessor may still be up has
    /// to wait for a while: if it is, there are two sensors. At the end nothing stays open.
    pub(super) fn decide(&mut self, now_us: u64, is_end: bool) {
        for at in 0..self.runs.len() {
            let run = &self.runs[at];
            if run.lane.is_some() || run.holder.is_some() {
                continue;
            }
            let id = run.id;
            let mut others = self.runs.iter().filter(|other| other.lane.is_some());
            let is_open = others.any(|other| {
                self.lives.is_heard(other.id, now_us) && !self.lives.overlap(other.id, id)
            });
            if is_open && !is_end && run.open.elapsed() < OPEN {
                continue;
            }
            let is_free = |lane: &usize| {
                let mut runs = self.runs.iter().filter(|run| run.lane == Some(*lane));
                runs.all(|other| !self.lives.overlap(other.id, id))
            };
            self.runs[at].lane = (0..=RUNS_MAX).find(is_free);
        }
        // What a store has of an earlier run is its sensor's.
        for at in 0..self.runs.len() {
            let run = &self.runs[at];
            if let (None, Some(holder)) = (run.lane, run.holder) {
                let holder = self.runs.iter().find(|run| run.id == holder);
                let lane = holder.map_or(Some(0), |holder| holder.lane);
                self.runs[at].lane = lane.or(is_end.then_some(0));
            }
        }
    }

    /// Returns whether to ask for the clocks now, and records that they are asked for.
    pub(super) fn is_clock_due(&mut self, now_us: u64) -> bool {
        let mut heard = self
            .runs
            .iter()
            .filter(|run| self.lives.is_heard(run.id, now_us));
        let Some(every) = heard.clone().map(|run| run.ahead.ask_after()).min() else {
            return false;
        };
        let is_new = heard.any(|run| run.ahead.trips() == 0 && run.open.elapsed() < CLOCK_NEW);
        let since = self.clock_asked.map(|asked| asked.elapsed());
        // A new run is asked soon.
        let is_due = since.is_none_or(|since| since >= every || (is_new && since >= WISH_AGAIN));
        if is_due {
            self.clock_asked = Some(Instant::now());
        }
        is_due
    }

    /// Records what a run's clock showed.
    pub(super) fn trip(&mut self, trip: RoundTrip) {
        let Some(run) = self.runs.iter_mut().find(|run| run.id == trip.run) else {
            return;
        };
        run.ahead.add(trip);
        if let Some(estimate) = run.ahead.at(trip.answered_us) {
            for delay_us in run.delays.drain(..) {
                self.delays.add(estimate.corrected_us(delay_us));
            }
            run.delays.shrink_to_fit();
        }
    }

    /// Records that a frame of a run whose window ended at `end_us` of the run's clock arrived at `at_us` of the
    /// receiver's.
    pub(super) fn arrived(&mut self, id: u64, end_us: u64, at_us: u64) {
        let Some(run) = self.runs.iter_mut().find(|run| run.id == id) else {
            return;
        };
        let delay_us = crate::clock::difference_us(at_us, end_us);
        match run.ahead.at(at_us) {
            Some(estimate) => self.delays.add(estimate.corrected_us(delay_us)),
            None if run.delays.len() < DELAYS_MAX => run.delays.push(delay_us),
            None => {}
        }
    }

    /// Completes the report, at a time of the receiver's clock.
    pub(super) fn tell(&mut self, now_us: u64) -> SensorReport {
        self.report.before = self.unwanted();
        let report = &mut self.report;
        let lost = self.runs.iter().map(|run| run.numbers.lost());
        report.lost = lost.fold(self.lost_before, u64::saturating_add);
        let missing = self.runs.iter().map(|run| run.numbers.missing());
        report.missing = missing.fold(self.postponed, u64::saturating_add);
        let mut newest = self.runs.iter().rev();
        report.clock = newest.find_map(|run| run.ahead.at(now_us));
        let delays = self.delays.quantiles();
        report.delay_p50_ms = delays.map(|delays| delays.p50_ms);
        report.delay_p99_ms = delays.map(|delays| delays.p99_ms);
        report.delay_max_ms = delays.map(|delays| delays.max_ms);
        report.clone()
    }
}

impl Run {
    fn new(id: u64, first: u64, joined: u64, holder: Option<u64>) -> Self {
        Self {
            id,
            numbers: Numbers::from(first),
            joined,
            held: BTreeMap::new(),
            progress: Instant::now(),
            waited: Duration::ZERO,
            lane: None,
            holder,
            open: Instant::now(),
            ahead: Ahead::default(),
            delays: Vec::new(),
        }
    }

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

    /// Returns how many frames were not wanted.
    fn unwanted(&self) -> u64 {
        self.numbers.first().saturating_add(self.numbers.passed())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Range;

    const S: u64 = 1_000_000;

    /// Where the clocks of a sensor's computer stand is not among what is known of a run: it began so long before the
    /// message, and the receiver has been there for so long.
    #[test]
    fn of_a_run_that_began_after_the_receiver_everything_is_wanted() {
        for (up_us, first) in [
            (0, 0),
            (4 * S, 0),
            (5 * S, 0),
            (5 * S + 1000, 245),
            (7200 * S, 245),
        ] {
            let joined = Joined {
                from_start: false,
                up_us: 5 * S,
            };
            let mut sensor = Sensor::default();
            let run = sensor.begin(1, 245, up_us, joined);
            run.until(250);
            assert_eq!(run.numbers.first(), first, "{up_us}");
            assert_eq!(sensor.unwanted(), first);
            assert_eq!(sensor.tell(0).missing, 250 - first);
            let joined = Joined {
                from_start: true,
                ..joined
            };
            let mut sensor = Sensor::default();
            assert_eq!(sensor.begin(1, 245, up_us, joined).numbers.first(), 0);
            // What a sensor no longer has of the time before the receiver is not lost to it.
            assert_eq!(sensor.runs[0].joined, first);
        }
    }

    #[test]
    fn a_run_in_a_store_is_wanted_unless_it_is_older_than_the_receiver() {
        let joined = Joined {
            from_start: false,
            up_us: 60 * S,
        };
        let held = |run, ago_us| Held {
            run,
            range: Range { from: 3, to: 9 },
            ago_us,
        };
        let mut sensor = Sensor::default();
        sensor.hear(50, S, 1000 * S);
        sensor.begin(50, 0, S, joined);
        assert!(sensor.wants(&held(40, Some(50 * S)), joined));
        assert!(!sensor.wants(&held(40, Some(70 * S)), joined));
        // The sensor's clock was set back: its run of a higher number may be an earlier one.
        assert!(sensor.wants(&held(60, None), joined));
        sensor.begin_held(&held(60, None), 50, joined);
        let order: Vec<u64> = sensor.runs.iter().map(|run| run.id).collect();
        assert_eq!(order, [60, 50]);
        sensor.decide(1000 * S, false);
        assert!(sensor.runs.iter().all(|run| run.lane == Some(0)));
        assert_eq!(
            (sensor.complete(1000 * S), sensor.oldest(1000 * S)),
            (Some(0), 0)
        );
        sensor.forget(0);
        assert!(sensor.has_forgotten(60) && !sensor.tracks(60));
    }

    fn lanes(sensor: &Sensor) -> Vec<(u64, Option<usize>)> {
        sensor.runs.iter().map(|run| (run.id, run.lane)).collect()
    }

    #[test]
    fn a_successor_follows_and_a_double_has_a_lane_of_its_own() {
        let joined = Joined {
            from_start: false,
            up_us: 3600 * S,
        };
        let mut sensor = Sensor::default();
        let say = |sensor: &mut Sensor, id: u64, began_us: u64, at_us: u64| {
            sensor.hear(id, at_us - began_us, at_us);
            sensor.begin(id, 0, at_us - began_us, joined);
            sensor.decide(at_us, false);
        };
        say(&mut sensor, 9, 100 * S, 100 * S);
        say(&mut sensor, 9, 100 * S, 110 * S);
        assert_eq!(lanes(&sensor), [(9, Some(0))]);
        // Started again, with a clock that was set back in between: a little later it is known to follow.
        say(&mut sensor, 5, 111 * S, 111 * S);
        assert_eq!(lanes(&sensor), [(9, Some(0)), (5, None)]);
        assert!(!sensor.may_say_gone(9, 5, 111 * S));
        say(&mut sensor, 5, 111 * S, 113 * S);
        assert_eq!(lanes(&sensor), [(9, Some(0)), (5, Some(0))]);
        assert!(sensor.may_say_gone(9, 5, 113 * S));
        assert_eq!(sensor.report.at_once, 1);
        // Another one of this name, while that one goes on.
        say(&mut sensor, 5, 111 * S, 120 * S);
        say(&mut sensor, 7, 120 * S, 120 * S);
        assert_eq!(lanes(&sensor)[2], (7, None));
        say(&mut sensor, 5, 111 * S, 121 * S + 1);
        say(&mut sensor, 7, 120 * S, 121 * S + 2);
        assert_eq!(lanes(&sensor)[1..], [(5, Some(0)), (7, Some(1))]);
        assert_eq!(sensor.report.at_once, 2);
        assert!(!sensor.may_say_gone(5, 7, 200 * S));
        // The other one is started again: it follows itself.
        say(&mut sensor, 5, 111 * S, 129 * S);
        say(&mut sensor, 7, 120 * S, 129 * S);
        say(&mut sensor, 8, 130 * S, 130 * S);
        for at_us in [131 * S, 132 * S, 133 * S] {
            say(&mut sensor, 5, 111 * S, at_us);
            say(&mut sensor, 8, 130 * S, at_us);
        }
        assert_eq!(lanes(&sensor)[3], (8, Some(1)));
    }

    #[test]
    fn one_that_comes_back_is_not_mixed_with_its_double() {
        let joined = Joined {
            from_start: false,
            up_us: 3600 * S,
        };
        let mut sensor = Sensor::default();
        sensor.hear(1, 10 * S, 10 * S);
        sensor.begin(1, 0, 10 * S, joined);
        sensor.decide(10 * S, false);
        // While it has no link, another begins, which seems to follow.
        sensor.hear(2, S, 60 * S);
        sensor.begin(2, 0, S, joined);
        sensor.decide(60 * S, false);
        assert_eq!(lanes(&sensor), [(1, Some(0)), (2, Some(0))]);
        sensor.hear(1, 70 * S, 70 * S);
        assert_eq!(lanes(&sensor), [(1, None), (2, Some(0))]);
        sensor.decide(70 * S, false);
        assert_eq!(lanes(&sensor), [(1, Some(1)), (2, Some(0))]);
    }

    #[test]
    fn delays_wait_for_the_clock() {
        let joined = Joined {
            from_start: true,
            up_us: 0,
        };
        let mut sensor = Sensor::default();
        sensor.hear(1, 0, 5000 * S);
        sensor.begin(1, 0, 0, joined);
        // A clock that is an hour ahead, and delays of 20 ms.
        let shown = |at_us: u64| at_us + 3600 * S;
        sensor.arrived(1, shown(5000 * S), 5000 * S + 20_000);
        assert_eq!(sensor.tell(5001 * S).delay_p50_ms, None);
        assert!(sensor.is_clock_due(5001 * S) && !sensor.is_clock_due(5001 * S));
        sensor.trip(RoundTrip {
            run: 1,
            asked_us: 5001 * S,
            shown_us: shown(5001 * S + 500),
            answered_us: 5001 * S + 1000,
        });
        sensor.arrived(1, shown(5002 * S), 5002 * S + 20_000);
        let report = sensor.tell(5002 * S);
        assert_eq!(
            report.clock.map(|clock| clock.ahead_us),
            Some(3600 * S as i64)
        );
        assert_eq!(sensor.delays.count(), 2);
        let p50_ms = report.delay_p50_ms.unwrap();
        assert!((p50_ms - 20.0).abs() < 20.0 / 16.0, "{p50_ms}");
    }
}
