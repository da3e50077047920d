//! The halves in plain Rust.

/// Widens the bounds of both halves, least and most, by those of `word`.
#[inline(always)]
pub fn widen((least, most): (u32, u32), word: u32) -> (u32, u32) {
    let (low, high) = (word & 0xFFFF, word >> 16);
    (
        (least >> 16).min(high) << 16 | (least & 0xFFFF).min(low),
        (most >> 16).max(high) << 16 | (most & 0xFFFF).max(low),
    )
}

/// Returns the sum of the products of both halves, all below 2^15.
#[inline(always)]
pub fn dot(a: u32, b: u32) -> u32 {
    (a & 0xFFFF)
        .wrapping_mul(b & 0xFFFF)
        .wrapping_add((a >> 16).wrapping_mul(b >> 16))
}

/// Returns `sum` plus the sum of the products of both halves, all below 2^15.
#[inline(always)]
pub fn dot_add(a: u32, b: u32, sum: u32) -> u32 {
    dot(a, b).wrapping_add(sum)
}
