//! Sums p cos(pi k u) for k = 1..7 by linear interpolation in a table: the DCT on grids of up to 8.
//!
//! A row of the table holds, for each k, a line from its u to that of the next row: cosine and slope, 16 bits each.
//! One `smlad` with the weights (p, p d), where d is the distance from the row, adds an atom. The rows span half of
//! the window; u and 1 - u share a row, with the opposite sign for odd k.
//!
//! The error of an atom is largest for k = 7: 2.9e-5 from the line (half of the curve's sagitta, as the line runs
//! midway through it), 2^-16 from rounding the line's two ends, and 2^-11 rows, or 1.0e-5, from rounding the
//! distance. Together this is 5.5e-5 = 2^-14.15. `atoms_are_within_the_bound` tests every row and distance and
//! enforces 2^-14.2, and that no atom reaches 1. Grids of up to 16 use rows twice as fine, in a table four times
//! the size ([`super::dct16`]).

#[cfg_attr(target_feature = "sse2", allow(dead_code))]
mod portable;

#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
#[allow(unsafe_code)]
mod sse2;

#[cfg(eecvs_dsp)]
pub(crate) mod armv7em;

use core::f64::consts::FRAC_PI_2;

use crate::accumulate::cosine::{cos_of_row, round};
#[cfg(eecvs_dsp)]
use crate::fixed_point::Sum;
use crate::fixed_point::{FRACTION_BITS, Phase, dot_add, negate_halves};
use crate::group::Impulses;
use crate::group::impulse::Impulse;
use crate::transform::phase::PhaseScale;

/// Largest K that this table serves.
pub const GRID: usize = 8;
/// Number of coefficients, c_0 not included.
const ATOMS: usize = GRID - 1;
/// Number of rows, from u = 0 to u = 1/2.
const ROWS: usize = 1 << ROWS_LOG2;
pub(crate) const ROWS_LOG2: u32 = 9;

/// -cos in units of [`ONE`] in the upper half; the slope per row, with 15 fractional bits, in the lower half.
type Line = u32;

/// The table.
///
/// A row has one more place than lines, so that its address takes one shift and one addition.
pub(crate) type Lines = [[Line; GRID]; ROWS];

pub(crate) static LINES: Lines = table();

/// Number of bits of the distance from a row; its weight is 1 for a whole row.
pub(crate) const DISTANCE_BITS: u32 = FRACTION_BITS - 15;
/// Lowest bit of the row within 30 bits of u / 2; the distance lies below it.
#[allow(dead_code, reason = "assembly alone asks")]
pub(crate) const ROW_AT: u32 = 30 - ROWS_LOG2;
/// Lowest bit of the distance.
#[allow(dead_code, reason = "assembly alone asks")]
pub(crate) const DISTANCE_AT: u32 = ROW_AT - DISTANCE_BITS;
/// Weight of the cosine. Not 2^10: its multiples are up to 2^-15 away from the largest atom.
pub(crate) const ONE: i32 = 1056;
/// Largest atom. The levels of n events need no extra bit for n itself, because |c_k| < n.
const ATOM_MAX: i32 = (1 << FRACTION_BITS) - 1;

/// Weights of the lines for one event.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Weights {
    /// (p, p d) for even k.
    pub even: u32,
    /// (p, p d) for odd k.
    pub odd: u32,
}

/// Returns the row of an event and the weights of its lines. `half` is u / 2 in turns; the table has 2^`ROWS_LOG2`
/// rows and holds -cos in units of `ONE`.
#[inline(always)]
pub(crate) fn weigh<const ROWS_LOG2: u32, const ONE: i32>(
    half: Phase,
    is_on: bool,
) -> (usize, Weights) {
    let half = half.to_bits();
    // All ones in the second half of the window, which is mirrored onto the first: 30 bits remain.
    let turned = ((half << 1) as i32 >> 31) as u32;
    let from_edge = half ^ turned;
    let row = (from_edge >> (30 - ROWS_LOG2)) as usize % (1 << ROWS_LOG2);
    let distance = (from_edge >> (30 - ROWS_LOG2 - DISTANCE_BITS)) % (1 << DISTANCE_BITS);
    let weights = ((ONE as u32) << 16) | distance;
    // The table's cosines are negative, so it is an ON event whose weights are negated.
    let negative = u32::from(is_on).wrapping_neg();
    let weights = Weights {
        even: negate_halves(weights, negative),
        odd: negate_halves(weights, negative ^ turned),
    };
    (row, weights)
}

