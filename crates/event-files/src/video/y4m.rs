//! YUV4MPEG2 (`.y4m`), as `ffmpeg -f yuv4mpegpipe` writes it.
//!
//! A header is a line, `YUV4MPEG2` and parameters: `W` and `H` the size, `F` the rate as a ratio, `I` the interlacing, `C`
//! the chroma and the bits, `X` anything; unknown ones are passed over. A frame is a line, `FRAME` and parameters, then the
//! planes: luma, two of chroma, and perhaps alpha. Planes have 8 bits a pixel, or 9 to 16 in two bytes, the low one first.
//! Luma alone is used.
//!
//! The format is described in mjpegtools' yuv4mpeg(5); `p10` and the like, `mono10` and `XCOLORRANGE` are ffmpeg's.
//! Interlaced video is refused: half of the rows would be of another time.

use std::io::{BufRead, Read};

use event_types::stream::{Context, Error, Response, Result};
use event_types::{Sensor, error};

use super::raw_gray::numbers;
use super::{Fps, Frames, Taken, VideoReading, fill, size_of};
use crate::Assumption;

/// First bytes of every file.
pub(super) const MAGIC: &[u8] = b"YUV4MPEG2 ";

/// Longest line of a header or before a frame, in bytes.
const LINE_MAX: u64 = 1 << 12;

/// The planes after the luma.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Chroma {
    /// Columns and rows of luma for a sample of chroma; `None` for gray.
    per_sample: Option<(u64, u64)>,
    /// Whether a plane of alpha follows.
    has_alpha: bool,
    bits: u32,
}

impl Chroma {
    /// Parses the value of the parameter `C`.
    fn parse(name: &str) -> Option<Self> {
        let of = |per_sample, bits| Self {
            per_sample,
            has_alpha: false,
            bits,
        };
        if let Some(bits) = name.strip_prefix("mono") {
            let bits = if bits.is_empty() { 8 } else { deep(bits)? };
            return Some(of(None, bits));
        }
        let (layout, bits) = match name.split_once('p') {
            // The siting of chroma, not its bits.
            Some(("420", "aldv")) => ("420", 8),
            Some(("420j", "eg")) => ("420", 8),
            Some(("420m", "eg2")) => ("420", 8),
            Some((layout, bits)) if name != "444alpha" => (layout, deep(bits)?),
            _ => (name, 8),
        };
        let chroma = match layout {
            "420" => of(Some((2, 2)), bits),
            "411" => of(Some((4, 1)), bits),
            "410" => of(Some((4, 4)), bits),
            "422" => of(Some((2, 1)), bits),
            "440" => of(Some((1, 2)), bits),
            "444" => of(Some((1, 1)), bits),
            "444alpha" => Self {
                has_alpha: true,
                ..of(Some((1, 1)), 8)
            },
            _ => return None,
        };
        Some(chroma)
    }

    /// Returns the samples of a frame after its luma.
    fn samples(self, sensor: Sensor) -> u64 {
        let (width, height) = (u64::from(sensor.width), u64::from(sensor.height));
        let chroma = self
            .per_sample
            .map_or(0, |(x, y)| 2 * width.div_ceil(x) * height.div_ceil(y));
        chroma + if self.has_alpha { width * height } else { 0 }
    }
}

/// Parses the bits of a deep format.
fn deep(bits: &str) -> Option<u32> {
    bits.parse().ok().filter(|bits| (9..=16).contains(bits))
}

/// A reader of YUV4MPEG2.
pub(super) struct Y4m {
    source: Box<dyn BufRead + Send>,
    name: String,
    sensor: Sensor,
    chroma: Chroma,
    rate: Option<Fps>,
    /// What black is, and what one less than white is divided by.
    black: f32,
    scale: f32,
    assumptions: Vec<Assumption>,
    luma: Vec<u8>,
    /// Offset of the next byte, and of the latest frame.
    offset: u64,
    begun: u64,
    frames: u64,
}

