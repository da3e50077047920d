//! Arrow's IPC format: files (`.arrow`, Feather 2's `.feather`) and streams (`.arrows`), as pyarrow, polars and
//! pandas write them (Arrow Columnar Format 1.5).
//!
//! A file is `ARROW1`, two zeros, a stream, and a footer that lists the batches. A stream is a sequence of
//! messages: ff ff ff ff, u32 length of the metadata, metadata (a `FlatBuffers` table), body. The first message
//! holds the schema, every other one holds rows of all columns or the values of a dictionary, and a length of 0
//! ends the stream. In the body, a column is a bitmap of the values that are present, followed by its values. Each
//! of the two is compressed with LZ4 or Zstandard, after an i64 with its decompressed size (-1: not compressed),
//! or stored uncompressed.
//!
//! - Columns: t, x, y and p, named as in a text file's header line, of any integer or float type, p also of bool;
//!   other columns are left out. `--columns` selects them by name or position. They may be indices into a
//!   dictionary of numbers, or of strings such as ON and OFF.
//! - t: a type with a unit (timestamp, duration, time), or a unit in the column's name, gives the unit; times are
//!   rounded to microseconds. Otherwise the rule of `crate::table::time_unit` applies. `crate::table::row_events`
//!   has the rules for clocks that wrap, polarities, and invalid events, such as those with a missing value.
//! - The sensor's size: from the schema's metadata (`width` and `height`, `resolution` and the like); else the
//!   caller's; else from names like `x@320`; else the largest x and y plus one, by a first pass.
//!
//! Messages are read from front to back, so that everything before a damaged place is returned. The footer is
//! needed only if it alone has the schema, as in polars' files. Seeking reads the first time of every batch. The
//! columns are read side by side, some kilobytes of each at a time.

mod schema;
mod writer;

use std::collections::HashMap;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::sync::{Arc, Mutex, PoisonError};

use event_types::stream::{ErrorKind, Result};
use event_types::{Sensor, ensure, error};
use lz4_flex::frame::FrameDecoder;
use ruzstd::decoding::StreamingDecoder;

use self::schema::{Codec, Dictionary, Items, Message, RecordBatch, Schema};
pub use self::writer::ArrowWriter;
use crate::format::{Format, Limits, Opening, Start};
use crate::input::following::ANOTHER;
use crate::input::section::{Section, Shared};
use crate::input::{Batch, Decode, ReadSeek, Reader, following};
use crate::numpy::npy_header::{Dtype, Number};
use crate::reading::Reading;
use crate::table::columns::{Columns, Named, Stored, stated};
use crate::table::event_numbers::{Row, SHORT, T, X, Y};
use crate::table::row_events::{Base, Extent, RowEvents};
use crate::table::time_unit::SAMPLE_TIMES;
use crate::text::layout as text_layout;
use crate::{Assumption, BATCH_EVENTS, Skipped};

/// First and last bytes of a file.
pub const MAGIC: &[u8] = b"ARROW1";

/// First bytes of a message.
pub const CONTINUATION: [u8; 4] = [0xff; 4];

/// First bytes of Feather 1, a different format.
const FEATHER_1: &[u8] = b"FEA1";

/// Number of bytes before a file's first message.
const START_BYTES: u64 = 8;

/// Largest length of a message's metadata in bytes.
const METADATA_MAX: u32 = 16 << 20;

/// Number of bytes of a column that are read at once.
const BUFFER_BYTES: usize = 1 << 15;

/// Largest number of values of a dictionary, and largest total length of its strings in bytes.
const DICTIONARY_MAX: usize = 1 << 22;
const TEXTS_MAX: u64 = 64 << 20;

/// The entry of Arrow files, and of reading streams, in the table of formats.
pub const FORMAT: Format = Format {
    name: "arrow",
    title: "Arrow",
    endings: &[".arrow", ".feather"],
    detect: is_arrow,
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(ArrowReader::new(source, name, &reading)?)),
    has_places: false,
    is_table: true,
    grows: false,
    streams: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(ArrowWriter::create(path, sensor, false)?))),
};

/// The entry of Arrow streams, which are written from front to back and read like [`FORMAT`].
pub const STREAM_FORMAT: Format = Format {
    name: "arrows",
    title: "Arrow stream",
    endings: &[".arrows"],
    create: Some(|path, sensor| Ok(Box::new(ArrowWriter::create(path, sensor, true)?))),
    ..FORMAT
};

