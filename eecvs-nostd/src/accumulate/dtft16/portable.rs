//! Sums one number at a time. `armv7em` gives the same bits for a pixel's list.

use super::{GRID, Impulse, Phase, Place, Sum, dot_add, negate_halves, place};

/// Implements [`super::exponentials`]. Out of line, so that the loop has all registers to itself.
#[inline(never)]
pub fn exponentials(
    impulses: impl Iterator<Item = Impulse>,
    half: impl Fn(Impulse) -> Phase,
    sums: &mut [[Sum; 2]; GRID],
) {
    let [_, sums @ ..] = sums;
    sums.fill([Sum::ZERO; 2]);
    for impulse in impulses {
        let at = Place::new(half(impulse));
        let lines = at.lines();
        // The table's numbers are negative, so it is an ON event whose weights are negated.
        let even = negate_halves(at.weights, u32::from(impulse.is_on).wrapping_neg());
        let weights = [even, negate_halves(even, at.late)];
        for (i, sums) in sums.iter_mut().enumerate() {
            let k = i + 1;
            for (i, sum) in sums.iter_mut().enumerate() {
                let line = lines.get(place(k) + i).copied().unwrap_or_default();
                *sum = Sum::from_bits(dot_add(sum.to_bits(), line, weights[k % 2]));
            }
        }
    }
}
