//! Writes MCAP files of one topic: LZ4 chunks, each with an index of its messages after it, and the summary.
//!
//! | record | content |
//! |---|---|
//! | magic, header | profile `ros2` |
//! | chunk, index of its messages | repeated; the first chunk begins with the schema and the channel |
//! | end of the data | CRC-32 of all bytes before it |
//! | schema, channel, statistics, index of each chunk | the summary |
//! | offsets of the summary's groups | |
//! | footer, magic | the summary's offset and its CRC-32 |

use std::io::Write;
use std::path::Path;

use crc32fast::Hasher;
use event_types::Sensor;
use event_types::stream::{Context, Result};
use lz4_flex::frame::{BlockSize, FrameEncoder, FrameInfo};

use super::fields::Serialisation;
use super::mcap::{
    CHANNEL, CHUNK, CHUNK_INDEX, DATA_END, FOOTER, HEADER, MAGIC, MESSAGE, MESSAGE_INDEX, SCHEMA,
    STATISTICS, SUMMARY_OFFSET,
};
use super::packets::{
    DEFINITION_ROS2, Message, MessageFile, PacketWriter, Packets, TOPIC, TYPE_ROS2,
};
use crate::output::sequential::Output;
use crate::output::workers::Workers;

/// Size in bytes at which a chunk is closed.
const CHUNK_BYTES: usize = 1 << 20;

/// Ids of the only schema and the only channel.
const SCHEMA_ID: u16 = 1;
const CHANNEL_ID: u16 = 0;

/// A writer of MCAP files with one topic of `event_camera_msgs/EventPacket`.
///
/// Events may have any order, and times up to the largest stamp of ROS 2.
pub type McapWriter = PacketWriter<Records>;

impl McapWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let file = Records::create(path, CHUNK_BYTES)?;
        let packets = Packets::new(file.file.name(), sensor, Serialisation::Cdr);
        Ok(Self::new(packets, file))
    }
}

/// Appends the records of the schema and the channel.
fn describe(bytes: &mut Vec<u8>) {
    record(bytes, SCHEMA, &schema());
    record(bytes, CHANNEL, &channel());
}

fn schema() -> Vec<u8> {
    let mut schema = SCHEMA_ID.to_le_bytes().to_vec();
    string(&mut schema, TYPE_ROS2);
    string(&mut schema, "ros2msg");
    string(&mut schema, DEFINITION_ROS2);
    schema
}

fn channel() -> Vec<u8> {
    let mut channel = CHANNEL_ID.to_le_bytes().to_vec();
    channel.extend_from_slice(&SCHEMA_ID.to_le_bytes());
    string(&mut channel, TOPIC);
    string(&mut channel, "cdr");
    // No metadata.
    channel.extend_from_slice(&0_u32.to_le_bytes());
    channel
}

/// Appends a record to `bytes`.
fn record(bytes: &mut Vec<u8>, opcode: u8, content: &[u8]) {
    bytes.push(opcode);
    bytes.extend_from_slice(&(content.len() as u64).to_le_bytes());
    bytes.extend_from_slice(content);
}

/// Appends a string, which must be shorter than 2^32 bytes.
fn string(bytes: &mut Vec<u8>, text: &str) {
    bytes.extend_from_slice(&(text.len() as u32).to_le_bytes());
    bytes.extend_from_slice(text.as_bytes());
}

/// The chunk that is being filled.
#[derive(Default)]
struct Chunk {
    bytes: Vec<u8>,
    /// Time and position within the chunk of each message.
    messages: Vec<(u64, u64)>,
}

/// A chunk, compressed.
struct Packed {
    packed: Result<Vec<u8>, lz4_flex::frame::Error>,
    /// Size in bytes and CRC-32 of the chunk before.
    size: u64,
    crc: u32,
    messages: Vec<(u64, u64)>,
}

