//! Sums p exp(-i 2 pi k u) for k = 1..15 by linear interpolation in a table: the DTFT of 16 frequencies, the
//! default for M = 8.
//!
//! A row of the table holds, for each k, two lines from its u to that of the next row, one for the real and one for
//! the imaginary part: value and slope, 16 bits each. One `smlad` with the weights (p, p d), where d is the
//! distance from the row, adds a number. The rows span half of the window; u and u + 1/2 share a row, with the
//! opposite sign for odd k.
//!
//! The error of a number is largest for k = 15. It has three parts: from the line, 3.3e-5 where the curve bends
//! (half of its sagitta, as the line runs midway through it) and, as no atom may reach 1, 4.4e-5 in the rows next
//! to a peak; from rounding the distance, 2^-11 rows, or 1.1e-5, where the curve is steep instead; and up to 2^-16
//! from rounding the line's two ends. The sum of all maxima is 6.0e-5 = 2^-14.0. `atoms_are_within_the_bound` tests
//! every row. It finds 2^-14.18 for one part and 2^-14.10 for both together, and enforces 2^-14.15 and 2^-14.08,
//! and that no atom reaches 1.
//!
//! The lines are computed in integers. If flash is scarce (`eecvs_small`), there is no table and each line is
//! computed when it is needed.

#[cfg_attr(target_feature = "sse2", allow(dead_code))]
mod portable;

#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
#[allow(unsafe_code)]
pub(crate) mod sse2;

#[cfg(eecvs_dsp)]
pub(crate) mod armv7em;

use core::f64::consts::{FRAC_PI_2, TAU};

use crate::accumulate::cosine::cos_first_quarter;
use crate::fixed_point::{CHUNK_EVENTS, FRACTION_BITS, Phase, Sum, dot_add, negate_halves};
use crate::group::impulse::Impulse;

/// K, the number of frequencies.
pub const GRID: usize = 16;
/// Number of rows, from u = 0 to u = 1/2.
const ROWS: usize = 1 << ROWS_LOG2;
pub(crate) const ROWS_LOG2: u32 = 11;
/// Number of rows, from u = 0 to u = 1/4.
const QUARTER: usize = ROWS / 2;
/// Number of bits of the distance from a row; its weight is 1 for a whole row.
pub(crate) const DISTANCE_BITS: u32 = FRACTION_BITS - 15;
/// Lowest bit of the row within 30 bits of u / 2; the distance lies below it.
pub(crate) const ROW_AT: u32 = 30 - ROWS_LOG2;
pub(crate) const DISTANCE_AT: u32 = ROW_AT - DISTANCE_BITS;
/// Weight of the value: the one from 2^10 + 1 to 2^10 + 36 with the smallest error.
pub(crate) const ONE: i32 = 1030;
/// Largest atom. The levels of n events need no extra bit for n itself, because |c_k| < n.
const ATOM_MAX: i32 = (1 << FRACTION_BITS) - 1;

/// The negative of a number in units of [`ONE`] in the upper half; the slope per row, with 15 fractional bits, in
/// the lower half.
type Line = u32;
/// The lines of the real and the imaginary part of each k, from [`place`] on.
type Row = [Line; LINES_OF_ROW];

/// Even k except 0, then odd k; all lines of a group have weights of one sign.
#[cfg(eecvs_dsp)]
const LINES_OF_ROW: usize = 2 * (GRID - 1);
/// All k, with zeros for k = 0, whose sum the caller knows: a whole number of vectors.
#[cfg(not(eecvs_dsp))]
const LINES_OF_ROW: usize = 2 * GRID;

/// Returns the index in a row of the lines of `k`, 1 to 15.
#[cfg(eecvs_dsp)]
pub(crate) const fn place(k: usize) -> usize {
    if k.is_multiple_of(2) {
        k - 2
    } else {
        GRID - 3 + k
    }
}

/// Returns the index in a row of the lines of `k`.
#[cfg(not(eecvs_dsp))]
const fn place(k: usize) -> usize {
    2 * k
}

