//! Parses the metadata of a Parquet file: columns, row groups and pages (parquet.thrift of Apache Parquet).

use std::io::Read;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;

use super::thrift::Compact;
use crate::arrow;
use crate::numpy::npy_header::{Dtype, Number};
use crate::table::columns::{Stored, is_known_key};

/// Key under which Arrow's writers store their schema: a message in Arrow's format, in base 64.
const ARROW_SCHEMA: &str = "ARROW:schema";

/// The footer of a file.
#[derive(Default)]
pub struct Metadata {
    /// The fields of a row, including groups.
    pub fields: Vec<Field>,
    /// Number of columns that hold values, including those inside groups.
    pub leaves: usize,
    /// Number of rows in all row groups.
    pub rows: u64,
    /// The row groups.
    pub groups: Vec<RowGroup>,
    /// The keys and values.
    pub metadata: Vec<(String, String)>,
}

/// A field of a row.
pub struct Field {
    /// The field's name.
    pub name: String,
    /// Index of its column chunk in every row group.
    pub leaf: usize,
    /// How its values are stored; `None` if the type is not supported.
    pub stored: Option<Stored>,
    /// For times with a unit, its power of ten: a value times 10 to this is in microseconds.
    pub shift: Option<i32>,
    /// Whether values may be missing.
    pub is_optional: bool,
}

/// A row group: rows whose columns are stored together.
#[derive(Default)]
pub struct RowGroup {
    /// Number of rows.
    pub rows: u64,
    /// The column chunks.
    pub chunks: Vec<Chunk>,
}

/// A column chunk: a column's part of a row group.
#[derive(Clone, Default)]
pub struct Chunk {
    /// Offset of the first page, and size in bytes of all pages.
    pub start: u64,
    pub bytes: u64,
    /// Number of the compression codec.
    pub codec: i64,
    /// Bytes of the least value, from the statistics.
    pub least: Option<Vec<u8>>,
}

/// The header of a page.
#[derive(Default)]
pub struct Page {
    /// Kind of page: 0 or 3 values, 2 the dictionary.
    pub kind: i64,
    /// Size in bytes when unpacked, and as stored.
    pub bytes: u64,
    pub stored_bytes: u64,
    /// CRC-32 of the stored bytes.
    pub crc: Option<u32>,
    /// Number of values, including missing ones.
    pub values: u64,
    /// Number of the encoding.
    pub encoding: i64,
    /// For kind 3: sizes in bytes of the uncompressed lists that state which values are nested and which are
    /// present.
    pub levels: [u64; 2],
    /// For kind 3: whether the values are compressed.
    pub is_compressed: bool,
}

/// An element of the schema as stored in the file.
#[derive(Default)]
struct Element {
    kind: Option<i64>,
    repetition: i64,
    name: String,
    children: u64,
    converted: Option<i64>,
    shift: Option<i32>,
    is_unsigned: bool,
}

fn unsigned(value: i64) -> Option<u64> {
    u64::try_from(value).ok()
}

impl Metadata {
    /// Parses the footer; `None` if it is damaged.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let mut found = Self::default();
        let mut elements = Vec::new();
        Compact::new(bytes).fields(|thrift, number, _| {
            match number {
                2 => thrift.structs(|thrift| {
                    elements.push(element(thrift)?);
                    Some(())
                })?,
                3 => found.rows = unsigned(thrift.integer()?)?,
                4 => thrift.structs(|thrift| {
                    found.groups.push(row_group(thrift)?);
                    Some(())
                })?,
                5 => thrift.structs(|thrift| {
                    found.metadata.push(pair(thrift)?);
                    Some(())
                })?,
                _ => return Some(false),
            }
            Some(true)
        })?;
        found.place_fields(elements)?;
        found.take_durations();
        Some(found)
    }

    /// Takes the units that Parquet cannot express from Arrow's schema, if there is one.
    fn take_durations(&mut self) {
        let pair = self.metadata.iter().find(|(key, _)| key == ARROW_SCHEMA);
        let bytes = pair.and_then(|(_, text)| BASE64_STANDARD.decode(text.trim()).ok());
        let Some(schema) = bytes.and_then(|bytes| arrow::schema_of_message(&bytes)) else {
            return;
        };
        for field in self.fields.iter_mut().filter(|field| field.shift.is_none()) {
            let column = schema
                .columns
                .iter()
                .find(|column| column.name == field.name);
            field.shift = column.and_then(|column| column.shift);
        }
    }

    /// Finds the root's fields in the list of elements, in which each follows its parent.
    fn place_fields(&mut self, elements: Vec<Element>) -> Option<()> {
        let mut elements = elements.into_iter();
        let mut fields = elements.next()?.children;
        while fields > 0 {
            fields -= 1;
            let element = elements.next()?;
            let leaf = self.leaves;
            let mut below = element.children;
            self.leaves += usize::from(below == 0);
            while below > 0 {
                let child = elements.next()?;
                below = below.checked_sub(1)?.checked_add(child.children)?;
                self.leaves += usize::from(child.children == 0);
            }
            let is_plain = element.children == 0 && element.repetition < 2;
            self.fields.push(Field {
                stored: stored(&element).filter(|_| is_plain),
                shift: element.shift.or_else(|| converted_shift(&element)),
                leaf,
                is_optional: element.repetition == 1,
                name: element.name,
            });
        }
        Some(())
    }
}

/// Returns a chunk's least value, from its statistics.
pub fn least(chunk: &Chunk, stored: Stored) -> Option<Number> {
    match stored {
        Stored::Number(dtype) => dtype.number(chunk.least.as_ref()?),
        Stored::Bool => None,
    }
}

