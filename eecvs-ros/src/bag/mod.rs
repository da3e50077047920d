//! ROS 2 bags: folders with `metadata.yaml` and a file of messages, as `ros2 bag` reads and writes them.
//!
//! Bags are written with one message file. A folder with several message files, or a message file alone, can also
//! be read.

pub mod event_array;
mod mcap;
mod metadata;
mod sqlite;

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::ValueEnum;
use event_files::output;
use event_files::output::temporary::Temporary;
use event_files::ros::decoder::unpack;
use event_files::ros::folder::unpacked;

pub(crate) use self::mcap::write_options;
use crate::message::Type;
use mcap::{McapReader, McapWriter};
use metadata::{Counts, METADATA, Metadata};
use sqlite::{SqliteReader, SqliteWriter};

/// Storage format of a bag's messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Storage {
    /// LZ4-compressed chunks with an index
    Mcap,
    /// An SQLite database
    Sqlite3,
}

impl Storage {
    /// Returns the format's identifier in the metadata.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Sqlite3 => "sqlite3",
        }
    }

    const fn ending(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Sqlite3 => "db3",
        }
    }
}

/// A topic recorded in a bag.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Topic {
    /// The topic's absolute name.
    pub name: String,
    /// Name of the message type: `std_msgs/msg/Header`.
    pub kind: String,
    /// Serialisation of the messages: `cdr` in bags of ROS 2. A writer does not use it.
    pub encoding: String,
    /// Hash of the type as the bag has it; empty if it has none. A writer does not use it.
    pub hash: String,
}

/// Serialisation of messages in ROS 2.
pub const CDR: &str = "cdr";

/// A serialised message in a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stored {
    /// Index of its topic in [`Reader::topics`].
    pub topic: usize,
    /// Time of reception, in nanoseconds since 1970.
    pub time_ns: u64,
    /// The message as CDR bytes, with the encapsulation in front.
    pub cdr: Vec<u8>,
}

/// A message file being written.
trait WriteFile {
    /// Appends a message of the topic with index `topic`; `sequence` counts the topic's messages from 0.
    fn message(&mut self, topic: usize, sequence: u64, time_ns: u64, cdr: &[u8]) -> Result<()>;

    /// Completes the file; `metadata` is the bag's, as text.
    fn finish(self: Box<Self>, metadata: &str) -> Result<()>;
}

/// A message file being read: in time order, or from front to back if it has no index.
trait ReadFile {
    /// Returns the topics that have occurred so far: of a file without an index, more may follow.
    fn topics(&self) -> &[Topic];

    fn next(&mut self) -> Result<Option<Stored>>;
}

/// Writer of a bag.
pub struct Writer {
    folder: PathBuf,
    storage: Storage,
    topics: Vec<(Topic, Type)>,
    file_name: String,
    file: Box<dyn WriteFile>,
    counts: Counts,
}

impl Writer {
    /// Creates the bag's folder, which must not exist yet, and the message file in it.
    ///
    /// # Errors
    /// The folder exists or cannot be created, or the file cannot be created.
    pub fn create(folder: &Path, storage: Storage, topics: Vec<(Topic, Type)>) -> Result<Self> {
        let name = folder.display();
        std::fs::create_dir(folder)
            .with_context(|| format!("{name}: the bag's folder cannot be created"))?;
        let made = Self::in_folder(folder, storage, topics);
        if made.is_err() {
            // Nothing is lost with it, and it would stand in the way of the next attempt.
            let _ = std::fs::remove_dir_all(folder);
        }
        made
    }

    /// Creates the message file in the bag's new folder.
    fn in_folder(folder: &Path, storage: Storage, topics: Vec<(Topic, Type)>) -> Result<Self> {
        let base = folder.file_name().unwrap_or_default().to_string_lossy();
        let file_name = format!("{base}_0.{}", storage.ending());
        let path = folder.join(&file_name);
        let file: Box<dyn WriteFile> = match storage {
            Storage::Mcap => Box::new(McapWriter::create(&path, &topics)?),
            Storage::Sqlite3 => Box::new(SqliteWriter::create(&path, &topics)?),
        };
        let counts = Counts::new(topics.len());
        Ok(Self {
            folder: folder.to_owned(),
            storage,
            topics,
            file_name,
            file,
            counts,
        })
    }

