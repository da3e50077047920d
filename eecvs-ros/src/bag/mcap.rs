//! Bags in MCAP files, by means of the crate `mcap`.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom};
use std::path::Path;

use anyhow::{Context, Result, anyhow};
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

impl McapWriter {
    /// Creates the file with one channel per topic.
    pub fn create(path: &Path, topics: &[(Topic, Type)]) -> Result<Self> {
        let name = path.display().to_string();
        let file = File::create(path).with_context(|| format!("{name}: cannot be created"))?;
        let begin = || {
            let mut writer = WriteOptions::new()
                .profile("ros2")
                .library(concat!("eecvs ", env!("CARGO_PKG_VERSION")))
                .compression(Some(Compression::Lz4))
                .chunk_size(Some(CHUNK_BYTES))
                .create(BufWriter::new(file))?;
            let mut channels = Vec::new();
            for (topic, kind) in topics {
                let definition = kind.definition.as_bytes();
                let schema = writer.add_schema(kind.name, "ros2msg", definition)?;
                let offers = ("offered_qos_profiles".to_owned(), OFFERS.to_owned());
                let hash = ("topic_type_hash".to_owned(), kind.hash.to_owned());
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
            channel_id: self.channels.get(topic).copied().context("a topic")?,
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

/// An MCAP file being read: in time order by means of its index, or from front to back if it has no chunks and
/// therefore no index.
pub struct McapReader {
    name: String,
    file: File,
    topics: Vec<Topic>,
    /// Maps channel IDs to indices in `topics`.
    channels: BTreeMap<u16, usize>,
    way: Way,
    chunk: Vec<u8>,
    from_ns: u64,
}

/// How the messages are found.
enum Way {
    Indexed(Box<IndexedReader>),
    Linear(Box<LinearReader>),
}

impl McapReader {
    /// Opens a file, which must have a summary; messages before `from_ns` are left out.
    pub fn open(path: &Path, from_ns: u64) -> Result<Self> {
        let name = path.display().to_string();
        let mut file = File::open(path).with_context(|| format!("{name}: cannot be read"))?;
        let summary = summary(&mut file).with_context(|| {
            format!("{name}: has no summary at its end: `eecvs convert` reads what is whole of it")
        })?;
        let mut topics = Vec::new();
        let mut channels = BTreeMap::new();
        // In the order of their IDs, which is the order of creation.
        let sorted: BTreeMap<_, _> = summary.channels.iter().collect();
        for (id, channel) in sorted {
            let schema = channel.schema.as_ref();
            channels.insert(*id, topics.len());
            topics.push(Topic {
                name: channel.topic.clone(),
                kind: schema.map_or_else(String::new, |schema| schema.name.clone()),
            });
        }
        let way = if summary.chunk_indexes.is_empty() {
            file.rewind()
                .with_context(|| format!("{name}: cannot be read"))?;
            let options = LinearReaderOptions::default().with_record_length_limit(RECORD_MAX);
            Way::Linear(Box::new(LinearReader::new_with_options(options)))
        } else {
            let options = IndexedReaderOptions::new()
                .with_order(ReadOrder::LogTime)
                .with_record_length_limit(RECORD_MAX)
                .starting_at(from_ns);
            let reader = IndexedReader::new_with_options(&summary, options);
            Way::Indexed(Box::new(reader.map_err(|error| failed(&name, &error))?))
        };
        Ok(Self {
            name,
            file,
            topics,
            channels,
            way,
            chunk: Vec::new(),
            from_ns,
        })
    }
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
        &self.topics
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
        let stored = |header: &MessageHeader, data: &[u8]| {
            let topic = channels.get(&header.channel_id).copied();
            Ok(Some(Stored {
                topic: topic.with_context(|| format!("{name}: an unknown channel"))?,
                time_ns: header.log_time,
                cdr: data.to_vec(),
            }))
        };
        match way {
            Way::Indexed(reader) => loop {
                let Some(event) = reader.next_event() else {
                    return Ok(None);
                };
                match event.map_err(|error| failed(name, &error))? {
                    IndexedReadEvent::Message { header, data } => return stored(&header, data),
                    IndexedReadEvent::ReadChunkRequest { offset, length } => {
                        let mut read = || {
                            anyhow::ensure!(length <= RECORD_MAX, "a chunk of {length} bytes");
                            chunk.resize(length, 0);
                            file.seek(SeekFrom::Start(offset))?;
                            file.read_exact(chunk)?;
                            Ok(())
                        };
                        read().with_context(|| format!("{name}: byte {offset}"))?;
                        let inserted = reader.insert_chunk_record_data(offset, chunk);
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
                        if let Record::Message { header, data } =
                            record.map_err(|error| failed(name, &error))?
                            && header.log_time >= *from_ns
                        {
                            return stored(&header, &data);
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

    /// A file as written by `ros2 bag record --storage-preset-profile fastwrite`, without chunks.
    #[test]
    fn files_without_chunks_are_read_from_front_to_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let file = BufWriter::new(File::create(&path).unwrap());
        let options = WriteOptions::new().profile("ros2").use_chunks(false);
        let mut writer = options.create(file).unwrap();
        let kind = EventPacket::TYPE;
        let schema = writer
            .add_schema(kind.name, "ros2msg", kind.definition.as_bytes())
            .unwrap();
        let channel = writer
            .add_channel(schema, "/a/events", "cdr", &BTreeMap::new())
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
        for from_ns in [0, 120] {
            let mut reader = McapReader::open(&path, from_ns).unwrap();
            assert_eq!(reader.topics().len(), 1);
            for time_ns in from_ns..300 {
                let stored = reader.next().unwrap().unwrap();
                assert_eq!((stored.topic, stored.time_ns), (0, time_ns));
                assert_eq!(stored.cdr, [time_ns as u8; 700]);
            }
            assert!(reader.next().unwrap().is_none());
        }
    }
}
