//! Reads ROS 2 bags in MCAP files (`.mcap`), by the specification at mcap.dev.
//!
//! A file is 8 bytes of magic, then records: u8 opcode, u64 length, content; little-endian, strings with a u32
//! length. The opcodes are 3 schema (u16 id, name, encoding, definition), 4 channel (u16 id, u16 schema, topic,
//! message encoding, map), 5 message (u16 channel, u32 sequence, u64 log time and u64 publish time in ns, data), 6
//! chunk (u64 first and last time, u64 size, u32 CRC, compression: none, `lz4` or `zstd`, u64 length, records), F
//! end of the data, 2 footer. The data of a message is CDR, or serialised as in ROS 1 if the channel's encoding is
//! `ros1`, as in a converted ROS 1 bag.
//!
//! Records are read one after another up to the end of the data, so that a file without a summary, cut off or still
//! being written, is read as far as it goes. The summary states where chunks are, for seeking. If a chunk has a
//! CRC, it is checked before the chunk's records are read. The reader holds one message and, if it is compressed,
//! one chunk.
//!
//! The crate `mcap` is not used: it builds two C libraries for its compressions, and three stacks of derive macros
//! without them. Its Python counterpart checks this reader in the tests.

use event_types::Sensor;
use event_types::stream::Result;

use super::chunk::Chunked;
use super::decoder::{Messages, RosReader, Uses};
use super::fields::{Fields, Serialisation};
pub use super::mcap_writer::McapWriter;
use super::message::Kind;
use super::packets::t_max_us;
use super::topics::{Topics, Use};
use crate::Skipped;
use crate::format::{Format, Limits, Opening};
use crate::input::following::{ANOTHER, SEARCHED_BYTES};
use crate::input::{Input, ReadSeek};

/// First and last bytes of every file.
pub const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

/// The last bytes of a file and the first bytes of another file that was appended to it.
const JOINED: &[u8] = b"\x89MCAP0\r\n\x89MCAP0\r\n";

/// Longest schema or channel, in bytes.
const DESCRIPTION_MAX: u64 = 1 << 20;

/// Longest name of a type, in bytes, since memory is kept for each.
const NAME_MAX: usize = 1 << 10;

// Kinds of records.
pub(super) const HEADER: u8 = 0x01;
pub(super) const FOOTER: u8 = 0x02;
pub(super) const SCHEMA: u8 = 0x03;
pub(super) const CHANNEL: u8 = 0x04;
pub(super) const MESSAGE: u8 = 0x05;
pub(super) const CHUNK: u8 = 0x06;
pub(super) const MESSAGE_INDEX: u8 = 0x07;
pub(super) const CHUNK_INDEX: u8 = 0x08;
pub(super) const STATISTICS: u8 = 0x0b;
pub(super) const SUMMARY_OFFSET: u8 = 0x0e;
pub(super) const DATA_END: u8 = 0x0f;

/// Size in bytes of the footer record and the magic after it.
const FOOTER_BYTES: u64 = 1 + 8 + 8 + 8 + 4 + 8;

/// Size in bytes of a message's head before its data.
const MESSAGE_HEAD: u64 = 2 + 4 + 8 + 8;

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "mcap",
    title: "ROS 2 bag in MCAP",
    endings: &[".mcap"],
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
        t_max_us: t_max_us(Serialisation::Cdr),
        ..Limits::NONE
    },
    create: Some(|path, sensor| Ok(Box::new(McapWriter::create(path, sensor)?))),
};

/// Reads the file `source`, which messages call `name`, like [`RosReader::new`].
///
/// # Errors
/// Those of [`RosReader::new`]; `source` is not an MCAP file.
pub fn open(
    source: Box<dyn ReadSeek>,
    name: &str,
    place: Option<&str>,
    size: Option<Sensor>,
) -> Result<RosReader> {
    RosReader::new(Box::new(Mcap::new(source, name)?), place, size)
}

/// The messages of an MCAP file.
pub struct Mcap {
    bytes: Chunked,
    /// Names of types, by the id of their schema.
    schemas: std::collections::HashMap<u16, String>,
    channels: Uses,
    /// Channels whose messages are serialised as in ROS 1.
    ros1: std::collections::HashSet<u16>,
    content: Vec<u8>,
    /// Offset of the latest record.
    at: u64,
    ended: bool,
    /// Places where reading can begin, once they have been requested.
    places: Option<Vec<u64>>,
    /// Number of messages read; `None` after a seek, when it cannot be compared with the summary's.
    messages: Option<u64>,
}

impl Mcap {
    /// Begins at the first record.
    ///
    /// # Errors
    /// `source` is not an MCAP file of version 0.
    pub fn new(source: Box<dyn ReadSeek>, name: &str) -> Result<Self> {
        let mut input = Input::new(source, name)?;
        let mut start = [0; MAGIC.len()];
        if input.fill(&mut start)? < start.len() || &start != MAGIC {
            return Err(input.error_at(0, "not an MCAP file of version 0"));
        }
        Ok(Self {
            bytes: Chunked::new(input),
            schemas: std::collections::HashMap::new(),
            channels: Uses::new(),
            ros1: std::collections::HashSet::new(),
            content: Vec::new(),
            at: 0,
            ended: false,
            places: None,
            messages: Some(0),
        })
    }

