//! Groups a closed window's events by pixel, in raster order, without an array of the sensor's size.
//!
//! The window holds one list per segment of 32 columns. The group splits one segment at a time into 32 column
//! lists. A segment's list is newest first, so each column's list comes out oldest first.

pub mod impulse;
pub mod lists;
pub(crate) mod sort;
#[allow(dead_code, reason = "assembly alone asks")]
pub(crate) mod source;

use core::mem;
use core::num::NonZeroU32;

pub use impulse::{Impulse, Impulses};

use crate::window::{FIRST, Head, NO_SLOT, SEGMENT_PIXELS, Slot, Window, index};

/// A pixel with events: its position and its event counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pixel {
    /// Column of the pixel, from 0.
    pub x: u16,
    /// Row of the pixel, from 0.
    pub y: u16,
    /// Number of ON events.
    pub on: u32,
    /// Number of OFF events.
    pub off: u32,
    /// Slot of the pixel's first event.
    pub(crate) head: u32,
}

/// The walk over the pixels of a closed window.
#[derive(Debug)]
pub struct Group {
    pub(crate) cursor: usize,
    /// The first of the current 32 segments.
    pub(crate) first_segment: u32,
    /// Those of the 32 segments that are still to be visited.
    pub(crate) segments: u32,
    pub(crate) segment_x: u16,
    pub(crate) segment_y: u16,
    /// Columns of the current segment that are still to be visited.
    pub(crate) columns: u32,
    /// [`Entry::EMPTY`] where `columns` has no bit set.
    pub(crate) entries: [Entry; 32],
    /// The segment after the current one, and its list. On a large sensor both lie far away in memory, so a host
    /// fetches them before it needs them.
    #[cfg(target_pointer_width = "64")]
    ahead: Option<(u32, u32)>,
}

/// The events of one column of a segment.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct Entry {
    /// Slot of the first event, or a number that no slot of a buffer has.
    pub(crate) head: u32,
    /// Counts of the events.
    pub(crate) tally: Tally,
}

impl Entry {
    const EMPTY: Self = Self {
        head: NO_SLOT,
        tally: 0,
    };
}

/// Number of events in the upper half, number of ON events in the lower half; a window has no more slots than fit.
#[cfg(all(target_os = "none", target_pointer_width = "32"))]
pub(crate) type Tally = u32;
#[cfg(not(all(target_os = "none", target_pointer_width = "32")))]
pub(crate) type Tally = u64;
/// A count of one event.
const EVENT: Tally = 1 << Head::BITS;
const _: () = assert!(Tally::BITS == 2 * Head::BITS);

