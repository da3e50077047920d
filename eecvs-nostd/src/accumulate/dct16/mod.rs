//! Sums p cos(pi k u) for k = 1..15 by linear interpolation in a table: the DCT on grids of 9 to 16.
//!
//! Works like [`dct8`](super::dct8), with rows twice as fine for the higher k. A row holds a line for each k, and
//! one `smlad` with the weights (p, p d), where d is the distance from the row, adds an atom. The lines of odd k
//! come first, so that each half of a row has weights of one sign: u and 1 - u share a row, with the opposite sign
//! for odd k.
//!
//! The error of an atom is largest for k = 15. It has three parts: from the line, 3.3e-5 where the cosine is
//! largest and, as no atom may reach 1, 4.5e-5 in the rows around its peaks; 2^-16 from rounding the line's two
//! ends; and 2^-11 rows, or 1.1e-5, from rounding the distance, which is largest where the line's part is not. The
//! sum of all maxima is 6.0e-5 = 2^-14.0. `atoms_are_within_the_bound` tests every row and distance, finds
//! 2^-14.21, and enforces 2^-14.2, and that no atom reaches 1.

#[cfg_attr(target_feature = "sse2", allow(dead_code))]
mod portable;

#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
#[allow(unsafe_code)]
mod sse2;

use core::f64::consts::FRAC_PI_2;

use crate::accumulate::cosine::{cos_first_quarter, round};
use crate::accumulate::dct8::{Weights, weigh};
use crate::fixed_point::{FRACTION_BITS, Phase};
use crate::group::impulse::Impulse;

/// Largest K that this table serves.
pub const GRID: usize = 16;
/// Number of coefficients, c_0 not included.
const ATOMS: usize = GRID - 1;
/// Places in a row for the lines of odd k, and for those of even k, of which the last is unused.
const HALF: usize = GRID / 2;
/// Number of rows, from u = 0 to u = 1/2.
const ROWS: usize = 1 << ROWS_LOG2;
pub(crate) const ROWS_LOG2: u32 = 10;
/// Weight of the cosine: the value below 2^10 + 2^7 with the smallest error.
pub(crate) const ONE: i32 = 1026;
/// Number of bits of the distance from a row; its weight is 1 for a whole row.
const DISTANCE_BITS: u32 = super::dct8::DISTANCE_BITS;
/// Lowest bit of the row within 30 bits of u / 2; the distance lies below it.
#[allow(dead_code, reason = "assembly alone asks")]
pub(crate) const ROW_AT: u32 = 30 - ROWS_LOG2;
#[allow(dead_code, reason = "assembly alone asks")]
pub(crate) const DISTANCE_AT: u32 = ROW_AT - DISTANCE_BITS;
/// Largest atom. The levels of n events need no extra bit for n itself, because |c_k| < n.
const ATOM_MAX: i32 = (1 << FRACTION_BITS) - 1;

/// -cos in units of [`ONE`] in the upper half; the slope per row, with 15 fractional bits, in the lower half.
type Line = u32;
/// Lines of k = 1, 3, .. 15, then 2, 4, .. 14, then an unused one.
type Row = [Line; GRID];

pub(crate) static LINES: [Row; ROWS] = table();

#[cfg(not(all(target_arch = "x86_64", target_feature = "sse2")))]
use portable::Sums;
#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
use sse2::Sums;

/// Returns sum p cos(pi k u) for k = 1..16 over the impulses, at most a chunk of them, in the units of a
/// [`Sum`](crate::fixed_point::Sum). `half` maps an impulse to u / 2.
///
/// Out of line, so that the loop has all registers to itself.
#[inline(never)]
pub fn cosines(
    impulses: impl Iterator<Item = Impulse>,
    half: impl Fn(Impulse) -> Phase,
) -> [i32; ATOMS] {
    let mut sums = Sums::zero();
    for impulse in impulses {
        let (row, weights) = weigh::<ROWS_LOG2, ONE>(half(impulse), impulse.is_on);
        sums.add(&LINES[row % ROWS], weights);
    }
    sums.into_array()
}

/// Builds the table in constant evaluation, which gives the same bits on every machine.
const fn table() -> [Row; ROWS] {
    // The cosines of the first quarter turn.
    let mut cos = [0.0; ROWS + 1];
    let mut row = 0;
    while row <= ROWS {
        cos[row] = cos_first_quarter(row as f64 * (FRAC_PI_2 / ROWS as f64));
        row += 1;
    }
    let mut lines = [[0; GRID]; ROWS];
    let mut row = 0;
    while row < ROWS {
        let mut k = 1;
        while k <= ATOMS {
            let place = if k % 2 == 1 { k / 2 } else { HALF + k / 2 - 1 };
            lines[row][place] = line(k, cos_at(&cos, k * row), cos_at(&cos, k * (row + 1)));
            k += 1;
        }
        row += 1;
    }
    lines
}

