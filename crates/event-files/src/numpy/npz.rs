//! Reads events from numpy's arrays: in a zip file (`.npz`, stored or deflated), in one file (`.npy`), or in a
//! folder of `.npy` files.
//!
//! * Either there are arrays t, x, y and p (or with other usual names, such as ts, `timestamps_ns`, pol, on), each
//!   of one dimension or (N, 1), (1, N),
//! * or there is one array `events` (or only one array, or one whose name the user appends to the file's, as in
//!   `FILE.npz/left`): structured with fields of these names, or of shape (N, 4) or (4, N), with columns that are
//!   told apart like those of a text file without a header.
//! * `--columns` names arrays or fields, or gives the order of a table's columns; the table may then have any width.
//! * Scalars `width` and `height`, or a pair such as `resolution`, give the sensor's size; without them and without
//!   a size from the caller, a first pass finds the largest x and y, plus one.
//! * Types: integers and floats of up to 8 bytes, in either byte order; bool for p; timedelta64 and datetime64 for
//!   t. Arrays of Python objects (pickled dictionaries) are refused with an explanation.
//! * t: in the unit of its time type, or in the unit at the end of its name, otherwise by the rule in
//!   `crate::table::time_unit`. `crate::table::row_events` describes clocks that wrap, polarities and invalid
//!   events.
//!
//! A zip file without arrays may hold one recording of another format: see `crate::zipped::recording`.
//!
//! The arrays are read in step, one batch of each at a time. A wrong CRC-32 is reported after the last event. A
//! truncated file has lost its directory and cannot be read at all.

use std::path::Path;

use event_types::stream::{Context, ErrorKind, Result};
use event_types::{Sensor, ensure, error};

use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, ReadSeek, Reader};
use crate::numpy::layout::{Field, NpzFile, Plan, Stream, count, fill};
use crate::numpy::npy_header;
use crate::numpy::npy_writer::NpyWriter;
use crate::numpy::npz_writer::NpzWriter;
use crate::reading::Reading;
use crate::table::event_numbers::Row;
use crate::table::row_events::{Base, RowEvents};
use crate::table::time_unit::SAMPLE_TIMES;
use crate::zipped::entry::Entries;
use crate::zipped::recording as zip_recording;
use crate::{Assumption, EventReader, Skipped};

/// First bytes of a zip file with at least one entry.
pub const MAGIC: &[u8; 4] = b"PK\x03\x04";

/// Largest number of files of a folder that are opened.
const FILES_MAX: usize = 256;

/// The entry of `.npz` in the table of formats.
pub const FORMAT: Format = Format {
    name: "npz",
    title: "npz",
    endings: &[".npz"],
    detect: |start| start.begins(MAGIC),
    open: open_zip,
    has_places: true,
    is_table: true,
    grows: false,
    streams: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(NpzWriter::create(path, sensor)?))),
};

/// The entry of `.npy` in the table of formats.
pub const NPY_FORMAT: Format = Format {
    name: "npy",
    title: "npy",
    endings: &[".npy"],
    detect: |start| start.begins(npy_header::MAGIC),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| {
        let entries = Entries::files(vec![("events.npy".to_owned(), source)]);
        let entries = entries.with_context(|| format!("{name}: byte 0: cannot be read"))?;
        let file = NpzFile::new(entries, name);
        Ok(Box::new(NpzReader::new(file, "npy", None, &reading)?))
    },
    has_places: false,
    is_table: true,
    grows: false,
    streams: false,
    limits: Limits::NONE,
    create: Some(|path, sensor| Ok(Box::new(NpyWriter::create(path, sensor)?))),
};

/// Opens a zip file of arrays, or of one recording.
fn open_zip(opening: Opening) -> Result<Box<dyn EventReader>> {
    let Opening {
        source,
        name,
        place,
        reading,
        ..
    } = opening;
    let entries = Entries::read(source)
        .map_err(|error| error!(Damaged, "{name}: byte 0: damaged zip or npz file: {error}"))?;
    if zip_recording::holds_one(&entries, place) {
        return zip_recording::open(&entries, name, place, &reading);
    }
    let file = NpzFile::new(entries, name);
    Ok(Box::new(NpzReader::new(file, "npz", place, &reading)?))
}

/// Opens a zip file of arrays from a file or memory; messages call it `name`.
///
/// # Errors
/// Those of [`crate::open`].
pub fn open_arrays(
    source: Box<dyn ReadSeek>,
    name: &str,
    reading: &Reading,
) -> Result<Box<dyn EventReader>> {
    let entries = Entries::read(source)
        .map_err(|error| error!(Damaged, "{name}: byte 0: damaged npz file: {error}"))?;
    let file = NpzFile::new(entries, name);
    Ok(Box::new(NpzReader::new(file, "npz", None, reading)?))
}

/// Returns whether a folder holds arrays, such as `t.npy`.
pub fn is_folder(path: &Path) -> bool {
    let mut files = std::fs::read_dir(path).into_iter().flatten().flatten();
    files.any(|file| Path::new(&file.file_name()).extension() == Some("npy".as_ref()))
}

