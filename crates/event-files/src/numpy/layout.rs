//! Finds the numbers of the events in numpy's arrays, and reads the arrays in step.

use std::io::Read;

use event_types::stream::{ErrorKind, Result};
use event_types::{Sensor, bail, ensure, error};

use crate::numpy::npy_header::{Descr, Dtype, NpyHeader, Number};
use crate::reading::{Columns, Reading};
use crate::table::event_numbers::{
    Named, Row, SAMPLE_ROWS, X, Y, column_order, find_names, given_names, names_taken, order_taken,
};
use crate::table::row_events::{Extent, Scale, Times};
use crate::table::stated_size;
use crate::table::stated_size::StatedSize;
use crate::zipped::entry::{Entries, Entry, EntryReader};
use crate::{Assumption, BATCH_EVENTS};

/// A number that every event has: the index of its stream, its offset in the stream's record, its type.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    pub stream: usize,
    offset: usize,
    dtype: Dtype,
}

/// A part of an array that is read from front to back.
#[derive(Clone)]
pub struct StreamPlan {
    pub entry: Entry,
    /// Number of bytes before the first record.
    skip: u64,
    record: usize,
}

/// The place and the meaning of the events' numbers.
pub struct Plan {
    /// The streams that are read in step.
    pub streams: Vec<StreamPlan>,
    /// The fields of t, x, y and p.
    pub fields: [Field; 4],
    /// Number of events.
    pub events: u64,
    /// Type and unit of the times.
    pub times: Times,
    /// Number of arrays used, without those of the size.
    pub used: usize,
    /// How t, x, y and p were found, if that may be wrong.
    pub assumption: Option<Assumption>,
    /// The size that names such as `x@320` state.
    pub named_sensor: Option<Sensor>,
}

/// A stream that is being read, with the records of one batch.
pub struct Stream {
    reader: EntryReader,
    record: usize,
    bytes: Vec<u8>,
}

impl Stream {
    /// Reads `count` records; returns how many were read whole and, if fewer, the error.
    fn fill(&mut self, count: usize) -> (usize, Option<std::io::Error>) {
        self.bytes.resize(count * self.record, 0);
        let mut filled = 0;
        while let Some(rest) = self.bytes.get_mut(filled..).filter(|rest| !rest.is_empty()) {
            match self.reader.read(rest) {
                Ok(0) => {
                    let error = std::io::Error::other("the array is shorter than its shape");
                    return (filled / self.record, Some(error));
                }
                Ok(n) => filled += n,
                Err(error) => return (filled / self.record, Some(error)),
            }
        }
        (count, None)
    }

    /// Returns the number of bytes that have not been read.
    pub const fn left(&self) -> u64 {
        self.reader.left()
    }

    /// Returns whether the array has been read to its end and its CRC-32 is wrong.
    pub fn is_damaged(&self) -> bool {
        self.reader.is_damaged()
    }

    /// Puts a field of the first `count` records into `numbers`, if its type is one of whole numbers.
    pub fn whole(&self, field: Field, count: usize, numbers: &mut Vec<i64>) -> bool {
        numbers.clear();
        if !field.dtype.is_whole() {
            return false;
        }
        let bytes = &self.bytes[..count * self.record];
        if self.record == field.dtype.bytes {
            field.dtype.whole_numbers(bytes, numbers);
        } else {
            let place = field.offset..field.offset + field.dtype.bytes;
            for record in bytes.chunks_exact(self.record) {
                field.dtype.whole_numbers(&record[place.clone()], numbers);
            }
        }
        true
    }

    /// Returns a field of record `index`.
    pub fn number(&self, index: usize, field: Field) -> Option<Number> {
        field
            .dtype
            .number(self.bytes.get(index * self.record + field.offset..)?)
    }
}

/// Arrays, each an entry of a zip file or a file of its own.
pub struct NpzFile {
    name: String,
    entries: Entries,
}

impl NpzFile {
    /// Wraps the arrays of a zip file or of single files, which messages call `name`.
    pub fn new(entries: Entries, name: &str) -> Self {
        let name = name.to_owned();
        Self { name, entries }
    }

