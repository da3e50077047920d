//! A pixel's events in the form that the transforms use.

use crate::group::Pixel;
use crate::window::Slot;

/// An event as the transforms see it: p delta(t - t0 - `offset_us`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Impulse {
    /// t - t0 in microseconds, below T.
    pub offset_us: u32,
    /// Polarity: `true` for p = +1, `false` for p = -1.
    pub is_on: bool,
}

/// Iterator over a pixel's events, oldest first.
///
/// `next`, and each slot that the list links, is an existing slot or the end of the list.
#[derive(Debug, Clone)]
pub struct Impulses<'s> {
    slots: &'s [Slot],
    next: u32,
}

impl<'s> Impulses<'s> {
    /// Creates the iterator over the events of `pixel`, which a group has found in these slots.
    #[inline(always)]
    #[must_use]
    pub(crate) const fn new(pixel: Pixel, slots: &'s [Slot]) -> Self {
        Self::from_slot(slots, pixel.head)
    }

    /// Creates the iterator over a list in `slots`, from the slot `next` on.
    #[inline(always)]
    pub(crate) const fn from_slot(slots: &'s [Slot], next: u32) -> Self {
        Self { slots, next }
    }

    /// Returns whether no event is left.
    #[inline(always)]
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.next as usize >= self.slots.len()
    }

    /// Returns the slots and the number of the next one.
    #[allow(dead_code, reason = "assembly alone asks")]
    #[inline(always)]
    pub(crate) const fn parts(&self) -> (&'s [Slot], u32) {
        (self.slots, self.next)
    }

    /// Returns the events from the slot `next` on, which must be a slot of this list, or its end.
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
        // The end of the list is a number that no slot of a buffer has.
        let slot = self.slots.get(self.next as usize)?;
        self.next = slot.next();
        Some(Impulse {
            offset_us: slot.offset_us(),
            is_on: slot.is_on(),
        })
    }
}
