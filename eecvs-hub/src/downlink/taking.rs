//! The thread that takes what arrives: counts it, delivers it, requests what is missing, and gives up what does not
//! arrive.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use eecvs_nostd::Frame;

use super::ask::ask;
use super::sensor::{Asking, Joined, RUNS_MAX, Sensor};
use super::{Came, Deliver, Delivered, Report, SENSORS_MAX, SensorReport, Shared, lock};
use crate::key::Name;
use crate::latency::Latencies;
use crate::link::Client;
use crate::message::{RANGES_MAX, Range, Stamp, Wish, now_us};

/// A sensor counts as heard if something arrived from it within this time: it sends its status twice a second.
const HEARD: Duration = Duration::from_secs(3);

/// Interval at which missing frames are looked for and requested.
const WISH: Duration = Duration::from_millis(50);

/// The thread that takes what arrives.
pub(super) struct Taking {
    pub(super) shared: Arc<Shared>,
    pub(super) client: Client,
    pub(super) sensors: BTreeMap<Name, Sensor>,
    pub(super) deliver: Deliver,
    /// Bytes of frames held until earlier ones arrive.
    pub(super) held_bytes: usize,
    pub(super) wishes: u64,
    pub(super) is_down: bool,
    pub(super) outages: u64,
}

impl Taking {
    pub(super) fn run(mut self) -> Result<()> {
        let mut wished = Instant::now();
        let mut told = Instant::now();
        loop {
            let is_stopped = self.shared.stop.load(Ordering::Relaxed);
            let batch = self.wait(is_stopped);
            for came in batch {
                self.take(came)?;
            }
            let now = Instant::now();
            if now.saturating_duration_since(wished) >= WISH {
                let since = now.saturating_duration_since(wished);
                wished = now;
                self.look();
                self.wish();
                self.give_up(since)?;
            }
            if is_stopped {
                self.end()?;
                self.tell();
                return Ok(());
            }
            if now.saturating_duration_since(told) >= 4 * WISH {
                told = now;
                self.tell();
            }
        }
    }

