//! Frames back to windows and events.

use std::collections::VecDeque;
use std::io::Read;
use std::time::{Duration, Instant};

use eecvs_nostd::{Frame, Header, Mode, Sensor};
use event_types::stream::{Context, Error, EventWriter, Result};
use serde::Serialize;

use crate::frame_file::{FrameReader, LinkReport};
use crate::reconstruct::arrival::Arrivals;
use crate::reconstruct::coefficients::CoefficientDecoder;
use crate::reconstruct::events::{EventDecoder, Finder};
use crate::reconstruct::hybrid::{HybridDecoder, Refused};
use crate::reconstruct::order::ByTime;
use crate::reconstruct::recover::Confidences;
use crate::reconstruct::{DecodedWindow, pixels};

/// Reads the windows of a stream of frames, one at a time.
pub struct WindowReader<R> {
    frames: FrameReader<R>,
    windows: Windows,
    /// Windows that are whole and were not taken yet: two at the most.
    ready: VecDeque<DecodedWindow>,
    /// Time spent on payloads.
    busy: Duration,
}

/// Puts windows together from their frames, as these come.
#[derive(Default)]
pub struct Windows {
    pending: Option<DecodedWindow>,
    /// Events of `pending`.
    pending_events: u32,
    counts: FrameCounts,
    coefficients: CoefficientDecoder,
    hybrid: HybridDecoder,
    arrivals: Arrivals,
}

/// What the frames say of the events.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    /// Runs of windows: 1, and 1 for each time that the clock fell back.
    pub runs: u64,
    /// Too old for their window.
    pub events_late: u64,
    /// Kept out by a filter.
    pub events_filtered: u64,
    /// Lost before or in the encoder.
    pub events_dropped: u64,
    /// Left out so that the frames fit their budget.
    pub events_thinned: u64,
    /// In frames, at their exact times.
    pub events_exact: u64,
    /// In frames, at times within a tolerance or a bin, or in coefficients.
    pub events_approximate: u64,
    /// Windows whose events of equal time are in the order in which they came.
    pub windows_in_order: u64,
    /// Windows whose order was sent but cannot be told, as a frame of theirs is missing.
    pub windows_order_lost: u64,
}

impl<R: Read> WindowReader<R> {
    /// Windows of `frames`.
    pub fn new(frames: FrameReader<R>) -> Self {
        Self {
            frames,
            windows: Windows::default(),
            ready: VecDeque::new(),
            busy: Duration::ZERO,
        }
    }

    /// The account of the frames so far.
    pub const fn report(&self) -> &LinkReport {
        self.frames.report()
    }

    /// The frames' own counts so far.
    pub const fn counts(&self) -> FrameCounts {
        self.windows.counts()
    }

    /// Bytes read so far, up to the end of the last frame.
    pub const fn offset(&self) -> u64 {
        self.frames.offset()
    }

    /// Takes a window's memory back, for those to come.
    pub fn reuse(&mut self, window: DecodedWindow) {
        self.windows.reuse(window);
    }

    /// The next window that has events, or `None` at the end.
    ///
    /// # Errors
    /// Only I/O. A frame that does not decode is counted and left out.
    pub fn next_window(&mut self) -> Result<Option<DecodedWindow>> {
        loop {
            if let Some(window) = self.ready.pop_front() {
                return Ok(Some(window));
            }
            let Some(located) = self.frames.next_frame().context("reading frames")? else {
                return Ok(self.windows.end());
            };
            let started = Instant::now();
            let taken = self
                .windows
                .take(&located.frame, |window| self.ready.push_back(window));
            self.busy += started.elapsed();
            if let Err(refused) = taken {
                self.frames.count_refused(refused);
            }
        }
    }
}

impl Windows {
    /// The frames' own counts so far.
    #[must_use]
    pub const fn counts(&self) -> FrameCounts {
        let order = self.arrivals.counts();
        FrameCounts {
            windows_in_order: order.kept,
            windows_order_lost: order.lost,
            ..self.counts
        }
    }

    /// Events that came of a window whose end has not.
    #[must_use]
    pub const fn pending_events(&self) -> u64 {
        match &self.pending {
            Some(_) => self.pending_events as u64,
            None => 0,
        }
    }

    /// Takes a window's memory back, for those to come.
    pub fn reuse(&mut self, window: DecodedWindow) {
        self.hybrid.reuse(window.events);
    }

