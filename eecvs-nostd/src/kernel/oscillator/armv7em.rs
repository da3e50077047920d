//! Seven steps of the recurrence in assembly.
#![allow(unsafe_code)]

use super::Oscillator;

/// Adds seven coefficients in one block of assembly, with the same bits. A compiler orders these instructions so
/// that more values are alive than there are registers, and spends twice as many instructions on moving them.
#[inline(always)]
pub(super) fn add_seven(oscillator: &mut Oscillator, sums: &mut [i32; 7]) {
    let [s1, s2, s3, s4, s5, s6, s7] = sums;
    // SAFETY: reads and writes only registers, all of them operands, and touches neither memory nor flags. This
    // file is built only for cores that have the instructions.
    unsafe {
        core::arch::asm!(
            "smmla {s1}, {now}, {weight}, {s1}",
            "smmulr {next}, {cos}, {now}",
            "rsb {before}, {before}, {next}, lsl #3",
            "smmla {s2}, {before}, {weight}, {s2}",
            "smmulr {next}, {cos}, {before}",
            "rsb {now}, {now}, {next}, lsl #3",
            "smmla {s3}, {now}, {weight}, {s3}",
            "smmulr {next}, {cos}, {now}",
            "rsb {before}, {before}, {next}, lsl #3",
            "smmla {s4}, {before}, {weight}, {s4}",
            "smmulr {next}, {cos}, {before}",
            "rsb {now}, {now}, {next}, lsl #3",
            "smmla {s5}, {now}, {weight}, {s5}",
            "smmulr {next}, {cos}, {now}",
            "rsb {before}, {before}, {next}, lsl #3",
            "smmla {s6}, {before}, {weight}, {s6}",
            "smmulr {next}, {cos}, {before}",
            "rsb {now}, {now}, {next}, lsl #3",
            "smmla {s7}, {now}, {weight}, {s7}",
            "smmulr {next}, {cos}, {now}",
            "rsb {before}, {before}, {next}, lsl #3",
            s1 = inout(reg) *s1, s2 = inout(reg) *s2, s3 = inout(reg) *s3, s4 = inout(reg) *s4,
            s5 = inout(reg) *s5, s6 = inout(reg) *s6, s7 = inout(reg) *s7,
            cos = in(reg) oscillator.cos, weight = in(reg) oscillator.weight,
            before = inout(reg) oscillator.before => oscillator.now,
            now = inout(reg) oscillator.now => oscillator.before,
            next = out(reg) _,
            options(pure, nomem, nostack, preserves_flags),
        );
    }
}
