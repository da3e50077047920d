//! Decodes the frames of the encoder into events.
//!
//! Events come window by window, ordered by time, with the last frame of each window. If frames hold coefficients,
//! the events have the times that [`EventDecoder`] finds. A frame that is damaged, lost or refused costs only its
//! own events, but with the dense coder also those of the frames up to the next key frame. A frame may hold more
//! events than its bytes suggest, but never more than a sensor sends, see
//! [`eecvs::window_limit`].

use eecvs::decode::Windows;
use eecvs::frame_file::{FrameOrder, LinkReport};
use eecvs::reconstruct::DecodedWindow;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::reconstruct::recover::Confidences;
use eecvs_nostd::event_link::Kind;
use eecvs_nostd::{Event, Sensor};
use event_files::Skipped;

use super::messages::{FRAME_BYTES_MAX, Message, Messages};
use crate::device::Parse;

/// Parser of an encoder's stream.
pub struct McuParser {
    /// The largest sensor that frames may have.
    largest: Sensor,
    /// Sensor of the first frame.
    sensor: Option<Sensor>,
    messages: Messages,
    order: FrameOrder,
    report: LinkReport,
    windows: Windows,
    ready: Vec<DecodedWindow>,
    /// Events found at a break, which the next call returns.
    late: Vec<Event>,
    decoder: EventDecoder,
    confidences: Confidences,
    time_us: Option<u64>,
    events: u64,
    statuses: u64,
    packets: u64,
    other_sensors: u64,
}

impl McuParser {
    /// Starts at the beginning of a stream of frames, of a sensor of at most this size.
    #[must_use]
    pub fn new(largest: Sensor) -> Self {
        Self {
            largest,
            sensor: None,
            messages: Messages::default(),
            order: FrameOrder::default(),
            report: LinkReport::default(),
            windows: Windows::default(),
            ready: Vec::new(),
            late: Vec::new(),
            decoder: EventDecoder::new(Finder::Exact),
            confidences: Confidences::default(),
            time_us: None,
            events: 0,
            statuses: 0,
            packets: 0,
            other_sensors: 0,
        }
    }

    fn take(&mut self, events: &mut Vec<Event>) {
        while let Some(message) = self.messages.next() {
            let (frame, crc) = match message {
                Message::Frame { frame, crc, .. } => (frame, crc),
                Message::Packet(Kind::Status) => {
                    self.statuses += 1;
                    continue;
                }
                Message::Packet(_) => {
                    self.packets += 1;
                    continue;
                }
            };
            let header = &frame.header;
            if !self.order.take(header, crc, &mut self.report) {
                continue;
            }
            let Sensor { width, height } = self.sensor.unwrap_or(self.largest);
            let is_known = match self.sensor {
                Some(sensor) => header.sensor == sensor,
                None => header.sensor.width <= width && header.sensor.height <= height,
            };
            if !is_known {
                self.other_sensors += 1;
                continue;
            }
            self.sensor = Some(header.sensor);
            let end_us = header.t0_us.saturating_add(u64::from(header.duration_us));
            match self.windows.take(&frame, |window| self.ready.push(window)) {
                Ok(()) => self.time_us = self.time_us.max(Some(end_us)),
                Err(refused) => self.report.count_refused(refused),
            }
            for mut window in self.ready.drain(..) {
                self.confidences.add(self.decoder.fill(&mut window));
                self.events += window.events.len() as u64;
                events.extend_from_slice(&window.events);
                self.windows.reuse(window);
            }
        }
    }
}

impl Parse for McuParser {
    fn sensor(&self) -> Sensor {
        self.sensor.unwrap_or(self.largest)
    }

    fn parse(&mut self, bytes: &[u8], events: &mut Vec<Event>) {
        events.append(&mut self.late);
        for piece in bytes.chunks(FRAME_BYTES_MAX) {
            self.messages.push(piece);
            self.take(events);
        }
    }

    fn resume(&mut self, _: Option<u64>) {
        // There may be whole frames within the bytes of the incomplete one.
        let mut late = std::mem::take(&mut self.late);
        while self.messages.has_begun() {
            self.messages.give_up();
            self.take(&mut late);
        }
        self.late = late;
    }

    fn time_us(&self) -> Option<u64> {
        self.time_us
    }

    fn events(&self) -> u64 {
        self.events
    }

    fn words(&self) -> Skipped {
        let mut words = Skipped::default();
        for (name, count) in [
            ("frames", self.report.frames),
            ("frames out of order", self.report.frames_reordered),
            ("new beginnings of the numbering", self.report.restarts),
            ("packets of status", self.statuses),
            ("other packets", self.packets),
            (
                "pixels of rough times, since finding them is too much work",
                self.confidences.pixels_over_work_limit,
            ),
        ] {
            words.add(name, count);
        }
        words
    }

    fn losses(&self) -> Skipped {
        let mut losses = Skipped::default();
        let (damaged_bytes, damaged_runs) = self.messages.damaged();
        let counts = self.windows.counts();
        for (name, count) in [
            ("damaged bytes", damaged_bytes),
            ("damaged places", damaged_runs),
            ("frames lost", self.report.frames_lost),
            ("frames that came twice", self.report.frames_repeated),
            ("frames malformed", self.report.frames_malformed),
            (
                "frames without those they go on from",
                self.report.frames_dependent,
            ),
            (
                "frames with more events than a sensor sends",
                self.report.frames_crowded,
            ),
            (
                "frames without memory to decode them",
                self.report.frames_without_memory,
            ),
            ("frames of another sensor", self.other_sensors),
            ("events too late for their window", counts.events_late),
            ("events filtered by the encoder", counts.events_filtered),
            ("events dropped by the encoder", counts.events_dropped),
            ("events left out for the rate", counts.events_thinned),
            ("windows whose order is lost", counts.windows_order_lost),
            (
                "events of a window that has not ended",
                self.windows.pending_events(),
            ),
        ] {
            losses.add(name, count);
        }
        losses
    }
}
