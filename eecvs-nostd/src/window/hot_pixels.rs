//! Pixels that are never sent, as a sorted list in lent memory.
//!
//! The list takes four bytes per hot pixel on a sensor of any size, and no mask.

use crate::window::{SEGMENT_PIXELS, Window};

/// The lent memory has no room for a further pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoRoom;

const COLUMNS: u32 = SEGMENT_PIXELS as u32;

/// Returns the position of a pixel of a sensor of `width` columns, as [`HotPixels`] keeps it.
fn place((x, y): (u16, u16), width: u16) -> u32 {
    let stride = u32::from(width.div_ceil(SEGMENT_PIXELS));
    u32::from(y) * stride * COLUMNS + u32::from(x)
}

/// The hot pixels of one sensor.
#[derive(Debug)]
pub struct HotPixels<'b> {
    /// Positions of the pixels, ascending: 32 times the segment's number, plus the column within the segment.
    places: &'b mut [u32],
    count: usize,
}

impl<'b> HotPixels<'b> {
    /// Creates an empty list in lent memory, with room for one pixel per word.
    #[must_use]
    pub const fn new(places: &'b mut [u32]) -> Self {
        Self { places, count: 0 }
    }

    /// Removes all pixels from the list.
    pub const fn clear(&mut self) {
        self.count = 0;
    }

    /// Returns the number of pixels in the list.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.count
    }

    /// Adds the pixel in column `x` and row `y` of a sensor of `width` columns. Does nothing if it is already
    /// listed.
    ///
    /// # Errors
    /// [`NoRoom`] if the memory is full.
    pub fn add(&mut self, (x, y): (u16, u16), width: u16) -> Result<(), NoRoom> {
        let place = place((x, y), width);
        let at = match self.all().binary_search(&place) {
            Ok(_) => return Ok(()),
            Err(at) => at,
        };
        // Pixels mostly arrive in raster order, and then nothing moves.
        let moved = self.places.get_mut(at..=self.count).ok_or(NoRoom)?;
        let mut carried = place;
        for place in moved {
            core::mem::swap(place, &mut carried);
        }
        self.count += 1;
        Ok(())
    }

    /// Returns whether the list has a pixel of a sensor of `width` columns.
    pub(crate) fn contains(&self, pixel: (u16, u16), width: u16) -> bool {
        self.all().binary_search(&place(pixel, width)).is_ok()
    }

    fn all(&self) -> &[u32] {
        self.places.get(..self.count).unwrap_or_default()
    }

    /// Removes the listed pixels' events from a closed window; returns how many it removed.
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
        /// The list is the set of the pixels added, in raster order, as far as there is room.
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