impl Y4m {
    pub(super) fn new(
        source: Box<dyn BufRead + Send>,
        name: &str,
        reading: &VideoReading,
    ) -> Result<Self> {
        let mut video = Self {
            source,
            name: name.to_owned(),
            sensor: Sensor {
                width: 0,
                height: 0,
            },
            chroma: Chroma {
                per_sample: None,
                has_alpha: false,
                bits: 8,
            },
            rate: None,
            black: 0.0,
            scale: 1.0,
            assumptions: Vec::new(),
            luma: Vec::new(),
            offset: 0,
            begun: 0,
            frames: 0,
        };
        let line = video.line()?.unwrap_or_default();
        video
            .parse(&line, reading)
            .map_err(|what| video.error(&what))?;
        let bytes = video.sensor.pixels() as usize * video.sample_bytes() as usize;
        video.luma.resize(bytes, 0);
        Ok(video)
    }

    /// Returns whether the header states a frame rate.
    pub(super) fn has_rate(&self) -> bool {
        self.rate.is_some()
    }

    fn parse(&mut self, header: &str, reading: &VideoReading) -> Result<(), String> {
        let (mut width, mut height) = (None, None);
        let mut chroma = "420jpeg";
        let mut interlacing = '?';
        let mut stated_range = None;
        for parameter in header.split_ascii_whitespace().skip(1) {
            let Some((key, value)) = parameter.split_at_checked(1) else {
                continue;
            };
            let number = || {
                value
                    .parse::<u64>()
                    .map_err(|_| format!("{parameter} is no size"))
            };
            match key {
                "W" => width = Some(number()?),
                "H" => height = Some(number()?),
                "F" => self.rate = rate(value)?,
                "I" => interlacing = value.chars().next().unwrap_or('?'),
                "C" => chroma = value,
                "X" if value == "COLORRANGE=FULL" => stated_range = Some(true),
                "X" if value == "COLORRANGE=LIMITED" => stated_range = Some(false),
                _ => {}
            }
        }
        let (Some(width), Some(height)) = (width, height) else {
            return Err("the header states no size (W and H): damaged".to_owned());
        };
        self.sensor = size_of(width, height)?;
        self.chroma = Chroma::parse(chroma).ok_or_else(|| {
            format!("chroma {chroma} is not known: convert it, as by ffmpeg -pix_fmt yuv420p")
        })?;
        match interlacing {
            'p' => {}
            '?' => self.assumptions.push(Assumption {
                what: "interlacing",
                taken: "progressive".to_owned(),
                why: "the header does not say; ffmpeg -vf yadif makes interlaced video progressive"
                    .to_owned(),
            }),
            _ => return Err(interlaced()),
        }
        let is_gray = self.chroma.per_sample.is_none();
        let full = reading.full_range.or(stated_range).unwrap_or(is_gray);
        if reading.full_range.or(stated_range).is_none() && reading.white.is_none() {
            let (taken, other) = match full {
                true => ("full", "limited"),
                false => ("limited", "full"),
            };
            self.assumptions.push(Assumption {
                what: "range of the luma",
                taken: taken.to_owned(),
                why: format!("the header does not say; --luma-range {other} is the other one"),
            });
        }
        // ITU-R BT.601 and BT.709: black is 16 and white 235 of 8 bits.
        let unit = f64::from(1_u32 << (self.chroma.bits - 8));
        let most = f64::from((1_u32 << self.chroma.bits) - 1);
        let (black, white) = match (reading.white, full) {
            (Some(white), _) => (0.0, white),
            (None, true) => (0.0, most),
            (None, false) => (16.0 * unit, 235.0 * unit),
        };
        self.black = black as f32;
        self.scale = (1.0 / (white - black)) as f32;
        Ok(())
    }

    fn sample_bytes(&self) -> u64 {
        if self.chroma.bits > 8 { 2 } else { 1 }
    }

    /// Reads a line without its line feed; `None` at the end.
    fn line(&mut self) -> Result<Option<String>> {
        let mut line = Vec::new();
        let read = self
            .source
            .by_ref()
            .take(LINE_MAX)
            .read_until(b'\n', &mut line);
        let read = read.with_context(|| self.unread())?;
        if read == 0 {
            return Ok(None);
        }
        if line.pop() != Some(b'\n') {
            return Err(
                self.error("the line before the pixels does not end: the input is damaged or cut")
            );
        }
        self.offset += read as u64;
        Ok(Some(String::from_utf8_lossy(&line).into_owned()))
    }

    fn unread(&self) -> String {
        format!("{}: byte {}: cannot be read", self.name, self.offset)
    }

