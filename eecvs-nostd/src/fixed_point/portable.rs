//! For targets without Arm's DSP instructions.

#[inline(always)]
pub const fn mul_high(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64) >> 32) as i32
}

#[inline(always)]
pub const fn mul_high_round(a: i32, b: i32) -> i32 {
    ((a as i64 * b as i64 + (1 << 31)) >> 32) as i32
}

#[inline(always)]
pub const fn mul_high_add(sum: i32, a: i32, b: i32) -> i32 {
    sum.wrapping_add(mul_high(a, b))
}

#[inline(always)]
pub const fn mul_add(a: i32, b: i32, c: i32) -> i32 {
    a.wrapping_mul(b).wrapping_add(c)
}

#[inline(always)]
pub const fn dot_add(sum: i32, a: u32, b: u32) -> i32 {
    let upper = (a as i32 >> 16).wrapping_mul(b as i32 >> 16);
    let lower = (a as i16 as i32).wrapping_mul(b as i16 as i32);
    sum.wrapping_add(upper).wrapping_add(lower)
}

#[inline(always)]
pub fn least_halves(a: u32, b: u32) -> u32 {
    (a >> 16).min(b >> 16) << 16 | (a & 0xFFFF).min(b & 0xFFFF)
}

#[inline(always)]
pub fn most_halves(a: u32, b: u32) -> u32 {
    (a >> 16).max(b >> 16) << 16 | (a & 0xFFFF).max(b & 0xFFFF)
}

#[inline(always)]
pub const fn negate_halves(halves: u32, negative: u32) -> u32 {
    let turned = halves ^ negative;
    let upper = (turned >> 16).wrapping_sub(negative >> 16);
    let lower = turned.wrapping_sub(negative);
    (upper << 16) | (lower & 0xffff)
}
