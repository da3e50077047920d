//! Lists of impulses in slots, laid out like those of a window's pixels, for measurements and tests of a single
//! stage.

use crate::group::Impulses;
use crate::group::impulse::Impulse;
use crate::window::{NO_SLOT, SLOTS_MAX, Slot};

/// Builds lists one after the other.
#[derive(Debug)]
pub struct Lists<'s> {
    slots: &'s mut [Slot],
    used: usize,
}

impl<'s> Lists<'s> {
    /// Creates an empty set of lists with room for one impulse per slot, [`SLOTS_MAX`] at most.
    #[must_use]
    pub const fn new(slots: &'s mut [Slot]) -> Self {
        Self { slots, used: 0 }
    }

    /// Appends a list of `impulses` and returns its start, the number of impulses before it. Returns `None` and
    /// changes nothing if there is no room.
    pub fn push(&mut self, impulses: impl IntoIterator<Item = Impulse>) -> Option<usize> {
        let first = self.used;
        let mut end = first;
        for impulse in impulses {
            let slot = self.slots.get_mut(end).filter(|_| end < SLOTS_MAX)?;
            end += 1;
            *slot = Slot::new(impulse.offset_us, end as u32, u32::from(impulse.is_on));
        }
        if let Some(last) = self.slots.get_mut(first..end)?.last_mut() {
            *last = last.with_next(NO_SLOT);
        }
        self.used = end;
        Some(first)
    }

    /// Returns all lists so far.
    #[must_use]
    pub fn laid_out(&self) -> LaidOut<'_> {
        LaidOut(self.slots.get(..self.used).unwrap_or_default())
    }
}

/// Completed lists.
#[derive(Debug, Clone, Copy)]
pub struct LaidOut<'s>(&'s [Slot]);

impl<'s> LaidOut<'s> {
    /// Returns the impulses from the one at `first` to the last of its list; none if no list holds `first`.
    #[inline(always)]
    #[must_use]
    pub const fn impulses(self, first: usize) -> Impulses<'s> {
        Impulses::from_slot(self.0, first as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impulses_come_back_until_there_is_no_room() {
        let impulse = |offset_us| Impulse {
            offset_us,
            is_on: offset_us % 3 == 1,
        };
        let mut slots = [Slot::EMPTY; 7];
        let mut lists = Lists::new(&mut slots);
        assert_eq!(lists.push((0..3).map(impulse)), Some(0));
        assert_eq!(lists.push([]), Some(3));
        assert_eq!(lists.push((10..15).map(impulse)), None);
        assert_eq!(lists.push((20..24).map(impulse)), Some(3));
        assert_eq!(lists.push([impulse(9)]), None);
        for (first, expected) in [(0, 0..3), (3, 20..24), (5, 22..24), (7, 0..0)] {
            let found = lists.laid_out().impulses(first);
            assert_eq!(found.is_empty(), expected.is_empty());
            assert!(found.eq(expected.map(impulse)), "{first}");
        }
    }
}
