//! A sensor's side: frames are numbered, published, and kept; receivers that miss some can have them again.
//!
//! One thread owns the link. New frames go first, and requested ones when nothing else waits. If the link takes
//! less than is made, the encoder's budget is lowered. While there is no link, frames are kept, and receivers
//! request them once it is back.

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
use crate::clock::Clock;
use crate::key::{Kind, Name};
use crate::link::{Client, Links, said};
use crate::message::{Budget, Events, HELD_MAX, Held, Message, RANGES_MAX, Status, Time, Wish};
use crate::store::Store;
use crate::store::claim::Claim;
use crate::store::disk::{Disk, Settings};
use link::Link;

/// Options of a sensor.
#[derive(Debug, Clone)]
pub struct Options {
    /// Name of the sensor.
    pub name: Name,
    /// Sensor size in pixels.
    pub sensor: Sensor,
    /// Maximum bytes of frames in memory.
    pub memory_bytes: usize,
    /// Folder for frames, and how they are kept there.
    pub disk: Option<(PathBuf, Settings)>,
    /// Maximum bytes of frames per second.
    pub bytes_per_second: Option<u32>,
    /// The clock of the run, which began when this was started; the ends of windows are told by it.
    pub clock: Clock,
}

/// Maximum number of waiting requests; further ones are ignored, and have to be sent again.
const WISHES_MAX: usize = 64;

/// A sensor's link.
pub struct Uplink {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    /// Keeps other sensors out of the folder for frames.
    _claim: Option<Claim>,
}

struct Shared {
    name: Name,
    run: u64,
    clock: Clock,
    sensor: Sensor,
    client: OnceLock<Client>,
    ends: OnceLock<Ends>,
    state: Mutex<State>,
    changed: Condvar,
    /// The encoder's budget per second.
    encoder: Arc<EncoderBudget>,
}

/// The sensor's declarations in a session with a hub.
struct Ends {
    frames: Publisher<'static>,
    status: Publisher<'static>,
    _again: Queryable<()>,
    _clock: Queryable<()>,
    _budget: Subscriber<()>,
    _alive: LivelinessToken,
}

struct State {
    store: Store,
    /// Number of the next frame to be sent.
    cursor: u64,
    /// Waiting requests, at most one per receiver.
    wishes: VecDeque<(Query, Wish)>,
    /// Time of the latest request.
    wished: Option<Instant>,
    own_budget: Option<u32>,
    hub_budget: Option<u32>,
    governor: Governor,
    events: Events,
    windows: [u64; 3],
    bytes: u64,
    sent_bytes: u64,
    again: u64,
    /// Since when there is no link; `None` while there is one.
    down: Option<Instant>,
    outages: u64,
    outages_us: u64,
    ends: Option<Ending>,
    /// At the end: whether nobody has requested anything for a while.
    is_quiet: bool,
}

/// The end of the stream: no further frame follows.
#[derive(Debug, Clone, Copy)]
struct Ending {
    /// When the end was requested.
    asked: Instant,
    /// Until when frames may still be requested.
    by: Instant,
    /// Whether frames that wait then are not sent either.
    is_hurried: bool,
}

/// Outcome of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// The sensor's last status.
    pub status: Status,
    /// Frames that had not been sent at the end.
    pub unsent: u64,
}