    /// Returns the name for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the number of arrays of any kind.
    pub fn arrays(&self) -> usize {
        self.entries.iter().count()
    }

    /// Returns an error about an array.
    pub fn error(&self, entry: &Entry, what: impl std::fmt::Display) -> event_types::stream::Error {
        error!(
            Damaged,
            "{}: byte {}: {}: {what}", self.name, entry.start, entry.name
        )
    }

    fn header(&self, entry: &Entry) -> Result<NpyHeader> {
        let mut reader = self.entries.open(entry);
        NpyHeader::read(&mut reader).map_err(|what| self.error(entry, what))
    }

    fn find(&self, name: &str) -> Option<&Entry> {
        let mut entries = self.entries.iter();
        entries.find(|entry| stem(entry).eq_ignore_ascii_case(name))
    }

    /// Finds the arrays of the events; `place` is the array that the user named.
    pub fn plan(&self, reading: &Reading, place: Option<&str>) -> Result<Plan> {
        if let Some(place) = place {
            let entry = self
                .find(place)
                .or_else(|| self.find(place.strip_suffix(".npy")?));
            let entry = entry.ok_or_else(|| self.missing(&format!("no array {place}")))?;
            return self.plan_whole(entry, reading);
        }
        let given = given_names(reading);
        let names = self.entries.iter().map(stem);
        if let Some(named) = find_names(names, given) {
            return self.plan_columns(&named, reading);
        }
        let mut all = self.entries.iter();
        let only = all.next().filter(|_| all.next().is_none());
        let Some(entry) = self.find("events").or(only) else {
            let what = match given {
                Some(names) => format!("no arrays {}", names.join(", ")),
                None => "no arrays t, x, y, p and no array events".to_owned(),
            };
            return Err(self.missing(&what));
        };
        self.plan_whole(entry, reading)
    }

    fn missing(&self, what: &str) -> event_types::stream::Error {
        let arrays = self.entries.iter().map(|entry| entry.name.as_str());
        let arrays: Vec<&str> = arrays.take(24).collect();
        let (name, arrays) = (&self.name, arrays.join(", "));
        error!(
            Undecided,
            "{name}: byte 0: {what}, only {arrays}: name one, as in {name}/events, or see --columns"
        )
    }

    fn plan_whole(&self, entry: &Entry, reading: &Reading) -> Result<Plan> {
        let header = self.header(entry)?;
        match &header.descr {
            Descr::Fields(fields, size) => {
                self.plan_structured(entry, &header, (fields, *size), reading)
            }
            Descr::Plain(dtype) => self.plan_table(entry, &header, *dtype, reading),
        }
    }

    fn checked(&self, entry: &Entry, dtype: Dtype) -> Result<Dtype> {
        if dtype.is_object() {
            let what = "it holds pickled Python objects (a dictionary or a list), which only \
                        Python can read: load it there with allow_pickle=True and save its arrays: \
                        numpy.savez(FILE, t=..., x=..., y=..., p=...)";
            return Err(self.error(entry, what));
        }
        let ok = dtype.is_number();
        ok.then_some(dtype).ok_or_else(|| {
            let what = "the type must be bool, an integer or a float of up to 8 bytes, or a time \
                        with a unit from as to W";
            self.error(entry, what)
        })
    }

    fn plan_columns(&self, named: &Named, reading: &Reading) -> Result<Plan> {
        self.refuse_places(reading)?;
        let mut streams = Vec::new();
        let mut fields = Vec::new();
        let mut events = None;
        for (stream, place) in named.places.into_iter().enumerate() {
            let entry = self.entries.iter().nth(place);
            let entry = entry.ok_or_else(|| self.missing("no such array"))?;
            let header = self.header(entry)?;
            let (Descr::Plain(dtype), Some(count)) = (&header.descr, one_side(&header.shape))
            else {
                return Err(self.error(entry, "the array must be one column of numbers"));
            };
            let dtype = self.checked(entry, *dtype)?;
            let first = *events.get_or_insert(count);
            if first != count {
                let what = format!("{count} values, but {first} times");
                return Err(self.error(entry, what));
            }
            let (skip, record) = (header.bytes, dtype.bytes);
            streams.push(StreamPlan {
                entry: entry.clone(),
                skip,
                record,
            });
            fields.push(Field {
                stream,
                offset: 0,
                dtype,
            });
        }
        let plan = self.finish_plan(streams, &fields, events.unwrap_or(0), 4)?;
        Ok(plan.with(named))
    }

