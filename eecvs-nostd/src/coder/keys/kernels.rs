//! The loops that have an implementation for each kind of core.

use crate::coder::keys::{SLICE_EVENTS, Window};
use event_types::Event;

/// Words of a slice: events, keys or differences of keys. The rest is room for whole vectors.
pub type Words = [u64; SLICE_EVENTS + 16];
/// Symbols of a slice with room for whole vectors on both sides; the first is at [`AHEAD`].
pub type Symbols = [u8; SLICE_EVENTS + 2 * AHEAD];
/// Room on either side of [`Symbols`].
pub const AHEAD: usize = 32;

/// The bits of two mantissas each, the second's above the first's, and their numbers of bits; the bits mean nothing
/// where there are more than 64.
#[derive(Debug, zerocopy::FromZeros)]
pub struct Pairs {
    /// Bits of two mantissas.
    pub bits: [u64; SLICE_EVENTS / 2],
    /// Their number.
    pub counts: [u8; SLICE_EVENTS / 2],
}

/// What a slice's keys are made of: key = place * units + unit of time.
#[derive(Debug, Clone, Copy)]
pub struct Span {
    /// Units of time from the slice's first to its last, both included, at least 1.
    pub units: u32,
    /// Places of the sensor times `units`, at most 2^54.
    pub keys: u64,
}

impl Span {
    /// Returns the span of `units`, at least 1, on a window's sensor.
    pub const fn new(window: &Window, units: u32) -> Self {
        Self {
            units,
            keys: window.places() as u64 * units as u64,
        }
    }

    /// Returns the class of the largest difference of keys.
    pub const fn highest(&self) -> u32 {
        u64::BITS - (self.keys - 1).leading_zeros()
    }
}

/// Polarity of a word in order of place, above its time.
pub const ON: u32 = 32;
/// First bit of its place.
pub const PLACE: u32 = 33;
/// First bit of the time of a word in order of time, which has the place below, and the polarity in bit 0.
pub const TIME: u32 = 32;

/// How a decoded time is made of a unit's number.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    /// Start of the window.
    pub start_us: u64,
    /// Number of the slice's first unit.
    pub first: u32,
    /// Width of a unit.
    pub unit_us: u32,
    /// Last microsecond of the window, from its start.
    pub last_us: u32,
}

/// Returns the most moves of words by insertion.
pub const fn moves(words: usize) -> usize {
    8 * words + 64
}

/// All implementations do the same.
pub trait Kernels: Copy {
    /// Replaces counts by the sums of those before.
    fn sums(self, counts: &mut [u16]);

    /// Replaces words in order of place (place, polarity, time from the highest bit down) by differences of keys, the
    /// flip of polarity in the highest bit, and finds their symbols and the pairs of their mantissas. Returns whether
    /// keys ascend and times are in the span.
    fn classes(
        self,
        words: &mut Words,
        count: usize,
        span: Span,
        symbols: &mut Symbols,
        pairs: &mut Pairs,
    ) -> bool;

    /// Decodes mantissas into words: time, place, polarity from the highest bit down. Returns whether all keys are in
    /// the span. `mantissas` has the bits of all symbols and 8 bytes more.
    fn words(
        self,
        symbols: &Symbols,
        count: usize,
        mantissas: &[u8],
        span: Span,
        words: &mut Words,
    ) -> bool;

    /// Sorts words by time that are in order of buckets; those of equal time keep their order. Returns false, with
    /// words in any order, where that takes more than [`moves`], as in a burst of events within few buckets.
    fn insert(self, words: &mut [u64]) -> bool;

    /// Makes events of words; `width` is the sensor's.
    fn events(self, words: &Words, width: u16, clock: Clock, events: &mut [Event]);
}
