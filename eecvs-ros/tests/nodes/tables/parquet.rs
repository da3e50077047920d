//! A reader of Parquet for this test alone, after the format's description: no more of it than `log` writes.
//!
//! The crate `parquet` would change the features of crates below the core, and have all of them built twice. pyarrow
//! reads these files as well.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Row, number};

/// A value in Thrift's compact protocol.
enum Thrift {
    Whole(i64),
    Bytes(Vec<u8>),
    List(Vec<Thrift>),
    Struct(BTreeMap<i64, Thrift>),
}

impl Thrift {
    fn at(&self, field: i64) -> &Self {
        let Self::Struct(fields) = self else {
            panic!("no struct")
        };
        &fields[&field]
    }

    fn whole(&self) -> i64 {
        let Self::Whole(whole) = self else {
            panic!("no number")
        };
        *whole
    }

    fn list(&self) -> &[Self] {
        let Self::List(list) = self else {
            panic!("no list")
        };
        list
    }

    fn text(&self) -> String {
        let Self::Bytes(bytes) = self else {
            panic!("no text")
        };
        String::from_utf8(bytes.clone()).unwrap()
    }
}

/// Bytes that are read from their start.
struct Bytes<'b>(&'b [u8]);

impl<'b> Bytes<'b> {
    fn take(&mut self, count: usize) -> &'b [u8] {
        let (taken, rest) = self.0.split_at(count);
        self.0 = rest;
        taken
    }

    fn byte(&mut self) -> u8 {
        self.take(1)[0]
    }

    fn u32(&mut self) -> usize {
        u32::from_le_bytes(self.take(4).try_into().unwrap()) as usize
    }

    fn varint(&mut self) -> u64 {
        let byte = self.byte();
        let low = u64::from(byte & 0x7f);
        if byte < 0x80 {
            low
        } else {
            low | self.varint() << 7
        }
    }

    fn zigzag(&mut self) -> i64 {
        let value = self.varint();
        (value >> 1) as i64 ^ -((value & 1) as i64)
    }

    fn thrift(&mut self, of: u8) -> Thrift {
        match of {
            1 | 2 => Thrift::Whole(i64::from(of == 1)),
            3 => Thrift::Whole(self.byte().into()),
            4..=6 => Thrift::Whole(self.zigzag()),
            8 => {
                let length = self.varint() as usize;
                Thrift::Bytes(self.take(length).to_vec())
            }
            9 => {
                let head = self.byte();
                let count = match head >> 4 {
                    15 => self.varint(),
                    count => count.into(),
                };
                Thrift::List((0..count).map(|_| self.thrift(head & 15)).collect())
            }
            12 => {
                let mut fields = BTreeMap::new();
                let mut field = 0;
                loop {
                    let head = self.byte();
                    if head == 0 {
                        return Thrift::Struct(fields);
                    }
                    field += i64::from(head >> 4);
                    fields.insert(field, self.thrift(head & 15));
                }
            }
            of => panic!("type {of}"),
        }
    }

    /// Runs of one value of up to 8 bits.
    fn runs(&mut self, count: usize) -> Vec<u8> {
        let mut values = Vec::new();
        while values.len() < count {
            let head = self.varint() as usize;
            assert_eq!(head & 1, 0, "packed values");
            let value = self.byte();
            values.extend(std::iter::repeat_n(value, head >> 1));
        }
        assert_eq!(values.len(), count);
        values
    }

    /// Differences in blocks of four parts.
    fn deltas(&mut self) -> Vec<i64> {
        let (block, parts) = (self.varint() as usize, self.varint() as usize);
        let count = self.varint() as usize;
        let mut values = vec![self.zigzag()];
        while values.len() < count {
            let least = self.zigzag();
            let widths = self.take(parts).to_vec();
            for width in widths.into_iter().map(usize::from) {
                if values.len() >= count {
                    break;
                }
                let packed = self.take(block / parts * width / 8);
                for index in 0..block / parts {
                    let bits = (0..width).map(|bit| {
                        let at = index * width + bit;
                        u64::from(packed[at / 8] >> (at % 8) & 1) << bit
                    });
                    let step = least.wrapping_add(bits.sum::<u64>() as i64);
                    values.push(values.last().unwrap().wrapping_add(step));
                }
            }
        }
        values.truncate(count);
        values
    }
}

/// The cells of a column chunk, whose rows are in one page.
fn column(mut bytes: Bytes<'_>, kind: i64, rows: usize) -> Vec<Option<String>> {
    let mut words = Vec::new();
    let mut header = bytes.thrift(12);
    if header.at(1).whole() == 2 {
        for _ in 0..header.at(7).at(1).whole() {
            let length = bytes.u32();
            words.push(String::from_utf8(bytes.take(length).to_vec()).unwrap());
        }
        header = bytes.thrift(12);
    }
    assert_eq!(header.at(1).whole(), 0);
    assert_eq!(header.at(5).at(1).whole(), rows as i64);
    assert_eq!(header.at(3).whole() as usize, bytes.0.len());
    let length = bytes.u32();
    let present = Bytes(bytes.take(length)).runs(rows);
    let there = present.iter().filter(|present| **present == 1).count();
    let values: Vec<String> = match kind {
        1 | 2 => bytes.deltas().iter().map(i64::to_string).collect(),
        5 => {
            let floats = bytes.0.chunks(8);
            let floats = floats.map(|float| f64::from_le_bytes(float.try_into().unwrap()));
            floats.map(number).collect()
        }
        6 => {
            assert!(bytes.byte() <= 8);
            let places = bytes.runs(there).into_iter();
            places
                .map(|place| words[usize::from(place)].clone())
                .collect()
        }
        kind => panic!("type {kind}"),
    };
    let mut values = values.into_iter();
    let cells = present
        .iter()
        .map(|present| (*present == 1).then(|| values.next().unwrap()));
    cells.collect()
}

/// A Parquet file's rows.
pub fn parquet(path: &Path) -> Vec<Row> {
    let bytes = std::fs::read(path).unwrap();
    assert!(bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"));
    let end = bytes.len() - 8;
    let length = Bytes(&bytes[end..]).u32();
    let footer = Bytes(&bytes[end - length..end]).thrift(12);
    let mut rows = Vec::new();
    for group in footer.at(4).list() {
        let count = group.at(3).whole() as usize;
        let mut group_rows = vec![Row::new(); count];
        for (chunk, field) in group.at(1).list().iter().zip(&footer.at(2).list()[1..]) {
            let metadata = chunk.at(3);
            let name = metadata.at(3).list()[0].text();
            assert_eq!(name, field.at(4).text());
            let start = chunk.at(2).whole() as usize;
            let page = &bytes[start..start + metadata.at(7).whole() as usize];
            let cells = column(Bytes(page), metadata.at(1).whole(), count);
            for (row, cell) in group_rows.iter_mut().zip(cells) {
                row.extend(cell.map(|cell| (name.clone(), cell)));
            }
        }
        rows.extend(group_rows);
    }
    assert_eq!(rows.len() as i64, footer.at(3).whole());
    rows
}
