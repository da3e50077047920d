//! One instruction for each function. A compiler finds them too, but if it knows a sign or a constant it uses three
//! other instructions instead.

use core::arch::asm;

#[inline(always)]
pub fn mul_high(a: i32, b: i32) -> i32 {
    let product;
    // SAFETY: reads two registers, writes a third, and touches neither memory nor flags. This file is built only
    // for cores that have the instruction.
    unsafe {
        asm!("smmul {}, {}, {}", lateout(reg) product, in(reg) a, in(reg) b,
            options(pure, nomem, nostack, preserves_flags));
    }
    product
}

#[inline(always)]
pub fn mul_high_round(a: i32, b: i32) -> i32 {
    let product;
    // SAFETY: as for `mul_high`.
    unsafe {
        asm!("smmulr {}, {}, {}", lateout(reg) product, in(reg) a, in(reg) b,
            options(pure, nomem, nostack, preserves_flags));
    }
    product
}

#[inline(always)]
pub fn mul_high_add(sum: i32, a: i32, b: i32) -> i32 {
    let total;
    // SAFETY: as for `mul_high`.
    unsafe {
        asm!("smmla {0}, {2}, {3}, {1}", lateout(reg) total, in(reg) sum, in(reg) a, in(reg) b,
            options(pure, nomem, nostack, preserves_flags));
    }
    total
}

#[inline(always)]
pub fn mul_add(a: i32, b: i32, c: i32) -> i32 {
    let sum;
    // SAFETY: as for `mul_high`.
    unsafe {
        asm!("mla {0}, {1}, {2}, {3}", lateout(reg) sum, in(reg) a, in(reg) b, in(reg) c,
            options(pure, nomem, nostack, preserves_flags));
    }
    sum
}

#[inline(always)]
pub fn dot_add(sum: i32, a: u32, b: u32) -> i32 {
    let total;
    // SAFETY: as for `mul_high`; an overflow would set the Q flag, which nobody reads.
    unsafe {
        asm!("smlad {0}, {2}, {3}, {1}", lateout(reg) total, in(reg) sum, in(reg) a, in(reg) b,
            options(pure, nomem, nostack));
    }
    total
}

#[inline(always)]
pub fn least_halves(a: u32, b: u32) -> u32 {
    let least;
    // SAFETY: as for `mul_high`, except that it changes the GE flags, which are not declared as preserved.
    unsafe {
        asm!("usub16 {0}, {1}, {2}", "sel {0}, {2}, {1}", out(reg) least, in(reg) a, in(reg) b,
            options(pure, nomem, nostack));
    }
    least
}

#[inline(always)]
pub fn most_halves(a: u32, b: u32) -> u32 {
    let most;
    // SAFETY: as for `least_halves`.
    unsafe {
        asm!("usub16 {0}, {1}, {2}", "sel {0}, {1}, {2}", out(reg) most, in(reg) a, in(reg) b,
            options(pure, nomem, nostack));
    }
    most
}

#[inline(always)]
pub fn negate_halves(halves: u32, negative: u32) -> u32 {
    let negated;
    // SAFETY: as for `mul_high`, except that it changes the GE flags, which are not declared as preserved.
    unsafe {
        asm!("ssub16 {0}, {1}, {2}", lateout(reg) negated, in(reg) halves ^ negative,
            in(reg) negative, options(pure, nomem, nostack));
    }
    negated
}
