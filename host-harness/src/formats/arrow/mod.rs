//! Arrow's IPC format: files (`.arrow`, Feather 2's `.feather`) and streams (`.arrows`), as pyarrow, polars
//! and pandas write them (Arrow Columnar Format 1.5).
//!
//! A file is `ARROW1`, two zeros, a stream, and a footer that lists the batches. A stream is messages: ff ff
//! ff ff, u32 bytes of metadata, metadata (a `FlatBuffers` table), body; the first holds the schema, every
//! other rows of all columns; a length of 0 ends it. In the body, a column is a list of bits of the values
//! that are not missing, and its values, each LZ4, Zstandard (behind i64 bytes unpacked, -1 for none) or
//! not compressed.
//!
//! * Columns t, x, y, p, named as in a text file's header line, of any integers or floats, p also of bool;
//!   other columns are left out. Values must not be missing.
//! * t: of a type with a unit (timestamp, duration, time) or with a unit in its name in that one, rounded to
//!   microseconds; else as in npz files: integers are microseconds, floats are judged by the first 4,096.
//! * p: 1 or true is on; 0, -1 or false is off.
//! * The sensor's size: the schema's metadata `width` and `height`; else the caller's; else from names like
//!   `x@320`; else the largest x and y plus one, by a first pass.
//!
//! Messages are read from front to back, so that what is before a damage is given; the footer is not needed.
//! Seeking reads the first time of every batch. Columns are read in step, some kilobytes of each.

mod schema;
mod writer;

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::sync::{Arc, Mutex, PoisonError};

use eecvs_nostd::Sensor;
use lz4_flex::frame::FrameDecoder;
use ruzstd::decoding::StreamingDecoder;

pub use self::writer::ArrowWriter;

use self::schema::{Codec, Message, RecordBatch, Schema};
use self::writer::STREAM_ENDING;
use crate::formats::event_numbers::{NAMES, Row, T, X, Y, coordinate};
use crate::formats::format::{Format, Limits, Opening, Start};
use crate::formats::input::{Batch, Decode, ReadSeek, Reader};
use crate::formats::npy_header::Number;
use crate::formats::section::{Section, Shared};
use crate::formats::table_columns::{Columns, Named, Stored, stated_size};
use crate::formats::{BATCH_EVENTS, Skipped};

/// First and last bytes of a file.
pub const MAGIC: &[u8] = b"ARROW1";

/// First bytes of a message.
pub const CONTINUATION: [u8; 4] = [0xff; 4];

/// First bytes of Feather 1, another format.
const FEATHER_1: &[u8] = b"FEA1";

/// Bytes before a file's first message.
const START_BYTES: u64 = 8;

/// Most bytes of a message's metadata.
const METADATA_MAX: u32 = 16 << 20;

/// Bytes of a column that are read at once.
const BUFFER_BYTES: usize = 1 << 15;

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "arrow",
    title: "Arrow",
    endings: &[".arrow", ".feather", STREAM_ENDING],
    detect: is_arrow,
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(ArrowReader::new(source, name, reading.size)?)),
    has_places: false,
    grows: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(ArrowWriter::create(path, sensor)?))),
};

/// A file, or a stream, whose first message has metadata of a believable length.
fn is_arrow(start: &Start) -> bool {
    let length = start.bytes.get(4..).and_then(<[u8]>::first_chunk);
    let is_stream = start.begins(&CONTINUATION)
        && length.is_some_and(|length| (16..METADATA_MAX).contains(&u32::from_le_bytes(*length)));
    start.begins(MAGIC) || start.begins(FEATHER_1) || is_stream
}

/// Reader of Arrow files and streams.
pub type ArrowReader = Reader<ArrowDecoder>;

