//! Parses messages of Arrow's IPC format: the schema, and the positions of the columns in a record batch.
//!
//! Field numbers are those of Schema.fbs, Message.fbs and File.fbs of the format's versions 1.x.

use crate::flatbuffer::{Buffer, Table, Vector};
use crate::numpy::npy_header::Dtype;
use crate::table::columns::Stored;

/// Largest depth of nested types.
const DEPTH_MAX: usize = 16;

/// Largest number of columns of a schema.
const COLUMNS_MAX: usize = 10_000;

/// The content of a message.
pub enum Message {
    /// The schema.
    Schema(Schema),
    /// A batch of rows.
    Batch(RecordBatch),
    /// Values that columns refer to by index.
    Dictionary(Dictionary),
    /// Anything else, such as tensors.
    Other,
}

/// The columns and the metadata of a file.
pub struct Schema {
    /// Columns, in file order.
    pub columns: Vec<Column>,
    /// Keys and values of the metadata.
    pub metadata: Vec<(String, String)>,
}

/// A column of the schema.
pub struct Column {
    /// Name of the column.
    pub name: String,
    /// How the column is stored; `None` if it cannot be read.
    pub stored: Option<Stored>,
    /// For times with a unit: microseconds are the values times 10 to this power.
    pub shift: Option<i32>,
    /// For indices into a dictionary: the dictionary's number and the type of its values.
    pub dictionary: Option<(i64, Items)>,
    /// Numbers of nodes and buffers that the column has in a batch; `None` if they differ between batches.
    extent: Option<(usize, usize)>,
}

/// The type of a dictionary's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Items {
    /// Numbers.
    Numbers(Stored),
    /// Strings, whose offsets are integers of this many bytes.
    Texts(usize),
}

/// A message with the values of a dictionary.
pub struct Dictionary {
    /// Number of the dictionary, to which columns refer.
    pub id: i64,
    /// Values of the dictionary, as a column.
    pub batch: RecordBatch,
    /// Whether the values are appended to those that the dictionary already has.
    pub is_more: bool,
}

/// The compression of a batch's buffers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Codec {
    /// Not compressed.
    Stored,
    /// LZ4 frames.
    Lz4,
    /// Zstandard frames.
    Zstandard,
}

/// The positions of the columns in a batch.
pub struct RecordBatch {
    /// Number of rows.
    pub rows: u64,
    /// Compression of every buffer.
    pub codec: Codec,
    /// Offset and length of every buffer in the message's body.
    pub buffers: Vec<(u64, u64)>,
    /// Number of missing values of every node, that is, of every column and its children.
    pub nulls: Vec<u64>,
}

/// Returns a message's content and the length of its body; `None` if the message is damaged.
pub fn message(bytes: &[u8]) -> Option<(Message, u64)> {
    let (buffer, root) = Buffer::plain(bytes)?;
    let body = u64::try_from(buffer.i64(root, 3, 0)?).ok()?;
    let kind = buffer.u8(root, 1, 0)?;
    let message = match kind {
        1 => Message::Schema(schema(buffer, buffer.table(root, 2)??)?),
        2 => Message::Dictionary(dictionary(buffer, buffer.table(root, 2)??)?),
        3 => Message::Batch(batch(buffer, buffer.table(root, 2)??)?),
        _ => Message::Other,
    };
    Some((message, body))
}

/// Returns the schema that a file's footer repeats, and the offset of the first message that it lists, if any;
/// `None` if the footer is damaged.
pub fn footer(bytes: &[u8]) -> Option<(Schema, Option<u64>)> {
    let (buffer, root) = Buffer::plain(bytes)?;
    let schema = schema(buffer, buffer.table(root, 1)??)?;
    let mut first: Option<u64> = None;
    // Dictionaries and batches: blocks of offset, metadata length and body length.
    for field in [2, 3] {
        let blocks = buffer.vector(root, field)?;
        buffer.holds(blocks.start, blocks.len.checked_mul(24)?)?;
        for index in 0..blocks.len {
            let at = i64::from_le_bytes(buffer.bytes(blocks.start + 24 * index)?);
            let at = u64::try_from(at).ok()?;
            first = Some(first.map_or(at, |first| first.min(at)));
        }
    }
    Some((schema, first))
}

