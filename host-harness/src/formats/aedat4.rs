//! AEDAT 4.0, the format of iniVation's DV: LZ4, Zstandard or no compression.
//!
//! `#!AER-DAT4.0\r\n`, an `IOHE` table (compression, position of the packet table, XML that names
//! streams, their types and sizes), packets (i32 stream, i32 size, content), then the `FTAB`
//! packet table. A packet's content and the packet table are size-prefixed `FlatBuffers`, each
//! compressed as one frame. An event is 16 bytes: i64 t in us, i16 x, i16 y, u8 polarity, padding.
//!
//! Events come from the first event stream in the XML. Frames, IMU samples, triggers and the
//! events of further streams are counted as skipped.
//!
//! The crate `aedat` 1.3 decodes the shared recordings alike, but it allocates whatever size a
//! packet states, takes a truncated file for its end, hands the packets out without offsets and
//! reads from files and sockets only, and it builds two C libraries and `ndarray`; so this is our
//! own decoder, and `aedat` is its peer in the tests.

use std::io::Read;

use eecvs_nostd::{Event, Polarity, Sensor};
use lz4_flex::frame::FrameDecoder;

use super::Skipped;
use super::aedat4_writer::Aedat4Writer;
use super::flatbuffer::{Buffer, Vector};
use super::format::{Format, Limits, Opening};
use super::input::{Batch, Decode, Input, ReadSeek, Reader};

/// First bytes of every AEDAT 4.0 file.
pub const MAGIC: &[u8; 14] = b"#!AER-DAT4.0\r\n";

/// Longest IOHE table: the XML of real files has a few kB.
const HEADER_MAX: usize = 1 << 20;

/// Longest content of a packet, compressed and decompressed: 4 million events. DV closes a packet
/// every 10 ms.
pub(super) const PACKET_MAX: usize = 1 << 26;

/// Bytes of an event in a packet.
pub(super) const EVENT_BYTES: usize = 16;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Compression {
    None,
    Lz4,
    Zstd,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Content {
    /// The stream whose events are read.
    Events,
    OtherEvents,
    Frames,
    Imu,
    Triggers,
    Unknown,
}

/// A stream that the XML describes.
#[derive(Debug, Clone)]
struct Stream {
    id: i32,
    content: Content,
    size: Option<(u64, u64)>,
    source: Option<String>,
}

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "aedat4",
    title: "AEDAT 4",
    endings: &[".aedat4"],
    detect: |start| start.begins(MAGIC),
    open: |Opening {
               source, name, size, ..
           }| Ok(Box::new(Aedat4Reader::new(source, name, size)?)),
    has_places: false,
    grows: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(Aedat4Writer::create(path, sensor)?))),
};

/// Reader of AEDAT 4.0 files.
pub type Aedat4Reader = Reader<Aedat4Decoder>;

