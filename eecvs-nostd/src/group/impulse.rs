//! A pixel's events as the transforms see them.

use crate::group::Pixel;
use crate::window::Slot;

/// One event as the transforms see it: p * delta(t - t0 - offset).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Impulse {
    /// t - t0 in microseconds.
    pub offset_us: u32,
    /// p = +1.
    pub is_on: bool,
}

/// A pixel's events, oldest first.
///
/// `next` and what it links are slots that are there, or the end of the list.
#[derive(Debug, Clone)]
pub struct Impulses<'s> {
    slots: &'s [Slot],
    next: u32,
}

impl<'s> Impulses<'s> {
    /// The events of `pixel`, which a group has made of these slots.
    #[inline(always)]
    #[must_use]
    pub(crate) const fn new(pixel: Pixel, slots: &'s [Slot]) -> Self {
        Self::from_slot(slots, pixel.head)
    }

    /// The events from the slot `next` on, of a list in `slots`.
    #[inline(always)]
    pub(crate) const fn from_slot(slots: &'s [Slot], next: u32) -> Self {
        Self { slots, next }
    }

    /// Whether there is none.
    #[inline(always)]
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.next as usize >= self.slots.len()
    }

    /// The slots, and which of them is next.
    #[allow(dead_code, reason = "assembly alone asks")]
    #[inline(always)]
    pub(crate) const fn parts(&self) -> (&'s [Slot], u32) {
        (self.slots, self.next)
    }

    /// Those from the slot `next` on, which is one of theirs, or the end.
    #[allow(dead_code, reason = "assembly alone asks")]
    #[inline(always)]
    pub(crate) const fn after(&self, next: u32) -> Self {
        Self::from_slot(self.slots, next)
    }
}

impl Iterator for Impulses<'_> {
    type Item = Impulse;

    #[inline(always)]
    fn next(&mut self) -> Option<Impulse> {
        // The end of the list is a slot that no buffer has.
        let slot = self.slots.get(self.next as usize)?;
        self.next = slot.next();
        Some(Impulse {
            offset_us: slot.offset_us(),
            is_on: slot.is_on(),
        })
    }
}
