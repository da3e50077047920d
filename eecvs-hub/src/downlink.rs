//! A receiver's side: takes frames of many sensors, asks for those that have not come, and delivers each once.
//!
//! Zenoh's threads put what comes into a queue that is bounded in bytes; one thread takes it out, keeps the numbers of
//! each sensor, and delivers. What found no room in the queue, or in memory while others before it are awaited, is asked
//! for again later: as long as the sensor holds it, nothing is lost.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};
use eecvs_nostd::Frame;
use serde::Serialize;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::ConsolidationMode;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

use crate::access::RECEIVERS;
use crate::key::{Kind, Name, name_of, names};
use crate::latency::Latencies;
use crate::link::{Client, Links, said};
use crate::message::{Answer, Message, RANGES_MAX, Range, Stamp, Status, Wish, now_us};
use crate::order::Numbers;

/// What a receiver is told.
#[derive(Debug, Clone)]
pub struct Options {
    /// Sensors: names, or patterns of them.
    pub names: Vec<String>,
    /// Deliver frames as they come, and those that come late behind later ones; else in their order.
    pub as_they_come: bool,
    /// Also ask for what was made before this receiver was there.
    pub from_start: bool,
    /// What is missing, and does not come for so long, is lost.
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

/// Runs of a sensor of which something may be missing.
const RUNS_MAX: usize = 8;

/// How often what is missing is asked for.
const WISH: Duration = Duration::from_millis(50);

/// How often it is asked who has answered nothing.
const WISH_AGAIN: Duration = Duration::from_millis(250);

/// Answers that do not come for so long have got lost, the next ones after twice that, up to the longest wait.
const ANSWER: Duration = Duration::from_millis(500);
pub(crate) const ANSWER_MAX: Duration = Duration::from_secs(2);

/// How long answers are listened to.
const ANSWERS: Duration = Duration::from_secs(30);

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
    /// Frames that found no room and were asked for again.
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
    /// A frame of this number exists.
    NoRoom {
        name: Name,
        stamp: Stamp,
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
        let came = match came {
            Came::Frame {
                name, stamp, frame, ..
            } if inbox.bytes + frame.len() > self.options.waiting_bytes => {
                inbox.no_room += 1;
                Came::NoRoom { name, stamp }
            }
            came => came,
        };
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

impl Came {
    fn bytes(&self) -> usize {
        match self {
            Self::Frame { frame, .. } => frame.len(),
            _ => 64,
        }
    }
}

/// The thread that takes what came.
struct Taking {
    shared: Arc<Shared>,
    client: Client,
    sensors: BTreeMap<Name, Sensor>,
    deliver: Deliver,
    /// Bytes that wait for others before them.
    held_bytes: usize,
    wishes: u64,
    is_down: bool,
    outages: u64,
}

#[derive(Default)]
struct Sensor {
    report: SensorReport,
    runs: BTreeMap<u64, Run>,
    delays: Latencies,
    asking: Asking,
}

/// What is asked of a sensor.
#[derive(Default)]
struct Asking {
    /// The wish that is under way.
    wish: Option<u64>,
    /// When it was asked last, and when something came of that.
    asked: Option<Instant>,
    heard: Option<Instant>,
    /// Wishes in a row of which nothing came.
    in_vain: u32,
}

impl Asking {
    /// Something that was asked for has come.
    fn hear(&mut self) {
        self.heard = Some(Instant::now());
        self.in_vain = 0;
    }

    /// Whether to ask now.
    fn is_due(&self) -> bool {
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

    fn ask(&mut self, wish: u64) {
        if self.asked.is_some() && self.heard <= self.asked {
            self.in_vain += 1;
        }
        self.wish = Some(wish);
        self.asked = Some(Instant::now());
    }
}

struct Run {
    numbers: Numbers,
    /// In order: frames that wait for others.
    held: BTreeMap<u64, (Stamp, Vec<u8>)>,
    /// When something that was missing has come last, or has begun to be missing.
    progress: Instant,
}

impl Taking {
    fn run(mut self) -> Result<()> {
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
                wished = now;
                self.look();
                self.wish();
                self.give_up(now)?;
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

    /// What has come, a batch of it; nothing for a moment, where nothing has.
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
        | Came::NoRoom { name, .. }
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
            Came::NoRoom { stamp, .. } => {
                if let Some(run) = sensor.run(stamp.run, stamp.number, joined) {
                    run.until(stamp.number.saturating_add(1));
                }
            }
            Came::Status(_, status) => {
                if let Some(run) = sensor.run(status.run, status.next, joined) {
                    run.until(status.next);
                }
                for (number, range) in status.held {
                    // Of what was there before this receiver, only where it is asked for.
                    let is_known = sensor.runs.contains_key(&number);
                    if number < status.run && (is_known || joined.is_whole(number)) {
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
                        sensor.report.lost += run.numbers.give_up(*range);
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
        // A damaged one has not come: it is asked for again.
        let Ok(parsed) = Frame::parse(&frame) else {
            sensor.report.damaged += 1;
            return Ok(());
        };
        let events = parsed.header.events;
        let is_full = self.held_bytes + frame.len() > options.waiting_bytes;
        let (is_new, is_behind) = match sensor.run(stamp.run, stamp.number, joined) {
            None => (false, false),
            Some(run) => {
                let is_behind =
                    !options.as_they_come && is_full && stamp.number != run.numbers.settled();
                // It would have to wait for others, and finds no room: it is asked for when these have come.
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

    /// Delivers what waits for nothing any more: what is missing of a run comes before the next one.
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

    /// Looks whether there is a link.
    fn look(&mut self) {
        let is_down = !self.client.is_connected();
        if is_down && !self.is_down {
            self.outages += 1;
        }
        if is_down {
            // Answers that are under way do not come.
            for sensor in self.sensors.values_mut() {
                sensor.asking = Asking::default();
            }
        }
        self.is_down = is_down;
    }

    /// Asks every sensor for what is missing of its oldest run of which something is.
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
            // One that cannot be sent now is sent later.
            let _ = ask(&self.shared, session, name, self.wishes, &wish);
        }
    }

    /// What does not come for too long is lost.
    fn give_up(&mut self, now: Instant) -> Result<()> {
        let patience = self.shared.options.patience;
        let mut given_up = Vec::new();
        for (name, sensor) in &mut self.sensors {
            let newest = sensor.runs.keys().next_back().copied();
            let many = sensor.runs.len() > RUNS_MAX;
            for (index, run) in sensor.runs.values_mut().enumerate() {
                let is_old = now.saturating_duration_since(run.progress) >= patience;
                if run.numbers.missing() > 0 && (is_old || (many && index == 0)) {
                    let all = Range {
                        from: 0,
                        to: run.numbers.next(),
                    };
                    sensor.report.lost += run.numbers.give_up(all);
                    given_up.push(name.clone());
                }
            }
            // A run that is over, and of which nothing is missing, is forgotten with the next but one.
            if many
                && let Some(mut first) = sensor.runs.first_entry()
                && Some(*first.key()) != newest
                && first.get_mut().held.is_empty()
                && first.get().numbers.missing() == 0
            {
                first.remove();
            }
        }
        for name in given_up {
            self.settle(&name)?;
        }
        Ok(())
    }

    /// No more comes: what waits for others is delivered without them.
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
                sensor.report.lost += run.numbers.give_up(all);
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

/// From where on a run counts.
#[derive(Debug, Clone, Copy)]
struct Joined {
    from_start: bool,
    started_us: u64,
}

impl Joined {
    /// Whether all of a run is wanted: it began after the receiver.
    const fn is_whole(self, run: u64) -> bool {
        self.from_start || run >= self.started_us
    }
}

impl Sensor {
    /// A run, of which `number` has come first; none where too many are newer.
    fn run(&mut self, run: u64, number: u64, joined: Joined) -> Option<&mut Run> {
        if !self.runs.contains_key(&run) {
            let is_old = self.runs.keys().next().is_some_and(|first| run < *first);
            if is_old && self.runs.len() >= RUNS_MAX {
                return None;
            }
            self.report.runs += 1;
            let first = if joined.is_whole(run) { 0 } else { number };
            let new = Run {
                numbers: Numbers::from(first),
                held: BTreeMap::new(),
                progress: Instant::now(),
            };
            self.runs.insert(run, new);
        }
        self.runs.get_mut(&run)
    }
}

impl Run {
    /// Takes a frame; whether it is of use.
    fn take(&mut self, number: u64) -> bool {
        let missing = self.numbers.missing();
        let is_new = self.numbers.take(number);
        if is_new && (missing == 0 || self.numbers.missing() < missing) {
            self.progress = Instant::now();
        }
        is_new
    }

    /// All below a number exist.
    fn until(&mut self, next: u64) {
        if self.numbers.missing() == 0 {
            self.progress = Instant::now();
        }
        self.numbers.until(next);
    }
}

/// Asks a sensor for frames; answers come as everything else does.
fn ask(
    shared: &Arc<Shared>,
    session: &Session,
    name: &Name,
    number: u64,
    wish: &Wish,
) -> Result<()> {
    let key = name.key(Kind::Again);
    let end = Answered {
        shared: Arc::clone(shared),
        name: name.clone(),
        number,
    };
    let asked = session
        .get(key.as_str())
        .payload(wish.to_bytes())
        .consolidation(ConsolidationMode::None)
        // Answers have what the question has: they make way for what is new.
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::DataLow)
        .timeout(ANSWERS)
        .callback(move |reply| {
            if let Ok(sample) = reply.result() {
                end.shared.put(came(end.name.clone(), Kind::Again, sample));
            }
        })
        .wait();
    asked.map_err(said(key))
}

/// Tells, when it is dropped with the callback of a question, that no further answer comes.
struct Answered {
    shared: Arc<Shared>,
    name: Name,
    number: u64,
}

impl Drop for Answered {
    fn drop(&mut self) {
        self.shared
            .put(Came::Answered(self.name.clone(), self.number));
    }
}