impl Uplink {
    /// Starts to connect to a hub; frames are accepted at once.
    ///
    /// # Errors
    /// Settings or keys are invalid, or the folder for frames cannot be used, for instance because it is another
    /// sensor's.
    pub fn start(options: &Options, links: &Links) -> Result<Self> {
        let (claim, disk) = match &options.disk {
            Some((folder, settings)) => {
                let claim = Claim::new(folder, &options.name)?;
                (Some(claim), Some(Disk::open(folder, *settings)?))
            }
            None => (None, None),
        };
        let now = Instant::now();
        // A clock that was set back since an earlier run does not make this run an earlier one.
        let newest = disk.as_ref().and_then(Disk::newest_run);
        let clock = options.clock;
        let run = match newest {
            Some(newest) => clock.origin_us().max(newest.saturating_add(1)),
            None => clock.origin_us(),
        };
        let mut store = Store::new(run, options.memory_bytes, disk);
        store.link(false, now);
        let shared = Arc::new(Shared {
            name: options.name.clone(),
            run,
            clock,
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
            .context("starting the link's thread")?;
        Ok(Self {
            shared,
            thread: Some(thread),
            _claim: claim,
        })
    }

    /// Returns the clock of the run.
    #[must_use]
    pub fn clock(&self) -> Clock {
        self.shared.clock
    }

    /// Returns the encoder's budget per second, which changes over time.
    #[must_use]
    pub fn budget(&self) -> Arc<EncoderBudget> {
        Arc::clone(&self.shared.encoder)
    }

    /// Accepts the next frame, whose window ended at `end_us` of the run's clock, in microseconds since 1970.
    ///
    /// # Errors
    /// The bytes are not a frame, or there will be no link.
    pub fn send(&self, frame: &[u8], end_us: u64) -> Result<()> {
        let parsed = Frame::parse(frame);
        let header = parsed.map_err(|error| anyhow::anyhow!("{error}"))?.header;
        self.send_parsed(&header, frame, end_us)
    }

    /// Accepts the next frame, whose header is already parsed; `end_us` as in [`Uplink::send`].
    ///
    /// # Errors
    /// There will be no link; the error says why.
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

    /// Returns the sensor's present status.
    #[must_use]
    pub fn status(&self) -> Status {
        self.shared.status(&self.shared.state())
    }

    /// Returns whether a hub is connected.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.shared.state().down.is_none()
    }

    /// Ends the stream. For at most the time `most`, waiting frames are sent, and requests are answered as long as
    /// they arrive. Afterwards, frames that an outage may have lost go to disk.
    #[must_use]
    pub fn finish(self, most: Duration) -> Summary {
        self.finish_while(most, &|| true)
    }

    /// Does the same, but once `goes_on` returns false only what can be done at once.
    #[must_use]
    pub fn finish_while(mut self, most: Duration, goes_on: &dyn Fn() -> bool) -> Summary {
        self.end(most, goes_on);
        let state = self.shared.state();
        Summary {
            status: self.shared.status(&state),
            unsent: state.store.next() - state.cursor,
        }
    }

    fn end(&mut self, most: Duration, goes_on: &dyn Fn() -> bool) {
        let Some(thread) = self.thread.take() else {
            return;
        };
        let asked = Instant::now();
        let mut ending = Ending {
            asked,
            by: asked + most,
            is_hurried: false,
        };
        self.shared.state().ends = Some(ending);
        self.shared.changed.notify_one();
        while goes_on() && !thread.is_finished() {
            thread::sleep(LOOK);
        }
        if !thread.is_finished() {
            ending.by = ending.by.min(Instant::now() + HURRY);
            ending.is_hurried = true;
            self.shared.state().ends = Some(ending);
            self.shared.changed.notify_one();
            // A message that waits for a link which takes nothing is not waited for.
            let last = Instant::now() + 2 * HURRY;
            while !thread.is_finished() && Instant::now() < last {
                thread::sleep(LOOK);
            }
        }
        let mut state = self.shared.state();
        let is_quiet = state.is_quiet;
        state.store.end(is_quiet);
        drop(state);
        if let Some(client) = self.shared.client.get() {
            client.close();
        }
    }
}

/// Interval at which the end is looked for.
const LOOK: Duration = Duration::from_millis(5);

/// Time for what can be done at once, where somebody waits for the end.
const HURRY: Duration = Duration::from_millis(200);

impl Drop for Uplink {
    fn drop(&mut self) {
        self.end(Duration::ZERO, &|| true);
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
        let clock = session
            .declare_queryable(key(Kind::Clock))
            .callback(move |query| {
                let time = Time {
                    run: own.run,
                    now_us: own.clock.now_us(),
                };
                // Whoever gets no answer asks again.
                let _ = query
                    .reply(own.name.key(Kind::Clock), time.to_bytes())
                    .wait();
            })
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
            _clock: clock.map_err(said(key(Kind::Clock)))?,
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
            // This ends the earlier query, which its receiver expects.
            Some(at) => state.wishes[at] = (query, wish),
            None if state.wishes.len() < WISHES_MAX => state.wishes.push_back((query, wish)),
            None => {}
        }
        drop(state);
        self.changed.notify_one();
    }

    fn status(&self, state: &State) -> Status {
        let down_us = match state.down {
            // The time before the first connection is not an outage.
            Some(since) if state.outages > 0 => since.elapsed().as_micros() as u64,
            _ => 0,
        };
        Status {
            run: self.run,
            next: state.store.next(),
            width: self.sensor.width,
            height: self.sensor.height,
            up_us: self.clock.up_us(),
            events: state.events,
            bytes: state.bytes,
            windows: state.windows,
            budget: state.budget(),
            is_congested: state.governor.limit().is_some(),
            outages: state.outages,
            outages_us: state.outages_us + down_us,
            again: state.again,
            stored: state.store.stored(),
            held: self.held(&state.store),
        }
    }

    /// Returns which frames of earlier runs the store holds, and how long ago these runs began.
    fn held(&self, store: &Store) -> Vec<Held> {
        let held = store.held(HELD_MAX).into_iter();
        held.map(|(run, range)| Held {
            run,
            range,
            ago_us: self
                .clock
                .now_us()
                .checked_sub(run)
                .filter(|_| run < self.clock.origin_us()),
        })
        .collect()
    }
}

impl State {
    fn budget(&self) -> Option<u32> {
        least(self.allowed(), self.governor.limit())
    }

    /// The limit by the command line and the hub.
    fn allowed(&self) -> Option<u32> {
        least(self.own_budget, self.hub_budget)
    }
}
