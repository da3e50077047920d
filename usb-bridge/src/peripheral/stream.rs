//! A recording as the bytes that a device sends, at its pace.
//!
//! Event i, at time t_i of the recording, is due when the time e since the stream was first read satisfies:
//!
//! ```text
//! as recorded, f times as fast   (t_i - t_0) / f <= e
//! at a rate of R per second      i / R           <= e
//! as fast as possible            always
//! ```
//!
//! A slower host makes the stream late ([`Sent::late_us`]) but loses nothing. At most a batch of events and the
//! words of [`WRITE_EVENTS`] events wait in memory.
//!
//! A device shows its time in a silence too: while no event is due, the stream has the words of time up to now, which
//! is t_0 + f e as recorded. At other paces the device's time follows the events, and goes on by the host's clock after
//! the last one, if the device stays on ([`Recording::stay`]).

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use eecvs_nostd::Event;
use event_files::{BATCH_EVENTS, EventReader};

use crate::device::{Due, Stream, WriteStream};

/// Number of events turned into bytes at once.
pub const WRITE_EVENTS: usize = 1024;

/// A recording that begins before this time keeps its own times: about 71 minutes on the device's clock.
pub const OWN_TIME_MAX_US: u64 = 1 << 32;

/// When events are due.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// As recorded, but this many times as fast.
    Recorded(f64),
    /// This many events per second, evenly spaced.
    Rate(f64),
    /// As fast as the host takes them.
    Max,
}

impl std::str::FromStr for Pace {
    type Err = String;

    /// Parses `real`, `max`, `N` events per second, or `Nx` for a factor of the recorded speed.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let number = |digits: &str| {
            let number: Option<f64> = digits.parse().ok();
            number.filter(|number| number.is_finite() && *number > 0.0)
        };
        let pace = match text {
            "real" => Some(Self::Recorded(1.0)),
            "max" => Some(Self::Max),
            _ => match text.strip_suffix('x') {
                Some(factor) => number(factor).map(Self::Recorded),
                None => number(text).map(Self::Rate),
            },
        };
        pace.ok_or_else(|| {
            "expected real, max, a number of events per second, or a factor such as 2x".into()
        })
    }
}

/// Counts of what a stream has sent so far; they may be read while the stream is in use.
#[derive(Debug, Default)]
pub struct Sent {
    events: AtomicU64,
    bytes: AtomicU64,
    rounds: AtomicU64,
    late_us: AtomicU64,
    elapsed_us: AtomicU64,
    first_us: OnceLock<(u64, u64)>,
    error: OnceLock<String>,
}

impl Sent {
    /// Returns the number of events whose words were written.
    #[must_use]
    pub fn events(&self) -> u64 {
        self.events.load(Ordering::Relaxed)
    }

    /// Returns the number of bytes handed over.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Returns how many times the recording reached its end.
    #[must_use]
    pub fn rounds(&self) -> u64 {
        self.rounds.load(Ordering::Relaxed)
    }

    /// Returns the longest time for which a due event was not yet read, in microseconds.
    #[must_use]
    pub fn late_us(&self) -> u64 {
        self.late_us.load(Ordering::Relaxed)
    }

    /// Returns the time from the first read to the latest bytes.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        Duration::from_micros(self.elapsed_us.load(Ordering::Relaxed))
    }

    /// Returns the time of the first event in the recording and in the stream, in microseconds.
    #[must_use]
    pub fn first_us(&self) -> Option<(u64, u64)> {
        self.first_us.get().copied()
    }

    /// Returns the error that ended the stream early, if any.
    #[must_use]
    pub fn error(&self) -> Option<&str> {
        self.error.get().map(String::as_str)
    }
}

/// Opens the recording from its beginning.
pub type Open = Box<dyn FnMut() -> Result<Box<dyn EventReader>> + Send>;

