//! Groups of 8 rows, by their number.

/// 8 rows of a column.
#[derive(Debug, Clone, Copy)]
pub struct Group {
    /// First row.
    pub row: u16,
    /// Which of the rows there are: the last group may have fewer, one beyond the last has none.
    pub inside: u16,
}

impl Group {
    /// No group.
    pub const NONE: Self = Self { row: 0, inside: 0 };
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
            *group = Group {
                row: row as u16,
                inside,
            };
        }
        Self(groups)
    }

    /// A group, or [`Group::NONE`].
    #[inline(always)]
    pub fn get(&self, number: u32) -> Group {
        self.0[(number % NUMBERS) as usize]
    }
}
