//! AEDAT 4.0, the format of iniVation's DV, with LZ4, Zstandard or no compression.
//!
//! A file is `#!AER-DAT4.0\r\n`, an `IOHE` table (compression, position of the packet table, XML that names the
//! streams, their types and sizes), packets (i32 stream, i32 size, content), then the `FTAB` packet table. A
//! packet's content and the packet table are size-prefixed `FlatBuffers`, each compressed as one frame. An event
//! has 16 bytes: i64 t in us, i16 x, i16 y, u8 polarity, padding.
//!
//! Events come from the stream that the path names after the file (`FILE.aedat4/1`, or the name of its camera or
//! output), or else from the first event stream in the XML; if there are several, the reader's assumptions say so.
//! Frames, IMU samples, triggers and the events of other streams are counted as skipped.
//!
//! The reader seeks by the packet table, as described in `packet_table.rs`. A recording that is still being
//! written, or was interrupted, states that it has none (position -1, or 0 from DV). It ends after its last
//! packet, or where a packet table begins nevertheless: the table's first bytes distinguish it from a packet of a
//! stream that the XML names.
//!
//! The crate `aedat` 1.3 decodes the shared recordings to the same events, but it allocates whatever size a packet
//! states, takes a truncated file for a complete one, returns packets without offsets, reads only from files and
//! sockets, and builds two C libraries and `ndarray`. Hence this decoder, which the tests compare with `aedat`.

use std::io::Read;

use event_types::stream::{ErrorKind, Result};
use event_types::{Event, Polarity, Sensor};

use crate::aedat::aedat4_writer::Aedat4Writer;
use crate::aedat::lz4_frame;
use crate::aedat::lz4_frame::Content as Unpacked;
use crate::aedat::packet_table::{Entry, PacketTable};
use crate::flatbuffer::{Buffer, Vector};
use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, OUTSIDE, ReadSeek, Reader};
use crate::word_runs::RUN_WORDS;
use crate::{Assumption, Skipped};

/// First bytes of every AEDAT 4.0 file.
pub const MAGIC: &[u8; 14] = b"#!AER-DAT4.0\r\n";

/// Number of bytes after the packets in which another recording is searched for: more than any packet table has.
const FOLLOWING_MAX: u64 = 1 << 24;

/// Largest IOHE table in bytes: the XML of real files has a few kB.
const HEADER_MAX: usize = 1 << 20;

/// Largest content of a packet in bytes, both compressed and decompressed: 4 million events. DV closes a packet
/// every 10 ms.
pub(crate) const PACKET_MAX: usize = 1 << 26;

/// First bytes of a Zstandard frame.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Bytes of an event in a packet.
pub(crate) const EVENT_BYTES: usize = 16;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Compression {
    None,
    Lz4,
    Zstd,
}

impl Compression {
    /// Decompresses a packet or the packet table, to at most one byte more than a packet may have.
    fn unpack(self, raw: &[u8], to: &mut Unpacked) -> std::io::Result<()> {
        const LIMIT: usize = PACKET_MAX + 1;
        match self {
            Self::None => to.read(raw),
            Self::Lz4 => to.decode(raw, LIMIT),
            Self::Zstd => {
                let decoder = ruzstd::decoding::StreamingDecoder::new(raw);
                to.read(decoder.map_err(std::io::Error::other)?.take(LIMIT as u64))
            }
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Content {
    /// Events of the stream that is read.
    Events,
    OtherEvents,
    /// Frames of the stream that is read.
    OwnFrames,
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
    /// Name that the recording program gave the stream's output.
    output: Option<String>,
}

impl Stream {
    /// Returns whether `place` names the stream: by its number, its camera, its output's name, or camera/output.
    fn is_named(&self, place: &str) -> bool {
        let is = |name: &Option<String>, part: &str| name.as_deref() == Some(part);
        let both = place.split_once('/');
        place == self.id.to_string()
            || is(&self.source, place)
            || is(&self.output, place)
            || both.is_some_and(|(source, output)| {
                is(&self.source, source) && is(&self.output, output)
            })
    }

    /// Returns the stream's number and names, for messages.
    fn title(&self) -> String {
        let names = [&self.source, &self.output].into_iter().flatten();
        let names: Vec<&str> = names.map(String::as_str).collect();
        match names.as_slice() {
            [] => self.id.to_string(),
            names => format!("{} ({})", self.id, names.join(", ")),
        }
    }
}

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "aedat4",
    title: "AEDAT 4",
    endings: &[".aedat4"],
    detect: |start| start.begins(MAGIC),
    open: |Opening {
               source,
               name,
               reading,
               place,
               ..
           }| {
        Ok(Box::new(Aedat4Reader::of_stream(
            source,
            name,
            place,
            reading.size,
        )?))
    },
    has_places: true,
    is_table: false,
    grows: true,
    streams: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(Aedat4Writer::create(path, sensor)?))),
};