/// A recording that a device sends.
pub struct Recording {
    open: Open,
    reader: Option<Box<dyn EventReader>>,
    writer: Box<dyn WriteStream>,
    pace: Pace,
    repeats: bool,
    stays: bool,
    delay: Duration,
    start_us: Option<u64>,
    /// Events that were read, at the stream's times; those from `next` on are not yet written.
    events: Vec<Event>,
    next: usize,
    /// Words that were written; those from `given` on are not yet handed over.
    words: Vec<u8>,
    given: usize,
    /// First and latest time in the recording, in this round.
    span: Option<(u64, u64)>,
    /// Stream time of the recording's first event, in this round.
    base_us: u64,
    /// Value of `base_us` in the first round, from which the pace counts; `None` before the first event.
    origin_us: Option<u64>,
    /// Number of events whose words were written since the start.
    written: u64,
    /// Stream time up to which words were written.
    shown_us: u64,
    /// Stream time at which the host last reset the device's clock.
    reset_us: u64,
    /// After the recording's end: how long after the start the stream's time was shown last.
    over: Option<Duration>,
    due: Due,
    clock: Option<Instant>,
    sent: Arc<Sent>,
}

impl Recording {
    /// Creates a stream of a recording. `start_us` is the time of its first event on the device's clock; `None`
    /// keeps the recording's own time if that is below [`OWN_TIME_MAX_US`], and uses 0 otherwise.
    #[must_use]
    pub fn new(
        open: Open,
        writer: Box<dyn WriteStream>,
        pace: Pace,
        start_us: Option<u64>,
    ) -> Self {
        Self {
            open,
            reader: None,
            writer,
            pace,
            repeats: false,
            stays: false,
            delay: Duration::ZERO,
            start_us,
            events: Vec::with_capacity(BATCH_EVENTS),
            next: 0,
            words: Vec::new(),
            given: 0,
            span: None,
            base_us: 0,
            origin_us: None,
            written: 0,
            shown_us: 0,
            reset_us: 0,
            over: None,
            due: Due::More,
            clock: None,
            sent: Arc::default(),
        }
    }

    /// Sets whether the recording restarts at its end, 1 us after its latest event.
    #[must_use]
    pub fn repeat(mut self, repeats: bool) -> Self {
        self.repeats = repeats;
        self
    }

    /// Sets whether the device stays on after the recording, like a camera that sees nothing: its stream does not end,
    /// and shows its time.
    #[must_use]
    pub fn stay(mut self, stays: bool) -> Self {
        self.stays = stays;
        self
    }

    /// Sets how long after its start the device is silent, and its clock stands still.
    #[must_use]
    pub fn delay(mut self, delay: Duration) -> Self {
        self.delay = delay;
        self
    }

    /// Returns the shared counts of what was sent.
    #[must_use]
    pub fn sent(&self) -> Arc<Sent> {
        Arc::clone(&self.sent)
    }

    /// Appends the bytes that are due at `elapsed` after the stream's start; see [`Stream::take`].
    ///
    /// # Errors
    /// The recording cannot be read, or an event cannot be represented in the device's stream. The stream has then
    /// ended.
    pub fn take_at(&mut self, elapsed: Duration, room: usize, bytes: &mut Vec<u8>) -> Result<Due> {
        let (before, was_over) = (bytes.len(), self.over.is_some());
        let result = self.fill(elapsed, room, bytes);
        // Not for the words of time after the recording.
        if bytes.len() > before && !was_over {
            let elapsed_us = u64::try_from(elapsed.as_micros()).unwrap_or(u64::MAX);
            self.sent.elapsed_us.store(elapsed_us, Ordering::Relaxed);
        }
        if let Err(error) = &result {
            self.due = Due::Ended;
            self.words.clear();
            self.given = 0;
            // Only the first error, which ended the stream, is kept.
            let _ = self.sent.error.set(format!("{error:#}"));
        }
        result
    }

    fn fill(&mut self, elapsed: Duration, room: usize, bytes: &mut Vec<u8>) -> Result<Due> {
        let end = bytes.len().saturating_add(room);
        loop {
            if !self.hand_over(end, bytes) {
                return Ok(Due::More);
            }
            if self.due == Due::Ended || bytes.len() == end {
                return Ok(self.due);
            }
            if self.over.is_none() && self.next == self.events.len() && !self.read(elapsed)? {
                continue;
            }
            let count = self.count_due(elapsed);
            if count > 0 {
                self.write(count)?;
                continue;
            }
            self.show_time(elapsed);
            if self.words.is_empty() {
                return Ok(Due::More);
            }
        }
    }

