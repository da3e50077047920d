//! The fields of a serialised message, one after the other: ROS 1's packed ones, or CDR's aligned ones.

/// How a message is serialised.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Serialisation {
    /// ROS 1: little-endian, without padding.
    Ros1,
    /// ROS 2: CDR of version 1, either endianness, told by the message's first four bytes.
    Cdr,
}

/// Where CDR counts its alignment from: behind the four bytes of the encapsulation.
const CDR_START: usize = 4;

/// A position in a message and how to read on from there.
#[derive(Debug, Clone, Copy)]
pub struct Cursor {
    /// Position of the next byte in the message.
    pub at: usize,
    aligned: bool,
    big_endian: bool,
}

/// A message and the position in it. Errors tell what is wrong; [`Cursor::at`] tells where.
#[derive(Debug)]
pub struct Fields<'a> {
    bytes: &'a [u8],
    /// Where the next field, or its padding, begins.
    pub cursor: Cursor,
}

impl<'a> Fields<'a> {
    /// Begins a message.
    ///
    /// # Errors
    /// CDR of another kind than version 1's plain one.
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

    /// Goes on with a message at a position of before.
    #[must_use]
    pub fn resume(bytes: &'a [u8], cursor: Cursor) -> Self {
        Self { bytes, cursor }
    }

    /// Bytes of the message that are left.
    #[must_use]
    pub fn left(&self) -> usize {
        self.bytes.len().saturating_sub(self.cursor.at)
    }

    /// The next `n` bytes.
    ///
    /// # Errors
    /// The message ends before.
    pub fn bytes(&mut self, n: usize) -> Result<&'a [u8], String> {
        let rest = self.bytes.get(self.cursor.at..).unwrap_or_default();
        let bytes = rest.get(..n).ok_or_else(|| ends(n - rest.len()))?;
        self.cursor.at += n;
        Ok(bytes)
    }

    /// A number of `N` bytes, in little-endian order.
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

    /// A bool or `uint8`.
    ///
    /// # Errors
    /// The message ends before.
    pub fn u8(&mut self) -> Result<u8, String> {
        self.number().map(u8::from_le_bytes)
    }

    /// A `uint16`.
    ///
    /// # Errors
    /// The message ends before.
    pub fn u16(&mut self) -> Result<u16, String> {
        self.number().map(u16::from_le_bytes)
    }

    /// A `uint32`.
    ///
    /// # Errors
    /// The message ends before.
    pub fn u32(&mut self) -> Result<u32, String> {
        self.number().map(u32::from_le_bytes)
    }

    /// A `uint64`.
    ///
    /// # Errors
    /// The message ends before.
    pub fn u64(&mut self) -> Result<u64, String> {
        self.number().map(u64::from_le_bytes)
    }

    /// A time of seconds and nanoseconds, in nanoseconds. ROS 2's signed seconds before 1970 are refused.
    ///
    /// # Errors
    /// The message ends before, or the time is none.
    pub fn time_ns(&mut self) -> Result<u64, String> {
        let (seconds, nanos) = (self.u32()?, self.u32()?);
        if nanos >= 1_000_000_000 || self.cursor.aligned && seconds > i32::MAX as u32 {
            return Err(format!("a time of {seconds} s and {nanos} ns is damaged"));
        }
        Ok(u64::from(seconds) * 1_000_000_000 + u64::from(nanos))
    }

    /// A `uint8[]` or the bytes of a string.
    ///
    /// # Errors
    /// The message ends before.
    pub fn sequence(&mut self) -> Result<&'a [u8], String> {
        let n = self.u32()?;
        self.bytes(usize::try_from(n).unwrap_or(usize::MAX))
    }

    /// A string, without the zero that CDR closes it with.
    ///
    /// # Errors
    /// The message ends before, or it is not UTF-8.
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
