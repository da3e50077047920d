//! A consumer of messages, with its own queue and a thread that empties it.

use std::io::{self, ErrorKind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, Builder};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use event_files::output::Output;
use serde::Serialize;

use super::address::Address;
use super::sink::Sink;
use crate::queue::{Queue, Taken, Weigh};

/// Wait before a lost connection is tried again: at first, and at most.
const RETRY: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(5));
/// Time in which a receiver refuses a connection, if it does.
const REFUSED: Duration = Duration::from_millis(100);
/// Time in which a thread notices that the time for sending is over.
pub(super) const LAST: Duration = Duration::from_millis(150);
/// Overhead of a message in a queue, in bytes.
const MESSAGE_BYTES: usize = 64;

/// A frame or a packet, shared by all consumers.
#[derive(Debug, Clone)]
pub struct Message {
    /// Its bytes.
    pub bytes: Arc<Vec<u8>>,
    /// Number of events in it.
    pub events: u64,
}

impl Weigh for Message {
    /// Counts the message in full, as if it were not shared: the limit then holds for any number of consumers.
    fn weight(&self) -> usize {
        self.bytes.len() + MESSAGE_BYTES
    }
}

/// A number of messages and their content.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Amount {
    /// Number of messages.
    pub messages: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Their events.
    pub events: u64,
}

#[derive(Debug, Default)]
struct Counter {
    messages: AtomicU64,
    bytes: AtomicU64,
    events: AtomicU64,
}

impl Counter {
    fn add(&self, message: &Message) {
        self.add_all(Amount {
            messages: 1,
            bytes: message.bytes.len() as u64,
            events: message.events,
        });
    }

    /// Takes back what was counted.
    fn remove(&self, amount: Amount) {
        self.messages.fetch_sub(amount.messages, Ordering::Relaxed);
        self.bytes.fetch_sub(amount.bytes, Ordering::Relaxed);
        self.events.fetch_sub(amount.events, Ordering::Relaxed);
    }

    fn add_all(&self, amount: Amount) {
        self.messages.fetch_add(amount.messages, Ordering::Relaxed);
        self.bytes.fetch_add(amount.bytes, Ordering::Relaxed);
        self.events.fetch_add(amount.events, Ordering::Relaxed);
    }

    fn amount(&self) -> Amount {
        Amount {
            messages: self.messages.load(Ordering::Relaxed),
            bytes: self.bytes.load(Ordering::Relaxed),
            events: self.events.load(Ordering::Relaxed),
        }
    }
}

/// What happened to a consumer's messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Address of the consumer.
    pub to: String,
    /// What was sent to it.
    pub sent: Amount,
    /// What was not sent: its queue was full, it was away, or it accepted nothing until the end.
    pub lost: Amount,
    /// Whether it was ever reached.
    pub reached: bool,
    /// Number of times that it was away and came back.
    pub reconnects: u64,
    /// Most bytes that were ever in its queue.
    pub queue_peak_bytes: usize,
    /// Why it gets nothing any more, or got nothing at the end.
    pub failure: Option<String>,
    /// Whether it is a pipe that its reader has closed.
    #[serde(skip)]
    pub is_closed: bool,
}

impl Amount {
    /// Returns what came after `before`.
    const fn since(self, before: Self) -> Self {
        Self {
            messages: self.messages - before.messages,
            bytes: self.bytes - before.bytes,
            events: self.events - before.events,
        }
    }
}

struct Shared {
    address: Address,
    queue: Queue<Message>,
    sent: Counter,
    lost: Counter,
    reached: AtomicBool,
    reconnects: AtomicU64,
    /// The first attempt to reach it has succeeded or failed.
    is_tried: AtomicBool,
    /// It may not be used at all.
    is_forbidden: AtomicBool,
    /// No more messages follow; those queued are still sent for a while.
    ending: AtomicBool,
    /// The time for sending what is queued is over.
    over: AtomicBool,
    done: AtomicBool,
    failure: Mutex<Option<String>>,
    closed: AtomicBool,
}

/// A consumer of messages.
pub struct Consumer {
    shared: Arc<Shared>,
    /// For a file: renames it to its own name when it is complete.
    output: Option<Output>,
}

