//! Contexts from the surroundings of a segment and its pixels: which neighbours have events, and of which polarity.
//!
//! Everything is kept in words of 32 columns, one bit each. What a column sees is then the same bit of several
//! words: its own, and neighbouring words shifted by a column.

/// Contexts of a segment's flag: four numbers of pixels, each 0, 1, 2 to 3, or more.
pub(super) const SEGMENT_CONTEXTS: usize = 256;
/// Contexts of a run's flag: log2 of its length, and how many pixels there are to the west and north.
pub(super) const RUN_CONTEXTS: usize = 8 * 4;
/// Contexts of a pixel's flag.
pub(super) const PIXEL_CONTEXTS: usize = 1 << 9;
/// Contexts of a first polarity: five neighbours, each without events, or first OFF, or first ON.
pub(super) const POLARITY_CONTEXTS: usize = 3 * 3 * 3 * 3 * 3;

/// Words around a segment. Arrays of three are those to the west, here and to the east.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Around {
    /// Pixels with events, in this row so far and in the two rows above.
    pub(super) west: u32,
    pub(super) north: [u32; 3],
    pub(super) far_north: u32,
    /// Pixels with events in the window before: here and to the east, and in the row below.
    pub(super) old: [u32; 2],
    pub(super) south: [u32; 3],
    /// Polarities of the last events in the window before.
    pub(super) old_on: u32,
    /// Polarities of first events; arbitrary where there are no events.
    pub(super) west_on: u32,
    pub(super) north_on: [u32; 3],
}

/// Counts the bits set, as 0 to 3: none, 1, 2 to 3, or more.
#[inline(always)]
fn few(word: u32) -> usize {
    // Clears one bit after the other, as most words have none.
    let mut left = word;
    let mut number = 0;
    for few in [1, 2, 2, 3] {
        if left == 0 {
            break;
        }
        left &= left - 1;
        number = few;
    }
    number
}

/// Returns for each column the bit of the column to its west, and of the one to its east.
#[inline(always)]
const fn sides([west, here, east]: [u32; 3]) -> (u32, u32) {
    (here << 1 | west >> 31, here >> 1 | east << 31)
}

impl Around {
    /// Moves to the next segment. `occupied` and `first_on` are what was coded of this one; `east` has the words
    /// that come into view, in the fields where they belong.
    #[inline(always)]
    pub(super) fn go_on(&mut self, (occupied, first_on): (u32, u32), east: &Self) {
        let next = |of: [u32; 3], east: [u32; 3]| [of[1], of[2], east[2]];
        *self = Self {
            west: occupied,
            west_on: first_on,
            north: next(self.north, east.north),
            north_on: next(self.north_on, east.north_on),
            old: [self.old[1], east.old[1]],
            south: next(self.south, east.south),
            ..*east
        };
    }

    #[inline(always)]
    pub(super) fn segment_context(&self) -> usize {
        let [_, north, north_east] = self.north;
        few(self.west) << 6 | few(north) << 4 | few(self.old[0]) << 2 | few(north_east)
    }

    /// Returns what the columns of the segment see.
    #[inline(always)]
    pub(super) fn columns(&self, has_previous: bool) -> Columns {
        let (north_west, north_east) = sides(self.north);
        let north_on = [0, 1, 2].map(|at| self.north_on[at] & self.north[at]);
        let (north_west_on, north_east_on) = sides(north_on);
        let north = self.north[1];
        let mut columns = Columns {
            west: self.west >> 30,
            west_on: (self.west_on & self.west) >> 31,
            north_west,
            north,
            north_east,
            far_north: self.far_north,
            north_west_on,
            north_east_on,
            north_on: north_on[1],
            old: 0,
            old_on: 0,
            later: [0; 2],
            seen: north_west | north | north_east | self.far_north,
            crowd: few(self.west | north),
            has_previous,
        };
        if has_previous {
            let (south_west, south_east) = sides(self.south);
            let (_, east) = sides([0, self.old[0], self.old[1]]);
            let south = self.south[1];
            // Per column, the sum of the four neighbours in two bits, with 4 as 3.
            let (a, b) = (east ^ south_west, south ^ south_east);
            let (c, d) = (east & south_west, south & south_east);
            columns.later = [(a ^ b) | (c & d), c | d | (a & b)];
            columns.old = self.old[0];
            columns.old_on = self.old_on & self.old[0];
            columns.seen |= self.old[0] | columns.later[0] | columns.later[1];
        }
        columns
    }
}

