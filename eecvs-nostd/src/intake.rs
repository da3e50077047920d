//! EVT 2.0 words into a window's slots: the loop that every event passes.

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
        portable::take(self, words)
    }
}

/// On any core.
mod portable {
    use super::Intake;
    use crate::evt2::{KIND_SHIFT, NO_EVENT, SIDE_MASK, X_SHIFT, low_us, time_step_us};
    use crate::window::{COLUMN_BITS, COLUMN_SHIFT, FIRST, Head, Slot, index};

    pub fn take(intake: &mut Intake<'_>, words: &[[u8; 4]]) -> usize {
        let mut rest = words;
        loop {
            let events = intake.take_events(rest);
            rest = rest.get(events..).unwrap_or_default();
            let Some((word, after)) = rest.split_first() else {
                break;
            };
            let word = u32::from_le_bytes(*word);
            if word < intake.time || word > intake.time_last {
                break;
            }
            intake.step(word);
            rest = after;
        }
        words.len() - rest.len()
    }

    impl Intake<'_> {
        /// Steps to a `TIME_HIGH`.
        #[inline(always)]
        fn step(&mut self, time: u32) {
            if self.len != self.span_at {
                (self.before_us, self.before_at) = (self.span_us, self.span_at);
                self.span_at = self.len;
            }
            self.span_us += time_step_us(self.time, time);
            self.time = time;
        }

        /// Stores events up to the first word that is none on the sensor; returns how many.
        #[inline(always)]
        fn take_events(&mut self, words: &[[u8; 4]]) -> usize {
            let before = self.len;
            let width = u32::from(self.width) << X_SHIFT;
            let free = self.slots.get_mut(self.len as usize..).unwrap_or_default();
            for (word, slot) in words.iter().zip(free) {
                let word = u32::from_le_bytes(*word);
                // x is compared where it is in the word, together with the bits that an event has not.
                let x = word & (NO_EVENT | (SIDE_MASK << X_SHIFT) | SIDE_MASK);
                if x >= width {
                    break;
                }
                // An x on the sensor makes the segment's index tell whether y is.
                let segment =
                    (word & SIDE_MASK) * self.stride.get() + (x >> (X_SHIFT + COLUMN_BITS));
                let Some(head) = self.heads.get_mut(segment as usize) else {
                    break;
                };
                let next = index(*head);
                // The head of an empty list is more than any slot.
                if next >= self.len
                    && let Some(bits) = self.bitmap.get_mut(segment as usize / 32)
                {
                    *bits |= FIRST.rotate_right(segment);
                }
                let x =
                    (word >> (X_SHIFT - COLUMN_SHIFT)) & (((1 << COLUMN_BITS) - 1) << COLUMN_SHIFT);
                *slot = Slot::new(
                    self.span_us.wrapping_add(low_us(word)),
                    next,
                    x | (word >> KIND_SHIFT),
                );
                *head = self.len as Head;
                self.len += 1;
            }
            (self.len - before) as usize
        }
    }
}