    /// Hands over the words that wait, until `bytes` ends at `end`; returns whether none are left.
    fn hand_over(&mut self, end: usize, bytes: &mut Vec<u8>) -> bool {
        let waiting = &self.words[self.given..];
        let length = waiting.len().min(end - bytes.len());
        bytes.extend_from_slice(&waiting[..length]);
        self.given += length;
        self.sent.bytes.fetch_add(length as u64, Ordering::Relaxed);
        if self.given < self.words.len() {
            return false;
        }
        self.words.clear();
        self.given = 0;
        true
    }

    /// Writes the next `count` events.
    fn write(&mut self, count: usize) -> Result<()> {
        let events = &mut self.events[self.next..self.next + count];
        for event in &mut *events {
            self.shown_us = self.shown_us.max(event.t_us);
            event.t_us = event.t_us.saturating_sub(self.reset_us);
        }
        self.writer.write(events, &mut self.words)?;
        self.next += count;
        self.written += count as u64;
        self.sent.events.fetch_add(count as u64, Ordering::Relaxed);
        Ok(())
    }

    /// Writes the words of time up to now.
    fn show_time(&mut self, elapsed: Duration) {
        let now_us = match (self.pace, self.origin_us, self.over) {
            (Pace::Recorded(factor), Some(origin_us), _) => {
                origin_us.saturating_add((elapsed.as_secs_f64() * 1e6 * factor) as u64)
            }
            // At another pace, or without an event, time goes on as the clock does.
            (_, _, Some(shown)) => {
                let passed_us = elapsed.saturating_sub(shown).as_micros() as u64;
                self.over = Some(shown + Duration::from_micros(passed_us));
                self.shown_us.saturating_add(passed_us)
            }
            _ => return,
        };
        self.shown_us = self.shown_us.max(now_us);
        self.writer
            .advance(self.shown_us.saturating_sub(self.reset_us), &mut self.words);
    }

    /// Reads the next events; returns `false` at an end of the recording, where there may be words that close the
    /// stream.
    fn read(&mut self, elapsed: Duration) -> Result<bool> {
        self.events.clear();
        self.next = 0;
        let reader = match &mut self.reader {
            Some(reader) => reader,
            None => self.reader.insert((self.open)()?),
        };
        if reader.read(&mut self.events)? > 0 {
            return self.shift().map(|()| true);
        }
        self.reader = None;
        self.sent.rounds.fetch_add(1, Ordering::Relaxed);
        match self.span.take() {
            // An empty recording is not repeated, because that would never end.
            Some((first, latest)) if self.repeats => {
                self.base_us = self.base_us.saturating_add(latest - first + 1);
            }
            _ => {
                self.writer.finish(&mut self.words)?;
                self.over = Some(elapsed);
                if !self.stays {
                    self.due = Due::Ended;
                }
            }
        }
        Ok(false)
    }

    /// Shifts the events that were just read to their times in the stream.
    fn shift(&mut self) -> Result<()> {
        let Some(event) = self.events.first() else {
            return Ok(());
        };
        let (first, mut latest) = *self.span.get_or_insert((event.t_us, event.t_us));
        if self.origin_us.is_none() {
            let own = if first < OWN_TIME_MAX_US { first } else { 0 };
            self.base_us = self.start_us.unwrap_or(own);
            self.origin_us = Some(self.base_us);
            // Every start has the same.
            let _ = self.sent.first_us.set((first, self.base_us));
        }
        for event in &mut self.events {
            latest = latest.max(event.t_us);
            let shifted = i128::from(event.t_us) - i128::from(first) + i128::from(self.base_us);
            event.t_us = u64::try_from(shifted).ok().with_context(|| {
                format!(
                    "the event at {} us would be before the device's time 0: give the recording's \
                     first event a later device time",
                    event.t_us
                )
            })?;
        }
        self.span = Some((first, latest));
        Ok(())
    }

    /// Returns how many of the next events are due, at most [`WRITE_EVENTS`].
    fn count_due(&self, elapsed: Duration) -> usize {
        let events = &self.events[self.next..];
        let events = &events[..events.len().min(WRITE_EVENTS)];
        if events.is_empty() {
            return 0;
        }
        match self.pace {
            Pace::Max => events.len(),
            Pace::Rate(rate) => {
                let all = (elapsed.as_secs_f64() * rate) as u64;
                let late = all.saturating_sub(self.written);
                self.note_late(late as f64 / rate * 1e6);
                usize::try_from(late)
                    .unwrap_or(usize::MAX)
                    .min(events.len())
            }
            Pace::Recorded(factor) => {
                let passed = elapsed.as_secs_f64() * 1e6 * factor;
                let now = self.origin_us.unwrap_or(0).saturating_add(passed as u64);
                if let Some(first) = events.first() {
                    self.note_late(now.saturating_sub(first.t_us) as f64 / factor);
                }
                events.iter().take_while(|event| event.t_us <= now).count()
            }
        }
    }

