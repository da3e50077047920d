//! Bags in MCAP files, by means of the crate `mcap`.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom};
use std::path::Path;

use anyhow::{Context, Result, anyhow, ensure};
use mcap::records::{MessageHeader, Record};
use mcap::sans_io::indexed_reader::{
    IndexedReadEvent, IndexedReader, IndexedReaderOptions, ReadOrder,
};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{Compression, Summary, WriteOptions};

use super::metadata::OFFERS;
use super::{ReadFile, Stored, Topic, WriteFile};
use crate::message::Type;

/// Key of a type's hash in a channel's metadata.
const HASH: &str = "topic_type_hash";

/// Longest record accepted, in bytes.
const RECORD_MAX: usize = 1 << 29;

/// Approximate size of a chunk, in bytes.
const CHUNK_BYTES: u64 = 1 << 20;

/// An MCAP file being written.
pub struct McapWriter {
    name: String,
    writer: mcap::Writer<BufWriter<File>>,
    channels: Vec<u16>,
}

/// Returns the options of all MCAP files that are written.
pub(crate) fn write_options() -> WriteOptions {
    WriteOptions::new()
        .library(concat!("eecvs ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Lz4))
        .chunk_size(Some(CHUNK_BYTES))
}

impl McapWriter {
    /// Creates the file with one channel per topic.
    pub fn create(path: &Path, topics: &[(Topic, Type)]) -> Result<Self> {
        let name = path.display().to_string();
        let file = File::create(path).with_context(|| format!("{name}: cannot be created"))?;
        let begin = || {
            let mut writer = write_options()
                .profile("ros2")
                .create(BufWriter::new(file))?;
            let mut channels = Vec::new();
            for (topic, kind) in topics {
                let definition = kind.definition.as_bytes();
                let schema = writer.add_schema(kind.name, "ros2msg", definition)?;
                let offers = ("offered_qos_profiles".to_owned(), OFFERS.to_owned());
                let hash = (HASH.to_owned(), kind.hash.to_owned());
                let metadata = BTreeMap::from([offers, hash]);
                channels.push(writer.add_channel(schema, &topic.name, "cdr", &metadata)?);
            }
            Ok((writer, channels))
        };
        let (writer, channels) = begin().map_err(|error| failed(&name, &error))?;
        Ok(Self {
            name,
            writer,
            channels,
        })
    }
}

fn failed(name: &str, error: &mcap::McapError) -> anyhow::Error {
    anyhow!("{name}: {error}")
}

impl WriteFile for McapWriter {
    fn message(&mut self, topic: usize, sequence: u64, time_ns: u64, cdr: &[u8]) -> Result<()> {
        let header = MessageHeader {
            channel_id: self
                .channels
                .get(topic)
                .copied()
                .context("the topic is unknown")?,
            // MCAP's sequence number has 32 bits and may wrap.
            sequence: sequence as u32,
            log_time: time_ns,
            publish_time: time_ns,
        };
        let written = self.writer.write_to_known_channel(&header, cdr);
        written.map_err(|error| failed(&self.name, &error))
    }

    fn finish(mut self: Box<Self>, metadata: &str) -> Result<()> {
        let record = mcap::records::Metadata {
            name: "rosbag2".to_owned(),
            metadata: BTreeMap::from([("serialized_metadata".to_owned(), metadata.to_owned())]),
        };
        let end = self
            .writer
            .write_metadata(&record)
            .and_then(|()| self.writer.finish());
        end.map(drop).map_err(|error| failed(&self.name, &error))
    }
}

/// An MCAP file being read: in time order by means of its index, or from front to back if it has none, as without
/// chunks, or if its summary is missing.
pub struct McapReader {
    name: String,
    file: File,
    channels: Channels,
    way: Way,
    chunk: Vec<u8>,
    from_ns: u64,
}

/// How the messages are found.
enum Way {
    /// With the places of chunks by where their records begin: first byte and length.
    Indexed(Box<IndexedReader>, BTreeMap<u64, (u64, usize)>),
    Linear(Box<LinearReader>),
}

/// The channels of a file, each of which is a topic.
#[derive(Default)]
struct Channels {
    topics: Vec<Topic>,
    /// Maps channel IDs to indices in `topics`.
    numbers: BTreeMap<u16, usize>,
    /// Names of types by the IDs of their schemas.
    schemas: BTreeMap<u16, String>,
}

impl Channels {
    /// Adds a channel, unless it is known: the summary repeats those of the data.
    fn add(&mut self, id: u16, topic: &str, kind: &str, encoding: &str, hash: Option<&String>) {
        if !self.numbers.contains_key(&id) {
            self.numbers.insert(id, self.topics.len());
            self.topics.push(Topic {
                name: topic.to_owned(),
                kind: kind.to_owned(),
                encoding: encoding.to_owned(),
                hash: hash.cloned().unwrap_or_default(),
            });
        }
    }

    fn add_all(&mut self, summary: &Summary) {
        // In the order of their IDs, which is the order of creation.
        let sorted: BTreeMap<_, _> = summary.channels.iter().collect();
        for (id, channel) in sorted {
            let kind = channel.schema.as_ref();
            let kind = kind.map_or("", |schema| schema.name.as_str());
            let hash = channel.metadata.get(HASH);
            self.add(*id, &channel.topic, kind, &channel.message_encoding, hash);
        }
    }

    /// Takes a record that may describe a channel.
    fn take(&mut self, record: &Record<'_>) {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name.clone());
            }
            Record::Channel(channel) => {
                let kind = self.schemas.get(&channel.schema_id).cloned();
                let hash = channel.metadata.get(HASH);
                let kind = kind.unwrap_or_default();
                self.add(
                    channel.id,
                    &channel.topic,
                    &kind,
                    &channel.message_encoding,
                    hash,
                );
            }
            _ => {}
        }
    }
}

