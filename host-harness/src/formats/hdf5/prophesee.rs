//! Events in Prophesee's compounds: x and y (u16), p (i16), two bytes that mean nothing, t (i64, us), all
//! little-endian, which are taken as they stand, without a number of any type between.

use eecvs_nostd::{Event, Polarity, Sensor};
use hdf5_reader::{ByteOrder, Dataset, Datatype, H5Type, error::Error};

use super::ecf::RECORD_BYTES;
use super::file::read_rows;

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

/// Appends the events of `count` compounds from `start` on to `events`; `false` where they are not all
/// events on the sensor, which whoever reads them one number after the other can tell more about.
pub fn read(
    dataset: &Dataset,
    start: u64,
    count: u64,
    sensor: Sensor,
    mut append: impl FnMut(&mut dyn ExactSizeIterator<Item = Event>),
) -> bool {
    let Ok(records) = read_rows::<Record>(dataset, start, count) else {
        return false;
    };
    let is_right = records
        .iter()
        .fold(true, |all, record| all & record.is_event(sensor));
    if is_right {
        append(&mut records.iter().map(Record::event));
    }
    is_right
}
