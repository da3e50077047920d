//! The pass over a table of [`Symbols`] in assembly, four symbols a turn.
#![allow(unsafe_code)]

use core::arch::naked_asm;

use super::shares_portable;
use super::symbols::Symbols;

/// As [`shares_portable::move_shares`], in assembly where the table's length lets it.
#[inline(always)]
pub(super) fn move_shares<const N: usize>(table: &mut Symbols<N>, each: u32, rate: u32) {
    if !Symbols::<N>::IS_MOVED_BY_FOURS {
        return shares_portable::move_shares(table, each, rate);
    }
    let turns = Symbols::<N>::COUNT.div_ceil(4);
    // SAFETY: the starts, counts and what is left of the block are behind each other, so that what the
    // last turn reads and writes beyond the last symbol is of this table, and is set anew below and by
    // the caller. This file is only for cores that have the instructions.
    unsafe {
        let table = (&raw mut *table).cast::<u8>();
        let counts = table.wrapping_add(Symbols::<N>::COUNTS_AT);
        move_by_fours(table.cast(), counts, turns, 2 * each, rate);
    }
    table.end();
}

/// Moves the frequencies of a table's `starts` towards its `counts`, which become 0; `turns` of four symbols.
///
/// With `each` what one of a count stands for, twice, and a rate in units of 2^-15 below 1, a share beyond
/// one each goes from old to old + floor((count * each / 2 - old) * rate). All is below 2^17: the product of
/// twice the difference and the rate has its upper 32 of 48 bits added.
///
/// # Safety
/// There are 4 * turns + 1 starts, and as many counts as 4 * turns.
#[unsafe(naked)]
unsafe extern "C" fn move_by_fours(
    starts: *mut u16,
    counts: *mut u8,
    turns: u32,
    each: u32,
    rate: u32,
) {
    naked_asm!(
        // r4: rate; r5 and r6: begin and end of a share; r8: where its next begins; r9: 2.
        "push {{r4-r10, lr}}",
        "ldr r4, [sp, #32]",
        "movs r5, #0",
        "mov r8, #0",
        "mov r9, #2",
        "1:",
        "ldr r7, [r1]",
        "movs r6, #0",
        "str r6, [r1], #4",
        ".macro eecvs_share byte, begin, end",
        "ldrh \\end, [r0, #2 * \\byte + 2]",
        "strh r8, [r0, #2 * \\byte]",
        "uxtb r12, r7, ror #8 * \\byte",
        "sub lr, \\end, \\begin",
        "mla r12, r12, r3, r9",
        "add r8, r8, lr",
        "sub r12, r12, lr, lsl #1",
        "smlawb r8, r12, r4, r8",
        ".endm",
        "eecvs_share 0, r5, r6",
        "eecvs_share 1, r6, r5",
        "eecvs_share 2, r5, r6",
        "eecvs_share 3, r6, r5",
        ".purgem eecvs_share",
        "adds r0, #8",
        "subs r2, #1",
        "bne 1b",
        "pop {{r4-r10, pc}}",
    )
}
