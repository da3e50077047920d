//! A receiver's side: takes frames of many sensors, asks for those that have not come, and delivers each once.
//!
//! Zenoh's threads put what comes into a queue that is bounded in bytes; one thread takes it out, keeps the numbers of
//! each sensor, and delivers. What found no room in the queue, or in memory while others before it are awaited, is asked
//! for again later: as long as the sensor holds it, nothing is lost.

mod ask;
mod sensor;
mod taking;

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use serde::Serialize;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

use crate::access::RECEIVERS;
use crate::key::{Kind, Name, name_of, names};
use crate::latency::Latencies;
use crate::link::{Client, Links, said};
use crate::message::{Answer, Message, Stamp, Status, now_us};
pub(crate) use sensor::ANSWER_MAX;
use taking::Taking;

/// What a receiver is told.
#[derive(Debug, Clone)]
pub struct Options {
    /// Sensors: names, or patterns of them.
    pub names: Vec<String>,
    /// Deliver frames as they come, and those that come late behind later ones; else in their order.
    pub as_they_come: bool,
    /// Also ask for what was made before this receiver was there.
    pub from_start: bool,
    /// What is missing, and does not come for so long while its sensor is heard, is lost.
    pub patience: Duration,
    /// Bytes that wait to be taken, and bytes that wait for others before them.
    pub waiting_bytes: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            names: vec!["**".to_owned()],
            as_they_come: false,
            from_start: false,
            patience: Duration::from_secs(60),
            waiting_bytes: 256 << 20,
        }
    }
}

/// A frame that is delivered.
#[derive(Debug, Clone, Copy)]
pub struct Delivered<'f> {
    /// Whose.
    pub name: &'f Name,
    /// Its run, number, and time.
    pub stamp: Stamp,
    /// The frame, undamaged.
    pub frame: &'f [u8],
}

/// Takes frames.
pub type Deliver = Box<dyn FnMut(Delivered<'_>) -> Result<()> + Send>;

/// Sensors at the most; what others send is counted.
pub const SENSORS_MAX: usize = 10_000;

/// What a receiver knows of a sensor; the fields are the JSON keys.
#[derive(Debug, Clone, Default, Serialize)]
pub struct SensorReport {
    /// Its name.
    pub name: String,
    /// Frames delivered.
    pub frames: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Events in them.
    pub events: u64,
    /// Frames that came when they were asked for again.
    pub again: u64,
    /// Frames that have not come yet.
    pub missing: u64,
    /// Frames that never will.
    pub lost: u64,
    /// Frames that came twice, or too late.
    pub needless: u64,
    /// Frames that were damaged.
    pub damaged: u64,
    /// Messages that were none.
    pub malformed: u64,
    /// Times that the sensor was started.
    pub runs: u64,
    /// From a window's end to the arrival of its frame, milliseconds; of frames that were not asked for.
    pub delay_p50_ms: f64,
    /// 99th percentile.
    pub delay_p99_ms: f64,
    /// The longest.
    pub delay_max_ms: f64,
}

/// What a receiver knows.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Report {
    /// By name.
    pub sensors: Vec<SensorReport>,
    /// Frames, and what was said beside them, that found no room; frames are asked for again.
    pub no_room: u64,
    /// Messages of sensors beyond [`SENSORS_MAX`], or of no name.
    pub refused: u64,
    /// Times that there was no link.
    pub outages: u64,
    /// Delays of all sensors' frames that were not asked for again.
    #[serde(skip)]
    pub delays: Latencies,
}

/// A receiver's link.
pub struct Downlink {
    shared: Arc<Shared>,
    client: Client,
    thread: Option<JoinHandle<Result<()>>>,
}

struct Shared {
    options: Options,
    /// When it was started: runs since then are received from their beginning.
    started_us: u64,
    inbox: Mutex<Inbox>,
    changed: Condvar,
    ends: OnceLock<Ends>,
    report: Mutex<Report>,
    stop: AtomicBool,
}

struct Ends {
    _subscribers: Vec<Subscriber<()>>,
    _alive: LivelinessToken,
}

#[derive(Default)]
struct Inbox {
    waiting: VecDeque<Came>,
    bytes: usize,
    no_room: u64,
    refused: u64,
}

/// Something that came.
enum Came {
    Frame {
        name: Name,
        stamp: Stamp,
        frame: Vec<u8>,
        at_us: u64,
        is_again: bool,
    },
    Status(Name, Box<Status>),
    Gone(Name, Answer),
    /// No further answers to a wish come.
    Answered(Name, u64),
    Malformed(Name),
}

