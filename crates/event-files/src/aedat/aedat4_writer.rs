//! Writer of AEDAT 4.0 files: one event stream, by default in LZ4 frames with checksums, and a packet table.

use std::cell::RefCell;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Event, Polarity, Sensor};
use lz4_flex::frame::{FrameEncoder, FrameInfo};

use crate::aedat::aedat4::{EVENT_BYTES, MAGIC};
use crate::output::workers::Workers;
use crate::{BATCH_EVENTS, EventWriter, create_file};

/// Message for a packet or a file that exceeds the format's fields.
const TOO_LARGE: &str = "AEDAT 4: the packet or the file is too large";

/// Largest number of events in a packet: 256 KiB before compression.
const PACKET_EVENTS: usize = BATCH_EVENTS;

/// Bytes of an event packet before its events.
const PACKET_HEAD_BYTES: usize = 32;

/// Bytes of the largest packet.
const PACKET_BYTES: usize = PACKET_HEAD_BYTES + PACKET_EVENTS * EVENT_BYTES;

/// Number of the stream, in the XML and in every packet.
const STREAM: i32 = 0;

/// Offset in the file of the packet table's position.
const TABLE_POSITION_AT: u64 = MAGIC.len() as u64 + 40;

/// A compression in which [`Aedat4Writer`] writes packets.
#[derive(Debug, Clone, Copy)]
pub struct Compression {
    /// Number of the compression in the format.
    pub code: i32,
    /// Name of the compression in the format.
    pub name: &'static str,
    /// Compresses bytes to one frame.
    pub compress: fn(&[u8]) -> Result<Vec<u8>>,
}

impl Compression {
    /// LZ4 frames with a checksum of their content.
    pub const LZ4: Self = Self {
        code: 1,
        name: "LZ4",
        compress: lz4,
    };
}

fn lz4(bytes: &[u8]) -> Result<Vec<u8>> {
    thread_local! {
        /// This thread's latest encoder, with the length of its content. The system would clear the memory
        /// of its buffers anew for every packet; its size of blocks is that of its first content, so that it serves those
        /// of the same length alone: most packets are full.
        static LATEST: RefCell<Option<(usize, FrameEncoder<Vec<u8>>)>> = const { RefCell::new(None) };
    }
    let latest = LATEST.take().filter(|(length, _)| *length == bytes.len());
    let mut encoder = latest.map_or_else(
        || {
            let info = FrameInfo::new().content_checksum(true);
            FrameEncoder::with_frame_info(info, Vec::new())
        },
        |(_, encoder)| encoder,
    );
    encoder.get_mut().reserve_exact(bytes.len());
    encoder.write_all(bytes).context("LZ4")?;
    encoder.try_finish().context("LZ4")?;
    let content = std::mem::take(encoder.get_mut());
    // Not one that failed, nor one of an empty frame, which it would not begin a second time.
    LATEST.set((!bytes.is_empty()).then_some((bytes.len(), encoder)));
    Ok(content)
}

/// A packet's entry in the packet table.
struct Packet {
    /// Offset of the packet's content, after its 8-byte header.
    content_at: u64,
    size: i32,
    events: u32,
    first_us: i64,
    last_us: i64,
}

/// A packet's content, compressed, with its number of events, and first and last time.
struct Compressed {
    content: Result<Vec<u8>>,
    /// The memory of the packet.
    memory: Vec<u8>,
    events: u32,
    first_us: i64,
    last_us: i64,
}

/// A writer of AEDAT 4.0 files, for times up to 2^63 - 1 us in any order.
///
/// It holds one packet, those that are being compressed on other threads (at most nine), the memory of as many for those
/// to come, and 32 bytes for every packet written (16,384 events). Each thread that compresses keeps its encoder, whose
/// buffers have room for 2 MB; that of the caller's thread outlives the writer.
pub struct Aedat4Writer {
    file: BufWriter<File>,
    name: String,
    sensor: Sensor,
    compression: Compression,
    position: u64,
    /// The packet being filled: room for its head, and its events as they will be stored.
    pending: Vec<u8>,
    /// Memory of packets that are written.
    spare: Vec<Vec<u8>>,
    first_us: i64,
    last_us: i64,
    compressing: Workers<Compressed>,
    packets: Vec<Packet>,
    events: u64,
}

