//! Reads the events of a link as they arrive, through the same [`EventReader`] interface as recordings.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use eecvs_nostd::{Event, Sensor};
use event_files::{BATCH_EVENTS, EventReader, Pause, Skipped};

use crate::clock::{Clock, Relation};
use crate::device::{EVENTS_PER_BYTE_MAX, Parse};
use crate::pump::{Chunk, Pumped};
use crate::queue::Taken;

/// Longest time between two updates of [`Progress`] while nothing arrives.
const WAIT: Duration = Duration::from_millis(20);
/// Shortest time between two updates of [`Progress`] while chunks arrive.
const TELL: Duration = Duration::from_millis(50);
/// Bytes parsed per call, so that their events fit one batch.
const PARSE_BYTES: usize = BATCH_EVENTS / EVENTS_PER_BYTE_MAX;

/// State of a live stream, shared with whoever watches it.
#[derive(Debug, Clone, Default)]
pub struct Progress {
    /// Events so far.
    pub events: u64,
    /// Size of the sensor as the stream reports it; `None` before the first update.
    pub sensor: Option<Sensor>,
    /// Latest time in the stream, in the device's microseconds.
    pub time_us: Option<u64>,
    /// Words that are not events, by name.
    pub words: Skipped,
    /// What the parser found lost or left out, by cause.
    pub losses: Skipped,
    /// Relation between the device's clock and the host's.
    pub relation: Option<Relation>,
}

/// Runs a stream's parser, informs it of losses and the host's clock, and updates the shared [`Progress`].
pub struct Follower {
    parser: Box<dyn Parse>,
    clock: Clock,
    progress: Arc<Mutex<Progress>>,
    told: Option<Instant>,
}

impl Follower {
    /// Follows a stream from its beginning; `progress` is updated about twenty times a second.
    #[must_use]
    pub fn new(parser: Box<dyn Parse>, progress: Arc<Mutex<Progress>>) -> Self {
        Self {
            parser,
            clock: Clock::default(),
            progress,
            told: None,
        }
    }

    /// Returns the stream's parser, for its counts, time and sensor.
    #[must_use]
    pub fn parser(&self) -> &dyn Parse {
        self.parser.as_ref()
    }

    /// Prepares the parser for a chunk; call it before the chunk's bytes are parsed.
    pub fn begin(&mut self, chunk: &Chunk) {
        if chunk.after_loss {
            self.parser.resume(self.clock.device_us(chunk.at));
        }
    }

    /// Parses bytes of a chunk and appends their events to `events`.
    pub fn parse(&mut self, bytes: &[u8], events: &mut Vec<Event>) {
        self.parser.parse(bytes, events);
    }

    /// Completes a chunk that arrived at `at`: relates the clocks and updates the progress when due.
    pub fn end(&mut self, at: Instant) {
        if let Some(time_us) = self.parser.time_us() {
            self.clock.note(at, time_us);
        }
        if self.told.is_none_or(|told| told.elapsed() > TELL) {
            self.tell();
            self.told = Some(Instant::now());
        }
    }

    /// Parses a whole chunk only to count its events; `events` is scratch space.
    pub fn count(&mut self, chunk: &Chunk, events: &mut Vec<Event>) {
        self.begin(chunk);
        for part in chunk.bytes.chunks(PARSE_BYTES) {
            events.clear();
            self.parser.parse(part, events);
        }
        self.end(chunk.at);
    }

    /// Updates the shared progress now: for pauses of the stream and for its end.
    pub fn tell(&mut self) {
        let mut progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        *progress = Progress {
            events: self.parser.events(),
            sensor: Some(self.parser.sensor()),
            time_us: self.parser.time_us(),
            words: self.parser.words(),
            losses: self.parser.losses(),
            relation: self.clock.relation(),
        };
    }
}

/// Reads the events of a link.
pub struct LiveReader {
    format: &'static str,
    camera: String,
    pumped: Arc<Pumped>,
    follower: Follower,
    chunk: Option<Chunk>,
    /// Number of bytes of the chunk that have been parsed.
    used: usize,
    /// Events read while waiting for the sensor.
    ahead: Vec<Event>,
    ended: bool,
    words: Skipped,
}