    fn damaged(&self, what: &str) -> event_types::stream::Error {
        self.bytes.input.error_at(self.at, what)
    }

    /// Adds a schema or a channel; the error is what is wrong with it.
    fn describe(&mut self, opcode: u8, topics: &mut Topics) -> Result<(), String> {
        // The content is laid out like a message of ROS 1.
        let mut fields = Fields::new(&self.content, Serialisation::Ros1)?;
        let id = fields.u16()?;
        if opcode == SCHEMA {
            let name = fields.string()?;
            if name.len() > NAME_MAX {
                return Err("a schema's name is too long: it is damaged".to_owned());
            }
            self.schemas.insert(id, name.to_owned());
            return Ok(());
        }
        let schema = fields.u16()?;
        let (topic, encoding) = (fields.string()?, fields.string()?);
        let kind = self.schemas.get(&schema).map_or("", String::as_str);
        let uses = topics.meet(topic, kind)?;
        if let Use::Read(_) = uses
            && !matches!(encoding, "cdr" | "ros1")
        {
            return Err(format!(
                "topic {topic:?} is serialised as {encoding:?}: record it as cdr or ros1"
            ));
        }
        if encoding == "ros1" {
            self.ros1.insert(id);
        } else {
            self.ros1.remove(&id);
        }
        self.channels.insert(id.into(), uses);
        Ok(())
    }

    /// Returns the offsets of the first record and the chunks, if the summary lists all chunks and channels.
    fn index(&mut self, topics: &mut Topics) -> Result<Option<Vec<u64>>> {
        let summary = self.find_summary()?;
        Ok(summary.and_then(|(start, summary)| self.summary(&summary, start, topics)))
    }

    /// Checks what follows the end of the data: that the summary counts as many messages as were read, and that no
    /// other file was appended.
    fn check_end(&mut self) -> Result<()> {
        let start = self.bytes.offset();
        let behind = self
            .bytes
            .peek(start, start.saturating_add(SEARCHED_BYTES))?;
        let behind = behind.unwrap_or_default();
        let mut places = behind.windows(JOINED.len());
        if let Some(end) = places.position(|bytes| bytes == JOINED) {
            let another = start + (end + MAGIC.len()) as u64;
            return Err(self.bytes.input.error_at(another, ANOTHER));
        }
        let Some((_, summary)) = self.find_summary()? else {
            return Ok(());
        };
        let counted = records(&summary).find(|(opcode, _)| *opcode == STATISTICS);
        let counted = counted.and_then(|(_, content)| content.first_chunk().copied());
        match (self.messages, counted.map(u64::from_le_bytes)) {
            (Some(messages), Some(counted)) if messages != counted => Err(self.damaged(&format!(
                "the summary counts {counted} messages, but {messages} come before it: the file is \
                 damaged"
            ))),
            _ => Ok(()),
        }
    }

    /// Returns the offset of the summary and its bytes, if there is one.
    fn find_summary(&mut self) -> Result<Option<(u64, Vec<u8>)>> {
        let length = self.bytes.length()?;
        let Some(footer) = length.checked_sub(FOOTER_BYTES) else {
            return Ok(None);
        };
        let bytes = self.bytes.peek(footer, length)?.unwrap_or_default();
        let [FOOTER, 20, 0, 0, 0, 0, 0, 0, 0, rest @ ..] = bytes.as_slice() else {
            return Ok(None);
        };
        let start = rest.first_chunk().copied().map_or(0, u64::from_le_bytes);
        if start == 0 || start > footer || !bytes.ends_with(MAGIC) {
            return Ok(None);
        }
        let summary = self.bytes.peek(start, footer)?;
        Ok(summary.map(|summary| (start, summary)))
    }

    /// Returns the places of [`Mcap::index`] from the records of the summary, which begins at `start`.
    fn summary(&mut self, summary: &[u8], start: u64, topics: &mut Topics) -> Option<Vec<u64>> {
        let mut places = vec![MAGIC.len() as u64];
        // A file without channels has no events either.
        let mut channels = 1;
        let mut bytes = 0;
        for (opcode, content) in records(summary) {
            bytes += 1 + 8 + content.len();
            match opcode {
                SCHEMA | CHANNEL => {
                    self.content.clear();
                    self.content.extend_from_slice(content);
                    self.describe(opcode, topics).ok()?;
                }
                STATISTICS => {
                    // After the numbers of messages and of schemas.
                    let count = content.get(8 + 2..)?.first_chunk()?;
                    channels = u32::from_le_bytes(*count);
                }
                CHUNK_INDEX => {
                    // After the first and the last time.
                    let place = content.get(8 + 8..)?.first_chunk()?;
                    places.push(u64::from_le_bytes(*place));
                }
                _ => {}
            }
        }
        if bytes < summary.len() {
            return None;
        }
        places.sort_unstable();
        let inside = places.last().is_some_and(|last| *last < start);
        // Messages of a channel that only an earlier chunk introduces would be taken for unknown.
        let known = self.channels.len() as u64 >= u64::from(channels);
        (places.len() > 1 && inside && known).then_some(places)
    }

