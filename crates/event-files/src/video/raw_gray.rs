//! Gray pixels without a header, one frame after the other.

use std::io::Read;

use event_types::stream::{Context, Response, Result};
use event_types::{Sensor, ensure, error};

use super::{Frames, Taken, fill};

/// The layout of gray pixels without a header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RawGray {
    /// Columns and rows.
    pub sensor: Sensor,
    /// Whether a pixel has 16 bits, the low byte first (ffmpeg's `gray16le`), and not 8 (`gray`).
    pub wide: bool,
}

impl RawGray {
    fn frame_bytes(self) -> usize {
        self.sensor.pixels() as usize * if self.wide { 2 } else { 1 }
    }
}

/// A reader of gray pixels.
pub(super) struct RawFrames {
    source: Box<dyn Read + Send>,
    name: String,
    layout: RawGray,
    scale: f32,
    bytes: Vec<u8>,
    /// Offset of the next frame and number of frames read.
    offset: u64,
    frames: u64,
}

impl RawFrames {
    pub(super) fn new(
        source: Box<dyn Read + Send>,
        name: &str,
        layout: RawGray,
        white: Option<f64>,
    ) -> Result<Self> {
        let Sensor { width, height } = layout.sensor;
        ensure!(
            Sensor::new(width, height).is_some(),
            Refused,
            "{name}: frames of {width} x {height} pixels; give sides of 1 to {}",
            Sensor::SIDE_MAX
        );
        let white = white.unwrap_or(if layout.wide { 65_535.0 } else { 255.0 });
        Ok(Self {
            source,
            name: name.to_owned(),
            layout,
            scale: (1.0 / white) as f32,
            bytes: vec![0; layout.frame_bytes()],
            offset: 0,
            frames: 0,
        })
    }
}

impl Frames for RawFrames {
    fn format(&self) -> &'static str {
        "raw-gray"
    }

    fn sensor(&self) -> Sensor {
        self.layout.sensor
    }

    fn response(&self) -> Response {
        Response::Srgb
    }

    fn next(&mut self, values: &mut Vec<f32>) -> Result<Option<Taken>> {
        let got = fill(&mut self.source, &mut self.bytes)
            .with_context(|| format!("{}: byte {}: cannot be read", self.name, self.offset))?;
        if got == 0 {
            return Ok(None);
        }
        if got < self.bytes.len() {
            let Sensor { width, height } = self.layout.sensor;
            return Err(error!(
                Damaged,
                "{}: byte {}: frame {} ends after {got} of {} bytes: the input is cut, or its frames are not {width} x \
                 {height} pixels of {} bits",
                self.name,
                self.offset + got as u64,
                self.frames,
                self.bytes.len(),
                if self.layout.wide { 16 } else { 8 }
            ));
        }
        numbers(&self.bytes, self.layout.wide, self.scale, values);
        self.offset += got as u64;
        self.frames += 1;
        Ok(Some(Taken { t_us: None }))
    }

    fn place(&self) -> String {
        let begun = self.offset.saturating_sub(self.bytes.len() as u64);
        format!("{}: byte {begun}", self.name)
    }
}

/// Replaces `values` by the numbers of `bytes`, 8 bits each or 16 with the low byte first, times `scale`.
pub(crate) fn numbers(bytes: &[u8], wide: bool, scale: f32, values: &mut Vec<f32>) {
    values.clear();
    if wide {
        let (pairs, _) = bytes.as_chunks::<2>();
        let number = |pair: &[u8; 2]| f32::from(u16::from_le_bytes(*pair)) * scale;
        values.extend(pairs.iter().map(number));
    } else {
        values.extend(bytes.iter().map(|byte| f32::from(*byte) * scale));
    }
}
