//! Reads the frames of an AEDAT 4 recording, as of a DAVIS.
//!
//! A packet of a stream of type `FRME` is one frame, a table of iniVation's `frame.fbs`: i64 timestamp, i64 start and end of
//! the frame, i64 start and end of its exposure, i8 format, i16 columns, rows and position, the pixels, and what newer
//! programs add. A frame's time is the middle of its exposure. Gray pixels have 8 or 16 bits; of colours (blue, green, red,
//! and perhaps alpha), the luma of BT.709 is taken.

use event_types::stream::{Response, Result};
use event_types::{Sensor, bail, ensure};

use super::aedat4::{Aedat4Decoder, Aedat4Reader};
use crate::Assumption;
use crate::flatbuffer::{Buffer, Vector};
use crate::input::ReadSeek;
use crate::video::{Frames, Taken, numbers, size_of};

/// Formats of pixels: OpenCV's numbers of types.
const GRAY_8: u8 = 0;
const GRAY_16: u8 = 2;
const BGR_8: u8 = 16;
const BGRA_8: u8 = 24;

/// Weights of blue, green and red in the luma of BT.709.
const LUMA: [f32; 3] = [0.0722, 0.7152, 0.2126];

/// A reader of frames.
pub(crate) struct Aedat4Frames {
    packets: Aedat4Decoder,
    sensor: Sensor,
    /// The first frame, which is read ahead for its size.
    ahead: Option<(Vec<f32>, u64)>,
}

/// A frame's table, checked.
struct Frame {
    t_us: u64,
    format: u8,
    sensor: Sensor,
    pixels: Vector,
}

impl Aedat4Frames {
    /// Reads the frames of the stream that `place` names, or else of the first one.
    ///
    /// # Errors
    /// There is no AEDAT 4.0 header, no such stream, or no frame.
    pub(crate) fn new(source: Box<dyn ReadSeek>, name: &str, place: Option<&str>) -> Result<Self> {
        let mut frames = Self {
            packets: Aedat4Reader::frames_of(source, name, place)?,
            sensor: Sensor {
                width: 0,
                height: 0,
            },
            ahead: None,
        };
        let mut values = Vec::new();
        let Some(frame) = frames.read(&mut values)? else {
            bail!(
                Refused,
                "{name}: the stream of frames holds none: choose another recording"
            );
        };
        frames.sensor = frame.sensor;
        frames.ahead = Some((values, frame.t_us));
        Ok(frames)
    }

    fn read(&mut self, values: &mut Vec<f32>) -> Result<Option<Frame>> {
        if !self.packets.next_packet()? {
            return Ok(None);
        }
        let packet = self.packets.packet();
        let Some(frame) = parse(packet) else {
            return Err(self.packets.packet_error("the frame is damaged"));
        };
        let frame = frame.map_err(|what| self.packets.packet_error(&what))?;
        let Vector { start, len } = frame.pixels;
        let pixels = packet.get(start..start + len).unwrap_or_default();
        match frame.format {
            GRAY_8 => numbers(pixels, false, 1.0 / 255.0, values),
            GRAY_16 => numbers(pixels, true, 1.0 / 65_535.0, values),
            format => {
                let bytes = if format == BGR_8 { 3 } else { 4 };
                let luma = |pixel: &[u8]| {
                    let parts = LUMA.iter().zip(pixel);
                    parts
                        .map(|(weight, part)| weight * f32::from(*part))
                        .sum::<f32>()
                        / 255.0
                };
                values.clear();
                values.extend(pixels.chunks_exact(bytes).map(luma));
            }
        }
        Ok(Some(frame))
    }
}