/// Whether messages can be found by the summary's index: it knows all chunks, all channels and their types.
fn has_index(summary: &Summary) -> bool {
    let (chunks, channels) = (summary.chunk_indexes.len(), summary.channels.len());
    if summary
        .channels
        .values()
        .any(|channel| channel.schema.is_none())
    {
        return false;
    }
    match &summary.stats {
        Some(stats) => {
            chunks > 0
                && chunks >= stats.chunk_count as usize
                && channels >= stats.channel_count as usize
        }
        None => chunks > 0 && channels > 0,
    }
}

impl McapReader {
    /// Opens a file, which messages call `name`; messages before `from_ns` are left out.
    pub fn open(path: &Path, name: &str, from_ns: u64) -> Result<Self> {
        let name = name.to_owned();
        let unread = || format!("{name}: cannot be read");
        let mut file = File::open(path).with_context(unread)?;
        let mut channels = Channels::default();
        // Without a summary, the file is cut off or was written without one: the end of the file shows which.
        let summary = summary(&mut file).ok().filter(has_index);
        let way = match summary {
            None => {
                file.rewind().with_context(unread)?;
                let options = LinearReaderOptions::default()
                    .with_record_length_limit(RECORD_MAX)
                    .with_prevalidate_chunk_crcs(true);
                Way::Linear(Box::new(LinearReader::new_with_options(options)))
            }
            Some(summary) => {
                let mut chunks = BTreeMap::new();
                for chunk in &summary.chunk_indexes {
                    let records_at = chunk.compressed_data_offset();
                    let records_at = records_at.map_err(|error| failed(&name, &error))?;
                    let longest = chunk.chunk_length.max(chunk.uncompressed_size);
                    ensure!(
                        longest <= RECORD_MAX as u64,
                        "{name}: a chunk of {longest} bytes is too long: the file is damaged"
                    );
                    let place = (chunk.chunk_start_offset, chunk.chunk_length as usize);
                    chunks.insert(records_at, place);
                }
                channels.add_all(&summary);
                let options = IndexedReaderOptions::new()
                    .with_order(ReadOrder::LogTime)
                    .with_record_length_limit(RECORD_MAX)
                    .starting_at(from_ns);
                let reader = IndexedReader::new_with_options(&summary, options);
                let reader = reader.map_err(|error| failed(&name, &error))?;
                Way::Indexed(Box::new(reader), chunks)
            }
        };
        Ok(Self {
            name,
            file,
            channels,
            way,
            chunk: Vec::new(),
            from_ns,
        })
    }
}

