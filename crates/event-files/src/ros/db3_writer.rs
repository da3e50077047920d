//! Writes ROS 2 bags in SQLite: one database with one topic, by version 4 of rosbag2's schema.
//!
//! | table | content |
//! |---|---|
//! | `schema` | 4, and the program that wrote the file |
//! | `topics` | the only topic, its type and the hash of its definition |
//! | `message_definitions` | the definition, so that the bag can be read without the type's package |
//! | `messages`, sorted by the index `timestamp_idx` | numbered in the file's order |
//! | `metadata` | written at the end: what a `metadata.yaml` states about the file |
//!
//! Version 4 is the newest, written by rosbag2 since Iron. Humble, whose own version is 3, reads it as well: it
//! selects columns by name and does not check the version. The metadata have version 8, the newest that Humble,
//! Jazzy and Kilted all read: from 9 on, quality-of-service offers are not text, which Humble rejects. There are no
//! offers, so that a player uses its default.
//!
//! No stamp is before an earlier one, so that sorting by stamp gives the order of the numbers. Nothing is written
//! beside the file, which rosbag2 opens by itself; `ros2 bag reindex` turns a folder into a bag if its files are
//! named `NAME_0.db3`.
//!
//! The file changes only at the ends of transactions, and there is no journal beside it: a run that is killed
//! leaves a database of all transactions but the last.

use std::path::{Path, PathBuf};

use event_types::Sensor;
use event_types::stream::Result;
use rusqlite::{Connection, OpenFlags, params};

use super::fields::Serialisation;
use super::packets::{
    DEFINITION_ROS2, HASH_ROS2, Message, MessageFile, PacketWriter, Packets, TOPIC, TYPE_ROS2,
};
use crate::create_file;
use crate::output::{final_path, remove_partial};

/// Number of messages of a transaction, which is held in memory: at most 10 MB.
const TRANSACTION_MESSAGES: u64 = 100;

/// Id of the only topic.
const TOPIC_ID: i64 = 1;

/// Quality-of-service offers: none, in a form that every version of the metadata accepts.
const OFFERS: &str = "[]";

/// Stands in the place of the ROS distribution.
const WRITTEN_BY: &str = "eecvs";

const METADATA_VERSION: i64 = 8;

/// Nothing is written to the disk before the end of a transaction, and nothing waits for the disk.
const PRAGMAS: &str = "
PRAGMA journal_mode = MEMORY;
PRAGMA synchronous = OFF;
PRAGMA cache_spill = OFF;";

const TABLES: &str = "
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

/// A writer of ROS 2 bags in SQLite with one topic of `event_camera_msgs/EventPacket`.
///
/// Events may have any order, and times up to the largest stamp of ROS 2.
pub type Db3Writer = PacketWriter<Rows>;

impl Db3Writer {
    /// Creates the file and replaces an existing one.
    ///
    /// # Errors
    /// The file cannot be created or written.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        // An empty file is an empty database, whatever an earlier one has left beside it.
        let (_, name) = create_file(path)?;
        let connection = begin(path).map_err(|error| failed(&name, error))?;
        let packets = Packets::new(&name, sensor, Serialisation::Cdr);
        let final_path = final_path(path);
        let file_name = final_path.file_name().unwrap_or_default().to_string_lossy();
        let file = Rows {
            connection,
            name,
            path: final_path.clone(),
            file_name: file_name.into_owned(),
            messages: 0,
            times_ns: None,
        };
        Ok(Self::new(packets, file))
    }
}

/// Opens the empty database and writes everything before the messages; leaves a transaction open.
fn begin(path: &Path) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags)?;
    connection.execute_batch(PRAGMAS)?;
    connection.execute_batch("BEGIN")?;
    connection.execute_batch(TABLES)?;
    connection.execute("INSERT INTO schema VALUES (4, ?1)", [WRITTEN_BY])?;
    let topic = "INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', ?4, ?5)";
    let values = params![TOPIC_ID, TOPIC, TYPE_ROS2, OFFERS, HASH_ROS2];
    connection.execute(topic, values)?;
    let definition = "INSERT INTO message_definitions VALUES (1, ?1, 'ros2msg', ?2, ?3)";
    connection.execute(definition, [TYPE_ROS2, DEFINITION_ROS2, HASH_ROS2])?;
    connection.execute_batch("COMMIT; BEGIN")?;
    Ok(connection)
}

fn failed(name: &str, error: rusqlite::Error) -> event_types::stream::Error {
    event_types::stream::Error::other(error).context(format!("{name}: SQLite cannot write it"))
}

/// The rows of a file that is being written.
pub struct Rows {
    connection: Connection,
    /// Name of the file in messages.
    name: String,
    /// Path that the file will have.
    path: PathBuf,
    /// Name of the file in the metadata.
    file_name: String,
    messages: u64,
    /// Stamps of the first and the last message.
    times_ns: Option<(u64, u64)>,
}

impl MessageFile for Rows {
    fn message(&mut self, message: &Message) -> Result<()> {
        let put = self.put(message);
        put.map_err(|error| failed(&self.name, error))
    }

