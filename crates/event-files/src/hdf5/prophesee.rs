//! Events in Prophesee's compounds: x and y (u16), p (i16), two bytes that mean nothing, t (i64, us), all
//! little-endian, which are taken as they stand, without a number of any type between.

use event_types::{Event, Polarity, Sensor};
use hdf5_reader::{ByteOrder, Dataset, Datatype, H5Type, error::Error};

use super::chunks::Chunks;
use super::ecf::{Columns, RECORD_BYTES};
use super::file::{Hdf5, read_rows};
use super::filters;
use crate::input::Batch;
use crate::numpy::npy_header::Number;
use crate::table::event_numbers::Row;

/// A compound as it stands in the file.
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

/// Whether compounds are Prophesee's.
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

/// Compounds packed by ECF, and the chunk of them that is being read: its columns, of which the library would make
/// records in memory of their own for every chunk.
pub struct Packed {
    chunks: Chunks,
    bytes: Vec<u8>,
    columns: Columns,
    /// The first row of the chunk that was read last, and the number of its events: none where it is damaged.
    held: Option<(u64, Option<usize>)>,
}

impl Packed {
    /// The compounds of a dataset, if they are packed so.
    pub fn find(file: &Hdf5, dataset: &Dataset) -> Option<Self> {
        Some(Self {
            chunks: file.chunks(dataset, filters::ECF)?,
            bytes: Vec::new(),
            columns: Columns::default(),
            held: None,
        })
    }

    /// Reads the chunk that begins at row `first`, unless it is held already; the number of its events.
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

    /// t, x, y and p of the first `count` events, if they are of one chunk that is not damaged.
    pub fn first_rows(&mut self, count: usize) -> Option<Vec<Row>> {
        let events = self.hold(0)?;
        if count > events {
            return None;
        }
        let numbers = |event: Event| {
            let [x, y] = [event.x, event.y].map(i64::from);
            [event.t_us.cast_signed(), x, y, event.polarity as i64]
        };
        let rows = self.columns.events(0..count).map(numbers);
        Some(
            rows.map(|row| row.map(|number| Some(Number::Whole(number))))
                .collect(),
        )
    }

    /// Appends the `count` events from row `start` on, of the chunk that begins at row `first`, to `batch`;
    /// `false` where they are not all there and on the sensor.
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

/// Appends the events of `count` compounds from `start` on to `batch`; `false` where they are not all
/// events on the sensor, which whoever reads them one number after the other can tell more about.
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
