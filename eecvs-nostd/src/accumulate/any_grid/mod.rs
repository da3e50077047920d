//! Sums p cos(k a) and p exp(-i k a) for k = 1, 2, ... by linear interpolation in a table of one wave: the DTFT,
//! and the DCT on grids that [`super::dct8`] and [`super::dct16`] do not serve.
//!
//! A row of the table holds a line: start and slope, 16 bits each. One `smlad` with the weights (`ONE`, d) adds an
//! atom, where d is bits 27 to 12 of the phase as they are, signed: the distance from the row (10 bits) and the
//! row's own lowest six bits, which the line's start allows for. An atom and its sum take five instructions, a
//! complex atom seven: -sin x is the cosine a quarter of a turn later. Half a turn negates both numbers of a line
//! and changes nothing else, so the polarity is an initial half turn.
//!
//! Phases are multiples of a wrapping 32-bit fraction of a turn. The only error that grows with k is that of the
//! fraction itself, times k ([`crate::transform::phase`]).
//!
//! The error of an atom is at most 2^-16 from rounding the start, 2^-17 from rounding the slope over half a row,
//! 2^-18.7 from the line and 2^-18.3 from the distance: together 2^-15.1. `atoms_are_within_the_bound` tests every
//! row and distance and enforces 2^-15.1, and that no atom reaches 1.

#[cfg_attr(eecvs_dsp, allow(dead_code))]
mod portable;

#[cfg(eecvs_dsp)]
#[allow(unsafe_code)]
pub(crate) mod armv7em;

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
pub(crate) mod avx2;

use core::f64::consts::TAU;

use crate::accumulate::cosine::{cos_of_row, round};
use crate::fixed_point::{CHUNK_EVENTS, FRACTION_BITS, Phase, Sum, dot_add};
use crate::group::impulse::Impulse;

const ROWS_LOG2: u32 = 10;
/// Number of rows per turn.
const ROWS: usize = 1 << ROWS_LOG2;
/// Number of rows per quarter turn.
const QUARTER: usize = ROWS / 4;
/// Number of bits of the distance from a row; its weight is 1 for a whole row.
const DISTANCE_BITS: u32 = FRACTION_BITS - 15;
/// Lowest bit of the row in a phase.
const ROW_AT: u32 = 32 - ROWS_LOG2;
/// Lowest bit of the distance.
const DISTANCE_AT: u32 = ROW_AT - DISTANCE_BITS;
/// Weight of a line's start, as in [`super::dct8`]. It also keeps a start that allows for six bits of the row
/// within 16 bits.
const ONE: i32 = 1056;
/// Largest atom. The levels of n events need no extra bit for n itself, because |c_k| < n.
const ATOM_MAX: i32 = (1 << FRACTION_BITS) - 1;

/// The start in units of [`ONE`] in the upper half, the slope in the lower half.
type Line = u32;

/// The table of -cos, because an ON event begins half a turn ahead, which takes one instruction. It covers a turn
/// and a quarter, for the imaginary parts.
static LINES: [Line; ROWS + QUARTER] = lines();

/// Phase of an event at k = 0, and the step to each further k.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct Turn {
    start: u32,
    step: u32,
}

impl Turn {
    #[inline(always)]
    fn new(step: Phase, is_on: bool) -> Self {
        Self {
            start: u32::from(is_on) << 31,
            step: step.to_bits(),
        }
    }
}

/// Returns the weights of the line at a phase.
#[inline(always)]
const fn weights(phase: u32) -> u32 {
    ((ONE as u32) << 16) | ((phase >> DISTANCE_AT) & 0xffff)
}

/// Returns the lines of the real and the imaginary part at a phase.
#[inline(always)]
fn pair(phase: u32) -> (Line, Line) {
    let row = (phase >> ROW_AT) as usize;
    (LINES[row], LINES[row + QUARTER])
}

/// Writes sum p cos(k a) for k in 1..`sums.len()` over at most [`CHUNK_EVENTS`] impulses to `sums`. `step` maps an
/// impulse to a in turns. The sum of k = 0 is left as it is.
#[inline(always)]
pub fn cosines(
    impulses: impl Iterator<Item = Impulse> + Clone,
    step: impl Fn(Impulse) -> Phase + Clone,
    sums: &mut [Sum],
) {
    let turns = impulses
        .take(CHUNK_EVENTS)
        .map(|impulse| Turn::new(step(impulse), impulse.is_on));
    #[cfg(target_arch = "x86_64")]
    if avx2::is_there() {
        return avx2::cosines(&turns, sums);
    }
    #[cfg(eecvs_dsp)]
    armv7em::cosines(turns, sums);
    #[cfg(not(eecvs_dsp))]
    portable::cosines(turns, sums);
}

/// Writes sum p exp(-i k a) to `sums`, pairs of real and imaginary part; otherwise like [`cosines`].
#[inline(always)]
pub fn exponentials(
    impulses: impl Iterator<Item = Impulse> + Clone,
    step: impl Fn(Impulse) -> Phase + Clone,
    sums: &mut [[Sum; 2]],
) {
    let turns = impulses
        .take(CHUNK_EVENTS)
        .map(|impulse| Turn::new(step(impulse), impulse.is_on));
    #[cfg(target_arch = "x86_64")]
    if avx2::is_there() {
        return avx2::exponentials(&turns, sums);
    }
    #[cfg(eecvs_dsp)]
    armv7em::exponentials(turns, sums);
    #[cfg(not(eecvs_dsp))]
    portable::exponentials(turns, sums);
}