/// The lines of one event, with their weights.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Weighted {
    lines: &'static [Line; GRID],
    weights: Weights,
}

impl Weighted {
    /// Looks up the lines of an event; `half` is u / 2 in turns.
    #[inline(always)]
    fn new(half: Phase, is_on: bool) -> Self {
        let (row, weights) = weigh::<ROWS_LOG2, ONE>(half, is_on);
        Self {
            lines: &LINES[row % ROWS],
            weights,
        }
    }
}

#[cfg(not(all(target_arch = "x86_64", target_feature = "sse2")))]
use portable::Sums;
#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
pub(crate) use sse2::Sums;

/// Returns sum p cos(pi k u) for k = 1..8 over the impulses, at most a chunk of them, in the units of `Sum`. `half`
/// maps an impulse to u / 2.
///
/// Out of line, so that the loop has all registers to itself.
#[inline(never)]
pub fn cosines(
    impulses: impl Iterator<Item = Impulse>,
    half: impl Fn(Impulse) -> Phase,
) -> [i32; ATOMS] {
    sums_of(impulses, half).into_array()
}

#[inline(always)]
fn sums_of(impulses: impl Iterator<Item = Impulse>, half: impl Fn(Impulse) -> Phase) -> Sums {
    let mut sums = Sums::zero();
    for impulse in impulses {
        sums.add(Weighted::new(half(impulse), impulse.is_on));
    }
    sums
}

#[cfg(not(eecvs_dsp))]
pub(crate) use super::of_list::of_list;
#[cfg(eecvs_dsp)]
pub(crate) use armv7em::of_list;

/// Computes [`cosines`] for the pixels of one window.
#[derive(Debug)]
#[repr(C)]
pub struct Cosines {
    scale: PhaseScale,
    #[cfg(not(target_arch = "x86_64"))]
    sums: [i32; ATOMS],
    #[cfg(not(target_arch = "x86_64"))]
    spread: u32,
}

impl Cosines {
    /// Creates an instance for a window of this scale.
    #[must_use]
    pub fn new(scale: PhaseScale) -> Self {
        Self {
            scale,
            #[cfg(not(target_arch = "x86_64"))]
            sums: [0; ATOMS],
            #[cfg(not(target_arch = "x86_64"))]
            spread: 0,
        }
    }

    /// Returns the sums of the last pixel.
    #[cfg(not(target_arch = "x86_64"))]
    #[inline(always)]
    #[must_use]
    pub const fn sums(&self) -> &[i32; ATOMS] {
        &self.sums
    }

    /// Returns a mask of the bits that differ from the sign bit in at least one sum.
    #[cfg(not(target_arch = "x86_64"))]
    #[inline(always)]
    #[must_use]
    pub const fn spread(&self) -> u32 {
        self.spread
    }

    /// Byte offset of [`Self::sums`]; [`Self::spread`] follows them.
    #[cfg(eecvs_dsp)]
    pub(crate) const SUMS_AT: usize = core::mem::offset_of!(Cosines, sums);

    /// Sums the events of a pixel, at most [`CHUNK_EVENTS`].
    #[cfg(not(any(eecvs_dsp, target_arch = "x86_64")))]
    pub(crate) fn sum(&mut self, impulses: &Impulses<'_>) {
        let scale = self.scale;
        self.sums = cosines(impulses.clone(), |impulse| scale.half(impulse.offset_us));
        self.spread = spread(&self.sums);
    }

    /// Returns the sums over a pixel's events, at most [`CHUNK_EVENTS`](crate::fixed_point::CHUNK_EVENTS), in
    /// vectors. Out of line, like [`cosines`].
    #[cfg(target_arch = "x86_64")]
    #[inline(never)]
    pub(crate) fn sums_of(&self, impulses: &Impulses<'_>) -> Sums {
        let scale = self.scale;
        sums_of(impulses.clone(), |impulse| scale.half(impulse.offset_us))
    }

