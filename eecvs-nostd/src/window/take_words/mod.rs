//! Stores EVT 2.0 words in a window's slots: the loop that every event passes through.

#[cfg(target_pointer_width = "64")]
mod portable64;

#[cfg(eecvs_intake_asm)]
#[allow(unsafe_code)]
mod armv7em;

#[cfg(not(any(eecvs_intake_asm, target_pointer_width = "64")))]
mod portable32;

#[cfg(not(eecvs_intake_asm))]
mod in_order;

use core::num::NonZeroU32;

use crate::window::{Head, Slot};

/// The part of an open window that takes words, all of whose times must lie in the window.
#[derive(Debug)]
pub(crate) struct Intake<'w> {
    pub slots: &'w mut [Slot],
    /// One head per segment; a word whose segment has no head is not taken.
    pub heads: &'w mut [Head],
    /// One bit per head.
    pub bitmap: &'w mut [u32],
    /// Width of the sensor.
    pub width: u16,
    /// Number of segments in a row.
    pub stride: NonZeroU32,
    /// Number of slots in use.
    pub len: u32,
    /// The current `TIME_HIGH` word.
    pub time: u32,
    /// The last `TIME_HIGH` word that may be taken.
    pub time_last: u32,
    /// Offset of the current `TIME_HIGH` from the window's start. It wraps if that time is before the window, while
    /// the events with it lie in the window all the same.
    pub span_us: u32,
    /// Slot of the first event after the current `TIME_HIGH`.
    pub span_at: u32,
    /// Offset of the latest earlier `TIME_HIGH` that has events.
    pub before_us: u32,
    /// Slot of the first of these events.
    pub before_at: u32,
}

impl Intake<'_> {
    /// Stores events on the sensor while there are free slots, and follows the time. Stops at the first word that
    /// is neither an event it can store nor a time it may step to. Returns the number of words taken.
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

    /// As [`Self::take`], into slots in the order of arrival; heads and bitmap are left alone.
    #[inline]
    pub fn take_in_order(&mut self, height: u16, words: &[[u8; 4]]) -> usize {
        #[cfg(eecvs_intake_asm)]
        use armv7em::take_in_order as take;
        #[cfg(not(eecvs_intake_asm))]
        use in_order::take;
        take(self, height, words)
    }
}