impl Group {
    /// Creates a walk that has not started.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            cursor: 0,
            first_segment: 0,
            segments: 0,
            segment_x: 0,
            segment_y: 0,
            columns: 0,
            entries: [Entry::EMPTY; 32],
            #[cfg(target_pointer_width = "64")]
            ahead: None,
        }
    }

    /// Starts the walk over, for the next window.
    pub const fn restart(&mut self) {
        *self = Self::new();
    }

    /// Returns the next pixel, or `None` after the last.
    ///
    /// Inlined on a host, where storing fields one by one and loading them as one causes a stall.
    #[cfg_attr(target_pointer_width = "64", inline(always))]
    #[cfg_attr(not(target_pointer_width = "64"), inline)]
    pub fn next(&mut self, window: &mut Window<'_>) -> Option<Pixel> {
        let columns = match NonZeroU32::new(self.columns) {
            Some(columns) => columns,
            None => self.next_segment_apart::<true>(window)?,
        };
        let column = columns.trailing_zeros();
        self.columns = columns.get() & (columns.get() - 1);
        let entry = &mut self.entries[column as usize % 32];
        let Entry { head, tally } = mem::replace(entry, Entry::EMPTY);
        let on = index(tally as Head);
        Some(Pixel {
            x: self.segment_x + column as u16,
            y: self.segment_y,
            on,
            off: index((tally >> Head::BITS) as Head) - on,
            head,
        })
    }

    /// Does the same as [`Self::next`], but without counting events: the pixels have `on` and `off` of 0.
    #[inline]
    pub(crate) fn next_uncounted(&mut self, window: &mut Window<'_>) -> Option<Pixel> {
        let columns = match NonZeroU32::new(self.columns) {
            Some(columns) => columns,
            None => self.next_segment_apart::<false>(window)?,
        };
        let column = columns.trailing_zeros();
        self.columns = columns.get() & (columns.get() - 1);
        let head = &mut self.entries[column as usize % 32].head;
        Some(Pixel {
            x: self.segment_x + column as u16,
            y: self.segment_y,
            on: 0,
            off: 0,
            head: mem::replace(head, NO_SLOT),
        })
    }

    /// Returns the position of the pixel that [`Self::next`] will return, or `None` after the last.
    #[inline]
    pub fn peek(&mut self, window: &mut Window<'_>) -> Option<(u16, u16)> {
        if self.columns == 0 {
            self.columns = self.next_segment_apart::<true>(window)?.get();
        }
        let column = self.columns.trailing_zeros() as u16;
        Some((self.segment_x + column, self.segment_y))
    }

    /// Returns whether the next pixel is in row `y`.
    pub(crate) fn is_next_in_row(&mut self, window: &mut Window<'_>, y: u16) -> bool {
        self.peek(window).is_some_and(|(_, row)| row == y)
    }

    /// Returns whether the next pixel is in segment `segment` of row `y`.
    pub(crate) fn is_next_in_segment(
        &mut self,
        window: &mut Window<'_>,
        (segment, y): (u16, u16),
    ) -> bool {
        let next = self.peek(window);
        next.is_some_and(|(x, row)| (x / SEGMENT_PIXELS, row) == (segment, y))
    }

    /// Puts back the pixel that [`Self::next`] returned last, so that it is the next one again.
    pub const fn put_back(&mut self, pixel: Pixel) {
        let i = (pixel.x % SEGMENT_PIXELS) as usize;
        self.columns |= 1 << i;
        self.entries[i] = Entry {
            head: pixel.head,
            tally: (pixel.on + pixel.off) as Tally * EVENT + pixel.on as Tally,
        };
    }

    /// Takes the remaining columns of the current segment for a walk in assembly, or those of the next segment if
    /// none are left. Returns 0 after the last segment.
    #[allow(dead_code, reason = "assembly alone asks")]
    pub(crate) fn enter(&mut self, window: &mut Window<'_>) -> u32 {
        match mem::take(&mut self.columns) {
            0 => self
                .next_segment_apart::<true>(window)
                .map_or(0, NonZeroU32::get),
            columns => columns,
        }
    }

    #[inline(never)]
    fn next_segment_apart<const COUNTS: bool>(
        &mut self,
        window: &mut Window<'_>,
    ) -> Option<NonZeroU32> {
        self.next_segment::<COUNTS>(window)
    }

    /// Moves to the next segment and returns its columns.
    #[inline(always)]
    fn next_segment<const COUNTS: bool>(&mut self, window: &mut Window<'_>) -> Option<NonZeroU32> {
        #[cfg(target_pointer_width = "64")]
        let (segment, head) = {
            let here = match self.ahead {
                Some(here) => here,
                None => self.take_segment(window)?,
            };
            self.ahead = self.take_segment(window);
            here
        };
        #[cfg(not(target_pointer_width = "64"))]
        let (segment, head) = self.take_segment(window)?;
        (self.segment_x, self.segment_y) = window.segment_origin(segment);
        NonZeroU32::new(self.deal::<COUNTS>(head, window.slots()))
    }

    /// Returns the next segment that has events, and its list.
    #[inline(always)]
    pub(crate) fn take_segment(&mut self, window: &mut Window<'_>) -> Option<(u32, u32)> {
        if self.segments == 0 {
            (self.first_segment, self.segments) = window.take_segments(&mut self.cursor)?;
        }
        let segment = self.first_segment + self.segments.leading_zeros();
        self.segments ^= FIRST.rotate_right(segment);
        Some((segment, window.take_head(segment)))
    }

    /// Splits a segment's list into one list per column; returns the columns that have events.
    #[inline(always)]
    fn deal<const COUNTS: bool>(&mut self, mut head: u32, slots: &mut [Slot]) -> u32 {
        let mut columns = 0;
        // The end of a list is a number that no slot of a buffer has.
        while let Some(slot) = slots.get_mut(head as usize) {
            let column = slot.column();
            columns |= 1 << column;
            let entry = &mut self.entries[column as usize];
            if COUNTS {
                entry.tally += EVENT + Tally::from(slot.sign());
            }
            let first = mem::replace(&mut entry.head, head);
            head = slot.next();
            *slot = slot.with_next(first);
        }
        columns
    }
}

impl Default for Group {
    fn default() -> Self {
        Self::new()
    }
}
