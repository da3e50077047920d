//! The thread that owns the link: new frames go first, requested ones when nothing else waits.

use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use zenoh::Wait;
use zenoh::query::Query;

use super::answer::Answering;
use super::{Ending, Shared, State};
use crate::budget::{Bucket, Governor};
use crate::downlink::ANSWER_MAX;
use crate::key::Kind;
use crate::link::Client;
use crate::message::{Answer, Message, Stamp, Status, Wish};

/// Intervals at which the sensor sends its status, checks its link, and adapts its rate to the link.
const STATUS: Duration = Duration::from_millis(500);
const LOOK: Duration = Duration::from_millis(50);
const STEP: Duration = Duration::from_millis(1000 / Governor::STEPS_HZ as u64);

/// Longest sleep of the thread.
const SLEEP: Duration = Duration::from_millis(200);

/// At the end, after this time without a request, no receiver misses anything: one that does would have asked
/// again.
const QUIET: Duration = ANSWER_MAX.saturating_mul(2);

/// While frames are requested again, one part in this many of the budget is reserved for them.
const AGAIN_PART: u32 = 8;

/// Maximum bytes that wait for the link: beyond it, the newest frame goes first.
const WAITING_MAX: u64 = 8 << 20;

/// The thread of the link.
pub(super) struct Link<'s> {
    shared: &'s Shared,
    bucket: Bucket,
    answering: Option<Answering>,
    looked: Instant,
    stepped: Instant,
    said: Instant,
    /// Bytes sent and made up to the previous step.
    before: (u64, u64),
}

/// What to do next.
enum Act {
    Send(Stamp, Arc<[u8]>),
    Answer(Box<(Query, Wish)>),
    GoOn,
    Wait(Duration),
    End,
}

impl<'s> Link<'s> {
    pub(super) fn new(shared: &'s Shared) -> Self {
        let now = Instant::now();
        let rate = shared.state().own_budget;
        Self {
            shared,
            bucket: Bucket::new(rate, now),
            answering: None,
            looked: now - LOOK,
            stepped: now,
            said: now - STATUS,
            before: (0, 0),
        }
    }

    pub(super) fn run(&mut self) {
        loop {
            let now = Instant::now();
            let mut state = self.shared.state();
            self.look(&mut state, now);
            self.step(&mut state, now);
            let status = self
                .is_status_due(&state, now)
                .then(|| self.shared.status(&state));
            let act = self.next(&mut state, now);
            if let Act::Wait(most) = act
                && status.is_none()
            {
                let waited = self.shared.changed.wait_timeout(state, most);
                drop(waited.unwrap_or_else(PoisonError::into_inner));
                continue;
            }
            drop(state);
            if let Some(status) = status {
                self.say(&status);
            }
            match act {
                Act::Send(stamp, frame) => self.send(stamp, &frame),
                Act::Answer(asked) => self.begin(*asked),
                Act::GoOn => self.go_on(),
                Act::Wait(_) => {}
                Act::End => {
                    let status = self.shared.status(&self.shared.state());
                    self.say(&status);
                    return;
                }
            }
        }
    }

    /// Checks whether there is a link, and records outages.
    fn look(&mut self, state: &mut State, now: Instant) {
        if now.saturating_duration_since(self.looked) < LOOK {
            return;
        }
        self.looked = now;
        let is_there = self.shared.ends.get().is_some()
            && self.shared.client.get().is_some_and(Client::is_connected);
        match state.down {
            Some(since) if is_there => {
                // The time before the first connection is not an outage.
                if state.outages > 0 {
                    state.outages_us += now.saturating_duration_since(since).as_micros() as u64;
                }
                state.down = None;
                state.store.link(true, now);
                // Send a status at once, so that receivers see what they miss.
                self.said = now - STATUS;
            }
            None if !is_there => {
                state.down = Some(now);
                state.outages += 1;
                state.store.link(false, now);
            }
            _ => {}
        }
    }

    /// Updates the rate that the encoder may use.
    fn step(&mut self, state: &mut State, now: Instant) {
        let since = now.saturating_duration_since(self.stepped);
        if since < STEP {
            return;
        }
        self.stepped = now;
        let per_s = |bytes: u64| (bytes as f64 / since.as_secs_f64()) as u64;
        let (sent, made) = (
            state.sent_bytes - self.before.0,
            state.bytes - self.before.1,
        );
        self.before = (state.sent_bytes, state.bytes);
        let waiting = match state.down {
            // Without a link, its rate is unknown.
            Some(_) => 0,
            None => state.store.bytes_from(state.cursor),
        };
        state.governor.step(waiting, per_s(sent), per_s(made));
        self.bucket.set_rate(state.allowed(), now);
        let is_asked = !state.wishes.is_empty() || self.answering.is_some();
        let budget = match state.budget() {
            Some(budget) if is_asked => Some(budget - budget / AGAIN_PART),
            budget => budget,
        };
        self.shared.encoder.set(budget);
    }

