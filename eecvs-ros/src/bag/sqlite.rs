//! Bags in SQLite files, with version 4 of rosbag2's schema.
//!
//! The file is written only when a transaction ends, and there is no journal file beside it: a run that is killed
//! leaves a database with all transactions but the last.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use rusqlite::{Connection, OpenFlags, params};

use super::metadata::{OFFERS, VERSION, WRITTEN_BY};
use super::{ReadFile, Stored, Topic, WriteFile};
use crate::message::Type;

/// Bytes of messages per transaction, which is held in memory.
const TRANSACTION_BYTES: usize = 8 << 20;

/// Number of messages per query.
const ROWS: i64 = 64;

const TABLES: &str = "
PRAGMA journal_mode = MEMORY;
PRAGMA synchronous = OFF;
PRAGMA cache_spill = OFF;
BEGIN;
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,
    metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
    serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
    type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,
    encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL,
    type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
    timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);";

fn failed(name: &str, error: rusqlite::Error) -> anyhow::Error {
    anyhow::Error::new(error).context(format!("{name}: SQLite"))
}

/// An SQLite file being written.
pub struct SqliteWriter {
    name: String,
    connection: Connection,
    waiting: usize,
}

impl SqliteWriter {
    /// Creates the file with its tables and topics.
    pub fn create(path: &Path, topics: &[(Topic, Type)]) -> Result<Self> {
        let name = path.display().to_string();
        let begin = || {
            let connection = Connection::open(path)?;
            connection.execute_batch(TABLES)?;
            connection.execute("INSERT INTO schema VALUES (4, ?1)", [WRITTEN_BY])?;
            for (id, (topic, kind)) in (1_i64..).zip(topics) {
                let row = "INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', ?4, ?5)";
                let values = params![id, topic.name, kind.name, OFFERS, kind.hash];
                connection.execute(row, values)?;
                let row = "INSERT INTO message_definitions VALUES (?1, ?2, 'ros2msg', ?3, ?4)";
                let values = params![id, kind.name, kind.definition, kind.hash];
                connection.execute(row, values)?;
            }
            connection.execute_batch("COMMIT; BEGIN")?;
            Ok(connection)
        };
        let connection = begin().map_err(|error| failed(&name, error))?;
        Ok(Self {
            name,
            connection,
            waiting: 0,
        })
    }

    fn put(&mut self, topic: usize, time_ns: u64, cdr: &[u8]) -> rusqlite::Result<()> {
        let row = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
        let mut row = self.connection.prepare_cached(row)?;
        row.execute(params![topic as i64 + 1, time_ns as i64, cdr])?;
        self.waiting += cdr.len();
        if self.waiting >= TRANSACTION_BYTES {
            self.connection.execute_batch("COMMIT; BEGIN")?;
            self.waiting = 0;
        }
        Ok(())
    }
}

impl WriteFile for SqliteWriter {
    fn message(&mut self, topic: usize, _: u64, time_ns: u64, cdr: &[u8]) -> Result<()> {
        ensure!(
            i64::try_from(time_ns).is_ok(),
            "{}: the time {time_ns} ns is above 2^63 - 1 ns",
            self.name
        );
        let put = self.put(topic, time_ns, cdr);
        put.map_err(|error| failed(&self.name, error))
    }

    fn finish(self: Box<Self>, metadata: &str) -> Result<()> {
        let Self {
            name, connection, ..
        } = *self;
        let row = "INSERT INTO metadata VALUES (1, ?1, ?2)";
        let ended = connection
            .execute(row, params![VERSION, metadata])
            .and_then(|_| connection.execute_batch("COMMIT"));
        ended.map_err(|error| failed(&name, error))?;
        let closed = connection.close();
        closed.map_err(|(_, error)| failed(&name, error))
    }
}

