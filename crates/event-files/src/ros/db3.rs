//! Reads ROS 2 bags in an SQLite database (`.db3`), as written by rosbag2's plugin `sqlite3`.
//!
//! The tables are `topics` (id, name, type, serialization_format, ...) and `messages` (id, topic_id, timestamp,
//! data); the data is CDR. Messages are read by ascending id, the order in which they were written, and sought by
//! id, since timestamps are the computer's. A database that is still being written cannot be followed: new data may
//! be anywhere in it, or in a journal beside it.
//!
//! SQLite itself reads the file, since a second reader could not cover everything that a database may contain
//! (journals, overflow pages, versions). It is built from its source in every build.

use std::io::{Seek, SeekFrom};
use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{Sensor, bail, ensure, error};
use rusqlite::{Connection, OpenFlags, OptionalExtension};

use super::db3_writer::Db3Writer;
use super::decoder::{MESSAGE_MAX, Messages, RosReader};
use super::fields::Serialisation;
use super::message::Kind;
use super::packets::t_max_us;
use super::topics::{Topics, Use};
use crate::format::{Format, Limits, Opening};
use crate::input::following::ANOTHER;
use crate::input::{ReadSeek, following};
use crate::output::temporary::{Temporary, copy};
use crate::{EventReader, EventWriter, Skipped};

/// First bytes of every SQLite database.
pub const MAGIC: &[u8] = b"SQLite format 3\0";

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "rosbag2_db3",
    title: "ROS 2 bag in SQLite",
    endings: &[".db3"],
    detect: |start| start.begins(MAGIC),
    open,
    has_places: true,
    is_table: false,
    grows: false,
    streams: false,
    limits: Limits {
        t_max_us: t_max_us(Serialisation::Cdr),
        ..Limits::NONE
    },
    create: Some(create),
};

/// Creates a database.
fn create(path: &Path, sensor: Sensor) -> Result<Box<dyn EventWriter>> {
    Ok(Box::new(Db3Writer::create(path, sensor)?))
}

/// Opens a database.
fn open(opening: Opening) -> Result<Box<dyn EventReader>> {
    let Opening {
        mut source,
        name,
        path,
        place,
        reading,
    } = opening;
    let size = reading.size;
    let another = followed(source.as_mut()).with_context(|| format!("{name}: cannot be read"))?;
    if let Some(end) = another {
        bail!(Damaged, "{name}: byte {end}: {ANOTHER}");
    }
    let database = match path {
        Some(path) => Database::new(path, name)?,
        None => {
            // SQLite needs a file of its own.
            let context = || format!("{name}: byte 0: cannot be copied to a temporary file");
            let (mut file, own) = Temporary::create().with_context(context)?;
            source.seek(SeekFrom::Start(0)).with_context(context)?;
            copy(&mut source, &mut file, name).with_context(context)?;
            let mut database = Database::new(own.path(), name)?;
            database.copy = Some(own);
            database
        }
    };
    let reader = RosReader::new(Box::new(database), place, size)?;
    Ok(Box::new(reader))
}

/// Returns where another database begins after this one, which SQLite would not report.
fn followed(source: &mut dyn ReadSeek) -> std::io::Result<Option<u64>> {
    let mut header = [0; 100];
    source.seek(SeekFrom::Start(0))?;
    if source.read_exact(&mut header).is_err() {
        return Ok(None);
    }
    let number = |at: usize| {
        let bytes = header.get(at..).and_then(|rest| rest.first_chunk());
        bytes.copied().map_or(0, u32::from_be_bytes)
    };
    // The stated number of pages is valid if it was written with the latest counted change.
    let page = match number(16) >> 16 {
        1 => 1 << 16,
        page => u64::from(page),
    };
    let end = page * u64::from(number(28));
    let is_valid = end > 0 && number(24) == number(92);
    Ok((is_valid && following::is_at(source, end, MAGIC)?).then_some(end))
}

/// The messages of a database.
pub struct Database {
    connection: Connection,
    name: String,
    /// Ids and kinds of the wanted topic, once they have been requested.
    topics: Option<Vec<(i64, Kind)>>,
    /// Id of the latest message.
    message: i64,
    /// Ids of the first and the last message, once places have been requested.
    numbers: Option<(i64, i64)>,
    /// Temporary file, kept while the database is read.
    copy: Option<Temporary>,
}