/// The table. On a host each row fills two cache lines.
#[cfg(not(eecvs_small))]
#[cfg_attr(not(eecvs_dsp), repr(align(128)))]
pub(crate) struct Lines([Row; ROWS]);

// Takes the compiler two seconds.
#[cfg(not(eecvs_small))]
#[allow(long_running_const_eval)]
pub(crate) static LINES: Lines = table();

/// The place of an event in the table.
#[derive(Debug, Clone, Copy)]
struct Place {
    row: usize,
    /// [`ONE`] in the upper half, the distance in the lower.
    weights: u32,
    /// All ones if the event is in the second half of the window.
    late: u32,
}

impl Place {
    /// Locates an event; `half` is u / 2 in turns.
    #[inline(always)]
    fn new(half: Phase) -> Self {
        let half = half.to_bits();
        let distance = (half >> DISTANCE_AT) % (1 << DISTANCE_BITS);
        Self {
            row: (half >> ROW_AT) as usize % ROWS,
            weights: ((ONE as u32) << 16) | distance,
            late: ((half << 1).cast_signed() >> 31).cast_unsigned(),
        }
    }

    /// Returns the lines of the event's row.
    #[cfg(not(eecvs_small))]
    #[inline(always)]
    fn lines(self) -> &'static Row {
        &LINES.0[self.row]
    }

    /// Computes the lines of the event's row.
    #[cfg(eecvs_small)]
    fn lines(self) -> Row {
        row_of(self.row, &COSINES)
    }
}

/// Writes sum p exp(-i 2 pi k u) for k in 1..16 over at most [`CHUNK_EVENTS`] impulses to `sums`, pairs of real and
/// imaginary part. `half` maps an impulse to u / 2. The sum of k = 0 is left as it is.
#[inline(always)]
pub fn exponentials(
    impulses: impl Iterator<Item = Impulse>,
    half: impl Fn(Impulse) -> Phase,
    sums: &mut [[Sum; 2]; GRID],
) {
    let impulses = impulses.take(CHUNK_EVENTS);
    #[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
    sse2::exponentials(impulses, half, sums);
    #[cfg(not(all(target_arch = "x86_64", target_feature = "sse2")))]
    portable::exponentials(impulses, half, sums);
}

#[cfg(not(eecvs_dsp))]
pub(crate) use super::of_list::of_list;
#[cfg(eecvs_dsp)]
pub(crate) use armv7em::of_list;

/// Builds the table in constant evaluation, which gives the same bits on every machine.
#[cfg(not(eecvs_small))]
const fn table() -> Lines {
    let cosines = cosines();
    let mut lines = [[0; LINES_OF_ROW]; ROWS];
    let mut row = 0;
    while row < ROWS {
        lines[row] = row_of(row, &cosines);
        row += 1;
    }
    Lines(lines)
}

/// Cosines of the rows from u = 0 to u = 1/4, with 30 fractional bits.
type Cosines = [i32; QUARTER + 1];

#[cfg(eecvs_small)]
static COSINES: Cosines = cosines();

const fn cosines() -> Cosines {
    let mut cosines = [0; QUARTER + 1];
    let mut row = 0;
    while row <= QUARTER {
        let cos = cos_first_quarter(row as f64 * (FRAC_PI_2 / QUARTER as f64));
        cosines[row] = (cos * (1 << WIDE_BITS) as f64 + 0.5) as i32;
        row += 1;
    }
    cosines
}

/// Fractional bits of the values that a line is computed from.
const WIDE_BITS: u32 = 30;
/// How many of them exceed a sum's fractional bits.
const MORE_BITS: u32 = WIDE_BITS - FRACTION_BITS;

/// Returns cos(2 pi `at` / 2 / [`ROWS`]).
const fn cos_at(at: usize, cosines: &Cosines) -> i32 {
    let within = at % QUARTER;
    match at / QUARTER % 4 {
        0 => cosines[within],
        1 => -cosines[QUARTER - within],
        2 => -cosines[within],
        _ => cosines[QUARTER - within],
    }
}