fn stored(element: &Element) -> Option<Stored> {
    let is_unsigned = element.is_unsigned || matches!(element.converted, Some(11..=14));
    let integer = if is_unsigned { b'u' } else { b'i' };
    let (kind, bytes) = match element.kind? {
        0 => return Some(Stored::Bool),
        1 => (integer, 4),
        2 => (integer, 8),
        4 => (b'f', 4),
        5 => (b'f', 8),
        _ => return None,
    };
    Dtype::new(kind, false, bytes).map(Stored::Number)
}

/// Returns the unit of times that the older annotations state.
fn converted_shift(element: &Element) -> Option<i32> {
    match element.converted? {
        7 | 9 => Some(3),
        8 | 10 => Some(0),
        _ => None,
    }
}

fn element(thrift: &mut Compact<&[u8]>) -> Option<Element> {
    let mut found = Element::default();
    thrift.fields(|thrift, number, _| {
        match number {
            1 => found.kind = Some(thrift.integer()?),
            3 => found.repetition = thrift.integer()?,
            4 => found.name = thrift.text()?,
            5 => found.children = unsigned(thrift.integer()?)?,
            6 => found.converted = Some(thrift.integer()?),
            10 => logical(thrift, &mut found)?,
            _ => return Some(false),
        }
        Some(true)
    })?;
    Some(found)
}

/// Parses a logical type: one of a union's structs.
fn logical(thrift: &mut Compact<&[u8]>, found: &mut Element) -> Option<()> {
    thrift.fields(|thrift, kind, _| {
        match kind {
            // A time of day or a timestamp: the unit is again one of a union's structs, all of them empty.
            7 | 8 => thrift.fields(|thrift, number, _| {
                if number != 2 {
                    return Some(false);
                }
                thrift.fields(|_, unit, _| {
                    found.shift = match unit {
                        1 => Some(3),
                        2 => Some(0),
                        3 => Some(-3),
                        _ => None,
                    };
                    Some(false)
                })?;
                Some(true)
            })?,
            10 => thrift.fields(|_, number, of| {
                if number == 2 {
                    found.is_unsigned = of == super::thrift::FALSE;
                }
                Some(false)
            })?,
            _ => return Some(false),
        }
        Some(true)
    })
}

fn pair(thrift: &mut Compact<&[u8]>) -> Option<(String, String)> {
    let mut pair = (String::new(), String::new());
    thrift.fields(|thrift, number, _| {
        match number {
            1 => pair.0 = thrift.text()?,
            2 if pair.0 == ARROW_SCHEMA || is_known_key(&pair.0) => pair.1 = thrift.text()?,
            _ => return Some(false),
        }
        Some(true)
    })?;
    Some(pair)
}

fn row_group(thrift: &mut Compact<&[u8]>) -> Option<RowGroup> {
    let mut found = RowGroup::default();
    thrift.fields(|thrift, number, _| {
        match number {
            1 => thrift.structs(|thrift| {
                let mut chunk = Chunk::default();
                thrift.fields(|thrift, number, _| {
                    // A chunk stored in another file has no metadata here; it stays empty and cannot be read.
                    if number == 3 {
                        chunk = column(thrift)?;
                    }
                    Some(number == 3)
                })?;
                found.chunks.push(chunk);
                Some(())
            })?,
            3 => found.rows = unsigned(thrift.integer()?)?,
            _ => return Some(false),
        }
        Some(true)
    })?;
    Some(found)
}

fn column(thrift: &mut Compact<&[u8]>) -> Option<Chunk> {
    let mut found = Chunk::default();
    let (mut data, mut dictionary) = (0, 0);
    thrift.fields(|thrift, number, _| {
        match number {
            4 => found.codec = thrift.integer()?,
            7 => found.bytes = unsigned(thrift.integer()?)?,
            9 => data = unsigned(thrift.integer()?)?,
            11 => dictionary = unsigned(thrift.integer()?)?,
            12 => thrift.fields(|thrift, number, _| {
                // Older writers use field 2.
                let is_least = matches!(number, 2 | 6);
                if is_least {
                    found.least = Some(thrift.binary()?);
                }
                Some(is_least)
            })?,
            _ => return Some(false),
        }
        Some(true)
    })?;
    found.start = if dictionary > 0 {
        data.min(dictionary)
    } else {
        data
    };
    Some(found)
}

/// Parses the header of the next page; `None` if it is damaged.
pub fn page(source: &mut impl Read) -> Option<Page> {
    let mut found = Page {
        is_compressed: true,
        ..Page::default()
    };
    Compact::new(source).fields(|thrift, number, _| {
        match number {
            1 => found.kind = thrift.integer()?,
            2 => found.bytes = unsigned(thrift.integer()?)?,
            3 => found.stored_bytes = unsigned(thrift.integer()?)?,
            4 => found.crc = Some(thrift.integer()? as u32),
            5 | 7 => thrift.fields(|thrift, number, _| {
                match number {
                    1 => found.values = unsigned(thrift.integer()?)?,
                    2 => found.encoding = thrift.integer()?,
                    _ => return Some(false),
                }
                Some(true)
            })?,
            8 => thrift.fields(|thrift, number, of| {
                match number {
                    1 => found.values = unsigned(thrift.integer()?)?,
                    4 => found.encoding = thrift.integer()?,
                    5 => found.levels[1] = unsigned(thrift.integer()?)?,
                    6 => found.levels[0] = unsigned(thrift.integer()?)?,
                    7 => {
                        found.is_compressed = of == super::thrift::TRUE;
                        return Some(false);
                    }
                    _ => return Some(false),
                }
                Some(true)
            })?,
            _ => return Some(false),
        }
        Some(true)
    })?;
    Some(found)
}
