//! EVT 2.0 words into a window's slots: the loop that every event passes.

#[cfg(target_pointer_width = "64")]
mod portable64;

#[cfg(eecvs_intake_asm)]
#[allow(unsafe_code)]
mod armv7em;

#[cfg(not(any(eecvs_intake_asm, target_pointer_width = "64")))]
mod portable32;

use core::num::NonZeroU32;

use crate::window::{Head, Slot};

/// The part of an open window that takes words whose times all lie in it.
#[derive(Debug)]
pub(crate) struct Intake<'w> {
    pub slots: &'w mut [Slot],
    /// One a segment; a word whose segment has none is not taken.
    pub heads: &'w mut [Head],
    /// One bit a head.
    pub bitmap: &'w mut [u32],
    /// The sensor's.
    pub width: u16,
    /// Segments in a row.
    pub stride: NonZeroU32,
    /// Slots in use.
    pub len: u32,
    /// The current `TIME_HIGH`.
    pub time: u32,
    /// The last one that may be stepped to.
    pub time_last: u32,
    /// Offset of the current one; wraps where it is before the window, and its events are not.
    pub span_us: u32,
    /// Slot of the first event since.
    pub span_at: u32,
    /// Offset of the last `TIME_HIGH` before that had events.
    pub before_us: u32,
    /// Slot of the first of them.
    pub before_at: u32,
}

impl Intake<'_> {
    /// Stores events on the sensor while there are slots and follows the time, up to the first word
    /// that is neither; returns how many words it took.
    #[inline]
    pub fn take(&mut self, words: &[[u8; 4]]) -> usize {
        #[cfg(eecvs_intake_asm)]
        use armv7em as machine;
        #[cfg(all(not(eecvs_intake_asm), not(target_pointer_width = "64")))]
        use portable32 as machine;
        #[cfg(target_pointer_width = "64")]
        use portable64 as machine;
        machine::take(self, words)
    }
}
