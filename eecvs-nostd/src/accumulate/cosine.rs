//! cos(2 pi x) and sin(2 pi x): the atoms of the precise kernel, and the start values of the recurrence.
//!
//! A table of 1,024 nodes per turn with 30 fractional bits, with the second-order Taylor polynomial around the
//! nearest node: cos(a + d) = C - S d - C d^2 / 2, |d| <= pi / 1024. The third order leaves an error of at most d^3
//! / 6 = 2^-27.6. Measured over 2^22 phases: at most 6.4e-9, 2.2e-9 RMS; `error_is_within_the_bound` enforces 2^-27
//! and 2.5e-9. Values never leave [-1, 1], because an oscillator that starts outside would grow.

use core::f64::consts::FRAC_PI_2;

use crate::fixed_point::{Atom, Phase, mul_high};

/// log2 of the number of nodes per turn.
const NODES_LOG2: u32 = 10;
const NODES: usize = 1 << NODES_LOG2;
const QUARTER: usize = NODES / 4;

/// cos(2 pi i / 1024) over a turn and a quarter: -sin is the cosine a quarter of a turn later.
pub static COS: [Atom; NODES + QUARTER] = cos_table();

/// 2 pi 2^38 / 2^(32 + NODES_LOG2 - 32). The upper half of the product with a distance in units of 2^-42 turns is
/// in radians with 38 fractional bits.
const RADIANS: i32 = (core::f64::consts::TAU * (1_u64 << 28) as f64 + 0.5) as i32;

/// Returns C and -S of the nearest node, d in radians with 38 fractional bits, and d^2 with 44.
#[inline(always)]
fn nearest_node(turn: Phase) -> (i32, i32, i32, i32) {
    let turn = turn.to_bits();
    let node = (turn.wrapping_add(1 << (31 - NODES_LOG2)) >> (32 - NODES_LOG2)) as usize;
    // The bits below the node's bits, as a signed distance from the node.
    let d = mul_high((turn << NODES_LOG2) as i32, RADIANS);
    (
        COS[node].to_bits(),
        COS[node + QUARTER].to_bits(),
        d,
        mul_high(d, d),
    )
}

/// Returns cos(2 pi `turn`), |error| <= 2^-27.
#[inline(always)]
#[must_use]
pub fn cos(turn: Phase) -> Atom {
    let (cos, minus_sin, d, d2) = nearest_node(turn);
    Atom::from_bits(cos + ((mul_high(minus_sin, d) - (mul_high(cos, d2) >> 7)) >> 6))
}

/// Returns cos(2 pi `turn`) and sin(2 pi `turn`), |error| <= 2^-27 each.
#[inline(always)]
#[must_use]
pub fn cos_sin(turn: Phase) -> (Atom, Atom) {
    let (cos, minus_sin, d, d2) = nearest_node(turn);
    (
        Atom::from_bits(cos + ((mul_high(minus_sin, d) - (mul_high(cos, d2) >> 7)) >> 6)),
        Atom::from_bits(((mul_high(cos, d) + (mul_high(minus_sin, d2) >> 7)) >> 6) - minus_sin),
    )
}

/// Builds the table in constant evaluation, which gives the same bits on every machine, whatever its libm.
const fn cos_table() -> [Atom; NODES + QUARTER] {
    let mut table = [Atom::ZERO; NODES + QUARTER];
    let mut i = 0;
    while i <= QUARTER {
        let value = cos_first_quarter(i as f64 * (core::f64::consts::TAU / NODES as f64));
        let bits = (value * (1 << 30) as f64 + 0.5) as i32;
        let (positive, negative) = (Atom::from_bits(bits), Atom::from_bits(-bits));
        table[i] = positive;
        table[NODES / 2 - i] = negative;
        table[NODES / 2 + i] = negative;
        table[NODES - i] = positive;
        i += 1;
    }
    let mut i = 0;
    while i < QUARTER {
        table[NODES + i] = table[i];
        i += 1;
    }
    table
}

/// Returns cos x for x in [0, pi/2] by its Taylor series; 12 terms leave an error below 1e-17.
pub(crate) const fn cos_first_quarter(x: f64) -> f64 {
    let mut term = 1.0;
    let mut sum = 1.0;
    let mut n = 1;
    while n <= 12 {
        term *= -x * x / ((2 * n - 1) * (2 * n)) as f64;
        sum += term;
        n += 1;
    }
    if sum < 0.0 { 0.0 } else { sum }
}

/// Returns cos(pi / 2 `row` / `quarter`), for tables of `quarter` rows per quarter turn.
pub(crate) const fn cos_of_row(row: usize, quarter: usize) -> f64 {
    let within = (row % quarter) as f64 * (FRAC_PI_2 / quarter as f64);
    let rest = FRAC_PI_2 - within;
    match row / quarter % 4 {
        0 => cos_first_quarter(within),
        1 => -cos_first_quarter(rest),
        2 => -cos_first_quarter(within),
        _ => cos_first_quarter(rest),
    }
}

/// Returns the nearest integer; halves are rounded away from 0.
pub(crate) const fn round(x: f64) -> i32 {
    (if x < 0.0 { x - 0.5 } else { x + 0.5 }) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    const TAU: f64 = core::f64::consts::TAU;

    #[test]
    fn table_is_symmetric_and_pinned() {
        assert_eq!(COS[0], Atom::ONE);
        assert_eq!(COS[QUARTER], Atom::ZERO);
        assert_eq!(COS[NODES / 2], -Atom::ONE);
        let mut bytes = [0; 4 * (NODES + QUARTER)];
        for (word, value) in bytes.chunks_exact_mut(4).zip(&COS) {
            word.copy_from_slice(&value.to_bits().to_le_bytes());
        }
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes);
        assert_eq!(crc, 678_339_580, "the cosine table's checksum");
        for (i, entry) in COS.iter().enumerate() {
            let exact = libm::cos(i as f64 * TAU / NODES as f64) * f64::from(1 << 30);
            let error = f64::from(entry.to_bits()) - exact;
            assert!(error.abs() <= 0.5 + 1e-6, "entry {i}");
        }
    }

    #[test]
    fn error_is_within_the_bound() {
        let (mut max, mut square_sum) = (0.0_f64, 0.0);
        let count = 1_u32 << 22;
        // Phases all over the turn, and those next to multiples of an eighth.
        let edges = (0..8_u32).flat_map(|eighth| {
            (0..4096_u32).map(move |i| (eighth << 29).wrapping_add(i).wrapping_sub(2048))
        });
        let spread = (0..count).map(|i| i.wrapping_mul(0x9E37_79B1));
        for turn in spread.chain(edges) {
            let x = f64::from(turn) * (TAU / 4_294_967_296.0);
            let (cos, sin) = cos_sin(Phase::from_bits(turn));
            assert_eq!(cos, super::cos(Phase::from_bits(turn)));
            for (found, exact) in [(cos, libm::cos(x)), (sin, libm::sin(x))] {
                assert!(found.abs() <= Atom::ONE, "{turn:#x}");
                let error = found.to_num::<f64>() - exact;
                max = max.max(error.abs());
                square_sum += error * error;
            }
        }
        let rms = libm::sqrt(square_sum / f64::from(2 * count));
        assert!(max <= libm::exp2(-27.0), "max {max:e}");
        assert!(rms <= 2.5e-9, "rms {rms:e}");
    }
}