/// A reader of AEDAT 4.0 files.
pub type Aedat4Reader = Reader<Aedat4Decoder>;

impl Aedat4Reader {
    /// Reads `source`, which messages call `name`; `size` is used if the XML states no size.
    ///
    /// # Errors
    /// There is no AEDAT 4.0 header; the compression is unknown; there is no event stream; the sensor's size is
    /// unknown.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        Self::of_stream(source, name, None, size)
    }

    /// Reads the events of the stream that `place` names; otherwise like [`Aedat4Reader::new`].
    ///
    /// # Errors
    /// Those of [`Aedat4Reader::new`]; no event stream has that name, or more than one has it.
    pub fn of_stream(
        source: Box<dyn ReadSeek>,
        name: &str,
        place: Option<&str>,
        size: Option<Sensor>,
    ) -> Result<Self> {
        let (input, header, mut streams) = open_streams(source, name)?;
        let assumption = choose(&mut streams, Content::OtherEvents, place)
            .map_err(|what| input.error_at(18, what))?;
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
                input
                    .error_at(18, "no sensor size in the XML: give --width W --height H")
                    .of_kind(ErrorKind::Undecided)
            })?,
        };
        let (camera, stream_id) = (stream.source.clone(), stream.id);
        let mut decoder = Aedat4Decoder::new(input, &header, streams, stream_id, sensor);
        decoder.camera = camera;
        decoder.assumptions = assumption.into_iter().collect();
        Ok(Self::around(decoder))
    }

    /// Returns the packets of the stream of frames that `place` names, or else of the first one.
    ///
    /// # Errors
    /// There is no AEDAT 4.0 header; the compression is unknown; there is no such stream, or more than one.
    pub(super) fn frames_of(
        source: Box<dyn ReadSeek>,
        name: &str,
        place: Option<&str>,
    ) -> Result<Aedat4Decoder> {
        let (input, header, mut streams) = open_streams(source, name)?;
        let assumption = choose(&mut streams, Content::Frames, place)
            .map_err(|what| input.error_at(18, what))?;
        let stream = streams.iter().find(|s| s.content == Content::OwnFrames);
        let Some(stream_id) = stream.map(|stream| stream.id) else {
            return Err(input.error_at(18, "the recording holds no stream of frames"));
        };
        // Other streams need not be decompressed.
        for stream in &mut streams {
            if stream.content != Content::OwnFrames {
                stream.content = Content::Unknown;
            }
        }
        let none = Sensor {
            width: 0,
            height: 0,
        };
        let mut decoder = Aedat4Decoder::new(input, &header, streams, stream_id, none);
        decoder.assumptions = assumption.into_iter().collect();
        Ok(decoder)
    }
}