impl ArrowReader {
    /// Reads `source`, which messages call `name`; `size` counts where the file states none.
    ///
    /// # Errors
    /// No Arrow file, no columns t, x, y, p of numbers, no size and no event.
    pub fn new(
        source: Box<dyn ReadSeek>,
        name: &str,
        size: Option<Sensor>,
    ) -> anyhow::Result<Self> {
        let mut decoder = ArrowDecoder::open(source, name)?;
        let start = decoder.position;
        decoder.learn()?;
        decoder.rewind(start);
        let named = decoder.columns.sensor;
        decoder.sensor = match decoder.stated.or(size).or(named) {
            Some(sensor) => sensor,
            None => {
                let sensor = decoder.largest()?;
                decoder.rewind(start);
                sensor
            }
        };
        Ok(Self::around(decoder))
    }
}

/// State between two batches of events.
pub struct ArrowDecoder {
    source: Shared,
    name: String,
    length: u64,
    is_file: bool,
    /// Place of the first message behind the schema, and of the next one.
    first: u64,
    position: u64,
    schema: Schema,
    columns: Columns,
    /// Size that the metadata states.
    stated: Option<Sensor>,
    sensor: Sensor,
    rows: Option<Rows>,
    events: u64,
    skipped: Skipped,
}

/// A record batch being read.
struct Rows {
    /// Where its message begins.
    start: u64,
    left: u64,
    columns: [Values; 4],
}

/// A column of a record batch being read.
struct Values {
    reader: Box<dyn Read + Send>,
    stored: Stored,
    /// Of bits: the byte they are in, and how many of it are left.
    bits: (u8, u32),
}

impl Values {
    /// The next `count` numbers, or as many as there are before an error.
    fn take(&mut self, count: usize) -> (Vec<Option<Number>>, Option<std::io::Error>) {
        let mut numbers = Vec::with_capacity(count);
        match self.stored {
            Stored::Number(dtype) => {
                let mut bytes = vec![0; count * dtype.bytes];
                let (filled, error) = fill(&mut self.reader, &mut bytes);
                dtype.numbers(bytes.get(..filled).unwrap_or_default(), &mut numbers);
                (numbers, error)
            }
            Stored::Bool => {
                while numbers.len() < count {
                    let (byte, left) = &mut self.bits;
                    if *left == 0 {
                        let mut next = [0];
                        if let (_, Some(error)) = fill(&mut self.reader, &mut next) {
                            return (numbers, Some(error));
                        }
                        (*byte, *left) = (next[0], 8);
                    }
                    numbers.push(Some(Number::Whole(i64::from(*byte & 1))));
                    *byte >>= 1;
                    *left -= 1;
                }
                (numbers, None)
            }
        }
    }
}

/// Fills `bytes`, or what of it there is before an error; the end is one.
fn fill(reader: &mut dyn Read, bytes: &mut [u8]) -> (usize, Option<std::io::Error>) {
    let mut filled = 0;
    while let Some(rest) = bytes.get_mut(filled..).filter(|rest| !rest.is_empty()) {
        match reader.read(rest) {
            Ok(0) => {
                let error =
                    std::io::Error::other("the column has fewer values than the batch has rows");
                return (filled, Some(error));
            }
            Ok(n) => filled += n,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return (filled, Some(error)),
        }
    }
    (filled, None)
}