impl LiveReader {
    /// Reads a link that is already pumped; `camera` is the name that files give the camera.
    #[must_use]
    pub fn new(
        format: &'static str,
        camera: String,
        pumped: Arc<Pumped>,
        follower: Follower,
    ) -> Self {
        Self {
            format,
            camera,
            pumped,
            follower,
            chunk: None,
            used: 0,
            ahead: Vec::new(),
            ended: false,
            words: Skipped::default(),
        }
    }

    /// Waits until the stream reports a sensor other than `unknown`, or ends.
    ///
    /// # Errors
    /// Those of [`EventReader::read`].
    pub fn wait_for_sensor(&mut self, unknown: Sensor) -> Result<()> {
        while self.sensor() == unknown && self.ahead.is_empty() && !self.ended {
            let mut ahead = Vec::new();
            let read = self.read(&mut ahead);
            self.ahead = ahead;
            read?;
        }
        Ok(())
    }

    /// Returns the next chunk if one arrives in time.
    fn next_chunk(&mut self) -> Option<Chunk> {
        match self.pumped.queue.take(WAIT) {
            Taken::Item(chunk) => {
                self.follower.begin(&chunk);
                self.used = 0;
                Some(chunk)
            }
            Taken::Nothing => {
                self.follower.tell();
                None
            }
            Taken::Closed => {
                self.ended = true;
                None
            }
        }
    }
}

impl EventReader for LiveReader {
    fn format(&self) -> &'static str {
        self.format
    }

    fn sensor(&self) -> Sensor {
        self.follower.parser().sensor()
    }

    fn camera(&self) -> Option<&str> {
        Some(&self.camera)
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        if !self.ahead.is_empty() {
            let ahead = self.ahead.len();
            events.append(&mut self.ahead);
            return Ok(ahead);
        }
        let before = events.len();
        loop {
            let chunk = match self.chunk.take() {
                Some(chunk) => chunk,
                None => match self.next_chunk() {
                    Some(chunk) => chunk,
                    None if self.ended => {
                        self.words = self.follower.parser().words();
                        self.follower.tell();
                        return match self.pumped.failure() {
                            Some(failure) => Err(event_types::stream::Error::other(failure)),
                            None => Ok(0),
                        };
                    }
                    None => return Ok(0),
                },
            };
            let rest = chunk.bytes.get(self.used..).unwrap_or_default();
            let part = &rest[..rest.len().min(PARSE_BYTES)];
            self.follower.parse(part, events);
            self.used += part.len();
            if part.len() < rest.len() {
                self.chunk = Some(chunk);
            } else {
                self.follower.end(chunk.at);
                self.pumped.reuse(chunk.bytes);
            }
            if events.len() > before {
                return Ok(events.len() - before);
            }
        }
    }

    fn pause(&self) -> Pause {
        if self.ended {
            return Pause::Ended;
        }
        Pause::Until(self.follower.parser().time_us().unwrap_or(0))
    }

    fn skipped(&self) -> &Skipped {
        &self.words
    }
}

#[cfg(test)]
mod tests {
    use std::io::{self, Write};
    use std::num::NonZeroUsize;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use clap::Parser;
    use eecvs::encode::{Limits, encode};
    use eecvs_cli::codec::CodecOptions;
    use eecvs_nostd::{Polarity, Scan, scan};

    use super::*;
    use crate::link::{Link, LinkError, Loss, Received};
    use crate::pump;

    const SENSOR: Sensor = Sensor {
        width: 8,
        height: 8,
    };
    const WINDOW_US: u32 = 1000;

    #[derive(Parser)]
    struct Options {
        #[command(flatten)]
        codec: CodecOptions,
    }

    /// A byte below 255 is an event that many microseconds after the previous one; 255 is a window without events.
    struct Steps {
        time_us: u64,
        events: u64,
        resumed: u64,
    }

    impl Parse for Steps {
        fn sensor(&self) -> Sensor {
            SENSOR
        }

        fn parse(&mut self, bytes: &[u8], events: &mut Vec<Event>) {
            for byte in bytes {
                if *byte == 255 {
                    self.time_us += u64::from(WINDOW_US);
                    continue;
                }
                self.time_us += u64::from(*byte);
                self.events += 1;
                events.push(Event {
                    t_us: self.time_us,
                    x: 1,
                    y: u16::from(byte % 8),
                    polarity: Polarity::On,
                });
            }
        }

        fn resume(&mut self, _: Option<u64>) {
            self.resumed += 1;
        }

