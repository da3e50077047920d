//! Frames (`.eecvs`) as a recording: their windows, decoded, one after the other.
//!
//! A window's events come in order of time, or in the order in which they came where that was sent
//! (`--keep-order`); times within a tolerance or a bin, or solved for from coefficients, are as good as
//! `eecvs decode` makes them. The layout is docs/wire-format.md's. A damaged or missing frame is left out, those
//! behind it are read, and the end is an error that says what was met; what the encoder left out is counted.
//!
//! Frames are told by their first bytes, or by their name's ending, as damage may hide what they begin with. The
//! reader holds a window. It does not seek: a frame goes on from those before it. Frames are written by
//! `eecvs encode` alone, which has much to ask.

use std::io::Read;

use eecvs::decode::{WindowEvents, WindowReader};
use eecvs::frame_file::{FrameReader, LinkReport};
use eecvs::reconstruct::DecodedWindow;
use eecvs::reconstruct::events::Finder;
use eecvs_nostd::frame::SYNC;
use event_types::stream::{Context, Result};
use event_types::{Event, Sensor, bail};

use crate::Skipped;
pub use crate::format::FRAMES_ENDING as ENDING;
use crate::format::{FRAMES, FRAMES_SYNC, Format, Limits, Opening};
use crate::input::{Batch, Decode, ReadSeek, Reader};

const _: () = assert!(FRAMES_SYNC[0] == SYNC[0] && FRAMES_SYNC[1] == SYNC[1]);

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: FRAMES,
    title: "EECVS frames",
    endings: &[ENDING],
    detect: |start| start.begins(&FRAMES_SYNC) || start.is_named(ENDING),
    open: |Opening { source, name, .. }| Ok(Box::new(FramesReader::new(source, name)?)),
    has_places: false,
    is_table: false,
    grows: false,
    streams: true,
    limits: Limits::NONE,
    create: None,
};

/// Events of the windows of frames, a window at a time.
pub struct FrameEvents<R> {
    name: String,
    windows: WindowReader<R>,
    events: WindowEvents,
    sensor: Sensor,
    /// Decoded, to be given next.
    ahead: Option<DecodedWindow>,
}

impl<R: Read> FrameEvents<R> {
    /// Reads up to the first window with events.
    ///
    /// # Errors
    /// I/O; no frame, no window with events.
    pub fn new(source: R, name: &str) -> Result<Self> {
        let mut windows = WindowReader::new(FrameReader::new(source));
        let mut events = WindowEvents::new(Finder::default());
        let mut first = windows.next_window().with_context(|| name.to_owned())?;
        let Some(window) = &mut first else {
            if windows.report().frames == 0 {
                bail!(
                    Damaged,
                    "{name}: byte 0: no frame found; is it a file that `eecvs encode` wrote?"
                );
            }
            bail!(Damaged, "{name}: byte 0: no window with events");
        };
        events.fill(window);
        Ok(Self {
            name: name.to_owned(),
            sensor: window.header.sensor,
            windows,
            events,
            ahead: first,
        })
    }

    /// Size of the sensor.
    #[must_use]
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// The events that come next, of one window or none.
    #[must_use]
    pub fn ahead(&self) -> &[Event] {
        self.ahead
            .as_ref()
            .map_or(&[], |window| window.events.as_slice())
    }

    /// The next window, with its events, which are some; `None` at the end.
    ///
    /// # Errors
    /// I/O.
    pub fn next_window(&mut self) -> Result<Option<DecodedWindow>> {
        let name = &self.name;
        let window = loop {
            if let Some(window) = self.ahead.take_if(|window| !window.events.is_empty()) {
                break window;
            }
            let next = self.windows.next_window();
            let Some(mut window) = next.with_context(|| name.clone())? else {
                return Ok(None);
            };
            self.events.fill(&mut window);
            self.ahead = Some(window);
        };
        Ok(Some(window))
    }

    /// Takes a window's memory back, for those to come.
    pub fn reuse(&mut self, window: DecodedWindow) {
        self.windows.reuse(window);
    }

    /// What was damaged or lost so far.
    pub const fn report(&self) -> &LinkReport {
        self.windows.report()
    }
}

/// Reader of frames.
pub type FramesReader = Reader<FramesDecoder>;

impl FramesReader {
    /// Reads `source`, which messages call `name`.
    ///
    /// # Errors
    /// As [`FrameEvents::new`].
    pub fn new(mut source: Box<dyn ReadSeek>, name: &str) -> Result<Self> {
        source.rewind().with_context(|| name.to_owned())?;
        Ok(Self::around(FramesDecoder {
            frames: FrameEvents::new(source, name)?,
            window: None,
            given: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// State between two batches.
pub struct FramesDecoder {
    frames: FrameEvents<Box<dyn ReadSeek>>,
    /// Being given.
    window: Option<DecodedWindow>,
    /// Events of it that were.
    given: usize,
    skipped: Skipped,
}

impl FramesDecoder {
    /// What the encoder left out, and an error where frames were damaged or lost.
    fn end(&mut self) -> Result<()> {
        let windows = &self.frames.windows;
        let counts = windows.counts();
        self.skipped = Skipped::default();
        for (kind, events) in [
            ("events late at the encoder", counts.events_late),
            ("events filtered", counts.events_filtered),
            ("events dropped", counts.events_dropped),
            ("events left out by the rate control", counts.events_thinned),
        ] {
            self.skipped.add(kind, events);
        }
        let report = windows.report();
        for (kind, frames) in [
            ("frames before the first one", report.frames_before),
            ("frames that came twice", report.frames_repeated),
            ("frames out of order, used", report.frames_reordered),
            ("new beginnings of the frames' numbers", report.restarts),
        ] {
            self.skipped.add(kind, frames);
        }
        let Some(warning) = report.warning().filter(|_| report.has_loss()) else {
            return Ok(());
        };
        let first = report.first_damage.as_ref();
        let first = first.or(report.other_sensor.as_ref());
        let at = first.map_or(windows.offset(), |(offset, _)| *offset);
        bail!(Damaged, "{}: byte {at}: {warning}", self.frames.name)
    }
}

impl Decode for FramesDecoder {
    fn format(&self) -> &'static str {
        FORMAT.name
    }

    fn sensor(&self) -> Sensor {
        self.frames.sensor
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        while batch.room() > 0 {
            let Some(window) = &self.window else {
                self.given = 0;
                self.window = self.frames.next_window()?;
                if self.window.is_none() {
                    return self.end();
                }
                continue;
            };
            let rest = window.events.get(self.given..).unwrap_or_default();
            let part = rest.get(..batch.room()).unwrap_or(rest);
            batch.extend(part.iter().copied());
            self.given += part.len();
            if part.len() == rest.len()
                && let Some(window) = self.window.take()
            {
                self.frames.reuse(window);
            }
        }
        Ok(())
    }
}
