//! Operators: they turn events into frames, and frames into events. One belongs to the project; others can be
//! added.
//!
//! An operator is found by its name, which every frame carries. [`Eecvs`] is the project's own; another crate adds
//! its operators by passing them to [`crate::run`]:
//!
//! ```no_run
//! # use eecvs_ros::operator::{Operator, Eecvs};
//! # fn mine() -> Box<dyn Operator> { Box::new(Eecvs) }
//! fn main() -> std::process::ExitCode {
//!     eecvs_ros::run(vec![mine()])
//! }
//! ```
//!
//! An operator that needs only the events of one window at a time can implement [`WindowCoder`]; [`Windowed`] turns
//! it into an operator.

use std::io;
use std::num::NonZeroUsize;

use anyhow::{Context, Result};
use eecvs::decode::{FrameCounts, Windows};
use eecvs::encode::{Codec, EncodeSummary, Limits, encode};
use eecvs::frame_file::FrameSink;
use eecvs::reconstruct::DecodedWindow;
use eecvs::reconstruct::hybrid::Refused;
use eecvs::window_limit::WindowLimit;
use eecvs_cli::codec::CodecOptions;
use eecvs_nostd::{Event, Header, Sensor};
use event_files::{EventReader, Pause};

/// A window's sensor size and time span, in the sensor's time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    /// Sensor size in pixels.
    pub sensor: Sensor,
    /// Start of the window, in microseconds.
    pub t0_us: u64,
    /// Duration of the window, in microseconds.
    pub duration_us: u32,
}

/// A frame: a window of events, or a part of one.
#[derive(Debug, Clone, Copy)]
pub struct Encoded<'f> {
    /// The frame's window.
    pub span: Span,
    /// Number of events encoded in this frame.
    pub events: u32,
    /// Whether the sensor's clock fell back before this window.
    pub begins_run: bool,
    /// Events since the previous frame that arrived too late and are in no frame.
    pub late: u32,
    /// The encoded bytes, which only the operator understands.
    pub data: &'f [u8],
}

/// The settings of one encoder.
pub struct Job<'j> {
    /// Options of the project's own coders. Another operator documents which of them it honours.
    pub codec: &'j CodecOptions,
    /// Limits on the sizes of windows and frames.
    pub limits: Limits,
}

/// A window decoded from frames.
#[derive(Debug, Clone, PartialEq)]
pub enum Decoded {
    /// A window from the project's own frames: its events or coefficients.
    Window(DecodedWindow),
    /// The events of a window from another operator's frames.
    Events(Span, Vec<Event>),
}

/// Callback that receives each window completed by a frame.
pub type Ready<'r> = &'r mut dyn FnMut(Decoded);

/// Decodes frames into windows.
pub trait Decoder: Send {
    /// Decodes the next frame; `ready` receives the windows that end before or with it.
    ///
    /// # Errors
    /// The frame cannot be decoded; it is left out, and the error says why.
    fn take(&mut self, frame: &crate::message::Frame, ready: Ready<'_>) -> Result<()>;

    /// Ends the stream: `ready` receives the window that is still open, if any.
    fn end(&mut self, ready: Ready<'_>) {
        let _ = ready;
    }

    /// Returns what the frames so far report about their events: how many they hold, and how many are late,
    /// filtered, dropped or thinned.
    fn counts(&self) -> FrameCounts;
}

/// An encoder and decoder of events, selected by name.
pub trait Operator: Send + Sync {
    /// Returns the operator's name, which its frames carry.
    fn name(&self) -> &'static str;

    /// Encodes all events of a live reader and returns what became of them. `put` receives each frame as soon as
    /// its window has ended.
    ///
    /// # Errors
    /// The reader fails, the job's options are invalid, or `put` returns an error.
    fn encode(
        &self,
        reader: Box<dyn EventReader>,
        job: &Job<'_>,
        put: &mut dyn FnMut(Encoded<'_>) -> Result<()>,
    ) -> Result<EncodeSummary>;

    /// Returns a new decoder, for the frames of one encoder, that refuses windows beyond `limit`.
    fn decoder(&self, limit: WindowLimit) -> Box<dyn Decoder>;
}

/// The known operators, the project's own first.
pub struct Operators(Vec<Box<dyn Operator>>);

impl Operators {
    /// Collects the project's own operator and `others`.
    #[must_use]
    pub fn new(others: Vec<Box<dyn Operator>>) -> Self {
        let mut all: Vec<Box<dyn Operator>> = vec![Box::new(Eecvs)];
        all.extend(others);
        Self(all)
    }

    /// Returns the first operator with this name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<&dyn Operator> {
        self.0
            .iter()
            .map(AsRef::as_ref)
            .find(|operator| operator.name() == name)
    }