/// Reads a file up to its packets, and lists its streams.
fn open_streams(source: Box<dyn ReadSeek>, name: &str) -> Result<(Input, Buffers, Vec<Stream>)> {
    let mut input = Input::new(source, name)?;
    let mut start = [0; MAGIC.len()];
    if input.fill(&mut start)? < start.len() || &start != MAGIC {
        return Err(input.error_at(0, "no AEDAT 4.0 header (#!AER-DAT4.0)"));
    }
    let header = read_io_header(&mut input)?;
    let streams = streams_of(&header.xml).map_err(|what| input.error_at(18, what))?;
    Ok((input, header, streams))
}

struct Buffers {
    compression: Compression,
    /// Offset of the packet table, where the packets end, if the file states it.
    table_position: Option<u64>,
    xml: String,
}

fn read_io_header(input: &mut Input) -> Result<Buffers> {
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
    // -1 means that there is no table; DV leaves 0 if it was killed.
    let table_position = u64::try_from(position)
        .ok()
        .filter(|position| *position > 0);
    Ok(Buffers {
        compression,
        table_position,
        xml,
    })
}

/// Returns the streams that the XML describes, in its order.
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
            .map_err(|_| format!("stream name {name:?} is not a number"))?;
        let content = match kind.as_str() {
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
            output: attribute(node, "originalOutputName"),
        });
    }
    Ok(streams)
}

/// Selects the stream of a content, [`Content::OtherEvents`] or [`Content::Frames`], that `place` names, or else the first
/// one, and returns an assumption if there was a choice.
fn choose(
    streams: &mut [Stream],
    content: Content,
    place: Option<&str>,
) -> Result<Option<Assumption>, String> {
    let (kind, own) = match content {
        Content::Frames => ("stream of frames", Content::OwnFrames),
        _ => ("event stream", Content::Events),
    };
    let titles: Vec<String> = streams
        .iter()
        .filter(|stream| stream.content == content)
        .map(Stream::title)
        .collect();
    let all = titles.join(", ");
    let mut found = streams
        .iter_mut()
        .filter(|stream| stream.content == content)
        .filter(|stream| place.is_none_or(|place| stream.is_named(place)));
    let Some(stream) = found.next() else {
        return match place {
            Some(place) if !titles.is_empty() => {
                Err(format!("no {kind} {place}: the recording has {all}"))
            }
            _ => Ok(None),
        };
    };
    if let Some(place) = place {
        if found.next().is_some() {
            return Err(format!(
                "more than one {kind} is called {place}: choose one by its number: {all}"
            ));
        }
        stream.content = own;
        return Ok(None);
    }
    stream.content = own;
    let taken = stream.title();
    Ok((titles.len() > 1).then(|| Assumption {
        what: "stream",
        taken,
        why: format!(
            "the first of {all}; to choose another, name it after the file, as in FILE.aedat4/1"
        ),
    }))
}

/// The decoder of [`Aedat4Reader`]: its state between two batches, with one decompressed packet.
pub struct Aedat4Decoder {
    input: Input,
    compression: Compression,
    streams: Vec<Stream>,
    /// Number of the stream whose events are read.
    stream_id: i32,
    sensor: Sensor,
    camera: Option<String>,
    assumptions: Vec<Assumption>,
    /// Whether invalid events are counted instead of refused.
    leave_out: bool,
    /// Offset of the first packet.
    start: u64,
    /// Offset where the packets end; `None` if only the file's end or the packet table itself shows it.
    end: Option<u64>,
    /// The packet table, read at the first seek; the inner `None` means that there is no usable one.
    table: Option<Option<PacketTable>>,
    /// A packet as stored in the file.
    raw: Vec<u8>,
    packet: Unpacked,
    packet_offset: u64,
    /// Events of the packet that have not been returned yet.
    elements: Vector,
    events: u64,
    skipped: Skipped,
}

