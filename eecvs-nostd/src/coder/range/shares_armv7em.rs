//! Pass over a table of [`Symbols`] that moves its shares, in assembly, four symbols per turn.
#![allow(unsafe_code)]

use core::arch::naked_asm;

use super::shares_portable;
use super::symbols::Symbols;

/// As [`shares_portable::move_shares`], in assembly if the table's length allows it.
#[inline(always)]
pub(super) fn move_shares<const N: usize>(table: &mut Symbols<N>, each: u32, rate: u32) {
    if !Symbols::<N>::IS_MOVED_BY_FOURS {
        return shares_portable::move_shares(table, each, rate);
    }
    let turns = Symbols::<N>::COUNT.div_ceil(4);
    // SAFETY: the starts, the counts and what is left of the block are stored one after the other, so what the last
    // turn reads and writes beyond the last symbol is part of this table, and is set anew below and by the caller.
    // This file is compiled only for cores that have the instructions.
    unsafe {
        let table = (&raw mut *table).cast::<u8>();
        let counts = table.wrapping_add(Symbols::<N>::COUNTS_AT);
        move_by_fours(table.cast(), counts, turns, 2 * each, rate);
    }
    table.end();
}

/// Moves the shares of a table, given by its `starts`, towards its `counts`, and clears these; `turns` turns of
/// four symbols each.
///
/// `each` is twice what one count stands for, and `rate`, below 1, is in units of 2^-15. A share beyond one goes
/// from old to old + floor((count * each / 2 - old) * rate). All values are below 2^17: of the product of twice the
/// difference and the rate, the upper 32 of 48 bits are added.
///
/// # Safety
/// There have to be 4 * turns + 1 starts and 4 * turns counts.
#[unsafe(naked)]
unsafe extern "C" fn move_by_fours(
    starts: *mut u16,
    counts: *mut u8,
    turns: u32,
    each: u32,
    rate: u32,
) {
    naked_asm!(
        // r4: rate; r5 and r6: begin and end of a share; r8: its new begin; r9: 2.
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
