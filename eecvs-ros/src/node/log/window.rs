//! A window assembled from the frames that arrive.

use eecvs::reconstruct::{DecodedWindow, same_window};
use eecvs_nostd::{Density, Fidelity, Header, Mode};

use crate::message::{Frame, Time};
use crate::operator::{Eecvs, Operator as _};

/// A decoded frame, with its parsed header.
pub struct Told<'f> {
    frame: &'f Frame,
    operator: &'static str,
    /// Header of a frame of docs/wire-format.md; `None` for another operator's frame.
    header: Option<Header>,
}

impl<'f> Told<'f> {
    /// Parses a frame of an operator.
    pub fn new(frame: &'f Frame, operator: &'static str) -> Self {
        let is_ours = operator == Eecvs.name();
        let parsed = is_ours.then(|| eecvs_nostd::Frame::parse(&frame.data).ok());
        Self {
            frame,
            operator,
            header: parsed.flatten().map(|parsed| parsed.header),
        }
    }

    /// Returns whether this is the last frame of its window; false for other operators, whose frames do not show
    /// it.
    pub fn is_last(&self) -> bool {
        self.header.is_some_and(|header| header.last)
    }

    fn events(&self) -> u32 {
        self.header
            .map_or(self.frame.events, |header| header.events)
    }
}

/// What the received frames of a window report.
#[derive(Debug)]
pub struct Window {
    /// Header of the first frame, if it is the project's own.
    pub header: Option<Header>,
    /// Sequence number of the latest frame.
    pub seq: u64,
    /// Stamp of the latest frame.
    pub stamp: Time,
    /// Start of the window in microseconds.
    pub t0_us: u64,
    /// Duration of the window in microseconds.
    pub duration_us: u32,
    /// Columns of the sensor.
    pub width: u32,
    /// Rows of the sensor.
    pub height: u32,
    /// Name of the operator that encoded the window.
    pub operator: &'static str,
    /// Events in the frames received.
    pub events: u64,
    /// Number of frames received.
    pub frames: u64,
    /// Bytes of the frames received.
    pub bytes: u64,
    /// Coefficients, if the window was sent as coefficients.
    pub coefficients: Option<u64>,
    /// Pixels that have coefficients.
    pub coefficient_pixels: Option<u64>,
    /// Late events, as counted by the frames.
    pub late: Option<u64>,
    /// Filtered events, as counted by the frames.
    pub filtered: Option<u64>,
    /// Dropped events, as counted by the frames.
    pub dropped: Option<u64>,
    /// Thinned events, as counted by the frames.
    pub thinned: Option<u64>,
}

impl Window {
    /// Creates the window that begins with a frame; the frame is still to be added.
    pub fn new(first: &Told<'_>) -> Self {
        let frame = first.frame;
        let header = first.header;
        let none = header.map(|_| 0);
        let is_transform = header.is_some_and(|header| header.mode.is_transform());
        Self {
            header,
            seq: frame.seq,
            stamp: frame.header.stamp,
            t0_us: header.map_or(frame.t0_us, |header| header.t0_us),
            duration_us: header.map_or(frame.duration_us, |header| header.duration_us),
            width: header.map_or(frame.width, |header| header.sensor.width.into()),
            height: header.map_or(frame.height, |header| header.sensor.height.into()),
            operator: first.operator,
            events: 0,
            frames: 0,
            bytes: 0,
            coefficients: is_transform.then_some(0),
            coefficient_pixels: is_transform.then_some(0),
            late: none,
            filtered: none,
            dropped: none,
            thinned: none,
        }
    }

    /// Returns whether a frame is another part of this window, by the rules of the decoder.
    pub fn has_part(&self, told: &Told<'_>) -> bool {
        match (&self.header, &told.header) {
            (Some(first), Some(header)) => {
                let events = self.events + u64::from(header.events);
                same_window(first, header) && events <= u64::from(header.window_events)
            }
            (None, None) => {
                let frame = told.frame;
                let span = (frame.t0_us, frame.duration_us, frame.width, frame.height);
                self.operator == told.operator
                    && span == (self.t0_us, self.duration_us, self.width, self.height)
            }
            _ => false,
        }
    }

    /// Adds a received frame to the window's counts.
    pub fn add(&mut self, told: &Told<'_>) {
        self.seq = told.frame.seq;
        self.stamp = told.frame.header.stamp;
        self.events += u64::from(told.events());
        self.frames += 1;
        self.bytes += told.frame.data.len() as u64;
        if let Some(header) = &told.header {
            for (sum, count) in [
                (&mut self.late, header.late),
                (&mut self.filtered, header.filtered),
                (&mut self.dropped, header.dropped),
                (&mut self.thinned, header.thinned),
            ] {
                *sum = sum.map(|sum| sum + u64::from(count));
            }
        }
    }

    /// Adds the counts of the decoded window; returns its number of coefficients.
    pub fn add_decoded(&mut self, decoded: &DecodedWindow) -> u64 {
        if !decoded.header.mode.is_transform() {
            return 0;
        }
        let counts = decoded.pixels.iter().map(|pixel| pixel.coefficients.len());
        let pixels = counts.clone().filter(|count| *count > 0).count() as u64;
        let coefficients = counts.sum::<usize>() as u64;
        *self.coefficients.get_or_insert(0) += coefficients;
        *self.coefficient_pixels.get_or_insert(0) += pixels;
        coefficients
    }

    /// Returns N_w, the number of events in the encoder's window.
    pub fn window_events(&self) -> u64 {
        self.header
            .map_or(self.events, |header| header.window_events.into())
    }

    /// Returns the events per pixel and second.
    pub fn density(&self) -> Option<f64> {
        let density = Density {
            events: u32::try_from(self.window_events()).ok()?,
            pixels: self.width.checked_mul(self.height)?,
            duration_us: self.duration_us,
        };
        Some(density.per_pixel_s()).filter(|density| density.is_finite())
    }

    /// Returns the name of the mode, as `encode --mode` takes it.
    pub fn mode(&self) -> Option<&'static str> {
        let is_transform = self.header?.mode.is_transform();
        Some(if is_transform { "transform" } else { "hybrid" })
    }

    /// Returns the name of the coder that turned events or coefficients into bits.
    pub fn coder(&self) -> Option<&'static str> {
        match self.header?.mode {
            Mode::Transform => Some("plain"),
            Mode::Coefficients(coder) => Some(coder.name()),
            Mode::Hybrid(hybrid) => Some(hybrid.coder.name()),
        }
    }

    fn fidelity(&self) -> Option<Fidelity> {
        match self.header?.mode {
            Mode::Hybrid(hybrid) => Some(hybrid.fidelity),
            Mode::Transform | Mode::Coefficients(_) => None,
        }
    }

    /// For a window sent as events: how far event times may be off, in microseconds; 0 if lossless.
    pub fn time_tolerance_us(&self) -> Option<u32> {
        self.fidelity()?.within_us()
    }

    /// For a window sent as events: the number of time bins, if only the volume of the bins is exact.
    pub fn bins(&self) -> Option<u32> {
        match self.fidelity()? {
            Fidelity::Bins(bins) => Some(bins.into()),
            Fidelity::Lossless | Fidelity::ToleranceUs(_) | Fidelity::SpreadUs(_) => None,
        }
    }

    /// Returns the step of the quantiser.
    pub fn step(&self) -> Option<f64> {
        Some(f64::from(self.header?.quantiser.step_log2()).exp2())
    }
}
