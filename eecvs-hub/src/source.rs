//! Plays a scene or a recording as a live source, which returns events when they are due.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use eecvs_nostd::{Event, Sensor};
use event_files::{BATCH_EVENTS, EventReader, Pause, Skipped};
use usb_bridge::peripheral::stream::Pace;
use usb_bridge::stop::Stop;

use crate::clock::Clock;

/// Longest wait for the next event before a read returns none.
const WAIT: Duration = Duration::from_millis(2);

/// Maximum number of events in a repeated recording, which is held in memory.
pub const REPEATED_MAX: usize = 1 << 26;

/// Converts the time of a sensor's events to the time at which they were due, by the clock of its run.
#[derive(Debug)]
pub struct Due {
    clock: Clock,
    /// What the clock shows (microseconds since 1970) at the events' time 0, plus 1; 0 if the two do not run at the
    /// same pace.
    origin_us: AtomicU64,
    /// What the clock showed at the latest read.
    read_us: AtomicU64,
}

impl Due {
    /// Returns when a time of the events was due, in microseconds since 1970; if the events' time does not run at
    /// the clock's pace, the time of the latest read.
    #[must_use]
    pub fn at(&self, t_us: u64) -> u64 {
        match self.origin_us.load(Ordering::Relaxed) {
            0 => self.read_us.load(Ordering::Relaxed),
            origin_us => (origin_us - 1).wrapping_add(t_us),
        }
    }
}

/// A reader that returns the events of another reader when they are due.
pub struct Live {
    events: From,
    pace: Pace,
    stop: Stop,
    due: Arc<Due>,
    sensor: Sensor,
    skipped: Skipped,
    format: &'static str,
    /// Events that were read and are not due yet.
    waiting: Vec<Event>,
    used: usize,
    /// When the first event was returned, and its time.
    start: Option<(Instant, u64)>,
    given: u64,
    is_over: bool,
    /// The sensor's time up to which all events were returned.
    passed_us: u64,
}

/// Source of the events.
enum From {
    Once(Box<dyn EventReader>),
    Again {
        events: Vec<Event>,
        next: usize,
        /// Offset added to the times; it grows by `round_us` with each repetition.
        shift_us: u64,
        round_us: u64,
    },
}

impl Live {
    /// Plays the events of a reader at a pace, by a clock. With `repeat`, starts again at the end, with times that
    /// continue.
    ///
    /// # Errors
    /// The recording cannot be read, or it is to be repeated and has no events or too many.
    pub fn new(
        mut reader: Box<dyn EventReader>,
        pace: Pace,
        repeat: bool,
        clock: Clock,
        stop: Stop,
    ) -> Result<Self> {
        let (sensor, format) = (reader.sensor(), reader.format());
        let events = match repeat {
            false => From::Once(reader),
            true => {
                let mut events = Vec::new();
                while reader.read(&mut events)? > 0 {
                    ensure!(
                        events.len() <= REPEATED_MAX,
                        "a recording of more than {REPEATED_MAX} events cannot be repeated: cut it \
                         with eecvs convert"
                    );
                }
                ensure!(
                    !events.is_empty(),
                    "a recording without events cannot be repeated"
                );
                let times = || events.iter().map(|event| event.t_us);
                let span_us = times().max().unwrap_or(0) - times().min().unwrap_or(0);
                From::Again {
                    events,
                    next: 0,
                    shift_us: 0,
                    round_us: span_us + 1,
                }
            }
        };
        Ok(Self {
            events,
            pace,
            stop,
            due: Arc::new(Due {
                clock,
                origin_us: AtomicU64::new(0),
                read_us: AtomicU64::new(0),
            }),
            sensor,
            skipped: Skipped::default(),
            format,
            waiting: Vec::new(),
            used: 0,
            start: None,
            given: 0,
            is_over: false,
            passed_us: 0,
        })
    }

    /// Returns when the events are due.
    #[must_use]
    pub fn due_times(&self) -> Arc<Due> {
        Arc::clone(&self.due)
    }

    /// Reads the next events if none are waiting.
    fn fill(&mut self) -> Result<()> {
        if self.used < self.waiting.len() {
            return Ok(());
        }
        self.waiting.clear();
        self.used = 0;
        match &mut self.events {
            From::Once(reader) => {
                // A reader that is live itself may have no events for the moment.
                while reader.read(&mut self.waiting)? == 0 {
                    if reader.pause() == Pause::Ended || self.stop.is_asked() {
                        self.is_over = true;
                        return Ok(());
                    }
                }
            }
            From::Again {
                events,
                next,
                shift_us,
                round_us,
            } => {
                if *next >= events.len() {
                    *next = 0;
                    *shift_us += *round_us;
                }
                let batch = events.iter().skip(*next).take(BATCH_EVENTS);
                self.waiting.extend(batch.map(|event| Event {
                    t_us: event.t_us + *shift_us,
                    ..*event
                }));
                *next += self.waiting.len();
            }
        }
        Ok(())
    }