/// Returns the lines from `row` to the next row.
const fn row_of(row: usize, cosines: &Cosines) -> Row {
    let mut lines = [0; LINES_OF_ROW];
    let mut k = 1;
    while k < GRID {
        let (from, to) = (k * row, k * (row + 1));
        lines[place(k)] = line(k, cos_at(from, cosines), cos_at(to, cosines));
        // -sin is the cosine a quarter of a turn later.
        let (from, to) = (from + QUARTER, to + QUARTER);
        lines[place(k) + 1] = line(k, cos_at(from, cosines), cos_at(to, cosines));
        k += 1;
    }
    lines
}

/// Returns the line for k from a row, where the curve is at `from`, to the next, where it is at `to`.
///
/// It is the chord, moved at both ends by half of its distance from the curve. If that passes 1 at one end, that
/// end is clamped and the other is moved further, so that the errors there and in the middle are equal.
const fn line(k: usize, from: i32, to: i32) -> Line {
    // A distance stands for the middle of its last bit.
    let half_bit = (to - from) >> (DISTANCE_BITS + 1);
    let (chord_from, chord_to) = (from + half_bit, to + half_bit);
    // Distance of the chord from the curve, towards 0.
    let middle = (chord_from as i64 + chord_to as i64) >> 1;
    let depth = ((middle * DEPTHS[k]) >> 32) as i32;
    let (mut from, mut to) = (chord_from + depth / 2, chord_to + depth / 2);
    let most = ATOM_MAX << MORE_BITS;
    if from > most || from < -most {
        from = clamp(from, most);
        to = clamp(chord_to + (2 * depth - (from - chord_from)) / 3, most);
    } else if to > most || to < -most {
        to = clamp(to, most);
        from = clamp(chord_from + (2 * depth - (to - chord_to)) / 3, most);
    }
    let half = ONE << (MORE_BITS - 1);
    let half = if from < 0 { -half } else { half };
    let value = clamp((from + half) / (ONE << MORE_BITS), ATOM_MAX / ONE);
    // The slope ends where the curve does, whatever rounding did to the value.
    let start = value * ONE;
    let rise = to - (start << MORE_BITS);
    let mut slope = (rise + (1 << (DISTANCE_BITS + MORE_BITS - 1))) >> (DISTANCE_BITS + MORE_BITS);
    let last = (1 << DISTANCE_BITS) - 1;
    if start + slope * last > ATOM_MAX {
        slope -= 1;
    }
    if start + slope * last < -ATOM_MAX {
        slope += 1;
    }
    ((-value as u32) << 16) | (-slope as u32 & 0xffff)
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

/// 1 - cos of half a row for each k, with 32 fractional bits: the distance of a chord from the curve, relative to
/// the curve's distance from 0.
const DEPTHS: [i64; GRID] = depths();

const fn depths() -> [i64; GRID] {
    let mut depths = [0; GRID];
    let mut k = 1;
    while k < GRID {
        let step = k as f64 * (TAU / (2 * ROWS) as f64);
        depths[k] = (step * step / 8.0 * (1_u64 << 32) as f64 + 0.5) as i64;
        k += 1;
    }
    depths
}

#[cfg(test)]
#[allow(unsafe_code)]
mod tests {
    use super::*;

    #[test]
    fn table_is_pinned() {
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
        let mut digest = crc.digest();
        for line in LINES.0.as_flattened() {
            digest.update(&line.to_le_bytes());
        }
        assert_eq!(digest.finalize(), 1_503_592_566, "the table's checksum");
    }

    /// Returns both parts of every k for an event; `half` is u / 2 in turns.
    fn atoms(half: u32, is_on: bool) -> [[i32; 2]; GRID] {
        let impulse = Impulse {
            offset_us: 0,
            is_on,
        };
        let mut sums = [[Sum::ZERO; 2]; GRID];
        let half = |_| Phase::from_bits(half);
        portable::exponentials([impulse].into_iter(), half, &mut sums);
        sums.map(|pair| pair.map(Sum::to_bits))
    }

    /// At u = 0 all atoms are equal, so ties go to the lower k.
    #[test]
    fn no_k_is_before_another_at_the_start_of_a_window() {
        let [_, others @ ..] = atoms(0, true);
        assert_eq!(others, [[ATOM_MAX / ONE * ONE, 0]; GRID - 1]);
    }

    #[test]
    fn atoms_are_within_the_bound() {
        let mut worst = [[0.0_f64; 2]; GRID];
        let mut largest = 0;
        let bits = ROWS_LOG2 + DISTANCE_BITS;
        let unit = 1_u32 << (30 - bits);
        // Every row, at both ends and at 33 distances between them.
        for at in (0..1_u32 << bits).step_by(31) {
            for at in [
                at,
                at - at % (1 << DISTANCE_BITS),
                at | ((1 << DISTANCE_BITS) - 1),
            ] {
                let on = atoms(at * unit, true);
                for half in [at * unit, at * unit + unit - 1] {
                    let u = f64::from(half) / f64::from(1_u32 << 31);
                    let (sin, cos) = libm::sincos(TAU * u);
                    let mut exact = [1.0, 0.0];
                    for (found, worst) in on.iter().zip(&mut worst).skip(1) {
                        let [re, im] = exact;
                        exact = [re * cos + im * sin, im * cos - re * sin];
                        let error: [f64; 2] = core::array::from_fn(|i| {
                            f64::from(found[i]) / f64::from(1 << FRACTION_BITS) - exact[i]
                        });
                        worst[0] = worst[0].max(error[0].abs()).max(error[1].abs());
                        worst[1] = worst[1].max(libm::hypot(error[0], error[1]));
                        largest = largest.max(found[0].abs()).max(found[1].abs());
                    }
                }
            }
        }
        let worst = worst.map(|worst| worst.map(libm::log2));
        let is_within = |[part, both]: &[f64; 2]| *part <= -14.15 && *both <= -14.08;
        assert!(worst.iter().all(is_within), "{worst:?}");
        assert!(largest < 1 << FRACTION_BITS);
    }

    /// Both halves of the window and both polarities share a row.
    #[test]
    fn odd_frequencies_change_their_sign_halfway() {
        for half in [0, 1 << 20, 123_456_789, (1 << 30) - 1] {
            let (early, late) = (atoms(half, true), atoms(half | (1 << 30), true));
            let off = atoms(half, false);
            for k in 1..GRID {
                let sign = if k % 2 == 0 { 1 } else { -1 };
                assert_eq!(late[k], early[k].map(|part| sign * part));
                assert_eq!(off[k], early[k].map(|part| -part));
            }
        }
    }

    #[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
    proptest::proptest! {
        #[test]
        fn vectors_give_the_same_bits(
            events in proptest::collection::vec(
                (0..1_u32 << 31, proptest::prelude::any::<bool>()),
                0..=CHUNK_EVENTS,
            ),
        ) {
            let impulses = || {
                let impulse = |(offset_us, is_on): &(u32, bool)| Impulse {
                    offset_us: *offset_us,
                    is_on: *is_on,
                };
                events.iter().map(impulse)
            };
            let half = |impulse: Impulse| Phase::from_bits(impulse.offset_us);
            let mut sums = [[[Sum::NEG_ONE; 2]; GRID]; 2];
            portable::exponentials(impulses(), half, &mut sums[0]);
            sse2::exponentials(impulses(), half, &mut sums[1]);
            proptest::prop_assert_eq!(sums[0], sums[1]);
            if crate::accumulate::any_grid::avx2::is_there() {
                // SAFETY: the processor has AVX2; both are 128 bytes.
                let found: [[Sum; 2]; GRID] = unsafe {
                    let found = sse2::first_exponentials::<4>(impulses(), half);
                    core::mem::transmute(found)
                };
                proptest::prop_assert_eq!(&sums[0][1..], &found[1..]);
                proptest::prop_assert_eq!(found[0], [Sum::ZERO; 2]);
            }
        }
    }
}
