//! Messages `event_camera_msgs/msg/EventPacket` to events, as they come.
//!
//! Read like a recording whose end is that of the subscription. A message that is damaged, of another sensor's size
//! or of an unknown encoding is counted and left out; so is what its number shows to be missing.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use eecvs_nostd::{Event, Sensor};
use host_harness::formats::input::Batch;
use host_harness::formats::ros::fields::Serialisation;
use host_harness::formats::ros::message::{Content, Head, Kind};
use host_harness::formats::ros::message_events::MessageEvents;
use host_harness::formats::{BATCH_EVENTS, EventReader, Pause, Skipped};
use usb_bridge::stop::Stop;

use crate::message::Time;
use crate::sequence::Sequence;
use crate::transport::Subscription;

/// Longest wait between two looks at whether to stop.
const WAIT: Duration = Duration::from_millis(20);
/// Time without a message after which windows are closed without one.
const QUIET: Duration = Duration::from_millis(100);

/// What has come so far.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Received {
    /// Messages.
    pub packets: u64,
    /// Those that never came, by their numbers, and other oddities of these.
    pub sequence: Sequence,
    /// Messages that were left out.
    pub refused: u64,
    /// Why the latest of them was.
    pub why_refused: Option<String>,
    /// Events.
    pub events: u64,
    /// The computer's time in the header of the latest message.
    pub stamp: Time,
}

/// What has come so far, for those who watch while the reader is in use.
pub type Watch = Arc<Mutex<Received>>;

/// A look at it.
#[must_use]
pub fn look(watch: &Watch) -> Received {
    lock(watch).clone()
}

/// Whoever panicked while it was locked has left it whole.
fn lock(watch: &Watch) -> MutexGuard<'_, Received> {
    watch.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reader of a subscription's events.
pub struct PacketReader {
    subscription: Box<dyn Subscription>,
    stop: Stop,
    /// How long a silence may be before the stream is taken to have ended.
    idle: Option<Duration>,
    decoder: MessageEvents,
    told: (u32, u32),
    received: Watch,
    clock: Clock,
    is_reading: bool,
    ended: bool,
}

/// How the sensor's time relates to the computer's.
#[derive(Debug, Clone, Copy, Default)]
struct Clock {
    first: Option<(Instant, u64)>,
    last: Option<(Instant, u64)>,
}

impl Clock {
    fn note(&mut self, at: Instant, t_us: u64) {
        self.first.get_or_insert((at, t_us));
        self.last = Some((at, t_us));
    }

    /// The sensor's time, of which events may no longer come; `None` while they are to be expected. Time that is
    /// played slower than it was recorded passes slower.
    fn passed_us(&self, now: Instant) -> Option<u64> {
        let ((first_at, first_us), (last_at, last_us)) = self.first.zip(self.last)?;
        let silence = now.saturating_duration_since(last_at).checked_sub(QUIET)?;
        let came = last_at.saturating_duration_since(first_at).as_secs_f64();
        let played = last_us.saturating_sub(first_us) as f64 * 1e-6;
        let speed = if came > 0.0 {
            (played / came).min(1.0)
        } else {
            1.0
        };
        let passed_us = silence.as_secs_f64() * speed * 1e6;
        Some(last_us.saturating_add(passed_us as u64))
    }
}

fn begin(cdr: &[u8]) -> Result<Head, String> {
    Head::read(cdr, Kind::EventPacket, Serialisation::Cdr).map_err(|(_, what)| what)
}

fn stamp(head: &Head) -> Time {
    Time::from_ns(i64::try_from(head.stamp_ns).unwrap_or(i64::MAX))
}

fn sensor(head: &Head) -> Option<Sensor> {
    let side = |side: u32| u16::try_from(side).ok();
    Sensor::new(side(head.width)?, side(head.height)?)
}