    /// Sums the events of a pixel with `armv7em`, with the same bits.
    #[cfg(eecvs_dsp)]
    #[inline(always)]
    pub(crate) fn sum(&mut self, impulses: &Impulses<'_>) {
        let mut sums = [Sum::ZERO; ATOMS];
        let _ = armv7em::seven(impulses, self.scale, &mut sums);
        self.sums = sums.map(Sum::to_bits);
        self.spread = spread(&self.sums);
    }
}

/// Returns a mask of the bits that differ from the sign bit in at least one of `sums`.
#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
pub(crate) fn spread(sums: &[i32; ATOMS]) -> u32 {
    let spread = |all, sum: &i32| all | (sum ^ (sum >> 31));
    sums.iter().fold(0, spread) as u32
}

/// Builds the table in constant evaluation, which gives the same bits on every machine.
const fn table() -> Lines {
    let mut lines = [[0; GRID]; ROWS];
    let mut row = 0;
    while row < ROWS {
        let mut i = 0;
        while i < ATOMS {
            lines[row][i] = line(row, i + 1);
            i += 1;
        }
        row += 1;
    }
    lines
}

/// Returns the line for k from `row` to the next row: the chord, moved by half of its distance from the curve.
const fn line(row: usize, k: usize) -> Line {
    let step = k as f64 * (FRAC_PI_2 / ROWS as f64);
    let (from, to) = (cos_of_row(k * row, ROWS), cos_of_row(k * (row + 1), ROWS));
    let bend = (from + to) / 2.0 * (step * step / 16.0);
    // A distance stands for the middle of its last bit.
    let half_bit = (to - from) / (2 << DISTANCE_BITS) as f64;
    let scale = (1_u32 << FRACTION_BITS) as f64;
    let from = (from + bend + half_bit) * scale;
    let to = (to + bend + half_bit) * scale;
    let cos = clamp(round(from / ONE as f64), ATOM_MAX / ONE);
    let from = cos * ONE;
    // The slope ends where the curve does, whatever rounding did to the cosine.
    let slope = round((to - from as f64) / (1 << DISTANCE_BITS) as f64);
    let slope = clamp(from + (slope << DISTANCE_BITS), ATOM_MAX) - from;
    // Rounds towards 0 if the slope was clamped.
    let slope = slope / (1 << DISTANCE_BITS);
    ((-cos as u32) << 16) | (-slope as u32 & 0xffff)
}

const fn clamp(x: i32, most: i32) -> i32 {
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
        for line in LINES.iter().flat_map(|row| &row[..ATOMS]) {
            digest.update(&line.to_le_bytes());
        }
        assert_eq!(digest.finalize(), 2_042_627_424, "the table's checksum");
    }

    #[test]
    fn atoms_are_within_the_bound() {
        let (mut worst, mut largest) = ([0.0_f64; ATOMS], 0);
        let bits = ROWS_LOG2 + DISTANCE_BITS;
        // Both ends and the middle of every distance, in both halves of the window.
        let unit = 1_u32 << (30 - bits);
        for at in 0..2_u32 << bits {
            for within in [0, unit / 2, unit - 1] {
                let half = at * unit + within;
                let phase = Phase::from_bits(half);
                let mut atoms = [portable::Sums::zero(); 2];
                let mut same = [Sums::zero(); 2];
                for (i, is_on) in [true, false].into_iter().enumerate() {
                    atoms[i].add(Weighted::new(phase, is_on));
                    same[i].add(Weighted::new(phase, is_on));
                    assert_eq!(atoms[i].into_array(), same[i].into_array());
                }
                let [atoms, negative] = atoms.map(portable::Sums::into_array);
                for (i, (atom, negative)) in atoms.into_iter().zip(negative).enumerate() {
                    assert_eq!(atom, -negative);
                    largest = largest.max(atom.abs());
                    let u = f64::from(half) / f64::from(1 << 31);
                    let exact = libm::cos((i + 1) as f64 * core::f64::consts::PI * u);
                    let error = f64::from(atom) / f64::from(1 << FRACTION_BITS) - exact;
                    worst[i] = worst[i].max(error.abs());
                }
            }
        }
        let worst = worst.map(libm::log2);
        assert!(worst.iter().all(|worst| *worst <= -14.2), "{worst:?}");
        assert!(largest < 1 << FRACTION_BITS);
    }
}