impl Consumer {
    /// Starts the thread that feeds the consumer at an address, with a queue of at most `queue_bytes` bytes. A file is
    /// created here; a connection is opened by the thread, for a name may take long to look up and a host to answer.
    /// Until somebody listens there, it is tried again. A file gets its own name when it is complete; an existing one is
    /// replaced only with `overwrite`.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn start(address: Address, queue_bytes: usize, overwrite: bool) -> Result<Self> {
        let open = |to: &Address| Sink::open(to).map_err(|error| anyhow!("{address}: {error}"));
        let (output, sink) = match &address {
            Address::File(path) => {
                let output = Output::begin_live(path, overwrite)?;
                let part = Address::File(output.path().to_owned());
                (Some(output), Some(open(&part)?))
            }
            Address::Stdout => (None, Some(open(&address)?)),
            Address::Tcp(_) | Address::Udp(_) | Address::Unix(_) => (None, None),
        };
        let shared = Arc::new(Shared {
            queue: Queue::new(queue_bytes),
            sent: Counter::default(),
            lost: Counter::default(),
            reached: AtomicBool::new(false),
            reconnects: AtomicU64::new(0),
            is_tried: AtomicBool::new(sink.is_some()),
            is_forbidden: AtomicBool::new(false),
            ending: AtomicBool::new(false),
            over: AtomicBool::new(false),
            done: AtomicBool::new(false),
            failure: Mutex::new(sink.is_none().then(|| "has not answered yet".to_owned())),
            closed: AtomicBool::new(false),
            address,
        });
        let thread = Arc::clone(&shared);
        Builder::new()
            .name("consumer".to_owned())
            .spawn(move || thread.run(sink))
            .context("cannot start a consumer's thread")?;
        Ok(Self { shared, output })
    }

    /// Returns whether the first attempt to reach the consumer is over.
    #[must_use]
    pub fn is_tried(&self) -> bool {
        self.shared.is_tried.load(Ordering::Acquire)
    }

    /// Checks that the consumer may be reached, now or later.
    ///
    /// # Errors
    /// The system forbids it, or the address can be nobody's.
    pub fn check(&self) -> Result<()> {
        if !self.shared.is_forbidden.load(Ordering::Relaxed) {
            return Ok(());
        }
        let Report { to, failure, .. } = self.report();
        Err(anyhow!("{to}: {}", failure.unwrap_or_default()))
    }

    /// Queues a message without ever waiting; messages dropped to make room are counted as lost.
    pub fn give(&self, message: Message) {
        for gone in self.shared.queue.force(message) {
            self.shared.lost.add(&gone);
        }
    }

    /// Announces that no more messages follow.
    pub fn end(&self) {
        self.shared.ending.store(true, Ordering::Relaxed);
        self.shared.queue.close();
    }

    /// Returns whether the consumer has stopped for good.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.shared.done.load(Ordering::Acquire)
    }

    /// Asks the consumer's thread to stop, whatever is queued.
    pub fn give_up(&self) {
        self.shared.over.store(true, Ordering::Relaxed);
    }

    /// Returns a report. What is queued is lost, and a thread that hangs in a write to a file or a pipe, or in a look-up
    /// of a name, is left running. A file gets its own name if it has received everything and `is_whole`, that is, the
    /// stream ended as it should; otherwise it stays marked as incomplete.
    #[must_use]
    pub fn finish(mut self, is_whole: bool) -> Report {
        self.give_up();
        if !self.is_done() {
            for message in self.shared.queue.abandon() {
                self.shared.lost.add(&message);
            }
        }
        let mut report = self.report();
        if let Some(output) = self.output.take() {
            if !self.is_done() && report.failure.is_none() {
                report.failure = Some("accepted nothing more until the end".to_owned());
            }
            if report.failure.is_none() && is_whole {
                report.failure = output.keep().err().map(|error| format!("{error:#}"));
            } else if let Some(part) = output.leave() {
                let failure = report.failure.take();
                let failure = failure.map_or(String::new(), |failure| format!(": {failure}"));
                let part = part.display();
                report.failure = Some(format!("incomplete: what arrived is in {part}{failure}"));
            }
        }
        report
    }

    /// Returns what has happened to the messages so far.
    #[must_use]
    pub fn report(&self) -> Report {
        let failure = self.shared.failure.lock();
        Report {
            to: self.shared.address.to_string(),
            sent: self.shared.sent.amount(),
            lost: self.shared.lost.amount(),
            reached: self.shared.reached.load(Ordering::Relaxed),
            reconnects: self.shared.reconnects.load(Ordering::Relaxed),
            queue_peak_bytes: self.shared.queue.fill().peak_bytes,
            failure: failure.unwrap_or_else(PoisonError::into_inner).clone(),
            is_closed: self.shared.closed.load(Ordering::Relaxed),
        }
    }
}

impl Drop for Consumer {
    fn drop(&mut self) {
        // For a consumer that was never finished: an empty file is removed.
        self.shared.over.store(true, Ordering::Relaxed);
        self.end();
        if let Some(output) = self.output.take() {
            let _ = output.leave();
        }
    }
}

impl Shared {
    fn fail(&self, why: String) {
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        *failure = Some(why);
    }

