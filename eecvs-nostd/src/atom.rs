//! cos(2 pi x) from a table with linear interpolation: the atom of the DCT and the DTFT.
//!
//! 1,024 cells a turn, 16-bit values, 8-bit interpolation weights. The error has three parts: the
//! table's rounding (2^-16, and 2^-15 at +1, which I1F15 cannot hold), the chord under the arc
//! ((2 pi / 1024)^2 / 8 = 2^-17.7) and the weight's rounding (slope * 2^-9 of a cell = 2^-16.3).
//! Measured over 2^22 phases: at most 2^-15 (at +1), 8.8e-6 RMS; `error_is_within_the_bound`
//! enforces 2^-15 and 9e-6.

use crate::fixed_point::{Atom, Phase, Sum};

/// log2 of the cells in a turn.
const CELLS_LOG2: u32 = 10;
/// log2 of the interpolation weights in a cell.
const WEIGHTS_LOG2: u32 = 8;
const CELLS: usize = 1 << CELLS_LOG2;

/// cos(2 pi i / 1024) for i in 0..=1024: one entry more than a turn, so that a cell is a pair.
pub static COS: [Atom; CELLS + 1] = cos_table();

/// cos(2 pi `turn`) with 23 fractional bits, |error| <= 2^-15.
#[inline]
#[must_use]
pub fn cos(turn: Phase) -> Sum {
    // Half a weight is added so that the weight below is rounded and not cut.
    let turn = turn
        .to_bits()
        .wrapping_add(1 << (31 - CELLS_LOG2 - WEIGHTS_LOG2));
    let cell = (turn >> (32 - CELLS_LOG2)) as usize;
    let weight = (turn >> (32 - CELLS_LOG2 - WEIGHTS_LOG2)) & ((1 << WEIGHTS_LOG2) - 1);
    let from = i32::from(COS[cell].to_bits());
    let to = i32::from(COS[cell + 1].to_bits());
    Sum::from_bits((from << WEIGHTS_LOG2) + (to - from) * weight as i32)
}

/// The table in constant evaluation: the same bits on every machine, whatever its libm.
const fn cos_table() -> [Atom; CELLS + 1] {
    let mut table = [Atom::ZERO; CELLS + 1];
    let quarter = CELLS / 4;
    let mut i = 0;
    while i <= quarter {
        let value = cos_first_quarter(i as f64 * (core::f64::consts::TAU / CELLS as f64));
        // Half away from zero; +1 saturates to the largest value of I1F15.
        let bits = (value * 32_768.0 + 0.5) as i32;
        let positive = if bits > 32_767 { 32_767 } else { bits as i16 };
        let negative = -bits as i16;
        table[i] = Atom::from_bits(positive);
        table[CELLS - i] = Atom::from_bits(positive);
        table[CELLS / 2 - i] = Atom::from_bits(negative);
        table[CELLS / 2 + i] = Atom::from_bits(negative);
        i += 1;
    }
    table
}

/// cos x for x in [0, pi/2] by its Taylor series: 12 terms leave less than 1e-17.
const fn cos_first_quarter(x: f64) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_is_symmetric_and_pinned() {
        assert_eq!(COS[0].to_bits(), 32_767);
        assert_eq!(COS[CELLS / 4].to_bits(), 0);
        assert_eq!(COS[CELLS / 2].to_bits(), -32_768);
        assert_eq!(COS[CELLS].to_bits(), 32_767);
        let mut bytes = [0; 2 * (CELLS + 1)];
        for (pair, value) in bytes.chunks_exact_mut(2).zip(&COS) {
            pair.copy_from_slice(&value.to_bits().to_le_bytes());
        }
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes);
        assert_eq!(crc, 828_047_991, "the cosine table's checksum");
        for (i, entry) in COS.iter().enumerate() {
            let exact = libm::cos(i as f64 * core::f64::consts::TAU / CELLS as f64) * 32_768.0;
            let error = f64::from(entry.to_bits()) - exact;
            assert!(
                error.abs() <= if exact > 32_767.5 { 1.0 } else { 0.5 + 1e-6 },
                "entry {i}"
            );
        }
    }

    #[test]
    fn error_is_within_the_bound() {
        let (mut max, mut square_sum) = (0.0_f64, 0.0);
        let count = 1_u32 << 22;
        for i in 0..count {
            let turn = i.wrapping_mul(0x9E37_79B1);
            let exact = libm::cos(f64::from(turn) * (core::f64::consts::TAU / 4_294_967_296.0));
            let error = cos(Phase::from_bits(turn)).to_num::<f64>() - exact;
            max = max.max(error.abs());
            square_sum += error * error;
        }
        let rms = libm::sqrt(square_sum / f64::from(count));
        assert!(max <= libm::exp2(-15.0), "max {max:e}");
        assert!(rms <= 9e-6, "rms {rms:e}");
    }
}