impl Aedat4Writer {
    /// Creates a file whose packets are compressed with LZ4.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        Self::with_compression(path, sensor, Compression::LZ4)
    }

    /// Creates a file whose packets are compressed with `compression`.
    ///
    /// # Errors
    /// I/O.
    pub fn with_compression(path: &Path, sensor: Sensor, compression: Compression) -> Result<Self> {
        let (file, name) = create_file(path)?;
        let mut writer = Self {
            file,
            name,
            sensor,
            compression,
            position: 0,
            pending: new_packet(Vec::new()),
            spare: Vec::new(),
            first_us: i64::MAX,
            last_us: i64::MIN,
            compressing: Workers::new(),
            packets: Vec::new(),
            events: 0,
        };
        writer.put(MAGIC)?;
        writer.put(&io_header(sensor, compression))?;
        Ok(writer)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.position += bytes.len() as u64;
        self.file
            .write_all(bytes)
            .with_context(|| format!("{}: cannot be written", self.name))
    }

    fn close_packet(&mut self) -> Result<()> {
        let events = self.pending.len().saturating_sub(PACKET_HEAD_BYTES) / EVENT_BYTES;
        let events = u32::try_from(events).context(TOO_LARGE)?;
        if events == 0 {
            return Ok(());
        }
        let next = new_packet(self.spare.pop().unwrap_or_default());
        let pending = std::mem::replace(&mut self.pending, next);
        let (first_us, last_us) = (self.first_us, self.last_us);
        (self.first_us, self.last_us) = (i64::MAX, i64::MIN);
        let compress = self.compression.compress;
        let compressed = self.compressing.give(move || {
            let packet = event_packet(pending, events);
            Compressed {
                content: compress(&packet),
                memory: packet,
                events,
                first_us,
                last_us,
            }
        });
        compressed.map_or(Ok(()), |compressed| self.place(compressed))
    }

    /// Writes a packet.
    fn place(&mut self, compressed: Compressed) -> Result<()> {
        let Compressed {
            content,
            memory,
            events,
            first_us,
            last_us,
        } = compressed;
        self.spare.push(memory);
        let content = self.compressed(content)?;
        let size = i32::try_from(content.len()).context(TOO_LARGE)?;
        self.put(&STREAM.to_le_bytes())?;
        self.put(&size.to_le_bytes())?;
        let content_at = self.position;
        self.put(&content)?;
        self.packets.push(Packet {
            content_at,
            size,
            events,
            first_us,
            last_us,
        });
        Ok(())
    }

    fn compressed(&self, compressed: Result<Vec<u8>>) -> Result<Vec<u8>> {
        compressed.with_context(|| format!("{}: compression failed", self.name))
    }
}

impl EventWriter for Aedat4Writer {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            crate::check_inside(&self.name, self.events, event, self.sensor)?;
            let t = crate::signed_us(&self.name, self.events, event.t_us)?;
            self.first_us = self.first_us.min(t);
            self.last_us = self.last_us.max(t);
            self.pending.extend_from_slice(&t.to_le_bytes());
            // Both are below 2048, where i16 and u16 have the same bytes.
            self.pending.extend_from_slice(&event.x.to_le_bytes());
            self.pending.extend_from_slice(&event.y.to_le_bytes());
            self.pending
                .extend_from_slice(&[u8::from(event.polarity == Polarity::On), 0, 0, 0]);
            self.events += 1;
            if self.pending.len() >= PACKET_BYTES {
                self.close_packet()?;
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.close_packet()?;
        while let Some(compressed) = self.compressing.take() {
            self.place(compressed)?;
        }
        let table_position = i64::try_from(self.position).context(TOO_LARGE)?;
        let table = self.compressed((self.compression.compress)(&packet_table(&self.packets)))?;
        self.put(&table)?;
        let patched = self
            .file
            .seek(SeekFrom::Start(TABLE_POSITION_AT))
            .and_then(|_| self.file.write_all(&table_position.to_le_bytes()))
            .and_then(|()| self.file.flush());
        patched.with_context(|| format!("{}: cannot be written", self.name))
    }
}

