//! Reads and writes Apache Parquet files (`.parquet`), as written by pyarrow, polars, DuckDB and pandas.
//!
//! A file is `PAR1`, row groups, a footer in Thrift's compact protocol, the footer's size in bytes (u32), `PAR1`. A
//! column of a row group is a sequence of pages, each after a header. A page holds values, possibly after a list
//! that says which are missing, or the dictionary that later pages refer to.
//!
//! * Columns, times, polarities, missing values and the sensor's size are as in Arrow files; `width` and `height`
//!   are among the footer's keys. Parquet stores a duration as an integer; its unit is in the schema that Arrow's
//!   writers leave among these keys. Columns must be plain columns of rows, not parts of groups or lists.
//! * Encodings: plain, dictionary, runs, delta, byte stream split. Compression: none, Snappy, gzip, Brotli,
//!   Zstandard, LZ4 (raw); LZO and Hadoop's LZ4 are refused with an explanation. A page's CRC-32 is checked if it
//!   has one. Encrypted files are not read.
//!
//! The `parquet` crate is not used: damaged files still make it panic (apache/arrow-rs#9742), and it allocates the
//! sizes that a file claims. This reader supports only flat columns of numbers.
//!
//! The reader holds the footer and one page of every column. A truncated file has lost its footer and cannot be
//! read at all. Seeking goes to the last row group whose least time, by its statistics, is before the time sought.

mod metadata;
pub mod table;
mod thrift;
mod values;
mod writer;

use std::io::{BufRead, BufReader, Read, SeekFrom};
use std::sync::{Arc, Mutex};

use event_types::stream::{ErrorKind, Result};
use event_types::{Sensor, bail, ensure, error};

use self::metadata::{Metadata, Page};
use self::values::{Runs, Values};
pub use self::writer::ParquetWriter;
use crate::format::{Format, Limits, Opening};
use crate::input::following::ANOTHER;
use crate::input::section::{Section, Shared};
use crate::input::{Batch, Decode, ReadSeek, Reader, following};
use crate::numpy::npy_header::Number;
use crate::reading::Reading;
use crate::table::columns::{Columns, Named, Stored, stated};
use crate::table::event_numbers::{Row, SHORT, T, X, Y};
use crate::table::row_events::{Base, Extent, RowEvents};
use crate::table::time_unit::SAMPLE_TIMES;
use crate::{Assumption, BATCH_EVENTS, Skipped, unpack};

/// First and last bytes of a file.
pub const MAGIC: &[u8; 4] = b"PAR1";

/// The end of a file, followed by the start of another file that was appended to it.
const JOINED: &[u8] = b"PAR1PAR1";

/// Last bytes of a file whose footer is encrypted.
const ENCRYPTED: &[u8; 4] = b"PARE";

/// Largest footer in bytes; it takes some hundred for every row group and column.
const FOOTER_MAX: u64 = 64 << 20;

/// Largest unpacked size of a page in bytes, and its largest number of values; writers aim at 1 MB.
const PAGE_BYTES_MAX: u64 = 64 << 20;
const PAGE_VALUES_MAX: u64 = 1 << 26;

/// Largest number of rows per byte of the file: values may take no bytes, so that a few could otherwise keep a
/// reader busy.
const EXPANSION_MAX: u64 = 1100;

/// Number of bytes of a column read at once.
const BUFFER_BYTES: usize = 1 << 16;

/// Number of bytes of a page that Brotli's decoder takes at once.
const BROTLI_BYTES: usize = 1 << 12;

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "parquet",
    title: "Parquet",
    endings: &[".parquet"],
    detect: |start| start.begins(MAGIC) || start.begins(ENCRYPTED),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(ParquetReader::new(source, name, &reading)?)),
    has_places: false,
    is_table: true,
    grows: false,
    streams: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(ParquetWriter::create(path, sensor)?))),
};

/// A reader of Parquet files.
pub type ParquetReader = Reader<ParquetDecoder>;

