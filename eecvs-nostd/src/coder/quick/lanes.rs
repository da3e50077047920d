//! Vectors of eight lanes of 32 bits, as what codes blocks sees them.

use crate::coder::quick::format::{BLOCK, LANES};
use event_types::Event;

/// Number of words of each lane.
pub const ROWS: usize = BLOCK / LANES;

/// Operations on eight unsigned lanes of 32 bits. A value of the type proves that the core has the instructions.
///
/// Arithmetic wraps.
pub trait Lanes: Copy {
    /// Eight lanes.
    type Vector: Copy;

    /// Returns a vector of equal lanes.
    fn splat(self, value: u32) -> Self::Vector;
    /// Reads eight words.
    fn load(self, from: &[u32; LANES]) -> Self::Vector;
    /// Writes eight words.
    fn store(self, to: &mut [u32; LANES], v: Self::Vector);
    /// Reads eight little-endian words.
    fn load_bytes(self, from: &[u8; 4 * LANES]) -> Self::Vector;
    /// Writes eight words, little-endian.
    fn store_bytes(self, to: &mut [u8; 4 * LANES], v: Self::Vector);
    /// Reads eight bytes, each into a lane.
    fn load_single_bytes(self, from: &[u8; LANES]) -> Self::Vector;
    /// Reads eight little-endian halves.
    fn load_half_bytes(self, from: &[u8; 2 * LANES]) -> Self::Vector;
    /// Writes the lanes, all below 2^16, as little-endian halves.
    fn store_half_bytes(self, to: &mut [u8; 2 * LANES], v: Self::Vector);
    /// a + b.
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a - b.
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a b.
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// floor(a b / 2^32).
    fn mul_high(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The sum of the products of both signed halves of each lane.
    fn dot(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a & b.
    fn and(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a | b.
    fn or(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a << count, count below 32.
    fn shl(self, a: Self::Vector, count: u32) -> Self::Vector;
    /// a >> count, count below 32.
    fn shr(self, a: Self::Vector, count: u32) -> Self::Vector;
    /// The larger of each pair of lanes.
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The smaller of each pair of halves.
    fn min_halves(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The larger of each pair of halves.
    fn max_halves(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// Returns a bit for each byte, all of them 0 or 255; the first byte gives the lowest bit.
    fn high_bits(self, bytes: &[u8; 4 * LANES]) -> u32;
    /// Returns the first words and the second words of eight pairs.
    fn load_pairs(self, from: &[[u32; 2]; LANES]) -> (Self::Vector, Self::Vector);
    /// Writes events from times, to which `start_us` is added, y << 16 | x, and polarities of 0 or 1.
    fn store_events(
        self,
        events: &mut [Event; LANES],
        start_us: u64,
        t: Self::Vector,
        place: Self::Vector,
        polarity: Self::Vector,
    );

    /// Returns the least of the eight values of each half.
    #[inline(always)]
    fn least_halves(self, v: Self::Vector) -> u32 {
        let mut lanes = [0; LANES];
        self.store(&mut lanes, v);
        lanes
            .into_iter()
            .fold(u32::MAX, |a, b| halves(a, b, u16::min))
    }

    /// Returns the most of the eight values of each half.
    #[inline(always)]
    fn most_halves(self, v: Self::Vector) -> u32 {
        let mut lanes = [0; LANES];
        self.store(&mut lanes, v);
        lanes.into_iter().fold(0, |a, b| halves(a, b, u16::max))
    }

    /// Returns the largest lane.
    #[inline(always)]
    fn most(self, v: Self::Vector) -> u32 {
        let mut lanes = [0; LANES];
        self.store(&mut lanes, v);
        lanes.into_iter().fold(0, u32::max)
    }

    /// Returns whether all bits are zero.
    #[inline(always)]
    fn is_zero(self, v: Self::Vector) -> bool {
        let mut lanes = [0; LANES];
        self.store(&mut lanes, v);
        lanes.into_iter().fold(0, |a, b| a | b) == 0
    }
}

/// Applies `f` to both halves of two words.
#[inline(always)]
pub fn halves(a: u32, b: u32, f: impl Fn(u16, u16) -> u16) -> u32 {
    u32::from(f((a >> 16) as u16, (b >> 16) as u16)) << 16 | u32::from(f(a as u16, b as u16))
}