impl PacketReader {
    /// Waits for the first message that tells the sensor's size; `None` where it is stopped before.
    ///
    /// # Errors
    /// The subscription has ended.
    pub fn begin(
        mut subscription: Box<dyn Subscription>,
        stop: &Stop,
        idle: Option<Duration>,
    ) -> Result<Option<Self>> {
        let mut received = Received::default();
        while !stop.is_asked() {
            let Some(cdr) = subscription.take(WAIT)? else {
                continue;
            };
            received.packets += 1;
            let (head, sensor) = match begin(&cdr).map(|head| (sensor(&head), head)) {
                Ok((Some(sensor), head)) => (head, sensor),
                _ => {
                    received.refused += 1;
                    continue;
                }
            };
            received.sequence.follow(head.sequence);
            received.stamp = stamp(&head);
            let mut reader = Self {
                subscription,
                stop: stop.clone(),
                idle,
                decoder: MessageEvents::new(sensor),
                told: (head.width, head.height),
                received: Arc::new(Mutex::new(received)),
                clock: Clock::default(),
                is_reading: false,
                ended: false,
            };
            reader.start(cdr, head.content);
            return Ok(Some(reader));
        }
        Ok(None)
    }

    /// What has come, for those who watch.
    #[must_use]
    pub fn watch(&self) -> Watch {
        Arc::clone(&self.received)
    }

    fn start(&mut self, cdr: Vec<u8>, content: Content) {
        self.decoder.take(cdr, content);
        self.is_reading = true;
    }

    fn refuse(&mut self, why: String) {
        let mut received = lock(&self.received);
        received.refused += 1;
        received.why_refused = Some(why);
        drop(received);
        self.is_reading = false;
    }

    /// Takes the next message, if one comes in time.
    fn next(&mut self) -> Result<()> {
        let Some(cdr) = self.subscription.take(WAIT)? else {
            return Ok(());
        };
        let head = begin(&cdr);
        let mut received = lock(&self.received);
        received.packets += 1;
        if let Ok(head) = &head {
            received.sequence.follow(head.sequence);
            received.stamp = stamp(head);
        }
        drop(received);
        match head {
            Err(why) => self.refuse(why),
            Ok(head) if (head.width, head.height) != self.told => {
                let (width, height) = self.told;
                self.refuse(format!(
                    "a sensor of {}x{}, and of {width}x{height} before",
                    head.width, head.height
                ));
            }
            Ok(head) => self.start(cdr, head.content),
        }
        Ok(())
    }
}

impl EventReader for PacketReader {
    fn format(&self) -> &'static str {
        "event_packets"
    }

    fn sensor(&self) -> Sensor {
        self.decoder.sensor()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        if self.ended {
            return Ok(0);
        }
        if !self.is_reading {
            self.next()?;
        }
        let before = events.len();
        while self.is_reading && events.len() - before < BATCH_EVENTS / 2 {
            // A batch may end before its last dozen of events; a message goes on with the next one.
            let mut batch = Batch::new(events);
            match self.decoder.read(&mut batch) {
                Ok(true) => self.is_reading = false,
                Ok(false) => break,
                Err((at, why)) => self.refuse(format!("byte {at}: {why}")),
            }
        }
        let read = events.len() - before;
        let now = Instant::now();
        if let Some(last) = events.last().filter(|_| read > 0) {
            lock(&self.received).events += read as u64;
            self.clock.note(now, last.t_us);
        } else {
            let silence = self
                .clock
                .last
                .map(|(at, _)| now.saturating_duration_since(at));
            let is_idle = silence
                .zip(self.idle)
                .is_some_and(|(silence, idle)| silence >= idle);
            self.ended = self.stop.is_asked() || is_idle;
        }
        Ok(read)
    }

    fn pause(&self) -> Pause {
        if self.ended {
            return Pause::Ended;
        }
        let passed_us = self.clock.passed_us(Instant::now());
        // Up to the latest event, before which none is expected either.
        let last_us = self.clock.last.map_or(0, |(_, last_us)| last_us);
        Pause::Until(passed_us.unwrap_or(last_us))
    }

    fn skipped(&self) -> &Skipped {
        self.decoder.skipped()
    }
}