    fn note_late(&self, late_us: f64) {
        self.sent
            .late_us
            .fetch_max(late_us as u64, Ordering::Relaxed);
    }
}

impl Stream for Recording {
    fn take(&mut self, room: usize, bytes: &mut Vec<u8>) -> Result<Due> {
        let elapsed = self.clock.get_or_insert_with(Instant::now).elapsed();
        match elapsed.checked_sub(self.delay) {
            Some(elapsed) => self.take_at(elapsed, room, bytes),
            None => {
                // A reset of the clock is reported at once: hosts wait for it.
                self.hand_over(bytes.len().saturating_add(room), bytes);
                Ok(Due::More)
            }
        }
    }

    fn start(&mut self) {
        self.reader = None;
        self.events.clear();
        self.words.clear();
        (self.next, self.given, self.written) = (0, 0, 0);
        (self.span, self.origin_us, self.over, self.clock) = (None, None, None, None);
        (self.base_us, self.shown_us, self.reset_us) = (0, 0, 0);
        self.due = Due::More;
        self.writer.restart();
    }

    fn reset_time(&mut self) {
        if self.writer.reset_time(&mut self.words) {
            self.reset_us = self.shown_us;
        }
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::{Polarity, Sensor};
    use event_files::Skipped;
    use proptest::prelude::*;

    use super::*;

    struct Reader {
        times: Vec<u64>,
        skipped: Skipped,
    }

    impl EventReader for Reader {
        fn format(&self) -> &'static str {
            "test"
        }
        fn sensor(&self) -> Sensor {
            Sensor::new(4, 4).expect("a sensor")
        }
        fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
            let length = self.times.len().min(3);
            events.extend(self.times.drain(..length).map(|t_us| Event {
                t_us,
                x: 0,
                y: 0,
                polarity: Polarity::On,
            }));
            Ok(length)
        }
        fn skipped(&self) -> &Skipped {
            &self.skipped
        }
    }

    /// Marks a word of time without an event, which is written when more than 1,000 us have passed.
    const TIME: u64 = 1 << 62;
    /// The word of a reset of the clock.
    const RESET: u64 = 1 << 63;

    /// Eight bytes per event or word of time, and 0xEE at the end; refuses the time 666,666.
    #[derive(Default)]
    struct Writer {
        shown_us: u64,
    }

    impl WriteStream for Writer {
        fn write(&mut self, events: &[Event], bytes: &mut Vec<u8>) -> Result<()> {
            for event in events {
                anyhow::ensure!(event.t_us != 666_666, "event at 666666 us");
                self.shown_us = event.t_us;
                bytes.extend(event.t_us.to_le_bytes());
            }
            Ok(())
        }
        fn advance(&mut self, t_us: u64, bytes: &mut Vec<u8>) {
            if t_us > self.shown_us + 1000 {
                self.shown_us = t_us;
                bytes.extend((t_us | TIME).to_le_bytes());
            }
        }
        fn reset_time(&mut self, bytes: &mut Vec<u8>) -> bool {
            self.shown_us = 0;
            bytes.extend(RESET.to_le_bytes());
            true
        }
        fn restart(&mut self) {
            self.shown_us = 0;
        }
        fn finish(&mut self, bytes: &mut Vec<u8>) -> Result<()> {
            bytes.push(0xEE);
            Ok(())
        }
    }

    fn recording(times: &[u64], pace: Pace, start_us: Option<u64>) -> Recording {
        let times = times.to_vec();
        let open = Box::new(move || {
            Ok(Box::new(Reader {
                times: times.clone(),
                skipped: Skipped::default(),
            }) as Box<dyn EventReader>)
        });
        Recording::new(open, Box::new(Writer::default()), pace, start_us)
    }

    fn times(bytes: &[u8]) -> Vec<u64> {
        let words = bytes.chunks_exact(8);
        words
            .map(|word| u64::from_le_bytes(word.try_into().expect("eight")))
            .collect()
    }

    const AT: fn(u64) -> Duration = Duration::from_micros;

    #[test]
    fn events_are_due_in_their_time() {
        let all = [100, 110, 130, 150, 150];
        for (pace, at, due) in [
            (Pace::Recorded(1.0), 0, 1),
            (Pace::Recorded(1.0), 29, 2),
            (Pace::Recorded(1.0), 30, 3),
            (Pace::Recorded(10.0), 3, 3),
            (Pace::Recorded(1.0), 50, 5),
            (Pace::Rate(1e6), 0, 0),
            (Pace::Rate(1e6), 4, 4),
            (Pace::Rate(1e6), 400, 5),
            (Pace::Max, 0, 5),
        ] {
            let mut bytes = Vec::new();
            let mut stream = recording(&all, pace, None);
            let more = stream.take_at(AT(at), 1000, &mut bytes).expect("good");
            assert_eq!(times(&bytes), all[..due], "{pace:?} after {at} us");
            assert_eq!(more == Due::Ended, due == 5);
            assert_eq!(bytes.last() == Some(&0xEE), due == 5);
        }
    }

    #[test]
    fn a_repeated_recording_goes_on_in_time_and_an_empty_one_ends() {
        let mut bytes = Vec::new();
        let mut stream = recording(&[1 << 50, (1 << 50) + 9], Pace::Max, None).repeat(true);
        assert_eq!(
            stream.take_at(AT(0), 48, &mut bytes).expect("good"),
            Due::More
        );
        assert_eq!(times(&bytes), [0, 9, 10, 19, 20, 29]);
        assert_eq!(stream.sent().first_us(), Some((1 << 50, 0)));
        let mut stream = recording(&[], Pace::Max, None).repeat(true);
        assert_eq!(
            stream.take_at(AT(0), 48, &mut bytes).expect("good"),
            Due::Ended
        );
    }

    #[test]
    fn times_begin_where_they_were_asked_to() {
        let mut bytes = Vec::new();
        let mut stream = recording(&[50, 40, 60], Pace::Max, Some(1 << 40));
        stream.take_at(AT(0), 24, &mut bytes).expect("good");
        assert_eq!(times(&bytes), [1 << 40, (1 << 40) - 10, (1 << 40) + 10]);
        let mut stream = recording(&[50, 40, 60], Pace::Max, Some(0));
        assert!(stream.take_at(AT(0), 24, &mut bytes).is_err());
    }

    fn words_at(stream: &mut Recording, at_us: u64) -> Vec<u64> {
        let mut bytes = Vec::new();
        let due = stream
            .take_at(AT(at_us), 1 << 20, &mut bytes)
            .expect("good");
        assert_eq!(due, Due::More);
        times(&bytes)
    }

    #[test]
    fn time_is_shown_in_a_silence() {
        let mut stream = recording(&[100, 9_000], Pace::Recorded(1.0), None).stay(true);
        assert_eq!(words_at(&mut stream, 0), [100]);
        assert_eq!(words_at(&mut stream, 900), [0_u64; 0]);
        assert_eq!(words_at(&mut stream, 2_000), [TIME | 2_100]);
        assert_eq!(words_at(&mut stream, 2_500), [0_u64; 0]);
        assert_eq!(words_at(&mut stream, 9_000), [9_000]);
        // After its end, whose mark is no whole word.
        assert_eq!(words_at(&mut stream, 12_000), [TIME | 12_100]);
        assert_eq!(words_at(&mut stream, 1_000_000), [TIME | 1_000_100]);
        let mut stream = recording(&[100, 9_000], Pace::Max, None).stay(true);
        assert_eq!(words_at(&mut stream, 50), [100, 9_000]);
        assert_eq!(words_at(&mut stream, 500), [0_u64; 0]);
        assert_eq!(words_at(&mut stream, 1_150), [TIME | 10_100]);
        assert_eq!(words_at(&mut stream, 5_050), [TIME | 14_000]);
    }

    #[test]
    fn time_goes_on_as_the_clock_does_where_there_is_no_event() {
        for pace in [Pace::Recorded(1.0), Pace::Recorded(0.1), Pace::Max] {
            let mut stream = recording(&[], pace, None).stay(true);
            let words: Vec<u64> = (0..1000)
                .flat_map(|ms| words_at(&mut stream, ms * 1000))
                .collect();
            let shown = (1..500).map(|i| TIME | (2000 * i));
            assert!(shown.eq(words), "{pace:?}");
        }
    }

    #[test]
    fn a_reset_of_the_clock_is_shown_and_times_count_from_it() {
        let mut stream = recording(&[100, 9_000, 9_500], Pace::Recorded(1.0), None).stay(true);
        assert_eq!(words_at(&mut stream, 2_000), [100, TIME | 2_100]);
        stream.reset_time();
        assert_eq!(words_at(&mut stream, 8_900), [RESET, 6_900]);
        assert_eq!(words_at(&mut stream, 9_400), [7_400]);
    }

    #[test]
    fn a_reset_is_shown_during_the_delay() {
        let hour = Duration::from_secs(3600);
        let mut stream = recording(&[100], Pace::Max, None).delay(hour);
        let mut bytes = Vec::new();
        stream.take(1000, &mut bytes).expect("good");
        assert_eq!(bytes.len(), 0);
        stream.reset_time();
        stream.take(3, &mut bytes).expect("good");
        stream.take(1000, &mut bytes).expect("good");
        assert_eq!(times(&bytes), [RESET]);
    }

    #[test]
    fn every_start_plays_from_the_start() {
        for pace in [Pace::Max, Pace::Rate(1e6), Pace::Recorded(1.0)] {
            let mut stream = recording(&[100, 150, 200], pace, None).stay(true);
            assert_eq!(words_at(&mut stream, 100), [100, 150, 200], "{pace:?}");
            stream.reset_time();
            stream.start();
            assert_eq!(words_at(&mut stream, 100), [100, 150, 200], "{pace:?}");
            stream.start();
            // Half way.
            let mut bytes = Vec::new();
            stream.take_at(AT(100), 12, &mut bytes).expect("good");
            stream.start();
            assert_eq!(words_at(&mut stream, 100), [100, 150, 200], "{pace:?}");
        }
    }

    #[test]
    fn an_error_ends_the_stream_and_is_kept() {
        let mut bytes = Vec::new();
        let mut stream = recording(&[1, 2, 3, 666_666, 4], Pace::Max, None);
        assert!(stream.take_at(AT(0), 1000, &mut bytes).is_err());
        assert_eq!(stream.sent().error(), Some("event at 666666 us"));
        assert_eq!(
            stream.take_at(AT(0), 1000, &mut bytes).expect("ended"),
            Due::Ended
        );
    }

    #[test]
    fn paces_are_read_and_nonsense_is_refused() {
        assert_eq!("real".parse(), Ok(Pace::Recorded(1.0)));
        assert_eq!("0.5x".parse(), Ok(Pace::Recorded(0.5)));
        assert_eq!("1e6".parse(), Ok(Pace::Rate(1e6)));
        assert_eq!("max".parse(), Ok(Pace::Max));
        for text in ["", "x", "0", "-1", "nan", "infx", "fast", "1 x"] {
            assert!(text.parse::<Pace>().is_err(), "{text}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]
        #[test]
        fn any_room_at_any_time_gives_the_same_bytes(
            steps in prop::collection::vec(0_u64..50, 0..40),
            mut rooms in prop::collection::vec(0_usize..40, 0..20),
            factor in 0.1..20.0_f64,
        ) {
            let mut t = 0;
            let all: Vec<u64> = steps.iter().map(|step| { t += step; t }).collect();
            rooms.push(9);
            let mut whole = Vec::new();
            recording(&all, Pace::Max, None).take_at(AT(0), usize::MAX / 2, &mut whole).unwrap();
            let mut bytes = Vec::new();
            let mut stream = recording(&all, Pace::Recorded(factor), None);
            let mut ended = false;
            for (turn, room) in rooms.iter().cycle().enumerate().take(30_000) {
                let before = bytes.len();
                let due = stream.take_at(AT(turn as u64), *room, &mut bytes).unwrap();
                prop_assert!(bytes.len() - before <= *room);
                if due == Due::Ended {
                    ended = true;
                    break;
                }
            }
            prop_assert!(ended);
            prop_assert_eq!(bytes, whole);
        }
    }
}
