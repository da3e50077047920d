//! Writer of Arrow's IPC format: t (int64, us), x, y (uint16), p (uint8, 0 or 1), uncompressed, so that readers
//! can map the file into memory; the schema's metadata has the keys `width` and `height`.

use std::path::Path;

use event_types::stream::Result;
use event_types::{Event, Sensor};

use super::{CONTINUATION, MAGIC};
use crate::EventWriter;
use crate::flatbuffer::writer::{Value, buffer};
use crate::output::sequential::Output;

/// Number of rows in a record batch, as in pyarrow.
const BATCH_ROWS: usize = 1 << 16;

/// Code of version 5 of the metadata.
const VERSION: i16 = 4;

/// Codes of message headers in their union, and of the type `Int`.
const SCHEMA: u8 = 1;
const RECORD_BATCH: u8 = 3;
const INT: u8 = 2;

/// Names, widths in bits and signedness of the columns.
const COLUMNS: [(&str, i32, bool); 4] = [
    ("t", 64, true),
    ("x", 16, false),
    ("y", 16, false),
    ("p", 8, false),
];

/// A writer of Arrow files and streams. It holds one batch, and 24 bytes for every batch written.
pub struct ArrowWriter {
    file: Output,
    sensor: Sensor,
    is_stream: bool,
    columns: [Vec<u8>; 4],
    rows: usize,
    /// Offset, metadata length and body length of every batch, as in the footer.
    blocks: Vec<u8>,
    events: u64,
}

impl ArrowWriter {
    /// Creates a file, or a stream if `is_stream` is true, and writes the schema.
    ///
    /// # Errors
    /// I/O.
    pub(crate) fn create(path: &Path, sensor: Sensor, is_stream: bool) -> Result<Self> {
        let file = Output::create(path)?;
        let mut writer = Self {
            file,
            sensor,
            is_stream,
            columns: [const { Vec::new() }; 4],
            rows: 0,
            blocks: Vec::new(),
            events: 0,
        };
        writer.begin()?;
        Ok(writer)
    }

    fn begin(&mut self) -> Result<()> {
        if !self.is_stream {
            self.file.put(&[MAGIC, &[0, 0]].concat())?;
        }
        self.message(SCHEMA, schema(self.sensor), 0).map(drop)
    }

    /// Writes a message's metadata; returns its length with the prefix.
    fn message(&mut self, kind: u8, header: Value, body: u64) -> Result<u32> {
        let message = buffer(&Value::Table(vec![
            (0, Value::i16(VERSION)),
            (1, Value::u8(kind)),
            (2, header),
            (3, Value::i64(body as i64)),
        ]));
        self.file.put(&CONTINUATION)?;
        self.file.put(&(message.len() as u32).to_le_bytes())?;
        self.file.put(&message)?;
        Ok(message.len() as u32 + 8)
    }

    /// Writes the buffered rows as a record batch.
    fn write_batch(&mut self) -> Result<()> {
        if self.rows == 0 {
            return Ok(());
        }
        let (mut nodes, mut buffers, mut body) = (Vec::new(), Vec::new(), 0_u64);
        for column in &self.columns {
            // No value is missing, so the bitmap is empty.
            nodes.extend([self.rows as u64, 0].map(u64::to_le_bytes).concat());
            let length = column.len() as u64;
            buffers.extend([body, 0, body, length].map(u64::to_le_bytes).concat());
            body += length.next_multiple_of(8);
        }
        let header = Value::Table(vec![
            (0, Value::i64(self.rows as i64)),
            (1, Value::Structs(4, nodes)),
            (2, Value::Structs(8, buffers)),
        ]);
        let start = self.file.position();
        let metadata = self.message(RECORD_BATCH, header, body)?;
        self.blocks.extend(start.to_le_bytes());
        self.blocks.extend(u64::from(metadata).to_le_bytes());
        self.blocks.extend(body.to_le_bytes());
        let mut columns = std::mem::take(&mut self.columns);
        for column in &mut columns {
            column.resize(column.len().next_multiple_of(8), 0);
            self.file.put(column)?;
            column.clear();
        }
        self.columns = columns;
        self.rows = 0;
        Ok(())
    }

    fn close(&mut self) -> Result<()> {
        self.write_batch()?;
        self.file.put(&CONTINUATION)?;
        self.file.put(&[0; 4])?;
        if !self.is_stream {
            let count = (self.blocks.len() / 24) as u32;
            let footer = buffer(&Value::Table(vec![
                (0, Value::i16(VERSION)),
                (1, schema(self.sensor)),
                (2, Value::Structs(0, Vec::new())),
                (3, Value::Structs(count, std::mem::take(&mut self.blocks))),
            ]));
            self.file.put(&footer)?;
            self.file.put(&(footer.len() as u32).to_le_bytes())?;
            self.file.put(MAGIC)?;
        }
        self.file.finish()
    }
}

impl EventWriter for ArrowWriter {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            crate::check_inside(self.file.name(), self.events, event, self.sensor)?;
            let (name, index, t_us) = (self.file.name(), self.events, event.t_us);
            let time = crate::signed_us(name, index, t_us)?;
            let [t, x, y, p] = &mut self.columns;
            t.extend(time.to_le_bytes());
            x.extend(event.x.to_le_bytes());
            y.extend(event.y.to_le_bytes());
            p.push(event.polarity as u8);
            self.rows += 1;
            self.events += 1;
            if self.rows == BATCH_ROWS {
                self.write_batch()?;
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.close()
    }
}

fn schema(sensor: Sensor) -> Value {
    let field = |(name, bits, is_signed): (&str, i32, bool)| {
        let mut of = vec![(0, Value::i32(bits))];
        of.push((1, Value::u8(u8::from(is_signed))));
        Value::Table(vec![
            (0, Value::Text(name.to_owned())),
            (1, Value::u8(0)),
            (2, Value::u8(INT)),
            (3, Value::Table(of)),
            (5, Value::Vector(Vec::new())),
        ])
    };
    let pair = |(key, side): (&str, u16)| {
        Value::Table(vec![
            (0, Value::Text(key.to_owned())),
            (1, Value::Text(side.to_string())),
        ])
    };
    let sides = [("width", sensor.width), ("height", sensor.height)];
    Value::Table(vec![
        (0, Value::i16(0)),
        (1, Value::Vector(COLUMNS.map(field).into())),
        (2, Value::Vector(sides.map(pair).into())),
    ])
}
