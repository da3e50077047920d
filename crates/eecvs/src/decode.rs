//! Decodes frames to windows and events.

use std::collections::VecDeque;
use std::io::{Read, Seek};
use std::time::{Duration, Instant};

use eecvs_nostd::{Event, Frame, Header, Mode, Sensor};
use event_types::stream::{Context, Error, EventWriter, Result};
use serde::Serialize;

use crate::frame_file::{FrameReader, LinkReport, Times, is_before_end};
use crate::reconstruct::arrival::Arrivals;
use crate::reconstruct::coefficients::CoefficientDecoder;
use crate::reconstruct::events::EventDecoder;
use crate::reconstruct::hybrid::{HybridDecoder, Refused};
use crate::reconstruct::recover::Confidences;
use crate::reconstruct::{DecodedWindow, Pixel, pixels};
use crate::window_limit::WindowLimit;

/// Reads the windows of a stream of frames, one at a time.
pub struct WindowReader<R> {
    frames: FrameReader<R>,
    windows: Windows,
    /// Complete windows that have not been taken yet: at most two.
    ready: VecDeque<DecodedWindow>,
    /// Windows outside of these times are left out.
    times: Times,
    /// Frames of windows that are left out; they are not even decoded unless a later frame depends on them. `None`
    /// before [`WindowReader::seek`].
    held: Option<Held>,
    /// Time spent on decoding payloads.
    busy: Duration,
}

/// Assembles windows from their frames as the frames arrive.
#[derive(Default)]
pub struct Windows {
    limit: WindowLimit,
    pending: Option<DecodedWindow>,
    /// Events received for `pending`.
    pending_events: u32,
    counts: FrameCounts,
    coefficients: CoefficientDecoder,
    hybrid: HybridDecoder,
    arrivals: Arrivals,
}

/// Event counts from the frame headers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    /// Runs of windows: 1, plus 1 for each time the clock fell back.
    pub runs: u64,
    /// Events that were too old for their window.
    pub events_late: u64,
    /// Events removed by a filter.
    pub events_filtered: u64,
    /// Events lost before or in the encoder.
    pub events_dropped: u64,
    /// Events left out by the rate control.
    pub events_thinned: u64,
    /// Events in frames, at their exact times.
    pub events_exact: u64,
    /// Events in frames, at times within a tolerance or a bin, or as coefficients.
    pub events_approximate: u64,
    /// Windows whose events of equal time are in the order in which they arrived.
    pub windows_in_order: u64,
    /// Windows whose arrival order was sent but cannot be decoded, because one of their frames is missing.
    pub windows_order_lost: u64,
}

impl<R: Read> WindowReader<R> {
    /// Creates a reader for the windows of `frames`.
    pub fn new(frames: FrameReader<R>) -> Self {
        Self {
            frames,
            windows: Windows::default(),
            ready: VecDeque::new(),
            times: 0..u64::MAX,
            held: None,
            busy: Duration::ZERO,
        }
    }

    /// Sets the largest number of events of a window; frames of windows with more are counted and skipped.
    #[must_use]
    pub fn with_limit(mut self, limit: WindowLimit) -> Self {
        self.windows.limit = limit;
        self
    }

    /// Leaves out windows outside of these times.
    #[must_use]
    pub fn within(mut self, times: Times) -> Self {
        self.times = times;
        self
    }

    /// Returns the times whose events are wanted: all, unless [`WindowReader::within`] or [`WindowReader::seek`] chose
    /// some.
    pub const fn times(&self) -> &Times {
        &self.times
    }

    /// Returns the report on the frames so far.
    pub const fn report(&self) -> &LinkReport {
        self.frames.report()
    }

    /// Returns the sensor's size, which the first frame states; `None` before it.
    pub const fn sensor(&self) -> Option<Sensor> {
        self.frames.sensor()
    }

    /// Returns the event counts from the frame headers so far.
    pub const fn counts(&self) -> FrameCounts {
        self.windows.counts()
    }

    /// Returns the number of bytes read so far, up to the end of the last frame.
    pub const fn offset(&self) -> u64 {
        self.frames.offset()
    }

    /// Takes back the memory of a window, to reuse it for later windows.
    pub fn reuse(&mut self, window: DecodedWindow) {
        self.windows.reuse(window);
    }