/// Returns cos(pi / 2 `at` / [`ROWS`]) from the cosines of the first quarter turn.
const fn cos_at(cos: &[f64; ROWS + 1], at: usize) -> f64 {
    let within = at % ROWS;
    match at / ROWS % 4 {
        0 => cos[within],
        1 => -cos[ROWS - within],
        2 => -cos[within],
        _ => cos[ROWS - within],
    }
}

/// Returns the line for k from a row, where the cosine is `from`, to the next, where it is `to`.
///
/// It is the chord, moved at both ends by half of its distance from the curve. If that passes 1 at one end, that
/// end is clamped and the other is moved further, so that the errors there and in the middle are equal.
const fn line(k: usize, from: f64, to: f64) -> Line {
    let step = k as f64 * (FRAC_PI_2 / ROWS as f64);
    // Distance of the chord from the curve, towards 0.
    let depth = (from + to) / 2.0 * (step * step / 8.0);
    // A distance stands for the middle of its last bit.
    let half_bit = (to - from) / (2 << DISTANCE_BITS) as f64;
    let scale = (1_u32 << FRACTION_BITS) as f64;
    let most = ATOM_MAX as f64 / scale;
    let (chord_from, chord_to) = (from + half_bit, to + half_bit);
    let (mut from, mut to) = (chord_from + depth / 2.0, chord_to + depth / 2.0);
    if is_beyond(from, most) {
        from = cut(from, most);
        to = cut(chord_to + (depth - (from - chord_from) / 2.0) / 1.5, most);
    } else if is_beyond(to, most) {
        to = cut(to, most);
        from = cut(chord_from + (depth - (to - chord_to) / 2.0) / 1.5, most);
    }
    let mut cos = round(from * scale / ONE as f64);
    while cos * ONE > ATOM_MAX {
        cos -= 1;
    }
    while cos * ONE < -ATOM_MAX {
        cos += 1;
    }
    // The slope ends where the curve does, whatever rounding did to the cosine.
    let from = cos * ONE;
    let last = (1 << DISTANCE_BITS) - 1;
    let mut slope = round((to * scale - from as f64) / (1 << DISTANCE_BITS) as f64);
    while from + slope * last > ATOM_MAX {
        slope -= 1;
    }
    while from + slope * last < -ATOM_MAX {
        slope += 1;
    }
    ((-cos as u32) << 16) | (-slope as u32 & 0xffff)
}

const fn is_beyond(x: f64, most: f64) -> bool {
    x > most || x < -most
}

const fn cut(x: f64, most: f64) -> f64 {
    if x > most {
        most
    } else if x < -most {
        -most
    } else {
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_is_pinned() {
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
        let mut digest = crc.digest();
        for line in LINES.as_flattened() {
            digest.update(&line.to_le_bytes());
        }
        assert_eq!(digest.finalize(), 106_757_652, "the table's checksum");
        assert!(LINES.iter().all(|row| row[GRID - 1] == 0));
    }

    #[test]
    fn atoms_are_within_the_bound() {
        let (mut worst, mut largest) = ([0.0_f64; ATOMS], 0);
        let bits = ROWS_LOG2 + DISTANCE_BITS;
        // Both ends of every distance, in both halves of the window.
        let unit = 1_u32 << (30 - bits);
        for at in 0..2_u32 << bits {
            let atoms = [true, false].map(|is_on| {
                let phase = Phase::from_bits(at * unit);
                let (row, weights) = weigh::<ROWS_LOG2, ONE>(phase, is_on);
                let (mut atoms, mut same) = (portable::Sums::zero(), Sums::zero());
                atoms.add(&LINES[row], weights);
                same.add(&LINES[row], weights);
                assert_eq!(atoms.into_array(), same.into_array());
                atoms.into_array()
            });
            let [atoms, negative] = atoms;
            assert!(
                atoms
                    .iter()
                    .zip(negative)
                    .all(|(atom, other)| *atom == -other)
            );
            for within in [0, unit - 1] {
                let half = at * unit + within;
                let u = f64::from(half) / f64::from(1 << 31);
                // cos(pi k u) from those of k - 1 and k - 2: exact to 1e-14.
                let first = libm::cos(core::f64::consts::PI * u);
                let (mut before, mut exact) = (1.0, first);
                for (atom, worst) in atoms.into_iter().zip(&mut worst) {
                    largest = largest.max(atom.abs());
                    let error = f64::from(atom) / f64::from(1 << FRACTION_BITS) - exact;
                    *worst = worst.max(error.abs());
                    (before, exact) = (exact, 2.0 * first * exact - before);
                }
            }
        }
        let worst = worst.map(libm::log2);
        assert!(worst.iter().all(|worst| *worst <= -14.2), "{worst:?}");
        assert!(largest < 1 << FRACTION_BITS);
    }
}