/// Returns whether the file is an Arrow file, or a stream whose first message has metadata of a plausible length.
fn is_arrow(start: &Start) -> bool {
    let length = start.bytes.get(4..).and_then(<[u8]>::first_chunk);
    let is_stream = start.begins(&CONTINUATION)
        && length.is_some_and(|length| (16..METADATA_MAX).contains(&u32::from_le_bytes(*length)));
    start.begins(MAGIC) || start.begins(FEATHER_1) || is_stream
}

/// A reader of Arrow files and streams.
pub type ArrowReader = Reader<ArrowDecoder>;

impl ArrowReader {
    /// Reads `source`, which messages call `name`; `reading` states what the file does not.
    ///
    /// # Errors
    /// The source is not an Arrow file; it has no numeric columns t, x, y and p; it has neither a size nor an
    /// event.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, reading: &Reading) -> Result<Self> {
        let mut decoder = ArrowDecoder::open(source, name, reading)?;
        let start = decoder.position;
        let sample = decoder.sample();
        decoder.rewind(start);
        decoder.numbers = decoder.numbers(reading, &sample)?;
        let named = decoder.columns.sensor;
        decoder.numbers.sensor = match decoder.stated.or(reading.size).or(named) {
            Some(sensor) => sensor,
            None => {
                let sensor = decoder.largest(reading)?;
                decoder.rewind(start);
                decoder
                    .numbers
                    .assumptions
                    .push(Assumption::size_taken(sensor));
                sensor
            }
        };
        Ok(Self::around(decoder))
    }
}

/// The decoder of [`ArrowReader`]: its state between two batches of events.
pub struct ArrowDecoder {
    source: Shared,
    name: String,
    length: u64,
    is_file: bool,
    /// Offset of the first message after the schema, and of the next message.
    first: u64,
    position: u64,
    schema: Schema,
    columns: Columns,
    /// Size that the metadata states.
    stated: Option<Sensor>,
    numbers: RowEvents,
    /// Values of the dictionaries met so far.
    dictionaries: HashMap<i64, Arc<Vec<Number>>>,
    rows: Option<Rows>,
    events: u64,
}

/// A record batch that is being read.
struct Rows {
    /// Offset of the batch's message.
    start: u64,
    left: u64,
    columns: [Values; 4],
}

/// A column of the record batch that is being read.
struct Values {
    reader: Box<dyn Read + Send>,
    stored: Stored,
    bits: Bits,
    /// Bitmap of the values that are present, if some are missing.
    present: Option<(Box<dyn Read + Send>, Bits)>,
    /// Dictionary into which the values are indices.
    dictionary: Option<Arc<Vec<Number>>>,
}

/// The byte with the next bits, and the number of bits left in it.
#[derive(Default)]
struct Bits {
    byte: u8,
    left: u32,
}

impl Bits {
    fn next(&mut self, reader: &mut dyn Read) -> std::io::Result<bool> {
        if self.left == 0 {
            let mut next = [0];
            if let (_, Some(error)) = fill(reader, &mut next) {
                return Err(error);
            }
            (self.byte, self.left) = (next[0], 8);
        }
        let bit = self.byte & 1 == 1;
        self.byte >>= 1;
        self.left -= 1;
        Ok(bit)
    }
}

impl Values {
    /// Returns the next `count` numbers, or as many as there are before an error; a missing value becomes NaN.
    fn take(&mut self, count: usize) -> (Vec<Option<Number>>, Option<std::io::Error>) {
        let (mut numbers, mut error) = self.take_stored(count);
        if let Some(dictionary) = &self.dictionary {
            for number in &mut numbers {
                let place = number
                    .and_then(Number::whole)
                    .and_then(|place| usize::try_from(place).ok());
                *number = place.and_then(|place| dictionary.get(place)).copied();
            }
        }
        if let Some((reader, bits)) = &mut self.present {
            let mut known = 0;
            for number in &mut numbers {
                match bits.next(reader.as_mut()) {
                    Ok(true) => {}
                    Ok(false) => *number = Some(Number::Float(f64::NAN)),
                    Err(other) => {
                        error = Some(other);
                        break;
                    }
                }
                known += 1;
            }
            numbers.truncate(known);
        }
        (numbers, error)
    }