/// What columns see: bit i of each word is what column i sees.
#[derive(Debug, Clone, Copy)]
pub(super) struct Columns {
    /// The two pixels to the west of the segment, and the polarity of the nearer one.
    pub(super) west: u32,
    pub(super) west_on: u32,
    pub(super) north_west: u32,
    pub(super) north: u32,
    pub(super) north_east: u32,
    pub(super) far_north: u32,
    pub(super) north_west_on: u32,
    pub(super) north_east_on: u32,
    pub(super) north_on: u32,
    pub(super) old: u32,
    pub(super) old_on: u32,
    pub(super) later: [u32; 2],
    /// Whether any neighbour except those to the west has events.
    pub(super) seen: u32,
    pub(super) crowd: usize,
    pub(super) has_previous: bool,
}

#[inline(always)]
const fn bit(word: u32, column: u32) -> usize {
    (word >> column) as usize & 1
}

impl Columns {
    /// Returns whether the two columns to the west have events, the nearer as bit 1; `made` are the segment's
    /// pixels so far.
    #[inline(always)]
    fn west(&self, made: u32, column: u32) -> usize {
        ((made << 2 | self.west) >> column) as usize & 3
    }

    /// Returns how many columns from this one on, of the segment's `columns`, have no neighbour with events.
    #[inline(always)]
    pub(super) fn quiet(&self, made: u32, column: u32, columns: u32) -> u32 {
        if self.west(made, column) == 0 {
            let seen = self.seen >> column;
            seen.trailing_zeros().min(columns - column)
        } else {
            0
        }
    }

    /// Returns the context of whether a run of `quiet` (at least 1) columns has events.
    #[inline(always)]
    pub(super) fn run_context(&self, quiet: u32) -> usize {
        (self.crowd << 3 | (31 - quiet.leading_zeros()) as usize) % RUN_CONTEXTS
    }

    #[inline(always)]
    pub(super) fn pixel_context(&self, made: u32, column: u32) -> usize {
        let mut context = self.west(made, column)
            | bit(self.north_west, column) << 2
            | bit(self.north, column) << 3
            | bit(self.north_east, column) << 4
            | bit(self.far_north, column) << 5;
        if self.has_previous {
            context |= bit(self.old, column) << 6
                | bit(self.later[0], column) << 7
                | bit(self.later[1], column) << 8;
        }
        context
    }

    #[inline(always)]
    pub(super) const fn has_north(&self, column: u32) -> bool {
        bit(self.north, column) == 1
    }

    /// Returns whether the column to the west has events.
    #[inline(always)]
    pub(super) fn has_west(&self, made: u32, column: u32) -> bool {
        self.west(made, column) & 2 != 0
    }

    /// Returns the context of a pixel's first polarity.
    #[inline(always)]
    pub(super) fn polarity_context(&self, made: u32, made_on: u32, column: u32) -> usize {
        let west_on = bit(made_on << 1 | self.west_on, column);
        let mut context = (self.west(made, column) >> 1) + west_on;
        // Each neighbour adds 0 without events, 1 if OFF, 2 if ON.
        for (has, on) in [
            (self.north, self.north_on),
            (self.north_west, self.north_west_on),
            (self.north_east, self.north_east_on),
        ] {
            context = 3 * context + bit(has, column) + bit(on, column);
        }
        context *= 3;
        if self.has_previous {
            context += bit(self.old, column) + bit(self.old_on, column);
        }
        context
    }
}
