//! Reads events straight from the bytes of Prophesee's compounds, without converting each number by its type: x and
//! y (u16), p (i16), two unused bytes, t (i64, us), all little-endian.

use event_types::{Event, Polarity, Sensor};
use hdf5_reader::{ByteOrder, Dataset, Datatype, H5Type, error::Error};

use super::chunks::Chunks;
use super::ecf::{Columns, RECORD_BYTES};
use super::file::{Hdf5, read_rows};
use super::filters;
use crate::input::Batch;

/// A compound as stored in the file.
#[derive(Clone)]
struct Record([u8; RECORD_BYTES]);

impl Record {
    const fn x(&self) -> u16 {
        u16::from_le_bytes([self.0[0], self.0[1]])
    }

    const fn y(&self) -> u16 {
        u16::from_le_bytes([self.0[2], self.0[3]])
    }

    const fn p(&self) -> i16 {
        i16::from_le_bytes([self.0[4], self.0[5]])
    }

    fn t(&self) -> i64 {
        let [_, t] = zerocopy::transmute!(self.0);
        i64::from_le_bytes(t)
    }

    fn is_event(&self, sensor: Sensor) -> bool {
        let is_polarity = (-1..=1).contains(&self.p());
        sensor.contains(self.x(), self.y()) & is_polarity & (self.t() >= 0)
    }

    fn event(&self) -> Event {
        Event {
            t_us: self.t().cast_unsigned(),
            x: self.x(),
            y: self.y(),
            polarity: Polarity::from_bool(self.p() == 1),
        }
    }
}

impl H5Type for Record {
    fn hdf5_type() -> Datatype {
        Datatype::Compound {
            size: RECORD_BYTES as u32,
            fields: Vec::new(),
        }
    }

    fn from_bytes(bytes: &[u8], _: &Datatype) -> Result<Self, Error> {
        let record = bytes.first_chunk().copied().map(Self);
        record.ok_or_else(|| Error::InvalidData("the compound is too short".to_owned()))
    }

    fn element_size(_: &Datatype) -> usize {
        RECORD_BYTES
    }

    fn native_copy_compatible(datatype: &Datatype) -> bool {
        is_known(datatype)
    }
}

/// Returns whether compounds of this type are Prophesee's.
pub fn is_known(datatype: &Datatype) -> bool {
    let Datatype::Compound { size, fields } = datatype else {
        return false;
    };
    let places = [
        ("x", 0, 2, false),
        ("y", 2, 2, false),
        ("p", 4, 2, true),
        ("t", 8, 8, true),
    ];
    let is_all = |(name, at, bytes, is_signed)| {
        fields.iter().any(|field| {
            let is_number = matches!(
                field.datatype,
                Datatype::FixedPoint { size, signed, byte_order: ByteOrder::LittleEndian }
                    if u64::from(size) == bytes && signed == is_signed
            );
            field.name == name && u64::from(field.byte_offset) == at && is_number
        })
    };
    u64::from(*size) == RECORD_BYTES as u64 && places.into_iter().all(is_all)
}

/// Compounds packed by ECF, with the columns of the current chunk. The columns are used directly, whereas the
/// library would unpack every chunk to records in newly allocated memory.
pub struct Packed {
    chunks: Chunks,
    bytes: Vec<u8>,
    columns: Columns,
    /// The first row of the chunk read last, and its number of events, or `None` if it is damaged.
    held: Option<(u64, Option<usize>)>,
}

impl Packed {
    /// Returns the compounds of a dataset, if ECF packs them.
    pub fn find(file: &Hdf5, dataset: &Dataset) -> Option<Self> {
        Some(Self {
            chunks: file.chunks(dataset, filters::ECF)?,
            bytes: Vec::new(),
            columns: Columns::default(),
            held: None,
        })
    }

    /// Reads the chunk that begins at row `first`, unless it is the current one, and returns its number of events.
    fn hold(&mut self, first: u64) -> Option<usize> {
        if let Some((held, events)) = self.held
            && held == first
        {
            return events;
        }
        let read = self.chunks.read(first, &mut self.bytes);
        let events = read.and_then(|()| self.columns.read(&self.bytes).ok());
        self.held = Some((first, events));
        events
    }

    /// Appends the `count` events from row `start` on, all in the chunk that begins at row `first`, to `batch`.
    /// Returns `false` and appends none if one of them is missing or outside the sensor.
    pub fn read(
        &mut self,
        (first, start, count): (u64, u64, usize),
        sensor: Sensor,
        batch: &mut Batch<'_>,
    ) -> bool {
        let Some(events) = self.hold(first) else {
            return false;
        };
        let begin = usize::try_from(start - first).unwrap_or(usize::MAX);
        let places = begin..begin.saturating_add(count);
        if places.end > events || !self.columns.are_events(places.clone(), sensor) {
            return false;
        }
        batch.extend(self.columns.events(places));
        true
    }
}

/// Appends the events of `count` compounds from `start` on to `batch`. Returns `false` and appends none if one of
/// them is not an event on the sensor; reading them number by number then shows the cause.
pub fn read(
    dataset: &Dataset,
    start: u64,
    count: u64,
    sensor: Sensor,
    batch: &mut Batch<'_>,
) -> bool {
    let Ok(records) = read_rows::<Record>(dataset, start, count) else {
        return false;
    };
    let is_right = records
        .iter()
        .fold(true, |all, record| all & record.is_event(sensor));
    if is_right {
        batch.extend(records.iter().map(Record::event));
    }
    is_right
}