/// Returns the `IOHE` table with its size. The packet table's position is -1 for now, so that an interrupted file
/// can still be read. A `FlatBuffer` may be laid out in any order that its offsets allow; 8-byte scalars are at
/// multiples of 8 from the start of the size.
fn io_header(sensor: Sensor, compression: Compression) -> Vec<u8> {
    let Sensor { width, height } = sensor;
    let Compression { code, name, .. } = compression;
    let xml = format!(
        r#"<dv version="2.0">
    <node name="outInfo" path="/mainloop/Recorder/outInfo/">
        <node name="{STREAM}" path="/mainloop/Recorder/outInfo/{STREAM}/">
            <attr key="compression" type="string">{name}</attr>
            <attr key="originalModuleName" type="string">eecvs</attr>
            <attr key="originalOutputName" type="string">events</attr>
            <attr key="typeDescription" type="string">Array of events (polarity ON/OFF).</attr>
            <attr key="typeIdentifier" type="string">EVTS</attr>
            <node name="info" path="/mainloop/Recorder/outInfo/{STREAM}/info/">
                <attr key="sizeX" type="int">{width}</attr>
                <attr key="sizeY" type="int">{height}</attr>
                <attr key="source" type="string">EECVS</attr>
                <attr key="tsOffset" type="long">0</attr>
            </node>
        </node>
    </node>
</dv>
"#
    );
    let mut bytes = vec![0; 18];
    // vtable at 18: its size, the table's size, offsets of compression, position, description.
    for value in [10_u16, 24, 4, 12, 8] {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    // Table at 28: offset back to its vtable, compression, description 16 bytes further on, position -1.
    bytes.extend_from_slice(&10_i32.to_le_bytes());
    bytes.extend_from_slice(&code.to_le_bytes());
    bytes.extend_from_slice(&16_u32.to_le_bytes());
    bytes.extend_from_slice(&(-1_i64).to_le_bytes());
    bytes.extend_from_slice(&[0; 4]);
    bytes.extend_from_slice(&(xml.len() as u32).to_le_bytes());
    bytes.extend_from_slice(xml.as_bytes());
    // Strings end with a 0 that their length does not count.
    bytes.push(0);
    pad(&mut bytes);
    finish(bytes, 28, b"IOHE")
}

/// Returns an empty packet in `memory`: room for its head.
fn new_packet(mut memory: Vec<u8>) -> Vec<u8> {
    memory.clear();
    memory.reserve_exact(PACKET_BYTES);
    memory.resize(PACKET_HEAD_BYTES, 0);
    memory
}

/// Returns an `EVTS` packet: `bytes` with the head in its room, before events of 16 bytes each.
fn event_packet(mut bytes: Vec<u8>, count: u32) -> Vec<u8> {
    // vtable at 14, table at 20 with the vector's offset at 24, the vector's length at 28.
    let vtable = [6_u16, 8, 4].map(u16::to_le_bytes);
    let table = [6, 4, count].map(u32::to_le_bytes);
    let head = [&[0; 14], vtable.as_flattened(), table.as_flattened()].concat();
    bytes.splice(..PACKET_HEAD_BYTES, head);
    finish(bytes, 20, b"EVTS")
}

/// Bytes from one packet's entry to the next, and the offset of the entries' vtable.
const ENTRY_BYTES: usize = 48;
const ENTRY_VTABLE_AT: usize = 18;

/// Returns the `FTAB` table: for each packet, the position and size of its content, its events and its times.
fn packet_table(packets: &[Packet]) -> Vec<u8> {
    let mut bytes = vec![0; ENTRY_VTABLE_AT];
    // vtable of the entries at 18: position, packet header, events, first and last time.
    for value in [14_u16, 44, 4, 12, 20, 28, 36] {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    // vtable at 32, table at 38 + 2 with the vector's offset at 44, the vector's length at 48.
    for value in [6_u16, 8, 4, 0] {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes.extend_from_slice(&8_i32.to_le_bytes());
    bytes.extend_from_slice(&4_u32.to_le_bytes());
    bytes.extend_from_slice(&(packets.len() as u32).to_le_bytes());
    // The entries begin 4 bytes after a multiple of 8, so that their first field is at a multiple of 8.
    let offsets_at = bytes.len();
    let first = (offsets_at + 4 * packets.len() + 3) / 8 * 8 + 4;
    for index in 0..packets.len() {
        let entry = first + index * ENTRY_BYTES;
        let offset = entry - (offsets_at + 4 * index);
        bytes.extend_from_slice(&(offset as u32).to_le_bytes());
    }
    for (index, packet) in packets.iter().enumerate() {
        let entry = first + index * ENTRY_BYTES;
        bytes.resize(entry, 0);
        bytes.extend_from_slice(&((entry - ENTRY_VTABLE_AT) as i32).to_le_bytes());
        bytes.extend_from_slice(&(packet.content_at as i64).to_le_bytes());
        bytes.extend_from_slice(&STREAM.to_le_bytes());
        bytes.extend_from_slice(&packet.size.to_le_bytes());
        bytes.extend_from_slice(&i64::from(packet.events).to_le_bytes());
        bytes.extend_from_slice(&packet.first_us.to_le_bytes());
        bytes.extend_from_slice(&packet.last_us.to_le_bytes());
    }
    pad(&mut bytes);
    finish(bytes, 40, b"FTAB")
}

fn pad(bytes: &mut Vec<u8>) {
    bytes.resize(bytes.len().next_multiple_of(8), 0);
}

/// Writes the size, the root table's offset and the four-letter identifier into the first 12 bytes.
fn finish(mut bytes: Vec<u8>, root_at: u32, letters: &[u8; 4]) -> Vec<u8> {
    let size = (bytes.len() - 4) as u32;
    let start = [size.to_le_bytes(), (root_at - 4).to_le_bytes(), *letters].concat();
    bytes.splice(..12, start);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flatbuffer::Buffer;

    #[test]
    fn a_frame_does_not_depend_on_those_before_it() {
        let content = |length: u32, seed: u32| -> Vec<u8> {
            (0..length).map(|i| ((i % 97 * seed) >> 3) as u8).collect()
        };
        let lengths = [300_000, 300_000, 5, 0, 0, 300_000, 300_000, 70_000, 5];
        for (seed, length) in (1..).zip(lengths) {
            let content = content(length, seed);
            let info = FrameInfo::new().content_checksum(true);
            let mut fresh = FrameEncoder::with_frame_info(info, Vec::new());
            fresh.write_all(&content).expect("memory");
            let fresh = fresh.finish().expect("memory");
            assert!(lz4(&content).expect("memory") == fresh, "{length}");
        }
    }

    #[test]
    fn the_packet_table_reads_back() {
        for count in 0..4 {
            let packets: Vec<Packet> = (0..count)
                .map(|i| Packet {
                    content_at: 1000 + i,
                    size: 7 + i as i32,
                    events: 3,
                    first_us: 10 * i as i64,
                    last_us: 10 * i as i64 + 5,
                })
                .collect();
            let bytes = packet_table(&packets);
            let (buffer, root) = Buffer::root(&bytes, b"FTAB").expect("a table");
            let vector = buffer.vector(root, 0).expect("entries");
            assert_eq!(vector.len, packets.len());
            for (index, packet) in packets.iter().enumerate() {
                let entry = buffer.element(vector, index).expect("an entry");
                let position = buffer.inline(entry, 0).expect("a position");
                assert_eq!(position % 8, 0);
                assert_eq!(buffer.i64(entry, 0, 0), Some(packet.content_at as i64));
                let header = buffer.inline(entry, 1).expect("a packet header");
                assert_eq!(buffer.bytes(header), Some(STREAM.to_le_bytes()));
                assert_eq!(buffer.bytes(header + 4), Some(packet.size.to_le_bytes()));
                assert_eq!(buffer.i64(entry, 2, 0), Some(3));
                assert_eq!(buffer.i64(entry, 3, -1), Some(packet.first_us));
                assert_eq!(buffer.i64(entry, 4, -1), Some(packet.last_us));
            }
        }
    }
}
