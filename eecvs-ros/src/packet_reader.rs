//! Reads events from a subscription to `event_camera_msgs/msg/EventPacket`, as messages arrive.
//!
//! The reader works like that of a recording that ends with the subscription. Messages that are damaged, come from
//! a sensor of another size, or have an unknown encoding are counted and left out, as are those of a second
//! publisher. Gaps in the sequence numbers are counted as losses.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use eecvs_nostd::{Event, Sensor};
use event_files::input::Batch;
use event_files::ros::fields::Serialisation;
use event_files::ros::message::{Head, Kind};
use event_files::ros::message_events::MessageEvents;
use event_files::{Assumption, BATCH_EVENTS, EventReader, Pause, Skipped};
use usb_bridge::stop::Stop;

use crate::message::{EventPacket, Message, Time, sequence_of};
use crate::one_publisher::OnePublisher;
use crate::sequence::Sequence;

/// Longest wait before the stop request is checked again.
const WAIT: Duration = Duration::from_millis(20);
/// Silence after which windows are closed by the clock alone.
const QUIET: Duration = Duration::from_millis(100);

/// Counts and stamps of what has been received so far.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Received {
    /// Messages received, including those left out.
    pub packets: u64,
    /// Losses, repetitions and restarts, according to the sequence numbers.
    pub sequence: Sequence,
    /// Messages left out.
    pub refused: u64,
    /// Why the latest of them was left out.
    pub why_refused: Option<String>,
    /// Messages of other publishers, which are not among those above.
    pub others: u64,
    /// Events read.
    pub events: u64,
    /// For the latest two messages whose events were read: the computer's time in the header, and the sensor's time
    /// of the latest event.
    pub stamps: [Option<(Time, u64)>; 2],
}

impl Received {
    /// Counts a message that has arrived, readable or not: a message that is left out is not lost.
    fn count(&mut self, cdr: &[u8]) {
        self.packets += 1;
        if let Some(number) = sequence_of(EventPacket::TYPE, cdr) {
            self.sequence.follow(number);
        }
    }

    /// Returns the counts of what was lost, each with what it counts.
    #[must_use]
    pub const fn losses(&self) -> [(u64, &'static str); 3] {
        [
            (self.sequence.lost, "event messages have not arrived"),
            (self.refused, "event messages were left out"),
            (
                self.others,
                "event messages of another publisher were left out",
            ),
        ]
    }

    /// Converts a time of the sensor to the computer's time, zero before any events were read.
    ///
    /// A time between the latest events of the last two messages is interpolated between their stamps. An earlier
    /// time gets the older stamp. A later time gets the latest stamp plus the difference in sensor time.
    #[must_use]
    pub fn stamp_at(&self, t_us: u64) -> Time {
        let Some((stamp, last_us)) = self.stamps[1] else {
            return Time::default();
        };
        if t_us >= last_us {
            let behind_us = i64::try_from(t_us - last_us).unwrap_or(i64::MAX);
            return Time::from_ns(stamp.ns().saturating_add(behind_us.saturating_mul(1000)));
        }
        match self.stamps[0] {
            Some((before, before_us)) if before_us < last_us && before < stamp => {
                let part = t_us.saturating_sub(before_us) as f64 / (last_us - before_us) as f64;
                let apart_ns = (stamp.ns() - before.ns()) as f64;
                Time::from_ns(before.ns() + (apart_ns * part) as i64)
            }
            _ => stamp,
        }
    }
}

/// The shared counts, for those who watch while the reader is in use.
pub type Watch = Arc<Mutex<Received>>;

/// Returns a copy of the current counts.
#[must_use]
pub fn look(watch: &Watch) -> Received {
    lock(watch).clone()
}

/// Locks the counts. Poisoning is ignored: a panic while they are locked leaves them consistent.
fn lock(watch: &Watch) -> MutexGuard<'_, Received> {
    watch.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reader of the events of a subscription.
pub struct PacketReader {
    subscription: OnePublisher,
    stop: Stop,
    /// Length of a silence that ends the stream.
    idle: Option<Duration>,
    decoder: MessageEvents,
    told: (u32, u32),
    received: Watch,
    clock: Clock,
    /// Stamp of the message being read.
    stamp: Time,
    is_reading: bool,
    ended: bool,
}

/// Relation between the sensor's time and the computer's.
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