/// Reads a frame's table; `None` if it is damaged.
fn parse(packet: &[u8]) -> Option<Result<Frame, String>> {
    let (buffer, table) = Buffer::root(packet, b"FRME")?;
    let time = |field| buffer.i64(table, field, -1);
    let (stamp, begin, end) = (time(0)?, time(3)?, time(4)?);
    let format = buffer.u8(table, 5, 0)?;
    let side = |field| Some(u64::try_from(buffer.i16(table, field, 0)?).unwrap_or(0));
    let (width, height) = (side(6)?, side(7)?);
    let pixels = buffer.vector(table, 10)?;
    buffer.holds(pixels.start, pixels.len)?;
    let check = || {
        let t_us = if begin >= 0 && end >= begin {
            begin + (end - begin) / 2
        } else {
            stamp
        };
        let t_us = u64::try_from(t_us).map_err(|_| "the frame has no time".to_owned())?;
        let sensor = size_of(width, height)?;
        let bytes = match format {
            GRAY_8 => 1,
            GRAY_16 => 2,
            BGR_8 => 3,
            BGRA_8 => 4,
            other => {
                return Err(format!(
                    "pixels of format {other} are not known: record gray or colours of 8 bits"
                ));
            }
        };
        let expected = sensor.pixels() as usize * bytes;
        if pixels.len != expected {
            return Err(format!(
                "the frame has {} bytes in place of {expected}: damaged",
                pixels.len
            ));
        }
        Ok(Frame {
            t_us,
            format,
            sensor,
            pixels,
        })
    };
    Some(check())
}

impl Frames for Aedat4Frames {
    fn format(&self) -> &'static str {
        "aedat4"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn response(&self) -> Response {
        Response::Linear
    }

    fn assumptions(&self) -> &[Assumption] {
        self.packets.stream_assumptions()
    }

    fn next(&mut self, values: &mut Vec<f32>) -> Result<Option<Taken>> {
        if let Some((ahead, t_us)) = self.ahead.take() {
            *values = ahead;
            return Ok(Some(Taken { t_us: Some(t_us) }));
        }
        let Some(frame) = self.read(values)? else {
            return Ok(None);
        };
        let (now, first) = (frame.sensor, self.sensor);
        ensure!(
            now == first,
            Damaged,
            "{}: a frame of {} x {} pixels, the first one has {} x {}: record one region",
            self.place(),
            now.width,
            now.height,
            first.width,
            first.height
        );
        Ok(Some(Taken {
            t_us: Some(frame.t_us),
        }))
    }

    fn place(&self) -> String {
        self.packets.packet_place()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flatbuffer::writer::{Value, buffer};

    fn packet(
        format: u8,
        (width, height): (i16, i16),
        pixels: &[u8],
        exposure: Option<(i64, i64)>,
    ) -> Vec<u8> {
        let mut fields = vec![
            (0, Value::i64(1_000)),
            (5, Value::u8(format)),
            (6, Value::i16(width)),
            (7, Value::i16(height)),
            (10, Value::Structs(pixels.len() as u32, pixels.to_vec())),
        ];
        if let Some((begin, end)) = exposure {
            fields.extend([(3, Value::i64(begin)), (4, Value::i64(end))]);
        }
        let plain = buffer(&Value::Table(fields));
        let root = u32::from_le_bytes(*plain.first_chunk().unwrap()) + 4;
        let size = plain.len() as u32 + 4;
        [
            &size.to_le_bytes()[..],
            &root.to_le_bytes(),
            b"FRME",
            &plain[4..],
        ]
        .concat()
    }

    #[test]
    fn a_frame_has_its_middle_time_and_its_pixels() {
        let gray = packet(GRAY_8, (3, 1), &[1, 2, 3], Some((2_000, 3_001)));
        let frame = parse(&gray).unwrap().unwrap();
        assert_eq!(
            (frame.t_us, frame.sensor.width, frame.pixels.len),
            (2_500, 3, 3)
        );
        let frame = parse(&packet(BGR_8, (1, 1), &[1, 2, 3], None))
            .unwrap()
            .unwrap();
        assert_eq!(frame.t_us, 1_000);
        for bad in [
            packet(GRAY_8, (3, 1), &[1, 2], None),
            packet(GRAY_8, (-3, 1), &[1, 2, 3], None),
            packet(GRAY_8, (3000, 1), &[1, 2, 3], None),
            packet(5, (3, 1), &[0; 12], None),
        ] {
            assert!(parse(&bad).unwrap().is_err());
        }
        for at in 0..gray.len() {
            let _ = parse(&gray[..at]);
            for byte in [0, 1, 0x7f, 0x80, 0xff] {
                let mut other = gray.clone();
                other[at] = byte;
                if let Some(Ok(Frame { pixels, .. })) = parse(&other) {
                    assert!(pixels.start + pixels.len <= other.len());
                }
            }
        }
    }
}