    /// Reads the next window that has events; returns `None` at the end.
    ///
    /// # Errors
    /// Only I/O errors. A frame that does not decode is counted and skipped.
    pub fn next_window(&mut self) -> Result<Option<DecodedWindow>> {
        loop {
            if let Some(window) = self.ready.pop_front() {
                if overlaps(&self.times, &window.header) {
                    return Ok(Some(window));
                }
                self.windows.reuse(window);
                continue;
            }
            let Some(located) = self.frames.next_frame().context("reading frames")? else {
                let last = self.windows.end();
                return Ok(last.filter(|window| overlaps(&self.times, &window.header)));
            };
            let frame = located.frame;
            let mut due = None;
            if let Some(held) = &mut self.held {
                if frame.header.is_key {
                    held.clear();
                }
                if !overlaps(&self.times, &frame.header) && held.hold(&frame) {
                    continue;
                }
                due = Some(held);
            }
            let started = Instant::now();
            let before = due.iter().flat_map(|held| held.frames());
            let mut refused = Vec::new();
            for frame in before.chain([frame]) {
                let ready = |window| self.ready.push_back(window);
                refused.extend(self.windows.take(&frame, ready).err());
            }
            if let Some(held) = due {
                held.clear();
            }
            self.busy += started.elapsed();
            for refused in refused {
                self.frames.count_refused(refused);
            }
        }
    }
}

/// Frames that are decoded only if a later one depends on them.
#[derive(Debug, Default)]
struct Held {
    /// Headers, and the lengths of payloads and of whole frames.
    frames: Vec<(Header, usize, usize)>,
    /// The payloads, one after the other.
    payloads: Vec<u8>,
}

impl Held {
    /// Largest number of bytes of payloads, and of frames; where more lie between two key frames, all are decoded.
    const BYTES_MAX: usize = 1 << 24;
    const FRAMES_MAX: usize = 1 << 12;

    fn clear(&mut self) {
        self.frames.clear();
        self.payloads.clear();
    }

    /// Keeps a copy of a frame; returns false, and keeps none, if there is no room.
    fn hold(&mut self, frame: &Frame<'_>) -> bool {
        let length = frame.payload.len();
        let has_room = self.frames.len() < Self::FRAMES_MAX
            && length <= Self::BYTES_MAX.saturating_sub(self.payloads.len());
        if has_room {
            self.frames.push((frame.header, length, frame.bytes));
            self.payloads.extend_from_slice(frame.payload);
        }
        has_room
    }

    /// Returns the frames in their order.
    fn frames(&self) -> impl Iterator<Item = Frame<'_>> {
        let mut rest = self.payloads.as_slice();
        self.frames.iter().map(move |(header, length, bytes)| {
            let (payload, after) = rest.split_at_checked(*length).unwrap_or_default();
            rest = after;
            Frame {
                header: *header,
                payload,
                bytes: *bytes,
            }
        })
    }
}

/// Returns whether a window has some of these times.
fn overlaps(times: &Times, header: &Header) -> bool {
    let end_us = header.t0_us.saturating_add(header.duration_us.into());
    is_before_end(times, header.t0_us) && end_us > times.start
}

impl<R: Read + Seek> WindowReader<R> {
    /// Continues with the windows between two times, if the source has an index, and leaves out all others: their frames
    /// are not read where the index says so, and otherwise neither decoded nor counted, unless a frame of these times
    /// depends on them. Returns false, and changes nothing, without an index.
    ///
    /// # Errors
    /// I/O.
    pub fn seek(&mut self, times: Times) -> Result<bool> {
        let sought = self.frames.seek(&times).context("reading the index")?;
        if sought {
            self.windows = Windows::new(self.windows.limit);
            self.ready.clear();
            self.held = Some(Held::default());
            self.times = times;
        }
        Ok(sought)
    }
}

impl Windows {
    /// Creates an assembler of windows of at most as many events as `limit` allows.
    #[must_use]
    pub fn new(limit: WindowLimit) -> Self {
        Self {
            limit,
            ..Self::default()
        }
    }

    /// Returns the event counts from the frame headers so far.
    #[must_use]
    pub const fn counts(&self) -> FrameCounts {
        let order = self.arrivals.counts();
        FrameCounts {
            windows_in_order: order.kept,
            windows_order_lost: order.lost,
            ..self.counts
        }
    }

    /// Returns the number of events received for a window that is not complete yet.
    #[must_use]
    pub const fn pending_events(&self) -> u64 {
        match &self.pending {
            Some(_) => self.pending_events as u64,
            None => 0,
        }
    }

    /// Takes back the memory of a window, to reuse it for later windows.
    pub fn reuse(&mut self, window: DecodedWindow) {
        self.hybrid.reuse(window.events);
    }

