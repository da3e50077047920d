//! Distances of times from the scans on which they lie.

use crate::coder::scan::{FINE_BITS, fine_of, fine_parts};
use crate::coder::tree::counter::Counter;
use crate::coder::tree::range::BitCoder;

/// Parts of a microsecond that are told apart: a scan just after the half of one is more often stamped a microsecond
/// early.
const FRACTIONS: usize = 32;
/// Magnitudes that have a counter of their own.
const MAGNITUDES: usize = 16;
/// Largest magnitude.
const MAGNITUDE_MAX: u32 = (1 << (FINE_BITS - 1)) - 1;

/// What is learned of the distances.
#[derive(Debug)]
pub(super) struct Beside<'m> {
    /// By the fraction of the scan's time: whether the event is beside it, and whether before it.
    is_beside: &'m mut [Counter; FRACTIONS],
    is_before: &'m mut [Counter; FRACTIONS],
    /// By the magnitude so far: whether it is larger.
    is_larger: &'m mut [Counter; MAGNITUDES],
}

impl<'m> Beside<'m> {
    pub(super) const COUNTERS: usize = 2 * FRACTIONS + MAGNITUDES;

    /// Takes its counters from the start of `counters`.
    pub(super) fn new(counters: &mut &'m mut [Counter]) -> Option<Self> {
        Some(Self {
            is_beside: counters.split_off_mut(..FRACTIONS)?.as_mut_array()?,
            is_before: counters.split_off_mut(..FRACTIONS)?.as_mut_array()?,
            is_larger: counters.split_off_mut(..MAGNITUDES)?.as_mut_array()?,
        })
    }

    pub(super) fn restart(&mut self) {
        self.is_beside.fill(Counter::EVEN);
        self.is_before.fill(Counter::EVEN);
        self.is_larger.fill(Counter::EVEN);
    }

    /// Codes a distance: `fraction`, 0 to 31, is that of the scan's time.
    #[inline(never)]
    pub(super) fn code<C: BitCoder>(&mut self, coder: &mut C, fraction: u32, fine: u32) -> u32 {
        let (magnitude, is_before) = fine_parts(fine);
        let at = fraction as usize % FRACTIONS;
        if !self.is_beside[at].code(coder, magnitude > 0) {
            return fine_of(0, false);
        }
        let is_before = self.is_before[at].code(coder, is_before);
        let mut made = 1;
        while made < MAGNITUDE_MAX {
            let at = (made as usize).min(MAGNITUDES) - 1;
            if !self.is_larger[at].code(coder, magnitude > made) {
                break;
            }
            made += 1;
        }
        fine_of(made, is_before)
    }
}