/// Builds the table in constant evaluation, which gives the same bits on every machine.
const fn lines() -> [Line; ROWS + QUARTER] {
    let mut lines = [0; ROWS + QUARTER];
    let mut i = 0;
    while i < lines.len() {
        lines[i] = line((i + ROWS / 2) % ROWS);
        i += 1;
    }
    lines
}

/// Returns the line of the cosine from `row` to the next row: the chord, moved by half of its distance from the
/// curve.
const fn line(row: usize) -> Line {
    if row >= ROWS / 2 {
        let line = line(row - ROWS / 2);
        let (start, slope) = (line >> 16, line & 0xffff);
        return (start.wrapping_neg() << 16) | (slope.wrapping_neg() & 0xffff);
    }
    let (from, to) = (cos_of_row(row, QUARTER), cos_of_row(row + 1, QUARTER));
    let step = TAU / ROWS as f64;
    let bend = (from + to) / 2.0 * (step * step / 16.0);
    // A distance stands for the middle of its last bit.
    let half_bit = (to - from) / (2 << DISTANCE_BITS) as f64;
    let scale = (1_u32 << FRACTION_BITS) as f64;
    let from = (from + bend + half_bit) * scale;
    let to = (to + bend + half_bit) * scale;
    let slope = round((to - from) / (1 << DISTANCE_BITS) as f64);
    // The slope's contribution in the middle of the row.
    let (first, last) = distances(row);
    let middle = slope as f64 * ((first + last) as f64 / 2.0);
    let mut start = round(((from + to) / 2.0 - middle) / ONE as f64);
    // Keep the atom below 1 at both ends.
    while start * ONE + slope * first > ATOM_MAX || start * ONE + slope * last > ATOM_MAX {
        start -= 1;
    }
    while start * ONE + slope * first < -ATOM_MAX || start * ONE + slope * last < -ATOM_MAX {
        start += 1;
    }
    assert!(start >= -0x8000 && start <= 0x7fff && slope >= -0x8000 && slope <= 0x7fff);
    ((start as u32) << 16) | (slope as u32 & 0xffff)
}

/// Returns the first and the last weight of a slope in `row`.
const fn distances(row: usize) -> (i32, i32) {
    let first = ((row << DISTANCE_BITS) & 0xffff) as u16 as i16 as i32;
    (first, first + (1 << DISTANCE_BITS) - 1)
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
        assert_eq!(digest.finalize(), 2_091_740_695, "the table's checksum");
    }

    #[cfg(target_arch = "x86_64")]
    proptest::proptest! {
        #[test]
        fn vectors_give_the_same_bits(
            turns in proptest::collection::vec(
                proptest::prelude::any::<(u32, bool)>(),
                0..=CHUNK_EVENTS,
            ),
            grid in 0..=70_usize,
        ) {
            if !avx2::is_there() {
                return Ok(());
            }
            let turns = turns.iter().map(|(step, is_on)| Turn::new(Phase::from_bits(*step), *is_on));
            let mut sums = [[Sum::NEG_ONE; 70]; 2];
            portable::cosines(turns.clone(), &mut sums[0][..grid]);
            avx2::cosines(&turns, &mut sums[1][..grid]);
            proptest::prop_assert_eq!(sums[0], sums[1]);
            let mut sums = [[[Sum::NEG_ONE; 2]; 70]; 2];
            portable::exponentials(turns.clone(), &mut sums[0][..grid]);
            avx2::exponentials(&turns, &mut sums[1][..grid]);
            proptest::prop_assert_eq!(sums[0], sums[1]);
        }
    }

    #[test]
    fn atoms_are_within_the_bound() {
        let (mut worst, mut largest) = (0.0_f64, 0);
        // Both ends of every distance.
        for at in 0..1_u32 << (32 - DISTANCE_AT) {
            let phase = at << DISTANCE_AT;
            let on = pair(phase ^ (1 << 31));
            let found = [on.0, on.1].map(|line| dot_add(0, line, weights(phase)));
            let off = pair(phase);
            assert_eq!(dot_add(0, off.0, weights(phase)), -found[0]);
            assert_eq!(dot_add(0, off.1, weights(phase)), -found[1]);
            for phase in [phase, phase | ((1 << DISTANCE_AT) - 1)] {
                let turns = f64::from(phase) / 4_294_967_296.0;
                let (sin, cos) = libm::sincos(turns * TAU);
                for (found, exact) in found.into_iter().zip([cos, -sin]) {
                    largest = largest.max(found.abs());
                    let found = f64::from(found) / f64::from(1 << FRACTION_BITS);
                    worst = worst.max((found - exact).abs());
                }
            }
        }
        assert!(worst <= libm::exp2(-15.1), "2^{}", libm::log2(worst));
        assert!(largest < 1 << FRACTION_BITS);
    }
}