/// Opens a folder of arrays.
///
/// # Errors
/// The folder cannot be read or holds more than 256 arrays; otherwise those of [`crate::open`].
pub fn open_folder(path: &Path, reading: &Reading) -> Result<Box<dyn EventReader>> {
    let name = path.display().to_string();
    let failed = || format!("{name}: cannot be read");
    let mut files: Vec<(String, Box<dyn ReadSeek>)> = Vec::new();
    let mut paths = Vec::new();
    for file in std::fs::read_dir(path).with_context(failed)? {
        paths.push(file.with_context(failed)?.path());
    }
    paths.retain(|path| path.extension() == Some("npy".as_ref()));
    paths.sort();
    ensure!(
        paths.len() <= FILES_MAX,
        Damaged,
        "{name}: more than {FILES_MAX} npy files: name one of them"
    );
    for path in paths {
        let file = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let source = std::fs::File::open(&path).with_context(failed)?;
        files.push((file, Box::new(source)));
    }
    let file = NpzFile::new(Entries::files(files).with_context(failed)?, &name);
    Ok(Box::new(NpzReader::new(file, "npy", None, reading)?))
}

/// A reader of numpy's arrays.
pub type NpzReader = Reader<NpzDecoder>;

impl NpzReader {
    /// Reads `file` as the format of this name; `place` is the array that the user named.
    fn new(
        file: NpzFile,
        format: &'static str,
        place: Option<&str>,
        reading: &Reading,
    ) -> Result<Self> {
        let plan = file.plan(reading, place)?;
        let (sample, _) = file.first_rows(&plan, SAMPLE_TIMES)?;
        let rows = RowEvents::new(reading, plan.times, Base::default(), &sample);
        let mut rows = rows.map_err(|what| match plan.streams.first() {
            Some(stream) => file
                .error(&stream.entry, what)
                .of_kind(ErrorKind::Undecided),
            None => error!(Undecided, "{}: {what}", file.name()),
        })?;
        rows.assumptions.extend(plan.assumption.clone());
        rows.sensor = match file.stated_size()?.or(reading.size).or(plan.named_sensor) {
            Some(sensor) => sensor,
            None => {
                let sensor = file.largest(&plan, reading)?;
                rows.assumptions.push(Assumption::size_taken(sensor));
                sensor
            }
        };
        let used = plan.used + file.sizes();
        let others = file.arrays().saturating_sub(used);
        rows.skipped.add("other arrays", others as u64);
        let streams = file.streams(&plan)?;
        Ok(Self::around(NpzDecoder {
            format,
            file,
            plan,
            streams,
            rows,
            whole: Default::default(),
            events: 0,
        }))
    }
}

/// The decoder of [`NpzReader`]: its state between two batches.
pub struct NpzDecoder {
    format: &'static str,
    file: NpzFile,
    plan: Plan,
    streams: Vec<Stream>,
    rows: RowEvents,
    /// Whole numbers of t, x, y and p, kept for their memory.
    whole: [Vec<i64>; 4],
    events: u64,
}

impl NpzDecoder {
    /// Appends the events of the first `count` records of every stream.
    fn append(&mut self, count: usize, batch: &mut Batch<'_>) -> Result<(), (usize, String)> {
        let (streams, fields) = (&self.streams, &self.plan.fields);
        let mut columns = self.whole.iter_mut().zip(fields);
        if columns.all(|(numbers, field)| streams[field.stream].whole(*field, count, numbers)) {
            let columns = self.whole.each_ref().map(Vec::as_slice);
            return self.rows.append_columns(columns, &mut self.events, batch);
        }
        let rows: Vec<Row> = (0..count).map(|row| self.row(row)).collect();
        self.rows.append(&rows, &mut self.events, batch)
    }

    fn row(&self, row: usize) -> Row {
        let number = |field: Field| self.streams.get(field.stream)?.number(row, field);
        self.plan.fields.map(number)
    }

    /// Returns an error if other arrays follow in the same file, as written by `numpy.save` to an open file. If
    /// several streams read one array, its end is not known here.
    fn check_end(&self) -> Result<()> {
        for (index, (stream, of)) in self.streams.iter().zip(&self.plan.streams).enumerate() {
            let others = self.plan.streams.iter();
            let readers = others.filter(|other| other.entry.name == of.entry.name);
            if stream.left() > 0 && readers.count() == 1 {
                let what = format!(
                    "{} bytes follow the array in its file: save each array to its own file, or \
                     all as one .npz",
                    stream.left()
                );
                return Err(self.error(index, what));
            }
        }
        Ok(())
    }

    fn error(&self, stream: usize, what: impl std::fmt::Display) -> event_types::stream::Error {
        let what = format!("event {}: {what}", self.events);
        match self.plan.streams.get(stream) {
            Some(stream) => self.file.error(&stream.entry, what),
            None => error!(Damaged, "{}: {what}", self.file.name()),
        }
    }
}

impl Decode for NpzDecoder {
    fn format(&self) -> &'static str {
        self.format
    }

    fn sensor(&self) -> Sensor {
        self.rows.sensor
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.rows.assumptions
    }

    fn skipped(&self) -> &Skipped {
        &self.rows.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        loop {
            let count = count(self.plan.events - self.events, batch.room());
            let (whole, ended) = fill(&mut self.streams, count);
            let appended = self.append(whole, batch);
            appended.map_err(|(which, what)| self.error(self.plan.fields[which].stream, what))?;
            match ended {
                // The CRC-32 does not show where the damage is, so it is checked after all events have been
                // returned.
                None if count == 0 => {
                    return match self.streams.iter().position(Stream::is_damaged) {
                        None => self.check_end(),
                        Some(stream) => {
                            Err(self.error(stream, "the array's CRC-32 is wrong: damaged data"))
                        }
                    };
                }
                // All rows of a batch may have been left out.
                None if batch.is_empty() => {}
                None => return Ok(()),
                Some((stream, error)) => return Err(self.error(stream, error)),
            }
        }
    }
}