impl Database {
    /// Opens the database at `path`, which messages call `name`.
    ///
    /// # Errors
    /// SQLite cannot open the file, or it is truncated.
    pub fn new(path: &Path, name: &str) -> Result<Self> {
        let context = || format!("{name}: byte 0: SQLite cannot open it");
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags).with_context(context)?;
        let page: i64 = connection
            .pragma_query_value(None, "page_size", |row| row.get(0))
            .with_context(context)?;
        let length = std::fs::metadata(path).with_context(context)?.len();
        // SQLite reads the missing part of the last page as zeros.
        ensure!(
            length.checked_rem(page.unsigned_abs()) == Some(0),
            Damaged,
            "{name}: byte {length}: truncated within a page of the database: copy it again"
        );
        Ok(Self {
            connection,
            name: name.to_owned(),
            topics: None,
            message: i64::MIN,
            numbers: None,
            copy: None,
        })
    }

    fn ask_topics(&self, topics: &mut Topics, skipped: &mut Skipped) -> Result<Vec<(i64, Kind)>> {
        let ask = "SELECT id, name, type, serialization_format FROM topics ORDER BY id";
        let rows = self.connection.prepare(ask).and_then(|mut statement| {
            let row = |row: &rusqlite::Row<'_>| {
                let text = |i| row.get::<_, String>(i);
                Ok((row.get::<_, i64>(0)?, text(1)?, text(2)?, text(3)?))
            };
            statement.query_map([], row)?.collect::<Result<Vec<_>, _>>()
        });
        let rows = rows.with_context(|| {
            format!(
                "{}: byte 0: not a ROS 2 bag (its table topics cannot be read)",
                self.name
            )
        })?;
        let mut read = Vec::new();
        for (id, topic, kind, serialisation) in rows {
            match topics.meet(&topic, &kind) {
                Ok(Use::Read(kind)) if serialisation == "cdr" => read.push((id, kind)),
                Ok(Use::Read(_)) => {
                    let name = &self.name;
                    bail!(
                        Damaged,
                        "{name}: byte 0: topic {topic} is serialised as {serialisation:?}: \
                         record it as cdr"
                    );
                }
                Ok(Use::Skip(what)) => skipped.add(what, self.count(id)?),
                Err(what) => bail!(Damaged, "{}: byte 0: {what}", self.name),
            }
        }
        Ok(read)
    }

    fn count(&self, topic: i64) -> Result<u64> {
        let ask = "SELECT count(*) FROM messages WHERE topic_id = ?1";
        let count = self.connection.query_row(ask, [topic], |row| row.get(0));
        count
            .map(|count: i64| u64::try_from(count).unwrap_or(0))
            .with_context(|| self.broken())
    }

    /// Returns the ids of the first and the last message.
    fn numbers(&self) -> Result<Option<(i64, i64)>> {
        let ask = "SELECT min(id), max(id) FROM messages";
        let numbers = self.connection.query_row(ask, [], |row| {
            let (first, last): (Option<i64>, Option<i64>) = (row.get(0)?, row.get(1)?);
            Ok(first.zip(last))
        });
        numbers.with_context(|| self.broken())
    }

    fn broken(&self) -> String {
        format!(
            "{}: byte 0 after message {}: SQLite cannot read further: the database is damaged",
            self.name, self.message
        )
    }
}

impl Messages for Database {
    fn format(&self) -> &'static str {
        FORMAT.name
    }

    fn next(
        &mut self,
        message: &mut Vec<u8>,
        topics: &mut Topics,
        skipped: &mut Skipped,
    ) -> Result<Option<(Kind, Serialisation)>> {
        let wanted = match self.topics.take() {
            Some(wanted) => wanted,
            None => self.ask_topics(topics, skipped)?,
        };
        let ask = "SELECT id, topic_id, length(data), data FROM messages WHERE id > ?1 \
                   ORDER BY id LIMIT 1";
        let found = loop {
            let found = self.connection.prepare_cached(ask).and_then(|mut ask| {
                let row = ask.query_row([self.message], |row| {
                    let (id, topic): (i64, i64) = (row.get(0)?, row.get(1)?);
                    let kind = wanted.iter().find(|(id, _)| *id == topic);
                    let length: i64 = row.get(2)?;
                    if kind.is_some() && length <= MESSAGE_MAX as i64 {
                        message.clear();
                        message.extend_from_slice(row.get_ref(3)?.as_blob()?);
                    }
                    Ok((id, kind.map(|(_, kind)| *kind), length))
                });
                row.optional()
            });
            match found.with_context(|| self.broken())? {
                None => break None,
                Some((id, kind, length)) => {
                    // SQLite trusts the order within its pages, and could return the same rows for ever.
                    if self.message != i64::MIN && id <= self.message {
                        bail!(Damaged, "{}", self.broken());
                    }
                    self.message = id;
                    if let Some(kind) = kind {
                        if length > MESSAGE_MAX as i64 {
                            let what =
                                format!("{length} bytes are too many for a message: it is damaged");
                            return Err(self.error(0, &what));
                        }
                        break Some((kind, Serialisation::Cdr));
                    }
                }
            }
        };
        self.topics = Some(wanted);
        Ok(found)
    }

    fn places(&mut self, topics: &mut Topics) -> Result<Option<u64>> {
        if self.topics.is_none() {
            self.topics = Some(self.ask_topics(topics, &mut Skipped::default())?);
        }
        self.numbers = self.numbers()?;
        // Every id in the range is a place, whether or not it is in use: reading continues at the next one.
        Ok(self
            .numbers
            .map(|(first, last)| last.abs_diff(first).saturating_add(1)))
    }

    fn go(&mut self, place: u64, _: &mut Topics) -> Result<()> {
        if let Some((first, last)) = self.numbers {
            let message = first.saturating_add_unsigned(place).min(last);
            self.message = message.saturating_sub(1);
        }
        Ok(())
    }

    fn error(&self, at: usize, what: &str) -> event_types::stream::Error {
        let Self { name, message, .. } = self;
        match *message {
            i64::MIN => error!(Damaged, "{name}: byte {at}: {what}"),
            message => error!(Damaged, "{name}: message {message}, byte {at}: {what}"),
        }
    }
}
#[cfg(test)]
mod tests {
    use std::path::Path;

