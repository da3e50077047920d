//! A sensor's side: frames are numbered, published, and kept; who misses some gets them again.
//!
//! One thread has the link. What is made goes first, what is asked for again when nothing else waits. Where the link takes
//! less than is made, the encoder's budget is lowered; while there is no link, frames are kept, and receivers ask for
//! them once it is back.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use eecvs_nostd::{Frame, Regime, Sensor};
use host_harness::encode::Budget as EncoderBudget;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

use crate::budget::{Bucket, Governor, least};
use crate::downlink::ANSWER_MAX;
use crate::key::{Kind, Name};
use crate::link::{Client, Links, said};
use crate::message::{
    Answer, Budget, Events, HELD_MAX, Message, RANGES_MAX, Range, Stamp, Status, Wish, now_us,
};
use crate::store::Store;
use crate::store::disk::Disk;

/// What a sensor is told.
#[derive(Debug, Clone)]
pub struct Options {
    /// What it is called.
    pub name: Name,
    /// Its size.
    pub sensor: Sensor,
    /// Bytes of frames in memory.
    pub memory_bytes: usize,
    /// A folder for frames, and how many bytes of them.
    pub disk: Option<(PathBuf, u64)>,
    /// Bytes of frames a second, at the most.
    pub bytes_per_second: Option<u32>,
}

/// Wishes that wait; whoever sends more has to send them again.
const WISHES_MAX: usize = 64;

/// Bytes sent in answer to one wish, about.
const ANSWER_BYTES: usize = 512 << 10;

/// Bytes that wait for the link at the most: beyond, what is newest goes first.
const WAITING_MAX: u64 = 8 << 20;

/// How often the sensor says how it fares, and looks at its link.
const STATUS: Duration = Duration::from_millis(500);
const LOOK: Duration = Duration::from_millis(50);
const STEP: Duration = Duration::from_millis(1000 / Governor::STEPS_HZ as u64);
/// Longest sleep of the thread.
const SLEEP: Duration = Duration::from_millis(200);

/// At the end, so long after the last wish, nobody misses anything: who does, asks again before.
const QUIET: Duration = ANSWER_MAX.saturating_mul(2);

/// While something is asked for again, this part of the budget is left to it.
const AGAIN_PART: u32 = 8;

/// A sensor's link.
pub struct Uplink {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    name: Name,
    run: u64,
    sensor: Sensor,
    client: OnceLock<Client>,
    ends: OnceLock<Ends>,
    state: Mutex<State>,
    changed: Condvar,
    /// What the encoder may make a second.
    encoder: Arc<EncoderBudget>,
}

/// What is declared with a hub.
struct Ends {
    frames: Publisher<'static>,
    status: Publisher<'static>,
    _again: Queryable<()>,
    _budget: Subscriber<()>,
    _alive: LivelinessToken,
}

struct State {
    store: Store,
    /// The next frame to be sent.
    cursor: u64,
    /// One of each receiver.
    wishes: VecDeque<(Query, Wish)>,
    /// Latest time that something was asked for.
    wished: Option<Instant>,
    own_budget: Option<u32>,
    hub_budget: Option<u32>,
    governor: Governor,
    events: Events,
    windows: [u64; 3],
    bytes: u64,
    sent_bytes: u64,
    again: u64,
    /// Since when there is no link.
    down: Option<Instant>,
    outages: u64,
    outages_us: u64,
    ends: Option<Ending>,
    /// At the end: nobody has asked for anything for a while.
    is_quiet: bool,
}

/// Nothing follows.
#[derive(Debug, Clone, Copy)]
struct Ending {
    /// Since when.
    asked: Instant,
    /// Until when something may still be asked for.
    by: Instant,
}

/// How a run went.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// What the sensor said last.
    pub status: Status,
    /// Frames that had not been sent when it ended.
    pub unsent: u64,
}

impl Uplink {
    /// Begins to connect to a hub; frames are taken at once.
    ///
    /// # Errors
    /// Settings, keys, or a folder that cannot be used.
    pub fn start(options: &Options, links: &Links) -> Result<Self> {
        let disk = match &options.disk {
            Some((folder, bytes)) => Some(Disk::open(folder, *bytes)?),
            None => None,
        };
        let now = Instant::now();
        let run = now_us();
        let mut store = Store::new(run, options.memory_bytes, disk);
        store.link(false, now);
        let shared = Arc::new(Shared {
            name: options.name.clone(),
            run,
            sensor: options.sensor,
            client: OnceLock::new(),
            ends: OnceLock::new(),
            state: Mutex::new(State {
                store,
                cursor: 0,
                wishes: VecDeque::new(),
                wished: None,
                own_budget: options.bytes_per_second,
                hub_budget: None,
                governor: Governor::default(),
                events: Events::default(),
                windows: [0; 3],
                bytes: 0,
                sent_bytes: 0,
                again: 0,
                down: Some(now),
                outages: 0,
                outages_us: 0,
                ends: None,
                is_quiet: false,
            }),
            changed: Condvar::new(),
            encoder: Arc::new(EncoderBudget::new(options.bytes_per_second)),
        });
        let own = Arc::clone(&shared);
        let client = Client::start(links, move |session| own.declare(session))?;
        let _ = shared.client.set(client);
        let own = Arc::clone(&shared);
        let thread = thread::Builder::new()
            .name("uplink".to_owned())
            .spawn(move || Link::new(&own).run())
            .context("a thread for the link")?;
        Ok(Self {
            shared,
            thread: Some(thread),
        })
    }

