//! The board's state of one sensor.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use eecvs_nostd::{Header, Sensor as Size};

use super::kept::Kept;
use super::latency::Latencies;
use super::picture;
use super::rate::{Amount, Rate};
use super::row::{Latest, Losses, Row};
use super::runs::{Place, Runs};
use crate::clock::{Ahead, Estimate, RoundTrip};
use crate::key::Name;
use crate::lives::Lives;
use crate::message::{Stamp, Status};

/// How long frames are kept after a request for a picture.
const WANTED: Duration = Duration::from_secs(10);

/// Shortest time between two decodings of a sensor's frames.
const BETWEEN: Duration = Duration::from_secs(1);

/// If no token was ever seen, a sensor heard within this time counts as connected.
const HEARD: Duration = Duration::from_secs(5);

/// Maximum number of runs whose clocks are known.
const CLOCKS_MAX: usize = 4;

/// A moment: time since the board began, and time by the board's clock.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    pub at: Duration,
    pub unix_us: u64,
}

/// A frame that has arrived, as far as it was read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrived<'f> {
    pub stamp: Stamp,
    /// `None` if the frame is damaged.
    pub header: Option<&'f Header>,
    pub bytes: &'f [u8],
}

/// A sensor, shared by threads.
#[derive(Debug, Default)]
pub(super) struct Sensor {
    state: Mutex<State>,
    picture: Mutex<Decoded>,
}

#[derive(Debug, Default)]
struct State {
    is_alive: Option<bool>,
    size: Option<Size>,
    runs: Runs,
    lives: Lives,
    at_once_most: usize,
    /// Differences of the clocks of the latest runs.
    clocks: Vec<(u64, Ahead)>,
    clock_asked_at: Option<Duration>,
    frame_at: Option<Duration>,
    status_at: Option<Duration>,
    status: Status,
    rate: Rate,
    latencies: Latencies,
    latest: Option<Latest>,
    windows: [u64; 3],
    frames: u64,
    events: u64,
    bytes: u64,
    damaged: u64,
    repeated: u64,
    malformed: u64,
    wanted_at: Option<Duration>,
    kept: Kept,
    kept_run: u64,
}

/// The last picture.
#[derive(Debug, Default)]
struct Decoded {
    png: Option<Vec<u8>>,
    of: Option<u64>,
    at: Option<Duration>,
    is_busy: bool,
}

/// Locks a mutex. Poisoning is ignored: the contents are counts, which a panic leaves usable.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Sensor {
    pub(super) fn frame(&self, now: Moment, arrived: Arrived<'_>) {
        lock(&self.state).frame(now, arrived);
    }

    pub(super) fn status(&self, now: Moment, status: Status) {
        let mut state = lock(&self.state);
        state.hear(status.run, status.up_us, now);
        state.runs.told(status.run, status.next);
        state.size = Size::new(status.width, status.height).or(state.size);
        state.status = status;
        // Only the figures are needed.
        state.status.held = Vec::new();
        state.status_at = Some(now.at);
    }

    /// Records what the sensor's clock showed.
    pub(super) fn trip(&self, trip: RoundTrip) {
        lock(&self.state).trip(trip);
    }

    /// Returns whether to ask for the sensor's clock now, and records that it is asked for.
    pub(super) fn is_clock_due(&self, now: Moment) -> bool {
        lock(&self.state).is_clock_due(now)
    }

    /// Returns how many sensors send under this name at present.
    pub(super) fn at_once(&self, now: Moment) -> usize {
        lock(&self.state).lives.at_once(now.unix_us)
    }

    pub(super) fn alive(&self, is_alive: bool) {
        lock(&self.state).is_alive = Some(is_alive);
    }

    pub(super) fn malformed(&self) {
        lock(&self.state).malformed += 1;
    }

    /// Notes that somebody looks at the sensor's picture: frames are kept from now on.
    pub(super) fn want(&self, now: Moment) {
        lock(&self.state).wanted_at = Some(now.at);
    }

    /// Drops what was kept for a picture that nobody looks at any more.
    fn tidy(&self, now: Moment) {
        if !lock(&self.state).tidy(now.at) {
            let mut decoded = lock(&self.picture);
            if !decoded.is_busy {
                *decoded = Decoded::default();
            }
        }
    }

    pub(super) fn row(&self, name: &Name, now: Moment) -> Row {
        self.tidy(now);
        lock(&self.state).row(name, now)
    }

    /// Returns the picture; decodes it if there is a new one, but not too often.
    pub(super) fn png(&self, now: Moment) -> Option<Vec<u8>> {
        let (of, frames) = {
            let mut state = lock(&self.state);
            state.wanted_at = Some(now.at);
            (state.kept.picture(), state.kept.frames())
        };
        {
            let mut decoded = lock(&self.picture);
            let is_recent = decoded
                .at
                .is_some_and(|at| now.at.saturating_sub(at) < BETWEEN);
            if of.is_none() || decoded.of == of || is_recent || decoded.is_busy {
                return decoded.png.clone();
            }
            decoded.is_busy = true;
        }
        let png = picture::latest(&frames).and_then(|sums| picture::png(&sums));
        let mut decoded = lock(&self.picture);
        decoded.is_busy = false;
        decoded.of = of;
        decoded.at = Some(now.at);
        if png.is_some() {
            decoded.png = png;
        }
        decoded.png.clone()
    }
}

