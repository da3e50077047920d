//! Writes tables as Parquet files: row groups with statistics, in which each column is one page.
//!
//! Integers are stored as differences, texts as positions in a dictionary, all else plain. This gives most of what
//! compression would give, and every reader supports it.

use std::fs::File;

use event_types::ensure;
use event_types::stream::Result;

use super::MAGIC;
use super::thrift::{BINARY, I32, STRUCT, Struct, put_integer, put_varint};
use super::values::{DELTA, DICTIONARY, PLAIN, RLE, deltas, runs};
use crate::output::sequential::Output;

/// Number of rows of a row group that suits readers; a page of them stays far below their limits.
pub const GROUP_ROWS: usize = 1 << 17;

/// The type of a column's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// True or false.
    Bool,
    /// Unsigned 16-bit integers.
    U16,
    /// Signed 64-bit integers.
    I64,
    /// 64-bit floats.
    F64,
    /// Text with few different values.
    Text,
}

/// A column of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// The column's name.
    pub name: &'static str,
    /// The type of its values.
    pub kind: Kind,
    /// Whether rows may lack a value.
    pub is_optional: bool,
}

/// The values of a column in a row group, without missing ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Values<'v> {
    /// Values of [`Kind::Bool`].
    Bools(&'v [bool]),
    /// Values of [`Kind::U16`] or [`Kind::I64`].
    Whole(&'v [i64]),
    /// Values of [`Kind::F64`].
    Floats(&'v [f64]),
    /// Values of [`Kind::Text`].
    Texts(&'v [&'static str]),
}

/// A column's part of a row group.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cells<'v> {
    /// The values that are present.
    pub values: Values<'v>,
    /// For an optional column, whether each row has a value.
    pub present: Option<&'v [bool]>,
}

/// A Parquet file that is being written. It holds about 100 bytes for every column of a row group written.
pub struct Table {
    file: Output,
    columns: Vec<Column>,
    groups: Vec<Vec<u8>>,
    rows: u64,
}

// Numbers of types.
const BOOLEAN: i32 = 0;
const INT32: i32 = 1;
const INT64: i32 = 2;
const DOUBLE: i32 = 5;
const BYTE_ARRAY: i32 = 6;

/// Older annotations, the only ones that some readers know.
const UTF8: i32 = 0;
const UINT_16: i32 = 12;

// Numbers of page types.
const DATA_PAGE: i32 = 0;
const DICTIONARY_PAGE: i32 = 2;

impl Kind {
    const fn stored(self) -> i32 {
        match self {
            Self::Bool => BOOLEAN,
            Self::U16 => INT32,
            Self::I64 => INT64,
            Self::F64 => DOUBLE,
            Self::Text => BYTE_ARRAY,
        }
    }

    const fn encoding(self) -> i32 {
        match self {
            Self::Bool | Self::F64 => PLAIN as i32,
            Self::U16 | Self::I64 => DELTA as i32,
            Self::Text => DICTIONARY as i32,
        }
    }

    const fn takes(self, values: Values<'_>) -> bool {
        matches!(
            (self, values),
            (Self::Bool, Values::Bools(_))
                | (Self::U16 | Self::I64, Values::Whole(_))
                | (Self::F64, Values::Floats(_))
                | (Self::Text, Values::Texts(_))
        )
    }

    /// Returns the least and the largest value, for kinds with statistics.
    fn ends(self, values: Values<'_>) -> Option<[Vec<u8>; 2]> {
        let Values::Whole(values) = values else {
            return None;
        };
        let (least, most) = (values.iter().min()?, values.iter().max()?);
        let size = if self.stored() == INT32 { 4 } else { 8 };
        Some([least, most].map(|value| value.to_le_bytes().into_iter().take(size).collect()))
    }
}