    /// Returns an error if `--columns` gives positions, which are only for tables without names.
    fn refuse_places(&self, reading: &Reading) -> Result<()> {
        let by_places = matches!(reading.columns, Some(Columns::Places { .. }));
        let name = &self.name;
        ensure!(
            !by_places,
            Undecided,
            "{name}: byte 0: the columns have names: give --columns t=NAME,x=NAME,y=NAME,p=NAME"
        );
        Ok(())
    }

    fn plan_structured(
        &self,
        entry: &Entry,
        header: &NpyHeader,
        (named, record): (&[(String, usize, Dtype)], usize),
        reading: &Reading,
    ) -> Result<Plan> {
        self.refuse_places(reading)?;
        let Some(events) = one_side(&header.shape) else {
            return Err(self.error(entry, "a structured array must have one dimension"));
        };
        let names = named.iter().map(|(name, ..)| name.as_str());
        let Some(found) = find_names(names.clone(), given_names(reading)) else {
            let names: Vec<&str> = names.take(24).collect();
            let what = format!(
                "the fields t, x, y, p are not all present, only {}: see --columns",
                names.join(", ")
            );
            return Err(self.error(entry, what).of_kind(ErrorKind::Undecided));
        };
        let mut fields = Vec::new();
        for place in found.places {
            let Some((_, offset, dtype)) = named.get(place) else {
                continue;
            };
            let dtype = self.checked(entry, *dtype)?;
            fields.push(Field {
                stream: 0,
                offset: *offset,
                dtype,
            });
        }
        let stream = StreamPlan {
            entry: entry.clone(),
            skip: header.bytes,
            record,
        };
        let plan = self.finish_plan(vec![stream], &fields, events, 1)?;
        Ok(plan.with(&found))
    }

    fn plan_table(
        &self,
        entry: &Entry,
        header: &NpyHeader,
        dtype: Dtype,
        reading: &Reading,
    ) -> Result<Plan> {
        let dtype = self.checked(entry, dtype)?;
        let wanted = match &reading.columns {
            Some(Columns::Places { columns, .. }) => *columns,
            Some(Columns::Names(_)) => {
                let what = "the columns have no names: give --columns txyp, in their order";
                return Err(self.error(entry, what).of_kind(ErrorKind::Undecided));
            }
            None => 4,
        };
        // Whether each column is a row of the array; this and the order in memory decide whether its numbers are
        // adjacent.
        let (events, is_turned) = match *header.shape.as_slice() {
            [events, columns] if columns == wanted as u64 => (events, false),
            [columns, events] if columns == wanted as u64 => (events, true),
            _ => {
                let shape: Vec<String> = header.shape.iter().map(u64::to_string).collect();
                let what = format!(
                    "the shape must be (N, {wanted}) or ({wanted}, N), one row or column for every event, but is \
                     ({}): see --columns",
                    shape.join(", ")
                );
                return Err(self.error(entry, what).of_kind(ErrorKind::Undecided));
            }
        };
        let are_together = header.fortran_order != is_turned;
        let column_bytes = events.checked_mul(dtype.bytes as u64);
        let mut streams = Vec::new();
        let mut fields = Vec::new();
        for column in 0..wanted {
            if are_together {
                let before = column_bytes.and_then(|bytes| bytes.checked_mul(column as u64));
                let skip = before.and_then(|bytes| bytes.checked_add(header.bytes));
                let skip = skip.ok_or_else(|| self.error(entry, "the shape is too large"))?;
                streams.push(StreamPlan {
                    entry: entry.clone(),
                    skip,
                    record: dtype.bytes,
                });
                fields.push(Field {
                    stream: column,
                    offset: 0,
                    dtype,
                });
            } else {
                let offset = column * dtype.bytes;
                fields.push(Field {
                    stream: 0,
                    offset,
                    dtype,
                });
            }
        }
        if !are_together {
            let record = wanted * dtype.bytes;
            streams.push(StreamPlan {
                entry: entry.clone(),
                skip: header.bytes,
                record,
            });
        }
        if let Some(Columns::Places { places, .. }) = &reading.columns {
            return self.finish_plan(streams, &in_order(&fields, *places), events, 1);
        }
        let plan = self.finish_plan(streams, &fields, events, 1)?;
        self.order_columns(plan, reading)
    }

