//! The thread that takes what arrives: counts it, delivers it, requests what is missing, and gives up what does not
//! arrive.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use eecvs_nostd::Frame;

use super::ask::ask;
use super::sensor::{Asking, Joined, Run, Sensor};
use super::{Came, Deliver, Delivered, Report, SENSORS_MAX, SensorReport, Shared, lock};
use crate::key::Name;
use crate::latency::Latencies;
use crate::link::{Client, ask_clock};
use crate::message::{Answer, HELD_MAX, RANGES_MAX, Range, Stamp, Status, Wish};

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
                self.decide(false)?;
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
        | Came::Status { name, .. }
        | Came::Gone(name, _)
        | Came::Trip(name, _)
        | Came::Answered(name, _)
        | Came::Malformed(name)) = &came;
        let name = name.clone();
        if !self.sensors.contains_key(&name) && self.sensors.len() >= SENSORS_MAX {
            lock(&self.shared.inbox).refused += 1;
            return Ok(());
        }
        let sensor = self.sensors.entry(name.clone());
        let sensor = sensor.or_insert_with(|| Sensor::new(&name));
        match came {
            Came::Malformed(_) => sensor.report.malformed += 1,
            Came::Answered(_, wish) => {
                if sensor.asking.wish == Some(wish) {
                    sensor.asking.wish = None;
                }
            }
            Came::Trip(_, trip) => sensor.trip(trip),
            Came::Status { status, at_us, .. } => return self.status(&name, &status, at_us),
            Came::Gone(_, answer) => return self.gone(&name, &answer),
            Came::Frame {
                stamp,
                frame,
                at_us,
                is_again,
                ..
            } => return self.frame(&name, stamp, frame, at_us, is_again),
        }
        Ok(())
    }

    /// Returns what is wanted of a run from which a message arrived at `at_us`.
    fn joined(&self, at_us: u64) -> Joined {
        Joined {
            from_start: self.shared.options.from_start,
            up_us: at_us.saturating_sub(self.shared.clock.origin_us()),
        }
    }

    fn status(&mut self, name: &Name, status: &Status, at_us: u64) -> Result<()> {
        let joined = self.joined(at_us);
        self.make_room(name, status.run)?;
        let Some(sensor) = self.sensors.get_mut(name) else {
            return Ok(());
        };
        sensor.hear(status.run, status.up_us, at_us);
        sensor
            .begin(status.run, status.next, status.up_us, joined)
            .until(status.next);
        let (mut unwanted, mut postponed) = (0_u64, 0_u64);
        for held in status.held.iter().take(HELD_MAX) {
            let count = held.range.to.saturating_sub(held.range.from);
            if held.run == status.run || sensor.has_forgotten(held.run) {
                continue;
            }
            if !sensor.wants(held, joined) {
                unwanted = unwanted.saturating_add(count);
                continue;
            }
            if !sensor.tracks(held.run)
                && !sensor.has_room()
                && let Some(complete) = sensor.complete(at_us)
            {
                sensor.forget(complete);
            }
            // While earlier runs are still coming, later ones wait: the next status names them again.
            if !sensor.tracks(held.run) && !sensor.has_room() {
                postponed = postponed.saturating_add(count);
                continue;
            }
            let run = sensor.begin_held(held, status.run, joined);
            run.until(held.range.to);
        }
        (sensor.unwanted_held, sensor.postponed) = (unwanted, postponed);
        self.settle(name)
    }

    /// Takes the numbers of requested frames that a sensor does not hold.
    fn gone(&mut self, name: &Name, answer: &Answer) -> Result<()> {
        let now_us = self.shared.clock.now_us();
        let Some(sensor) = self.sensors.get_mut(name) else {
            return Ok(());
        };
        // Another sensor of this name knows nothing of the run.
        if !sensor.may_say_gone(answer.run, answer.by, now_us) {
            return Ok(());
        }
        sensor.asking.hear();
        let Some(run) = sensor.run(answer.run) else {
            return Ok(());
        };
        for range in &answer.gone {
            let before = Range {
                from: range.from,
                to: range.to.min(run.joined),
            };
            run.numbers.pass(before);
            run.numbers.give_up(*range);
        }
        self.settle(name)
    }

    /// Forgets a run if there are too many to track another one: what is missing of it is lost.
    fn make_room(&mut self, name: &Name, run: u64) -> Result<()> {
        let now_us = self.shared.clock.now_us();
        let Some(sensor) = self.sensors.get_mut(name) else {
            return Ok(());
        };
        if sensor.tracks(run) || sensor.has_room() {
            return Ok(());
        }
        let at = sensor.oldest(now_us);
        sensor.decide(now_us, true);
        let Some(oldest) = sensor.runs.get_mut(at) else {
            return Ok(());
        };
        oldest.numbers.give_up(all(oldest.numbers.next()));
        let lane = oldest.lane.unwrap_or(0);
        let held = std::mem::take(&mut oldest.held);
        sensor.forget(at);
        for held in held.into_values() {
            deliver(&mut self.deliver, &mut self.held_bytes, name, lane, held)?;
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
        let joined = self.joined(at_us);
        let options = &self.shared.options;
        let as_they_come = options.as_they_come;
        let is_full = self.held_bytes + frame.len() > options.waiting_bytes;
        let Some(sensor) = self.sensors.get_mut(name) else {
            return Ok(());
        };
        // A damaged frame counts as not received: it is requested again.
        let Ok(parsed) = Frame::parse(&frame) else {
            sensor.report.damaged += 1;
            return Ok(());
        };
        let events = parsed.header.events;
        // A frame sent again says nothing of when its run was up, and is wanted only if its run is tracked.
        if is_again && !sensor.tracks(stamp.run) {
            sensor.report.needless += 1;
            return Ok(());
        }
        if !is_again {
            self.make_room(name, stamp.run)?;
        }
        let Some(sensor) = self.sensors.get_mut(name) else {
            return Ok(());
        };
        if !is_again {
            sensor.hear(stamp.run, stamp.up_us, at_us);
        }
        let run = sensor.begin(stamp.run, stamp.number, stamp.up_us, joined);
        let waits = run.lane.is_none() || (!as_they_come && stamp.number != run.numbers.settled());
        // The frame would have to wait, and there is no room: it is requested later.
        if is_full && waits {
            run.until(stamp.number.saturating_add(1));
            lock(&self.shared.inbox).no_room += 1;
            return Ok(());
        }
        if !run.take(stamp.number) {
            sensor.report.needless += 1;
            return Ok(());
        }
        let bytes = frame.len();
        run.held.insert(stamp.number, (stamp, frame));
        self.held_bytes += bytes;
        sensor.report.frames += 1;
        sensor.report.bytes += bytes as u64;
        sensor.report.events += u64::from(events);
        if is_again {
            sensor.report.again += 1;
            sensor.asking.hear();
        } else {
            sensor.arrived(stamp.run, stamp.end_us, at_us);
        }
        self.settle(name)
    }

    /// Delivers the held frames that no longer wait for missing ones. A run's missing frames also hold up the next
    /// run of the same sensor.
    fn settle(&mut self, name: &Name) -> Result<()> {
        let as_they_come = self.shared.options.as_they_come;
        let now_us = self.shared.clock.now_us();
        let Some(sensor) = self.sensors.get_mut(name) else {
            return Ok(());
        };
        sensor.decide(now_us, false);
        // A bit for each lane, of which there are few.
        let mut held_up = 0_u32;
        for run in &mut sensor.runs {
            let Some(lane) = run.lane else { continue };
            let bit = 1_u32.checked_shl(lane as u32).unwrap_or(0);
            if held_up & bit != 0 && !as_they_come {
                continue;
            }
            let settled = match as_they_come {
                true => u64::MAX,
                false => run.numbers.settled(),
            };
            while let Some(first) = run.held.first_entry() {
                if *first.key() >= settled {
                    break;
                }
                let held = first.remove();
                deliver(&mut self.deliver, &mut self.held_bytes, name, lane, held)?;
            }
            if run.numbers.missing() > 0 {
                held_up |= bit;
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

    /// Finds out which sensors have made runs for which that was open.
    fn decide(&mut self, is_end: bool) -> Result<()> {
        let now_us = self.shared.clock.now_us();
        let mut decided = Vec::new();
        for (name, sensor) in &mut self.sensors {
            if sensor.runs.iter().any(|run| run.lane.is_none()) {
                sensor.decide(now_us, is_end);
                decided.push(name.clone());
            }
        }
        for name in decided {
            self.settle(&name)?;
        }
        Ok(())
    }

    /// Requests from every sensor what is missing in its oldest incomplete run, or in another one if that was in
    /// vain; and asks for its clock.
    fn wish(&mut self) {
        let Some(session) = self.client.session() else {
            return;
        };
        if self.is_down {
            return;
        }
        let zid = session.zid().to_le_bytes();
        let receiver = zid.first_chunk().map_or(0, |zid| u64::from_le_bytes(*zid));
        let now_us = self.shared.clock.now_us();
        for (name, sensor) in &mut self.sensors {
            if sensor.is_clock_due(now_us) {
                let (shared, own) = (Arc::clone(&self.shared), name.clone());
                // A question that cannot be sent now is sent later.
                let _ = ask_clock(session, name, shared.clock, move |trip| {
                    shared.put(Came::Trip(own.clone(), trip));
                });
            }
            if !sensor.asking.is_due() {
                continue;
            }
            let is_incomplete =
                |run: &&Run| run.numbers.missing() > 0 && run.progress.elapsed() >= WISH;
            let count = sensor.runs.iter().filter(is_incomplete).count();
            let turn = (sensor.asking.in_vain as usize).checked_rem(count);
            let missing = turn.and_then(|turn| {
                let mut runs = sensor.runs.iter().filter(is_incomplete);
                runs.nth(turn)
            });
            let Some(missing) = missing else {
                continue;
            };
            let (run, ranges) = (missing.id, missing.numbers.gaps(RANGES_MAX));
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
        let now_us = self.shared.clock.now_us();
        let is_down = self.is_down;
        let mut given_up = Vec::new();
        for (name, sensor) in &mut self.sensors {
            for at in 0..sensor.runs.len() {
                let run = &sensor.runs[at];
                if run.numbers.missing() == 0 {
                    continue;
                }
                let is_heard = !is_down && sensor.is_heard(run, now_us);
                let run = &mut sensor.runs[at];
                if is_heard {
                    run.waited += since;
                }
                if run.waited >= patience {
                    run.numbers.give_up(all(run.numbers.next()));
                    given_up.push(name.clone());
                }
            }
        }
        for name in given_up {
            self.settle(&name)?;
        }
        Ok(())
    }

    /// Nothing more arrives: held frames are delivered without the missing ones.
    fn end(&mut self) -> Result<()> {
        self.decide(true)?;
        let names: Vec<Name> = self.sensors.keys().cloned().collect();
        for name in names {
            let Some(sensor) = self.sensors.get_mut(&name) else {
                continue;
            };
            for run in &mut sensor.runs {
                run.numbers.give_up(all(run.numbers.next()));
            }
            let postponed = std::mem::take(&mut sensor.postponed);
            sensor.lost_before = sensor.lost_before.saturating_add(postponed);
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
        let now_us = self.shared.clock.now_us();
        let sensors = self.sensors.values_mut().map(|sensor| {
            delays.merge(&sensor.delays);
            sensor.tell(now_us)
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

/// Delivers a frame that was held.
fn deliver(
    to: &mut Deliver,
    held_bytes: &mut usize,
    name: &Name,
    lane: usize,
    (stamp, frame): (Stamp, Vec<u8>),
) -> Result<()> {
    *held_bytes -= frame.len();
    to(Delivered {
        name,
        lane,
        stamp,
        frame: &frame,
    })
}

/// Returns the range of all numbers below one.
const fn all(next: u64) -> Range {
    Range { from: 0, to: next }
}