    /// Reads a chunk's head and enters the chunk.
    fn enter(&mut self, length: u64) -> Result<()> {
        // Times, size, CRC, length of the compression's name.
        self.bytes.take(&mut self.content, 8 + 8 + 8 + 4 + 4)?;
        let mut fields =
            Fields::new(&self.content, Serialisation::Ros1).map_err(|what| self.damaged(&what))?;
        let mut numbers = || {
            fields.bytes(16)?;
            Ok((fields.u64()?, fields.u32()?, fields.u32()?))
        };
        let (size, crc, name) = numbers().map_err(|what: String| self.damaged(&what))?;
        if name > 64 {
            return Err(
                self.damaged("the name of a chunk's compression is too long: it is damaged")
            );
        }
        self.bytes.take(&mut self.content, name.into())?;
        let compression = String::from_utf8_lossy(&self.content).into_owned();
        self.bytes.take(&mut self.content, 8)?;
        let packed = self.content.first_chunk().copied().unwrap_or_default();
        let packed = u64::from_le_bytes(packed);
        if packed.checked_add(8 + 8 + 8 + 4 + 4 + u64::from(name) + 8) != Some(length) {
            return Err(self.damaged("a chunk's lengths disagree: it is damaged"));
        }
        self.bytes.enter(&compression, packed, size)?;
        // 0 means that the writer computed none.
        if crc != 0 {
            self.bytes.check(crc, size)?;
        }
        Ok(())
    }
}

/// Returns the records of a summary, as opcode and content, up to the first that is incomplete.
fn records(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (opcode, rest) = bytes.split_first()?;
        let (length, rest) = rest.split_first_chunk()?;
        let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
        let (content, rest) = rest.split_at_checked(length)?;
        bytes = rest;
        Some((*opcode, content))
    })
}

impl Messages for Mcap {
    fn format(&self) -> &'static str {
        FORMAT.name
    }

    fn next(
        &mut self,
        message: &mut Vec<u8>,
        topics: &mut Topics,
        skipped: &mut Skipped,
    ) -> Result<Option<(Kind, Serialisation)>> {
        while !self.ended {
            let more = self.bytes.more()?;
            self.at = self.bytes.offset();
            if !more {
                return Err(self.damaged(
                    "the file ends without the end of its data: the recording was cut off; \
                     everything before can be used",
                ));
            }
            self.bytes.take(&mut self.content, 1 + 8)?;
            let Some((opcode, length)) = self.content.split_first() else {
                continue;
            };
            let opcode = *opcode;
            let length = u64::from_le_bytes(length.try_into().unwrap_or_default());
            match opcode {
                DATA_END | FOOTER => {
                    self.ended = true;
                    self.check_end()?;
                }
                CHUNK => self.enter(length)?,
                SCHEMA | CHANNEL => {
                    if length > DESCRIPTION_MAX {
                        return Err(self.damaged("a schema or channel is too long: damaged"));
                    }
                    self.bytes.take(&mut self.content, length)?;
                    self.describe(opcode, topics)
                        .map_err(|what| self.damaged(&what))?;
                }
                MESSAGE => {
                    self.messages = self.messages.map(|messages| messages + 1);
                    let data = length.checked_sub(MESSAGE_HEAD);
                    let data =
                        data.ok_or_else(|| self.damaged("a message is too short: damaged"))?;
                    self.bytes.take(&mut self.content, MESSAGE_HEAD)?;
                    let channel = self.content.first_chunk().copied().unwrap_or_default();
                    let channel = u16::from_le_bytes(channel);
                    let serialisation = match self.ros1.contains(&channel) {
                        true => Serialisation::Ros1,
                        false => Serialisation::Cdr,
                    };
                    match self.channels.get(&channel.into()) {
                        Some(Use::Read(kind)) => {
                            let kind = *kind;
                            self.at = self.bytes.offset();
                            self.bytes.take(message, data)?;
                            return Ok(Some((kind, serialisation)));
                        }
                        Some(Use::Skip(what)) => skipped.add(what, 1),
                        None => skipped.add("messages of unknown channels", 1),
                    }
                    self.bytes.skip(data)?;
                }
                _ => self.bytes.skip(length)?,
            }
        }
        Ok(None)
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
        if let Some(offset) = places.get(place) {
            self.bytes.go(*offset)?;
            self.ended = false;
            self.messages = None;
        }
        Ok(())
    }

    fn error(&self, at: usize, what: &str) -> event_types::stream::Error {
        if self.bytes.inside() {
            return self.damaged(&format!("byte {at} of a message in this chunk: {what}"));
        }
        self.bytes.input.error_at(self.at + at as u64, what)
    }
}