    /// Takes all that has arrived; waits up to [`WISH`] if nothing has.
    fn wait(&self, is_stopped: bool) -> VecDeque<Came> {
        let mut inbox = lock(&self.shared.inbox);
        if inbox.waiting.is_empty() && !is_stopped {
            let waited = self.shared.changed.wait_timeout(inbox, WISH);
            inbox = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        inbox.bytes = 0;
        std::mem::take(&mut inbox.waiting)
    }

    fn take(&mut self, came: Came) -> Result<()> {
        let (Came::Frame { name, .. }
        | Came::Status(name, _)
        | Came::Gone(name, _)
        | Came::Answered(name, _)
        | Came::Malformed(name)) = &came;
        let name = name.clone();
        if !self.sensors.contains_key(&name) && self.sensors.len() >= SENSORS_MAX {
            lock(&self.shared.inbox).refused += 1;
            return Ok(());
        }
        let sensor = self.sensors.entry(name.clone()).or_insert_with(|| Sensor {
            report: SensorReport {
                name: name.to_string(),
                ..SensorReport::default()
            },
            ..Sensor::default()
        });
        if !matches!(came, Came::Answered(..)) {
            sensor.heard = Some(Instant::now());
        }
        let options = &self.shared.options;
        let joined = Joined {
            from_start: options.from_start,
            started_us: self.shared.started_us,
        };
        match came {
            Came::Malformed(_) => sensor.report.malformed += 1,
            Came::Answered(_, wish) => {
                if sensor.asking.wish == Some(wish) {
                    sensor.asking.wish = None;
                }
            }
            Came::Status(_, status) => {
                sensor.note_clock(status.now_us, now_us());
                if let Some(run) = sensor.run(status.run, status.next, joined) {
                    run.until(status.next);
                }
                for (number, range) in status.held {
                    // Frames from before this receiver are wanted only if the options say so.
                    let is_known = sensor.runs.contains_key(&number);
                    if number < status.run && (is_known || sensor.is_whole(number, joined)) {
                        let from = if joined.from_start { range.from } else { 0 };
                        if let Some(run) = sensor.run(number, from, joined) {
                            run.until(range.to);
                        }
                    }
                }
            }
            Came::Gone(_, answer) => {
                sensor.asking.hear();
                if let Some(run) = sensor.runs.get_mut(&answer.run) {
                    for range in &answer.gone {
                        run.numbers.give_up(*range);
                    }
                    self.settle(&name)?;
                }
            }
            Came::Frame {
                stamp,
                frame,
                at_us,
                is_again,
                ..
            } => {
                return self.frame(&name, stamp, frame, at_us, is_again);
            }
        }
        Ok(())
    }

    fn frame(
        &mut self,
        name: &Name,
        stamp: Stamp,
        frame: Vec<u8>,
        at_us: u64,
        is_again: bool,
    ) -> Result<()> {
        let options = &self.shared.options;
        let joined = Joined {
            from_start: options.from_start,
            started_us: self.shared.started_us,
        };
        let Some(sensor) = self.sensors.get_mut(name) else {
            return Ok(());
        };
        // A damaged frame counts as not received: it is requested again.
        let Ok(parsed) = Frame::parse(&frame) else {
            sensor.report.damaged += 1;
            return Ok(());
        };
        let events = parsed.header.events;
        let is_full = self.held_bytes + frame.len() > options.waiting_bytes;
        // A frame sent again is too old for its stamp to show the sensor's clock.
        if !is_again {
            sensor.note_clock(stamp.end_us, at_us);
        }
        let (is_new, is_behind) = match sensor.run(stamp.run, stamp.number, joined) {
            None => (false, false),
            Some(run) => {
                let is_behind =
                    !options.as_they_come && is_full && stamp.number != run.numbers.settled();
                // The frame would have to wait for earlier ones, and there is no room: it is requested once they
                // have arrived.
                if is_behind {
                    run.until(stamp.number.saturating_add(1));
                }
                (!is_behind && run.take(stamp.number), is_behind)
            }
        };
        if is_behind {
            lock(&self.shared.inbox).no_room += 1;
            return Ok(());
        }
        if !is_new {
            sensor.report.needless += 1;
            return Ok(());
        }
        sensor.report.frames += 1;
        sensor.report.bytes += frame.len() as u64;
        sensor.report.events += u64::from(events);
        if is_again {
            sensor.report.again += 1;
            sensor.asking.hear();
        } else {
            sensor.delays.add(at_us as i64 - stamp.end_us as i64);
        }
        if options.as_they_come {
            return (self.deliver)(Delivered {
                name,
                stamp,
                frame: &frame,
            });
        }
        self.held_bytes += frame.len();
        if let Some(run) = sensor.runs.get_mut(&stamp.run) {
            run.held.insert(stamp.number, (stamp, frame));
        }
        self.settle(name)
    }

    /// Delivers the held frames that no longer wait for missing ones. A run's missing frames also hold up the next
    /// run.
    fn settle(&mut self, name: &Name) -> Result<()> {
        let Some(sensor) = self.sensors.get_mut(name) else {
            return Ok(());
        };
        for run in sensor.runs.values_mut() {
            let settled = run.numbers.settled();
            while let Some(first) = run.held.first_entry() {
                if *first.key() >= settled {
                    break;
                }
                let (stamp, frame) = first.remove();
                self.held_bytes -= frame.len();
                (self.deliver)(Delivered {
                    name,
                    stamp,
                    frame: &frame,
                })?;
            }
            if run.numbers.missing() > 0 {
                break;
            }
        }
        Ok(())
    }

    /// Checks the link, and counts its failures.
    fn look(&mut self) {
        let is_down = !self.client.is_connected();
        if is_down && !self.is_down {
            self.outages += 1;
        }
        if is_down {
            // Answers in progress will not arrive.
            for sensor in self.sensors.values_mut() {
                sensor.asking = Asking::default();
            }
        }
        self.is_down = is_down;
    }

    /// Requests from every sensor what is missing in its oldest incomplete run.
    fn wish(&mut self) {
        let Some(session) = self.client.session() else {
            return;
        };
        if self.is_down {
            return;
        }
        let zid = session.zid().to_le_bytes();
        let receiver = zid.first_chunk().map_or(0, |zid| u64::from_le_bytes(*zid));
        for (name, sensor) in &mut self.sensors {
            if !sensor.asking.is_due() {
                continue;
            }
            let missing = sensor
                .runs
                .iter()
                .find(|(_, run)| run.numbers.missing() > 0 && run.progress.elapsed() >= WISH);
            let Some((&run, missing)) = missing else {
                continue;
            };
            let ranges = missing.numbers.gaps(RANGES_MAX);
            self.wishes += 1;
            sensor.asking.ask(self.wishes);
            let wish = Wish {
                receiver,
                run,
                ranges,
            };
            // A request that cannot be sent now is sent later.
            let _ = ask(&self.shared, session, name, self.wishes, &wish);
        }
    }

    /// Gives up what has not arrived for too long.
    ///
    /// Time counts only while the sensor is heard: a sensor that is switched off, or whose link has failed, may
    /// still hold the frames.
    fn give_up(&mut self, since: Duration) -> Result<()> {
        let patience = self.shared.options.patience;
        let is_down = self.is_down;
        let mut given_up = Vec::new();
        for (name, sensor) in &mut self.sensors {
            let newest = sensor.runs.keys().next_back().copied();
            let many = sensor.runs.len() > RUNS_MAX;
            let is_heard = !is_down && sensor.heard.is_some_and(|heard| heard.elapsed() < HEARD);
            for (index, run) in sensor.runs.values_mut().enumerate() {
                if is_heard && run.numbers.missing() > 0 {
                    run.waited += since;
                }
                let is_old = run.waited >= patience;
                if run.numbers.missing() > 0 && (is_old || (many && index == 0)) {
                    let all = Range {
                        from: 0,
                        to: run.numbers.next(),
                    };
                    run.numbers.give_up(all);
                    given_up.push(name.clone());
                }
            }
            // If there are too many runs, the oldest is forgotten, provided that none of its frames is missing or
            // held.
            if many
                && let Some(mut first) = sensor.runs.first_entry()
                && Some(*first.key()) != newest
                && first.get_mut().held.is_empty()
                && first.get().numbers.missing() == 0
            {
                sensor.lost_before += first.remove().numbers.lost();
            }
        }
        for name in given_up {
            self.settle(&name)?;
        }
        Ok(())
    }

    /// Nothing more arrives: held frames are delivered without the missing ones.
    fn end(&mut self) -> Result<()> {
        let names: Vec<Name> = self.sensors.keys().cloned().collect();
        for name in names {
            let Some(sensor) = self.sensors.get_mut(&name) else {
                continue;
            };
            for run in sensor.runs.values_mut() {
                let all = Range {
                    from: 0,
                    to: run.numbers.next(),
                };
                run.numbers.give_up(all);
            }
            self.settle(&name)?;
        }
        Ok(())
    }

    fn tell(&mut self) {
        let (no_room, refused) = {
            let inbox = lock(&self.shared.inbox);
            (inbox.no_room, inbox.refused)
        };
        let mut delays = Latencies::default();
        let sensors = self.sensors.values_mut().map(|sensor| {
            delays.merge(&sensor.delays);
            let report = &mut sensor.report;
            let lost = sensor.runs.values().map(|run| run.numbers.lost());
            report.lost = lost.fold(sensor.lost_before, u64::saturating_add);
            report.missing = sensor.runs.values().map(|run| run.numbers.missing()).sum();
            let delays = sensor.delays.quantiles();
            (
                report.delay_p50_ms,
                report.delay_p99_ms,
                report.delay_max_ms,
            ) = (delays.p50_ms, delays.p99_ms, delays.max_ms);
            report.clone()
        });
        let sensors: Vec<SensorReport> = sensors.collect();
        let report = Report {
            sensors,
            no_room,
            refused,
            outages: self.outages,
            delays,
        };
        *lock(&self.shared.report) = report;
    }
}
