//! In Rust, for hosts.

use super::Intake;
use crate::window::{COLUMN_BITS, COLUMN_SHIFT, FIRST, Head, Slot, index};
use event_types::evt2::{KIND_SHIFT, NO_EVENT, SIDE_MASK, X_SHIFT, low_us, time_step_us};

/// Implements [`Intake::take`].
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
    /// Steps to a later `TIME_HIGH`.
    #[inline(always)]
    fn step(&mut self, time: u32) {
        if self.len != self.span_at {
            (self.before_us, self.before_at) = (self.span_us, self.span_at);
            self.span_at = self.len;
        }
        self.span_us += time_step_us(self.time, time);
        self.time = time;
    }

    /// Stores events up to the first word that is not an event on the sensor; returns how many it stored.
    #[inline(always)]
    fn take_events(&mut self, words: &[[u8; 4]]) -> usize {
        let before = self.len;
        let free = self.slots.get_mut(self.len as usize..).unwrap_or_default();
        let segments = Segments {
            heads: self.heads,
            bitmap: self.bitmap,
            width: u32::from(self.width) << X_SHIFT,
            stride: self.stride.get(),
            span_us: self.span_us,
            len: self.len,
        };
        self.len = segments.take(words, free);
        (self.len - before) as usize
    }
}

/// What is needed to store an event.
struct Segments<'w> {
    heads: &'w mut [Head],
    bitmap: &'w mut [u32],
    /// Width of the sensor, shifted to where x is in a word.
    width: u32,
    stride: u32,
    span_us: u32,
    len: u32,
}

impl Segments<'_> {
    #[inline(always)]
    fn take(mut self, words: &[[u8; 4]], slots: &mut [Slot]) -> u32 {
        for (word, slot) in words.iter().zip(slots) {
            if !self.event(u32::from_le_bytes(*word), slot) {
                break;
            }
        }
        self.len
    }

    /// Stores the word's event if it is on the sensor; returns `false` for any other word.
    #[inline(always)]
    fn event(&mut self, word: u32, slot: &mut Slot) -> bool {
        // x is compared in place, together with the bits that are never set in an event.
        let x = word & (NO_EVENT | (SIDE_MASK << X_SHIFT) | SIDE_MASK);
        // Once x is known to be on the sensor, the segment's index shows whether y is.
        let segment = (word & SIDE_MASK) * self.stride + (x >> (X_SHIFT + COLUMN_BITS));
        let is_outside = (x >= self.width) | (segment as usize >= self.heads.len());
        let (false, Some(head)) = (is_outside, self.heads.get_mut(segment as usize)) else {
            return false;
        };
        let next = index(*head);
        // The head of an empty list is larger than any slot's number.
        if next >= self.len {
            mark(self.bitmap, segment);
        }
        let x = (word >> (X_SHIFT - COLUMN_SHIFT)) & (((1 << COLUMN_BITS) - 1) << COLUMN_SHIFT);
        *slot = Slot::new(
            self.span_us.wrapping_add(low_us(word)),
            next,
            x | (word >> KIND_SHIFT),
        );
        *head = self.len as Head;
        self.len += 1;
        true
    }
}

/// Notes that a segment has its first event.
#[inline(always)]
fn mark(bitmap: &mut [u32], segment: u32) {
    if let Some(bits) = bitmap.get_mut(segment as usize / 32) {
        *bits |= FIRST.rotate_right(segment);
    }
}