impl Column {
    /// Returns the encoded field of the schema.
    fn field(self) -> Vec<u8> {
        let field = Struct::default()
            .i32(1, self.kind.stored())
            .i32(3, self.is_optional.into())
            .binary(4, self.name.as_bytes());
        match self.kind {
            Kind::U16 => {
                let integer = Struct::default().byte(1, 16).bool(2, false);
                let logical = Struct::default().inner(10, integer);
                field.i32(6, UINT_16).inner(10, logical)
            }
            Kind::Text => {
                let string = Struct::default().inner(1, Struct::default());
                field.i32(6, UTF8).inner(10, string)
            }
            Kind::Bool | Kind::I64 | Kind::F64 => field,
        }
        .finish()
    }
}

impl Values<'_> {
    const fn len(self) -> usize {
        match self {
            Self::Bools(values) => values.len(),
            Self::Whole(values) => values.len(),
            Self::Floats(values) => values.len(),
            Self::Texts(values) => values.len(),
        }
    }

    /// Encodes the values as a page; for texts, also returns the dictionary and its number of entries.
    fn encoded(self) -> (Vec<u8>, Option<(Vec<u8>, usize)>) {
        let page = match self {
            Self::Bools(values) => {
                let bytes = values.chunks(8).map(|eight| {
                    let bits = eight.iter().rev();
                    bits.fold(0_u8, |byte, on| byte << 1 | u8::from(*on))
                });
                bytes.collect()
            }
            Self::Whole(values) => deltas(values),
            Self::Floats(values) => values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect(),
            Self::Texts(values) => {
                let mut words: Vec<&str> = Vec::new();
                let mut places = Vec::with_capacity(values.len());
                for value in values {
                    let place = words.iter().position(|word| word == value);
                    places.push(place.unwrap_or(words.len()) as u32);
                    if place.is_none() {
                        words.push(value);
                    }
                }
                let width = (words.len().max(2) - 1).ilog2() as u8 + 1;
                let mut page = vec![width];
                page.extend(runs(places, width));
                let mut dictionary = Vec::new();
                for word in &words {
                    dictionary.extend((word.len() as u32).to_le_bytes());
                    dictionary.extend(word.bytes());
                }
                return (page, Some((dictionary, words.len())));
            }
        };
        (page, None)
    }
}