    fn recover(&self) {
        *self.failure.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    fn run(&self, sink: Option<Sink>) {
        let sink = sink.or_else(|| self.first()).or_else(|| self.again(false));
        if let Some(sink) = sink {
            self.carry(sink);
        }
        for message in self.queue.abandon() {
            self.lost.add(&message);
        }
        self.done.store(true, Ordering::Release);
    }

    /// Tries to reach a consumer for the first time.
    fn first(&self) -> Option<Sink> {
        let opened = Sink::open(&self.address);
        match &opened {
            Ok(_) => self.recover(),
            Err(error) => {
                self.fail(error.to_string());
                self.is_forbidden.store(!may_come(error), Ordering::Relaxed);
            }
        }
        self.is_tried.store(true, Ordering::Release);
        opened.ok()
    }

    /// Sends what is queued until the end, or until the sink fails for good.
    fn carry(&self, mut sink: Sink) {
        let goes_on = || !self.over.load(Ordering::Relaxed);
        // UDP only: whether the latest message found nobody.
        let mut is_away = false;
        // A UDP message may find nobody; every other sink is connected.
        if !matches!(sink, Sink::Udp(..)) {
            self.reached.store(true, Ordering::Relaxed);
        }
        // What had been sent when the connection was opened.
        let mut before = self.sent.amount();
        // A message of which nothing was sent over a connection that was refused.
        let mut held = None;
        // Whether the connection before this one was refused, so that this one may be.
        let mut is_doubtful = false;
        let mut opened = Instant::now();
        while goes_on() {
            if is_doubtful {
                self.pause(opened + REFUSED);
            }
            let message = match held.take() {
                Some(message) => message,
                None => match self.queue.take(Duration::from_millis(100)) {
                    Taken::Item(message) => message,
                    Taken::Nothing => continue,
                    Taken::Closed => break,
                },
            };
            if let Some(why) = sink.refusal() {
                held = Some(message);
                self.take_back(before, why);
                if self.ending.load(Ordering::Relaxed) {
                    break;
                }
                is_doubtful = true;
                match self.again(is_doubtful) {
                    Some(next) => (sink, before) = (next, self.sent.amount()),
                    None => break,
                }
                opened = Instant::now();
                continue;
            }
            match sink.send(&message.bytes, &goes_on) {
                Ok(()) => {
                    self.sent.add(&message);
                    if std::mem::take(&mut is_doubtful) {
                        self.recover();
                    }
                    let was_reached = self.reached.swap(true, Ordering::Relaxed);
                    if is_away {
                        self.recover();
                        is_away = false;
                        self.reconnects
                            .fetch_add(u64::from(was_reached), Ordering::Relaxed);
                    }
                }
                Err(error) if sink.survives(&error) => {
                    self.lost.add(&message);
                    // The system had no room for a datagram; other datagrams of the message may have arrived.
                    if error.kind() != ErrorKind::WouldBlock {
                        is_away = true;
                        self.fail(error.to_string());
                    }
                }
                Err(error) => {
                    // Part of the message may have arrived; the reader finds the next message by itself.
                    self.lost.add(&message);
                    if !goes_on() {
                        self.fail("accepted nothing more until the end".to_owned());
                        break;
                    }
                    match sink.refusal() {
                        Some(why) => {
                            is_doubtful = true;
                            self.take_back(before, why);
                        }
                        None => self.fail(error.to_string()),
                    }
                    if !sink.comes_back() {
                        let is_closed = error.kind() == ErrorKind::BrokenPipe;
                        self.closed.store(is_closed, Ordering::Relaxed);
                        break;
                    }
                    match self.again(is_doubtful) {
                        Some(next) => (sink, before) = (next, self.sent.amount()),
                        None => break,
                    }
                    opened = Instant::now();
                }
            }
        }
        if let Some(message) = held {
            self.lost.add(&message);
        } else {
            if sink.may_refuse() {
                self.pause(opened + REFUSED);
            }
            if let Some(why) = sink.refusal() {
                self.take_back(before, why);
            }
        }
        if let Err(error) = sink.end() {
            self.fail(error.to_string());
        }
    }

    /// Waits until then, or until the time for sending is over.
    fn pause(&self, until: Instant) {
        while Instant::now() < until && !self.over.load(Ordering::Relaxed) {
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Counts as lost what was sent over a connection that its consumer refused: nothing of it was taken.
    fn take_back(&self, before: Amount, why: String) {
        let refused = self.sent.amount().since(before);
        self.sent.remove(refused);
        self.lost.add_all(refused);
        self.fail(why);
    }

    /// Tries to open the sink of a consumer that is away, until it succeeds or the end has come. One that refused the
    /// connection before may do so again.
    fn again(&self, is_refused: bool) -> Option<Sink> {
        let (mut wait, most) = RETRY;
        loop {
            let until = Instant::now() + wait;
            while Instant::now() < until && !self.ending.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_millis(20));
            }
            // At the end the connection is tried once more without a wait.
            let is_last = self.ending.load(Ordering::Relaxed);
            match Sink::open(&self.address) {
                Ok(sink) if is_refused => return Some(sink),
                Ok(sink) => {
                    self.recover();
                    let was_reached = self.reached.load(Ordering::Relaxed);
                    self.reconnects
                        .fetch_add(u64::from(was_reached), Ordering::Relaxed);
                    return Some(sink);
                }
                Err(_) if is_last => return None,
                Err(error) => self.fail(error.to_string()),
            }
            wait = (2 * wait).min(most);
        }
    }
}

/// Returns whether a consumer that cannot be reached may appear later.
fn may_come(error: &io::Error) -> bool {
    !matches!(
        error.kind(),
        ErrorKind::PermissionDenied | ErrorKind::InvalidInput
    )
}
