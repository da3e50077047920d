//! Reads ROS 1 bags, version 2.0 (`.bag`), by the ROS wiki's "Bags/Format/2.0".
//!
//! A bag is `#ROSBAG V2.0\n`, then records: u32 length of the header, the header (fields of u32 length,
//! `name=value`), u32 length of the data, the data; little-endian. The field `op` is the kind of record: 2 message
//! (`conn`, `time`), 3 bag header, 4 index of a chunk, 5 chunk (`compression`: none, lz4 frames or bz2; `size` when
//! decompressed) whose data is records, 6 chunk info, 7 connection (`conn`, `topic`, and `type` in the data).
//!
//! Records are read one after another, so that a bag that was never closed (`.bag.active`) or was cut off is read
//! as far as it goes; indexes are used only for seeking. A bag that is still being written can be read likewise,
//! unless its chunks are compressed, since `rosbag record` writes a chunk's length only when it is full. The reader
//! holds one message and, if it is compressed, one chunk.

use event_types::Sensor;
use event_types::stream::Result;

pub use super::bag_writer::BagWriter;
use super::chunk::Chunked;
use super::decoder::{Messages, RosReader, Uses};
use super::fields::Serialisation;
use super::message::Kind;
use super::packets::t_max_us;
use super::topics::{Topics, Use};
use crate::Skipped;
use crate::format::{Format, Limits, Opening};
use crate::input::{Input, ReadSeek};

/// First bytes of every bag.
pub const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

/// Longest header of a record, in bytes.
const HEADER_MAX: u32 = 1 << 16;

/// Size in bytes of the bag's first record, with its padding.
const HEADER_BYTES: u64 = 4096;

/// Longest data of a connection record, in bytes; message definitions have a few kB.
const CONNECTION_MAX: u32 = 1 << 20;

/// Largest number of connections, since memory is kept for each.
const CONNECTIONS_MAX: usize = 1 << 16;

// Kinds of records.
pub(super) const MESSAGE: u8 = 2;
pub(super) const BAG_HEADER: u8 = 3;
pub(super) const INDEX: u8 = 4;
pub(super) const CHUNK: u8 = 5;
pub(super) const CHUNK_INFO: u8 = 6;
pub(super) const CONNECTION: u8 = 7;

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "rosbag",
    title: "ROS 1 bag",
    endings: &[".bag"],
    detect: |start| start.begins(MAGIC),
    open: |opening| {
        let Opening {
            name,
            place,
            reading,
            ..
        } = opening;
        Ok(Box::new(open(opening.source, name, place, reading.size)?))
    },
    has_places: true,
    is_table: false,
    grows: true,
    streams: false,
    limits: Limits {
        t_max_us: t_max_us(Serialisation::Ros1),
        ..Limits::NONE
    },
    create: Some(|path, sensor| Ok(Box::new(BagWriter::create(path, sensor)?))),
};

/// Reads the bag `source`, which messages call `name`, like [`RosReader::new`].
///
/// # Errors
/// Those of [`RosReader::new`]; `source` is not a bag of version 2.0.
pub fn open(
    source: Box<dyn ReadSeek>,
    name: &str,
    place: Option<&str>,
    size: Option<Sensor>,
) -> Result<RosReader> {
    RosReader::new(Box::new(Bag::new(source, name)?), place, size)
}

/// The messages of a ROS 1 bag.
pub struct Bag {
    bytes: Chunked,
    connections: Uses,
    header: Vec<u8>,
    /// Offset of the latest record's data.
    at: u64,
    /// Places where reading can begin, once they have been requested.
    places: Option<Vec<u64>>,
}

impl Bag {
    /// Begins at the first record.
    ///
    /// # Errors
    /// `source` is not a bag of version 2.0.
    pub fn new(source: Box<dyn ReadSeek>, name: &str) -> Result<Self> {
        let mut input = Input::new(source, name)?;
        let mut start = vec![0; MAGIC.len()];
        if input.fill(&mut start)? < start.len() || start != MAGIC {
            return Err(input.error_at(0, "not a bag of version 2.0 (#ROSBAG V2.0)"));
        }
        Ok(Self {
            bytes: Chunked::new(input),
            connections: Uses::new(),
            header: Vec::new(),
            at: 0,
            places: None,
        })
    }

    fn length(&mut self) -> Result<u32> {
        self.bytes.take(&mut self.header, 4)?;
        let bytes = self.header.first_chunk().copied().unwrap_or_default();
        Ok(u32::from_le_bytes(bytes))
    }

    fn damaged(&self, what: &str) -> event_types::stream::Error {
        self.bytes.input.error_at(self.at, what)
    }

    /// Returns a field of the latest header, of `N` bytes.
    fn number<const N: usize>(&self, name: &str) -> Result<[u8; N]> {
        let value = field(&self.header, name).and_then(|value| value.try_into().ok());
        value.ok_or_else(|| self.damaged(&format!("a record without {name}: it is damaged")))
    }

    /// Adds a connection, whose record's header is the latest one.
    fn connect(&mut self, data: &[u8], topics: &mut Topics) -> Result<()> {
        if self.connections.len() >= CONNECTIONS_MAX {
            return Err(self.damaged("too many connections: it is damaged"));
        }
        let connection = u32::from_le_bytes(self.number("conn")?);
        let topic = self.text(&self.header, "topic")?;
        let kind = self.text(data, "type")?;
        // Every connection occurs again at the end of the bag.
        let uses = topics
            .meet(&topic, &kind)
            .map_err(|what| self.damaged(&what))?;
        self.connections.insert(connection.into(), uses);
        Ok(())
    }