    use event_types::{Event, Polarity, Sensor};
    use rusqlite::{Connection, params};

    use crate::input::growing::{Follow, open_growing};
    use crate::ros::fields::Serialisation;
    use crate::ros::packets::{Packets, TOPIC};
    use crate::{Reading, open};

    /// Writes a ROS 2 bag whose messages have gaps in their ids and stamps of another clock.
    fn write(path: &Path, events: &[Event]) {
        let sensor = Sensor::new(346, 260).unwrap();
        let mut packets = Packets::new("test", sensor, Serialisation::Cdr);
        let mut messages = Vec::new();
        for events in events.chunks(100) {
            let put = |message: &crate::ros::packets::Message| {
                messages.push(message.bytes.clone());
                Ok(())
            };
            packets.write(events, put).unwrap();
        }
        packets
            .finish(|message| {
                messages.push(message.bytes.clone());
                Ok(())
            })
            .unwrap();
        let mut connection = Connection::open(path).unwrap();
        let tables = "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT,
                          serialization_format TEXT, offered_qos_profiles TEXT);
                      CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER,
                          timestamp INTEGER, data BLOB);";
        connection.execute_batch(tables).unwrap();
        let topic =
            "INSERT INTO topics VALUES (3, ?1, 'event_camera_msgs/msg/EventPacket', 'cdr', '')";
        connection.execute(topic, [TOPIC]).unwrap();
        let transaction = connection.transaction().unwrap();
        for (number, bytes) in messages.iter().enumerate() {
            let row = "INSERT INTO messages VALUES (?1, 3, ?2, ?3)";
            let (id, stamp) = (number as i64 * 3 + 40, -(number as i64));
            transaction.execute(row, params![id, stamp, bytes]).unwrap();
        }
        transaction.commit().unwrap();
    }

    /// The database finds a message by its id; SQLite does not report one that is out of order.
    #[test]
    fn numbers_that_do_not_ascend_end_the_reading() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db3");
        let event = |i: u64| Event {
            t_us: i * 20_000,
            x: 3,
            y: 4,
            polarity: Polarity::On,
        };
        write(&path, &[event(0), event(1), event(2)]);
        let bytes = std::fs::read(&path).unwrap();
        // Ids 40, 43 and 46 stand before the message's columns: a header of 5 bytes, then topic 3.
        let mut changed = 0;
        for at in 0..bytes.len() - 3 {
            if bytes[at] != 46 || !(4..8).contains(&bytes[at + 1]) {
                continue;
            }
            let mut damaged = bytes.clone();
            damaged[at] = 41;
            std::fs::write(&path, &damaged).unwrap();
            let Ok(mut reader) = open(&path, None) else {
                continue;
            };
            let mut got = Vec::new();
            let end = loop {
                match reader.read(&mut got) {
                    Ok(0) => break Ok(()),
                    Ok(_) => assert!(got.len() <= 3),
                    Err(error) => break Err(error.to_string()),
                }
            };
            if let Err(error) = end {
                assert!(error.contains("damaged"), "{error}");
                assert_eq!(got, [event(0), event(1)]);
                changed += 1;
            }
        }
        assert_eq!(changed, 1);
    }

    #[test]
    fn seeking_goes_by_the_numbers_of_messages() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db3");
        let want: Vec<Event> = (0..20_000_u64)
            .map(|i| Event {
                t_us: i / 3 * 700,
                x: (i % 346) as u16,
                y: (i % 260) as u16,
                polarity: Polarity::from_bool(i % 2 == 0),
            })
            .collect();
        write(&path, &want);
        let mut reader = open(&path, None).unwrap();
        for target in [0, 700, 1_000_000, 4_665_000, 70_000, u64::MAX] {
            assert!(reader.seek(target).unwrap());
            let mut got = Vec::new();
            while reader.read(&mut got).unwrap() > 0 {}
            let wanted = want.len() - want.partition_point(|event| event.t_us < target);
            assert!(want.ends_with(&got) && got.len() >= wanted, "{target}");
            // A message spans 10 ms.
            assert!(got.len() <= wanted + 50, "{target}: {}", got.len());
        }
        // Data that is appended to a database may be anywhere in it.
        let follow = Follow {
            idle: Some(std::time::Duration::ZERO),
            stop: std::sync::Arc::default(),
        };
        let refused = open_growing(&path, &Reading::default(), &follow)
            .err()
            .unwrap();
        assert!(refused.to_string().contains("SQLite"), "{refused}");
    }
}