fn dictionary(buffer: Buffer, table: Table) -> Option<Dictionary> {
    Some(Dictionary {
        id: buffer.i64(table, 0, 0)?,
        batch: batch(buffer, buffer.table(table, 1)??)?,
        is_more: buffer.u8(table, 2, 0)? != 0,
    })
}

fn schema(buffer: Buffer, table: Table) -> Option<Schema> {
    let is_little = buffer.i16(table, 0, 0)? == 0;
    let fields = buffer.vector(table, 1)?;
    if fields.len > COLUMNS_MAX {
        return None;
    }
    let mut columns = Vec::new();
    for index in 0..fields.len {
        let mut column = column(buffer, buffer.element(fields, index)?)?;
        // In big-endian files, only single bytes could be read; no writer of such files is known.
        column.stored = column.stored.filter(|_| is_little);
        columns.push(column);
    }
    Some(Schema {
        columns,
        metadata: pairs(buffer, buffer.vector(table, 2)?)?,
    })
}

fn pairs(buffer: Buffer, vector: Vector) -> Option<Vec<(String, String)>> {
    let mut pairs = Vec::new();
    for index in 0..vector.len {
        let table = buffer.element(vector, index)?;
        // Values need not be text.
        if let (Some(key), Some(value)) = (buffer.string(table, 0), buffer.string(table, 1)) {
            pairs.push((key.to_owned(), value.to_owned()));
        }
    }
    Some(pairs)
}

fn column(buffer: Buffer, field: Table) -> Option<Column> {
    let kind = buffer.u8(field, 2, 0)?;
    let of = buffer.table(field, 3)?;
    let encoding = buffer.table(field, 4)?;
    let number = |kind, bytes| Dtype::new(kind, false, bytes).map(Stored::Number);
    let power = |unit: i16| Some(6 - 3 * i32::from(unit));
    let (stored, shift) = match (kind, of) {
        (INT, Some(of)) => (integer(buffer, of)?, None),
        (FLOAT, Some(of)) => {
            let bytes = match buffer.i16(of, 0, 0)? {
                0 => 2,
                1 => 4,
                _ => 8,
            };
            (number(b'f', bytes), None)
        }
        (BOOL, _) => (Some(Stored::Bool), None),
        (TIMESTAMP, Some(of)) => (number(b'i', 8), power(buffer.i16(of, 0, 0)?)),
        (DURATION, Some(of)) => (number(b'i', 8), power(buffer.i16(of, 0, 1)?)),
        (TIME, Some(of)) => {
            let bytes = usize::try_from(buffer.i32(of, 1, 32)?).ok()? / 8;
            (number(b'i', bytes), power(buffer.i16(of, 0, 1)?))
        }
        _ => (None, None),
    };
    let items = match kind {
        UTF8 => Some(Items::Texts(4)),
        LARGE_UTF8 => Some(Items::Texts(8)),
        _ => stored.map(Items::Numbers),
    };
    let (stored, dictionary) = match encoding {
        None => (stored, None),
        Some(encoding) => {
            let places = match buffer.table(encoding, 1)? {
                Some(of) => integer(buffer, of)?,
                None => number(b'i', 4),
            };
            let id = buffer.i64(encoding, 0, 0)?;
            let dictionary = items.map(|items| (id, items));
            (places.filter(|_| dictionary.is_some()), dictionary)
        }
    };
    Some(Column {
        name: buffer.string(field, 0)?.to_owned(),
        stored,
        shift,
        dictionary,
        extent: extent(buffer, field, DEPTH_MAX)?,
    })
}

/// Returns the stored type of an integer type; `Some(None)` if it cannot be read.
fn integer(buffer: Buffer, of: Table) -> Option<Option<Stored>> {
    let bytes = usize::try_from(buffer.i32(of, 0, 0)?).ok()? / 8;
    let kind = if buffer.u8(of, 1, 0)? != 0 {
        b'i'
    } else {
        b'u'
    };
    Some(Dtype::new(kind, false, bytes).map(Stored::Number))
}

