//! EECVS frames (`.eecvs`) read as a recording: their windows are decoded one after the other.
//!
//! A window's events come in order of time, or in their original order if it was sent (`--keep-order`). Times that
//! were coded within a tolerance or a bin, or that are solved for from coefficients, are the same as those of
//! `eecvs decode`. docs/wire-format.md describes the layout. The reader skips a damaged or missing frame, reads
//! the frames after it, and ends with an error that describes the damage; it counts what the encoder left out.
//!
//! Frames are recognised by their first bytes, or by the ending of the file's name, as damage may hide the first
//! bytes. The reader holds one window. It seeks where the file has an index. Only `eecvs encode` writes
//! frames, since encoding has many options.

use std::io::{Read, Seek};
use std::ops::Range;

use eecvs::decode::WindowReader;
use eecvs::frame_file::{FrameReader, LinkReport, mark};
use eecvs::reconstruct::DecodedWindow;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::reconstruct::recover::Confidences;
use eecvs_nostd::frame::SYNC;
use event_types::stream::{Context, Result};
use event_types::{Event, Sensor, bail};

pub use crate::format::FRAMES_ENDING as ENDING;
use crate::format::{FRAMES, FRAMES_MARK, FRAMES_SYNC, Format, Limits, Opening};
use crate::input::{Batch, Decode, ReadSeek, Reader};
use crate::{Reading, Skipped};

const _: () = assert!(FRAMES_SYNC[0] == SYNC[0] && FRAMES_SYNC[1] == SYNC[1]);
const _: () = assert!(FRAMES_MARK[0] == mark::SYNC[0] && FRAMES_MARK[1] == mark::SYNC[1]);

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: FRAMES,
    title: "EECVS frames",
    endings: &[ENDING],
    detect: |start| {
        start.begins(&FRAMES_SYNC) || start.begins(&FRAMES_MARK) || start.is_named(ENDING)
    },
    open: |opening| {
        let Opening {
            source,
            name,
            reading,
            ..
        } = opening;
        Ok(Box::new(FramesReader::new(source, name, &reading)?))
    },
    has_places: false,
    is_table: false,
    grows: false,
    streams: true,
    limits: Limits::NONE,
    create: None,
};

/// A reader of frames that returns their events window by window.
pub struct FrameEvents<R> {
    name: String,
    windows: WindowReader<R>,
    events: EventDecoder,
    confidences: Confidences,
    sensor: Sensor,
    /// The window that is returned next, if it was read ahead.
    ahead: Option<Ahead>,
}

/// A window that was read ahead, which may never be wanted.
struct Ahead {
    window: DecodedWindow,
    /// Confidence counts of its times; `None` until they are found.
    confidences: Option<Confidences>,
}

impl Ahead {
    const fn of(window: DecodedWindow) -> Self {
        Self {
            window,
            confidences: None,
        }
    }
}

impl<R: Read> FrameEvents<R> {
    /// Reads up to the first window with events, or to the end if there is none; windows have at most
    /// [`Reading::window_events_max`] events, and their times cost at most [`Reading::window_work_max`].
    ///
    /// # Errors
    /// I/O; there is no frame.
    pub fn new(source: R, name: &str, reading: &Reading) -> Result<Self> {
        let windows = WindowReader::new(FrameReader::new(source));
        let mut windows = windows.with_limit(reading.window_events_max.into());
        let events = EventDecoder::new(Finder::default());
        let events = events.with_work_limit(reading.window_work_max.into());
        let first = windows.next_window().with_context(|| name.to_owned())?;
        let Some(sensor) = windows.sensor() else {
            let why = windows.report().why_empty();
            bail!(Damaged, "{name}: byte 0: {why}");
        };
        Ok(Self {
            name: name.to_owned(),
            sensor,
            windows,
            events,
            confidences: Confidences::default(),
            ahead: first.map(Ahead::of),
        })
    }

