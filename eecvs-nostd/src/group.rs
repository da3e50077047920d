//! Groups a closed window's events by pixel, in raster order, without an array of the sensor's
//! size.
//!
//! The window holds a list per segment of 32 columns. One segment at a time is dealt into 32
//! column lists; since the segment's list is newest first, each column's comes out oldest first.

use core::mem;

use crate::transform::Impulse;
use crate::window::{Head, SEGMENT_PIXELS, Slot, Window, index};

/// A pixel with events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pixel {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// ON events.
    pub on: u32,
    /// OFF events.
    pub off: u32,
    /// Index + 1 of its first event.
    head: u32,
}

/// The walk over a window's pixels.
#[derive(Debug)]
pub struct Group {
    cursor: usize,
    /// First of the 32 segments at hand.
    first_segment: u32,
    /// Those of them still to be visited.
    segments: u32,
    segment_x: u16,
    segment_y: u16,
    /// Columns of the current segment still to be visited.
    columns: u32,
    /// By column, index + 1 of its first event; 0 where `columns` has no bit.
    heads: [u32; 32],
    /// By column, OFF and ON events: no more than a window has slots; 0 where it has none.
    counts: [Head; 64],
}

impl Group {
    /// A walk that has not started.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            cursor: 0,
            first_segment: 0,
            segments: 0,
            segment_x: 0,
            segment_y: 0,
            columns: 0,
            heads: [0; 32],
            counts: [0; 64],
        }
    }

    /// Starts over, for the next window.
    pub const fn restart(&mut self) {
        *self = Self::new();
    }

    /// The next pixel; `None` after the last.
    #[inline]
    pub fn next(&mut self, window: &mut Window<'_>) -> Option<Pixel> {
        if self.columns == 0 {
            self.next_segment(window)?;
        }
        let column = self.columns.trailing_zeros();
        self.columns &= self.columns.wrapping_sub(1);
        let i = column as usize % 32;
        Some(Pixel {
            x: self.segment_x + column as u16,
            y: self.segment_y,
            on: index(mem::take(&mut self.counts[2 * i + 1])),
            off: index(mem::take(&mut self.counts[2 * i])),
            head: mem::take(&mut self.heads[i]),
        })
    }

    /// Makes the pixel that [`Self::next`] gave last the next one again.
    pub const fn put_back(&mut self, pixel: Pixel) {
        let i = (pixel.x % SEGMENT_PIXELS) as usize;
        self.columns |= 1 << i;
        self.heads[i] = pixel.head;
        self.counts[2 * i] = pixel.off as Head;
        self.counts[2 * i + 1] = pixel.on as Head;
    }

    fn next_segment(&mut self, window: &mut Window<'_>) -> Option<()> {
        if self.segments == 0 {
            (self.first_segment, self.segments) = window.take_segments(&mut self.cursor)?;
        }
        let segment = self.first_segment + self.segments.trailing_zeros();
        self.segments &= self.segments.wrapping_sub(1);
        (self.segment_x, self.segment_y) = window.segment_origin(segment);
        let head = window.take_head(segment);
        self.deal(head, window.slots());
        Some(())
    }

    /// Turns a segment's list into one for each column.
    #[inline]
    fn deal(&mut self, mut head: u32, slots: &mut [Slot]) {
        let mut columns = 0;
        // A list ends with 0, whose index there is none of.
        while let Some(slot) = slots.get_mut(head.wrapping_sub(1) as usize) {
            let column = slot.column();
            columns |= 1 << column;
            self.counts[(2 * column + slot.sign()) as usize % 64] += 1;
            let first = mem::replace(&mut self.heads[column as usize], head);
            head = slot.next();
            *slot = slot.with_next(first);
        }
        self.columns = columns;
    }
}

impl Default for Group {
    fn default() -> Self {
        Self::new()
    }
}

/// A pixel's events, oldest first.
#[derive(Debug, Clone)]
pub struct Impulses<'s> {
    slots: &'s [Slot],
    next: u32,
}

impl<'s> Impulses<'s> {
    /// The events of `pixel`.
    #[inline(always)]
    #[must_use]
    pub const fn new(pixel: Pixel, slots: &'s [Slot]) -> Self {
        Self {
            slots,
            next: pixel.head,
        }
    }
}

impl Iterator for Impulses<'_> {
    type Item = Impulse;

    #[inline(always)]
    fn next(&mut self) -> Option<Impulse> {
        // 0, the end of the list, is turned into an index beyond any buffer.
        let slot = self.slots.get(self.next.wrapping_sub(1) as usize)?;
        self.next = slot.next();
        Some(Impulse {
            offset_us: slot.offset_us(),
            is_on: slot.is_on(),
        })
    }
}
