//! Writer of Parquet files: t (int64, us), x, y (uint16) as differences, p (bool), in row groups of 131,072
//! events with statistics; `width` and `height` are keys of the footer.
//!
//! Differences take some 4 bytes an event without any compression, and every reader knows them.

use std::path::Path;

use anyhow::Context;
use eecvs_nostd::{Event, Sensor};

use super::MAGIC;
use super::thrift::{BINARY, I32, STRUCT, Struct, put_integer, put_varint};
use super::values::{DELTA, PLAIN, RLE, deltas};
use crate::formats::EventWriter;
use crate::formats::output::Output;

/// Rows of a row group, and of its only page of a column.
const GROUP_ROWS: usize = 1 << 17;

/// Numbers of types.
const BOOLEAN: i32 = 0;
const INT32: i32 = 1;
const INT64: i32 = 2;

/// An older annotation: unsigned, 16 bits.
const UINT_16: i32 = 12;

/// Names and types of the columns.
const COLUMNS: [(&str, i32); 4] = [("t", INT64), ("x", INT32), ("y", INT32), ("p", BOOLEAN)];

/// Writer of Parquet files. It holds a row group, and some 400 bytes for every one written.
pub struct ParquetWriter {
    file: Output,
    sensor: Sensor,
    /// t, x, y.
    columns: [Vec<i64>; 3],
    polarities: Vec<bool>,
    groups: Vec<Vec<u8>>,
    events: u64,
}

impl ParquetWriter {
    /// Creates the file.
    ///
    /// # Errors
    /// I/O.
    pub fn create(path: &Path, sensor: Sensor) -> anyhow::Result<Self> {
        let file = Output::create(path)?;
        let mut writer = Self {
            file,
            sensor,
            columns: [const { Vec::new() }; 3],
            polarities: Vec::new(),
            groups: Vec::new(),
            events: 0,
        };
        writer.file.put(MAGIC)?;
        Ok(writer)
    }

    fn write_group(&mut self) -> anyhow::Result<()> {
        let rows = self.polarities.len();
        if rows == 0 {
            return Ok(());
        }
        let pages = {
            let [t, x, y] = &self.columns;
            let bytes = self.polarities.chunks(8).map(|eight| {
                let bits = eight.iter().rev();
                bits.fold(0_u8, |byte, on| byte << 1 | u8::from(*on))
            });
            [deltas(t), deltas(x), deltas(y), bytes.collect()]
        };
        let ends = |column: &[i64]| Some((*column.iter().min()?, *column.iter().max()?));
        let ends = [
            ends(&self.columns[0]),
            ends(&self.columns[1]),
            ends(&self.columns[2]),
            None,
        ];
        let start = self.file.position();
        let mut chunks = Vec::new();
        for (((name, of), page), ends) in COLUMNS.into_iter().zip(pages).zip(ends) {
            let encoding = if of == BOOLEAN { PLAIN } else { DELTA } as i32;
            let values = Struct::default()
                .i32(1, rows as i32)
                .i32(2, encoding)
                // Of the lists that tell which values are missing; there are none.
                .i32(3, RLE as i32)
                .i32(4, RLE as i32);
            let bytes = page.len() as i32;
            let header = Struct::default().i32(1, 0).i32(2, bytes).i32(3, bytes);
            let header = header.inner(5, values).finish();
            let at = self.file.position();
            self.file.put(&header)?;
            self.file.put(&page)?;
            let all = (self.file.position() - at) as i64;
            let mut statistics = Struct::default().i64(3, 0);
            if let Some((least, most)) = ends {
                let size = if of == INT64 { 8 } else { 4 };
                let bytes = |value: i64| value.to_le_bytes().get(..size).map(<[u8]>::to_vec);
                statistics = statistics
                    .binary(5, &bytes(most).unwrap_or_default())
                    .binary(6, &bytes(least).unwrap_or_default());
            }
            let encodings = [encoding, RLE as i32].map(|encoding| {
                let mut element = Vec::new();
                put_integer(&mut element, encoding.into());
                element
            });
            let metadata = Struct::default()
                .i32(1, of)
                .list(2, I32, &encodings)
                .list(3, BINARY, &[text(name)])
                .i32(4, 0)
                .i64(5, rows as i64)
                .i64(6, all)
                .i64(7, all)
                .i64(9, at as i64)
                .inner(12, statistics);
            chunks.push(
                Struct::default()
                    .i64(2, at as i64)
                    .inner(3, metadata)
                    .finish(),
            );
        }
        let bytes = (self.file.position() - start) as i64;
        let group = Struct::default()
            .list(1, STRUCT, &chunks)
            .i64(2, bytes)
            .i64(3, rows as i64)
            .i64(5, start as i64)
            .i64(6, bytes);
        self.groups.push(group.finish());
        self.columns.iter_mut().for_each(Vec::clear);
        self.polarities.clear();
        Ok(())
    }

    fn close(&mut self) -> anyhow::Result<()> {
        self.write_group()?;
        let root = Struct::default().binary(4, b"schema").i32(5, 4).finish();
        let fields = COLUMNS.map(|(name, of)| {
            // Never missing.
            let field = Struct::default()
                .i32(1, of)
                .i32(3, 0)
                .binary(4, name.as_bytes());
            let field = if of == INT32 {
                let integer = Struct::default().byte(1, 16).bool(2, false);
                let logical = Struct::default().inner(10, integer);
                field.i32(6, UINT_16).inner(10, logical)
            } else {
                field
            };
            field.finish()
        });
        let schema: Vec<Vec<u8>> = std::iter::once(root).chain(fields).collect();
        let Sensor { width, height } = self.sensor;
        let sides = [("width", width), ("height", height)].map(|(key, side)| {
            let value = side.to_string();
            let pair = Struct::default().binary(1, key.as_bytes());
            pair.binary(2, value.as_bytes()).finish()
        });
        // Statistics are ordered as the types are.
        let order = || Struct::default().inner(1, Struct::default()).finish();
        let footer = Struct::default()
            .i32(1, 2)
            .list(2, STRUCT, &schema)
            .i64(3, self.events as i64)
            .list(4, STRUCT, &self.groups)
            .list(5, STRUCT, &sides)
            .binary(6, concat!("eecvs ", env!("CARGO_PKG_VERSION")).as_bytes())
            .list(7, STRUCT, &COLUMNS.map(|_| order()))
            .finish();
        self.file.put(&footer)?;
        self.file.put(&(footer.len() as u32).to_le_bytes())?;
        self.file.put(MAGIC)?;
        self.file.finish()
    }
}

/// A text as an element of a list.
fn text(text: &str) -> Vec<u8> {
    let mut element = Vec::new();
    put_varint(&mut element, text.len() as u64);
    element.extend(text.bytes());
    element
}

impl EventWriter for ParquetWriter {
    fn write(&mut self, events: &[Event]) -> anyhow::Result<()> {
        for event in events {
            crate::formats::check_inside(self.file.name(), self.events, event, self.sensor)?;
            let (name, index, t_us) = (self.file.name(), self.events, event.t_us);
            let time = i64::try_from(t_us).ok().with_context(|| {
                format!("{name}: event {index}: time {t_us} us is above 2^63 us")
            })?;
            let [t, x, y] = &mut self.columns;
            t.push(time);
            x.push(event.x.into());
            y.push(event.y.into());
            self.polarities.push(event.polarity as u8 == 1);
            self.events += 1;
            if self.polarities.len() == GROUP_ROWS {
                self.write_group()?;
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> anyhow::Result<()> {
        self.close()
    }
}