impl ArrowDecoder {
    fn open(mut source: Box<dyn ReadSeek>, name: &str) -> anyhow::Result<Self> {
        let length = source.seek(SeekFrom::End(0));
        let length =
            length.map_err(|error| anyhow::anyhow!("{name}: byte 0: cannot be sought: {error}"))?;
        let mut magic = Vec::new();
        let read = source
            .rewind()
            .and_then(|()| source.by_ref().take(START_BYTES).read_to_end(&mut magic));
        read.map_err(|error| anyhow::anyhow!("{name}: byte 0: cannot be read: {error}"))?;
        anyhow::ensure!(
            !magic.starts_with(FEATHER_1),
            "{name}: byte 0: Feather 1 is not read: write it again by pyarrow.feather.write_feather"
        );
        let is_file = magic.starts_with(MAGIC);
        let source: Shared = Arc::new(Mutex::new(source));
        let mut place = Place {
            source: &source,
            name,
            length,
            position: if is_file { START_BYTES } else { 0 },
        };
        let Some((Message::Schema(schema), body, start)) = place.message()? else {
            return Err(place.error("no schema comes first: not an Arrow file, or a damaged one"));
        };
        place.position += body;
        let position = place.position;
        let named: Vec<Named> = schema
            .columns
            .iter()
            .map(|column| Named {
                name: &column.name,
                stored: column.stored,
                shift: column.shift,
            })
            .collect();
        let at_start = |what: String| anyhow::anyhow!("{name}: byte {start}: {what}");
        let columns = Columns::find(&named).map_err(at_start)?;
        let mut skipped = Skipped::default();
        skipped.add("other columns", (named.len() - columns.places.len()) as u64);
        let metadata = schema.metadata.iter();
        let stated = stated_size(metadata.map(|(key, value)| (key.as_str(), value.as_str())));
        Ok(Self {
            source: Arc::clone(&source),
            name: name.to_owned(),
            length,
            is_file,
            first: position,
            position,
            schema,
            columns,
            stated,
            sensor: Sensor {
                width: 1,
                height: 1,
            },
            rows: None,
            events: 0,
            skipped,
        })
    }

