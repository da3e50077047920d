//! The preset code of small slices, which would pay more for the description of their own.
//!
//! Where pixels have an event or two, differences of keys are near their mean: lengths go by the distance of a class
//! from the mean's.

use crate::coder::keys::code::{Code, LONGEST};
use crate::coder::keys::kernels::Span;

/// Classes below the mean's that have a code.
const BELOW: u32 = 24;
/// Classes that have a code.
const CLASSES: usize = 31;

/// Lengths by class and flip, from [`BELOW`] classes below the mean's on.
const LENGTHS: [[u8; CLASSES]; 2] = [
    [
        10, 10, 10, 9, 7, 6, 8, 10, 10, 10, 10, 8, 7, 6, 5, 5, 5, 5, 5, 5, 5, 4, 4, 4, 4, 5, 6, 7,
        9, 10, 10,
    ],
    [
        10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 9, 8, 7, 7, 7, 6, 6, 6, 6, 5, 5, 4, 4, 4, 5, 6,
        8, 8, 10, 10,
    ],
];

/// Any bits begin with one of the codes.
const _: () = {
    let (mut sum, mut i) = (0, 0);
    while i < 2 * CLASSES {
        sum += 1 << LONGEST >> LENGTHS[i % 2][i / 2];
        i += 1;
    }
    assert!(sum == 1 << LONGEST);
};

/// Returns the preset code of a slice of `events`. Its classes may be above the span's highest.
pub fn preset(span: &Span, events: usize) -> Code {
    let mean = span.keys.checked_div(events as u64).unwrap_or(0);
    // At most 54, so that the last class is below 64.
    let class = (u64::BITS - mean.leading_zeros()).max(BELOW);
    let first = 2 * (class - BELOW) as usize;
    let symbols = (0..2 * CLASSES).map(|i| (first + i, LENGTHS[i % 2][i / 2]));
    Code::of(symbols)
}