impl Aedat4Reader {
    /// Reads `source`, which messages call `name`; `size` counts where the XML names no size.
    ///
    /// # Errors
    /// No AEDAT 4.0 header, an unknown compression, no event stream, no sensor size.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        size: Option<Sensor>,
    ) -> anyhow::Result<Self> {
        let mut input = Input::new(source, name)?;
        let mut start = [0; MAGIC.len()];
        if input.fill(&mut start)? < start.len() || &start != MAGIC {
            return Err(input.error_at(0, "no AEDAT 4.0 header (#!AER-DAT4.0)"));
        }
        let header = read_io_header(&mut input)?;
        let Buffers {
            compression,
            table_position,
            xml,
        } = header;
        let streams = streams_of(&xml).map_err(|what| input.error_at(18, what))?;
        let Some(stream) = streams
            .iter()
            .find(|stream| stream.content == Content::Events)
        else {
            return Err(input.error_at(18, "the recording holds no event stream"));
        };
        let sensor = match stream.size {
            Some((width, height)) => {
                let side = |side| u16::try_from(side).unwrap_or(0);
                Sensor::new(side(width), side(height)).ok_or_else(|| {
                    input.error_at(18, format!("sensor size {width}x{height} is out of range"))
                })?
            }
            None => size.ok_or_else(|| {
                input.error_at(18, "no sensor size in the XML: give --width W --height H")
            })?,
        };
        let camera = stream.source.clone();
        Ok(Self::around(Aedat4Decoder {
            end: table_position,
            input,
            compression,
            streams,
            sensor,
            camera,
            raw: Raw::default(),
            lz4: Lz4::default(),
            packet: Vec::new(),
            packet_offset: 0,
            elements: Vector { start: 0, len: 0 },
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

struct Buffers {
    compression: Compression,
    /// Where the packets end, if the file says so.
    table_position: Option<u64>,
    xml: String,
}

fn read_io_header(input: &mut Input) -> anyhow::Result<Buffers> {
    let start = input.offset();
    let mut bytes = vec![0; 4];
    let got = input.fill(&mut bytes)?;
    let size = bytes
        .first_chunk()
        .map_or(0, |size| u32::from_le_bytes(*size) as usize);
    if got < 4 || size > HEADER_MAX {
        return Err(input.error_at(start, "the header is truncated or over 1 MiB: damaged file"));
    }
    bytes.resize(4 + size, 0);
    if input.fill(bytes.get_mut(4..).unwrap_or_default())? < size {
        return Err(input.error("the file ends within its header: truncated"));
    }
    let fields = || {
        let (buffer, table) = Buffer::root(&bytes, b"IOHE")?;
        let xml = buffer.string(table, 2)?.to_owned();
        Some((buffer.i32(table, 0, 0)?, buffer.i64(table, 1, -1)?, xml))
    };
    let (compression, position, xml) =
        fields().ok_or_else(|| input.error_at(start, "the IOHE header is damaged"))?;
    let compression = match compression {
        0 => Compression::None,
        1 | 2 => Compression::Lz4,
        3 | 4 => Compression::Zstd,
        other => {
            return Err(input.error_at(start, format!("compression {other} is not known")));
        }
    };
    // -1 says that there is no table; DV leaves 0 where it was killed.
    let table_position = u64::try_from(position)
        .ok()
        .filter(|position| *position > 0);
    Ok(Buffers {
        compression,
        table_position,
        xml,
    })
}

/// The streams that the XML describes, in its order.
fn streams_of(xml: &str) -> Result<Vec<Stream>, String> {
    let options = roxmltree::ParsingOptions {
        nodes_limit: 1 << 16,
        ..Default::default()
    };
    let document = roxmltree::Document::parse_with_options(xml, options)
        .map_err(|error| format!("the XML in the header is damaged: {error}"))?;
    let attribute = |node: roxmltree::Node<'_, '_>, key: &str| {
        let mut attributes = node.children().filter(|child| child.has_tag_name("attr"));
        let found = attributes.find(|child| child.attribute("key") == Some(key))?;
        found.text().map(|text| text.trim().to_owned())
    };
    let mut streams: Vec<Stream> = Vec::new();
    for node in document
        .descendants()
        .filter(|node| node.has_tag_name("node"))
    {
        let Some(kind) = attribute(node, "typeIdentifier") else {
            continue;
        };
        let name = node.attribute("name").unwrap_or_default();
        let id = name
            .parse()
            .map_err(|_| format!("stream name {name:?} is no number"))?;
        let first_events = !streams
            .iter()
            .any(|stream| stream.content == Content::Events);
        let content = match kind.as_str() {
            "EVTS" if first_events => Content::Events,
            "EVTS" => Content::OtherEvents,
            "FRME" => Content::Frames,
            "IMUS" => Content::Imu,
            "TRIG" => Content::Triggers,
            _ => Content::Unknown,
        };
        let info = node
            .children()
            .find(|child| child.attribute("name") == Some("info"));
        let of_info = |key| info.and_then(|info| attribute(info, key));
        let side = |key| of_info(key).and_then(|side| side.parse::<u64>().ok());
        let size = side("sizeX").zip(side("sizeY"));
        streams.push(Stream {
            id,
            content,
            size,
            source: of_info("source"),
        });
    }
    Ok(streams)
}

/// State between two batches: one decompressed packet.
pub struct Aedat4Decoder {
    input: Input,
    compression: Compression,
    streams: Vec<Stream>,
    sensor: Sensor,
    camera: Option<String>,
    /// Where the packets end; `None` where only the file's end says it.
    end: Option<u64>,
    raw: Raw,
    lz4: Lz4,
    packet: Vec<u8>,
    packet_offset: u64,
    /// Events of the packet that are still to be read.
    elements: Vector,
    events: u64,
    skipped: Skipped,
}

impl Aedat4Decoder {
    /// Reads packets up to the next one of the event stream; `false` at the end.
    fn next_packet(&mut self) -> anyhow::Result<bool> {
        loop {
            let start = self.input.offset();
            if self.end.is_some_and(|end| start >= end) {
                return Ok(false);
            }
            let mut header = [0; 8];
            match self.input.fill(&mut header)? {
                0 => {
                    return match self.end {
                        None => Ok(false),
                        Some(_) => Err(self
                            .input
                            .error("the file ends before its packet table: truncated recording")),
                    };
                }
                8 => {}
                _ => return Err(self.input.error_at(start, "truncated packet header")),
            }
            let [s0, s1, s2, s3, n0, n1, n2, n3] = header;
            let id = i32::from_le_bytes([s0, s1, s2, s3]);
            let size = i32::from_le_bytes([n0, n1, n2, n3]);
            let Some(size) = usize::try_from(size)
                .ok()
                .filter(|size| *size <= PACKET_MAX)
            else {
                let what = format!("packet size {size} is not within 0 to 64 MiB: damaged file");
                return Err(self.input.error_at(start, what));
            };
            let end = start + 8 + size as u64;
            if end > self.end.unwrap_or(u64::MAX).min(self.input.length()) {
                let what = format!("the packet of {size} bytes runs past the end: truncated");
                return Err(self.input.error_at(start, what));
            }
            let Some(stream) = self.streams.iter().find(|stream| stream.id == id) else {
                let what = format!("packet of stream {id}, which the header does not name");
                return Err(self.input.error_at(start, what));
            };
            let content = stream.content;
            if matches!(content, Content::Frames | Content::Unknown) {
                let kind = if content == Content::Frames {
                    "frames"
                } else {
                    "other packets"
                };
                self.skipped.add(kind, 1);
                self.input.seek(end)?;
                continue;
            }
            let content_bytes = self.decompress(start, size)?;
            self.packet = content_bytes;
            self.packet_offset = start;
            let elements = self.elements_of(content);
            if content == Content::Events {
                self.elements = elements
                    .ok_or_else(|| self.input.error_at(start, "the event packet is damaged"))?;
                return Ok(true);
            }
            let (kind, damaged) = match content {
                Content::Imu => ("IMU samples", "damaged IMU packets"),
                Content::Triggers => ("triggers", "damaged trigger packets"),
                _ => (
                    "events of further streams",
                    "damaged packets of further streams",
                ),
            };
            match elements {
                Some(elements) => self.skipped.add(kind, elements.len as u64),
                None => self.skipped.add(damaged, 1),
            }
        }
    }

    /// Content of a packet whose `size` bytes follow.
    fn decompress(&mut self, start: u64, size: usize) -> anyhow::Result<Vec<u8>> {
        let mut content = std::mem::take(&mut self.packet);
        content.clear();
        self.raw.at = 0;
        self.raw.bytes.resize(size, 0);
        if self.input.fill(&mut self.raw.bytes)? < size {
            return Err(self.input.error_at(start, "truncated packet"));
        }
        let limit = PACKET_MAX as u64 + 1;
        let read = match self.compression {
            Compression::None => self.raw.read_to_end(&mut content),
            Compression::Lz4 => self.lz4.decompress(&mut self.raw, limit, &mut content),
            Compression::Zstd => {
                let decoder = ruzstd::decoding::StreamingDecoder::new(&mut self.raw);
                decoder
                    .map_err(std::io::Error::other)
                    .and_then(|decoder| decoder.take(limit).read_to_end(&mut content))
            }
        };
        match read {
            Ok(_) if content.len() > PACKET_MAX => Err(self
                .input
                .error_at(start, "the packet unpacks to over 64 MiB: damaged file")),
            Ok(_) => Ok(content),
            Err(error) => {
                let what = format!("the packet cannot be decompressed: {error}");
                Err(self.input.error_at(start, what))
            }
        }
    }

    /// The one vector of events, IMU and trigger packets.
    fn elements_of(&self, content: Content) -> Option<Vector> {
        let letters = match content {
            Content::Imu => b"IMUS",
            Content::Triggers => b"TRIG",
            _ => b"EVTS",
        };
        let (buffer, table) = Buffer::root(&self.packet, letters)?;
        let vector = buffer.vector(table, 0)?;
        let element = if letters == b"EVTS" { EVENT_BYTES } else { 4 };
        let end = vector.start.checked_add(vector.len.checked_mul(element)?)?;
        (end <= self.packet.len()).then_some(vector)
    }

    fn event_error(&self, event: &RawEvent, what: &str) -> anyhow::Error {
        let RawEvent { t, x, y, .. } = event;
        let Sensor { width, height } = self.sensor;
        self.input.error_at(
            self.packet_offset,
            format!(
                "event {} of the packet here (t = {t}, x = {x}, y = {y}) {what} ({width}x{height})",
                self.events
            ),
        )
    }
}

/// The bytes of a packet.
#[derive(Default)]
struct Raw {
    bytes: Vec<u8>,
    /// Bytes that were read.
    at: usize,
    /// More was asked for than there is.
    ran_out: bool,
}

impl Read for Raw {
    fn read(&mut self, to: &mut [u8]) -> std::io::Result<usize> {
        let mut rest = self.bytes.get(self.at..).unwrap_or_default();
        let read = rest.read(to)?;
        self.at += read;
        self.ran_out |= read < to.len();
        Ok(read)
    }
}

/// A decoder of LZ4 frames that serves many packets: a new one zeroes some megabytes, which takes
/// several times as long as the events of a packet.
#[derive(Default)]
struct Lz4(Option<(FrameFormat, FrameDecoder<Raw>)>);

/// First bytes of a frame, what the sizes of its decoder's buffers depend on: magic number, flags,
/// size of blocks.
type FrameFormat = [u8; 6];

impl Lz4 {
    /// Appends what is in `raw`, a frame, to `content`, `limit` bytes at most.
    fn decompress(
        &mut self,
        raw: &mut Raw,
        limit: u64,
        content: &mut Vec<u8>,
    ) -> std::io::Result<usize> {
        let format: Option<FrameFormat> = raw.bytes.first_chunk().copied();
        let mut decoder = match self.0.take() {
            Some((same, decoder)) if Some(same) == format => decoder,
            _ => FrameDecoder::new(Raw::default()),
        };
        std::mem::swap(decoder.get_mut(), raw);
        decoder.get_mut().ran_out = false;
        let read = (&mut decoder).take(limit).read_to_end(content);
        std::mem::swap(decoder.get_mut(), raw);
        // Within a frame that broke off it would take the next packet for the rest of it.
        let is_whole = !raw.ran_out && raw.at == raw.bytes.len() && (content.len() as u64) < limit;
        if read.is_ok() && is_whole {
            self.0 = format.map(|format| (format, decoder));
        }
        read
    }
}

/// An event as a packet holds it.
struct RawEvent {
    t: i64,
    x: i16,
    y: i16,
    on: bool,
}

impl RawEvent {
    fn parse(bytes: [u8; EVENT_BYTES]) -> Self {
        let [t0, t1, t2, t3, t4, t5, t6, t7, x0, x1, y0, y1, on, ..] = bytes;
        Self {
            t: i64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
            x: i16::from_le_bytes([x0, x1]),
            y: i16::from_le_bytes([y0, y1]),
            on: on != 0,
        }
    }
}

impl Decode for Aedat4Decoder {
    fn format(&self) -> &'static str {
        "aedat4"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn camera(&self) -> Option<&str> {
        self.camera.as_deref()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        while batch.room() > 0 {
            if self.elements.len == 0 && !self.next_packet()? {
                break;
            }
            let count = self.elements.len.min(batch.room());
            let start = self.elements.start;
            let bytes = self
                .packet
                .get(start..start + count * EVENT_BYTES)
                .unwrap_or_default();
            let (chunks, _) = bytes.as_chunks::<EVENT_BYTES>();
            for chunk in chunks {
                let event = RawEvent::parse(*chunk);
                let (x, y) = (u16::try_from(event.x), u16::try_from(event.y));
                match (u64::try_from(event.t), x, y) {
                    (Ok(t_us), Ok(x), Ok(y)) if self.sensor.contains(x, y) => {
                        let polarity = Polarity::from_bool(event.on);
                        batch.push(Event {
                            t_us,
                            x,
                            y,
                            polarity,
                        });
                    }
                    (Ok(_), ..) => {
                        return Err(self.event_error(&event, "is outside of the sensor"));
                    }
                    (Err(_), ..) => return Err(self.event_error(&event, "has a negative time")),
                }
                self.events += 1;
            }
            self.elements.start += count * EVENT_BYTES;
            self.elements.len -= count;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};
    use std::io::Write;

    #[test]
    fn a_decoder_of_many_packets_is_one_for_each() {
        let content: Vec<u8> = (0..200_000_u32).map(|i| (i / 7 % 251) as u8).collect();
        let mut packets = Vec::new();
        for size in [BlockSize::Max64KB, BlockSize::Max1MB, BlockSize::Max64KB] {
            for mode in [BlockMode::Linked, BlockMode::Linked, BlockMode::Independent] {
                let info = FrameInfo::new().block_size(size).block_mode(mode);
                let mut encoder = FrameEncoder::with_frame_info(info, Vec::new());
                encoder.write_all(&content[packets.len()..]).unwrap();
                let packet = encoder.finish().unwrap();
                // Whole, cut, without its end mark, damaged, with bytes behind it, whole.
                packets.push(packet.clone());
                packets.push(packet[..packet.len() / 2].to_vec());
                packets.push(packet[..packet.len() - 4].to_vec());
                let mut damaged = packet.clone();
                damaged[20] ^= 0xff;
                packets.push(damaged);
                packets.push([&packet[..], b"more"].concat());
                packets.push(packet);
            }
        }
        packets.extend([vec![], vec![4; 3]]);
        let mut many = Lz4::default();
        for bytes in packets {
            let mut raw = Raw {
                bytes: bytes.clone(),
                ..Raw::default()
            };
            let mut content = Vec::new();
            let read = many.decompress(&mut raw, 1 << 20, &mut content);
            let mut expected = Vec::new();
            let alone = FrameDecoder::new(bytes.as_slice()).read_to_end(&mut expected);
            assert_eq!(read.ok(), alone.ok());
            assert!(content == expected);
        }
    }
}