    fn place(&self) -> Place<'_> {
        Place {
            source: &self.source,
            name: &self.name,
            length: self.length,
            position: self.position,
        }
    }

    fn rewind(&mut self, position: u64) {
        self.position = position;
        self.rows = None;
        self.events = 0;
    }

    fn error(&self, at: u64, what: impl std::fmt::Display) -> anyhow::Error {
        anyhow::anyhow!("{}: byte {at}: event {}: {what}", self.name, self.events)
    }

    /// Opens the next record batch; false at the end.
    fn next_rows(&mut self) -> anyhow::Result<bool> {
        loop {
            let mut place = self.place();
            let Some((message, body, start)) = place.message()? else {
                let ended = place.position;
                if self.is_file && ended == self.length {
                    return Err(place.error("the file ends before its footer: truncated"));
                }
                return Ok(false);
            };
            let body_at = place.position;
            self.position = body_at.saturating_add(body);
            if let Message::Batch(batch) = message {
                self.rows = Some(self.open_rows(&batch, start, body_at, body)?);
                return Ok(true);
            }
        }
    }

    fn open_rows(
        &self,
        batch: &RecordBatch,
        start: u64,
        body_at: u64,
        body: u64,
    ) -> anyhow::Result<Rows> {
        let open = |which: usize| {
            let name = NAMES.get(which).and_then(|names| names.first());
            let name = name.copied().unwrap_or_default();
            let error = |what: &str| self.error(start, format!("column {name}: {what}"));
            let place = self.columns.places.get(which).copied().unwrap_or_default();
            let (node, buffer) = self.schema.position(place).ok_or_else(|| {
                error("it is behind a column of a type that is not read: drop that")
            })?;
            let nulls = batch.nulls.get(node).copied();
            if nulls.ok_or_else(|| error("it is not in the batch"))? > 0 {
                return Err(error("values are missing: drop those rows"));
            }
            let (at, length) = batch.buffers.get(buffer).copied().unwrap_or_default();
            if at.checked_add(length).is_none_or(|end| end > body) {
                return Err(error("it lies outside of its batch: damaged"));
            }
            let section = Section::new(&self.source, body_at.saturating_add(at), length);
            let reader = unpacked(section, batch.codec).map_err(|what| error(&what))?;
            let stored = self.columns.stored.get(which).copied();
            Ok(Values {
                reader,
                stored: stored.unwrap_or(Stored::Bool),
                bits: (0, 0),
            })
        };
        Ok(Rows {
            start,
            left: batch.rows,
            columns: [open(0)?, open(1)?, open(2)?, open(3)?],
        })
    }

    /// Some of the next rows, at most `count`, and the error that ended them; none at the end.
    fn read_rows(&mut self, count: usize) -> anyhow::Result<(Vec<Row>, Option<anyhow::Error>)> {
        while self.rows.as_ref().is_none_or(|rows| rows.left == 0) {
            if !self.next_rows()? {
                return Ok((Vec::new(), None));
            }
        }
        let Some(rows) = &mut self.rows else {
            return Ok((Vec::new(), None));
        };
        let count = usize::try_from(rows.left).unwrap_or(usize::MAX).min(count);
        rows.left -= count as u64;
        let start = rows.start;
        let mut ended = None;
        let [t, x, y, p] = rows.columns.each_mut().map(|values| {
            let (numbers, error) = values.take(count);
            ended = ended.take().or(error);
            numbers
        });
        let rows = t.into_iter().zip(x).zip(y).zip(p);
        let rows = rows.map(|(((t, x), y), p)| [t, x, y, p]);
        let rows: Vec<Row> = rows.collect();
        let ended = ended.map(|error| {
            let event = self.events + rows.len() as u64;
            anyhow::anyhow!("{}: byte {start}: event {event}: {error}", self.name)
        });
        Ok((rows, ended))
    }

    /// Finds the unit of float times by the first of them.
    fn learn(&mut self) -> anyhow::Result<()> {
        let Some(count) = self.columns.sample() else {
            return Ok(());
        };
        let mut times = Vec::new();
        while times.len() < count {
            // Damage is for the reader, which returns the events before it.
            let Ok((rows, ended)) = self.read_rows(count - times.len()) else {
                break;
            };
            times.extend(rows.iter().map(|row| row[T]));
            if rows.is_empty() || ended.is_some() {
                break;
            }
        }
        self.columns.learn(times.into_iter());
        Ok(())
    }

    /// Size that holds every event before the first that is damaged.
    fn largest(&mut self) -> anyhow::Result<Sensor> {
        let (mut width, mut height) = (0, 0);
        'all: loop {
            let (rows, ended) = match self.read_rows(BATCH_EVENTS) {
                Ok(read) => read,
                Err(error) if width == 0 => return Err(error),
                Err(_) => break,
            };
            for row in &rows {
                let (Some(x), Some(y)) = (coordinate(row[X]), coordinate(row[Y])) else {
                    break 'all;
                };
                width = width.max(x + 1);
                height = height.max(y + 1);
            }
            if rows.is_empty() || ended.is_some() {
                break;
            }
        }
        Sensor::new(width, height).ok_or_else(|| {
            let name = &self.name;
            anyhow::anyhow!(
                "{name}: byte {}: no event, so no sensor size: give --width W --height H",
                self.position
            )
        })
    }

    /// Place and first event of the last batch that begins before `t_us`, or of the first one; batches behind
    /// a damage do not count.
    fn batch_before(&mut self, t_us: u64) -> (u64, u64) {
        let mut found = (self.first, 0);
        let mut events = 0_u64;
        self.rewind(self.first);
        while matches!(self.next_rows(), Ok(true)) {
            let Some(rows) = &mut self.rows else { break };
            if rows.left == 0 {
                continue;
            }
            let (times, _) = rows.columns[T].take(1);
            let first = times.first().copied().flatten();
            if self.columns.t_us(first).is_none_or(|first| first >= t_us) {
                break;
            }
            found = (rows.start, events);
            events = events.saturating_add(rows.left);
        }
        found
    }
}

