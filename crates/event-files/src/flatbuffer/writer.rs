//! Writes the few `FlatBuffers` tables that Arrow needs, from front to back: a table, then what its fields refer
//! to.

/// The value of a field or of an element.
pub enum Value {
    /// A number: its bytes, little-endian.
    Number(Vec<u8>),
    /// A table: the numbers and values of its fields.
    Table(Vec<(u16, Self)>),
    /// A string.
    Text(String),
    /// A vector of tables or strings.
    Vector(Vec<Self>),
    /// A vector of structs with 8-byte members: the number of structs, and their bytes.
    Structs(u32, Vec<u8>),
}

impl Value {
    /// Returns a one-byte number or a bool.
    pub fn u8(value: u8) -> Self {
        Self::Number(vec![value])
    }

    /// Returns a two-byte number.
    pub fn i16(value: i16) -> Self {
        Self::Number(value.to_le_bytes().to_vec())
    }

    /// Returns a four-byte number.
    pub fn i32(value: i32) -> Self {
        Self::Number(value.to_le_bytes().to_vec())
    }

    /// Returns an eight-byte number.
    pub fn i64(value: i64) -> Self {
        Self::Number(value.to_le_bytes().to_vec())
    }
}

/// Returns a buffer whose root is the table `root`, padded to a multiple of 8 bytes.
pub fn buffer(root: &Value) -> Vec<u8> {
    let mut out = vec![0; 4];
    let position = append(&mut out, root);
    set_offset(&mut out, 0, position);
    out.resize(out.len().next_multiple_of(8), 0);
    out
}

/// Makes the four bytes at `from` an offset that leads to `to`.
fn set_offset(out: &mut [u8], from: usize, to: usize) {
    if let Some(slot) = out.get_mut(from..).and_then(<[u8]>::first_chunk_mut::<4>) {
        *slot = ((to - from) as u32).to_le_bytes();
    }
}

/// Appends zeros up to a position `after` bytes past a multiple of 8.
fn align(out: &mut Vec<u8>, after: usize) {
    let length = (out.len() + 8 - after).next_multiple_of(8) - 8 + after;
    out.resize(length, 0);
}

/// Appends the target of an offset, and returns its position.
fn append(out: &mut Vec<u8>, value: &Value) -> usize {
    match value {
        Value::Number(bytes) => {
            align(out, 0);
            out.extend(bytes);
            out.len() - bytes.len()
        }
        Value::Text(text) => {
            align(out, 0);
            let position = out.len();
            out.extend((text.len() as u32).to_le_bytes());
            out.extend(text.bytes().chain([0]));
            position
        }
        Value::Structs(count, bytes) => {
            // The elements are aligned; they follow the four bytes of their number.
            align(out, 4);
            let position = out.len();
            out.extend(count.to_le_bytes());
            out.extend(bytes);
            position
        }
        Value::Vector(elements) => {
            align(out, 0);
            let position = out.len();
            out.extend((elements.len() as u32).to_le_bytes());
            out.resize(position + 4 + 4 * elements.len(), 0);
            for (index, element) in elements.iter().enumerate() {
                let to = append(out, element);
                set_offset(out, position + 4 + 4 * index, to);
            }
            position
        }
        Value::Table(fields) => append_table(out, fields),
    }
}

fn append_table(out: &mut Vec<u8>, fields: &[(u16, Value)]) -> usize {
    // Positions of the fields in the table, after the four bytes that lead back to the vtable.
    let mut places = Vec::with_capacity(fields.len());
    let mut size = 4_usize;
    for (_, value) in fields {
        let bytes = match value {
            Value::Number(bytes) => bytes.len(),
            _ => 4,
        };
        size = size.next_multiple_of(bytes.max(1));
        places.push(size);
        size += bytes;
    }
    let slots = fields.iter().map(|(field, _)| field + 1).max().unwrap_or(0);
    let mut list = vec![0_u16; usize::from(slots)];
    for ((field, _), place) in fields.iter().zip(&places) {
        if let Some(slot) = list.get_mut(usize::from(*field)) {
            *slot = *place as u16;
        }
    }
    align(out, 0);
    let list_at = out.len();
    out.extend([4 + 2 * slots, size as u16].map(u16::to_le_bytes).concat());
    out.extend(list.iter().flat_map(|place| place.to_le_bytes()));
    align(out, 0);
    let position = out.len();
    out.extend(((position - list_at) as i32).to_le_bytes());
    out.resize(position + size, 0);
    for ((_, value), place) in fields.iter().zip(places) {
        let at = position + place;
        if let Value::Number(bytes) = value {
            if let Some(slot) = out.get_mut(at..at + bytes.len()) {
                slot.copy_from_slice(bytes);
            }
        } else {
            let to = append(out, value);
            set_offset(out, at, to);
        }
    }
    position
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flatbuffer::Buffer;

    #[test]
    fn what_is_written_is_read() {
        let inner = Value::Table(vec![(0, Value::Text("name".to_owned()))]);
        let root = Value::Table(vec![
            (0, Value::i16(-7)),
            (2, Value::i64(1 << 40)),
            (3, Value::Vector(vec![inner])),
            (4, Value::Structs(1, 5_i64.to_le_bytes().to_vec())),
            (5, Value::u8(3)),
            (6, Value::i32(9)),
        ]);
        let bytes = buffer(&root);
        let (read, table) = Buffer::plain(&bytes).unwrap();
        assert_eq!(read.i16(table, 0, 0), Some(-7));
        assert_eq!(read.i32(table, 1, 4), Some(4));
        assert_eq!(read.i64(table, 2, 0), Some(1 << 40));
        let vector = read.vector(table, 3).unwrap();
        let inner = read.element(vector, 0).unwrap();
        assert_eq!(read.string(inner, 0), Some("name"));
        let structs = read.vector(table, 4).unwrap();
        assert_eq!((structs.len, structs.start % 8), (1, 0));
        assert_eq!(read.u8(table, 5, 0), Some(3));
        assert_eq!(read.i32(table, 6, 0), Some(9));
    }
}