/// Reads and checks the chunk whose records begin at a byte and have a length; returns its records.
fn read_chunk<'c>(
    file: &mut File,
    chunk: &'c mut Vec<u8>,
    chunks: &BTreeMap<u64, (u64, usize)>,
    (offset, length): (u64, usize),
) -> Result<&'c [u8]> {
    let place = chunks.get(&offset);
    let (start, bytes) = *place.context("the index has no such chunk")?;
    chunk
        .try_reserve(bytes.saturating_sub(chunk.len()))
        .context("the memory for a chunk cannot be had")?;
    chunk.resize(bytes, 0);
    file.seek(SeekFrom::Start(start))?;
    file.read_exact(chunk)?;
    check_chunk(chunk)?;
    let records = chunk.get((offset - start) as usize..);
    let records = records.and_then(|rest| rest.get(..length));
    records.context("the chunk is shorter than its index says")
}

/// Checks the CRC of a chunk's record, which the reader by the index does not: the chunk is unpacked twice.
fn check_chunk(record: &[u8]) -> Result<()> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_record_length_limit(RECORD_MAX)
        .with_prevalidate_chunk_crcs(true);
    let mut reader = LinearReader::new_with_options(options);
    let mut rest = record;
    while let Some(event) = reader.next_event() {
        if let LinearReadEvent::ReadRequest(length) = event? {
            let (now, later) = rest.split_at(length.min(rest.len()));
            reader.insert(now.len()).copy_from_slice(now);
            reader.notify_read(now.len());
            rest = later;
        }
    }
    Ok(())
}

