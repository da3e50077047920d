//! A consumer: a queue of its own, and a thread that empties it.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, Builder};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use serde::Serialize;

use super::address::Address;
use super::sink::Sink;
use crate::queue::{Queue, Taken, Weigh};

/// Wait before a lost way is tried again, first and at the most.
const RETRY: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(5));
/// What a message takes in a queue besides its bytes.
const MESSAGE_BYTES: usize = 64;

/// A frame or a packet, which all consumers share.
#[derive(Debug, Clone)]
pub struct Message {
    /// Its bytes.
    pub bytes: Arc<Vec<u8>>,
    /// Its events.
    pub events: u64,
}

impl Weigh for Message {
    /// As if the queue were the only one that has it: so no number of consumers makes more of it.
    fn weight(&self) -> usize {
        self.bytes.len() + MESSAGE_BYTES
    }
}

/// Messages, and what was in them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Amount {
    /// Messages.
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
        self.messages.fetch_add(1, Ordering::Relaxed);
        let bytes = message.bytes.len() as u64;
        self.bytes.fetch_add(bytes, Ordering::Relaxed);
        self.events.fetch_add(message.events, Ordering::Relaxed);
    }

    fn amount(&self) -> Amount {
        Amount {
            messages: self.messages.load(Ordering::Relaxed),
            bytes: self.bytes.load(Ordering::Relaxed),
            events: self.events.load(Ordering::Relaxed),
        }
    }
}

/// What became of a consumer's messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Address.
    pub to: String,
    /// What it was sent.
    pub sent: Amount,
    /// What it was not: its queue was full, it was away, or it took nothing until the end.
    pub lost: Amount,
    /// Times that it was away and came back.
    pub reconnects: u64,
    /// Most bytes that were ever in its queue.
    pub queue_peak_bytes: usize,
    /// Why it gets nothing any more, or got nothing at the end.
    pub failure: Option<String>,
}

struct Shared {
    address: Address,
    queue: Queue<Message>,
    sent: Counter,
    lost: Counter,
    reconnects: AtomicU64,
    /// No more messages come: those in the queue are sent for a while yet.
    ending: AtomicBool,
    /// The while is over.
    over: AtomicBool,
    done: AtomicBool,
    failure: Mutex<Option<String>>,
}

/// Who gets the messages.
pub struct Consumer(Arc<Shared>);

impl Consumer {
    /// Opens the way to an address and starts its thread; the queue holds at most `queue_bytes`.
    ///
    /// # Errors
    /// Nobody is there, or the file cannot be created.
    pub fn start(address: Address, queue_bytes: usize) -> Result<Self> {
        let sink = Sink::open(&address).map_err(|error| anyhow!("{address}: {error}"))?;
        let shared = Arc::new(Shared {
            address,
            queue: Queue::new(queue_bytes),
            sent: Counter::default(),
            lost: Counter::default(),
            reconnects: AtomicU64::new(0),
            ending: AtomicBool::new(false),
            over: AtomicBool::new(false),
            done: AtomicBool::new(false),
            failure: Mutex::new(None),
        });
        let thread = Arc::clone(&shared);
        Builder::new()
            .name("consumer".to_owned())
            .spawn(move || thread.run(sink))
            .context("starting a consumer's thread")?;
        Ok(Self(shared))
    }

    /// Queues a message; what has to go for it is counted. Never waits.
    pub fn give(&self, message: Message) {
        for gone in self.0.queue.force(message) {
            self.0.lost.add(&gone);
        }
    }

    /// No more messages come.
    pub fn end(&self) {
        self.0.ending.store(true, Ordering::Relaxed);
        self.0.queue.close();
    }

    /// Waits until everything is sent or `until` has come, and reports. A thread that hangs in a write
    /// to a file or a pipe is left behind.
    #[must_use]
    pub fn finish(&self, until: Instant) -> Report {
        self.end();
        while !self.0.done.load(Ordering::Relaxed) && Instant::now() < until {
            thread::sleep(Duration::from_millis(5));
        }
        self.0.over.store(true, Ordering::Relaxed);
        let grace = Instant::now() + Duration::from_millis(500);
        while !self.0.done.load(Ordering::Relaxed) && Instant::now() < grace {
            thread::sleep(Duration::from_millis(5));
        }
        self.report()
    }

    /// What became of the messages so far.
    #[must_use]
    pub fn report(&self) -> Report {
        let failure = self.0.failure.lock();
        Report {
            to: self.0.address.to_string(),
            sent: self.0.sent.amount(),
            lost: self.0.lost.amount(),
            reconnects: self.0.reconnects.load(Ordering::Relaxed),
            queue_peak_bytes: self.0.queue.fill().peak_bytes,
            failure: failure.unwrap_or_else(PoisonError::into_inner).clone(),
        }
    }
}

impl Shared {
    fn fail(&self, why: String) {
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        *failure = Some(why);
    }

    fn run(&self, mut sink: Sink) {
        let goes_on = || !self.over.load(Ordering::Relaxed);
        while goes_on() {
            let message = match self.queue.take(Duration::from_millis(100)) {
                Taken::Item(message) => message,
                Taken::Nothing => continue,
                Taken::Closed => break,
            };
            match sink.send(&message.bytes, &goes_on) {
                Ok(()) => self.sent.add(&message),
                Err(error) => {
                    // A part of it may have come: its reader finds the next one by itself.
                    self.lost.add(&message);
                    if !goes_on() {
                        self.fail("took nothing any more until the end".to_owned());
                        break;
                    }
                    self.fail(error.to_string());
                    match self.again(&sink) {
                        Some(next) => sink = next,
                        None => break,
                    }
                }
            }
        }
        for message in self.queue.abandon() {
            self.lost.add(&message);
        }
        self.done.store(true, Ordering::Relaxed);
    }

    /// Tries to come back to a consumer that is away.
    fn again(&self, lost: &Sink) -> Option<Sink> {
        if !lost.comes_back() {
            return None;
        }
        let (mut wait, most) = RETRY;
        // At the end nobody is waited for.
        while !self.ending.load(Ordering::Relaxed) {
            let until = Instant::now() + wait;
            while Instant::now() < until && !self.ending.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_millis(20));
            }
            if let Ok(sink) = Sink::open(&self.address) {
                self.reconnects.fetch_add(1, Ordering::Relaxed);
                *self.failure.lock().unwrap_or_else(PoisonError::into_inner) = None;
                return Some(sink);
            }
            wait = (2 * wait).min(most);
        }
        None
    }
}
