//! Precomputed parts of the codes of [`crate::pack::packer`], from which [`crate::fused::walk_armv7em`] and
//! [`crate::fused::dtft32_armv7em`] assemble them.

use core::mem::offset_of;

use crate::fixed_point::CHUNK_EVENTS;

/// By n, the number of events. The first word has in its upper half 2 to the power of the bits of n's code, by
/// which the ON events are shifted beyond it; in its lower half 32 plus the bits of n and of the ON events, minus the
/// leading zeros of n - 1. The second word is added where the gap's code ends, besides the ON events.
///
/// The 1s above the gap's code and above n's are subtracted in it.
pub type Counts = [[u32; 2]; CHUNK_EVENTS + 1];
const COUNTS: Counts = {
    let mut counts = [[0; 2]; CHUNK_EVENTS + 1];
    let mut n = 2;
    while n <= CHUNK_EVENTS as u32 {
        let low_bits = n.ilog2();
        let code = (((n << 1) + 1) << low_bits) - (2 << (2 * low_bits)) - 1;
        let bits = 3 * low_bits + 2 + 32 - (n - 1).leading_zeros();
        counts[n as usize] = [(1 << (16 + 2 * low_bits + 1)) | bits, code];
        n += 1;
    }
    counts
};

/// By the bits b of a level: 2^b, and the highest bits of three and of four levels side by side.
const SIDE_BY_SIDE: [[u32; 4]; SIDE_BITS_MAX] = {
    let mut rows = [[0; 4]; SIDE_BITS_MAX];
    let mut bits = 1;
    while bits <= SIDE_BITS_MAX {
        let half = 1_u32 << (bits - 1);
        let three = half | (half << bits) | (half << (2 * bits));
        // Widest first, so that a row is found backwards from what follows the table.
        rows[SIDE_BITS_MAX - bits] = [1 << bits, three, three | (half << (3 * bits)), 0];
        bits += 1;
    }
    rows
};
/// Most bits of levels of which four fit a word.
pub const SIDE_BITS_MAX: usize = 8;

/// Both tables one after the other, so that one address is enough.
#[repr(C)]
pub struct Tables {
    side_by_side: [[u32; 4]; SIDE_BITS_MAX],
    pub counts: Counts,
}

pub static TABLES: Tables = Tables {
    side_by_side: SIDE_BY_SIDE,
    counts: COUNTS,
};

/// Returns the address of the table [`Counts`].
pub const fn counts() -> &'static Counts {
    &TABLES.counts
}

// Assumptions of the assembly.
const _: () = assert!(offset_of!(Tables, counts) == 16 * SIDE_BITS_MAX);