    /// Returns the sensor time before which no more events are expected, or `None` while there has been no silence
    /// of [`QUIET`]. During a silence the sensor's time is extrapolated, no faster than recorded; a recording
    /// played more slowly passes more slowly.
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

fn sensor(head: &Head) -> Option<Sensor> {
    let side = |side: u32| u16::try_from(side).ok();
    Sensor::new(side(head.width)?, side(head.height)?)
}

impl PacketReader {
    /// Waits for the first message that states a valid sensor size; returns only the counts if stopped before. The
    /// stream ends after a silence of `idle`, once events have arrived.
    ///
    /// # Errors
    /// The subscription has ended.
    pub fn begin(
        subscription: impl Into<OnePublisher>,
        stop: &Stop,
        idle: Option<Duration>,
    ) -> Result<Result<Self, Received>> {
        let mut subscription = subscription.into();
        let mut received = Received::default();
        while !stop.is_asked() {
            let Some(taken) = subscription.take(WAIT)? else {
                continue;
            };
            if taken.is_new_publisher {
                received.sequence.restart();
            }
            received.others = subscription.left_out();
            let cdr = taken.cdr;
            received.count(&cdr);
            let (head, sensor) = match begin(&cdr).map(|head| (sensor(&head), head)) {
                Ok((Some(sensor), head)) => (head, sensor),
                Ok((None, head)) => {
                    received.refused += 1;
                    received.why_refused = Some(format!(
                        "{}x{} is not a valid sensor size",
                        head.width, head.height
                    ));
                    continue;
                }
                Err(why) => {
                    received.refused += 1;
                    received.why_refused = Some(why);
                    continue;
                }
            };
            let mut reader = Self {
                subscription,
                stop: stop.clone(),
                idle,
                decoder: MessageEvents::new(sensor),
                told: (head.width, head.height),
                received: Arc::new(Mutex::new(received)),
                clock: Clock::default(),
                stamp: Time::default(),
                is_reading: false,
                ended: false,
            };
            reader.start(cdr, &head);
            return Ok(Ok(reader));
        }
        received.others = subscription.left_out();
        Ok(Err(received))
    }

    /// Returns a handle to the counts.
    #[must_use]
    pub fn watch(&self) -> Watch {
        Arc::clone(&self.received)
    }

    fn start(&mut self, cdr: Vec<u8>, head: &Head) {
        self.decoder.take(cdr, head.content);
        self.stamp = Time::from_ns(i64::try_from(head.stamp_ns).unwrap_or(i64::MAX));
        self.is_reading = true;
    }

    fn refuse(&mut self, why: String) {
        let mut received = lock(&self.received);
        received.refused += 1;
        received.why_refused = Some(why);
        drop(received);
        self.is_reading = false;
    }