impl Table {
    /// Begins a table in an empty file, which messages call `name`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn new(file: File, name: String, columns: &[Column]) -> Result<Self> {
        Self::begin(Output::new(file, name), columns)
    }

    pub(super) fn begin(file: Output, columns: &[Column]) -> Result<Self> {
        let mut table = Self {
            file,
            columns: columns.to_vec(),
            groups: Vec::new(),
            rows: 0,
        };
        table.file.put(MAGIC)?;
        Ok(table)
    }

    /// Returns the file's name for messages.
    #[must_use]
    pub fn name(&self) -> &str {
        self.file.name()
    }

    /// Writes a row group of `rows` rows: `cells` holds a part of every column, in the table's order.
    ///
    /// # Errors
    /// The file cannot be written; the parts do not match the columns or the number of rows.
    pub fn group(&mut self, rows: usize, cells: &[Cells<'_>]) -> Result<()> {
        if rows == 0 {
            return Ok(());
        }
        let name = self.file.name();
        ensure!(
            cells.len() == self.columns.len(),
            Damaged,
            "{name}: other columns"
        );
        for (column, cells) in self.columns.iter().zip(cells) {
            let present = cells.present.map_or(rows, |present| {
                present.iter().filter(|present| **present).count()
            });
            let is_whole = column.kind.takes(cells.values)
                && cells.present.is_some() == column.is_optional
                && cells.present.is_none_or(|present| present.len() == rows)
                && cells.values.len() == present;
            let of = column.name;
            ensure!(
                is_whole,
                Damaged,
                "{name}: column {of}: not the values of its rows"
            );
        }
        let start = self.file.position();
        let mut chunks = Vec::new();
        for (index, cells) in cells.iter().enumerate() {
            if let Some(column) = self.columns.get(index).copied() {
                chunks.push(self.chunk(column, rows, *cells)?);
            }
        }
        let bytes = (self.file.position() - start) as i64;
        let group = Struct::default()
            .list(1, STRUCT, &chunks)
            .i64(2, bytes)
            .i64(3, rows as i64)
            .i64(5, start as i64)
            .i64(6, bytes);
        self.groups.push(group.finish());
        self.rows += rows as u64;
        Ok(())
    }

    /// Writes a column's part of a row group, and returns its encoded entry for the footer.
    fn chunk(&mut self, column: Column, rows: usize, cells: Cells<'_>) -> Result<Vec<u8>> {
        let encoding = column.kind.encoding();
        let start = self.file.position();
        let (values, dictionary) = cells.values.encoded();
        let mut encodings = vec![encoding, RLE as i32];
        let has_dictionary = dictionary.is_some();
        if let Some((words, count)) = dictionary {
            encodings.push(PLAIN as i32);
            let of = Struct::default().i32(1, count as i32).i32(2, PLAIN as i32);
            self.page(DICTIONARY_PAGE, 7, of, &[&words])?;
        }
        let at = self.file.position();
        // The list of rows that have a value, after its size in bytes.
        let mut levels = Vec::new();
        if let Some(present) = cells.present {
            let list = runs(present.iter().map(|present| u32::from(*present)), 1);
            levels.extend((list.len() as u32).to_le_bytes());
            levels.extend(list);
        }
        let of = Struct::default()
            .i32(1, rows as i32)
            .i32(2, encoding)
            .i32(3, RLE as i32)
            .i32(4, RLE as i32);
        self.page(DATA_PAGE, 5, of, &[&levels, &values])?;
        let bytes = (self.file.position() - start) as i64;
        let missing = rows - cells.values.len();
        let mut statistics = Struct::default().i64(3, missing as i64);
        if let Some([least, most]) = column.kind.ends(cells.values) {
            statistics = statistics.binary(5, &most).binary(6, &least);
        }
        let encodings: Vec<Vec<u8>> = encodings
            .into_iter()
            .map(|encoding| {
                let mut element = Vec::new();
                put_integer(&mut element, encoding.into());
                element
            })
            .collect();
        let mut metadata = Struct::default()
            .i32(1, column.kind.stored())
            .list(2, I32, &encodings)
            .list(3, BINARY, &[text(column.name)])
            .i32(4, 0)
            .i64(5, rows as i64)
            .i64(6, bytes)
            .i64(7, bytes)
            .i64(9, at as i64);
        if has_dictionary {
            metadata = metadata.i64(11, start as i64);
        }
        let metadata = metadata.inner(12, statistics);
        let chunk = Struct::default().i64(2, start as i64);
        Ok(chunk.inner(3, metadata).finish())
    }

    /// Writes a page after its header, in which `of` is field number `field`.
    fn page(&mut self, kind: i32, field: u8, of: Struct, parts: &[&[u8]]) -> Result<()> {
        let bytes = parts.iter().map(|part| part.len()).sum::<usize>() as i32;
        let header = Struct::default().i32(1, kind).i32(2, bytes).i32(3, bytes);
        self.file.put(&header.inner(field, of).finish())?;
        parts.iter().try_for_each(|part| self.file.put(part))
    }

    /// Writes the footer, with these keys and values, and flushes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(&mut self, pairs: &[(&str, String)]) -> Result<()> {
        let count = self.columns.len() as i32;
        let root = Struct::default().binary(4, b"schema").i32(5, count);
        let fields = self.columns.iter().map(|column| column.field());
        let schema: Vec<Vec<u8>> = std::iter::once(root.finish()).chain(fields).collect();
        let pairs: Vec<Vec<u8>> = pairs
            .iter()
            .map(|(key, value)| {
                let pair = Struct::default().binary(1, key.as_bytes());
                pair.binary(2, value.as_bytes()).finish()
            })
            .collect();
        // Statistics are ordered by the order of their types.
        let orders = self.columns.iter().map(|_| {
            let order = Struct::default().inner(1, Struct::default());
            order.finish()
        });
        let orders: Vec<Vec<u8>> = orders.collect();
        let mut footer = Struct::default()
            .i32(1, 2)
            .list(2, STRUCT, &schema)
            .i64(3, self.rows as i64)
            .list(4, STRUCT, &self.groups);
        if !pairs.is_empty() {
            footer = footer.list(5, STRUCT, &pairs);
        }
        let footer = footer
            .binary(6, concat!("eecvs ", env!("CARGO_PKG_VERSION")).as_bytes())
            .list(7, STRUCT, &orders)
            .finish();
        self.file.put(&footer)?;
        self.file.put(&(footer.len() as u32).to_le_bytes())?;
        self.file.put(MAGIC)?;
        self.file.finish()
    }
}

