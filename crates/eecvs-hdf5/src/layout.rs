//! Where the fields of an event lie in a row.

#[cfg(feature = "pack")]
use event_types::Sensor;
use event_types::{Event, Polarity};

use crate::Error;

/// Largest size of a row in bytes.
const ROW_BYTES_MAX: u32 = 1 << 10;

/// An unsigned or signed integer of 1, 2, 4 or 8 bytes, little-endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Field {
    offset: usize,
    bytes: usize,
}

impl Field {
    #[cfg(feature = "pack")]
    #[inline]
    fn get(self, row: &[u8]) -> u64 {
        let at = &row[self.offset..];
        match self.bytes {
            1 => u64::from(at[0]),
            2 => u64::from(u16::from_le_bytes([at[0], at[1]])),
            4 => u64::from(u32::from_le_bytes([at[0], at[1], at[2], at[3]])),
            _ => u64::from_le_bytes([at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7]]),
        }
    }

    #[inline]
    fn set(self, row: &mut [u8], value: u64) {
        let at = &mut row[self.offset..];
        let bytes = value.to_le_bytes();
        match self.bytes {
            1 => at[0] = bytes[0],
            2 => at[..2].copy_from_slice(&bytes[..2]),
            4 => at[..4].copy_from_slice(&bytes[..4]),
            _ => at[..8].copy_from_slice(&bytes),
        }
    }

    /// The largest value of the field: -1, where it is signed.
    const fn ones(self) -> u64 {
        u64::MAX >> (64 - 8 * self.bytes)
    }

    const fn end(self) -> usize {
        self.offset + self.bytes
    }
}

/// What the encoder spends on fewer bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Effort {
    /// The quick coder: some 20 to 26 bits an event, at the speed of memory.
    #[default]
    Quick,
    /// Trees of places and times, of effort 1 to 3: 8 to 19 bits an event, at some 5 to 0.5 million events a second.
    Tree(eecvs_nostd::coder::Effort),
}

/// The numbers by which OFF events are stored; ON events are 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Off {
    Zero,
    MinusOne,
}

/// The layout of a dataset's rows, which the filter's values (`cd_values`) state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    row_bytes: usize,
    t: Field,
    x: Field,
    y: Field,
    p: Field,
    /// Offsets of bytes in no field.
    unused: Vec<usize>,
    pub(crate) effort: Effort,
    /// Rows of every chunk, if the values state it.
    chunk_rows: Option<u32>,
}

impl Layout {
    /// Reads a layout from the filter's values: the size of a row, then offset and size of t, x, y and p, all in bytes; an
    /// effort of 0 (the quick coder) to 3, which may be absent; and the number of rows of a chunk, which may be absent or
    /// 0. Where that is stated, chunks of any other number are refused, so that damage cannot give fewer rows, or more
    /// than there is memory for.
    ///
    /// A row has at most 1,024 bytes, a field 1, 2, 4 or 8; fields must not overlap.
    ///
    /// # Errors
    /// [`Error::Layout`].
    pub fn from_values(values: &[u32]) -> Result<Self, Error> {
        use eecvs_nostd::coder::Effort as Tree;

        let (fields, options) = values.split_at_checked(9).ok_or(Error::Layout)?;
        let (effort, chunk_rows) = match *options {
            [] => (0, 0),
            [effort] => (effort, 0),
            [effort, rows] => (effort, rows),
            _ => return Err(Error::Layout),
        };
        let effort = match effort {
            0 => Effort::Quick,
            1 => Effort::Tree(Tree::One),
            2 => Effort::Tree(Tree::Two),
            3 => Effort::Tree(Tree::Three),
            _ => return Err(Error::Layout),
        };
        let row_bytes = fields[0];
        if !(1..=ROW_BYTES_MAX).contains(&row_bytes) {
            return Err(Error::Layout);
        }
        let row_bytes = row_bytes as usize;
        let mut is_used = vec![false; row_bytes];
        let mut field = |offset: u32, bytes: u32| {
            let field = Field {
                offset: offset as usize,
                bytes: bytes as usize,
            };
            if !matches!(bytes, 1 | 2 | 4 | 8) || field.offset >= row_bytes {
                return Err(Error::Layout);
            }
            let used = is_used.get_mut(field.offset..field.end());
            let used = used.ok_or(Error::Layout)?;
            if used.contains(&true) {
                return Err(Error::Layout);
            }
            used.fill(true);
            Ok(field)
        };
        let t = field(fields[1], fields[2])?;
        let x = field(fields[3], fields[4])?;
        let y = field(fields[5], fields[6])?;
        let p = field(fields[7], fields[8])?;
        let unused = (0..row_bytes).filter(|at| !is_used[*at]).collect();
        Ok(Self {
            row_bytes,
            t,
            x,
            y,
            p,
            unused,
            effort,
            chunk_rows: (chunk_rows > 0).then_some(chunk_rows),
        })
    }