    /// Writes the metadata.
    fn finish(self) -> Result<()> {
        let end = || {
            let metadata = "INSERT INTO metadata VALUES (1, ?1, ?2)";
            let values = params![METADATA_VERSION, self.metadata()];
            self.connection.execute(metadata, values)?;
            self.connection.execute_batch("COMMIT")
        };
        end().map_err(|error| failed(&self.name, error))?;
        let Self {
            connection,
            name,
            path,
            ..
        } = self;
        let closed = connection.close();
        closed.map_err(|(_, error)| failed(&name, error))?;
        // A journal of an earlier database of this name would be applied to this one.
        for ending in ["-journal", "-wal", "-shm"] {
            let mut journal = path.clone().into_os_string();
            journal.push(ending);
            remove_partial(Path::new(&journal));
        }
        Ok(())
    }
}

impl Rows {
    fn put(&mut self, message: &Message) -> rusqlite::Result<()> {
        let Message { time_ns, bytes, .. } = message;
        let row = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
        let mut row = self.connection.prepare_cached(row)?;
        // A stamp's seconds have 31 bits, so that its nanoseconds fit.
        row.execute(params![TOPIC_ID, *time_ns as i64, bytes])?;
        self.messages += 1;
        let (first_ns, _) = self.times_ns.unwrap_or((*time_ns, 0));
        self.times_ns = Some((first_ns, *time_ns));
        if self.messages.is_multiple_of(TRANSACTION_MESSAGES) {
            self.connection.execute_batch("COMMIT; BEGIN")?;
        }
        Ok(())
    }

    /// Returns rosbag2's `BagMetadata` as text.
    fn metadata(&self) -> String {
        let (first_ns, last_ns) = self.times_ns.unwrap_or_default();
        let (messages, duration_ns) = (self.messages, last_ns - first_ns);
        // A JSON string is also a YAML string.
        let file = serde_json::Value::from(self.file_name.as_str());
        format!(
            "version: {METADATA_VERSION}
storage_identifier: sqlite3
duration:
  nanoseconds: {duration_ns}
starting_time:
  nanoseconds_since_epoch: {first_ns}
message_count: {messages}
topics_with_message_count:
  - topic_metadata:
      name: {TOPIC}
      type: {TYPE_ROS2}
      serialization_format: cdr
      offered_qos_profiles: \"{OFFERS}\"
      type_description_hash: {HASH_ROS2}
    message_count: {messages}
compression_format: \"\"
compression_mode: \"\"
relative_file_paths:
  - {file}
files:
  - path: {file}
    starting_time:
      nanoseconds_since_epoch: {first_ns}
    duration:
      nanoseconds: {duration_ns}
    message_count: {messages}
custom_data: ~
ros_distro: {WRITTEN_BY}
"
        )
    }
}

#[cfg(test)]
mod tests {
    use event_types::{Event, Polarity};

    use super::*;
    use crate::{EventReader, create, create_in_place, open};

    const SENSOR: Sensor = Sensor {
        width: 346,
        height: 260,
    };

    const START_US: u64 = 1_700_000_000_000_000;

    fn some_events(n: u64) -> Vec<Event> {
        (0..n)
            .map(|i| Event {
                // Every 1,000th event steps back in time.
                t_us: START_US + i * 700 - i % 1000 / 999 * 5000,
                x: (i % 346) as u16,
                y: (i % 260) as u16,
                polarity: Polarity::from_bool(i % 3 == 0),
            })
            .collect()
    }

    fn write(path: &Path, events: &[Event]) {
        let mut writer = create(path, SENSOR).unwrap();
        writer.write(events).unwrap();
        writer.finish().unwrap();
    }

    fn rest(reader: &mut dyn EventReader) -> Vec<Event> {
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        events
    }

    /// Returns the rows that a query yields, with their columns separated by `|`.
    fn ask(path: &Path, question: &str) -> Vec<String> {
        let database = Connection::open(path).unwrap();
        let mut question = database.prepare(question).unwrap();
        let columns = question.column_count();
        let rows = question.query_map([], |row| {
            let values = (0..columns).map(|i| match row.get_ref(i)? {
                rusqlite::types::ValueRef::Integer(number) => Ok(number.to_string()),
                other => Ok(other.as_str()?.to_owned()),
            });
            Ok(values.collect::<rusqlite::Result<Vec<_>>>()?.join("|"))
        });
        rows.unwrap().map(Result::unwrap).collect()
    }

