//! What a pixel is told in, and how its codes are told apart.

use super::prediction::Foretold;
use crate::transform::shape::width_of;

/// What a number is learned by: few contexts where there is little to learn from, many where there is
/// much.
#[derive(Debug, Clone, Copy)]
pub(super) struct Context {
    pub(super) coarse: usize,
    pub(super) fine: usize,
    /// What kind of number it is, for what is below its highest bit.
    pub(super) kind: usize,
}

/// Kinds of numbers, and how many contexts each has.
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

/// A count of events, 0 for none, as one of 6.
const fn few(count: u32) -> usize {
    match count {
        0..=2 => count as usize,
        3..=4 => 3,
        5..=8 => 4,
        _ => 5,
    }
}

/// The power of two of n, 1 to 8 of them; 0 is n = 1.
pub(super) fn power(events: u32) -> usize {
    (width_of(events).saturating_sub(1) as usize).min(7)
}

/// The number of events less one, by those at west and north, 0 for none.
pub(super) const fn events(west: u32, north: u32) -> Context {
    context(0, 0, few(west) * 6 + few(north))
}

/// How many events are of the rarer polarity.
pub(super) fn minor(events: u32) -> Context {
    let power = power(events);
    context(1, usize::from(power > 1), power)
}

/// The distance to the next event's cell, by the bits of the last one, the number of events that
/// follow, and whether the polarity changes.
pub(super) fn distance(last_bits: u32, after: u32, flips: bool) -> Context {
    let flips = usize::from(flips);
    let fine = (last_bits.min(15) as usize * 3 + after.min(2) as usize) * 2 + flips;
    context(2, flips, fine)
}

/// A level that nothing foretells, by n, its place among all, and how many bits less than the widest
/// the one before had.
pub(super) fn level(events: u32, height: u8, less: u32) -> Context {
    let power = power(events);
    let fine = (power * 4 + usize::from(height & 3)) * 4 + less.min(3) as usize;
    context(3, power, fine)
}

/// What a level differs by beyond 2.
pub(super) fn residual(events: u32) -> Context {
    context(4, 0, power(events).min(4).saturating_sub(1))
}

/// From one kept coefficient to the next.
pub(super) const SET: Context = context(5, 0, 0);
/// From one pixel to the next.
pub(super) const GAP: Context = context(6, 0, 0);

/// Levels that are as foretold, before the first other and after it.
pub(super) fn run(is_first: bool) -> Context {
    context(7, usize::from(!is_first), usize::from(!is_first))
}

/// Decisions, and where their contexts begin.
pub(super) const TOLD: usize = 0;
pub(super) const AS_FORETOLD: usize = TOLD + 8;
pub(super) const SAME_SET: usize = AS_FORETOLD + 8;
pub(super) const CONTIGUOUS: usize = SAME_SET + 8;
pub(super) const FLIP: usize = CONTIGUOUS + 8;
pub(super) const SIGN: usize = FLIP + 2 * 16;
pub(super) const FLAGS: usize = SIGN + 4;

/// Codes a pixel's fields, in either direction: an encoder takes what it is handed and returns it, a
/// decoder returns what it reads whatever it is handed.
pub(super) trait Fields {
    /// A decision.
    fn flag(&mut self, context: usize, bit: bool) -> bool;

    /// A number below 2^31 that is small as a rule.
    fn number(&mut self, context: Context, value: u32) -> u32;

    /// One of 2^`bits` numbers of which some are likelier; `table` is below [`TOPS`].
    fn top(&mut self, table: usize, value: u32, bits: u32) -> u32;

    /// Whether k is kept, for k from 0 to `grid`, in words: `foretold` are those that will be, with
    /// little doubt. No more than `most` of them.
    fn set(&mut self, foretold: Option<&[u32]>, words: &mut [u32], shape: SetShape);

    /// By how much levels differ from what is foretold, wrapping.
    fn residuals(&mut self, events: u32, foretold: &[Foretold], values: &mut [i32]);

    /// Whether all that was read was there.
    fn is_sound(&self) -> bool;
}

/// Tables of [`Fields::top`]: single events, and first ones by the number of events.
pub(super) const TOPS: usize = 5;

/// What is known of a set.
#[derive(Debug, Clone, Copy)]
pub(super) struct SetShape {
    pub(super) grid: usize,
    /// How many there are at the most.
    pub(super) most: usize,
    /// Whether there are as many.
    pub(super) is_exact: bool,
    /// n
    pub(super) events: u32,
}