    /// Returns the size of a row in bytes.
    #[must_use]
    pub const fn row_bytes(&self) -> usize {
        self.row_bytes
    }

    /// Returns the size of a chunk in bytes, if the values state it.
    #[must_use]
    pub fn chunk_bytes(&self) -> Option<usize> {
        let rows = usize::try_from(self.chunk_rows?).unwrap_or(usize::MAX);
        Some(rows.saturating_mul(self.row_bytes))
    }

    /// Returns the event of a row, if [`Layout::set`] would make the same row of it.
    #[cfg(feature = "pack")]
    #[inline]
    pub(crate) fn event(&self, row: &[u8], off: Off) -> Option<Event> {
        let (t, x, y) = (self.t.get(row), self.x.get(row), self.y.get(row));
        let p = self.p.get(row);
        let is_on = p == 1;
        let side = u64::from(Sensor::SIDE_MAX);
        let is_event = (is_on || p == self.off(off))
            && x < side
            && y < side
            // A negative time of 8 bytes is none.
            && t <= T_MAX
            && self.unused.iter().all(|at| row[*at] == 0);
        is_event.then(|| Event {
            t_us: t,
            x: x as u16,
            y: y as u16,
            polarity: Polarity::from_bool(is_on),
        })
    }

    /// Writes an event to a row of zeros.
    #[inline]
    pub(crate) fn set(&self, row: &mut [u8], event: &Event, off: Off) {
        self.t.set(row, event.t_us);
        self.x.set(row, event.x.into());
        self.y.set(row, event.y.into());
        let p = if event.polarity == Polarity::On {
            1
        } else {
            self.off(off)
        };
        self.p.set(row, p);
    }

    const fn off(&self, off: Off) -> u64 {
        match off {
            Off::Zero => 0,
            Off::MinusOne => self.p.ones(),
        }
    }
}

/// Latest time of an event that goes into frames, in microseconds; beyond it the windows' ends would pass 64 bits.
#[cfg(feature = "pack")]
const T_MAX: u64 = 1 << 62;

#[cfg(all(test, feature = "pack"))]
mod tests {
    use super::*;

    #[test]
    fn values_that_are_no_layout_are_refused() {
        let right = [13, 0, 8, 8, 2, 10, 2, 12, 1, 3];
        assert!(Layout::from_values(&right).is_ok());
        assert!(Layout::from_values(&right[..9]).is_ok());
        for (at, value) in [
            (0, 0),
            (0, 12),
            (0, 1025),
            (1, 1),
            (2, 3),
            (2, 0),
            (3, 7),
            (5, 9),
            (7, 13),
            (7, u32::MAX),
            (8, 2),
            (9, 4),
        ] {
            let mut values = right;
            values[at] = value;
            assert_eq!(
                Layout::from_values(&values),
                Err(Error::Layout),
                "{values:?}"
            );
        }
        for length in [0, 1, 8, 12] {
            assert_eq!(Layout::from_values(&vec![1; length]), Err(Error::Layout));
        }
    }

    #[test]
    fn rows_that_no_event_makes_are_no_events() {
        // Aligned as a C compiler does: x, y, p, two bytes of padding, t.
        let layout = Layout::from_values(&[16, 8, 8, 0, 2, 2, 2, 4, 2]).unwrap();
        let event = Event {
            t_us: 5,
            x: 6,
            y: 7,
            polarity: Polarity::Off,
        };
        let mut row = [0; 16];
        layout.set(&mut row, &event, Off::MinusOne);
        assert_eq!(row, [6, 0, 7, 0, 255, 255, 0, 0, 5, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(layout.event(&row, Off::MinusOne), Some(event));
        assert_eq!(layout.event(&row, Off::Zero), None);
        for (at, value) in [(1, 8), (3, 8), (4, 2), (5, 0), (6, 1), (7, 1), (15, 128)] {
            let mut wrong = row;
            wrong[at] = value;
            assert_eq!(layout.event(&wrong, Off::MinusOne), None, "byte {at}");
        }
    }
}