impl Downlink {
    /// Begins to connect to a hub; `deliver` gets the frames on a thread of its own.
    ///
    /// # Errors
    /// Settings, keys, or names that are none.
    pub fn start(options: Options, links: &Links, deliver: Deliver) -> Result<Self> {
        ensure!(!options.names.is_empty(), "no sensors: give names");
        for pattern in &options.names {
            names(pattern)?;
        }
        let shared = Arc::new(Shared {
            options,
            started_us: now_us(),
            inbox: Mutex::new(Inbox::default()),
            changed: Condvar::new(),
            ends: OnceLock::new(),
            report: Mutex::new(Report::default()),
            stop: AtomicBool::new(false),
        });
        let own = Arc::clone(&shared);
        let client = Client::start(links, move |session| own.declare(session))?;
        let taking = Taking {
            shared: Arc::clone(&shared),
            client: client.clone(),
            sensors: BTreeMap::new(),
            deliver,
            held_bytes: 0,
            wishes: 0,
            is_down: true,
            outages: 0,
        };
        let thread = thread::Builder::new()
            .name("downlink".to_owned())
            .spawn(move || taking.run())
            .context("a thread that takes frames")?;
        Ok(Self {
            shared,
            client,
            thread: Some(thread),
        })
    }

    /// What is known so far; a fifth of a second old at the most.
    ///
    /// # Errors
    /// Why there will be no link.
    pub fn report(&self) -> Result<Report> {
        self.client.check()?;
        Ok(lock(&self.shared.report).clone())
    }

    /// Whether a hub is connected.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.shared.ends.get().is_some() && self.client.is_connected()
    }

    /// Whether the thread that delivers has ended: what it was given failed.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Ends: what waits is delivered as far as it goes; what is missing is lost.
    ///
    /// # Errors
    /// What `deliver` has said.
    pub fn finish(mut self) -> Result<Report> {
        self.end()?;
        Ok(lock(&self.shared.report).clone())
    }

    fn end(&mut self) -> Result<()> {
        let Some(thread) = self.thread.take() else {
            return Ok(());
        };
        self.shared.stop.store(true, Ordering::Relaxed);
        self.shared.changed.notify_one();
        let ended = thread.join();
        self.client.close();
        ended.unwrap_or_else(|_| anyhow::bail!("a thread panicked: please report this"))
    }
}

impl Drop for Downlink {
    fn drop(&mut self) {
        // Whoever wants to know calls finish.
        let _ = self.end();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    fn declare(self: &Arc<Self>, session: &Session) -> Result<()> {
        let mut subscribers = Vec::new();
        for pattern in &self.options.names {
            for kind in [Kind::Frames, Kind::Status] {
                let own = Arc::clone(self);
                let key = kind.of_all(pattern);
                let declared = session
                    .declare_subscriber(key.clone())
                    .callback(move |sample| own.take(kind, &sample))
                    .wait();
                subscribers.push(declared.map_err(said(key))?);
            }
        }
        let token = format!("{RECEIVERS}/{}", session.zid());
        let alive = session.liveliness().declare_token(token.clone()).wait();
        let _ = self.ends.set(Ends {
            _subscribers: subscribers,
            _alive: alive.map_err(said(token))?,
        });
        Ok(())
    }

    /// Takes what a hub sends.
    fn take(&self, kind: Kind, sample: &Sample) {
        let came = match name_of(sample.key_expr().as_str(), kind) {
            None => return lock(&self.inbox).refused += 1,
            Some(name) => came(name, kind, sample),
        };
        self.put(came);
    }

    fn put(&self, came: Came) {
        let mut inbox = lock(&self.inbox);
        // What finds no room has not come: later numbers tell that it is missing. Of ends there is one for each wish.
        let is_end = matches!(came, Came::Answered(..));
        if !is_end && inbox.bytes + came.bytes() > self.options.waiting_bytes {
            inbox.no_room += 1;
            return;
        }
        inbox.bytes += came.bytes();
        inbox.waiting.push_back(came);
        let is_first = inbox.waiting.len() == 1;
        drop(inbox);
        if is_first {
            self.changed.notify_one();
        }
    }
}

/// What a sample is.
fn came(name: Name, kind: Kind, sample: &Sample) -> Came {
    let payload = sample.payload().to_bytes();
    let stamp = sample
        .attachment()
        .and_then(|attachment| Stamp::from_bytes(&attachment.to_bytes()));
    match (kind, stamp) {
        (Kind::Frames | Kind::Again, Some(stamp)) => Came::Frame {
            name,
            stamp,
            frame: payload.into_owned(),
            at_us: now_us(),
            is_again: kind == Kind::Again,
        },
        (Kind::Again, None) => match Answer::from_bytes(&payload) {
            Some(answer) => Came::Gone(name, answer),
            None => Came::Malformed(name),
        },
        (Kind::Status, _) => match Status::from_bytes(&payload) {
            Some(status) => Came::Status(name, Box::new(status)),
            None => Came::Malformed(name),
        },
        _ => Came::Malformed(name),
    }
}

/// What a message takes beside its own bytes, about.
const BYTES: usize = 256;

impl Came {
    fn bytes(&self) -> usize {
        match self {
            Self::Frame { frame, .. } => BYTES + frame.len(),
            Self::Status(_, status) => BYTES + size_of_val(status.held.as_slice()),
            Self::Gone(_, answer) => BYTES + size_of_val(answer.gone.as_slice()),
            Self::Answered(..) | Self::Malformed(_) => BYTES,
        }
    }
}