    /// Finds out which columns of an (N, 4) array are t, x, y and p.
    fn order_columns(&self, plan: Plan, reading: &Reading) -> Result<Plan> {
        let (rows, _) = self.first_rows(&plan, SAMPLE_ROWS)?;
        let Some(first) = plan.streams.first() else {
            return Ok(plan);
        };
        let size = self.stated_size()?.or(reading.size);
        let columns = column_order(&rows, size).ok_or_else(|| {
            let what =
                "the order of the four columns is unclear: give --columns txyp, in their order";
            self.error(&first.entry, what).of_kind(ErrorKind::Undecided)
        })?;
        let fields = in_order(&plan.fields, columns);
        let mut plan = self.finish_plan(plan.streams, &fields, plan.events, plan.used)?;
        plan.assumption = (!rows.is_empty()).then(|| order_taken(columns));
        Ok(plan)
    }

    /// Returns the first rows, at most `most` and at most those before the first damage, and whether the file has
    /// more than `most`.
    pub fn first_rows(&self, plan: &Plan, most: usize) -> Result<(Vec<Row>, bool)> {
        let mut streams = self.streams(plan)?;
        let wanted = count(plan.events, most);
        let whole = fill(&mut streams, wanted).0;
        let number = |row: usize, field: Field| streams.get(field.stream)?.number(row, field);
        let rows = (0..whole).map(|row| plan.fields.map(|field| number(row, field)));
        Ok((rows.collect(), plan.events > wanted as u64))
    }

    fn finish_plan(
        &self,
        streams: Vec<StreamPlan>,
        fields: &[Field],
        events: u64,
        used: usize,
    ) -> Result<Plan> {
        let Some(fields) = fields.first_chunk::<4>().copied() else {
            bail!(Damaged, "{}: byte 0: no arrays of events", self.name);
        };
        let [t, ..] = fields;
        Ok(Plan {
            streams,
            fields,
            events,
            times: Times::of(Some(t.dtype)),
            used,
            assumption: None,
            named_sensor: None,
        })
    }

    /// Opens every stream at its first record.
    pub fn streams(&self, plan: &Plan) -> Result<Vec<Stream>> {
        let open = |stream: &StreamPlan| {
            let mut reader = self.entries.open(&stream.entry);
            let skipped = std::io::copy(&mut (&mut reader).take(stream.skip), &mut std::io::sink());
            match skipped {
                Ok(n) if n == stream.skip => Ok(Stream {
                    reader,
                    record: stream.record,
                    bytes: Vec::new(),
                }),
                Ok(_) => Err(self.error(&stream.entry, "the array is shorter than its shape")),
                Err(error) => Err(self.error(&stream.entry, error)),
            }
        };
        plan.streams.iter().map(open).collect()
    }

    /// Returns the size that arrays of up to three numbers state beside the events.
    pub fn stated_size(&self) -> Result<Option<Sensor>> {
        let mut size = StatedSize::default();
        let mut sides = 0;
        let mut last = None;
        for entry in self.size_entries() {
            if let Some(numbers) = self.few(entry)? {
                size.numbers(stem(entry), &numbers);
            }
            sides += usize::from(stem(entry).to_ascii_lowercase().ends_with("width"));
            sides += usize::from(stem(entry).to_ascii_lowercase().ends_with("height"));
            last = Some(entry);
        }
        match (size.sensor(), last) {
            (None, Some(entry)) if sides >= 2 => {
                let most = Sensor::SIDE_MAX;
                let what = format!("the sensor's side must be one whole number from 1 to {most}");
                Err(self.error(entry, what))
            }
            (sensor, _) => Ok(sensor),
        }
    }

