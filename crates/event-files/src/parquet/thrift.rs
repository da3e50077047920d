//! Reads and writes Thrift's compact protocol, as far as Parquet's metadata needs it.
//!
//! A field begins with a byte: its type in the lower four bits, the step of its number in the upper four (0: the
//! number itself follows). Integers are varints, signed ones in zigzag encoding. A list begins with a byte: the
//! type of its elements in the lower four bits, its length in the upper four, or 15 if the length follows as a
//! varint. A type of 0 ends a struct.

use std::io::Read;

// Types of fields.
pub const TRUE: u8 = 1;
pub const FALSE: u8 = 2;
pub const BYTE: u8 = 3;
pub const I16: u8 = 4;
pub const I32: u8 = 5;
pub const I64: u8 = 6;
const DOUBLE: u8 = 7;
pub const BINARY: u8 = 8;
pub const LIST: u8 = 9;
const SET: u8 = 10;
const MAP: u8 = 11;
pub const STRUCT: u8 = 12;

/// Largest size in bytes of text or binary data that is kept; skipped data may be longer.
const BINARY_MAX: u64 = 16 << 20;

/// Greatest depth of nested structs.
const DEPTH_MAX: u8 = 16;

/// A reader of structs; all of its methods return `None` if the data is damaged.
pub struct Compact<R>(R);

impl<R: Read> Compact<R> {
    /// Reads from `source`.
    pub fn new(source: R) -> Self {
        Self(source)
    }

    fn byte(&mut self) -> Option<u8> {
        let mut byte = [0];
        self.0.read_exact(&mut byte).ok()?;
        Some(byte[0])
    }

    /// Reads an unsigned integer.
    pub fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    /// Reads a signed integer.
    pub fn integer(&mut self) -> Option<i64> {
        let value = self.varint()?;
        Some((value >> 1) as i64 ^ -((value & 1) as i64))
    }

    /// Reads binary data or text.
    pub fn binary(&mut self) -> Option<Vec<u8>> {
        let length = self.varint()?;
        if length > BINARY_MAX {
            return None;
        }
        let mut bytes = Vec::new();
        let read = (&mut self.0).take(length).read_to_end(&mut bytes).ok()?;
        (read as u64 == length).then_some(bytes)
    }

    /// Reads text; invalid UTF-8 is replaced.
    pub fn text(&mut self) -> Option<String> {
        self.binary()
            .map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
    }

    /// Reads the number and type of a list's elements.
    fn list(&mut self) -> Option<(u64, u8)> {
        let byte = self.byte()?;
        let count = match byte >> 4 {
            15 => self.varint()?,
            count => count.into(),
        };
        Some((count, byte & 15))
    }

    /// Reads a list of structs; `take` is called for each element and must read it.
    pub fn structs(&mut self, mut take: impl FnMut(&mut Self) -> Option<()>) -> Option<()> {
        let (count, of) = self.list()?;
        if of != STRUCT && count > 0 {
            return None;
        }
        for _ in 0..count {
            take(self)?;
        }
        Some(())
    }

    /// Reads a struct; `take` is called with each field's number and type, and returns whether it has read the
    /// field, which is skipped otherwise.
    pub fn fields(
        &mut self,
        mut take: impl FnMut(&mut Self, i64, u8) -> Option<bool>,
    ) -> Option<()> {
        let mut number = 0_i64;
        loop {
            let byte = self.byte()?;
            if byte & 15 == 0 {
                return Some(());
            }
            number = match byte >> 4 {
                0 => self.integer()?,
                step => number.checked_add(step.into())?,
            };
            if !take(self, number, byte & 15)? {
                self.skip(byte & 15, DEPTH_MAX)?;
            }
        }
    }

    fn skip(&mut self, of: u8, depth: u8) -> Option<()> {
        let depth = depth.checked_sub(1)?;
        match of {
            TRUE | FALSE => {}
            BYTE => drop(self.byte()?),
            I16 | I32 | I64 => drop(self.varint()?),
            DOUBLE => self.skip_bytes(8)?,
            BINARY => {
                let length = self.varint()?;
                self.skip_bytes(length)?;
            }
            LIST | SET => {
                let (count, of) = self.list()?;
                for _ in 0..count {
                    self.skip_element(of, depth)?;
                }
            }
            MAP => {
                let count = self.varint()?;
                let kinds = if count > 0 { self.byte()? } else { 0 };
                for _ in 0..count {
                    self.skip_element(kinds >> 4, depth)?;
                    self.skip_element(kinds & 15, depth)?;
                }
            }
            STRUCT => loop {
                let byte = self.byte()?;
                if byte & 15 == 0 {
                    break;
                }
                if byte >> 4 == 0 {
                    self.integer()?;
                }
                self.skip(byte & 15, depth)?;
            },
            _ => return None,
        }
        Some(())
    }