    fn take_stored(&mut self, count: usize) -> (Vec<Option<Number>>, Option<std::io::Error>) {
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
                    match self.bits.next(self.reader.as_mut()) {
                        Ok(bit) => numbers.push(Some(Number::Whole(bit.into()))),
                        Err(error) => return (numbers, Some(error)),
                    }
                }
                (numbers, None)
            }
        }
    }
}

/// Fills `bytes`, or as much of it as there is before an error; the end of the column is an error.
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
    fn open(mut source: Box<dyn ReadSeek>, name: &str, reading: &Reading) -> Result<Self> {
        let length = source.seek(SeekFrom::End(0));
        let length =
            length.map_err(|error| error!(Damaged, "{name}: byte 0: cannot seek: {error}"))?;
        let mut magic = Vec::new();
        let read = source
            .rewind()
            .and_then(|()| source.by_ref().take(START_BYTES).read_to_end(&mut magic));
        read.map_err(|error| error!(Damaged, "{name}: byte 0: cannot be read: {error}"))?;
        ensure!(
            !magic.starts_with(FEATHER_1),
            Unsupported,
            "{name}: byte 0: Feather 1 is not supported: write the file again with \
             pyarrow.feather.write_feather"
        );
        let mut is_file = magic.starts_with(MAGIC);
        let mut length = length;
        let source: Shared = Arc::new(Mutex::new(source));
        let mut place = Place {
            source: &source,
            name,
            length,
            position: if is_file { START_BYTES } else { 0 },
        };
        let start = place.position;
        let schema = match place.message() {
            Ok(Some((Message::Schema(schema), body, _))) => {
                place.position += body;
                schema
            }
            // polars writes the schema only into the footer.
            other if is_file => {
                place.position = start;
                let Some((schema, first, at)) = place.footer() else {
                    other?;
                    place.position = start;
                    return Err(place
                        .error("no schema at the start or in the footer: truncated or damaged"));
                };
                place.position = first;
                (length, is_file) = (at, false);
                schema
            }
            other => {
                other?;
                return Err(
                    place.error("no schema at the start: not an Arrow file, or a damaged one")
                );
            }
        };
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
        let at_start = |what: String| error!(Damaged, "{name}: byte {start}: {what}");
        let mut columns = Columns::find(&named, reading).map_err(at_start)?;
        for (which, place) in columns.places.into_iter().enumerate() {
            // The stored type of a dictionary column is that of its indices, not of its times.
            let column = schema.columns.get(place);
            if let (T, Some((_, items))) = (which, column.and_then(|column| column.dictionary)) {
                columns.times.is_u32 = false;
                columns.times.is_float =
                    matches!(items, Items::Numbers(Stored::Number(dtype)) if dtype.is_float());
            }
        }
        let metadata = schema.metadata.iter();
        let (stated, scale) = stated(metadata.map(|(key, value)| (key.as_str(), value.as_str())));
        columns.times.scale = columns.times.scale.or(scale);
        let numbers = RowEvents::new(reading, columns.times, Base::default(), &[]);
        let numbers = numbers.map_err(|what| at_start(what).of_kind(ErrorKind::Undecided))?;
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
            numbers,
            dictionaries: HashMap::new(),
            rows: None,
            events: 0,
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
        self.numbers.rewind();
    }

    /// Returns the converter from rows to events, for a recording whose rows begin with `sample`.
    fn numbers(&self, reading: &Reading, sample: &[Row]) -> Result<RowEvents> {
        let numbers = RowEvents::new(reading, self.columns.times, Base::default(), sample);
        let mut numbers =
            numbers.map_err(|what| self.error(self.first, what).of_kind(ErrorKind::Undecided))?;
        numbers.assumptions.extend(self.columns.assumption.clone());
        let others = self.schema.columns.len() - self.columns.places.len();
        numbers.skipped.add("other columns", others as u64);
        Ok(numbers)
    }

    fn error(&self, at: u64, what: impl std::fmt::Display) -> event_types::stream::Error {
        error!(
            Damaged,
            "{}: byte {at}: event {}: {what}", self.name, self.events
        )
    }

    /// Opens the next record batch; returns false at the end.
    fn next_rows(&mut self) -> Result<bool> {
        loop {
            let mut place = self.place();
            let Some((message, body, start)) = place.message()? else {
                let ended = place.position;
                if self.is_file && ended == self.length {
                    return Err(place.error("the file ends before its footer: truncated"));
                }
                place.check_nothing_follows(self.is_file)?;
                return Ok(false);
            };
            let body_at = place.position;
            self.position = body_at.saturating_add(body);
            match message {
                Message::Batch(batch) => {
                    self.rows = Some(self.open_rows(&batch, start, body_at, body)?);
                    return Ok(true);
                }
                Message::Dictionary(dictionary) => {
                    self.take_dictionary(&dictionary, start, (body_at, body))?;
                }
                _ => {}
            }
        }
    }

    /// Keeps the values of a dictionary if t, x, y or p refers to it.
    fn take_dictionary(
        &mut self,
        dictionary: &Dictionary,
        start: u64,
        body: (u64, u64),
    ) -> Result<()> {
        let columns = self
            .columns
            .places
            .iter()
            .filter_map(|place| self.schema.columns.get(*place));
        let mut known = columns.filter_map(|column| column.dictionary);
        let Some((_, items)) = known.find(|(id, _)| *id == dictionary.id) else {
            return Ok(());
        };
        let values = self.items(dictionary, items, body);
        let values = values.map_err(|what| self.error(start, format!("a dictionary: {what}")))?;
        let all = self.dictionaries.entry(dictionary.id).or_default();
        if dictionary.is_more {
            let all = Arc::make_mut(all);
            all.extend(values);
            if all.len() > DICTIONARY_MAX {
                return Err(self.error(
                    start,
                    "a dictionary has too many values: write plain columns",
                ));
            }
        } else {
            *all = Arc::new(values);
        }
        Ok(())
    }

    /// Returns the values of a dictionary.
    fn items(
        &self,
        dictionary: &Dictionary,
        items: Items,
        body: (u64, u64),
    ) -> Result<Vec<Number>, String> {
        let batch = &dictionary.batch;
        let rows = usize::try_from(batch.rows)
            .ok()
            .filter(|rows| *rows <= DICTIONARY_MAX);
        let rows = rows.ok_or("it has too many values: write plain columns")?;
        if batch.nulls.first().is_some_and(|nulls| *nulls > 0) {
            return Err("a value is missing: write plain columns".to_owned());
        }
        let open = |buffer: usize| {
            let place = batch.buffers.get(buffer).copied();
            self.buffer(place.ok_or("a buffer is missing")?, body, batch.codec)
        };
        let numbers =
            |stored: Stored, buffer: usize, count: usize| -> Result<Vec<Option<Number>>, String> {
                let mut values = Values {
                    reader: open(buffer)?,
                    stored,
                    bits: Bits::default(),
                    present: None,
                    dictionary: None,
                };
                let (numbers, error) = values.take(count);
                match error {
                    Some(error) => Err(error.to_string()),
                    None => Ok(numbers),
                }
            };
        let too_large = || "a number above 2^63".to_owned();
        match items {
            Items::Numbers(stored) => {
                let numbers = numbers(stored, 1, rows)?.into_iter();
                numbers.map(|number| number.ok_or_else(too_large)).collect()
            }
            Items::Texts(bytes) => {
                let dtype = Dtype::new(b'i', false, bytes).ok_or("unknown type of text")?;
                let ends = numbers(Stored::Number(dtype), 1, rows + 1)?;
                let ends = ends
                    .into_iter()
                    .map(|end| usize::try_from(end?.whole()?).ok());
                let ends: Option<Vec<usize>> = ends.collect();
                let ends = ends.ok_or("damaged text")?;
                let mut letters = Vec::new();
                let read = open(2)?.take(TEXTS_MAX).read_to_end(&mut letters);
                read.map_err(|error| error.to_string())?;
                let texts = ends.iter().zip(ends.iter().skip(1));
                texts
                    .map(|(start, end)| item(letters.get(*start..*end).ok_or("damaged text")?))
                    .collect()
            }
        }
    }

    /// Returns a buffer of a message's body, decompressed.
    fn buffer(
        &self,
        (at, length): (u64, u64),
        (body_at, body): (u64, u64),
        codec: Codec,
    ) -> Result<Box<dyn Read + Send>, String> {
        if at.checked_add(length).is_none_or(|end| end > body) {
            return Err("it lies outside its batch: damaged".to_owned());
        }
        let section = Section::new(&self.source, body_at.saturating_add(at), length);
        unpacked(section, codec)
    }

    fn open_rows(&self, batch: &RecordBatch, start: u64, body_at: u64, body: u64) -> Result<Rows> {
        let open = |which: usize| -> Result<Values> {
            let name = SHORT.get(which).copied().unwrap_or_default();
            let error = |what: &str| self.error(start, format!("column {name}: {what}"));
            let place = self.columns.places.get(which).copied().unwrap_or_default();
            let (node, buffer) = self.schema.position(place).ok_or_else(|| {
                error("it comes after a column of an unsupported type: drop that column")
            })?;
            let nulls = batch.nulls.get(node).copied();
            let nulls = nulls.ok_or_else(|| error("it is not in the batch"))?;
            let open = |buffer: usize| {
                let place = batch.buffers.get(buffer).copied().unwrap_or_default();
                let reader = self.buffer(place, (body_at, body), batch.codec);
                reader.map_err(|what| error(&what))
            };
            let present = match nulls {
                0 => None,
                _ => Some((open(buffer.saturating_sub(1))?, Bits::default())),
            };
            let column = self.schema.columns.get(place);
            let dictionary = match column.and_then(|column| column.dictionary) {
                None => None,
                Some((id, _)) => {
                    let known = self.dictionaries.get(&id).cloned();
                    Some(known.ok_or_else(|| error("its dictionary is missing: damaged"))?)
                }
            };
            let stored = self.columns.stored.get(which).copied();
            Ok(Values {
                reader: open(buffer)?,
                stored: stored.unwrap_or(Stored::Bool),
                bits: Bits::default(),
                present,
                dictionary,
            })
        };
        Ok(Rows {
            start,
            left: batch.rows,
            columns: [open(0)?, open(1)?, open(2)?, open(3)?],
        })
    }

    /// Returns the next rows, at most `count`, and the error that ended them; no rows at the end.
    fn read_rows(
        &mut self,
        count: usize,
    ) -> Result<(Vec<Row>, Option<event_types::stream::Error>)> {
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
            error!(
                Damaged,
                "{}: byte {start}: event {event}: {error}", self.name
            )
        });
        Ok((rows, ended))
    }

    /// Returns the first rows; damage is reported later by the reader, after the events before it.
    fn sample(&mut self) -> Vec<Row> {
        let mut sample = Vec::new();
        while sample.len() < SAMPLE_TIMES {
            let Ok((rows, ended)) = self.read_rows(SAMPLE_TIMES - sample.len()) else {
                break;
            };
            let is_end = rows.is_empty() || ended.is_some();
            sample.extend(rows);
            if is_end {
                break;
            }
        }
        sample
    }

    /// Returns the size that holds every event before the first damaged one.
    fn largest(&mut self, reading: &Reading) -> Result<Sensor> {
        let mut extent = Extent::new(reading);
        'all: loop {
            let (rows, ended) = match self.read_rows(BATCH_EVENTS) {
                Ok(read) => read,
                Err(error) if extent.is_empty() => return Err(error),
                Err(_) => break,
            };
            for row in &rows {
                if !extent.add(row[X], row[Y]) {
                    break 'all;
                }
            }
            if rows.is_empty() || ended.is_some() {
                break;
            }
        }
        extent.sensor(&self.name)
    }

    /// Returns the offset and the first event number of the last batch that begins before `t_us`, or of the first
    /// batch; ignores batches after a damaged place.
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
            if self.numbers.t_us(first).is_none_or(|first| first >= t_us) {
                break;
            }
            found = (rows.start, events);
            events = events.saturating_add(rows.left);
        }
        found
    }
}