/// Reads the summary at the end of a file.
fn summary(file: &mut File) -> Result<Summary> {
    let options = SummaryReaderOptions::default().with_record_length_limit(RECORD_MAX);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(n) => {
                let read = file.read(reader.insert(n))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    reader.finish().context("it is empty")
}

impl ReadFile for McapReader {
    fn topics(&self) -> &[Topic] {
        &self.channels.topics
    }

    fn next(&mut self) -> Result<Option<Stored>> {
        let Self {
            name,
            file,
            channels,
            way,
            chunk,
            from_ns,
            ..
        } = self;
        let stored = |channels: &Channels, header: &MessageHeader, data: &[u8]| {
            let topic = channels.numbers.get(&header.channel_id).copied();
            Ok(Some(Stored {
                topic: topic.with_context(|| format!("{name}: a message of an unknown channel"))?,
                time_ns: header.log_time,
                cdr: data.to_vec(),
            }))
        };
        match way {
            Way::Indexed(reader, chunks) => loop {
                let Some(event) = reader.next_event() else {
                    return Ok(None);
                };
                match event.map_err(|error| failed(name, &error))? {
                    IndexedReadEvent::Message { header, data } => {
                        return stored(channels, &header, data);
                    }
                    IndexedReadEvent::ReadChunkRequest { offset, length } => {
                        let records = read_chunk(file, chunk, chunks, (offset, length));
                        let records = records.with_context(|| format!("{name}: byte {offset}"))?;
                        let inserted = reader.insert_chunk_record_data(offset, records);
                        inserted.map_err(|error| failed(name, &error))?;
                    }
                }
            },
            Way::Linear(reader) => loop {
                let Some(event) = reader.next_event() else {
                    return Ok(None);
                };
                match event.map_err(|error| failed(name, &error))? {
                    LinearReadEvent::ReadRequest(length) => {
                        let read = file.read(reader.insert(length));
                        reader
                            .notify_read(read.with_context(|| format!("{name}: cannot be read"))?);
                    }
                    LinearReadEvent::Record { data, opcode } => {
                        let record = mcap::parse_record(opcode, data);
                        match record.map_err(|error| failed(name, &error))? {
                            Record::Message { header, data } => {
                                if header.log_time >= *from_ns {
                                    return stored(channels, &header, &data);
                                }
                            }
                            other => channels.take(&other),
                        }
                    }
                }
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{EventPacket, Message};

    /// Writes 300 messages of 700 bytes.
    fn write(path: &Path, options: WriteOptions) {
        let file = BufWriter::new(File::create(path).unwrap());
        let mut writer = options.profile("ros2").create(file).unwrap();
        let kind = EventPacket::TYPE;
        let schema = writer
            .add_schema(kind.name, "ros2msg", kind.definition.as_bytes())
            .unwrap();
        let metadata = BTreeMap::from([(HASH.to_owned(), kind.hash.to_owned())]);
        let channel = writer
            .add_channel(schema, "/a/events", "cdr", &metadata)
            .unwrap();
        for i in 0..300_u64 {
            let header = MessageHeader {
                channel_id: channel,
                sequence: i as u32,
                log_time: i,
                publish_time: i,
            };
            writer
                .write_to_known_channel(&header, &[i as u8; 700])
                .unwrap();
        }
        writer.finish().unwrap();
    }

    fn open(path: &Path, from_ns: u64) -> McapReader {
        McapReader::open(path, "a.mcap", from_ns).unwrap()
    }

    /// Files as the profiles of `ros2 bag record` write them, and without what a summary may leave out.
    #[test]
    fn files_of_every_layout_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let small = || WriteOptions::new().chunk_size(Some(20_000));
        let options = [
            small().use_chunks(false),
            small().use_chunks(false).emit_summary_records(false),
            small().compression(None),
            small().compression(Some(Compression::Lz4)),
            small().compression(Some(Compression::Zstd)),
            small()
                .compression(Some(Compression::Zstd))
                .emit_summary_records(false),
            small().repeat_channels(false).repeat_schemas(false),
            small().emit_chunk_indexes(false),
            small().emit_statistics(false),
        ];
        for (number, options) in options.into_iter().enumerate() {
            write(&path, options);
            for from_ns in [0, 120] {
                let mut reader = open(&path, from_ns);
                for time_ns in from_ns..300 {
                    let stored = reader.next().unwrap().unwrap();
                    assert_eq!((stored.topic, stored.time_ns), (0, time_ns), "{number}");
                    assert_eq!(stored.cdr, [time_ns as u8; 700]);
                }
                assert!(reader.next().unwrap().is_none());
                let kind = EventPacket::TYPE;
                let topic = Topic {
                    name: "/a/events".to_owned(),
                    kind: kind.name.to_owned(),
                    encoding: "cdr".to_owned(),
                    hash: kind.hash.to_owned(),
                };
                assert_eq!(reader.topics(), [topic]);
            }
        }
    }

    /// No byte of a damaged chunk is taken for a message.
    #[test]
    fn damaged_chunks_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let small = || {
            WriteOptions::new()
                .chunk_size(Some(20_000))
                .compression(None)
        };
        for options in [small(), small().emit_chunk_indexes(false)] {
            write(&path, options);
            let mut bytes = std::fs::read(&path).unwrap();
            // Message 100 of 300, beyond the first chunks.
            let at = bytes
                .windows(700)
                .position(|part| part == [100; 700])
                .unwrap();
            bytes[at + 350] ^= 1;
            std::fs::write(&path, bytes).unwrap();
            let mut reader = open(&path, 0);
            let mut messages = 0_usize;
            let error = loop {
                match reader.next() {
                    Ok(Some(stored)) => {
                        assert_eq!(stored.cdr, [messages as u8; 700]);
                        messages += 1;
                    }
                    Ok(None) => panic!("it is damaged"),
                    Err(error) => break format!("{error:#}"),
                }
            };
            assert!((70..=100).contains(&messages), "{messages}");
            assert!(error.contains("a.mcap"), "{error}");
        }
    }

    #[test]
    fn what_stands_before_a_cut_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        write(&path, WriteOptions::new().use_chunks(false));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let mut reader = open(&path, 0);
        let mut messages = 0;
        let error = loop {
            match reader.next() {
                Ok(Some(_)) => messages += 1,
                Ok(None) => panic!("it is cut"),
                Err(error) => break error.to_string(),
            }
        };
        assert!((130..=150).contains(&messages), "{messages}");
        assert!(error.contains("a.mcap"), "{error}");
    }
}
