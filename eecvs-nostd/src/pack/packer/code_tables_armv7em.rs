//! Parts of the codes of [`crate::pack::packer`], as [`crate::fused::walk_armv7em`] and
//! [`crate::fused::dtft32_armv7em`] put them together.

use core::mem::offset_of;

use crate::fixed_point::CHUNK_EVENTS;

/// Of n events: two to the bits of n's code, by which the ON events are moved behind it, in the upper
/// half; 32 and the bits of n and of the ON events, less the leading zeros of n - 1, in the lower; and
/// what is to be added where the gap's code ends, besides the ON events.
///
/// The 1s above the gap's code and above n's are taken off there.
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

/// Of levels of b bits: 2^b, and the highest bits of three and of four side by side.
const SIDE_BY_SIDE: [[u32; 4]; SIDE_BITS_MAX] = {
    let mut rows = [[0; 4]; SIDE_BITS_MAX];
    let mut bits = 1;
    while bits <= SIDE_BITS_MAX {
        let half = 1_u32 << (bits - 1);
        let three = half | (half << bits) | (half << (2 * bits));
        // Widest first, so that they are found backwards from what follows them.
        rows[SIDE_BITS_MAX - bits] = [1 << bits, three, three | (half << (3 * bits)), 0];
        bits += 1;
    }
    rows
};
/// Bits of the widest levels of which a word has room for four.
pub const SIDE_BITS_MAX: usize = 8;

/// One after the other, so that one address is enough for both.
#[repr(C)]
pub struct Tables {
    side_by_side: [[u32; 4]; SIDE_BITS_MAX],
    pub counts: Counts,
}

pub static TABLES: Tables = Tables {
    side_by_side: SIDE_BY_SIDE,
    counts: COUNTS,
};

/// [`Counts`].
pub const fn counts() -> &'static Counts {
    &TABLES.counts
}

// What the assembly takes for granted.
const _: () = assert!(offset_of!(Tables, counts) == 16 * SIDE_BITS_MAX);
