//! Reads the frames of a ROS bag: messages `sensor_msgs/Image`.
//!
//! A message is a header, uint32 height, uint32 width, string encoding, uint8 `is_bigendian`, uint32 step, `uint8[]` data.
//! A frame's time is its header's stamp. Gray pixels have 8 or 16 bits (`mono8`, `8UC1`, `mono16`, `16UC1`); of colours
//! (`rgb8`, `bgr8`, `rgba8`, `bgra8`), the luma of BT.709 is taken. Others, pixels behind colour filters among them, are
//! refused.

use std::fs::File;
use std::path::Path;

use event_types::stream::{Context, Response, Result};
use event_types::{Sensor, bail, ensure};

use super::decoder::{Messages, Unpacked};
use super::fields::{Fields, Serialisation};
use super::topics::Topics;
use super::{bag, db3, folder, mcap};
use crate::Skipped;
use crate::video::{Frames, Taken, size_of};

/// Weights of red, green and blue in the luma of BT.709.
const LUMA: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// A reader of the images of one topic.
pub(crate) struct Images {
    messages: Box<dyn Messages>,
    topics: Topics,
    name: String,
    sensor: Sensor,
    message: Vec<u8>,
    skipped: Skipped,
    /// The first frame, which is read ahead for its size.
    ahead: Option<(Vec<f32>, u64)>,
    frames: u64,
}

/// Where an encoding has which colour.
#[derive(Debug, Clone, Copy)]
struct Layout {
    /// Bytes of a pixel.
    bytes: usize,
    /// Places of red, green and blue; `None` for gray.
    colors: Option<[usize; 3]>,
}

impl Layout {
    fn of(encoding: &str) -> Option<Self> {
        let (bytes, colors) = match encoding {
            "mono8" | "8UC1" => (1, None),
            "mono16" | "16UC1" => (2, None),
            "rgb8" => (3, Some([0, 1, 2])),
            "bgr8" => (3, Some([2, 1, 0])),
            "rgba8" => (4, Some([0, 1, 2])),
            "bgra8" => (4, Some([2, 1, 0])),
            _ => return None,
        };
        Some(Self { bytes, colors })
    }

    /// Returns a pixel's number, white being 1.
    fn number(self, pixel: &[u8], big_endian: bool) -> f32 {
        let part = |place: usize| pixel.get(place).copied().unwrap_or(0);
        match (self.colors, self.bytes) {
            (Some(places), _) => {
                let parts = LUMA.iter().zip(places);
                let luma = parts.map(|(weight, place)| weight * f32::from(part(place)));
                luma.sum::<f32>() / 255.0
            }
            (None, 2) => {
                let pair = [part(0), part(1)];
                let number = if big_endian {
                    u16::from_be_bytes(pair)
                } else {
                    u16::from_le_bytes(pair)
                };
                f32::from(number) / 65_535.0
            }
            (None, _) => f32::from(part(0)) / 255.0,
        }
    }
}

impl Images {
    /// Reads a bag in one file.
    ///
    /// # Errors
    /// The file is no bag, or has no images on the topic `place`, or on any.
    pub(crate) fn file(path: &Path, place: Option<&str>) -> Result<Self> {
        let name = path.display().to_string();
        let mut start = [0; 16];
        let mut file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
        let got = crate::video::fill(&mut file, &mut start);
        let got = got.with_context(|| format!("{name}: cannot be read"))?;
        let start = start.get(..got).unwrap_or_default();
        let messages: Box<dyn Messages> = if start.starts_with(bag::MAGIC) {
            Box::new(bag::Bag::new(Box::new(file), &name)?)
        } else if start.starts_with(mcap::MAGIC) {
            Box::new(mcap::Mcap::new(Box::new(file), &name)?)
        } else {
            Box::new(db3::Database::new(path, &name)?)
        };
        Self::new(messages, name, place)
    }

    /// Reads a bag of ROS 2 in a folder.
    ///
    /// # Errors
    /// As [`Self::file`].
    pub(crate) fn folder(path: &Path, place: Option<&str>) -> Result<Self> {
        Self::new(folder::messages(path)?, path.display().to_string(), place)
    }

    fn new(messages: Box<dyn Messages>, name: String, place: Option<&str>) -> Result<Self> {
        let mut images = Self {
            messages: Box::new(Unpacked(messages)),
            topics: Topics::of_images(place),
            name,
            sensor: Sensor {
                width: 0,
                height: 0,
            },
            message: Vec::new(),
            skipped: Skipped::default(),
            ahead: None,
            frames: 0,
        };
        let mut values = Vec::new();
        let Some((sensor, t_us)) = images.read(&mut values)? else {
            bail!(
                Refused,
                "{}: no images (sensor_msgs/Image){}: name a topic of images after the file, as in FILE.bag/davis/image_raw",
                images.name,
                place.map_or(String::new(), |place| format!(" on the topic {place}"))
            );
        };
        images.sensor = sensor;
        images.ahead = Some((values, t_us));
        images.frames = 0;
        Ok(images)
    }

