//! Reads the fields of a serialised message one after another, in ROS 1's packed form or CDR's aligned one.

/// The serialisation of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Serialisation {
    /// ROS 1: little-endian, without padding.
    Ros1,
    /// ROS 2: CDR version 1, of either endianness, which the message's first four bytes state.
    Cdr,
}

/// Position from which CDR counts its alignment: after the four bytes of the encapsulation.
const CDR_START: usize = 4;

/// A position in a message, and how to read from there.
#[derive(Debug, Clone, Copy)]
pub struct Cursor {
    /// Position of the next byte in the message.
    pub at: usize,
    aligned: bool,
    big_endian: bool,
}

/// A message and the position in it. Errors describe what is wrong; [`Cursor::at`] is where.
#[derive(Debug)]
pub struct Fields<'a> {
    bytes: &'a [u8],
    /// Position of the next field, or of its padding.
    pub cursor: Cursor,
}

impl<'a> Fields<'a> {
    /// Begins a message.
    ///
    /// # Errors
    /// The message is CDR of another kind than plain version 1, or too short.
    pub fn new(bytes: &'a [u8], serialisation: Serialisation) -> Result<Self, String> {
        let (at, aligned, big_endian) = match (serialisation, bytes) {
            (Serialisation::Ros1, _) => (0, false, false),
            (Serialisation::Cdr, [0, kind @ (0 | 1), _, _, ..]) => (CDR_START, true, *kind == 0),
            (Serialisation::Cdr, [high, low, _, _, ..]) => {
                return Err(format!(
                    "representation {high:#04x} {low:#04x} is not CDR (0x00 0x00 or 0x00 0x01): \
                     record with a ROS 2 middleware's default"
                ));
            }
            (Serialisation::Cdr, _) => return Err(ends(CDR_START)),
        };
        let cursor = Cursor {
            at,
            aligned,
            big_endian,
        };
        Ok(Self { bytes, cursor })
    }

    /// Continues with a message at a position reached earlier.
    #[must_use]
    pub fn resume(bytes: &'a [u8], cursor: Cursor) -> Self {
        Self { bytes, cursor }
    }

    /// Returns the number of bytes of the message that are left.
    #[must_use]
    pub fn left(&self) -> usize {
        self.bytes.len().saturating_sub(self.cursor.at)
    }

    /// Reads the next `n` bytes.
    ///
    /// # Errors
    /// The message ends before them.
    pub fn bytes(&mut self, n: usize) -> Result<&'a [u8], String> {
        let rest = self.bytes.get(self.cursor.at..).unwrap_or_default();
        let bytes = rest.get(..n).ok_or_else(|| ends(n - rest.len()))?;
        self.cursor.at += n;
        Ok(bytes)
    }

    /// Reads a number of `N` bytes; returns them in little-endian order.
    fn number<const N: usize>(&mut self) -> Result<[u8; N], String> {
        if self.cursor.aligned {
            let over = self.cursor.at.saturating_sub(CDR_START) % N;
            self.bytes(if over == 0 { 0 } else { N - over })?;
        }
        let mut number = [0; N];
        number.copy_from_slice(self.bytes(N)?);
        if self.cursor.big_endian {
            number.reverse();
        }
        Ok(number)
    }

    /// Reads a bool or `uint8`.
    ///
    /// # Errors
    /// The message ends before it.
    pub fn u8(&mut self) -> Result<u8, String> {
        self.number().map(u8::from_le_bytes)
    }

    /// Reads a `uint16`.
    ///
    /// # Errors
    /// The message ends before it.
    pub fn u16(&mut self) -> Result<u16, String> {
        self.number().map(u16::from_le_bytes)
    }

    /// Reads a `uint32`.
    ///
    /// # Errors
    /// The message ends before it.
    pub fn u32(&mut self) -> Result<u32, String> {
        self.number().map(u32::from_le_bytes)
    }

    /// Reads a `uint64`.
    ///
    /// # Errors
    /// The message ends before it.
    pub fn u64(&mut self) -> Result<u64, String> {
        self.number().map(u64::from_le_bytes)
    }

    /// Reads a time in seconds and nanoseconds; returns it in nanoseconds.
    ///
    /// # Errors
    /// The message ends before it; it has 10^9 nanoseconds or more; its seconds, signed in ROS 2, are before 1970.
    pub fn time_ns(&mut self) -> Result<u64, String> {
        let (seconds, nanos) = (self.u32()?, self.u32()?);
        if nanos >= 1_000_000_000 || self.cursor.aligned && seconds > i32::MAX as u32 {
            return Err(format!("a time of {seconds} s and {nanos} ns is damaged"));
        }
        Ok(u64::from(seconds) * 1_000_000_000 + u64::from(nanos))
    }

    /// Reads a `uint8[]` or the bytes of a string.
    ///
    /// # Errors
    /// The message ends before it.
    pub fn sequence(&mut self) -> Result<&'a [u8], String> {
        let n = self.u32()?;
        self.bytes(usize::try_from(n).unwrap_or(usize::MAX))
    }

    /// Reads a string, without the zero at its end in CDR.
    ///
    /// # Errors
    /// The message ends before it, or it is not UTF-8.
    pub fn string(&mut self) -> Result<&'a str, String> {
        let bytes = self.sequence()?;
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(bytes).map_err(|_| "a string is not UTF-8: it is damaged".to_owned())
    }
}

fn ends(missing: usize) -> String {
    format!("the message ends {missing} bytes early: it is damaged")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cdr_aligns_behind_its_four_bytes_in_both_orders() {
        let little = [0, 1, 0, 0, 7, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0];
        let mut fields = Fields::new(&little, Serialisation::Cdr).unwrap();
        assert_eq!((fields.u8(), fields.u32()), (Ok(7), Ok(1)));
        assert_eq!((fields.u64(), fields.left()), (Ok(3 << 32 | 2), 0));
        let big = [0, 0, 0, 0, 7, 0, 1, 2, 0, 0, 0, 3, b'a', b'b', 0, 9];
        let mut fields = Fields::new(&big, Serialisation::Cdr).unwrap();
        assert_eq!((fields.u8(), fields.u16()), (Ok(7), Ok(0x102)));
        assert_eq!((fields.string(), fields.left()), (Ok("ab"), 1));
        assert!(fields.u16().is_err());
        assert!(Fields::new(&[0, 6, 0, 0], Serialisation::Cdr).is_err());
    }

    #[test]
    fn ros1_is_packed() {
        let bytes = [7, 1, 0, 0, 0, 2, 0, 0, 0, b'a', b'b'];
        let mut fields = Fields::new(&bytes, Serialisation::Ros1).unwrap();
        assert_eq!((fields.u8(), fields.u32()), (Ok(7), Ok(1)));
        assert_eq!(fields.string(), Ok("ab"));
        assert_eq!(fields.left(), 0);
    }
}