    /// Returns the arrays whose names are those of a size.
    fn size_entries(&self) -> impl Iterator<Item = &Entry> {
        let entries = self.entries.iter();
        entries.filter(|entry| stated_size::is_known(stem(entry)))
    }

    /// Returns the number of arrays that state the size.
    pub fn sizes(&self) -> usize {
        self.size_entries().count()
    }

    /// Returns the numbers of an array that has at most three.
    fn few(&self, entry: &Entry) -> Result<Option<Vec<f64>>> {
        let header = self.header(entry)?;
        let count = header
            .shape
            .iter()
            .try_fold(1_u64, |all, side| all.checked_mul(*side));
        let (Descr::Plain(dtype), Some(count @ 1..=3)) = (header.descr, count) else {
            return Ok(None);
        };
        if !dtype.is_number() {
            return Ok(None);
        }
        let mut reader = self.entries.open(entry);
        let mut bytes = vec![0; count as usize * dtype.bytes];
        let skipped = std::io::copy(&mut (&mut reader).take(header.bytes), &mut std::io::sink());
        let read = skipped.and_then(|_| reader.read_exact(&mut bytes));
        read.map_err(|error| self.error(entry, error))?;
        let mut numbers = Vec::new();
        dtype.numbers(&bytes, &mut numbers);
        Ok(Some(
            numbers.into_iter().flatten().map(Number::float).collect(),
        ))
    }

    /// Returns the smallest sensor that holds every event before the first damage.
    pub fn largest(&self, plan: &Plan, reading: &Reading) -> Result<Sensor> {
        let mut streams = self.streams(plan)?;
        let mut extent = Extent::new(reading);
        let mut left = plan.events;
        while left > 0 {
            // The reader reports damage, after it has returned the events before it.
            let (rows, error) = fill(&mut streams, count(left, BATCH_EVENTS));
            for row in 0..rows {
                let [x, y] = [X, Y].map(|which| {
                    let field = plan.fields[which];
                    streams.get(field.stream)?.number(row, field)
                });
                if !extent.add(x, y) {
                    return extent.sensor(&self.name);
                }
            }
            left = left.saturating_sub(rows as u64);
            if error.is_some() {
                break;
            }
        }
        extent.sensor(&self.name)
    }
}

impl Plan {
    /// Adds what the names of t, x, y and p state.
    fn with(mut self, named: &Named) -> Self {
        self.times.scale = self.times.scale.or(named.unit.map(Scale::from));
        self.named_sensor = named.sensor;
        self.assumption = names_taken(named);
        self
    }
}

/// Returns an array's name without its ending.
fn stem(entry: &Entry) -> &str {
    entry.name.strip_suffix(".npy").unwrap_or(&entry.name)
}

/// Returns the length of an array whose other sides are 1.
fn one_side(shape: &[u64]) -> Option<u64> {
    let mut others = shape.iter().filter(|side| **side != 1);
    let only = match others.next() {
        None if shape.is_empty() => return None,
        None => 1,
        Some(side) => *side,
    };
    others.next().is_none().then_some(only)
}

/// Returns the fields at these positions.
fn in_order(fields: &[Field], places: [usize; 4]) -> Vec<Field> {
    let fields = places.iter().filter_map(|place| fields.get(*place));
    fields.copied().collect()
}

/// Returns `left`, at most `limit`.
pub fn count(left: u64, limit: usize) -> usize {
    usize::try_from(left).unwrap_or(limit).min(limit)
}

/// Fills every stream with `count` records. Returns how many records all of them have, and, if it is fewer, the
/// stream that broke off and its error.
pub fn fill(streams: &mut [Stream], count: usize) -> (usize, Option<(usize, std::io::Error)>) {
    let (mut whole, mut ended) = (count, None);
    for (index, stream) in streams.iter_mut().enumerate() {
        let (records, error) = stream.fill(count);
        whole = whole.min(records);
        ended = ended.or(error.map(|error| (index, error)));
    }
    (whole, ended)
}