    /// Returns how many of the waiting events are due, and how long it is until the next one is.
    fn due(&mut self, now: Instant) -> (usize, Duration) {
        let waiting = self.waiting.get(self.used..).unwrap_or_default();
        let Some(first) = waiting.first() else {
            return (0, Duration::ZERO);
        };
        let (at, first_us) = match self.start {
            Some(start) => start,
            None => {
                // Take the clock's time first, so that no event is returned before its due time by the clock.
                let origin_us = self
                    .due
                    .clock
                    .now_us()
                    .wrapping_sub(first.t_us)
                    .wrapping_add(1);
                if self.pace == Pace::Recorded(1.0) {
                    self.due.origin_us.store(origin_us, Ordering::Relaxed);
                }
                *self.start.insert((Instant::now(), first.t_us))
            }
        };
        let since = now.saturating_duration_since(at);
        match self.pace {
            Pace::Max => (waiting.len(), Duration::ZERO),
            Pace::Recorded(factor) => {
                let passed_us = first_us + (since.as_secs_f64() * factor * 1e6) as u64;
                self.passed_us = self.passed_us.max(passed_us);
                let due = waiting
                    .iter()
                    .take_while(|event| event.t_us <= passed_us)
                    .count();
                let left_us = first.t_us.saturating_sub(passed_us) as f64 / factor;
                (due, Duration::from_micros(left_us as u64))
            }
            Pace::Rate(per_second) => {
                let due = (since.as_secs_f64() * per_second) as u64 + 1;
                let due = due.saturating_sub(self.given);
                (waiting.len().min(due as usize), WAIT)
            }
        }
    }
}

impl EventReader for Live {
    fn format(&self) -> &'static str {
        self.format
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        if self.stop.is_asked() {
            self.is_over = true;
        }
        if self.is_over {
            return Ok(0);
        }
        self.fill().map_err(event_types::stream::Error::other)?;
        if self.is_over {
            return Ok(0);
        }
        let (mut due, left) = self.due(Instant::now());
        if due == 0 {
            thread::sleep(left.min(WAIT).max(Duration::from_micros(100)));
            (due, _) = self.due(Instant::now());
        }
        self.due
            .read_us
            .store(self.due.clock.now_us(), Ordering::Relaxed);
        let now = self
            .waiting
            .get(self.used..self.used + due)
            .unwrap_or_default();
        events.extend_from_slice(now);
        if let Some(last) = now.last() {
            self.passed_us = self.passed_us.max(last.t_us);
        }
        self.used += due;
        self.given += due as u64;
        Ok(due)
    }

    fn pause(&self) -> Pause {
        match self.is_over {
            true => Pause::Ended,
            false => Pause::Until(self.passed_us),
        }
    }

    fn skipped(&self) -> &Skipped {
        match &self.events {
            From::Once(reader) => reader.skipped(),
            From::Again { .. } => &self.skipped,
        }
    }
}

#[cfg(test)]
mod tests {
    use event_emulator::{Preset, SceneConfig, emulate};

    use super::*;

    fn scene() -> Box<dyn EventReader> {
        let mut config = SceneConfig::model_1(Preset::IndoorFlying, 1);
        config.sensor = Sensor::new(32, 32).unwrap();
        config.duration_us = 100_000;
        Box::new(emulate(config).unwrap())
    }

    fn all(reader: &mut dyn EventReader) -> Vec<Event> {
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        events
    }

    #[test]
    fn events_come_when_they_are_due() {
        let want = all(scene().as_mut());
        // An hour behind this computer's clock.
        let clock = Clock::start_ahead(-3_600_000_000);
        let pace = Pace::Recorded(1.0);
        let mut live = Live::new(scene(), pace, false, clock, Stop::default()).unwrap();
        let due = live.due_times();
        let started = Instant::now();
        let mut events = Vec::new();
        let first_us = want[0].t_us;
        while live.pause() != Pause::Ended {
            let before = events.len();
            live.read(&mut events).unwrap();
            let passed_us = started.elapsed().as_micros() as u64;
            for event in &events[before..] {
                assert!(event.t_us - first_us <= passed_us, "not before it is due");
                let late_us = clock.now_us().checked_sub(due.at(event.t_us));
                assert!(late_us.is_some_and(|late_us| late_us < 60_000_000));
            }
            if let Pause::Until(until_us) = live.pause() {
                // Later events have later times.
                assert!(events.last().is_none_or(|last| last.t_us <= until_us));
            }
        }
        assert_eq!(events, want);
        let span_us = want[want.len() - 1].t_us - first_us;
        assert!(started.elapsed() >= Duration::from_micros(span_us));
    }

    #[test]
    fn a_recording_goes_on_at_its_end() {
        let want = all(scene().as_mut());
        let stop = Stop::default();
        let mut live = Live::new(scene(), Pace::Max, true, Clock::start(), stop.clone()).unwrap();
        let mut events = Vec::new();
        while events.len() < want.len() * 5 / 2 {
            live.read(&mut events).unwrap();
        }
        stop.ask();
        assert_eq!(
            (live.read(&mut events).unwrap(), live.pause()),
            (0, Pause::Ended)
        );
        let span_us = want[want.len() - 1].t_us - want[0].t_us + 1;
        for (at, event) in events.iter().enumerate() {
            let of = want[at % want.len()];
            let round = (at / want.len()) as u64;
            assert_eq!(
                *event,
                Event {
                    t_us: of.t_us + round * span_us,
                    ..of
                }
            );
        }
    }

    #[test]
    fn a_rate_holds() {
        let want = all(scene().as_mut());
        let rate = want.len() as f64 * 5.0;
        let (pace, clock) = (Pace::Rate(rate), Clock::start());
        let mut live = Live::new(scene(), pace, false, clock, Stop::default()).unwrap();
        let started = Instant::now();
        let mut events = Vec::new();
        while live.pause() != Pause::Ended {
            live.read(&mut events).unwrap();
            assert!(events.len() as f64 <= started.elapsed().as_secs_f64() * rate + 1.0);
        }
        assert_eq!(events, want);
    }
}