    fn is_status_due(&mut self, state: &State, now: Instant) -> bool {
        let is_due = state.down.is_none() && now.saturating_duration_since(self.said) >= STATUS;
        if is_due {
            self.said = now;
        }
        is_due
    }

    fn next(&mut self, state: &mut State, now: Instant) -> Act {
        let is_hurried = |ending: &Ending| ending.is_hurried && now >= ending.by;
        if state.ends.as_ref().is_some_and(is_hurried) {
            return Act::End;
        }
        if state.down.is_some() {
            // Receivers request what is made now once there is a link.
            state.cursor = state.store.next();
            self.answering = None;
            state.wishes.clear();
            return match state.ends {
                Some(Ending { by, .. }) if now >= by => Act::End,
                _ => Act::Wait(LOOK),
            };
        }
        if state.cursor < state.store.next() {
            let is_late = state.cursor < state.store.first_in_memory()
                || state.store.bytes_from(state.cursor) > WAITING_MAX;
            if is_late {
                state.cursor = state.store.next() - 1;
            }
            let kept = state.store.get(self.shared.run, state.cursor);
            state.cursor += 1;
            if let Some(kept) = kept {
                state.sent_bytes += kept.frame.len() as u64;
                return Act::Send(kept.stamp, kept.frame);
            }
        }
        if self.answering.is_some() || !state.wishes.is_empty() {
            let wait = self.bucket.wait(now);
            if !wait.is_zero() {
                return Act::Wait(wait.min(SLEEP));
            }
            // A later request of the same receiver replaces the one that is being answered.
            let is_renewed = self.answering.as_ref().is_some_and(|answering| {
                let mut waiting = state.wishes.iter();
                waiting.any(|(_, wish)| wish.receiver == answering.receiver)
            });
            if is_renewed {
                self.answering = None;
            }
            if self.answering.is_some() {
                return Act::GoOn;
            }
            if let Some(asked) = state.wishes.pop_front() {
                return Act::Answer(Box::new(asked));
            }
        }
        match state.ends {
            // A receiver that misses something asks for it shortly after the last status.
            Some(Ending { asked, by, .. }) => {
                let latest = state.wished.map_or(asked, |wished| wished.max(asked));
                state.is_quiet = now.saturating_duration_since(latest) >= QUIET;
                match state.is_quiet || now >= by {
                    true => Act::End,
                    false => Act::Wait(LOOK),
                }
            }
            None => Act::Wait(SLEEP),
        }
    }

    fn say(&self, status: &Status) {
        if let Some(ends) = self.shared.ends.get() {
            // A status that gets lost is followed by another.
            let _ = ends.status.put(status.to_bytes()).wait();
        }
    }

    fn send(&mut self, stamp: Stamp, frame: &[u8]) {
        self.bucket.take(frame.len(), Instant::now());
        let stamp = Stamp {
            up_us: self.shared.clock.up_us(),
            ..stamp
        };
        if let Some(ends) = self.shared.ends.get() {
            // A frame that does not leave is requested again.
            let _ = ends.frames.put(frame).attachment(stamp.to_bytes()).wait();
        }
    }

    fn begin(&mut self, (query, wish): (Query, Wish)) {
        self.answering = Some(Answering {
            query,
            receiver: wish.receiver,
            run: wish.run,
            ranges: wish.ranges.into(),
            answer: Answer {
                run: wish.run,
                by: self.shared.run,
                gone: Vec::new(),
            },
            bytes: 0,
        });
    }

    /// Sends one more requested frame, or at the end the numbers of those that are gone.
    fn go_on(&mut self) {
        let Some(answering) = &mut self.answering else {
            return;
        };
        let kept = {
            let mut state = self.shared.state();
            let kept = answering.next(&mut state.store, self.shared.run);
            state.again += u64::from(kept.is_some());
            kept
        };
        let key = self.shared.name.key(Kind::Again);
        match kept {
            Some((stamp, frame)) => {
                self.bucket.take(frame.len(), Instant::now());
                let reply = answering.query.reply(key, &frame[..]);
                // A frame that does not leave is requested once more.
                let _ = reply.attachment(stamp.to_bytes()).wait();
            }
            None => {
                let reply = answering.query.reply(key, answering.answer.to_bytes());
                let _ = reply.wait();
                self.answering = None;
            }
        }
    }
}