impl Aedat4Decoder {
    /// Begins at the first packet, to which the input has been read.
    fn new(
        input: Input,
        header: &Buffers,
        streams: Vec<Stream>,
        stream_id: i32,
        sensor: Sensor,
    ) -> Self {
        Self {
            start: input.offset(),
            end: header.table_position,
            input,
            compression: header.compression,
            streams,
            stream_id,
            sensor,
            camera: None,
            assumptions: Vec::new(),
            leave_out: false,
            table: None,
            raw: Vec::new(),
            packet: Unpacked::default(),
            packet_offset: 0,
            elements: Vector { start: 0, len: 0 },
            events: 0,
            skipped: Skipped::default(),
        }
    }

    /// Returns the content of the latest packet, decompressed.
    pub(super) fn packet(&self) -> &[u8] {
        self.packet.bytes()
    }

    /// Returns an error at the latest packet.
    pub(super) fn packet_error(&self, what: &str) -> event_types::stream::Error {
        self.input.error_at(self.packet_offset, what)
    }

    /// Returns the file and the offset of the latest packet.
    pub(super) fn packet_place(&self) -> String {
        format!("{}: byte {}", self.input.name(), self.packet_offset)
    }

    /// Returns what was assumed about the stream.
    pub(super) fn stream_assumptions(&self) -> &[Assumption] {
        &self.assumptions
    }