    /// Reads the next image; returns its size and time.
    fn read(&mut self, values: &mut Vec<f32>) -> Result<Option<(Sensor, u64)>> {
        let next = self
            .messages
            .next(&mut self.message, &mut self.topics, &mut self.skipped)?;
        let Some((_, serialisation)) = next else {
            return Ok(None);
        };
        let read = image(&self.message, serialisation, values);
        let read = read.map_err(|(at, what)| self.messages.error(at, &what))?;
        self.frames += 1;
        Ok(Some(read))
    }
}

/// Reads a message, and returns the image's size and time; an error is a position and a description.
fn image(
    message: &[u8],
    serialisation: Serialisation,
    values: &mut Vec<f32>,
) -> Result<(Sensor, u64), (usize, String)> {
    let mut fields = Fields::new(message, serialisation).map_err(|what| (0, what))?;
    let read = image_fields(&mut fields, serialisation, values);
    read.map_err(|what| (fields.cursor.at, what))
}

fn image_fields(
    fields: &mut Fields<'_>,
    serialisation: Serialisation,
    values: &mut Vec<f32>,
) -> Result<(Sensor, u64), String> {
    if serialisation == Serialisation::Ros1 {
        fields.u32()?;
    }
    let t_us = fields.time_ns()? / 1_000;
    fields.sequence()?;
    let (height, width) = (fields.u32()?, fields.u32()?);
    let encoding = fields.string()?;
    let layout = Layout::of(encoding).ok_or_else(|| {
        let encoding: String = encoding.chars().take(40).collect();
        format!("images of encoding {encoding:?}: record mono8, mono16, rgb8 or bgr8")
    })?;
    let big_endian = fields.u8()? != 0;
    let step = fields.u32()? as usize;
    let data = fields.sequence()?;
    let sensor = size_of(width.into(), height.into())?;
    let row_bytes = usize::from(sensor.width) * layout.bytes;
    let needed = step
        .checked_mul(usize::from(sensor.height) - 1)
        .and_then(|bytes| bytes.checked_add(row_bytes));
    if step < row_bytes || needed.is_none_or(|needed| data.len() < needed) {
        return Err(format!(
            "an image of {width} x {height} pixels with rows of {step} bytes has {} bytes: damaged",
            data.len()
        ));
    }
    values.clear();
    for row in data.chunks(step).take(sensor.height.into()) {
        let row = row.get(..row_bytes).unwrap_or_default();
        let pixels = row.chunks_exact(layout.bytes);
        values.extend(pixels.map(|pixel| layout.number(pixel, big_endian)));
    }
    Ok((sensor, t_us))
}

impl Frames for Images {
    fn format(&self) -> &'static str {
        self.messages.format()
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn response(&self) -> Response {
        Response::Linear
    }

    fn next(&mut self, values: &mut Vec<f32>) -> Result<Option<Taken>> {
        if let Some((ahead, t_us)) = self.ahead.take() {
            *values = ahead;
            return Ok(Some(Taken { t_us: Some(t_us) }));
        }
        let Some((now, t_us)) = self.read(values)? else {
            return Ok(None);
        };
        let first = self.sensor;
        ensure!(
            now == first,
            Damaged,
            "{}: image {} of {} x {} pixels, the first one has {} x {}: name one topic",
            self.name,
            self.frames,
            now.width,
            now.height,
            first.width,
            first.height
        );
        Ok(Some(Taken { t_us: Some(t_us) }))
    }

    fn place(&self) -> String {
        self.name.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(encoding: &str, step: u32, data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut put = |number: u32| bytes.extend_from_slice(&number.to_le_bytes());
        [7, 5, 250_000_999, 0, 2, 3].into_iter().for_each(&mut put);
        put(encoding.len() as u32);
        bytes.extend_from_slice(encoding.as_bytes());
        bytes.push(0);
        bytes.extend_from_slice(&step.to_le_bytes());
        bytes.extend_from_slice(&(data.len() as u32).to_le_bytes());
        bytes.extend_from_slice(data);
        bytes
    }

    #[test]
    fn images_of_each_encoding_are_read_and_damage_is_an_error() {
        let mut values = Vec::new();
        let mut read = |bytes: &[u8]| {
            image(bytes, Serialisation::Ros1, &mut values).map(|read| (read, values.clone()))
        };
        let sensor = Sensor {
            width: 3,
            height: 2,
        };
        let gray = message("mono8", 4, &[0, 51, 255, 9, 102, 0, 255]);
        let (at, numbers) = read(&gray).unwrap();
        assert_eq!(at, (sensor, 5_250_000));
        assert_eq!(numbers, [0.0, 0.2, 1.0, 0.4, 0.0, 1.0]);
        let (_, numbers) = read(&message("16UC1", 6, &[0xff; 12])).unwrap();
        assert_eq!(numbers, [1.0; 6]);
        let blue = [255, 0, 0].repeat(6);
        let (_, numbers) = read(&message("bgr8", 9, &blue)).unwrap();
        assert!(
            numbers.iter().all(|n| (n - 0.0722).abs() < 1e-6),
            "{numbers:?}"
        );
        for end in 0..gray.len() {
            assert!(read(&gray[..end]).is_err(), "{end}");
        }
        for bad in [
            message("bayer_rggb8", 3, &[0; 6]),
            message("mono8", 2, &[0; 6]),
            message("mono8", 3, &[0; 5]),
            message("mono8", u32::MAX, &[0; 6]),
        ] {
            assert!(read(&bad).is_err());
        }
    }
}