/// Converts a string of a dictionary to a number: a polarity, or the number that it spells.
fn item(text: &[u8]) -> Result<Number, String> {
    if let Some(on) = text_layout::polarity(text) {
        // Keep -1 distinct from 0.
        return Ok(Number::Whole(if text.starts_with(b"-") {
            -1
        } else {
            on.into()
        }));
    }
    let text = String::from_utf8_lossy(text);
    let number = text.trim().parse().map(Number::Whole);
    let number = number.or_else(|_| text.trim().parse().map(Number::Float));
    number.map_err(|_| format!("{} is neither a number nor a polarity", text.escape_debug()))
}

/// The end of one file followed by the start of another.
const JOINED: &[u8] = b"ARROW1ARROW1";

/// Returns the schema of a message with its length prefix; `None` if the message holds none.
pub fn schema_of_message(bytes: &[u8]) -> Option<Schema> {
    let rest = bytes.strip_prefix(&CONTINUATION).unwrap_or(bytes);
    match schema::message(rest.get(4..)?)? {
        (Message::Schema(schema), _) => Some(schema),
        _ => None,
    }
}

/// Returns a reader of a column's decompressed bytes.
fn unpacked(mut section: Section, codec: Codec) -> Result<Box<dyn Read + Send>, String> {
    let mut size = [0; 8];
    if codec != Codec::Stored {
        // An empty buffer does not even have its decompressed size.
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

/// A position in the file, for reading messages and reporting errors.
struct Place<'a> {
    source: &'a Shared,
    name: &'a str,
    length: u64,
    position: u64,
}

impl Place<'_> {
    fn error(&self, what: impl std::fmt::Display) -> event_types::stream::Error {
        error!(Damaged, "{}: byte {}: {what}", self.name, self.position)
    }

    /// Returns the schema in a file's footer, the offset of the first message that the footer lists, and the
    /// footer's own offset.
    fn footer(&mut self) -> Option<(Schema, u64, u64)> {
        let start = self.position;
        let end = self.length.checked_sub(10)?;
        self.position = end;
        let tail = self.bytes(10).ok()?;
        let (size, magic) = tail.split_first_chunk()?;
        let size = u32::from_le_bytes(*size);
        if magic != MAGIC || size > METADATA_MAX {
            return None;
        }
        let at = end
            .checked_sub(size.into())
            .filter(|at| *at >= START_BYTES)?;
        self.position = at;
        let bytes = self.bytes(size as usize).ok();
        self.position = start;
        let (schema, first) = schema::footer(&bytes?)?;
        let first = first.unwrap_or(at);
        (START_BYTES..=at)
            .contains(&first)
            .then_some((schema, first, at))
    }

    /// Returns an error if another file follows the end of this one, or another stream the end of this stream.
    fn check_nothing_follows(&mut self, is_file: bool) -> Result<()> {
        let shared = self.source;
        let mut source = shared.lock().unwrap_or_else(PoisonError::into_inner);
        let source = source.as_mut();
        let found = match is_file {
            true => following::find(source, self.position, JOINED)
                .map(|found| found.map(|at| at + MAGIC.len() as u64)),
            false => following::is_at(source, self.position, &CONTINUATION)
                .map(|is_there| is_there.then_some(self.position)),
        };
        match found {
            Ok(None) => Ok(()),
            Ok(Some(at)) => {
                self.position = at;
                Err(self.error(ANOTHER))
            }
            Err(error) => Err(self.error(format!("cannot be read: {error}"))),
        }
    }

    fn bytes(&mut self, count: usize) -> Result<Vec<u8>> {
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

    /// Reads the message at the current position. Returns it, the length of its body, which lies wholly in the
    /// file, and the offset of the message; `None` at the end.
    fn message(&mut self) -> Result<Option<(Message, u64, u64)>> {
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
        // Before version 0.15, only the length preceded the metadata.
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
        self.numbers.sensor
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.numbers.assumptions
    }

    fn skipped(&self) -> &Skipped {
        &self.numbers.skipped
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        if self.numbers.may_wrap() {
            return Ok(false);
        }
        let (position, events) = self.batch_before(t_us);
        self.rewind(position);
        self.events = events;
        Ok(true)
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        while batch.room() > 0 {
            let (rows, ended) = self.read_rows(batch.room())?;
            let start = self.rows.as_ref().map_or(0, |rows| rows.start);
            let appended = self.numbers.append(&rows, &mut self.events, batch);
            if let Err((which, what)) = appended {
                let name = SHORT.get(which).copied().unwrap_or_default();
                return Err(self.error(start, format!("column {name}: {what}")));
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