    /// Reads packets up to the next one of the stream that is read; returns false at the end.
    pub(super) fn next_packet(&mut self) -> Result<bool> {
        loop {
            let start = self.input.offset();
            if self.end.is_some_and(|end| start >= end) {
                self.check_nothing_follows(start)?;
                return Ok(false);
            }
            let mut header = [0; 8];
            match self.input.fill(&mut header)? {
                0 => {
                    return match self.end {
                        // The recording was interrupted, or is still being written and the caller does not wait
                        // for more.
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
            if self.end.is_none()
                && !self.streams.iter().any(|stream| stream.id == id)
                && self.is_table(header)?
            {
                self.end = Some(start);
                return Ok(false);
            }
            let Some(size) = usize::try_from(size)
                .ok()
                .filter(|size| *size <= PACKET_MAX)
            else {
                let what = format!("packet size {size} is not within 0 to 64 MiB: damaged file");
                return Err(self.input.error_at(start, what));
            };
            let end = start + 8 + size as u64;
            if self.end.is_some_and(|table| end > table) || !self.input.reaches(end)? {
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
            self.unpack(start, size)?;
            self.packet_offset = start;
            if content == Content::OwnFrames {
                return Ok(true);
            }
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

    /// Returns an error if another recording begins after the packet table at byte `at`, as in files joined by
    /// `cat`.
    fn check_nothing_follows(&mut self, at: u64) -> Result<()> {
        // Read no more than there is: in a growing file, a read would wait for more.
        let length = self.input.end()?.saturating_sub(at);
        self.input.seek(at)?;
        let mut bytes = vec![0; length.min(FOLLOWING_MAX) as usize];
        let filled = self.input.fill(&mut bytes)?;
        bytes.truncate(filled);
        let mut places = bytes.windows(MAGIC.len());
        if let Some(place) = places.position(|bytes| bytes == MAGIC) {
            return Err(self.input.error_at(
                at + place as u64,
                "another recording begins here: separate the files",
            ));
        }
        self.input.seek(at)
    }

    /// Returns whether these bytes, after which the input is positioned, begin the packet table.
    fn is_table(&mut self, start: [u8; 8]) -> Result<bool> {
        let [m0, m1, m2, m3, ..] = start;
        let magic = [m0, m1, m2, m3];
        Ok(match self.compression {
            Compression::Lz4 => magic == lz4_frame::MAGIC,
            Compression::Zstd => magic == ZSTD_MAGIC,
            Compression::None => {
                let mut letters = [0; 4];
                let here = self.input.offset();
                let is_table = self.input.fill(&mut letters)? == 4 && &letters == b"FTAB";
                self.input.seek(here)?;
                is_table
            }
        })
    }

    /// Reads and decompresses the content of a packet, whose `size` bytes come next.
    fn unpack(&mut self, start: u64, size: usize) -> Result<()> {
        self.input.room(&mut self.raw, size)?;
        if self.input.fill(&mut self.raw)? < size {
            return Err(self.input.error_at(start, "truncated packet"));
        }
        let unpacked = self.compression.unpack(&self.raw, &mut self.packet);
        unpacked.map_err(|error| {
            let what = format!("the packet cannot be decompressed: {error}");
            self.input.error_at(start, what)
        })?;
        if self.packet.bytes().len() > PACKET_MAX {
            let what = "the packet unpacks to over 64 MiB: damaged file";
            return Err(self.input.error_at(start, what));
        }
        Ok(())
    }

    /// Reads the packet table at byte `at`; `None` if it is damaged. Changes the input's position.
    fn read_table(&mut self, at: u64) -> Result<Option<PacketTable>> {
        let size = usize::try_from(self.input.length().saturating_sub(at)).unwrap_or(usize::MAX);
        let mut raw = vec![0; size.min(PACKET_MAX)];
        let read = self.input.fill_at(at, &mut raw)?;
        raw.truncate(read);
        let mut table = Unpacked::default();
        let unpacked = self.compression.unpack(&raw, &mut table);
        Ok(unpacked
            .ok()
            .and_then(|()| PacketTable::parse(table.bytes(), self.stream_id)))
    }

    /// Returns the offset from which to read events at or after `t_us`, and the number of events before it; `None`
    /// if there is no usable table. Changes the input's position.
    fn place(&mut self, t_us: u64) -> Result<Option<(u64, u64)>> {
        let Some(end) = self.end else {
            return Ok(None);
        };
        let table = match self.table.take() {
            Some(table) => table,
            None => self.read_table(end)?,
        };
        let Some(table) = self.table.insert(table) else {
            return Ok(None);
        };
        let (packet, events) = table.place(t_us);
        let Some(Entry {
            header_at, size, ..
        }) = packet
        else {
            return Ok(Some((end, events)));
        };
        let [mut id, mut its_size] = [[0; 4]; 2];
        let read = self.input.fill_at(header_at, &mut id)? + self.input.fill(&mut its_size)?;
        let header = (i32::from_le_bytes(id), i32::from_le_bytes(its_size));
        let is_there = read == 8 && (self.start..end).contains(&header_at);
        Ok((is_there && header == (self.stream_id, size)).then_some((header_at, events)))
    }

    /// Returns the only vector of an event, IMU or trigger packet; `None` if the packet is damaged.
    fn elements_of(&self, content: Content) -> Option<Vector> {
        let letters = match content {
            Content::Imu => b"IMUS",
            Content::Triggers => b"TRIG",
            _ => b"EVTS",
        };
        let packet = self.packet.bytes();
        let (buffer, table) = Buffer::root(packet, letters)?;
        let vector = buffer.vector(table, 0)?;
        let element = if letters == b"EVTS" { EVENT_BYTES } else { 4 };
        let end = vector.start.checked_add(vector.len.checked_mul(element)?)?;
        (end <= packet.len()).then_some(vector)
    }

    fn event_error(&self, event: &RawEvent, what: &str) -> event_types::stream::Error {
        let RawEvent { t, x, y, .. } = event;
        let Sensor { width, height } = self.sensor;
        self.input.error_at(
            self.packet_offset,
            format!(
                "event {} (t = {t}, x = {x}, y = {y}, in this packet) {what} ({width}x{height})",
                self.events
            ),
        )
    }
}

/// An event as stored in a packet.
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

    /// Returns whether the event lies inside the sensor. Negative coordinates are outside too, as unsigned
    /// numbers.
    const fn is_inside(&self, sensor: Sensor) -> bool {
        sensor.contains(self.x.cast_unsigned(), self.y.cast_unsigned())
    }

    /// Converts to an [`Event`], which is valid only inside the sensor and for a time that is not negative.
    const fn event(&self) -> Event {
        Event {
            t_us: self.t.cast_unsigned(),
            x: self.x.cast_unsigned(),
            y: self.y.cast_unsigned(),
            polarity: Polarity::from_bool(self.on),
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

    fn assumptions(&self) -> &[Assumption] {
        &self.assumptions
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn leave_out_bad_events(&mut self) -> bool {
        self.leave_out = true;
        true
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        let offset = self.input.offset();
        let place = self.place(t_us);
        let Ok(Some((packet_at, events))) = place else {
            self.input.seek(offset)?;
            return place.map(|_| false);
        };
        self.input.seek(packet_at)?;
        self.elements.len = 0;
        self.events = events;
        Ok(true)
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        while batch.room() > 0 {
            if self.elements.len == 0 && !self.next_packet()? {
                break;
            }
            let count = self.elements.len.min(batch.room()).min(RUN_WORDS);
            let Vector { start, len } = self.elements;
            let bytes = self.packet.bytes().get(start..start + count * EVENT_BYTES);
            let (run, _) = bytes.unwrap_or_default().as_chunks::<EVENT_BYTES>();
            let is_sound = |event: &RawEvent| event.t >= 0 && event.is_inside(self.sensor);
            let parsed = || run.iter().map(|bytes| RawEvent::parse(*bytes));
            // Check all events, not only those up to the first invalid one: this needs no branch per event.
            let are_sound = parsed().fold(true, |sound, event| sound & is_sound(&event));
            let wrong = if are_sound {
                None
            } else {
                parsed().enumerate().find(|(_, event)| !is_sound(event))
            };
            let sound = wrong.as_ref().map_or(run.len(), |(index, _)| *index);
            let sound_run = run.get(..sound).unwrap_or_default();
            batch.extend(
                sound_run
                    .iter()
                    .map(|bytes| RawEvent::parse(*bytes).event()),
            );
            self.events += sound as u64;
            let mut taken = count;
            if let Some((index, event)) = wrong {
                let (what, kind) = if event.t < 0 {
                    ("has a negative time", "events with a negative time")
                } else {
                    ("is outside the sensor", OUTSIDE)
                };
                if !self.leave_out {
                    return Err(self.event_error(&event, what));
                }
                self.skipped.add(kind, 1);
                self.events += 1;
                taken = index + 1;
            }
            self.elements = Vector {
                start: start + taken * EVENT_BYTES,
                len: len - taken,
            };
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::format::open_source;
    use crate::{EventReader, EventWriter};

    const SENSOR: Sensor = Sensor {
        width: 64,
        height: 48,
    };

    /// Returns events of several packets, some with equal times.
    fn events() -> Vec<Event> {
        (0..100_000_u64)
            .map(|i| Event {
                t_us: 1_600_000_000_000_000 + i / 3 * 5,
                x: (i % 64) as u16,
                y: (i / 64 % 48) as u16,
                polarity: Polarity::from_bool(i % 7 < 3),
            })
            .collect()
    }

    fn file(events: &[Event]) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.aedat4");
        let mut writer: Box<dyn EventWriter> =
            Box::new(Aedat4Writer::create(&path, SENSOR).unwrap());
        writer.write(events).unwrap();
        writer.finish().unwrap();
        std::fs::read(path).unwrap()
    }

    /// Returns the position of the packet table, and the offset at which the header states it.
    fn table(bytes: &[u8]) -> (usize, usize) {
        let at = MAGIC.len() + 40;
        let position = i64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        (position as usize, at)
    }

    fn open(bytes: Vec<u8>) -> Box<dyn EventReader> {
        open_source(Box::new(Cursor::new(bytes)), "test", None).unwrap()
    }

    fn rest(reader: &mut dyn EventReader) -> Vec<Event> {
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        events
    }

    #[test]
    fn seeking_leads_to_the_packet_of_a_time() {
        let want = events();
        let mut reader = open(file(&want));
        let last_us = want.last().unwrap().t_us;
        let middle_us = want[50_000].t_us;
        // Also seeks backwards, and from the end.
        for target in [
            middle_us,
            0,
            want[0].t_us,
            middle_us + 1,
            last_us,
            want[16_384].t_us,
        ] {
            assert!(reader.seek(target).unwrap());
            let got = rest(reader.as_mut());
            let from = want.len() - got.len();
            assert_eq!(got, want[from..]);
            assert!(want[..from].iter().all(|event| event.t_us < target));
            let first = want.partition_point(|event| event.t_us < target);
            assert!(first - from < 16_384, "{target}: {from}");
        }
        assert!(reader.seek(last_us + 1).unwrap());
        assert_eq!(rest(reader.as_mut()), []);
    }

    #[test]
    fn without_a_sound_table_nothing_is_sought() {
        let want = events();
        let bytes = file(&want);
        let (table_at, position_at) = table(&bytes);
        let without = |bytes: Vec<u8>| {
            let mut reader = open(bytes);
            let mut got = Vec::new();
            reader.read(&mut got).unwrap();
            assert!(!reader.seek(want[50_000].t_us).unwrap());
            got.extend(rest(reader.as_mut()));
            assert_eq!(got, want);
        };
        // Interrupted before the table; and with a table whose position the header does not state: it ends the
        // packets.
        let mut untold = bytes.clone();
        untold[position_at..position_at + 8].copy_from_slice(&(-1_i64).to_le_bytes());
        without(untold[..table_at].to_vec());
        without(untold);
        let mut damaged = bytes.clone();
        damaged[table_at + 20] ^= 0x55;
        without(damaged);
        without([&bytes[..table_at], b"nonsense"].concat());
        // A packet is not where the table says, since the table is that of another recording.
        let other: Vec<Event> = want
            .iter()
            .map(|event| Event {
                y: event.x / 2,
                ..*event
            })
            .collect();
        let other = file(&other);
        without([&bytes[..table_at], &other[table(&other).0..]].concat());
    }

    #[test]
    fn what_is_untold_is_sought_once_its_end_was_seen() {
        let want = events();
        let mut bytes = file(&want);
        let (_, position_at) = table(&bytes);
        bytes[position_at..position_at + 8].fill(0);
        let mut reader = open(bytes);
        assert_eq!(rest(reader.as_mut()), want);
        assert!(reader.seek(want[90_000].t_us).unwrap());
        let got = rest(reader.as_mut());
        assert!(got.len() < 10_000 + 16_384 && want.ends_with(&got));
    }

    #[test]
    fn events_that_cannot_be_are_refused_and_those_before_are_given() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.aedat4");
        let stored = crate::Compression {
            code: 0,
            name: "NONE",
            compress: |bytes| Ok(bytes.to_vec()),
        };
        let mut writer = Box::new(Aedat4Writer::with_compression(&path, SENSOR, stored).unwrap());
        writer.write(&events()[..1000]).unwrap();
        writer.finish().unwrap();
        let bytes = std::fs::read(path).unwrap();
        let end = table(&bytes).0;
        // Offsets count back from the packet's end: the packet holds 1000 events and nothing after them.
        let event = |index: usize| end - (1000 - index) * EVENT_BYTES;
        for (at, value, what) in [
            (event(700) + 7, 0x80, "event 700 (t = -"),
            (event(700) + 9, 0x80, "x = -"),
            (event(700) + 8, 64, "x = 64"),
            (event(700) + 10, 48, "y = 48"),
            (event(0) + 10, 48, "event 0 "),
        ] {
            let mut bytes = bytes.clone();
            bytes[at] = value;
            let mut reader = open(bytes);
            let mut got = Vec::new();
            let error = loop {
                match reader.read(&mut got) {
                    Ok(read) => assert!(read > 0),
                    Err(error) => break error.to_string(),
                }
            };
            assert!(error.contains(what), "{error}");
            let before = if at < event(700) { 0 } else { 700 };
            assert_eq!(got, events()[..before]);
        }
    }
}