    /// Takes the next frame; `ready` gets the windows with events that end before or with it.
    ///
    /// # Errors
    /// [`Refused`]: it does not decode, and is left out.
    pub fn take(
        &mut self,
        frame: &Frame<'_>,
        mut ready: impl FnMut(DecodedWindow),
    ) -> Result<(), Refused> {
        let header = frame.header;
        let decoded = match header.mode {
            Mode::Transform => match pixels(frame) {
                Ok(pixels) => Ok((pixels, vec![])),
                Err(_) => Err(Refused::Malformed),
            },
            Mode::Coefficients(coder) => {
                let pixels = self.coefficients.frame(frame, coder);
                pixels.map(|pixels| (pixels, vec![]))
            }
            Mode::Hybrid(hybrid) => {
                let events = self.hybrid.frame(frame, hybrid);
                events.map(|events| (vec![], events))
            }
        };
        // Frames without end that call themselves parts of one window do not grow it.
        let mut window = self.pending.as_mut().filter(|window| {
            window.has_part(&header) && header.events <= header.window_events - self.pending_events
        });
        // With the events of the parts before in front of them.
        let decoded = decoded.and_then(|(pixels, mut events)| {
            let mut earlier = 0;
            if let Some(window) = &mut window {
                earlier = window.events.len();
                window.events.append(&mut events);
                std::mem::swap(&mut window.events, &mut events);
            }
            let ordered = self.arrivals.frame(frame, &mut events);
            if let Some(window) = window
                && ordered.is_err()
            {
                events.truncate(earlier);
                window.events = events;
                return Err(Refused::Malformed);
            }
            ordered.map(|()| (pixels, events))
        });
        let (pixels, events) = decoded?;
        self.counts.runs +=
            u64::from(header.part == 0 && header.begins_run || self.counts.runs == 0);
        self.counts.events_late += u64::from(header.late);
        self.counts.events_filtered += u64::from(header.filtered);
        self.counts.events_dropped += u64::from(header.dropped);
        self.counts.events_thinned += u64::from(header.thinned);
        if header.mode.is_lossless() {
            self.counts.events_exact += u64::from(header.events);
        } else {
            self.counts.events_approximate += u64::from(header.events);
        }
        match &mut self.pending {
            Some(window)
                if window.has_part(&header)
                    && header.events <= header.window_events - self.pending_events =>
            {
                self.pending_events += header.events;
                window.pixels.extend(pixels);
                window.events = events;
            }
            _ => {
                self.pending_events = header.events;
                let window = (header.events > 0).then_some(DecodedWindow {
                    header,
                    pixels,
                    events,
                });
                let before = std::mem::replace(&mut self.pending, window);
                before.into_iter().for_each(&mut ready);
            }
        }
        if header.last {
            self.pending.take().into_iter().for_each(ready);
        }
        Ok(())
    }

    /// No further frame comes, or those that come do not go on from the last one: the window whose end
    /// has not come.
    pub fn end(&mut self) -> Option<DecodedWindow> {
        self.arrivals.end();
        self.pending.take()
    }
}

/// Finds the events of windows, whichever way they came.
#[derive(Debug)]
pub struct WindowEvents {
    finder: Finder,
    /// Tables that fitted the last window of coefficients.
    decoder: Option<EventDecoder>,
    by_time: ByTime,
}

impl WindowEvents {
    /// `finder` is for windows of coefficients.
    #[must_use]
    pub fn new(finder: Finder) -> Self {
        Self {
            finder,
            decoder: None,
            by_time: ByTime::default(),
        }
    }

    /// Leaves the window's events in it, in order of time; how sure the times are that were solved for.
    pub fn fill(&mut self, window: &mut DecodedWindow) -> Confidences {
        if !window.events.is_empty() {
            self.by_time.sort(&window.header, &mut window.events);
            return Confidences::default();
        }
        let decoder = match &mut self.decoder {
            Some(decoder) if decoder.fits(window) => decoder,
            _ => {
                let Header {
                    transform, grid, m, ..
                } = window.header;
                self.decoder
                    .insert(EventDecoder::new(transform, grid, m, self.finder))
            }
        };
        let confidences;
        (window.events, confidences) = decoder.window_with_confidence(window);
        confidences
    }
}

/// What `eecvs decode` reports; the fields are its JSON keys.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct DecodeSummary {
    /// Windows decoded.
    pub windows: u64,
    /// Events decoded.
    pub events: u64,
    /// What the frames say of other events.
    #[serde(flatten)]
    pub counts: FrameCounts,
    /// How sure the times are of pixels that came as coefficients.
    #[serde(flatten)]
    pub confidences: Confidences,
    /// What was damaged or lost.
    #[serde(flatten)]
    pub link: LinkReport,
    /// Seconds spent decoding; reading and writing excluded.
    pub decode_s: f64,
    /// `events` / `decode_s`; 0 without events.
    pub events_per_s: f64,
}

/// Decodes windows into events; `create` opens the output once the sensor is known, `each` sees
/// every window, and `progress` gets the events so far. `finder` is for windows of coefficients.
///
/// # Errors
/// Reading or writing, and those of `create` and `each`.
pub fn decode<R: Read, E: From<Error>>(
    windows: &mut WindowReader<R>,
    finder: Finder,
    create: &mut dyn FnMut(Sensor) -> Result<Option<Box<dyn EventWriter>>, E>,
    each: &mut dyn FnMut(u64, &DecodedWindow) -> Result<(), E>,
    progress: &mut dyn FnMut(u64),
) -> Result<DecodeSummary, E> {
    let mut summary = DecodeSummary::default();
    let mut decoding = Duration::ZERO;
    let mut writer: Option<Option<Box<dyn EventWriter>>> = None;
    let mut events = WindowEvents::new(finder);
    while let Some(mut window) = windows.next_window()? {
        each(summary.windows, &window)?;
        let output = match &mut writer {
            Some(output) => output,
            None => writer.insert(create(window.header.sensor)?),
        };
        summary.windows += 1;
        if let Some(output) = output {
            let started = Instant::now();
            summary.confidences.add(events.fill(&mut window));
            decoding += started.elapsed();
            output.write(&window.events)?;
            summary.events += window.events.len() as u64;
        }
        progress(summary.events);
        windows.reuse(window);
    }
    if let Some(output) = writer.flatten() {
        output.finish()?;
    }
    decoding += windows.busy;
    summary.counts = windows.counts();
    summary.link = windows.report().clone();
    summary.decode_s = decoding.as_secs_f64();
    if summary.events > 0 {
        summary.events_per_s = summary.events as f64 / summary.decode_s.max(1e-9);
    }
    Ok(summary)
}