    /// Returns the offsets of the first record and the chunks, if the bag was closed and its index lists all chunks
    /// and connections.
    fn index(&mut self, topics: &mut Topics) -> Result<Option<Vec<u64>>> {
        let start = MAGIC.len() as u64;
        let head = self.bytes.peek(start, start + HEADER_BYTES)?;
        let head = head.unwrap_or_default();
        let Some((header, _)) = split(&head) else {
            return Ok(None);
        };
        let index = field(header, "index_pos").and_then(|value| value.try_into().ok());
        let count = |name| field(header, name).and_then(|value| value.try_into().ok());
        let (Some(index), Some(connections), Some(chunks)) =
            (index, count("conn_count"), count("chunk_count"))
        else {
            return Ok(None);
        };
        let index = u64::from_le_bytes(index);
        if index <= start {
            return Ok(None);
        }
        let Some(records) = self.bytes.peek(index, u64::MAX)? else {
            return Ok(None);
        };
        let mut places = vec![start];
        let mut rest = records.as_slice();
        while let Some((header, behind)) = split(rest) {
            let Some((data, behind)) = split(behind) else {
                break;
            };
            rest = behind;
            self.header.clear();
            self.header.extend_from_slice(header);
            match self.number("op") {
                Ok([CONNECTION]) if self.connect(data, topics).is_ok() => {}
                Ok([CHUNK_INFO]) => match self.number("chunk_pos") {
                    Ok(place) => places.push(u64::from_le_bytes(place)),
                    Err(_) => return Ok(None),
                },
                _ => return Ok(None),
            }
        }
        places.sort_unstable();
        // Messages of a connection that only an earlier chunk introduces would be taken for unknown.
        let known = self.connections.len() as u64 >= u64::from(u32::from_le_bytes(connections));
        let whole = places.len() as u64 == u64::from(u32::from_le_bytes(chunks)) + 1;
        let inside = places.last().is_some_and(|last| *last < index);
        let usable = rest.is_empty() && known && whole && inside;
        Ok(usable.then_some(places))
    }

    fn text(&self, bytes: &[u8], name: &str) -> Result<String> {
        let value = field(bytes, name).and_then(|value| std::str::from_utf8(value).ok());
        let value = value.map(str::to_owned);
        value.ok_or_else(|| self.damaged(&format!("a record without {name}: it is damaged")))
    }
}

/// Splits off the bytes that follow a 32-bit length; returns them and the rest.
fn split(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)
}

/// Returns the value of a field of a header.
fn field<'a>(mut header: &'a [u8], name: &str) -> Option<&'a [u8]> {
    while let Some((length, rest)) = header.split_first_chunk() {
        let length = usize::try_from(u32::from_le_bytes(*length)).ok()?;
        let (field, rest) = rest.split_at_checked(length)?;
        let equals = field.iter().position(|byte| *byte == b'=')?;
        let (key, value) = field.split_at_checked(equals)?;
        if key == name.as_bytes() {
            return value.get(1..);
        }
        header = rest;
    }
    None
}

impl Messages for Bag {
    fn format(&self) -> &'static str {
        FORMAT.name
    }

    fn next(
        &mut self,
        message: &mut Vec<u8>,
        topics: &mut Topics,
        skipped: &mut Skipped,
    ) -> Result<Option<(Kind, Serialisation)>> {
        loop {
            if !self.bytes.more()? {
                return Ok(None);
            }
            self.at = self.bytes.offset();
            let length = self.length()?;
            if length > HEADER_MAX {
                return Err(self.damaged(&format!(
                    "a record's header of {length} bytes: it is damaged"
                )));
            }
            self.bytes.take(&mut self.header, length.into())?;
            let mut header = std::mem::take(&mut self.header);
            let length = self.length()?;
            std::mem::swap(&mut self.header, &mut header);
            self.at = self.bytes.offset();
            match self.number("op")? {
                [MESSAGE] => {
                    let connection = u32::from_le_bytes(self.number("conn")?);
                    match self.connections.get(&connection.into()) {
                        Some(Use::Read(kind)) => {
                            let kind = *kind;
                            self.bytes.take(message, length.into())?;
                            return Ok(Some((kind, Serialisation::Ros1)));
                        }
                        Some(Use::Skip(what)) => skipped.add(what, 1),
                        None => skipped.add("messages of unknown connections", 1),
                    }
                    self.bytes.skip(length.into())?;
                }
                [CHUNK] => {
                    let size = u32::from_le_bytes(self.number("size")?);
                    let compression = self.text(&self.header, "compression")?;
                    self.bytes.enter(&compression, length.into(), size.into())?;
                }
                [CONNECTION] => {
                    if length > CONNECTION_MAX {
                        return Err(self.damaged("a connection is too long: it is damaged"));
                    }
                    self.bytes.take(message, length.into())?;
                    self.connect(message, topics)?;
                }
                _ => self.bytes.skip(length.into())?,
            }
        }
    }

    fn places(&mut self, topics: &mut Topics) -> Result<Option<u64>> {
        if self.places.is_none() {
            self.places = self.index(topics)?;
        }
        Ok(self.places.as_ref().map(|places| places.len() as u64))
    }

    fn go(&mut self, place: u64, _: &mut Topics) -> Result<()> {
        let place = usize::try_from(place).unwrap_or(usize::MAX);
        let places = self.places.as_deref().unwrap_or_default();
        match places.get(place) {
            Some(offset) => self.bytes.go(*offset),
            None => Ok(()),
        }
    }

    fn error(&self, at: usize, what: &str) -> event_types::stream::Error {
        let (inside, at) = (self.bytes.inside(), at as u64);
        if inside {
            return self.damaged(&format!("byte {at} of a message in this chunk: {what}"));
        }
        self.bytes.input.error_at(self.at + at, what)
    }
}