impl Packed {
    fn pack(chunk: Chunk) -> Self {
        let Chunk { bytes, messages } = chunk;
        // Small blocks, so that most of a chunk that was cut off can be read.
        let info = FrameInfo::new()
            .block_size(BlockSize::Max64KB)
            .content_size(Some(bytes.len() as u64));
        let mut encoder = FrameEncoder::with_frame_info(info, Vec::new());
        let packed = encoder
            .write_all(&bytes)
            .map_err(lz4_flex::frame::Error::from)
            .and_then(|()| encoder.finish());
        Self {
            packed,
            size: bytes.len() as u64,
            crc: crc32fast::hash(&bytes),
            messages,
        }
    }
}

/// The place of a chunk in the file.
struct Placed {
    first_ns: u64,
    last_ns: u64,
    offset: u64,
    length: u64,
    /// Offset of the index of its messages, and length of that record.
    index: u64,
    index_length: u64,
    packed: u64,
    size: u64,
}

/// The records of a file that is being written.
pub struct Records {
    file: Output,
    crc: Hasher,
    chunk_bytes: usize,
    chunk: Chunk,
    packing: Workers<Packed>,
    chunks: Vec<Placed>,
    messages: u64,
}

impl MessageFile for Records {
    fn message(&mut self, message: &Message) -> Result<()> {
        let Chunk { bytes, messages } = &mut self.chunk;
        messages.push((message.time_ns, bytes.len() as u64));
        bytes.push(MESSAGE);
        bytes.extend_from_slice(&(message.bytes.len() as u64 + 2 + 4 + 8 + 8).to_le_bytes());
        bytes.extend_from_slice(&CHANNEL_ID.to_le_bytes());
        // MCAP's sequence number has 32 bits and may wrap.
        bytes.extend_from_slice(&(message.sequence as u32).to_le_bytes());
        bytes.extend_from_slice(&message.time_ns.to_le_bytes());
        bytes.extend_from_slice(&message.time_ns.to_le_bytes());
        bytes.extend_from_slice(&message.bytes);
        self.messages += 1;
        if bytes.len() >= self.chunk_bytes {
            self.close()?;
        }
        Ok(())
    }

    /// Writes the last chunk and the summary.
    fn finish(mut self) -> Result<()> {
        if !self.chunk.messages.is_empty() {
            self.close()?;
        }
        while let Some(packed) = self.packing.take() {
            self.place(packed)?;
        }
        let crc = std::mem::take(&mut self.crc).finalize();
        self.record(DATA_END, &crc.to_le_bytes())?;
        let start = self.file.position();
        // The offset and length of each group are written after all of them.
        let mut groups = Vec::new();
        for (opcode, contents) in [
            (SCHEMA, vec![schema()]),
            (CHANNEL, vec![channel()]),
            (STATISTICS, vec![self.statistics()]),
            (
                CHUNK_INDEX,
                self.chunks.iter().map(Placed::content).collect(),
            ),
        ] {
            let begin = self.file.position();
            for content in contents {
                self.record(opcode, &content)?;
            }
            groups.push((opcode, begin, self.file.position() - begin));
        }
        let offsets = self.file.position();
        for (opcode, begin, length) in groups {
            let mut content = vec![opcode];
            content.extend_from_slice(&begin.to_le_bytes());
            content.extend_from_slice(&length.to_le_bytes());
            self.record(SUMMARY_OFFSET, &content)?;
        }
        // The CRC covers the footer up to the CRC itself.
        let mut footer = vec![FOOTER];
        for number in [8 + 8 + 4, start, offsets] {
            footer.extend_from_slice(&u64::to_le_bytes(number));
        }
        self.put(&footer)?;
        let crc = std::mem::take(&mut self.crc).finalize();
        self.put(&crc.to_le_bytes())?;
        self.put(MAGIC)?;
        self.file.finish()
    }
}