/// Encodes a text as an element of a list.
fn text(text: &str) -> Vec<u8> {
    let mut element = Vec::new();
    put_varint(&mut element, text.len() as u64);
    element.extend(text.bytes());
    element
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::EventReader;
    use crate::parquet::ParquetReader;
    use crate::parquet::values::Runs;
    use crate::reading::Reading;

    fn column(name: &'static str, kind: Kind, is_optional: bool) -> Column {
        Column {
            name,
            kind,
            is_optional,
        }
    }

    #[test]
    fn columns_of_every_kind_lie_where_the_footer_says() {
        let columns = [
            column("note", Kind::Text, true),
            column("t", Kind::I64, true),
            column("x", Kind::U16, false),
            column("gain", Kind::F64, true),
            column("y", Kind::U16, true),
            column("p", Kind::Bool, true),
        ];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.parquet");
        let file = File::create(&path).unwrap();
        let mut table = Table::new(file, "table".to_owned(), &columns).unwrap();
        let all = [true; 3];
        let some = [true, false, true];
        let values = [
            (Values::Texts(&["one", "two"]), Some(&some)),
            (Values::Whole(&[5, 6, 1 << 40]), Some(&all)),
            (Values::Whole(&[0, 2047, 1]), None),
            (Values::Floats(&[0.5, -1e300]), Some(&some)),
            (Values::Whole(&[3, 2, 1]), Some(&all)),
            (Values::Bools(&[true, false, true]), Some(&all)),
        ];
        let cells = values.map(|(values, present)| Cells {
            values,
            present: present.map(<[bool; 3]>::as_slice),
        });
        table.group(3, &cells).unwrap();
        table.group(0, &cells).unwrap();
        table.group(3, &cells).unwrap();
        assert!(table.group(2, &cells).is_err());
        assert!(table.group(3, &cells[1..]).is_err());
        table.finish(&[]).unwrap();
        let source = Box::new(File::open(&path).unwrap());
        let mut reader = ParquetReader::new(source, "table", &Reading::default()).unwrap();
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        let got: Vec<_> = events
            .iter()
            .map(|event| (event.t_us, event.x, event.y, event.polarity as u8))
            .collect();
        let want = [(5, 0, 3, 1), (6, 2047, 2, 0), (1 << 40, 1, 1, 1)];
        assert_eq!(got, [want, want].concat());
    }

    #[test]
    fn texts_are_places_in_a_dictionary() {
        let (page, dictionary) = Values::Texts(&["a", "bc", "a", "d"]).encoded();
        assert_eq!(
            dictionary,
            Some((b"\x01\0\0\0a\x02\0\0\0bc\x01\0\0\0d".to_vec(), 3))
        );
        let mut places = Runs::new(page[1..].to_vec(), page[0]).unwrap();
        let got: Vec<u64> = std::iter::from_fn(|| places.next()).collect();
        assert_eq!(got, [0, 1, 0, 2]);
    }
}
