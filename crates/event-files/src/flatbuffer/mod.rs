//! Checked reading of the few `FlatBuffers` tables that AEDAT 4 and Arrow have.
//!
//! The crate `flatbuffers` needs code that `flatc` generates; `flatc` would have to be installed, and its code is
//! `unsafe` throughout. AEDAT 4 needs four tables of scalars and vectors and Arrow a dozen, so the few lines that
//! follow an offset are written here. Every access is checked, and nothing recurses.

pub(crate) mod writer;

/// A buffer. Unless it is plain, it consists of a u32 size, the u32 offset of the root table, a four-letter
/// identifier and data.
#[derive(Debug, Clone, Copy)]
pub struct Buffer<'a>(&'a [u8]);

/// Position of a table within its [`Buffer`].
#[derive(Debug, Clone, Copy)]
pub struct Table(usize);

/// The first element and the number of elements of a vector.
#[derive(Debug, Clone, Copy)]
pub struct Vector {
    /// Position of the first element within the buffer.
    pub start: usize,
    /// Number of elements as the buffer states it, not checked against the buffer's size.
    pub len: usize,
}

impl<'a> Buffer<'a> {
    /// Returns the buffer and its root table if the size prefix and the four-letter identifier match.
    pub fn root(bytes: &'a [u8], letters: &[u8; 4]) -> Option<(Self, Table)> {
        let buffer = Self(bytes);
        let size = buffer.offset(0)?;
        let holds = bytes.len().checked_sub(4)? >= size && bytes.get(8..12)? == letters;
        let root = buffer.offset(4)?.checked_add(4)?;
        holds.then_some((buffer, Table(root)))
    }

    /// Returns the buffer and its root table, for a buffer without size prefix and identifier.
    pub fn plain(bytes: &'a [u8]) -> Option<(Self, Table)> {
        let buffer = Self(bytes);
        let root = buffer.offset(0)?;
        Some((buffer, Table(root)))
    }

    /// Returns `Some(())` if the buffer has `count` bytes at `position`.
    pub fn holds(self, position: usize, count: usize) -> Option<()> {
        let end = position.checked_add(count)?;
        (end <= self.0.len()).then_some(())
    }

    /// Returns the `N` bytes at `position`.
    pub fn bytes<const N: usize>(self, position: usize) -> Option<[u8; N]> {
        self.0.get(position..)?.first_chunk().copied()
    }

    fn offset(self, position: usize) -> Option<usize> {
        usize::try_from(u32::from_le_bytes(self.bytes(position)?)).ok()
    }

    /// Returns the position of field number `field`; `Some(None)` if the table omits the field.
    fn field(self, table: Table, field: usize) -> Option<Option<usize>> {
        let back = i32::from_le_bytes(self.bytes(table.0)?);
        let vtable = usize::try_from(i64::try_from(table.0).ok()? - i64::from(back)).ok()?;
        let size = usize::from(u16::from_le_bytes(self.bytes(vtable)?));
        let slot = 4 + 2 * field;
        if slot + 2 > size {
            return Some(None);
        }
        let offset = u16::from_le_bytes(self.bytes(vtable.checked_add(slot)?)?);
        Some((offset > 0).then_some(table.0 + usize::from(offset)))
    }

    /// Returns a one-byte scalar field, or `default` if it is omitted.
    pub fn u8(self, table: Table, field: usize, default: u8) -> Option<u8> {
        match self.field(table, field)? {
            Some(position) => Some(u8::from_le_bytes(self.bytes(position)?)),
            None => Some(default),
        }
    }

    /// Returns a two-byte scalar field, or `default` if it is omitted.
    pub fn i16(self, table: Table, field: usize, default: i16) -> Option<i16> {
        match self.field(table, field)? {
            Some(position) => Some(i16::from_le_bytes(self.bytes(position)?)),
            None => Some(default),
        }
    }

    /// Returns a field that is a table; `Some(None)` if it is omitted.
    pub fn table(self, table: Table, field: usize) -> Option<Option<Table>> {
        let Some(position) = self.field(table, field)? else {
            return Some(None);
        };
        Some(Some(Table(position.checked_add(self.offset(position)?)?)))
    }

    /// Returns a four-byte scalar field, or `default` if it is omitted.
    pub fn i32(self, table: Table, field: usize, default: i32) -> Option<i32> {
        match self.field(table, field)? {
            Some(position) => Some(i32::from_le_bytes(self.bytes(position)?)),
            None => Some(default),
        }
    }

    /// Returns an eight-byte scalar field, or `default` if it is omitted.
    pub fn i64(self, table: Table, field: usize, default: i64) -> Option<i64> {
        match self.field(table, field)? {
            Some(position) => Some(i64::from_le_bytes(self.bytes(position)?)),
            None => Some(default),
        }
    }

    /// Returns a vector field, or a vector without elements if it is omitted.
    pub fn vector(self, table: Table, field: usize) -> Option<Vector> {
        let Some(position) = self.field(table, field)? else {
            return Some(Vector { start: 0, len: 0 });
        };
        let length = position.checked_add(self.offset(position)?)?;
        Some(Vector {
            start: length.checked_add(4)?,
            len: self.offset(length)?,
        })
    }

    /// Returns a string field, which must be UTF-8; an empty string if it is omitted.
    pub fn string(self, table: Table, field: usize) -> Option<&'a str> {
        let Vector { start, len } = self.vector(table, field)?;
        std::str::from_utf8(self.0.get(start..start.checked_add(len)?)?).ok()
    }

    /// Returns table number `index` of a vector of tables.
    pub fn element(self, vector: Vector, index: usize) -> Option<Table> {
        let position = vector.start.checked_add(index.checked_mul(4)?)?;
        Some(Table(position.checked_add(self.offset(position)?)?))
    }

    /// Returns the position of a struct field, which is stored in the table itself.
    pub fn inline(self, table: Table, field: usize) -> Option<usize> {
        self.field(table, field)?
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A table with one vector of one u32, in `flatc`'s layout.
    const ONE: [u8; 36] = [
        32, 0, 0, 0, 16, 0, 0, 0, b'T', b'E', b'S', b'T', 0, 0, 6, 0, 8, 0, 4, 0, 6, 0, 0, 0, 4, 0,
        0, 0, 1, 0, 0, 0, 7, 0, 0, 0,
    ];

    #[test]
    fn follows_offsets() {
        let (buffer, table) = Buffer::root(&ONE, b"TEST").expect("a table");
        let vector = buffer.vector(table, 0).expect("a vector");
        assert_eq!((vector.start, vector.len), (32, 1));
        assert_eq!(buffer.vector(table, 1).map(|vector| vector.len), Some(0));
        assert_eq!(buffer.i64(table, 3, -1), Some(-1));
        assert!(Buffer::root(&ONE, b"EVTS").is_none());
    }

    #[test]
    fn damage_is_none_and_never_a_panic() {
        for position in 0..ONE.len() {
            for value in [0, 1, 0x7f, 0x80, 0xff] {
                let mut bytes = ONE;
                bytes[position] = value;
                let read = |bytes: &[u8]| {
                    let (buffer, table) = Buffer::root(bytes, b"TEST")?;
                    let vector = buffer.vector(table, 0)?;
                    buffer.bytes::<4>(vector.start)
                };
                let _ = read(&bytes);
                assert!(read(&bytes[..position]).is_none());
            }
        }
    }
}