// Codes of types in the union `Type`.
const NULL: u8 = 1;
const INT: u8 = 2;
const FLOAT: u8 = 3;
const BINARY: u8 = 4;
const UTF8: u8 = 5;
const BOOL: u8 = 6;
const TIME: u8 = 9;
const TIMESTAMP: u8 = 10;
const LIST: u8 = 12;
const STRUCT: u8 = 13;
const UNION: u8 = 14;
const FIXED_SIZE_LIST: u8 = 16;
const MAP: u8 = 17;
const DURATION: u8 = 18;
const LARGE_BINARY: u8 = 19;
const LARGE_UTF8: u8 = 20;
const LARGE_LIST: u8 = 21;
const RUN_END_ENCODED: u8 = 22;
const BINARY_VIEW: u8 = 23;
const UTF8_VIEW: u8 = 24;
const LIST_VIEW: u8 = 25;
const LARGE_LIST_VIEW: u8 = 26;

/// Returns the numbers of nodes and buffers of a field with its children; `Some(None)` if they differ between
/// batches.
fn extent(buffer: Buffer, field: Table, depth: usize) -> Option<Option<(usize, usize)>> {
    let depth = depth.checked_sub(1)?;
    if buffer.table(field, 4)?.is_some() {
        // A dictionary column stores indices.
        return Some(Some((1, 2)));
    }
    let own = match buffer.u8(field, 2, 0)? {
        NULL => (1, 0),
        BINARY | UTF8 | LARGE_BINARY | LARGE_UTF8 => (1, 3),
        LIST | MAP | LARGE_LIST => (1, 2),
        LIST_VIEW | LARGE_LIST_VIEW => (1, 3),
        STRUCT | FIXED_SIZE_LIST => (1, 1),
        RUN_END_ENCODED => (1, 0),
        UNION => {
            let mode = buffer.table(field, 3)?;
            let is_dense = match mode {
                Some(of) => buffer.i16(of, 0, 0)? != 0,
                None => false,
            };
            (1, if is_dense { 2 } else { 1 })
        }
        BINARY_VIEW | UTF8_VIEW => return Some(None),
        _ => (1, 2),
    };
    let children = buffer.vector(field, 5)?;
    if children.len > COLUMNS_MAX {
        return None;
    }
    let (mut nodes, mut buffers) = own;
    for index in 0..children.len {
        let child = buffer.element(children, index)?;
        let Some((more_nodes, more_buffers)) = extent(buffer, child, depth)? else {
            return Some(None);
        };
        nodes += more_nodes;
        buffers += more_buffers;
        // Tables may be shared, so a small buffer can describe a huge number of nodes.
        if nodes > COLUMNS_MAX {
            return None;
        }
    }
    Some(Some((nodes, buffers)))
}

fn batch(buffer: Buffer, table: Table) -> Option<RecordBatch> {
    let number = |position| u64::try_from(i64::from_le_bytes(buffer.bytes(position)?)).ok();
    let pairs = |vector: Vector| {
        // Check before allocating that there are 16 bytes for each element.
        buffer.holds(vector.start, vector.len.checked_mul(16)?)?;
        let starts = (0..vector.len).map(|index| vector.start + 16 * index);
        let pairs = starts.map(|at| Some((number(at)?, number(at + 8)?)));
        pairs.collect::<Option<Vec<_>>>()
    };
    let codec = match buffer.table(table, 3)? {
        None => Codec::Stored,
        Some(of) => match (buffer.u8(of, 0, 0)?, buffer.u8(of, 1, 0)?) {
            (0, 0) => Codec::Lz4,
            (1, 0) => Codec::Zstandard,
            _ => return None,
        },
    };
    let nodes = pairs(buffer.vector(table, 1)?)?;
    Some(RecordBatch {
        rows: u64::try_from(buffer.i64(table, 0, 0)?).ok()?,
        codec,
        buffers: pairs(buffer.vector(table, 2)?)?,
        nulls: nodes.into_iter().map(|(_, nulls)| nulls).collect(),
    })
}

impl Schema {
    /// Returns the node and the values' buffer of column number `place`; `None` if a column before it has no fixed
    /// number of buffers.
    pub fn position(&self, place: usize) -> Option<(usize, usize)> {
        let mut position = (0, 0);
        for column in self.columns.get(..place)? {
            let (nodes, buffers) = column.extent?;
            position = (position.0 + nodes, position.1 + buffers);
        }
        // The first buffer is the bitmap of the values that are present.
        Some((position.0, position.1 + 1))
    }
}