impl Records {
    /// Creates the file and writes its beginning; a chunk is closed once it has `chunk_bytes`.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub(super) fn create(path: &Path, chunk_bytes: usize) -> Result<Self> {
        let mut file = Self {
            file: Output::create(path)?,
            chunk_bytes,
            crc: Hasher::new(),
            chunk: Chunk::default(),
            packing: Workers::new(),
            chunks: Vec::new(),
            messages: 0,
        };
        file.put(MAGIC)?;
        let mut header = Vec::new();
        string(&mut header, "ros2");
        string(&mut header, concat!("eecvs ", env!("CARGO_PKG_VERSION")));
        file.record(HEADER, &header)?;
        describe(&mut file.chunk.bytes);
        Ok(file)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.crc.update(bytes);
        self.file.put(bytes)
    }

    fn record(&mut self, opcode: u8, content: &[u8]) -> Result<()> {
        let mut head = vec![opcode];
        head.extend_from_slice(&(content.len() as u64).to_le_bytes());
        self.put(&head)?;
        self.put(content)
    }

    /// Closes the chunk.
    fn close(&mut self) -> Result<()> {
        let chunk = std::mem::take(&mut self.chunk);
        let packed = self.packing.give(|| Packed::pack(chunk));
        packed.map_or(Ok(()), |packed| self.place(packed))
    }

    /// Writes a chunk and the index of its messages.
    fn place(&mut self, packed: Packed) -> Result<()> {
        let Packed {
            packed,
            size,
            crc,
            messages,
        } = packed;
        let packed = packed
            .with_context(|| format!("{}: a chunk cannot be compressed", self.file.name()))?;
        // The messages' times never fall.
        let first_ns = messages.first().map_or(0, |(time_ns, _)| *time_ns);
        let last_ns = messages.last().map_or(0, |(time_ns, _)| *time_ns);
        let mut content = Vec::new();
        for number in [first_ns, last_ns, size] {
            content.extend_from_slice(&number.to_le_bytes());
        }
        content.extend_from_slice(&crc.to_le_bytes());
        string(&mut content, "lz4");
        content.extend_from_slice(&(packed.len() as u64).to_le_bytes());
        content.extend_from_slice(&packed);
        let offset = self.file.position();
        self.record(CHUNK, &content)?;
        let index = self.file.position();
        let mut content = CHANNEL_ID.to_le_bytes().to_vec();
        content.extend_from_slice(&(messages.len() as u32 * 16).to_le_bytes());
        for (time_ns, at) in &messages {
            content.extend_from_slice(&time_ns.to_le_bytes());
            content.extend_from_slice(&at.to_le_bytes());
        }
        self.record(MESSAGE_INDEX, &content)?;
        self.chunks.push(Placed {
            first_ns,
            last_ns,
            offset,
            length: index - offset,
            index,
            index_length: self.file.position() - index,
            packed: packed.len() as u64,
            size,
        });
        Ok(())
    }

    fn statistics(&self) -> Vec<u8> {
        let mut content = self.messages.to_le_bytes().to_vec();
        // Numbers of schemas and channels; of attachments, metadata and chunks.
        content.extend_from_slice(&1_u16.to_le_bytes());
        for count in [1, 0, 0, self.chunks.len() as u32] {
            content.extend_from_slice(&count.to_le_bytes());
        }
        let first_ns = self.chunks.first().map_or(0, |chunk| chunk.first_ns);
        let last_ns = self.chunks.last().map_or(0, |chunk| chunk.last_ns);
        content.extend_from_slice(&first_ns.to_le_bytes());
        content.extend_from_slice(&last_ns.to_le_bytes());
        // Number of messages of each channel.
        content.extend_from_slice(&10_u32.to_le_bytes());
        content.extend_from_slice(&CHANNEL_ID.to_le_bytes());
        content.extend_from_slice(&self.messages.to_le_bytes());
        content
    }
}

impl Placed {
    /// Returns the content of this chunk's index record.
    fn content(&self) -> Vec<u8> {
        let mut content = Vec::new();
        let numbers = [self.first_ns, self.last_ns, self.offset, self.length];
        for number in numbers {
            content.extend_from_slice(&number.to_le_bytes());
        }
        content.extend_from_slice(&10_u32.to_le_bytes());
        content.extend_from_slice(&CHANNEL_ID.to_le_bytes());
        content.extend_from_slice(&self.index.to_le_bytes());
        content.extend_from_slice(&self.index_length.to_le_bytes());
        string(&mut content, "lz4");
        content.extend_from_slice(&self.packed.to_le_bytes());
        content.extend_from_slice(&self.size.to_le_bytes());
        content
    }
}
