//! Portable pass over a table of [`Symbols`] that moves its shares.

use super::symbols::Symbols;

/// Moves the shares, less one each, by `rate` / 2^15 of the way towards `each` times the counts, and clears the
/// counts.
#[inline(always)]
pub(super) fn move_shares<const N: usize>(table: &mut Symbols<N>, each: u32, rate: u32) {
    let (each, rate) = (each as i32, rate as i32);
    let (mut begin, mut at) = (0_i32, 0_i32);
    for i in 0..N - 1 {
        let end = i32::from(table.starts[i + 1]);
        let old = end - begin - 1;
        begin = end;
        table.starts[i] = at as u16;
        let target = i32::from(table.counts[i]) * each;
        table.counts[i] = 0;
        // The product is below 2^15 times 2^16. It is rounded down; the last symbol gets what is missing at the
        // end.
        at += 1 + old + (((target - old) * rate) >> 15);
    }
}