/// An SQLite file being read, in time order.
pub struct SqliteReader {
    name: String,
    connection: Connection,
    topics: Vec<Topic>,
    /// IDs of the topics in the database.
    ids: Vec<i64>,
    /// Time and ID of the last message read; reading continues after it.
    behind: (i64, i64),
    /// Messages already read, in reverse order.
    waiting: Vec<Stored>,
}

impl SqliteReader {
    /// Opens a file; messages before `from_ns` are left out.
    pub fn open(path: &Path, name: &str, from_ns: u64) -> Result<Self> {
        let name = name.to_owned();
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let begin = || {
            let connection = Connection::open_with_flags(path, flags)?;
            // SQLite would read the missing pages of a truncated file as zeros: the size is compared below.
            let pages: i64 = connection.query_row("PRAGMA page_count", [], |row| row.get(0))?;
            let bytes: i64 = connection.query_row("PRAGMA page_size", [], |row| row.get(0))?;
            let mut ids = Vec::new();
            let mut topics = Vec::new();
            {
                // Earlier versions of the schema do not have the hash.
                let question = "SELECT * FROM topics ORDER BY id";
                let mut question = connection.prepare(question)?;
                let hash = question.column_index("type_description_hash").ok();
                let mut rows = question.query([])?;
                while let Some(row) = rows.next()? {
                    ids.push(row.get("id")?);
                    topics.push(Topic {
                        name: row.get("name")?,
                        kind: row.get("type")?,
                        encoding: row.get("serialization_format")?,
                        hash: match hash {
                            Some(hash) => row.get::<_, Option<String>>(hash)?.unwrap_or_default(),
                            None => String::new(),
                        },
                    });
                }
            }
            Ok((connection, ids, topics, pages.saturating_mul(bytes)))
        };
        let length = std::fs::metadata(path).map(|data| data.len());
        let length = length.with_context(|| format!("{name}: cannot be read"))?;
        let (connection, ids, topics, whole) = begin().map_err(|error| failed(&name, error))?;
        ensure!(
            i64::try_from(length).is_ok_and(|length| length >= whole),
            "{name}: byte {length}: the file is cut off; by its header it has {whole} bytes"
        );
        Ok(Self {
            name,
            connection,
            topics,
            ids,
            behind: match from_ns {
                // Also messages with stamps of another clock, before 1970.
                0 => (i64::MIN, i64::MIN),
                from_ns => (i64::try_from(from_ns).unwrap_or(i64::MAX), i64::MIN),
            },
            waiting: Vec::new(),
        })
    }

    /// Queries the next messages.
    fn fill(&mut self) -> rusqlite::Result<()> {
        let question = "SELECT id, topic_id, timestamp, data FROM messages \
             WHERE (timestamp, id) > (?1, ?2) ORDER BY timestamp, id LIMIT ?3";
        let mut question = self.connection.prepare_cached(question)?;
        let mut rows = question.query(params![self.behind.0, self.behind.1, ROWS])?;
        while let Some(row) = rows.next()? {
            let (id, topic, time_ns): (i64, i64, i64) = (row.get(0)?, row.get(1)?, row.get(2)?);
            self.behind = (time_ns, id);
            let topic = self.ids.iter().position(|known| *known == topic);
            self.waiting.push(Stored {
                // An index out of range: the caller reports the unknown topic.
                topic: topic.unwrap_or(usize::MAX),
                time_ns: u64::try_from(time_ns).unwrap_or(0),
                cdr: row.get(3)?,
            });
        }
        self.waiting.reverse();
        Ok(())
    }
}

impl ReadFile for SqliteReader {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn next(&mut self) -> Result<Option<Stored>> {
        if self.waiting.is_empty() {
            let before = self.behind;
            self.fill().map_err(|error| failed(&self.name, error))?;
            // A damaged index would yield the same rows for ever.
            let has_gone_on = self.waiting.is_empty() || self.behind > before;
            ensure!(
                has_gone_on,
                "{}: messages are not in ascending order: the file is damaged",
                self.name
            );
        }
        Ok(self.waiting.pop())
    }
}
