//! p cos(2 pi x) from a quarter of a wave in Q15, with lines between its rows.
//!
//! A row holds the cosines at its start and at its end, 16 bits each, so that one `smlad` with the
//! weights (1 - d, d), d the distance from the start and the signs in both, adds an atom.

use core::f64::consts::FRAC_PI_2;

use super::{
    Accumulate, Impulse, Kernel, Oscillators, PhaseScale, dct_turn, dtft_turn, multiples, zeroed,
    zeroed_parts,
};
use crate::atom::cos_first_quarter;
use crate::fixed_point::{CHUNK_EVENTS, Phase, Sum, dot_add, negate_halves};
use crate::transform::{Basis, Dct, Dtft, rows};

const ROWS_LOG2: u32 = 9;
/// Rows of a quarter of a turn.
const ROWS: usize = 1 << ROWS_LOG2;
/// Fractional bits of the weights.
const WEIGHT_BITS: u32 = 10;
/// Fractional bits of a weighted cosine: 64 atoms of a chunk stay below 2^31.
const FRACTION_BITS: u32 = 15 + WEIGHT_BITS;
const _: () = assert!(CHUNK_EVENTS << FRACTION_BITS <= 1 << 31);
/// A quarter of a turn.
const QUARTER: Phase = Phase::from_bits(1 << 30);

static LINES: [u32; ROWS] = lines();

/// A table of 2 KB for any K; the DCT's for K up to 8 is that of [`rows`], with all atoms of an
/// event in a row.
///
/// Error of an atom at the most: 2^-15 where 1 is missing from Q15, else 2^-16 of the rounding;
/// 2^-19.7 of the line, 2^-18.3 of its distance, and what k times the phase's error makes
/// ([`crate::phase`]). Measured for K = 1,024, |c_k - c_ref| per event: DCT 2^-15.0, DTFT
/// 2^-14.9; `tests/kernels.rs` enforces 2^-14.
#[derive(Debug, Clone, Copy)]
pub struct Table;

impl Accumulate<Dct> for Table {
    const KERNEL: Kernel = Kernel::Table;
    type Sum = Sum;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        work: &mut Oscillators,
        sums: &mut [Sum],
    ) {
        if grid <= rows::GRID {
            return Dct::accumulate(impulses, scale, grid, work, sums);
        }
        let Some(sums) = zeroed(sums, grid) else {
            return;
        };
        for impulse in impulses.take(CHUNK_EVENTS) {
            add(sums, Phase::ZERO, dct_turn(scale, impulse), impulse.is_on);
        }
        narrow(sums);
    }
}

impl Accumulate<Dtft> for Table {
    const KERNEL: Kernel = Kernel::Table;
    type Sum = Sum;

    #[inline(always)]
    fn accumulate(
        impulses: impl Iterator<Item = Impulse> + Clone,
        scale: PhaseScale,
        grid: usize,
        _: &mut Oscillators,
        sums: &mut [Sum],
    ) {
        let Some((re, im)) = zeroed_parts(sums, grid) else {
            return;
        };
        for impulse in impulses.take(CHUNK_EVENTS) {
            let turn = dtft_turn(scale, impulse);
            add(re, Phase::ZERO, turn, impulse.is_on);
            // sin(x) = cos(x - 1/4)
            add(im, QUARTER, turn, impulse.is_on);
        }
        narrow(re);
        narrow(im);
    }
}

/// Adds an event's atoms with [`FRACTION_BITS`], `behind` their phase.
#[inline(always)]
fn add(sums: &mut [Sum], behind: Phase, turn: Phase, is_on: bool) {
    let off = u32::from(is_on).wrapping_sub(1);
    for (sum, phase) in sums.iter_mut().zip(multiples(turn)) {
        let (line, weights) = atom(phase.wrapping_sub(behind), off);
        *sum = Sum::from_bits(dot_add(sum.to_bits(), line, weights));
    }
}

/// The two cosines around a phase and their weights, negative where `off` is all ones.
#[inline(always)]
fn atom(phase: Phase, off: u32) -> (u32, u32) {
    let phase = phase.to_bits();
    // cos(-x) = cos(x), and a complement is 2^-32 of a turn from the negative.
    let half = phase ^ (phase as i32 >> 31) as u32;
    // cos(1/2 - x) = -cos(x): all ones in the second quarter.
    let negative = ((half << 1) as i32 >> 31) as u32;
    let quarter = half ^ negative;
    let row = (quarter >> (30 - ROWS_LOG2)) as usize % ROWS;
    let distance = (quarter >> (30 - ROWS_LOG2 - WEIGHT_BITS)) % (1 << WEIGHT_BITS);
    let weights = (((1 << WEIGHT_BITS) - distance) << 16) | distance;
    (LINES[row], negate_halves(weights, negative ^ off))
}

/// From [`FRACTION_BITS`] to those of a sum; rounds down.
#[inline(always)]
fn narrow(sums: &mut [Sum]) {
    for sum in sums {
        *sum = Sum::from_bits(sum.to_bits() >> (FRACTION_BITS - 23));
    }
}

/// The table in constant evaluation: the same bits on every machine.
const fn lines() -> [u32; ROWS] {
    let mut lines = [0; ROWS];
    let mut row = 0;
    while row < ROWS {
        lines[row] = (cos_of_row(row) << 16) | cos_of_row(row + 1);
        row += 1;
    }
    lines
}

/// cos(pi / 2 row / ROWS) in Q15, whose largest is 2^-15 below 1: |c_k| < n is what lets the levels
/// of n events do without a bit for n itself.
const fn cos_of_row(row: usize) -> u32 {
    let cos = cos_first_quarter(row as f64 * (FRAC_PI_2 / ROWS as f64));
    let bits = (cos * (1 << 15) as f64 + 0.5) as u32;
    if bits > 0x7fff { 0x7fff } else { bits }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_is_pinned() {
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
        let mut digest = crc.digest();
        for line in &LINES {
            digest.update(&line.to_le_bytes());
        }
        assert_eq!(digest.finalize(), 739_645_786, "the table's checksum");
    }

    #[test]
    fn atoms_are_within_the_bound() {
        let (mut worst, mut largest) = (0.0_f64, 0);
        // Both ends of every distance, in all quarters.
        let unit = 1 << (30 - ROWS_LOG2 - WEIGHT_BITS);
        for at in 0..1_u32 << (ROWS_LOG2 + WEIGHT_BITS + 2) {
            for within in [0, unit - 1] {
                let phase = at * unit + within;
                let (line, weights) = atom(Phase::from_bits(phase), 0);
                let bits = dot_add(0, line, weights);
                let (line, weights) = atom(Phase::from_bits(phase), u32::MAX);
                assert_eq!(dot_add(0, line, weights), -bits);
                largest = largest.max(bits.abs());
                let turn = f64::from(phase) / 4_294_967_296.0;
                let exact = ::libm::cos(turn * core::f64::consts::TAU);
                let found = f64::from(bits) / f64::from(1 << FRACTION_BITS);
                worst = worst.max((found - exact).abs());
            }
        }
        assert!(worst <= ::libm::exp2(-14.7), "2^{}", ::libm::log2(worst));
        assert!(largest < 1 << FRACTION_BITS);
    }
}