    /// Returns the operators' names, separated by commas, for messages.
    #[must_use]
    pub fn names(&self) -> String {
        let names: Vec<&str> = self.0.iter().map(|operator| operator.name()).collect();
        names.join(", ")
    }
}

/// The project's own coders; their frames are defined in docs/wire-format.md.
#[derive(Debug, Clone, Copy, Default)]
pub struct Eecvs;

impl Operator for Eecvs {
    fn name(&self) -> &'static str {
        "eecvs"
    }

    fn encode(
        &self,
        reader: Box<dyn EventReader>,
        job: &Job<'_>,
        put: &mut dyn FnMut(Encoded<'_>) -> Result<()>,
    ) -> Result<EncodeSummary> {
        let config = job.codec.config(reader.sensor())?;
        let (mut reader, config) = job.codec.look(reader, config);
        let hot = job.codec.hot_pixels(reader.sensor())?;
        let codec = Codec {
            hot: &hot,
            max_nmse: job.codec.max_nmse(),
            ..Codec::from(config)
        };
        let mut frames = frames(put);
        let encoded = encode(
            reader.as_mut(),
            codec,
            job.limits,
            NonZeroUsize::MIN,
            &mut frames,
            &mut |_| {},
        );
        frames.finish(encoded.map_err(Into::into))
    }

    fn decoder(&self, limit: WindowLimit) -> Box<dyn Decoder> {
        Box::new(EecvsDecoder(Windows::new(limit)))
    }
}

/// Returns a sink that passes each frame to `put`.
pub fn frames<'p>(put: &'p mut dyn FnMut(Encoded<'_>) -> Result<()>) -> Frames<'p> {
    Frames { put, failed: None }
}

/// The sink returned by [`frames`].
pub struct Frames<'p> {
    put: &'p mut dyn FnMut(Encoded<'_>) -> Result<()>,
    failed: Option<anyhow::Error>,
}

impl Frames<'_> {
    /// Returns `written`, or the error of `put` if there was one, since that is the cause of a failed write.
    ///
    /// # Errors
    /// The error of `put`, else the error in `written`.
    pub fn finish<T>(self, written: Result<T>) -> Result<T> {
        self.failed.map_or(written, Err)
    }
}

impl FrameSink for Frames<'_> {
    fn frame(&mut self, header: &Header, bytes: &[u8]) -> io::Result<()> {
        let put = (self.put)(Encoded {
            span: Span {
                sensor: header.sensor,
                t0_us: header.t0_us,
                duration_us: header.duration_us,
            },
            events: header.events,
            begins_run: header.begins_run && header.part == 0,
            late: header.late,
            data: bytes,
        });
        put.map_err(|error| {
            self.failed = Some(error);
            io::Error::other("not published")
        })
    }
}

struct EecvsDecoder(Windows);

impl Decoder for EecvsDecoder {
    fn take(&mut self, frame: &crate::message::Frame, ready: Ready<'_>) -> Result<()> {
        let parsed = eecvs_nostd::Frame::parse(&frame.data);
        let parsed = parsed.map_err(|error| anyhow::anyhow!("{error}"))?;
        let taken = self
            .0
            .take(&parsed, |window| ready(Decoded::Window(window)));
        Ok(taken?)
    }

    fn end(&mut self, ready: Ready<'_>) {
        self.0
            .end()
            .map(Decoded::Window)
            .into_iter()
            .for_each(ready);
    }

    fn counts(&self) -> FrameCounts {
        self.0.counts()
    }
}

/// A coder of one window at a time.
pub trait WindowCoder: Send + Sync {
    /// Returns the coder's name, which its frames carry.
    fn name(&self) -> &'static str;

    /// Appends the encoded bytes of a window to `data`. All `events` lie in the window and on the sensor, in the
    /// order in which they arrived.
    fn encode(&self, span: Span, events: &[Event], data: &mut Vec<u8>);

    /// Returns the events encoded in `data`.
    ///
    /// # Errors
    /// `data` is not a valid encoding; the error says why.
    fn decode(&self, span: Span, data: &[u8]) -> Result<Vec<Event>>;
}

/// Operator made from a [`WindowCoder`]: cuts windows of `window_us`, aligned to the first event, and counts the
/// events.
pub struct Windowed<C>(pub std::sync::Arc<C>);

impl<C: WindowCoder + 'static> Windowed<C> {
    /// Makes an operator of a coder.
    pub fn new(coder: C) -> Self {
        Self(std::sync::Arc::new(coder))
    }
}

