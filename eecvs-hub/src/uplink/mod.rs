//! A sensor's side: frames are numbered, published, and kept; who misses some gets them again.
//!
//! One thread has the link. What is made goes first, what is asked for again when nothing else waits. Where the link takes
//! less than is made, the encoder's budget is lowered; while there is no link, frames are kept, and receivers ask for
//! them once it is back.

mod answer;
mod link;

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use eecvs::encode::Budget as EncoderBudget;
use eecvs_nostd::{Frame, Header, Regime, Sensor};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::CongestionControl;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

use crate::budget::{Governor, least};
use crate::key::{Kind, Name};
use crate::link::{Client, Links, said};
use crate::message::{Budget, Events, HELD_MAX, Message, RANGES_MAX, Status, Wish, now_us};
use crate::store::Store;
use crate::store::disk::Disk;
use link::Link;

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
        let parsed = Frame::parse(frame);
        let header = parsed.map_err(|error| anyhow::anyhow!("{error}"))?.header;
        self.send_parsed(&header, frame, end_us)
    }

    /// Takes the next frame, whose header is known.
    ///
    /// # Errors
    /// Why there will be no link.
    pub fn send_parsed(&self, header: &Header, frame: &[u8], end_us: u64) -> Result<()> {
        if let Some(client) = self.shared.client.get() {
            client.check()?;
        }
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
