//! Sums one atom at a time.

use super::{Sum, Turn, dot_add, pair, weights};

#[inline(always)]
pub fn cosines(turns: impl Iterator<Item = Turn>, sums: &mut [Sum]) {
    let sums = sums.get_mut(1..).unwrap_or_default();
    sums.fill(Sum::ZERO);
    for Turn { start, step } in turns {
        let mut phase = start;
        for sum in &mut *sums {
            phase = phase.wrapping_add(step);
            let (line, _) = pair(phase);
            *sum = Sum::from_bits(dot_add(sum.to_bits(), line, weights(phase)));
        }
    }
}

#[inline(always)]
pub fn exponentials(turns: impl Iterator<Item = Turn>, sums: &mut [[Sum; 2]]) {
    let sums = sums.get_mut(1..).unwrap_or_default();
    sums.fill([Sum::ZERO; 2]);
    for Turn { start, step } in turns {
        let mut phase = start;
        for [re, im] in &mut *sums {
            phase = phase.wrapping_add(step);
            let lines = pair(phase);
            *re = Sum::from_bits(dot_add(re.to_bits(), lines.0, weights(phase)));
            *im = Sum::from_bits(dot_add(im.to_bits(), lines.1, weights(phase)));
        }
    }
}