/// A column's bytes, decompressed.
fn unpacked(mut section: Section, codec: Codec) -> Result<Box<dyn Read + Send>, String> {
    let mut size = [0; 8];
    if codec != Codec::Stored {
        // Of no bytes, there is not even their number.
        match fill(&mut section, &mut size) {
            (0, Some(_)) => return Ok(Box::new(std::io::empty())),
            (_, Some(error)) => return Err(error.to_string()),
            _ => {}
        }
    }
    let size = i64::from_le_bytes(size);
    let section = BufReader::with_capacity(BUFFER_BYTES, section);
    let left = u64::try_from(size).unwrap_or(0);
    Ok(match codec {
        _ if size == -1 || codec == Codec::Stored => Box::new(section),
        Codec::Lz4 => Box::new(FrameDecoder::new(section).take(left)),
        _ => {
            let decoder = StreamingDecoder::new(section).map_err(|error| error.to_string())?;
            Box::new(decoder.take(left))
        }
    })
}

/// A place in the file, for errors and for messages.
struct Place<'a> {
    source: &'a Shared,
    name: &'a str,
    length: u64,
    position: u64,
}

impl Place<'_> {
    fn error(&self, what: impl std::fmt::Display) -> anyhow::Error {
        anyhow::anyhow!("{}: byte {}: {what}", self.name, self.position)
    }

    fn bytes(&mut self, count: usize) -> anyhow::Result<Vec<u8>> {
        let mut bytes = vec![0; count];
        let mut source = self.source.lock().unwrap_or_else(PoisonError::into_inner);
        let read = source
            .seek(SeekFrom::Start(self.position))
            .and_then(|_| source.read_exact(&mut bytes));
        read.map_err(|error| self.error(format!("cannot be read: {error}")))?;
        drop(source);
        self.position += count as u64;
        Ok(bytes)
    }

    /// The message here, the bytes of its body, which lies wholly in the file, and where it began; `None` at
    /// the end.
    fn message(&mut self) -> anyhow::Result<Option<(Message, u64, u64)>> {
        let start = self.position;
        let mut left = self.length.saturating_sub(start);
        if left == 0 {
            return Ok(None);
        }
        let word = |bytes: Vec<u8>| {
            let word = bytes.first_chunk().copied().unwrap_or_default();
            u32::from_le_bytes(word)
        };
        let truncated = "the file ends within a message: truncated";
        if left < 4 {
            return Err(self.error(truncated));
        }
        let mut length = word(self.bytes(4)?);
        left -= 4;
        // Before version 0.15 there was the length alone.
        if length == u32::MAX {
            if left < 4 {
                return Err(self.error(truncated));
            }
            length = word(self.bytes(4)?);
            left -= 4;
        }
        if length == 0 {
            return Ok(None);
        }
        if length > METADATA_MAX || u64::from(length) > left {
            self.position = start;
            let what = format!("a message with {length} bytes of metadata: truncated or damaged");
            return Err(self.error(what));
        }
        let bytes = self.bytes(length as usize)?;
        let message = schema::message(&bytes);
        let Some((message, body)) = message else {
            self.position = start;
            return Err(self.error("a message's metadata is damaged"));
        };
        if body > self.length.saturating_sub(self.position) {
            self.position = start;
            let what = format!("a message of {body} bytes ends beyond the file: truncated");
            return Err(self.error(what));
        }
        Ok(Some((message, body, start)))
    }
}

impl Decode for ArrowDecoder {
    fn format(&self) -> &'static str {
        "arrow"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn seek(&mut self, t_us: u64) -> anyhow::Result<bool> {
        let (position, events) = self.batch_before(t_us);
        self.rewind(position);
        self.events = events;
        Ok(true)
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        while batch.room() > 0 {
            let (rows, ended) = self.read_rows(batch.room())?;
            let start = self.rows.as_ref().map_or(0, |rows| rows.start);
            for row in &rows {
                match self.columns.event(row, self.sensor) {
                    Ok(event) => batch.push(event),
                    Err((which, what)) => {
                        let name = NAMES.get(which).and_then(|names| names.first());
                        let name = name.copied().unwrap_or_default();
                        return Err(self.error(start, format!("column {name}: {what}")));
                    }
                }
                self.events += 1;
            }
            match ended {
                Some(error) => return Err(error),
                None if rows.is_empty() => break,
                None => {}
            }
        }
        Ok(())
    }
}