impl ParquetReader {
    /// Reads `source`, which messages call `name`; `reading` states what the file does not.
    ///
    /// # Errors
    /// This is no Parquet file, or it is damaged; it has no columns t, x, y, p of numbers; the unit or the size
    /// cannot be determined.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, reading: &Reading) -> Result<Self> {
        let (mut decoder, stated) = ParquetDecoder::open(source, name, reading)?;
        let sample = decoder.sample();
        decoder.go_to(0);
        decoder.numbers = decoder.numbers(reading, &sample)?;
        let sensor = stated.or(reading.size).or(decoder.columns.sensor);
        decoder.numbers.sensor = match sensor {
            Some(sensor) => sensor,
            None => {
                let sensor = decoder.largest(reading)?;
                decoder.go_to(0);
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

/// The decoder of [`ParquetReader`]: its state between two batches.
pub struct ParquetDecoder {
    source: Shared,
    name: String,
    metadata: Metadata,
    columns: Columns,
    numbers: RowEvents,
    /// The next row group, and the current one.
    next_group: usize,
    rows: Option<Rows>,
    events: u64,
    /// Whole numbers of the four columns, kept for their memory.
    whole: [Vec<i64>; 4],
}

/// A row group that is being read.
struct Rows {
    left: u64,
    columns: [Column; 4],
}

/// A column of a row group that is being read.
struct Column {
    /// Offset of its first byte, for messages.
    start: u64,
    reader: BufReader<Section>,
    stored: Stored,
    is_optional: bool,
    codec: i64,
    dictionary: Vec<Option<Number>>,
    /// The dictionary, if it has whole numbers alone.
    whole_dictionary: Option<Vec<i64>>,
    values: Option<Values>,
    /// Number of values left in the page.
    left: u64,
    /// For each value of the page, whether it is present.
    present: Option<Runs>,
}

impl Column {
    /// Returns the next `count` numbers, or those before an error, with the error.
    fn take(&mut self, count: usize) -> (Vec<Option<Number>>, Option<String>) {
        let mut numbers = Vec::with_capacity(count);
        while numbers.len() < count {
            if let Err(what) = self.take_some(count - numbers.len(), &mut numbers) {
                return (numbers, Some(what));
            }
        }
        (numbers, None)
    }

    /// Appends at least one and at most `count` of the next numbers.
    fn take_some(&mut self, count: usize, numbers: &mut Vec<Option<Number>>) -> Result<(), String> {
        while self.left == 0 {
            self.open_page()?;
        }
        if self.present.is_some() {
            numbers.push(self.next()?);
            return Ok(());
        }
        let count = usize::try_from(self.left).unwrap_or(usize::MAX).min(count);
        let before = numbers.len();
        if let Some(values) = &mut self.values {
            values.take(count, &self.dictionary, numbers);
        }
        let taken = numbers.len() - before;
        self.left -= taken as u64;
        if taken < count {
            return Err("a damaged page".to_owned());
        }
        Ok(())
    }

    /// Returns how many of the page's next values [`Column::take_whole`] gives: at the page's end none, and `None` where
    /// values are missing or are no whole numbers.
    fn whole(&mut self) -> Option<u64> {
        let Some(values) = self.values.as_ref().filter(|_| self.left > 0) else {
            return Some(0);
        };
        if !values.is_whole(self.whole_dictionary.as_deref()) {
            return None;
        }
        match &mut self.present {
            Some(present) => Some(present.ones()?.min(self.left)),
            None => Some(self.left),
        }
    }

    /// Appends the next `count` numbers, of those that [`Column::whole`] counts, to `numbers`; fewer if the page is damaged.
    fn take_whole(&mut self, count: usize, numbers: &mut Vec<i64>) {
        let before = numbers.len();
        if let Some(values) = &mut self.values {
            let dictionary = self.whole_dictionary.as_deref().unwrap_or_default();
            values.take_whole(count, dictionary, numbers);
        }
        let taken = numbers.len() - before;
        self.left -= taken as u64;
        if let Some(present) = &mut self.present {
            present.skip_ones(taken);
        }
    }

    fn next(&mut self) -> Result<Option<Number>, String> {
        while self.left == 0 {
            self.open_page()?;
        }
        if let Some(present) = &mut self.present
            && present.next().ok_or("a damaged page")? == 0
        {
            self.left -= 1;
            return Ok(Some(Number::Float(f64::NAN)));
        }
        let values = self.values.as_mut().ok_or("a damaged page")?;
        let number = values.next(&self.dictionary).ok_or("a damaged page")?;
        self.left -= 1;
        Ok(number)
    }

    fn open_page(&mut self) -> Result<(), String> {
        // A read error is treated like the end, since the values are missing either way.
        if self.reader.fill_buf().map_or(true, <[u8]>::is_empty) {
            return Err("the column has fewer values than the row group has rows".to_owned());
        }
        let page = metadata::page(&mut self.reader).ok_or("a damaged page header")?;
        if page.bytes > PAGE_BYTES_MAX || page.stored_bytes > PAGE_BYTES_MAX {
            return Err("a page above 64 MB: write the file again with smaller pages".to_owned());
        }
        let stored = unpack::stream(
            (&mut self.reader).take(page.stored_bytes),
            page.stored_bytes as usize,
        );
        let stored = stored.filter(|stored| stored.len() as u64 == page.stored_bytes);
        let stored = stored.ok_or("a page ends beyond its column: truncated or damaged")?;
        if let Some(crc) = page.crc {
            let mut sum = flate2::Crc::new();
            sum.update(&stored);
            if sum.sum() != crc {
                return Err("a page's CRC-32 is wrong: damaged data".to_owned());
            }
        }
        match page.kind {
            0 => self.open_values(&page, &stored),
            2 => {
                let bytes = unpack(&stored, page.bytes, self.codec)?;
                let mut values = Values::new(bytes, values::PLAIN, self.stored)?;
                self.dictionary = std::iter::from_fn(|| values.next(&[]))
                    .take(usize::try_from(page.values).unwrap_or(usize::MAX))
                    .collect();
                let whole = self.dictionary.iter().map(|number| match number {
                    Some(Number::Whole(value)) => Some(*value),
                    _ => None,
                });
                self.whole_dictionary = whole.collect();
                Ok(())
            }
            3 => self.open_values_2(&page, &stored),
            // Index pages.
            _ => Ok(()),
        }
    }

    /// Opens a page of version 1: values, after a list of those that are present, compressed together.
    fn open_values(&mut self, page: &Page, stored: &[u8]) -> Result<(), String> {
        let mut bytes = unpack(stored, page.bytes, self.codec)?;
        let mut present = None;
        if self.is_optional {
            let length = bytes.first_chunk().ok_or("a damaged page")?;
            let length = u32::from_le_bytes(*length) as usize;
            let rest = bytes.split_off(4);
            let (levels, values) = rest.split_at_checked(length).ok_or("a damaged page")?;
            present = Runs::new(levels.to_vec(), 1);
            bytes = values.to_vec();
        }
        self.begin(page, bytes, present)
    }

    /// Opens a page of version 2, in which the list is not compressed.
    fn open_values_2(&mut self, page: &Page, stored: &[u8]) -> Result<(), String> {
        let [nested, there] = page.levels;
        let levels = nested.checked_add(there).ok_or("a damaged page")?;
        let split = usize::try_from(levels).ok();
        let (list, values) = split
            .and_then(|split| stored.split_at_checked(split))
            .ok_or("a damaged page")?;
        let left = page.bytes.checked_sub(levels).ok_or("a damaged page")?;
        let codec = if page.is_compressed { self.codec } else { 0 };
        let bytes = unpack(values, left, codec)?;
        let list = list.get(nested as usize..).unwrap_or_default();
        let present = self.is_optional.then(|| Runs::new(list.to_vec(), 1));
        self.begin(page, bytes, present.flatten())
    }

    fn begin(&mut self, page: &Page, bytes: Vec<u8>, present: Option<Runs>) -> Result<(), String> {
        if page.values > PAGE_VALUES_MAX {
            return Err(format!("a page of {} values: damaged", page.values));
        }
        self.values = Some(Values::new(bytes, page.encoding, self.stored)?);
        self.present = present;
        self.left = page.values;
        Ok(())
    }
}

/// Decompresses a page to exactly `bytes` bytes.
fn unpack(stored: &[u8], bytes: u64, codec: i64) -> Result<Vec<u8>, String> {
    let size = usize::try_from(bytes).map_err(|error| error.to_string())?;
    let unpacked = match codec {
        0 => Some(stored.to_vec()),
        1 => unpack::snappy(stored, size),
        2 => unpack::stream(flate2::read::MultiGzDecoder::new(stored), size),
        4 => unpack::stream(
            brotli_decompressor::Decompressor::new(stored, BROTLI_BYTES),
            size,
        ),
        6 => unpack::zstandard(stored, size),
        7 => lz4_flex::block::decompress(stored, size).ok(),
        other => {
            let name = match other {
                3 => "LZO",
                5 => "Hadoop's LZ4",
                _ => "an unknown codec",
            };
            return Err(format!(
                "packed with {name}: write the file again with zstd"
            ));
        }
    };
    let unpacked = unpacked.filter(|unpacked| unpacked.len() == size);
    unpacked.ok_or_else(|| "a page cannot be decompressed: damaged data".to_owned())
}

impl ParquetDecoder {
    fn open(
        mut source: Box<dyn ReadSeek>,
        name: &str,
        reading: &Reading,
    ) -> Result<(Self, Option<Sensor>)> {
        let (length, bytes) = footer(source.as_mut(), name)?;
        let start = length - 8 - bytes.len() as u64;
        let error = |what: &str| error!(Damaged, "{name}: byte {start}: {what}");
        let metadata = Metadata::read(&bytes).ok_or_else(|| error("the footer is damaged"))?;
        if metadata.rows > length.saturating_mul(EXPANSION_MAX) {
            return Err(error("the footer claims more rows than the file can hold"));
        }
        let total = metadata.groups.iter().map(|group| group.rows);
        let total = total.fold(0_u64, u64::saturating_add);
        if total != metadata.rows {
            return Err(error(
                "the row groups do not have the number of rows that the footer states",
            ));
        }
        let chunks = metadata.groups.iter().flat_map(|group| &group.chunks);
        let last = chunks
            .map(|chunk| chunk.start.saturating_add(chunk.bytes))
            .max();
        let last = last.unwrap_or(0).min(start);
        let joined = following::find(source.as_mut(), last, JOINED)
            .map_err(|failed| error(&format!("cannot be read: {failed}")))?;
        if let Some(at) = joined {
            bail!(
                Damaged,
                "{name}: byte {}: {ANOTHER}",
                at + MAGIC.len() as u64
            );
        }
        let named: Vec<Named> = metadata
            .fields
            .iter()
            .map(|field| Named {
                name: &field.name,
                stored: field.stored,
                shift: field.shift,
            })
            .collect();
        let mut columns = Columns::find(&named, reading).map_err(|what| error(&what))?;
        let pairs = metadata.metadata.iter();
        let (stated, scale) = stated(pairs.map(|(key, value)| (key.as_str(), value.as_str())));
        columns.times.scale = columns.times.scale.or(scale);
        let numbers = RowEvents::new(reading, columns.times, Base::default(), &[]);
        let numbers = numbers.map_err(|what| error(&what).of_kind(ErrorKind::Undecided))?;
        let decoder = Self {
            source: Arc::new(Mutex::new(source)),
            name: name.to_owned(),
            metadata,
            columns,
            numbers,
            next_group: 0,
            rows: None,
            events: 0,
            whole: Default::default(),
        };
        Ok((decoder, stated))
    }

    /// Continues at a row group.
    fn go_to(&mut self, group: usize) {
        let before = self.metadata.groups.get(..group).unwrap_or_default();
        self.events = before.iter().map(|group| group.rows).sum();
        self.next_group = group;
        self.rows = None;
    }

    fn error(
        &self,
        which: usize,
        event: u64,
        what: impl std::fmt::Display,
    ) -> event_types::stream::Error {
        let column = self.rows.as_ref().and_then(|rows| rows.columns.get(which));
        let start = column.map_or(0, |column| column.start);
        let name = SHORT.get(which).copied().unwrap_or_default();
        error!(
            Damaged,
            "{}: byte {start}: event {event}: column {name}: {what}", self.name
        )
    }

    /// Opens the next row group; returns `false` at the end.
    fn next_rows(&mut self) -> bool {
        let Some(group) = self.metadata.groups.get(self.next_group) else {
            return false;
        };
        self.next_group += 1;
        let open = |which: usize| {
            let place = self.columns.places.get(which).copied().unwrap_or_default();
            let field = self.metadata.fields.get(place);
            // A missing chunk is opened without bytes; reading it then reports the error.
            let chunk = field.and_then(|field| group.chunks.get(field.leaf));
            let chunk = chunk.cloned().unwrap_or_default();
            let section = Section::new(&self.source, chunk.start, chunk.bytes);
            Column {
                start: chunk.start,
                reader: BufReader::with_capacity(BUFFER_BYTES, section),
                stored: self
                    .columns
                    .stored
                    .get(which)
                    .copied()
                    .unwrap_or(Stored::Bool),
                is_optional: field.is_some_and(|field| field.is_optional),
                codec: chunk.codec,
                dictionary: Vec::new(),
                whole_dictionary: None,
                values: None,
                left: 0,
                present: None,
            }
        };
        self.rows = Some(Rows {
            left: group.rows,
            columns: [open(0), open(1), open(2), open(3)],
        });
        true
    }

    /// Returns up to `count` of the next rows, and the error that ended them; no rows and no error at the end.
    fn read_rows(&mut self, count: usize) -> (Vec<Row>, Option<event_types::stream::Error>) {
        while self.rows.as_ref().is_none_or(|rows| rows.left == 0) {
            if !self.next_rows() {
                return (Vec::new(), None);
            }
        }
        let Some(rows) = &mut self.rows else {
            return (Vec::new(), None);
        };
        let count = usize::try_from(rows.left).unwrap_or(usize::MAX).min(count);
        rows.left -= count as u64;
        let mut ended: Option<(usize, usize, String)> = None;
        let mut which = 0;
        let [t, x, y, p] = rows.columns.each_mut().map(|column| {
            let (numbers, error) = column.take(count);
            if let Some(what) = error
                && ended
                    .as_ref()
                    .is_none_or(|(_, least, _)| numbers.len() < *least)
            {
                ended = Some((which, numbers.len(), what));
            }
            which += 1;
            numbers
        });
        let rows = t.into_iter().zip(x).zip(y).zip(p);
        let rows: Vec<Row> = rows.map(|(((t, x), y), p)| [t, x, y, p]).collect();
        let ended = ended.map(|(which, before, what)| {
            let event = self.events + before as u64;
            self.error(which, event, what)
        });
        (rows, ended)
    }

    /// Appends the events of up to `count` of the next rows, if these are whole numbers within the columns' pages, and
    /// returns how many rows to read by [`ParquetDecoder::read_rows`] before it is called again.
    fn read_whole(&mut self, count: usize, batch: &mut Batch<'_>) -> Result<usize> {
        let Some(rows) = self.rows.as_mut().filter(|rows| rows.left > 0) else {
            return Ok(1);
        };
        let mut ready = rows.left.min(count as u64);
        for column in &mut rows.columns {
            let Some(whole) = column.whole() else {
                return Ok(count);
            };
            ready = ready.min(whole);
        }
        let ready = ready as usize;
        rows.left -= ready as u64;
        let mut least: Option<(usize, usize)> = None;
        for (which, (column, numbers)) in rows.columns.iter_mut().zip(&mut self.whole).enumerate() {
            numbers.clear();
            column.take_whole(ready, numbers);
            if least.is_none_or(|(_, length)| numbers.len() < length) {
                least = Some((which, numbers.len()));
            }
        }
        let (which, whole) = least.unwrap_or_default();
        let columns = self.whole.each_ref().map(|numbers| &numbers[..whole]);
        let appended = self
            .numbers
            .append_columns(columns, &mut self.events, batch);
        if let Err((which, what)) = appended {
            return Err(self.error(which, self.events, what));
        }
        if whole < ready {
            return Err(self.error(which, self.events, "a damaged page"));
        }
        // A row at the end of a page, which opens the next one.
        Ok(1)
    }

    /// Returns the first rows; damage ends them, and the reader reports it later.
    fn sample(&mut self) -> Vec<Row> {
        let mut sample = Vec::new();
        while sample.len() < SAMPLE_TIMES {
            let (rows, ended) = self.read_rows(SAMPLE_TIMES - sample.len());
            let is_end = rows.is_empty() || ended.is_some();
            sample.extend(rows);
            if is_end {
                break;
            }
        }
        sample
    }

    /// Returns the converter of rows that begin with `sample`.
    fn numbers(&self, reading: &Reading, sample: &[Row]) -> Result<RowEvents> {
        let numbers = RowEvents::new(reading, self.columns.times, Base::default(), sample);
        let mut numbers =
            numbers.map_err(|what| error!(Undecided, "{}: byte 0: {what}", self.name))?;
        numbers.assumptions.extend(self.columns.assumption.clone());
        let others = self.metadata.fields.len() - self.columns.places.len();
        numbers.skipped.add("other columns", others as u64);
        Ok(numbers)
    }

    /// Returns the smallest sensor that holds every event before the first damage.
    fn largest(&mut self, reading: &Reading) -> Result<Sensor> {
        let mut extent = Extent::new(reading);
        'all: loop {
            let (rows, ended) = self.read_rows(BATCH_EVENTS);
            for row in &rows {
                if !extent.add(row[X], row[Y]) {
                    break 'all;
                }
            }
            match ended {
                Some(error) if extent.is_empty() => return Err(error),
                None if !rows.is_empty() => {}
                _ => break,
            }
        }
        extent.sensor(&self.name)
    }

    /// Returns the last row group that begins before `t_us`, or the first one; `None` if statistics are missing.
    fn group_before(&self, t_us: u64) -> Option<usize> {
        if self.numbers.may_wrap() {
            return None;
        }
        let place = self.columns.places.first()?;
        let leaf = self.metadata.fields.get(*place)?.leaf;
        let mut found = 0;
        for (index, group) in self.metadata.groups.iter().enumerate() {
            if group.rows == 0 {
                continue;
            }
            let least = metadata::least(group.chunks.get(leaf)?, self.columns.stored[T]);
            if self.numbers.t_us(Some(least?))? >= t_us {
                break;
            }
            found = index;
        }
        Some(found)
    }
}

/// Returns the file's length and the footer's bytes.
fn footer(source: &mut dyn ReadSeek, name: &str) -> Result<(u64, Vec<u8>)> {
    let failed = |error: std::io::Error| error!(Damaged, "{name}: byte 0: cannot be read: {error}");
    let length = source.seek(SeekFrom::End(0)).map_err(failed)?;
    let truncated = || {
        let what = "the file does not end with PAR1 after its footer: truncated";
        error!(Damaged, "{name}: byte {length}: {what}")
    };
    let end = length.checked_sub(8).ok_or_else(truncated)?;
    source.seek(SeekFrom::Start(end)).map_err(failed)?;
    let mut tail = [0; 8];
    source.read_exact(&mut tail).map_err(failed)?;
    let [a, b, c, d, magic @ ..] = tail;
    ensure!(
        &magic != ENCRYPTED,
        Damaged,
        "{name}: byte {end}: the footer is encrypted: write the file again without encryption"
    );
    if &magic != MAGIC {
        return Err(truncated());
    }
    let bytes = u64::from(u32::from_le_bytes([a, b, c, d]));
    let start = end.checked_sub(bytes).filter(|start| *start >= 4);
    let Some(start) = start.filter(|_| bytes <= FOOTER_MAX) else {
        bail!(
            Damaged,
            "{name}: byte {end}: a footer of {bytes} bytes: damaged"
        );
    };
    source.seek(SeekFrom::Start(start)).map_err(failed)?;
    let mut footer = vec![0; bytes as usize];
    source.read_exact(&mut footer).map_err(failed)?;
    Ok((length, footer))
}

impl Decode for ParquetDecoder {
    fn format(&self) -> &'static str {
        "parquet"
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
        let Some(group) = self.group_before(t_us) else {
            return Ok(false);
        };
        self.go_to(group);
        Ok(true)
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        while batch.room() > 0 {
            let count = self.read_whole(batch.room(), batch)?;
            let (rows, ended) = self.read_rows(count.min(batch.room()));
            let appended = self.numbers.append(&rows, &mut self.events, batch);
            if let Err((which, what)) = appended {
                return Err(self.error(which, self.events, what));
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