    fn error(&self, what: &str) -> Error {
        error!(Damaged, "{}: byte {}: {what}", self.name, self.offset)
    }

    fn cut(&self, got: u64, of: u64) -> Error {
        let what = format!(
            "frame {} ends after {got} of {of} bytes: the input is cut",
            self.frames
        );
        self.error(&what)
    }
}

fn interlaced() -> String {
    "the video is interlaced: half of its rows are of another time: make it progressive first, as by ffmpeg -vf yadif"
        .to_owned()
}

/// Parses the value of the parameter `F`; 0:0 says that the rate is not known.
fn rate(value: &str) -> Result<Option<Fps>, String> {
    if value == "0:0" {
        return Ok(None);
    }
    let (frames, seconds) = value.split_once(':').unwrap_or((value, "1"));
    let parsed = frames.parse().ok().zip(seconds.parse().ok());
    let rate = parsed.and_then(|(frames, seconds)| Fps::new(frames, seconds));
    rate.map(Some)
        .ok_or_else(|| format!("F{value} is no frame rate: give --fps"))
}

impl Frames for Y4m {
    fn format(&self) -> &'static str {
        "y4m"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn response(&self) -> Response {
        Response::Srgb
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.assumptions
    }

    fn next(&mut self, values: &mut Vec<f32>) -> Result<Option<Taken>> {
        self.begun = self.offset;
        let Some(line) = self.line()? else {
            return Ok(None);
        };
        let mut words = line.split_ascii_whitespace();
        if words.next() != Some("FRAME") {
            self.offset = self.begun;
            let what = format!(
                "no FRAME where frame {} should begin: the input is damaged",
                self.frames
            );
            return Err(self.error(&what));
        }
        // A frame of a mixed video says of itself how it is; its first letter is t, T, b or B where it is interlaced.
        if words.any(|word| word.starts_with("It") || word.starts_with("Ib")) {
            return Err(self.error(&interlaced()));
        }
        let mut luma = std::mem::take(&mut self.luma);
        let got = fill(&mut self.source, &mut luma);
        self.luma = luma;
        let got = got.with_context(|| self.unread())? as u64;
        let (of_luma, rest) = (
            self.luma.len() as u64,
            self.chroma.samples(self.sensor) * self.sample_bytes(),
        );
        self.offset += got;
        if got < of_luma {
            return Err(self.cut(got, of_luma + rest));
        }
        let mut others = self.source.by_ref().take(rest);
        let passed = std::io::copy(&mut others, &mut std::io::sink());
        let passed = passed.with_context(|| self.unread())?;
        self.offset += passed;
        if passed < rest {
            return Err(self.cut(got + passed, of_luma + rest));
        }
        numbers(&self.luma, self.chroma.bits > 8, 1.0, values);
        let (black, scale) = (self.black, self.scale);
        for value in values.iter_mut() {
            // Below black there are overshoots only.
            *value = ((*value - black) * scale).max(0.0);
        }
        let t_us = self.rate.and_then(|rate| rate.time_us(self.frames));
        self.frames += 1;
        Ok(Some(Taken { t_us }))
    }

    fn place(&self) -> String {
        format!("{}: byte {}", self.name, self.begun)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_chroma_has_its_planes() {
        let sensor = Sensor {
            width: 5,
            height: 3,
        };
        for (name, bits, samples) in [
            ("420", 8, 12),
            ("420jpeg", 8, 12),
            ("420mpeg2", 8, 12),
            ("420paldv", 8, 12),
            ("420p10", 10, 12),
            ("420p16", 16, 12),
            ("411", 8, 12),
            ("410", 8, 4),
            ("422", 8, 18),
            ("422p12", 12, 18),
            ("440", 8, 20),
            ("444", 8, 30),
            ("444p9", 9, 30),
            ("444alpha", 8, 45),
            ("mono", 8, 0),
            ("mono16", 16, 0),
        ] {
            let chroma = Chroma::parse(name).unwrap_or_else(|| panic!("{name}"));
            assert_eq!(
                (chroma.bits, chroma.samples(sensor)),
                (bits, samples),
                "{name}"
            );
        }
        for bad in ["", "420p8", "420p17", "mono7", "rgb", "p", "444p", "420pal"] {
            assert_eq!(Chroma::parse(bad), None, "{bad}");
        }
    }
}