        fn time_us(&self) -> Option<u64> {
            Some(self.time_us)
        }

        fn events(&self) -> u64 {
            self.events
        }

        fn words(&self) -> Skipped {
            Skipped::default()
        }

        fn losses(&self) -> Skipped {
            let mut losses = Skipped::default();
            losses.add("resumed", self.resumed);
            losses
        }
    }

    fn reader(link: Box<dyn Link>, progress: &Arc<Mutex<Progress>>) -> LiveReader {
        let (pumped, _) = pump::start(link, 1 << 16).unwrap();
        let parser = Steps {
            time_us: 0,
            events: 0,
            resumed: 0,
        };
        let progress = Arc::clone(progress);
        let follower = Follower::new(Box::new(parser), progress);
        LiveReader::new("steps", "test".to_owned(), pumped, follower)
    }

    /// Sends nothing after an empty window until a frame has been written.
    struct Patient {
        step: usize,
        frames: Arc<AtomicUsize>,
    }

    impl Link for Patient {
        fn name(&self) -> &str {
            "patient"
        }

        fn receive(&mut self, _: Duration) -> Result<Received<'_>, LinkError> {
            self.step += 1;
            let at = Instant::now();
            Ok(match self.step {
                1 => Received::Bytes {
                    bytes: &[5, 6, 7],
                    at,
                },
                2 => Received::Bytes { bytes: &[255], at },
                3 => {
                    while self.frames.load(Ordering::Relaxed) == 0 {
                        if at.elapsed() > Duration::from_secs(20) {
                            return Err(LinkError::Failed {
                                link: "patient".to_owned(),
                                cause: "no frame came".to_owned(),
                            });
                        }
                        std::thread::sleep(Duration::from_millis(1));
                    }
                    Received::Bytes { bytes: &[8], at }
                }
                _ => Received::Ended,
            })
        }

        fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
            Ok(())
        }
    }

    struct Frames(Arc<AtomicUsize>, Vec<u8>);

    impl Write for Frames {
        fn write(&mut self, frame: &[u8]) -> io::Result<usize> {
            self.0.fetch_add(1, Ordering::Relaxed);
            self.1.extend_from_slice(frame);
            Ok(frame.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_window_is_written_when_its_time_has_run_though_nothing_follows() {
        let frames = Arc::new(AtomicUsize::new(0));
        let mut out = Frames(Arc::clone(&frames), Vec::new());
        let mut reader = reader(Box::new(Patient { step: 0, frames }), &Arc::default());
        let options = Options::parse_from(["encode", "--window-us", "1000"]);
        let config = options.codec.config(SENSOR).unwrap();
        let summary = encode(
            &mut reader,
            config,
            Limits::default(),
            NonZeroUsize::MIN,
            &mut out,
            &mut |_| {},
        )
        .unwrap();
        assert_eq!((summary.events_encoded, summary.frames), (4, 2));
        let mut rest = &out.1[..];
        let mut starts = Vec::new();
        while let Scan::Frame(frame) = scan(rest) {
            starts.push((frame.header.t0_us, frame.header.events));
            rest = &rest[frame.bytes..];
        }
        // The grid of windows continues through the pause.
        assert_eq!(starts, [(5, 3), (1005, 1)]);
    }

    #[test]
    fn losses_reach_the_parser_and_the_failure_comes_after_the_events() {
        use crate::pump::tests::{Scripted, Step};
        let link = Scripted::link([
            Step::Bytes(vec![1; 5000]),
            Step::Lost(Loss::Damaged),
            Step::Bytes(vec![2; 10]),
            Step::Unplug,
        ]);
        let progress = Arc::default();
        let mut reader = reader(link, &progress);
        let mut events = Vec::new();
        assert_eq!(reader.pause(), Pause::Until(0));
        let error = loop {
            match reader.read(&mut events) {
                Ok(read) => assert!(read <= BATCH_EVENTS),
                Err(error) => break error,
            }
        };
        assert_eq!(events.len(), 5010);
        assert!(error.to_string().contains("unplugged"), "{error}");
        assert_eq!(reader.pause(), Pause::Ended);
        let progress = progress.lock().unwrap().clone();
        assert_eq!(progress.events, 5010);
        assert_eq!(progress.losses.iter().collect::<Vec<_>>(), [("resumed", 1)]);
    }
}
