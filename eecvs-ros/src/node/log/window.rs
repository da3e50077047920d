//! A window whose frames come, and what they tell of it.

use eecvs::reconstruct::{DecodedWindow, same_window};
use eecvs_nostd::{Density, Fidelity, Header, Mode};

use crate::message::{Frame, Time};
use crate::operator::{Eecvs, Operator as _};

/// A frame that has been decoded.
pub struct Told<'f> {
    frame: &'f Frame,
    operator: &'static str,
    /// What a frame of docs/wire-format.md tells.
    header: Option<Header>,
}

impl<'f> Told<'f> {
    /// What a frame of an operator tells.
    pub fn new(frame: &'f Frame, operator: &'static str) -> Self {
        let is_ours = operator == Eecvs.name();
        let parsed = is_ours.then(|| eecvs_nostd::Frame::parse(&frame.data).ok());
        Self {
            frame,
            operator,
            header: parsed.flatten().map(|parsed| parsed.header),
        }
    }

    /// Whether no further frame of its window follows; of another operator's nothing tells it.
    pub fn is_last(&self) -> bool {
        self.header.is_some_and(|header| header.last)
    }

    fn events(&self) -> u32 {
        self.header
            .map_or(self.frame.events, |header| header.events)
    }
}

/// What the frames of a window that came tell.
#[derive(Debug)]
pub struct Window {
    /// Of the first frame.
    pub header: Option<Header>,
    /// Of the latest frame.
    pub seq: u64,
    /// Of the latest frame.
    pub stamp: Time,
    /// Start of the window.
    pub t0_us: u64,
    /// Its duration.
    pub duration_us: u32,
    /// Columns of the sensor.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// What encoded it.
    pub operator: &'static str,
    /// Events in the frames.
    pub events: u64,
    /// Frames.
    pub frames: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Coefficients, where these came in place of events.
    pub coefficients: Option<u64>,
    /// Pixels that have some.
    pub coefficient_pixels: Option<u64>,
    /// Counts of the frames.
    pub late: Option<u64>,
    /// Counts of the frames.
    pub filtered: Option<u64>,
    /// Counts of the frames.
    pub dropped: Option<u64>,
    /// Counts of the frames.
    pub thinned: Option<u64>,
}

impl Window {
    /// A window that begins with a frame, which is to be added.
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

    /// Whether a frame is another part of this window, as the decoder puts windows together.
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

    /// Adds a frame.
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

    /// Adds what was decoded of it; the number of coefficients.
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

    /// N_w: the events that the encoder had in it.
    pub fn window_events(&self) -> u64 {
        self.header
            .map_or(self.events, |header| header.window_events.into())
    }

    /// Events per pixel and second.
    pub fn density(&self) -> Option<f64> {
        let density = Density {
            events: u32::try_from(self.window_events()).ok()?,
            pixels: self.width.checked_mul(self.height)?,
            duration_us: self.duration_us,
        };
        Some(density.per_pixel_s()).filter(|density| density.is_finite())
    }

    /// As `encode --mode` is called.
    pub fn mode(&self) -> Option<&'static str> {
        let is_transform = self.header?.mode.is_transform();
        Some(if is_transform { "transform" } else { "hybrid" })
    }

    /// How events or coefficients became bits.
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

    /// Of events, by how much their times may be off; 0: lossless.
    pub fn time_tolerance_us(&self) -> Option<u32> {
        match self.fidelity()? {
            Fidelity::Lossless => Some(0),
            Fidelity::ToleranceUs(tolerance_us) => Some(tolerance_us),
            Fidelity::Bins(_) => None,
        }
    }

    /// Of events, the bins whose volume alone is exact.
    pub fn bins(&self) -> Option<u32> {
        match self.fidelity()? {
            Fidelity::Bins(bins) => Some(bins.into()),
            Fidelity::Lossless | Fidelity::ToleranceUs(_) => None,
        }
    }

    /// The quantiser's step.
    pub fn step(&self) -> Option<f64> {
        Some(f64::from(self.header?.quantiser.step_log2()).exp2())
    }
}