    /// Appends a message, received at `time_ns` since 1970, of the topic with index `topic`.
    ///
    /// # Errors
    /// Writing fails, or the storage cannot represent the time.
    pub fn message(&mut self, topic: usize, time_ns: u64, cdr: &[u8]) -> Result<()> {
        let sequence = self.counts.add(topic, time_ns);
        self.file.message(topic, sequence, time_ns, cdr)
    }

    /// Returns the number of messages so far.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.counts.messages()
    }

    /// Completes the message file, and writes the metadata when that is on the disk: a folder without metadata is half
    /// a bag.
    ///
    /// # Errors
    /// Writing fails.
    pub fn finish(self) -> Result<()> {
        let Self {
            folder,
            storage,
            topics,
            file_name,
            file,
            counts,
        } = self;
        let text = metadata::text(storage, &file_name, &topics, &counts);
        file.finish(&text)?;
        let path = folder.join(&file_name);
        output::sync(&path)
            .with_context(|| format!("{}: cannot be written to the disk", path.display()))?;
        Ok(output::write(
            &folder.join(METADATA),
            metadata::document(&text),
        )?)
    }
}

/// Reader of a bag: file by file, and within each file by time. An MCAP file without an index is read from front to
/// back.
pub struct Reader {
    files: Vec<PathBuf>,
    next: usize,
    from_ns: u64,
    file: Opened,
    topics: Vec<Topic>,
    /// For each topic of the open file, its index in `topics`.
    numbers: Vec<usize>,
}

impl Reader {
    /// Opens a folder or a single file; messages before `from_ns` are left out.
    ///
    /// # Errors
    /// The path is not a bag, or the bag is damaged.
    pub fn open(path: &Path, from_ns: u64) -> Result<Self> {
        let files = if path.is_dir() {
            let files = Metadata::read(path)?.relative_file_paths;
            ensure!(
                !files.is_empty(),
                "{}: {METADATA} lists no files: rewrite it with `ros2 bag reindex`",
                path.display()
            );
            files.iter().map(|file| path.join(file)).collect()
        } else {
            vec![path.to_owned()]
        };
        let first = files.first().cloned().unwrap_or_default();
        let file = open_file(&first, from_ns)?;
        let mut reader = Self {
            files,
            next: 1,
            from_ns,
            file,
            topics: Vec::new(),
            numbers: Vec::new(),
        };
        reader.number();
        Ok(reader)
    }

    /// Returns the topics of the files opened so far.
    #[must_use]
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Looks up the open file's topics in `topics`, and adds new ones.
    fn number(&mut self) {
        let all = &mut self.topics;
        self.numbers.clear();
        for topic in self.file.messages.topics() {
            let number = all.iter().position(|known| known == topic);
            self.numbers.push(number.unwrap_or_else(|| {
                all.push(topic.clone());
                all.len() - 1
            }));
        }
    }

    /// Returns the next message, or `None` at the end.
    ///
    /// # Errors
    /// A file is damaged.
    pub fn next_message(&mut self) -> Result<Option<Stored>> {
        loop {
            if let Some(mut stored) = self.file.messages.next()? {
                if self.numbers.len() < self.file.messages.topics().len() {
                    self.number();
                }
                let unknown = || format!("{}: a message of an unknown topic", self.file.name);
                let number = self.numbers.get(stored.topic);
                stored.topic = number.copied().with_context(unknown)?;
                let is_cdr = self.topics.get(stored.topic);
                if is_cdr.is_some_and(|topic| topic.encoding == CDR) {
                    unpack(&mut stored.cdr)
                        .map_err(|what| anyhow!("{}: {what}", self.file.name))?;
                }
                return Ok(Some(stored));
            }
            let Some(path) = self.files.get(self.next) else {
                return Ok(None);
            };
            self.next += 1;
            self.file = open_file(path, self.from_ns)?;
            self.number();
        }
    }
}

/// A message file, and the temporary file with its content if it was compressed as a whole.
struct Opened {
    name: String,
    messages: Box<dyn ReadFile>,
    _unpacked: Option<Temporary>,
}

