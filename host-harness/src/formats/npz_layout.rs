//! Where the numbers of the events are in an npz file, and how they are read in step.

use std::io::Read;

use eecvs_nostd::Sensor;

use super::BATCH_EVENTS;
use super::event_numbers::{NAMES, SAMPLE_ROWS, SAMPLE_TIMES, X, Y, column_order, coordinate};
use super::input::ReadSeek;
use super::npy_header::{Descr, Dtype, NpyHeader, Number};
use super::time_unit::TimeSample;
use super::zip_entry::{Entries, Entry, EntryReader};

/// A number of every event: its stream, its offset in the stream's record, its type.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    pub stream: usize,
    offset: usize,
    dtype: Dtype,
}

/// A part of an array that is read from front to back.
#[derive(Debug, Clone)]
pub struct StreamPlan {
    pub entry: Entry,
    /// Bytes before the first record.
    skip: u64,
    record: usize,
}

/// Where the numbers of the events are.
pub struct Plan {
    /// What is read in step.
    pub streams: Vec<StreamPlan>,
    /// t, x, y, p.
    pub fields: [Field; 4],
    /// Number of events.
    pub events: u64,
    /// Whether float times are seconds.
    pub seconds: bool,
    /// Arrays used, the scalars included.
    pub used: usize,
}

/// A stream being read, and the records of a batch.
pub struct Stream {
    reader: EntryReader,
    record: usize,
    bytes: Vec<u8>,
}

impl Stream {
    /// Reads `count` records; returns how many were whole, and the error that ended them.
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

    /// Whether the array has been read to its end and its CRC-32 is wrong.
    pub fn is_damaged(&self) -> bool {
        self.reader.is_damaged()
    }

    /// A number of record `index`.
    pub fn number(&self, index: usize, field: Field) -> Option<Number> {
        field
            .dtype
            .number(self.bytes.get(index * self.record + field.offset..)?)
    }
}

/// A zip file of arrays.
pub struct NpzFile {
    name: String,
    entries: Entries,
}

impl NpzFile {
    /// Opens a zip file, which messages call `name`.
    pub fn open(source: Box<dyn ReadSeek>, name: &str) -> anyhow::Result<Self> {
        let entries = Entries::read(source)
            .map_err(|error| anyhow::anyhow!("{name}: byte 0: damaged npz file: {error}"))?;
        let name = name.to_owned();
        Ok(Self { name, entries })
    }

    /// Name for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of arrays of any kind.
    pub fn arrays(&self) -> usize {
        self.entries.iter().count()
    }

    /// Error about an array.
    pub fn error(&self, entry: &Entry, what: impl std::fmt::Display) -> anyhow::Error {
        anyhow::anyhow!(
            "{}: byte {}: {}: {what}",
            self.name,
            entry.start,
            entry.name
        )
    }

    fn header(&self, entry: &Entry) -> anyhow::Result<NpyHeader> {
        let mut reader = self.entries.open(entry);
        NpyHeader::read(&mut reader).map_err(|what| self.error(entry, what))
    }

    fn find(&self, names: &[&str]) -> Option<&Entry> {
        self.entries.iter().find(|entry| {
            let name = entry.name.strip_suffix(".npy").unwrap_or(&entry.name);
            names.iter().any(|known| name.eq_ignore_ascii_case(known))
        })
    }

    /// Finds the arrays of the events.
    pub fn plan(&self) -> anyhow::Result<Plan> {
        let found = NAMES.map(|names| self.find(names));
        if let [Some(t), Some(x), Some(y), Some(p)] = found {
            return self.plan_columns([t, x, y, p]);
        }
        let mut all = self.entries.iter();
        let only = all.next().filter(|_| all.next().is_none());
        let Some(entry) = self.find(&["events"]).or(only) else {
            let arrays: Vec<_> = self
                .entries
                .iter()
                .map(|entry| entry.name.as_str())
                .collect();
            anyhow::bail!(
                "{}: byte 0: no arrays t, x, y, p and no array events, but {}",
                self.name,
                arrays.join(", ")
            );
        };
        let header = self.header(entry)?;
        match &header.descr {
            Descr::Fields(fields, size) => self.plan_structured(entry, &header, fields, *size),
            Descr::Plain(dtype) => self.plan_table(entry, &header, *dtype),
        }
    }