    /// Takes the next message, if one arrives within [`WAIT`].
    fn next(&mut self) -> Result<()> {
        let taken = self.subscription.take(WAIT)?;
        let mut received = lock(&self.received);
        received.others = self.subscription.left_out();
        let Some(taken) = taken else {
            return Ok(());
        };
        if taken.is_new_publisher {
            received.sequence.restart();
            received.stamps = [None, None];
        }
        let cdr = taken.cdr;
        received.count(&cdr);
        drop(received);
        if taken.is_new_publisher {
            // Neither words nor times go on where those of another publisher ended.
            self.decoder = MessageEvents::new(self.decoder.sensor());
            self.clock = Clock::default();
        }
        match begin(&cdr) {
            Err(why) => self.refuse(why),
            Ok(head) if (head.width, head.height) != self.told => {
                let (width, height) = self.told;
                self.refuse(format!(
                    "the sensor has {}x{} pixels, but had {width}x{height} before",
                    head.width, head.height
                ));
            }
            Ok(head) => self.start(cdr, &head),
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

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        if self.ended {
            return Ok(0);
        }
        if !self.is_reading {
            self.next().map_err(event_types::stream::Error::other)?;
        }
        let before = events.len();
        while self.is_reading && events.len() - before < BATCH_EVENTS / 2 {
            // A batch may end up to a vector of events before it is full: the message continues in the next batch.
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
            let mut received = lock(&self.received);
            received.events += read as u64;
            match &mut received.stamps {
                [_, Some((stamp, last_us))] if *stamp == self.stamp => *last_us = last.t_us,
                [before, latest] => {
                    *before = *latest;
                    *latest = Some((self.stamp, last.t_us));
                }
            }
            drop(received);
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
        // While events arrive, none are expected before the latest one.
        let last_us = self.clock.last.map_or(0, |(_, last_us)| last_us);
        Pause::Until(passed_us.unwrap_or(last_us))
    }

    fn assumptions(&self) -> &[Assumption] {
        self.decoder.assumptions()
    }

    fn skipped(&self) -> &Skipped {
        self.decoder.skipped()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use crate::message::to_cdr;
    use crate::transport::{Known, PublisherId, Subscription};

    /// A subscription to messages that have already arrived.
    struct Come(VecDeque<Vec<u8>>);

    impl Subscription for Come {
        fn take_from(&mut self, _: Duration) -> Result<Option<(Vec<u8>, PublisherId)>> {
            let next = self.0.pop_front();
            Ok(next.map(|cdr| (cdr, PublisherId::default())))
        }

        fn publisher(&self, _: PublisherId) -> Known {
            Known::Unnamed
        }

        fn publishers(&self) -> usize {
            1
        }
    }

    #[test]
    fn what_is_left_out_is_not_lost() {
        let packet = |seq: u64| EventPacket {
            seq,
            height: 720,
            width: 1280,
            encoding: "evt3".to_owned(),
            // No decoder supports big-endian packets.
            is_bigendian: seq.is_multiple_of(2),
            ..EventPacket::default()
        };
        let numbers = [0, 1, 2, 4, 6, 7, 10];
        let come = numbers.map(|seq| to_cdr(&packet(seq)));
        let subscription: Box<dyn Subscription> = Box::new(Come(come.into()));
        let reader = PacketReader::begin(subscription, &Stop::default(), None).unwrap();
        let mut reader = reader.ok().unwrap();
        let mut events = Vec::new();
        for _ in 0..10 {
            reader.read(&mut events).unwrap();
        }
        let received = look(&reader.watch());
        assert_eq!((received.packets, received.refused), (7, 5));
        assert_eq!(received.sequence.lost, 4);
    }

    #[test]
    fn stamps_lie_between_those_of_messages() {
        let at = |ms: i64| Time::from_ns(ms * 1_000_000);
        let mut received = Received::default();
        assert_eq!(received.stamp_at(5), Time::default());
        received.stamps = [None, Some((at(100), 7000))];
        assert_eq!(received.stamp_at(6000), at(100));
        assert_eq!(received.stamp_at(7000), at(100));
        assert_eq!(received.stamp_at(9000), at(102));
        // As if played at half speed.
        received.stamps = [Some((at(96), 5000)), Some((at(100), 7000))];
        assert_eq!(received.stamp_at(6000), at(98));
        assert_eq!(received.stamp_at(4000), at(96));
        assert_eq!(received.stamp_at(u64::MAX).sec, i32::MAX);
    }

    #[test]
    fn time_passes_in_silence_as_fast_as_it_was_played() {
        let start = Instant::now();
        let mut clock = Clock::default();
        assert_eq!(clock.passed_us(start), None);
        clock.note(start, 1_000_000);
        assert_eq!(clock.passed_us(start + QUIET / 2), None);
        let second = Duration::from_secs(1);
        for (speed_us, silence_us) in [
            (500_000, 500_000),
            (1_000_000, 1_000_000),
            (9_000_000, 1_000_000),
        ] {
            let mut clock = clock;
            clock.note(start + second, 1_000_000 + speed_us);
            let passed_us = clock.passed_us(start + 2 * second + QUIET).unwrap();
            assert_eq!(passed_us, 1_000_000 + speed_us + silence_us);
        }
    }
}
