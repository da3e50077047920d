//! Groups a closed window's events by pixel, in raster order, without an array of the sensor's
//! size.
//!
//! The window holds a list per segment of 32 columns. One segment at a time is dealt into 32
//! column lists; since the segment's list is newest first, each column's comes out oldest first.

use crate::transform::Impulse;
use crate::window::{Slot, Window};

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
    segment_x: u16,
    segment_y: u16,
    /// Columns of the current segment still to be visited.
    columns: u32,
    heads: [u32; 32],
    on: [u32; 32],
    events: [u32; 32],
}

impl Group {
    /// A walk that has not started.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            cursor: 0,
            segment_x: 0,
            segment_y: 0,
            columns: 0,
            heads: [0; 32],
            on: [0; 32],
            events: [0; 32],
        }
    }

    /// Starts over, for the next window.
    pub const fn restart(&mut self) {
        self.cursor = 0;
        self.columns = 0;
    }

    /// The current pixel; `None` after the last.
    pub fn current(&mut self, window: &mut Window<'_>) -> Option<Pixel> {
        if self.columns == 0 {
            let (segment, head) = window.take_segment(&mut self.cursor)?;
            (self.segment_x, self.segment_y) = window.segment_origin(segment);
            self.deal(head, window.slots());
        }
        let column = self.columns.trailing_zeros() as usize;
        Some(Pixel {
            x: self.segment_x + column as u16,
            y: self.segment_y,
            on: self.on[column],
            off: self.events[column] - self.on[column],
            head: self.heads[column],
        })
    }

    /// Goes on to the next pixel.
    pub const fn advance(&mut self) {
        self.columns &= self.columns.wrapping_sub(1);
    }

    fn deal(&mut self, mut head: u32, slots: &mut [Slot]) {
        while head != 0 {
            let slot = &mut slots[head as usize - 1];
            let column = slot.column() as usize;
            let next = slot.next();
            if (self.columns >> column) & 1 == 0 {
                self.columns |= 1 << column;
                self.heads[column] = 0;
                self.on[column] = 0;
                self.events[column] = 0;
            }
            *slot = slot.with_next(self.heads[column]);
            self.heads[column] = head;
            self.on[column] += u32::from(slot.is_on());
            self.events[column] += 1;
            head = next;
        }
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
