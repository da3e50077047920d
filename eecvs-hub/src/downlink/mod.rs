//! A receiver's side: takes frames of many sensors, requests those that have not arrived, and delivers each once.
//!
//! Zenoh's threads put what arrives into a queue that is bounded in bytes; one thread takes it out, tracks each
//! sensor's frame numbers, and delivers. Frames that find no room in the queue, or in memory while earlier frames
//! are awaited, are requested again later: nothing is lost while the sensor still holds it.

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
use crate::clock::{Clock, Estimate, RoundTrip};
use crate::key::{Kind, Name, name_of, names};
use crate::latency::Latencies;
use crate::link::{Client, Links, said};
use crate::message::{Answer, Message, Stamp, Status};
use crate::panicked;
pub(crate) use sensor::ANSWER_MAX;
use taking::Taking;

/// Options of a receiver.
#[derive(Debug, Clone)]
pub struct Options {
    /// Names of sensors, or patterns of names.
    pub names: Vec<String>,
    /// Whether to deliver frames as they arrive, late ones after newer ones; otherwise they are delivered in order.
    pub as_they_come: bool,
    /// Whether to request frames made before this receiver started, too.
    pub from_start: bool,
    /// How long a missing frame may fail to arrive, while its sensor is heard, before it is lost.
    pub patience: Duration,
    /// Limit on the bytes in the queue, and also on the bytes of frames held until earlier ones arrive.
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

/// A delivered frame.
#[derive(Debug, Clone, Copy)]
pub struct Delivered<'f> {
    /// Name of its sensor.
    pub name: &'f Name,
    /// Which of the sensors of this name sent it, from 0: more than one only if the name was given to several.
    pub lane: usize,
    /// The frame's run, number and time.
    pub stamp: Stamp,
    /// The frame, undamaged.
    pub frame: &'f [u8],
}

