//! Fields in which a pixel's coefficients are coded, and the contexts of their codes.

use super::prediction::Foretold;
use crate::transform::shape::width_of;

/// Context of a number: `coarse` for the fast coder, which learns little in a frame, and `fine` for the dense
/// coder.
#[derive(Debug, Clone, Copy)]
pub(super) struct Context {
    pub(super) coarse: usize,
    pub(super) fine: usize,
    /// Kind of the number, for the bit below its highest.
    pub(super) kind: usize,
}

/// Kinds of numbers, and how many coarse and fine contexts each has.
const EVENTS: (usize, usize) = (1, 36);
const MINOR: (usize, usize) = (2, 8);
const DISTANCES: (usize, usize) = (2, 16 * 3 * 2);
const LEVELS: (usize, usize) = (8, 8 * 4 * 4);
const RESIDUALS: (usize, usize) = (1, 4);
const SETS: (usize, usize) = (1, 1);
const GAPS: (usize, usize) = (1, 1);
const RUNS: (usize, usize) = (2, 2);
const ALL: [(usize, usize); 8] = [
    EVENTS, MINOR, DISTANCES, LEVELS, RESIDUALS, SETS, GAPS, RUNS,
];
pub(super) const KINDS: usize = ALL.len();

const fn before(kind: usize) -> (usize, usize) {
    let (mut sum, mut i) = ((0, 0), 0);
    while i < kind {
        sum = (sum.0 + ALL[i].0, sum.1 + ALL[i].1);
        i += 1;
    }
    sum
}

pub(super) const COARSE: usize = before(KINDS).0;
pub(super) const FINE: usize = before(KINDS).1;

const fn context(kind: usize, coarse: usize, fine: usize) -> Context {
    let start = before(kind);
    Context {
        coarse: start.0 + coarse,
        fine: start.1 + fine,
        kind,
    }
}

/// Groups counts of events, 0 for none, into 6.
const fn few(count: u32) -> usize {
    match count {
        0..=2 => count as usize,
        3..=4 => 3,
        5..=8 => 4,
        _ => 5,
    }
}

/// Returns floor(log2 n), 0 to 7; larger n count as 7.
pub(super) fn power(events: u32) -> usize {
    (width_of(events).saturating_sub(1) as usize).min(7)
}

/// Returns the context of the number of events less one, by those at west and north, 0 for none.
pub(super) const fn events(west: u32, north: u32) -> Context {
    context(0, 0, few(west) * 6 + few(north))
}

/// Returns the context of how many events are of the rarer polarity.
pub(super) fn minor(events: u32) -> Context {
    let power = power(events);
    context(1, usize::from(power > 1), power)
}

/// Returns the context of the distance to the next event's cell, by the bits of the last distance, the number of
/// events that follow, and whether the polarity changes.
pub(super) fn distance(last_bits: u32, after: u32, flips: bool) -> Context {
    let flips = usize::from(flips);
    let fine = (last_bits.min(15) as usize * 3 + after.min(2) as usize) * 2 + flips;
    context(2, flips, fine)
}

/// Returns the context of a level without prediction, by n, its place among all (0 to 3), and how many bits fewer
/// than the widest the one before had.
pub(super) fn level(events: u32, height: u8, less: u32) -> Context {
    let power = power(events);
    let fine = (power * 4 + usize::from(height & 3)) * 4 + less.min(3) as usize;
    context(3, power, fine)
}

/// Returns the context of the magnitude of a level's difference, less what flags have coded of it.
pub(super) fn residual(events: u32) -> Context {
    context(4, 0, power(events).min(4).saturating_sub(1))
}

/// Context of the step from one kept coefficient to the next.
pub(super) const SET: Context = context(5, 0, 0);
/// Context of the step from one pixel to the next.
pub(super) const GAP: Context = context(6, 0, 0);

/// Returns the context of a run of levels that are as predicted: up to the first other, or after it.
pub(super) fn run(is_first: bool) -> Context {
    context(7, usize::from(!is_first), usize::from(!is_first))
}

/// Kinds of decisions: where their contexts begin.
pub(super) const TOLD: usize = 0;
pub(super) const AS_FORETOLD: usize = TOLD + 8;
pub(super) const SAME_SET: usize = AS_FORETOLD + 8;
pub(super) const CONTIGUOUS: usize = SAME_SET + 8;
pub(super) const FLIP: usize = CONTIGUOUS + 8;
pub(super) const SIGN: usize = FLIP + 2 * 16;
pub(super) const FLAGS: usize = SIGN + 4;

/// Codes a pixel's fields in either direction: an encoder writes the values that it is given and returns them, a
/// decoder returns what it reads and ignores the values that it is given.
pub(super) trait Fields {
    /// Codes a decision.
    fn flag(&mut self, context: usize, bit: bool) -> bool;

    /// Codes a number below 2^31 that usually is small.
    fn number(&mut self, context: Context, value: u32) -> u32;

    /// Codes one of 2^`bits` numbers, some of which are likelier; `table` is below [`TOPS`].
    fn top(&mut self, table: usize, value: u32, bits: u32) -> u32;

    /// Codes which k below `grid` are kept, at most `most` of them, as bits in words; `foretold` is the set that is
    /// very likely.
    fn set(&mut self, foretold: Option<&[u32]>, words: &mut [u32], shape: SetShape);

    /// Codes how levels differ from their prediction, wrapping.
    fn residuals(&mut self, events: u32, foretold: &[Foretold], values: &mut [i32]);

    /// Returns whether everything that was read was in the input.
    fn is_sound(&self) -> bool;
}

/// Number of tables of [`Fields::top`]: one for single events, and others for first events by the number of events.
pub(super) const TOPS: usize = 5;

/// What is known of a set of coefficients before it is coded.
#[derive(Debug, Clone, Copy)]
pub(super) struct SetShape {
    pub(super) grid: usize,
    /// Most coefficients that the set has.
    pub(super) most: usize,
    /// Whether it has exactly `most`.
    pub(super) is_exact: bool,
    /// Number of events of the pixel: n.
    pub(super) events: u32,
}