    /// What the encoder may make a second, as it changes.
    #[must_use]
    pub fn budget(&self) -> Arc<EncoderBudget> {
        Arc::clone(&self.shared.encoder)
    }

    /// Takes the next frame, whose window ended at `end_us`.
    ///
    /// # Errors
    /// Bytes that are no frame; why there will be no link.
    pub fn send(&self, frame: &[u8], end_us: u64) -> Result<()> {
        if let Some(client) = self.shared.client.get() {
            client.check()?;
        }
        let parsed = Frame::parse(frame);
        let header = parsed.map_err(|error| anyhow::anyhow!("{error}"))?.header;
        let mut state = self.shared.state();
        let events = &mut state.events;
        events.encoded += u64::from(header.events);
        if !header.mode.is_lossless() {
            events.approximate += u64::from(header.events);
        }
        events.late += u64::from(header.late);
        events.filtered += u64::from(header.filtered);
        events.dropped += u64::from(header.dropped);
        events.thinned += u64::from(header.thinned);
        if header.part == 0 && header.window_events > 0 {
            let regime = match header.regime {
                Regime::Sparse => 0,
                Regime::Moderate => 1,
                Regime::Dense => 2,
            };
            state.windows[regime] += 1;
        }
        state.bytes += frame.len() as u64;
        state.store.push(frame.into(), end_us, Instant::now());
        drop(state);
        self.shared.changed.notify_one();
        Ok(())
    }

    /// What the sensor says of itself now.
    #[must_use]
    pub fn status(&self) -> Status {
        self.shared.status(&self.shared.state())
    }

    /// Whether a hub is connected.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.shared.state().down.is_none()
    }

    /// Nothing follows: what waits is sent, and as long as somebody asks for frames again, these; so long at the most.
    /// What an outage may have lost goes to disk.
    #[must_use]
    pub fn finish(mut self, most: Duration) -> Summary {
        self.end(most);
        let state = self.shared.state();
        Summary {
            status: self.shared.status(&state),
            unsent: state.store.next() - state.cursor,
        }
    }

    fn end(&mut self, most: Duration) {
        let Some(thread) = self.thread.take() else {
            return;
        };
        let asked = Instant::now();
        let by = asked + most;
        self.shared.state().ends = Some(Ending { asked, by });
        self.shared.changed.notify_one();
        let _ = thread.join();
        let mut state = self.shared.state();
        let is_quiet = state.is_quiet;
        state.store.end(is_quiet);
        drop(state);
        if let Some(client) = self.shared.client.get() {
            client.close();
        }
    }
}

