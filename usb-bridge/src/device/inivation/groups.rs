//! Groups of 8 rows, looked up by their number.

/// The rows of a group: the first row in bits 31..16, and in bits 7..0 one bit for each row that exists. The last
/// group may have fewer than 8 rows; a group beyond the last has none and is 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group(u32);

impl Group {
    /// A group that does not exist.
    pub const NONE: Self = Self(0);

    /// Returns the first row of the group.
    #[inline(always)]
    pub const fn row(self) -> u32 {
        self.0 >> 16
    }

    /// Returns a bit mask of the rows that exist.
    #[inline(always)]
    pub const fn inside(self) -> u32 {
        self.0 & 0xFF
    }
}

/// Number of group numbers that words can yield: 6 bits, plus or minus a distance of up to 31.
const NUMBERS: u32 = 128;

/// The groups of a sensor. Numbers below 0 wrap to 97 and above, where no sensor has groups.
#[derive(Debug)]
pub struct Groups([Group; NUMBERS as usize]);

impl Groups {
    /// Creates the groups of a sensor with `rows` rows.
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

    /// Returns a group, or [`Group::NONE`] if it does not exist.
    #[inline(always)]
    pub fn get(&self, number: u32) -> Group {
        self.0[(number % NUMBERS) as usize]
    }
}