    fn checked(&self, entry: &Entry, dtype: Dtype) -> anyhow::Result<Dtype> {
        let ok = dtype.is_number();
        ok.then_some(dtype).ok_or_else(|| {
            self.error(
                entry,
                "the type must be bool, an integer of up to 8 or a float of up to 8 bytes",
            )
        })
    }

    fn plan_columns(&self, entries: [&Entry; 4]) -> anyhow::Result<Plan> {
        let mut streams = Vec::new();
        let mut fields = Vec::new();
        let mut events = None;
        for (stream, entry) in entries.into_iter().enumerate() {
            let header = self.header(entry)?;
            let (Descr::Plain(dtype), [count]) = (&header.descr, header.shape.as_slice()) else {
                return Err(self.error(entry, "the array must be one column of numbers"));
            };
            let dtype = self.checked(entry, *dtype)?;
            let first = *events.get_or_insert(*count);
            if first != *count {
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
        self.finish_plan(streams, &fields, events.unwrap_or(0), 4)
    }

    fn plan_structured(
        &self,
        entry: &Entry,
        header: &NpyHeader,
        named: &[(String, usize, Dtype)],
        record: usize,
    ) -> anyhow::Result<Plan> {
        let [events] = header.shape.as_slice() else {
            return Err(self.error(entry, "a structured array must have one dimension"));
        };
        let mut fields = Vec::new();
        for names in NAMES {
            let field = named
                .iter()
                .find(|(name, ..)| names.iter().any(|known| name.eq_ignore_ascii_case(known)));
            let Some((_, offset, dtype)) = field else {
                return Err(self.error(entry, "the fields t, x, y, p are not all there"));
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
        self.finish_plan(vec![stream], &fields, *events, 1)
    }

    fn plan_table(&self, entry: &Entry, header: &NpyHeader, dtype: Dtype) -> anyhow::Result<Plan> {
        let dtype = self.checked(entry, dtype)?;
        let [events, 4] = *header.shape.as_slice() else {
            return Err(self.error(entry, "the shape must be (N, 4), one row for every event"));
        };
        let column_bytes = events.checked_mul(dtype.bytes as u64);
        let mut streams = Vec::new();
        let mut fields = Vec::new();
        for column in 0..4 {
            if header.fortran_order {
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
        if !header.fortran_order {
            let record = 4 * dtype.bytes;
            streams.push(StreamPlan {
                entry: entry.clone(),
                skip: header.bytes,
                record,
            });
        }
        let plan = self.finish_plan(streams, &fields, events, 1)?;
        self.order_columns(plan)
    }

    /// Finds out which column of an (N, 4) array is what.
    fn order_columns(&self, plan: Plan) -> anyhow::Result<Plan> {
        let mut streams = self.streams(&plan)?;
        let rows = fill(&mut streams, count(plan.events, SAMPLE_ROWS)).0;
        let number = |row: usize, field: Field| streams.get(field.stream)?.number(row, field);
        let sample: Vec<_> = (0..rows)
            .map(|row| plan.fields.map(|field| number(row, field)))
            .collect();
        let Some(first) = plan.streams.first() else {
            return Ok(plan);
        };
        let columns = column_order(&sample, self.stated_size()?).ok_or_else(|| {
            let what = "the order of the four columns is unclear: save t, x, y, p";
            self.error(&first.entry, what)
        })?;
        let fields: Vec<Field> = columns
            .iter()
            .filter_map(|column| plan.fields.get(*column).copied())
            .collect();
        self.finish_plan(plan.streams, &fields, plan.events, plan.used)
    }

    fn finish_plan(
        &self,
        streams: Vec<StreamPlan>,
        fields: &[Field],
        events: u64,
        used: usize,
    ) -> anyhow::Result<Plan> {
        let Some(fields) = fields.first_chunk::<4>().copied() else {
            anyhow::bail!("{}: byte 0: no arrays of events", self.name);
        };
        let scalars = ["width", "height"]
            .iter()
            .filter(|name| self.find(&[name]).is_some());
        let used = if streams.is_empty() {
            used
        } else {
            used + scalars.count()
        };
        Ok(Plan {
            streams,
            fields,
            events,
            seconds: false,
            used,
        })
    }

    /// Opens every stream at its first record.
    pub fn streams(&self, plan: &Plan) -> anyhow::Result<Vec<Stream>> {
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

    /// Whether the times are floats of seconds.
    pub fn times_in_seconds(&self, plan: &Plan) -> anyhow::Result<bool> {
        let [t, ..] = plan.fields;
        if !t.dtype.is_float() {
            return Ok(false);
        }
        let mut streams = self.streams(plan)?;
        let rows = fill(&mut streams, count(plan.events, SAMPLE_TIMES)).0;
        let mut sample = TimeSample::default();
        let stream = streams.get(t.stream);
        for time in (0..rows).filter_map(|row| stream?.number(row, t)) {
            sample.add(time.float().fract() == 0.0, time.float());
        }
        Ok(sample.seconds())
    }

    /// The scalars `width` and `height`.
    pub fn stated_size(&self) -> anyhow::Result<Option<Sensor>> {
        let (Some(width), Some(height)) = (self.find(&["width"]), self.find(&["height"])) else {
            return Ok(None);
        };
        let side = |entry: &Entry| {
            let header = self.header(entry)?;
            let mut reader = self.entries.open(entry);
            let mut value = [0; 8];
            let scalar = header.shape.iter().all(|side| *side == 1);
            let number = match header.descr {
                Descr::Plain(dtype) if scalar && dtype.is_number() => {
                    let slots = value.get_mut(..dtype.bytes).unwrap_or_default();
                    let skip = &mut (&mut reader).take(header.bytes);
                    let skipped = std::io::copy(skip, &mut std::io::sink());
                    let read = skipped.and_then(|_| reader.read_exact(slots));
                    read.map_err(|error| self.error(entry, error))?;
                    dtype.number(&value).and_then(Number::whole)
                }
                _ => None,
            };
            let side = number.and_then(|side| u16::try_from(side).ok());
            side.ok_or_else(|| self.error(entry, "the sensor's side must be one whole number"))
        };
        let (width_px, height_px) = (side(width)?, side(height)?);
        let sensor = Sensor::new(width_px, height_px);
        let wrong = || {
            self.error(
                width,
                format!("sensor size {width_px}x{height_px} is out of range"),
            )
        };
        sensor.map(Some).ok_or_else(wrong)
    }

    /// Size that holds every event.
    pub fn largest(&self, plan: &Plan) -> anyhow::Result<Sensor> {
        let mut streams = self.streams(plan)?;
        let (mut width, mut height, mut left) = (0, 0, plan.events);
        while left > 0 {
            // Damage is for the reader, which returns the events before it.
            let (rows, error) = fill(&mut streams, count(left, BATCH_EVENTS));
            for row in 0..rows {
                let side = |field: Field| coordinate(streams.get(field.stream)?.number(row, field));
                let (Some(x), Some(y)) = (side(plan.fields[X]), side(plan.fields[Y])) else {
                    left = 0;
                    break;
                };
                width = width.max(x + 1);
                height = height.max(y + 1);
            }
            left = left.saturating_sub(rows as u64);
            if error.is_some() {
                break;
            }
        }
        Sensor::new(width, height).ok_or_else(|| {
            anyhow::anyhow!(
                "{}: byte 0: no event, so no sensor size: give --width W --height H",
                self.name
            )
        })
    }
}

/// `left`, at most `limit`.
pub fn count(left: u64, limit: usize) -> usize {
    usize::try_from(left).unwrap_or(limit).min(limit)
}

/// Fills every stream with `count` records; returns how many all of them have, and what ended it:
/// the stream and its error.
pub fn fill(streams: &mut [Stream], count: usize) -> (usize, Option<(usize, std::io::Error)>) {
    let (mut whole, mut ended) = (count, None);
    for (index, stream) in streams.iter_mut().enumerate() {
        let (records, error) = stream.fill(count);
        whole = whole.min(records);
        ended = ended.or(error.map(|error| (index, error)));
    }
    (whole, ended)
}
