//! Groups of 8 rows, by their number.

/// 8 rows of a column: the first one * 2^16, and a bit for each of them that there is. The last group
/// may have fewer, one beyond the last has none and is 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group(u32);

impl Group {
    /// No group.
    pub const NONE: Self = Self(0);

    /// First row.
    #[inline(always)]
    pub const fn row(self) -> u32 {
        self.0 >> 16
    }

    /// Which of the rows there are.
    #[inline(always)]
    pub const fn inside(self) -> u32 {
        self.0 & 0xFF
    }
}

/// Numbers that a word can hold: 6 bits, and up to 31 above or below.
const NUMBERS: u32 = 128;

/// The groups of a sensor. Numbers below 0 are those from 97 on, where no sensor has any.
#[derive(Debug)]
pub struct Groups([Group; NUMBERS as usize]);

impl Groups {
    /// Groups of as many rows.
    pub fn new(rows: u32) -> Self {
        let mut groups = [Group::NONE; NUMBERS as usize];
        let first_rows = (0..rows.min(64 * 8)).step_by(8);
        for (group, row) in groups.iter_mut().zip(first_rows) {
            let inside = if rows - row >= 8 {
                0xFF
            } else {
                (1 << (rows - row)) - 1
            };
            *group = Group(row << 16 | inside);
        }
        Self(groups)
    }

    /// A group, or [`Group::NONE`].
    #[inline(always)]
    pub fn get(&self, number: u32) -> Group {
        self.0[(number % NUMBERS) as usize]
    }
}
