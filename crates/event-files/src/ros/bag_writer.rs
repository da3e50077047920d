//! Writes ROS 1 bags of one topic: chunks, each with an index of its messages after it, and at the end the
//! connection and the content of each chunk.
//!
//! Chunks are not compressed, like those of `rosbag record`: every reader supports them, and a bag can be followed
//! while it is written. The bag's header is rewritten at the end; until then it states no index, which shows that
//! the bag was not closed.

use std::path::Path;

use event_types::Sensor;
use event_types::stream::Result;

use super::bag::{BAG_HEADER, CHUNK, CHUNK_INFO, CONNECTION, INDEX, MAGIC, MESSAGE};
use super::fields::Serialisation;
use super::packets::{
    DEFINITION_ROS1, MD5_ROS1, Message, MessageFile, PacketWriter, Packets, TOPIC,
};
use crate::output::sequential::Output;

/// Size in bytes at which a chunk is closed, as in `rosbag record`.
const CHUNK_BYTES: usize = 768 << 10;

/// Size in bytes of the bag's header, with its padding.
const HEADER_BYTES: usize = 4096;

/// Number of the only connection.
const CONNECTION_ID: u32 = 0;

/// A writer of ROS 1 bags with one topic of `event_camera_msgs/EventPacket`.
///
/// Events may have any order, and times up to the largest stamp of ROS 1.
pub type BagWriter = PacketWriter<Records>;

impl BagWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let file = Output::create(path)?;
        let packets = Packets::new(file.name(), sensor, Serialisation::Ros1);
        let mut file = Records {
            file,
            chunk: Vec::new(),
            messages: Vec::new(),
            chunks: Vec::new(),
        };
        file.file.put(MAGIC)?;
        file.file.put(&bag_header(0, 0))?;
        file.chunk = connection();
        Ok(Self::new(packets, file))
    }
}

/// Returns a header of fields, after its length.
fn header(fields: &[(&str, &[u8])]) -> Vec<u8> {
    let mut bytes = vec![0; 4];
    for (name, value) in fields {
        let length = (name.len() + 1 + value.len()) as u32;
        bytes.extend_from_slice(&length.to_le_bytes());
        bytes.extend_from_slice(name.as_bytes());
        bytes.push(b'=');
        bytes.extend_from_slice(value);
    }
    let length = bytes.len() as u32 - 4;
    if let Some(first) = bytes.first_chunk_mut() {
        *first = length.to_le_bytes();
    }
    bytes
}

/// Returns a record: its header, and its data after their length.
fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let mut bytes = header(fields);
    bytes.extend_from_slice(&(data.len() as u32).to_le_bytes());
    bytes.extend_from_slice(data);
    bytes
}

/// Returns the bag's first record.
fn bag_header(index: u64, chunks: u32) -> Vec<u8> {
    let connections = u32::from(index > 0);
    let fields: [(&str, &[u8]); 4] = [
        ("op", &[BAG_HEADER]),
        ("index_pos", &index.to_le_bytes()),
        ("conn_count", &connections.to_le_bytes()),
        ("chunk_count", &chunks.to_le_bytes()),
    ];
    let padding = vec![b' '; HEADER_BYTES.saturating_sub(header(&fields).len() + 4)];
    record(&fields, &padding)
}

/// Returns the connection's record.
fn connection() -> Vec<u8> {
    let topic: (&str, &[u8]) = ("topic", TOPIC.as_bytes());
    let data = header(&[
        topic,
        ("type", b"event_camera_msgs/EventPacket"),
        ("md5sum", MD5_ROS1.as_bytes()),
        ("message_definition", DEFINITION_ROS1.as_bytes()),
    ]);
    let fields: [(&str, &[u8]); 3] = [
        ("op", &[CONNECTION]),
        ("conn", &CONNECTION_ID.to_le_bytes()),
        topic,
    ];
    record(&fields, data.get(4..).unwrap_or_default())
}

/// Returns a time as seconds and nanoseconds; no message has a time whose seconds exceed 32 bits.
fn time(time_ns: u64) -> [u8; 8] {
    let [seconds, nanos] = [time_ns / 1_000_000_000, time_ns % 1_000_000_000];
    (nanos << 32 | seconds).to_le_bytes()
}

/// The place of a chunk in the file.
struct Placed {
    offset: u64,
    first_ns: u64,
    last_ns: u64,
    messages: u32,
}

/// The records of a file that is being written.
pub struct Records {
    file: Output,
    chunk: Vec<u8>,
    /// Time and position within the chunk of each message.
    messages: Vec<(u64, u32)>,
    chunks: Vec<Placed>,
}

impl MessageFile for Records {
    fn message(&mut self, message: &Message) -> Result<()> {
        // A chunk is closed long before it has 2^32 bytes.
        let at = self.chunk.len() as u32;
        self.messages.push((message.time_ns, at));
        let fields: [(&str, &[u8]); 3] = [
            ("op", &[MESSAGE]),
            ("conn", &CONNECTION_ID.to_le_bytes()),
            ("time", &time(message.time_ns)),
        ];
        self.chunk.extend(record(&fields, &message.bytes));
        if self.chunk.len() >= CHUNK_BYTES {
            self.close()?;
        }
        Ok(())
    }

    /// Writes the last chunk, the content of each chunk, and the bag's header again.
    fn finish(mut self) -> Result<()> {
        if !self.messages.is_empty() {
            self.close()?;
        }
        let index = self.file.position();
        self.file.put(&connection())?;
        let chunks = std::mem::take(&mut self.chunks);
        for chunk in &chunks {
            let fields: [(&str, &[u8]); 6] = [
                ("op", &[CHUNK_INFO]),
                ("ver", &1_u32.to_le_bytes()),
                ("chunk_pos", &chunk.offset.to_le_bytes()),
                ("start_time", &time(chunk.first_ns)),
                ("end_time", &time(chunk.last_ns)),
                ("count", &1_u32.to_le_bytes()),
            ];
            let counts = [CONNECTION_ID.to_le_bytes(), chunk.messages.to_le_bytes()];
            self.file.put(&record(&fields, &counts.concat()))?;
        }
        let header = bag_header(index, chunks.len() as u32);
        self.file.put_at(MAGIC.len() as u64, &header)?;
        self.file.finish()
    }
}

impl Records {
    /// Writes the chunk and the index of its messages.
    fn close(&mut self) -> Result<()> {
        let offset = self.file.position();
        let bytes = std::mem::take(&mut self.chunk);
        let length = bytes.len() as u32;
        let fields: [(&str, &[u8]); 3] = [
            ("op", &[CHUNK]),
            ("compression", b"none"),
            ("size", &length.to_le_bytes()),
        ];
        self.file.put(&record(&fields, &bytes))?;
        let messages = std::mem::take(&mut self.messages);
        let count = messages.len() as u32;
        let index: Vec<u8> = messages
            .iter()
            .flat_map(|(time_ns, at)| time(*time_ns).into_iter().chain(at.to_le_bytes()))
            .collect();
        let fields: [(&str, &[u8]); 4] = [
            ("op", &[INDEX]),
            ("ver", &1_u32.to_le_bytes()),
            ("conn", &CONNECTION_ID.to_le_bytes()),
            ("count", &count.to_le_bytes()),
        ];
        self.file.put(&record(&fields, &index))?;
        // The messages' times never fall.
        self.chunks.push(Placed {
            offset,
            first_ns: messages.first().map_or(0, |(time_ns, _)| *time_ns),
            last_ns: messages.last().map_or(0, |(time_ns, _)| *time_ns),
            messages: count,
        });
        Ok(())
    }
}