    /// Skips an element of a collection, in which a bool takes one byte.
    fn skip_element(&mut self, of: u8, depth: u8) -> Option<()> {
        match of {
            TRUE | FALSE => self.byte().map(drop),
            _ => self.skip(of, depth),
        }
    }

    fn skip_bytes(&mut self, count: u64) -> Option<()> {
        let skipped = std::io::copy(&mut (&mut self.0).take(count), &mut std::io::sink());
        (skipped.ok()? == count).then_some(())
    }
}

/// Appends an unsigned integer.
pub fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Appends a signed integer.
pub fn put_integer(out: &mut Vec<u8>, value: i64) {
    put_varint(out, (value << 1 ^ value >> 63) as u64);
}

/// A writer of a struct; fields must be added in the order of their numbers.
#[derive(Default)]
pub struct Struct {
    bytes: Vec<u8>,
    last: u8,
}

impl Struct {
    fn field(mut self, number: u8, of: u8) -> Self {
        // Numbers ascend by less than 16 in every struct that is written.
        self.bytes.push((number - self.last) << 4 | of);
        self.last = number;
        self
    }

    /// Adds a 32-bit integer or the value of an enumeration.
    pub fn i32(self, number: u8, value: i32) -> Self {
        let mut next = self.field(number, I32);
        put_integer(&mut next.bytes, value.into());
        next
    }

    /// Adds a 64-bit integer.
    pub fn i64(self, number: u8, value: i64) -> Self {
        let mut next = self.field(number, I64);
        put_integer(&mut next.bytes, value);
        next
    }

    /// Adds a byte.
    pub fn byte(self, number: u8, value: u8) -> Self {
        let mut next = self.field(number, BYTE);
        next.bytes.push(value);
        next
    }

    /// Adds a bool.
    pub fn bool(self, number: u8, value: bool) -> Self {
        self.field(number, if value { TRUE } else { FALSE })
    }

    /// Adds text or binary data.
    pub fn binary(self, number: u8, value: &[u8]) -> Self {
        let mut next = self.field(number, BINARY);
        put_varint(&mut next.bytes, value.len() as u64);
        next.bytes.extend(value);
        next
    }

    /// Adds a struct.
    pub fn inner(self, number: u8, value: Self) -> Self {
        let mut next = self.field(number, STRUCT);
        next.bytes.extend(value.finish());
        next
    }

    /// Adds a list of encoded elements of one type.
    pub fn list(self, number: u8, of: u8, elements: &[Vec<u8>]) -> Self {
        let mut next = self.field(number, LIST);
        if elements.len() < 15 {
            next.bytes.push((elements.len() as u8) << 4 | of);
        } else {
            next.bytes.push(0xf0 | of);
            put_varint(&mut next.bytes, elements.len() as u64);
        }
        next.bytes.extend(elements.iter().flatten());
        next
    }

    /// Returns the bytes of the struct.
    pub fn finish(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let inner = Struct::default().bool(1, true).bool(2, false).i32(9, -5);
        let element = Struct::default().i64(1, i64::MIN).finish();
        let bytes = Struct::default()
            .i32(1, 7)
            .binary(2, b"text")
            .byte(3, 200)
            .inner(4, inner)
            .list(6, STRUCT, &vec![element; 20])
            .i64(20, 1 << 40)
            .finish();
        let (mut first, mut text, mut elements, mut last) = (0, String::new(), 0, 0);
        let mut read = |bytes: &[u8]| {
            Compact::new(bytes).fields(|thrift, number, _| {
                match number {
                    1 => first = thrift.integer()?,
                    2 => text = thrift.text()?,
                    6 => thrift.structs(|thrift| {
                        elements += 1;
                        thrift.fields(|_, _, _| Some(false))
                    })?,
                    20 => last = thrift.integer()?,
                    _ => return Some(false),
                }
                Some(true)
            })
        };
        assert!(read(&bytes).is_some());
        for end in 0..bytes.len() {
            assert!(read(&bytes[..end]).is_none());
        }
        assert_eq!((first, text.as_str(), last), (7, "text", 1 << 40));
        assert!(elements >= 20);
    }
}
