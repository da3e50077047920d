//! Pixels that are never sent: a sorted list in lent memory, so that a sensor of any size takes four
//! bytes a hot pixel and no mask.

use crate::window::{SEGMENT_PIXELS, Window};

/// The memory has no room for a further pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoRoom;

const COLUMNS: u32 = SEGMENT_PIXELS as u32;

/// The pixels of one sensor.
#[derive(Debug)]
pub struct HotPixels<'b> {
    /// Where they lie, ascending: 32 times a segment's number, and the column in it.
    places: &'b mut [u32],
    count: usize,
}

impl<'b> HotPixels<'b> {
    /// None, in memory for as many as it has words.
    #[must_use]
    pub const fn new(places: &'b mut [u32]) -> Self {
        Self { places, count: 0 }
    }

    /// Forgets all of them.
    pub const fn clear(&mut self) {
        self.count = 0;
    }

    /// How many there are.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.count
    }

    /// Adds column `x` and row `y` of a sensor of `width` columns; one that is there stays as it is.
    ///
    /// # Errors
    /// [`NoRoom`].
    pub fn add(&mut self, (x, y): (u16, u16), width: u16) -> Result<(), NoRoom> {
        let stride = u32::from(width.div_ceil(SEGMENT_PIXELS));
        let place = u32::from(y) * stride * COLUMNS + u32::from(x);
        let at = match self.all().binary_search(&place) {
            Ok(_) => return Ok(()),
            Err(at) => at,
        };
        // They mostly come in order, and then nothing moves.
        let moved = self.places.get_mut(at..=self.count).ok_or(NoRoom)?;
        let mut carried = place;
        for place in moved {
            core::mem::swap(place, &mut carried);
        }
        self.count += 1;
        Ok(())
    }

    fn all(&self) -> &[u32] {
        self.places.get(..self.count).unwrap_or_default()
    }

    /// Keeps their events out of a closed window; returns how many.
    pub(crate) fn remove(&self, window: &mut Window<'_>) -> u32 {
        let mut rest = self.all().iter().copied().peekable();
        let mut removed = 0;
        while let Some(place) = rest.peek() {
            let Some(segment) = window.next_used(place / COLUMNS) else {
                break;
            };
            let mut columns = 0;
            while let Some(place) = rest.next_if(|place| place / COLUMNS <= segment) {
                if place / COLUMNS == segment {
                    columns |= 1 << (place % COLUMNS);
                }
            }
            if columns != 0 {
                removed += window.keep_columns(segment, !columns);
            }
        }
        removed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;
    use std::vec::Vec;

    proptest! {
        /// The list is the set of what was added, in raster order, up to its room.
        #[test]
        fn a_set_in_order(
            width in 1_u16..100, room in 0_usize..30,
            pixels in proptest::collection::vec((0_u16..100, 0_u16..9), 0..60),
        ) {
            let mut memory = [0; 30];
            let mut hot = HotPixels::new(&mut memory[..room]);
            let mut set = BTreeSet::new();
            for (x, y) in pixels {
                let x = x % width;
                let fits = set.contains(&(y, x)) || set.len() < room;
                prop_assert_eq!(hot.add((x, y), width).is_ok(), fits);
                if fits {
                    set.insert((y, x));
                }
            }
            prop_assert_eq!(hot.count(), set.len());
            let stride = u32::from(width.div_ceil(32)) * 32;
            let places: Vec<_> =
                set.iter().map(|(y, x)| u32::from(*y) * stride + u32::from(*x)).collect();
            prop_assert_eq!(hot.all(), places);
            hot.clear();
            prop_assert_eq!(hot.count(), 0);
        }
    }
}