impl State {
    fn frame(&mut self, now: Moment, arrived: Arrived<'_>) {
        let Stamp {
            run,
            number,
            end_us,
            up_us,
        } = arrived.stamp;
        self.frame_at = Some(now.at);
        self.hear(run, up_us, now);
        let place = self.runs.take(run, number);
        if place == Place::Again {
            self.repeated += 1;
            return;
        }
        let Some(header) = arrived.header else {
            self.damaged += 1;
            return;
        };
        let bytes = arrived.bytes.len() as u64;
        let begins = u64::from(header.part == 0);
        self.frames += 1;
        self.events += u64::from(header.events);
        self.bytes += bytes;
        self.windows[header.regime as usize] += begins;
        let amount = Amount {
            events: u64::from(header.events),
            bytes,
            windows: begins,
            thinned: u64::from(header.thinned),
        };
        self.rate.add(now.at, amount);
        if place != Place::New {
            return;
        }
        // Between clocks whose difference is not known there is no latency.
        if let Some(clock) = self.clock(run, now) {
            let latency_us = clock.since_us(end_us, now.unix_us);
            self.latencies.add(now.at, latency_us);
        }
        self.size = Some(header.sensor);
        self.latest = Some(Latest::of(header));
        if run != self.kept_run {
            self.kept_run = run;
            self.kept.clear();
        }
        if self.tidy(now.at) {
            self.kept.take(number, header, arrived.bytes);
        }
    }

    /// Records that a run was up.
    fn hear(&mut self, run: u64, up_us: u64, now: Moment) {
        self.lives.hear(run, up_us, now.unix_us);
        self.at_once_most = self.at_once_most.max(self.lives.at_once(now.unix_us));
    }

    fn trip(&mut self, trip: RoundTrip) {
        if let Some((_, ahead)) = self.clocks.iter_mut().find(|(run, _)| *run == trip.run) {
            return ahead.add(trip);
        }
        if self.clocks.len() >= CLOCKS_MAX {
            self.clocks.remove(0);
        }
        let mut ahead = Ahead::default();
        ahead.add(trip);
        self.clocks.push((trip.run, ahead));
    }

    /// Returns how far a run's clock is ahead.
    fn clock(&self, run: u64, now: Moment) -> Option<Estimate> {
        let (_, ahead) = self.clocks.iter().find(|(of, _)| *of == run)?;
        ahead.at(now.unix_us)
    }

    fn is_clock_due(&mut self, now: Moment) -> bool {
        let run = self.runs.run();
        if !self.lives.is_heard(run, now.unix_us) {
            return false;
        }
        let ahead = self.clocks.iter().find(|(of, _)| *of == run);
        let every = ahead.map_or(Duration::ZERO, |(_, ahead)| ahead.ask_after());
        let since = self.clock_asked_at.map(|at| now.at.saturating_sub(at));
        let is_due = since.is_none_or(|since| since >= every);
        if is_due {
            self.clock_asked_at = Some(now.at);
        }
        is_due
    }

    /// Returns whether somebody looks at the picture; if not, drops the frames kept for it.
    fn tidy(&mut self, at: Duration) -> bool {
        let is_wanted = self
            .wanted_at
            .is_some_and(|wanted| at.saturating_sub(wanted) < WANTED);
        if !is_wanted && self.kept.bytes() > 0 {
            self.kept.clear();
        }
        is_wanted
    }

    fn row(&mut self, name: &Name, now: Moment) -> Row {
        let age = |at: Option<Duration>| Some(now.at.saturating_sub(at?).as_secs_f64());
        let heard = self.frame_at.max(self.status_at);
        let is_heard = heard.is_some_and(|at| now.at.saturating_sub(at) < HEARD);
        let status = &self.status;
        let (events, stored) = (status.events, status.stored);
        Row {
            name: name.clone(),
            is_connected: self.is_alive.unwrap_or(is_heard),
            columns: self.size.map_or(0, |size| size.width),
            rows: self.size.map_or(0, |size| size.height),
            run: self.runs.run(),
            up_s: age(self.status_at).map(|age_s| status.up_us as f64 / 1e6 + age_s),
            at_once: self.lives.at_once(now.unix_us),
            at_once_most: self.at_once_most,
            frame_age_s: age(self.frame_at),
            status_age_s: age(self.status_at),
            rate: self.rate.over(now.at),
            frames_received: self.frames,
            events_received: self.events,
            bytes_received: self.bytes,
            windows: self.windows,
            window: self.latest,
            losses: Losses {
                events_late: events.late,
                events_filtered: events.filtered,
                events_dropped: events.dropped,
                events_thinned: events.thinned,
                frames_missing: self.runs.missing(),
                frames_missing_before: self.runs.missing_before(),
                frames_damaged: self.damaged,
                frames_repeated: self.repeated,
                frames_let_go: stored.let_go_frames,
                disk_failures: stored.disk_failures,
                disk_damaged_frames: stored.disk_damaged_frames,
                malformed: self.malformed,
                outages: status.outages,
                outages_s: status.outages_us as f64 / 1e6,
            },
            latency: self.latencies.over(now.at),
            clock: self.clock(self.runs.run(), now),
            budget: status.budget,
            is_congested: status.is_congested,
            store_memory_bytes: stored.memory_bytes,
            store_disk_bytes: stored.disk_bytes,
            store_damaged_bytes: stored.disk_damaged_bytes,
            picture: self.kept.picture(),
        }
    }
}
