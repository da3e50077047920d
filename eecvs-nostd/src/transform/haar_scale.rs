//! The scale 2^(j/2) of a Haar coefficient.

/// Returns the scale j of coefficient k = 2^j + m; 0 for k = 0.
#[inline(always)]
#[must_use]
pub const fn scale_of(k: usize) -> u32 {
    if k == 0 { 0 } else { k.ilog2() }
}