impl<C: WindowCoder + 'static> Operator for Windowed<C> {
    fn name(&self) -> &'static str {
        self.0.name()
    }

    fn encode(
        &self,
        mut reader: Box<dyn EventReader>,
        job: &Job<'_>,
        put: &mut dyn FnMut(Encoded<'_>) -> Result<()>,
    ) -> Result<EncodeSummary> {
        let window_us = job.codec.config(reader.sensor())?.window.window_us;
        let mut cut = WindowCut {
            coder: self.0.as_ref(),
            sensor: reader.sensor(),
            window_us,
            events_max: job.limits.window_events,
            t0_us: None,
            begins_run: false,
            events: Vec::new(),
            data: Vec::new(),
            summary: EncodeSummary::default(),
        };
        let mut events = Vec::new();
        loop {
            events.clear();
            let read = reader.read(&mut events)?;
            for event in &events {
                cut.push(*event, put)?;
            }
            match reader.pause() {
                _ if read > 0 => {}
                Pause::Ended => {
                    cut.close(put)?;
                    return Ok(cut.summary);
                }
                Pause::Until(now_us) => cut.pass(now_us, put)?,
            }
        }
    }

    fn decoder(&self, limit: WindowLimit) -> Box<dyn Decoder> {
        Box::new(WindowDecoder {
            limit,
            coder: std::sync::Arc::clone(&self.0),
            counts: FrameCounts::default(),
        })
    }
}

struct WindowCut<'c, C> {
    coder: &'c C,
    sensor: Sensor,
    window_us: u32,
    events_max: usize,
    /// Start of the open window; `None` before the first event.
    t0_us: Option<u64>,
    /// Whether the clock fell back before the open window.
    begins_run: bool,
    events: Vec<Event>,
    data: Vec<u8>,
    summary: EncodeSummary,
}

impl<C: WindowCoder> WindowCut<'_, C> {
    fn push(&mut self, event: Event, put: &mut dyn FnMut(Encoded<'_>) -> Result<()>) -> Result<()> {
        self.pass(event.t_us, put)?;
        if self.events.len() >= self.events_max {
            self.close(put)?;
        }
        self.summary.events_in += 1;
        if self.t0_us.is_some_and(|t0_us| event.t_us < t0_us) {
            // The clock fell back: a new run of windows begins.
            self.close(put)?;
            self.t0_us = None;
            self.begins_run = true;
            self.summary.runs += 1;
        }
        self.summary.runs = self.summary.runs.max(1);
        self.t0_us.get_or_insert(event.t_us);
        self.events.push(event);
        Ok(())
    }

    /// Closes the open window if it has ended by `now_us`.
    fn pass(&mut self, now_us: u64, put: &mut dyn FnMut(Encoded<'_>) -> Result<()>) -> Result<()> {
        let window_us = u64::from(self.window_us);
        let Some(t0_us) = self.t0_us else {
            return Ok(());
        };
        let passed = now_us.saturating_sub(t0_us) / window_us;
        if passed > 0 {
            self.close(put)?;
            self.t0_us = Some(t0_us + passed * window_us);
        }
        Ok(())
    }

    fn close(&mut self, put: &mut dyn FnMut(Encoded<'_>) -> Result<()>) -> Result<()> {
        let (Some(t0_us), false) = (self.t0_us, self.events.is_empty()) else {
            return Ok(());
        };
        let span = Span {
            sensor: self.sensor,
            t0_us,
            duration_us: self.window_us,
        };
        self.data.clear();
        self.coder.encode(span, &self.events, &mut self.data);
        let events = u32::try_from(self.events.len()).context("a window has too many events")?;
        self.events.clear();
        self.summary.windows += 1;
        self.summary.frames += 1;
        self.summary.events_encoded += u64::from(events);
        self.summary.bytes_out += self.data.len() as u64;
        put(Encoded {
            span,
            events,
            begins_run: std::mem::take(&mut self.begins_run),
            late: 0,
            data: &self.data,
        })
    }
}

struct WindowDecoder<C> {
    limit: WindowLimit,
    coder: std::sync::Arc<C>,
    counts: FrameCounts,
}

impl<C: WindowCoder> Decoder for WindowDecoder<C> {
    fn take(&mut self, frame: &crate::message::Frame, ready: Ready<'_>) -> Result<()> {
        let side = |side: u32| u16::try_from(side).ok();
        let sensor = side(frame.width)
            .zip(side(frame.height))
            .and_then(|(width, height)| Sensor::new(width, height))
            .with_context(|| {
                format!(
                    "{}x{} is not a valid sensor size",
                    frame.width, frame.height
                )
            })?;
        let span = Span {
            sensor,
            t0_us: frame.t0_us,
            duration_us: frame.duration_us,
        };
        anyhow::ensure!(
            u64::from(frame.events) <= self.limit.events_max(frame.duration_us),
            Refused::Crowded
        );
        let events = self.coder.decode(span, &frame.data)?;
        anyhow::ensure!(
            events.len() == frame.events as usize,
            "{} events were decoded, but the message states {}",
            events.len(),
            frame.events
        );
        let outside = events
            .iter()
            .find(|event| !sensor.contains(event.x, event.y));
        anyhow::ensure!(outside.is_none(), "an event is outside the sensor");
        self.counts.events_exact += events.len() as u64;
        ready(Decoded::Events(span, events));
        Ok(())
    }

    fn counts(&self) -> FrameCounts {
        self.counts
    }
}