/// Opens a message file, whose format is found by its first bytes.
fn open_file(path: &Path, from_ns: u64) -> Result<Opened> {
    let name = path.display().to_string();
    let unpacked = unpacked(path)?;
    let content = unpacked.as_ref().map_or(path, Temporary::path);
    let mut start = Vec::new();
    let file = File::open(content).with_context(|| format!("{name}: cannot be read"))?;
    let read = file.take(16).read_to_end(&mut start);
    read.with_context(|| format!("{name}: cannot be read"))?;
    let messages: Box<dyn ReadFile> = if start.starts_with(event_files::ros::mcap::MAGIC) {
        Box::new(McapReader::open(content, &name, from_ns)?)
    } else if start.starts_with(event_files::ros::db3::MAGIC) {
        Box::new(SqliteReader::open(content, &name, from_ns)?)
    } else if start.starts_with(event_files::ros::bag::MAGIC) {
        bail!(
            "{name}: this is a ROS 1 bag: `eecvs convert {name} NAME.mcap` writes its events to a \
             ROS 2 bag; `eecvs-ros emulate --recording {name}` publishes them"
        );
    } else {
        bail!(
            "{name}: not a ROS 2 bag (a folder with {METADATA}, MCAP or SQLite): `eecvs-ros \
             emulate --recording FILE` publishes recordings of other formats"
        );
    };
    Ok(Opened {
        name,
        messages,
        _unpacked: unpacked,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{EventPacket, Frame, Message};

    fn topics() -> Vec<(Topic, Type)> {
        [("/a/events", EventPacket::TYPE), ("/a/frames", Frame::TYPE)]
            .map(|(name, kind)| {
                let topic = Topic {
                    name: name.to_owned(),
                    kind: kind.name.to_owned(),
                    ..Topic::default()
                };
                (topic, kind)
            })
            .into()
    }

    fn messages() -> Vec<Stored> {
        (0..2000)
            .map(|i| Stored {
                topic: i % 3 % 2,
                time_ns: 1_700_000_000_000_000_000 + i as u64 * 1_000_000,
                cdr: vec![i as u8; 1 + i % 900],
            })
            .collect()
    }

    fn rest(path: &Path, from_ns: u64) -> Vec<Stored> {
        let mut reader = Reader::open(path, from_ns).unwrap();
        assert_eq!(reader.topics().len(), 2);
        let mut all = Vec::new();
        while let Some(stored) = reader.next_message().unwrap() {
            all.push(stored);
        }
        all
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let want = messages();
        for storage in [Storage::Mcap, Storage::Sqlite3] {
            let bag = folder.path().join(storage.name());
            let mut writer = Writer::create(&bag, storage, topics()).unwrap();
            for stored in &want {
                writer
                    .message(stored.topic, stored.time_ns, &stored.cdr)
                    .unwrap();
            }
            writer.finish().unwrap();
            assert!(rest(&bag, 0) == want);
            let from_ns = want[700].time_ns;
            assert!(rest(&bag, from_ns) == want[700..]);
            assert!(rest(&bag, from_ns + 1) == want[701..]);
            assert!(rest(&bag, u64::MAX).is_empty());
            // The file alone can be read too.
            let file = bag.join(format!("{}_0.{}", storage.name(), storage.ending()));
            assert!(rest(&file, 0) == want);
            assert!(Writer::create(&bag, storage, topics()).is_err());
        }
    }

    #[test]
    fn damaged_bags_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        for storage in [Storage::Mcap, Storage::Sqlite3] {
            let bag = folder.path().join(storage.name());
            let mut writer = Writer::create(&bag, storage, topics()).unwrap();
            for stored in messages() {
                writer
                    .message(stored.topic, stored.time_ns, &stored.cdr)
                    .unwrap();
            }
            writer.finish().unwrap();
            let file = bag.join(format!("{}_0.{}", storage.name(), storage.ending()));
            let bytes = std::fs::read(&file).unwrap();
            for part in 0..8 {
                std::fs::write(&file, &bytes[..bytes.len() * part / 8]).unwrap();
                let read = Reader::open(&bag, 0).and_then(|mut reader| {
                    while reader.next_message()?.is_some() {}
                    Ok(())
                });
                let error = read.unwrap_err().to_string();
                assert!(error.contains(storage.name()), "{error}");
            }
        }
        std::fs::write(folder.path().join("a.txt"), "").unwrap();
        for none in ["a.txt", "nowhere.mcap", "nowhere.db3", "."] {
            assert!(
                Reader::open(&folder.path().join(none), 0).is_err(),
                "{none}"
            );
        }
    }
}