impl Drop for Uplink {
    fn drop(&mut self) {
        self.end(Duration::ZERO);
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn declare(self: &Arc<Self>, session: &Session) -> Result<()> {
        let key = |kind| self.name.key(kind);
        let publisher = |kind| {
            let declared = session
                .declare_publisher(key(kind))
                .congestion_control(CongestionControl::Block)
                .wait();
            declared.map_err(said(key(kind)))
        };
        let own = Arc::clone(self);
        let again = session
            .declare_queryable(key(Kind::Again))
            .callback(move |query| own.wish(query))
            .wait();
        let own = Arc::clone(self);
        let budget = session
            .declare_subscriber(key(Kind::Budget))
            .callback(move |sample| {
                if let Some(budget) = Budget::from_bytes(&sample.payload().to_bytes()) {
                    own.state().hub_budget = budget.bytes_per_second;
                }
            })
            .wait();
        let alive = session.liveliness().declare_token(key(Kind::Alive)).wait();
        let _ = self.ends.set(Ends {
            frames: publisher(Kind::Frames)?,
            status: publisher(Kind::Status)?,
            _again: again.map_err(said(key(Kind::Again)))?,
            _budget: budget.map_err(said(key(Kind::Budget)))?,
            _alive: alive.map_err(said(key(Kind::Alive)))?,
        });
        self.changed.notify_one();
        Ok(())
    }

    fn wish(&self, query: Query) {
        let wish = query
            .payload()
            .and_then(|payload| Wish::from_bytes(&payload.to_bytes()));
        let Some(mut wish) = wish else { return };
        wish.ranges.truncate(RANGES_MAX);
        let mut state = self.state();
        state.wished = Some(Instant::now());
        let mut waiting = state.wishes.iter();
        match waiting.position(|(_, earlier)| earlier.receiver == wish.receiver) {
            // The earlier query ends with that, and its receiver knows.
            Some(at) => state.wishes[at] = (query, wish),
            None if state.wishes.len() < WISHES_MAX => state.wishes.push_back((query, wish)),
            None => {}
        }
        drop(state);
        self.changed.notify_one();
    }

    fn status(&self, state: &State) -> Status {
        let down_us = match state.down {
            // The time before the first connection is no outage.
            Some(since) if state.outages > 0 => since.elapsed().as_micros() as u64,
            _ => 0,
        };
        Status {
            run: self.run,
            next: state.store.next(),
            width: self.sensor.width,
            height: self.sensor.height,
            now_us: now_us(),
            events: state.events,
            bytes: state.bytes,
            windows: state.windows,
            budget: state.budget(),
            is_congested: state.governor.limit().is_some(),
            outages: state.outages,
            outages_us: state.outages_us + down_us,
            again: state.again,
            stored: state.store.stored(),
            held: state.store.held(HELD_MAX),
        }
    }
}

impl State {
    fn budget(&self) -> Option<u32> {
        least(self.allowed(), self.governor.limit())
    }

    /// By the command line and the hub.
    fn allowed(&self) -> Option<u32> {
        least(self.own_budget, self.hub_budget)
    }
}

/// The thread of the link.
struct Link<'s> {
    shared: &'s Shared,
    bucket: Bucket,
    answering: Option<Answering>,
    looked: Instant,
    stepped: Instant,
    said: Instant,
    /// Bytes sent and made up to a step.
    before: (u64, u64),
}

/// A wish that is being met.
struct Answering {
    query: Query,
    receiver: u64,
    run: u64,
    ranges: VecDeque<Range>,
    answer: Answer,
    bytes: usize,
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
    fn new(shared: &'s Shared) -> Self {
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

    fn run(&mut self) {
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

    /// Looks whether there is a link.
    fn look(&mut self, state: &mut State, now: Instant) {
        if now.saturating_duration_since(self.looked) < LOOK {
            return;
        }
        self.looked = now;
        let is_there = self.shared.ends.get().is_some()
            && self.shared.client.get().is_some_and(Client::is_connected);
        match state.down {
            Some(since) if is_there => {
                // The time before the first connection is no outage.
                if state.outages > 0 {
                    state.outages_us += now.saturating_duration_since(since).as_micros() as u64;
                }
                state.down = None;
                state.store.link(true, now);
                // Receivers see at once what they miss.
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

    /// Finds what the encoder may make.
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
            // Without a link nothing is known of what it takes.
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
        if state.down.is_some() {
            // What is made now is asked for later.
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
            // A later wish of the same receiver takes the place of the one that is being met.
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
            // Who misses something asks within a moment of what was said last.
            Some(Ending { asked, by }) => {
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
            // One that gets lost is followed by another.
            let _ = ends.status.put(status.to_bytes()).wait();
        }
    }

    fn send(&mut self, stamp: Stamp, frame: &[u8]) {
        self.bucket.take(frame.len(), Instant::now());
        if let Some(ends) = self.shared.ends.get() {
            // What does not leave is asked for again.
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
                gone: Vec::new(),
            },
            bytes: 0,
        });
    }

    /// Sends one more frame that is asked for, or says what is gone.
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
                // What does not leave is asked for once more.
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

impl Answering {
    /// The next frame that is asked for and held; what is not is noted.
    fn next(&mut self, store: &mut Store, own_run: u64) -> Option<(Stamp, Arc<[u8]>)> {
        while self.bytes < ANSWER_BYTES {
            let range = self.ranges.front_mut()?;
            // What was not made yet is not gone.
            let to = match self.run == own_run {
                true => range.to.min(store.next()),
                false => range.to,
            };
            if range.from >= to {
                self.ranges.pop_front();
                continue;
            }
            let held = store.next_held(self.run, range.from).unwrap_or(to).min(to);
            if held > range.from {
                let from = range.from;
                range.from = held;
                self.answer.gone.push(Range { from, to: held });
                continue;
            }
            range.from += 1;
            match store.get(self.run, held) {
                Some(kept) => {
                    self.bytes += kept.frame.len();
                    return Some((kept.stamp, kept.frame));
                }
                // It is there, and cannot be read.
                None => self.answer.gone.push(Range {
                    from: held,
                    to: held + 1,
                }),
            }
        }
        None
    }
}