    #[test]
    fn events_come_back_in_place_of_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db3");
        // More messages than fit into one transaction.
        let many = some_events(50_000);
        for events in [&many, &many[..10], &[]] {
            write(&path, events);
            let mut reader = open(&path, None).unwrap();
            assert_eq!(reader.sensor(), SENSOR);
            assert_eq!(rest(reader.as_mut()), events);
            // No journal remains.
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
            assert_eq!(ask(&path, "PRAGMA integrity_check"), ["ok"]);
        }
    }

    /// Journals of an existing database do not become part of the new one.
    #[test]
    fn journals_of_another_database_are_left_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db3");
        let few = some_events(1000);
        for (mode, end, journal) in [
            ("WAL", "COMMIT", "a.db3-wal"),
            ("DELETE", "", "a.db3-journal"),
        ] {
            write(&path, &some_events(5000));
            let database = Connection::open(&path).unwrap();
            let change = format!(
                "PRAGMA journal_mode = {mode}; BEGIN; UPDATE messages SET data = zeroblob(9); {end}"
            );
            database.execute_batch(&change).unwrap();
            database.cache_flush().unwrap();
            let journal = folder.path().join(journal);
            let left = std::fs::read(&journal).unwrap();
            assert!(left.len() > 10_000);
            drop(database);
            std::fs::write(&journal, left).unwrap();
            write(&path, &few);
            let mut reader = open(&path, None).unwrap();
            assert_eq!(rest(reader.as_mut()), few);
            assert_eq!(ask(&path, "PRAGMA integrity_check"), ["ok"]);
        }
    }

    #[test]
    fn the_tables_are_rosbag2s() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a \"b\"_0.db3");
        write(&path, &some_events(5000));
        let columns = |table: &str| {
            let question = format!("SELECT name, type FROM pragma_table_info('{table}')");
            ask(&path, &question).join(", ")
        };
        assert_eq!(columns("schema"), "schema_version|INTEGER, ros_distro|TEXT");
        assert_eq!(
            columns("metadata"),
            "id|INTEGER, metadata_version|INTEGER, metadata|TEXT"
        );
        assert_eq!(
            columns("topics"),
            "id|INTEGER, name|TEXT, type|TEXT, serialization_format|TEXT, \
             offered_qos_profiles|TEXT, type_description_hash|TEXT"
        );
        assert_eq!(
            columns("message_definitions"),
            "id|INTEGER, topic_type|TEXT, encoding|TEXT, encoded_message_definition|TEXT, \
             type_description_hash|TEXT"
        );
        assert_eq!(
            columns("messages"),
            "id|INTEGER, topic_id|INTEGER, timestamp|INTEGER, data|BLOB"
        );
        let index = "SELECT tbl_name FROM sqlite_master WHERE name = 'timestamp_idx'";
        assert_eq!(ask(&path, index), ["messages"]);
        assert_eq!(ask(&path, "SELECT schema_version FROM schema"), ["4"]);
        // The hash is the same wherever the type is named.
        let hashes = "SELECT name FROM topics JOIN message_definitions
            ON topics.type = topic_type
            AND topics.type_description_hash = message_definitions.type_description_hash";
        assert_eq!(ask(&path, hashes), [TOPIC]);
        let strangers = "SELECT id FROM messages WHERE topic_id NOT IN (SELECT id FROM topics)";
        assert_eq!(ask(&path, strangers).len(), 0);
        let metadata = ask(&path, "SELECT metadata FROM metadata").join("");
        let count = ask(&path, "SELECT count(*) FROM messages").join("");
        for line in [
            format!("message_count: {count}"),
            format!("  nanoseconds_since_epoch: {START_US}000"),
            "  - \"a \\\"b\\\"_0.db3\"".to_owned(),
        ] {
            assert!(metadata.lines().any(|other| other == line), "{metadata}");
        }
    }

    #[test]
    fn order_by_number_and_by_stamp_is_the_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db3");
        write(&path, &some_events(50_000));
        let by_number = ask(&path, "SELECT id FROM messages ORDER BY id");
        let numbers: Vec<String> = (1..=by_number.len()).map(|id| id.to_string()).collect();
        assert!(by_number.len() > 3 * TRANSACTION_MESSAGES as usize);
        assert_eq!(by_number, numbers);
        let by_stamp = "SELECT id FROM messages ORDER BY timestamp, id";
        assert_eq!(ask(&path, by_stamp), numbers);
        // The first stamp is that of the first event; after a step back, stamps stay at the largest so far.
        let stamps = ask(&path, "SELECT timestamp FROM messages ORDER BY id");
        assert_eq!(stamps.first(), Some(&format!("{START_US}000")));
        assert!(stamps.is_sorted());
        assert!(stamps.array_windows().any(|[a, b]| a == b));
    }

    /// A run that is killed leaves all but the last transaction.
    #[test]
    fn what_is_not_finished_can_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db3");
        let events = some_events(50_000);
        let mut writer = create_in_place(&path, SENSOR).unwrap();
        writer.write(&events).unwrap();
        let killed = folder.path().join("killed.db3");
        std::fs::copy(&path, &killed).unwrap();
        assert_eq!(ask(&killed, "PRAGMA integrity_check"), ["ok"]);
        let got = rest(open(&killed, None).unwrap().as_mut());
        assert!(events.starts_with(&got));
        // A message spans 10 ms, an event 700 us.
        let transaction = TRANSACTION_MESSAGES as usize * 15;
        assert!(got.len() > events.len() - transaction, "{}", got.len());
        assert!(got.len() < events.len());
    }

    #[test]
    fn a_folder_that_is_not_there_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none/a.db3");
        let error = create(&path, SENSOR).err().unwrap();
        assert!(
            error.to_string().contains("none/a.db3: cannot be created"),
            "{error}"
        );
    }
}
