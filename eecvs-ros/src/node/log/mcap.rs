//! Tables as MCAP: one topic per table, with messages in JSON and a schema.
//!
//! A message contains a window's single row or, as arrays, many of its rows; missing values are left out. Messages
//! carry the stamps of their frames.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;

use anyhow::{Context as _, Result};
use event_files::parquet::table::Kind;
use mcap::records::MessageHeader;
use serde_json::{Map, Value, json};

use super::file::TableFile;
use super::table::{Cell, Column, Rows, Table};
use crate::bag::write_options;
use crate::message::Time;

/// Maximum number of rows per message.
const MESSAGE_ROWS: usize = 1 << 14;

/// An MCAP file being written.
pub struct McapFile {
    name: String,
    writer: mcap::Writer<BufWriter<File>>,
    topics: Vec<Topic>,
}

struct Topic {
    channel: u16,
    shared: &'static [Column],
    own: &'static [Column],
    messages: u32,
}

fn failed(name: &str, error: mcap::McapError) -> anyhow::Error {
    anyhow::Error::new(error).context(format!("{name}: cannot be written"))
}

impl McapFile {
    /// Starts a file of tables, each with its topic.
    ///
    /// # Errors
    /// Writing fails.
    pub fn new(file: File, name: String, tables: &[(Table, String)]) -> Result<Self> {
        let begin = || {
            let mut writer = write_options().create(BufWriter::new(file))?;
            let mut topics = Vec::new();
            for (table, topic) in tables {
                // Viewers read JSON with a schema directly; for CDR, some would need the message definitions
                // installed.
                let schema = schema(table).to_string();
                let schema = writer.add_schema(table.name, "jsonschema", schema.as_bytes())?;
                topics.push(Topic {
                    channel: writer.add_channel(schema, topic, "json", &BTreeMap::new())?,
                    shared: table.shared,
                    own: table.own,
                    messages: 0,
                });
            }
            Ok((writer, topics))
        };
        let (writer, topics) = begin().map_err(|error| failed(&name, error))?;
        Ok(Self {
            name,
            writer,
            topics,
        })
    }
}

/// Returns the JSON schema of a table's messages. Viewers support one type per property, so none is declared
/// nullable.
fn schema(table: &Table) -> Value {
    let kind = |kind| match kind {
        Kind::Bool => "boolean",
        Kind::U16 | Kind::I64 => "integer",
        Kind::F64 => "number",
        Kind::Text => "string",
    };
    let shared = table
        .shared
        .iter()
        .map(|(name, of)| ((*name).to_owned(), json!({ "type": kind(*of) })));
    let own = table.own.iter().map(|(name, of)| {
        let array = json!({ "type": "array", "items": { "type": kind(*of) } });
        ((*name).to_owned(), array)
    });
    let properties: Map<String, Value> = shared.chain(own).collect();
    json!({ "title": table.name, "type": "object", "properties": properties })
}

/// A message being assembled.
struct Message<'t> {
    topic: &'t Topic,
    /// The values of each own column, separated by commas.
    arrays: Vec<Vec<u8>>,
    /// Whether each own column has any value.
    has_any: Vec<bool>,
    rows: usize,
}

impl<'t> Message<'t> {
    fn new(topic: &'t Topic) -> Self {
        Self {
            topic,
            arrays: vec![Vec::new(); topic.own.len()],
            has_any: vec![false; topic.own.len()],
            rows: 0,
        }
    }

    fn push(&mut self, own: &[Cell]) -> Result<()> {
        let columns = self.arrays.iter_mut().zip(&mut self.has_any);
        for ((array, has_any), cell) in columns.zip(own) {
            if self.rows > 0 {
                array.push(b',');
            }
            serde_json::to_writer(array, cell)?;
            *has_any |= *cell != Cell::Missing;
        }
        self.rows += 1;
        Ok(())
    }

    /// Returns the message as JSON, and starts the next one.
    fn take(&mut self, shared: &[Cell]) -> Result<Vec<u8>> {
        let mut json = vec![b'{'];
        let mut property = |name: &str, value: &[&[u8]]| {
            if json.len() > 1 {
                json.push(b',');
            }
            // Column names need no escaping.
            json.extend([b"\"", name.as_bytes(), b"\":"].concat());
            value.iter().for_each(|part| json.extend_from_slice(part));
        };
        for ((name, _), cell) in self.topic.shared.iter().zip(shared) {
            if *cell != Cell::Missing {
                property(name, &[&serde_json::to_vec(cell)?]);
            }
        }
        let arrays = self.arrays.iter().zip(&self.has_any);
        for ((name, _), (array, has_any)) in self.topic.own.iter().zip(arrays) {
            if *has_any {
                property(name, &[b"[", array, b"]"]);
            }
        }
        json.push(b'}');
        self.arrays.iter_mut().for_each(Vec::clear);
        self.has_any.fill(false);
        self.rows = 0;
        Ok(json)
    }
}

impl TableFile for McapFile {
    fn put(&mut self, table: usize, rows: &Rows<'_>) -> Result<()> {
        let Self {
            name,
            writer,
            topics,
        } = self;
        let topic = topics.get_mut(table).context("a table")?;
        let (channel_id, mut messages) = (topic.channel, topic.messages);
        let stamp = if rows.stamp == Time::default() {
            Time::now()
        } else {
            rows.stamp
        };
        let time = u64::try_from(stamp.ns()).unwrap_or(0);
        let mut write = |json: &[u8]| {
            let header = MessageHeader {
                channel_id,
                sequence: messages,
                log_time: time,
                publish_time: time,
            };
            messages = messages.wrapping_add(1);
            let written = writer.write_to_known_channel(&header, json);
            written.map_err(|error| failed(name, error))
        };
        let mut message = Message::new(topic);
        rows.each(&mut |own| {
            message.push(own)?;
            if message.rows == MESSAGE_ROWS {
                write(&message.take(&rows.shared)?)?;
            }
            Ok(())
        })?;
        if message.rows > 0 {
            write(&message.take(&rows.shared)?)?;
        }
        topic.messages = messages;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        let end = self.writer.finish();
        end.map(drop).map_err(|error| failed(&self.name, error))
    }
}