/// Callback that takes the delivered frames.
pub type Deliver = Box<dyn FnMut(Delivered<'_>) -> Result<()> + Send>;

/// Maximum number of sensors; messages of others are counted only.
pub const SENSORS_MAX: usize = 10_000;

/// What a receiver knows of a sensor; the fields are the JSON keys.
#[derive(Debug, Clone, Default, Serialize)]
pub struct SensorReport {
    /// Name of the sensor.
    pub name: String,
    /// Frames accepted for delivery.
    pub frames: u64,
    /// Bytes of these frames.
    pub bytes: u64,
    /// Events in these frames.
    pub events: u64,
    /// Frames that arrived because they were requested again.
    pub again: u64,
    /// Frames that have not arrived yet.
    pub missing: u64,
    /// Frames that were given up.
    pub lost: u64,
    /// Frames that arrived twice or too late.
    pub needless: u64,
    /// Frames that arrived damaged.
    pub damaged: u64,
    /// Messages that could not be read.
    pub malformed: u64,
    /// Number of times that the sensor was started.
    pub runs: u64,
    /// Frames from before this receiver heard of their run, as far as they are known; they were not requested, or
    /// were not held any more.
    pub before: u64,
    /// Largest number of sensors that sent under this name at once: 1, unless the name was given to several.
    pub at_once: u64,
    /// How far the sensor's clock is ahead of this computer's; `None` if the sensor did not answer for it.
    pub clock: Option<Estimate>,
    /// Median time from a window's end to the arrival of its frame, in milliseconds, for frames that were not
    /// requested, without the difference between the clocks; `None` if that is not known, or there are no frames.
    pub delay_p50_ms: Option<f64>,
    /// 99th percentile of the same.
    pub delay_p99_ms: Option<f64>,
    /// Maximum of the same.
    pub delay_max_ms: Option<f64>,
}

/// What a receiver knows of its sensors and its link.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Report {
    /// The sensors, by name.
    pub sensors: Vec<SensorReport>,
    /// Messages that found no room; frames among them are requested again.
    pub no_room: u64,
    /// Messages of sensors beyond [`SENSORS_MAX`], or without a valid name.
    pub refused: u64,
    /// Number of times that the link failed.
    pub outages: u64,
    /// Delays of all sensors' frames that were not requested again.
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
    /// Clock of the receiver, by whose start runs that began later are received from their first frame.
    clock: Clock,
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

/// Something that has arrived.
enum Came {
    Frame {
        name: Name,
        stamp: Stamp,
        frame: Vec<u8>,
        at_us: u64,
        is_again: bool,
    },
    Status {
        name: Name,
        status: Box<Status>,
        at_us: u64,
    },
    Gone(Name, Answer),
    /// What a sensor's clock showed between two times of the receiver's.
    Trip(Name, RoundTrip),
    /// No further answers to the request of this number will arrive.
    Answered(Name, u64),
    Malformed(Name),
}

impl Downlink {
    /// Starts to connect to a hub; `deliver` is called with the frames, on a thread of its own.
    ///
    /// # Errors
    /// Settings, keys or names are invalid.
    pub fn start(options: Options, links: &Links, deliver: Deliver) -> Result<Self> {
        ensure!(
            !options.names.is_empty(),
            "no sensors are named: give their names"
        );
        for pattern in &options.names {
            names(pattern)?;
        }
        let shared = Arc::new(Shared {
            options,
            clock: Clock::start(),
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
            .context("starting the thread that takes frames")?;
        Ok(Self {
            shared,
            client,
            thread: Some(thread),
        })
    }

    /// Returns what is known so far, at most a fifth of a second old.
    ///
    /// # Errors
    /// There will be no link; the error says why.
    pub fn report(&self) -> Result<Report> {
        self.client.check()?;
        Ok(lock(&self.shared.report).clone())
    }

    /// Returns whether a hub is connected.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.shared.ends.get().is_some() && self.client.is_connected()
    }

    /// Returns whether the thread that delivers has ended, because `deliver` failed.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Stops receiving: delivers everything that has arrived, and counts missing frames as lost.
    ///
    /// # Errors
    /// The error of `deliver`.
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
        ended.unwrap_or_else(panicked)
    }
}

impl Drop for Downlink {
    fn drop(&mut self) {
        // Callers that want the error call [`Downlink::finish`].
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

    /// Takes a message that a hub has sent.
    fn take(&self, kind: Kind, sample: &Sample) {
        let came = match name_of(sample.key_expr().as_str(), kind) {
            None => return lock(&self.inbox).refused += 1,
            Some(name) => came(name, kind, sample, self.clock.now_us()),
        };
        self.put(came);
    }

    fn put(&self, came: Came) {
        let mut inbox = lock(&self.inbox);
        // A message without room counts as not received: later numbers show that it is missing. `Answered` is
        // always accepted, since there is only one per request.
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

/// Classifies a sample that arrived at `at_us` of the receiver's clock.
fn came(name: Name, kind: Kind, sample: &Sample, at_us: u64) -> Came {
    let payload = sample.payload().to_bytes();
    let stamp = sample
        .attachment()
        .and_then(|attachment| Stamp::from_bytes(&attachment.to_bytes()));
    match (kind, stamp) {
        (Kind::Frames | Kind::Again, Some(stamp)) => Came::Frame {
            name,
            stamp,
            frame: payload.into_owned(),
            at_us,
            is_again: kind == Kind::Again,
        },
        (Kind::Again, None) => match Answer::from_bytes(&payload) {
            Some(answer) => Came::Gone(name, answer),
            None => Came::Malformed(name),
        },
        (Kind::Status, _) => match Status::from_bytes(&payload) {
            Some(status) => Came::Status {
                name,
                status: Box::new(status),
                at_us,
            },
            None => Came::Malformed(name),
        },
        _ => Came::Malformed(name),
    }
}

/// Approximate size of a message besides its payload.
const BYTES: usize = 256;

impl Came {
    fn bytes(&self) -> usize {
        match self {
            Self::Frame { frame, .. } => BYTES + frame.len(),
            Self::Status { status, .. } => BYTES + size_of_val(status.held.as_slice()),
            Self::Gone(_, answer) => BYTES + size_of_val(answer.gone.as_slice()),
            Self::Answered(..) | Self::Malformed(_) | Self::Trip(..) => BYTES,
        }
    }
}