    /// Returns the sensor's size, which is that of the first frame.
    #[must_use]
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the events of the window that was decoded ahead; empty if there is none.
    #[must_use]
    pub fn ahead(&mut self) -> &[Event] {
        let Some(ahead) = &mut self.ahead else {
            return &[];
        };
        if ahead.confidences.is_none() {
            ahead.confidences = Some(self.events.fill(&mut ahead.window));
        }
        &ahead.window.events
    }

    /// Continues with the windows between two times; see [`WindowReader::seek`]. Without an index, nothing changes.
    ///
    /// # Errors
    /// I/O.
    pub fn seek(&mut self, times: Range<u64>) -> Result<bool>
    where
        R: Seek,
    {
        let sought = self.windows.seek(times);
        let sought = sought.with_context(|| self.name.clone())?;
        if sought {
            self.ahead = None;
        }
        Ok(sought)
    }

    /// Returns the next window that has events, or `None` at the end.
    ///
    /// # Errors
    /// I/O.
    pub fn next_window(&mut self) -> Result<Option<DecodedWindow>> {
        loop {
            let next = match self.ahead.take() {
                None => {
                    let next = self.windows.next_window();
                    next.with_context(|| self.name.clone())?.map(Ahead::of)
                }
                ahead => ahead,
            };
            let Some(Ahead {
                mut window,
                confidences,
            }) = next
            else {
                return Ok(None);
            };
            let found = confidences.unwrap_or_else(|| self.events.fill(&mut window));
            self.confidences.add(found);
            if !window.events.is_empty() {
                return Ok(Some(window));
            }
        }
    }

    /// Takes back a window's memory, to be used for later windows.
    pub fn reuse(&mut self, window: DecodedWindow) {
        self.windows.reuse(window);
    }

    /// Returns the confidence counts of the times found so far.
    pub const fn confidences(&self) -> Confidences {
        self.confidences
    }

    /// Returns what was damaged or lost so far.
    pub const fn report(&self) -> &LinkReport {
        self.windows.report()
    }
}

/// A reader of EECVS frames.
pub type FramesReader = Reader<FramesDecoder>;

impl FramesReader {
    /// Reads frames from `source`, which messages call `name`.
    ///
    /// # Errors
    /// Those of [`FrameEvents::new`].
    pub fn new(mut source: Box<dyn ReadSeek>, name: &str, reading: &Reading) -> Result<Self> {
        source.rewind().with_context(|| name.to_owned())?;
        Ok(Self::around(FramesDecoder {
            frames: FrameEvents::new(source, name, reading)?,
            window: None,
            given: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// The decoder of [`FramesReader`]: its state between two batches.
pub struct FramesDecoder {
    frames: FrameEvents<Box<dyn ReadSeek>>,
    /// The window whose events are being returned.
    window: Option<DecodedWindow>,
    /// Number of its events that have been returned.
    given: usize,
    skipped: Skipped,
}

impl FramesDecoder {
    fn go(&mut self, times: Range<u64>) -> Result<bool> {
        let sought = self.frames.seek(times)?;
        if sought {
            self.window = None;
        }
        Ok(sought)
    }

    /// Counts what the encoder left out, and returns an error if frames were damaged or lost.
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
        self.skipped.add(
            "pixels of rough times, beyond --max-work-per-window",
            self.frames.confidences.pixels_over_work_limit,
        );
        let report = windows.report();
        for (kind, frames) in [
            ("frames before the first one", report.frames_before),
            ("frames that came twice", report.frames_repeated),
            ("frames out of order, used", report.frames_reordered),
            ("new beginnings of the frames' numbers", report.restarts),
            ("frames without an end mark, used", report.frames_unmarked),
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

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        self.go(t_us..self.frames.windows.times().end)
    }

    fn end_at(&mut self, t_us: u64) -> Result<bool> {
        self.go(self.frames.windows.times().start..t_us)
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