    /// Decodes the next frame; `ready` is called with each window with events that this frame completes or ends.
    ///
    /// # Errors
    /// [`Refused`] if the frame does not decode; it is then skipped.
    pub fn take(
        &mut self,
        frame: &Frame<'_>,
        mut ready: impl FnMut(DecodedWindow),
    ) -> Result<(), Refused> {
        let header = frame.header;
        if u64::from(header.window_events) > self.limit.events_max(header.duration_us) {
            return Err(Refused::Crowded);
        }
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
        let decoded = decoded.and_then(|(pixels, events)| {
            let limit = self.limit.pixel_events_max(header.duration_us);
            let is_crowded = u64::from(header.events) > limit
                && if header.mode.takes_arrival() {
                    has_crowded_pixel(header.sensor, &events, limit)
                } else {
                    most_of_a_pixel(&pixels, &events) > limit
                };
            if is_crowded {
                return Err(Refused::Crowded);
            }
            Ok((pixels, events))
        });
        // A limit on malicious input: frames that claim to be parts of one window must not exceed its number of
        // events.
        let mut window = self.pending.as_mut().filter(|window| {
            window.has_part(&header) && header.events <= header.window_events - self.pending_events
        });
        // The arrival order covers the whole window, so the events of the earlier parts go in front.
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

    /// Ends the stream, or a stretch of it after which the frames do not continue; returns the incomplete window,
    /// if any.
    pub fn end(&mut self) -> Option<DecodedWindow> {
        self.arrivals.end();
        self.pending.take()
    }
}

/// Returns the largest number of events of one pixel in a frame; its events are in raster order.
fn most_of_a_pixel(pixels: &[Pixel], events: &[Event]) -> u64 {
    let counts = pixels
        .iter()
        .map(|pixel| u64::from(pixel.on) + u64::from(pixel.off));
    let runs = events.chunk_by(|a, b| (a.x, a.y) == (b.x, b.y));
    let runs = runs.map(|run| run.len() as u64);
    counts.chain(runs).max().unwrap_or_default()
}

/// Returns whether a pixel has more than `limit` of a frame's events, which come in any order.
fn has_crowded_pixel(sensor: Sensor, events: &[Event], limit: u64) -> bool {
    let limit = u32::try_from(limit).unwrap_or(u32::MAX);
    // Counters of groups of pixels stay in the first-level cache. Only where a group has as many is each pixel counted.
    let mut groups = [0_u32; 1 << 12];
    for event in events {
        let group = usize::from(event.y).wrapping_mul(67) ^ usize::from(event.x);
        groups[group & 0xFFF] += 1;
    }
    if groups.iter().all(|count| *count <= limit) {
        return false;
    }
    let mut counts = vec![0_u32; sensor.pixels() as usize];
    for event in events {
        if let Some(count) = counts.get_mut(sensor.number((event.x, event.y)) as usize) {
            *count += 1;
        }
    }
    counts.iter().any(|count| *count > limit)
}

/// Counts and times of a decoding run, as `eecvs decode` reports them; the fields are the JSON keys.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct DecodeSummary {
    /// Windows decoded.
    pub windows: u64,
    /// Events decoded.
    pub events: u64,
    /// Event counts from the frame headers.
    #[serde(flatten)]
    pub counts: FrameCounts,
    /// Confidence of the times of pixels sent as coefficients.
    #[serde(flatten)]
    pub confidences: Confidences,
    /// Damage and losses of the link.
    #[serde(flatten)]
    pub link: LinkReport,
    /// Seconds spent decoding, without reading and writing.
    pub decode_s: f64,
    /// `events` / `decode_s`; 0 without events.
    pub events_per_s: f64,
}

/// Decodes all windows to events and writes them.
///
/// `create` opens the output once the sensor is known, even if no frame has events; if it returns `None`, no events are recovered or written.
/// `each` is called with the index and the decoded content of every window, before event times are solved for.
/// `progress` is called with the number of events so far. `events` recovers the events of each window.
///
/// # Errors
/// Fails if reading or writing fails, and with the errors of `create` and `each`.
pub fn decode<R: Read, E: From<Error>>(
    windows: &mut WindowReader<R>,
    mut events: EventDecoder,
    create: &mut dyn FnMut(Sensor) -> Result<Option<Box<dyn EventWriter>>, E>,
    each: &mut dyn FnMut(u64, &DecodedWindow) -> Result<(), E>,
    progress: &mut dyn FnMut(u64),
) -> Result<DecodeSummary, E> {
    let mut summary = DecodeSummary::default();
    let mut decoding = Duration::ZERO;
    let mut writer: Option<Option<Box<dyn EventWriter>>> = None;
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
            let times = windows.times();
            window
                .events
                .retain(|event| event.t_us >= times.start && is_before_end(times, event.t_us));
            decoding += started.elapsed();
            output.write(&window.events)?;
            summary.events += window.events.len() as u64;
        }
        progress(summary.events);
        windows.reuse(window);
    }
    // Frames without events are those of a recording without events.
    if let (None, Some(sensor)) = (&writer, windows.sensor()) {
        writer = Some(create(sensor)?);
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
