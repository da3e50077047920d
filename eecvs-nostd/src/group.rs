//! Groups a closed window's events by pixel, in raster order, without an array of the sensor's
//! size.
//!
//! The window holds a list per segment of 32 columns. One segment at a time is dealt into 32
//! column lists; since the segment's list is newest first, each column's comes out oldest first.

use core::mem;

use crate::fixed_point::CHUNK_EVENTS;
use crate::phase::PhaseScale;
use crate::transform::Impulse;
use crate::window::{Head, SEGMENT_PIXELS, Slot, Window};

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

/// What a column of the current segment holds.
#[derive(Debug, Clone, Copy)]
struct Column {
    /// Index + 1 of its first event; 0 where it has none.
    head: u32,
    tally: Tally,
}

impl Column {
    const EMPTY: Self = Self { head: 0, tally: 0 };
}

/// ON events in the lower half, all events in the upper one: a window has no more events than a
/// [`Head`] counts.
#[cfg(all(target_os = "none", target_pointer_width = "32"))]
type Tally = u32;
#[cfg(not(all(target_os = "none", target_pointer_width = "32")))]
type Tally = u64;
const _: () = assert!(2 * size_of::<Head>() == size_of::<Tally>());

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
    /// Empty where `columns` has no bit.
    column: [Column; 32],
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
            column: [Column::EMPTY; 32],
        }
    }

    /// Starts over, for the next window.
    pub const fn restart(&mut self) {
        *self = Self::new();
    }

    /// The next pixel; `None` after the last.
    // A tally is wider than 32 bits on some targets.
    #[allow(clippy::unnecessary_cast)]
    #[inline]
    pub fn next(&mut self, window: &mut Window<'_>) -> Option<Pixel> {
        if self.columns == 0 {
            self.next_segment(window)?;
        }
        let column = self.columns.trailing_zeros();
        self.columns &= self.columns - 1;
        let Column { head, tally } =
            mem::replace(&mut self.column[column as usize % 32], Column::EMPTY);
        let on = (tally & Tally::from(Head::MAX)) as u32;
        let events = (tally >> Head::BITS) as u32;
        Some(Pixel {
            x: self.segment_x + column as u16,
            y: self.segment_y,
            on,
            off: events - on,
            head,
        })
    }

    /// Makes the pixel that [`Self::next`] gave last the next one again.
    pub const fn put_back(&mut self, pixel: Pixel) {
        let column = pixel.x % SEGMENT_PIXELS;
        self.columns |= 1 << column;
        self.column[column as usize] = Column {
            head: pixel.head,
            tally: ((pixel.on + pixel.off) as Tally) << Head::BITS | pixel.on as Tally,
        };
    }

    fn next_segment(&mut self, window: &mut Window<'_>) -> Option<()> {
        if self.segments == 0 {
            (self.first_segment, self.segments) = window.take_segments(&mut self.cursor)?;
        }
        let segment = self.first_segment + self.segments.trailing_zeros();
        self.segments &= self.segments - 1;
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
            let column = &mut self.column[column as usize];
            let next = slot.next();
            *slot = slot.with_next(column.head);
            *column = Column {
                head,
                tally: column.tally + (1 << Head::BITS) + Tally::from(slot.is_on()),
            };
            head = next;
        }
        self.columns = columns;
    }
}

impl Default for Group {
    fn default() -> Self {
        Self::new()
    }
}

/// A pixel's events as impulses, a chunk at a time.
#[derive(Debug)]
pub struct Chunks<'s> {
    slots: &'s [Slot],
    next: u32,
    scale: PhaseScale,
}

impl<'s> Chunks<'s> {
    /// The events of `pixel` in a window of `scale`'s duration.
    #[must_use]
    pub const fn new(pixel: Pixel, slots: &'s [Slot], scale: PhaseScale) -> Self {
        Self {
            slots,
            next: pixel.head,
            scale,
        }
    }

    /// Fills `impulses` with the next events and returns those filled; empty at the end.
    pub fn fill<'i>(&mut self, impulses: &'i mut [Impulse; CHUNK_EVENTS]) -> &'i [Impulse] {
        let mut len = 0;
        for impulse in impulses.iter_mut() {
            let Some(slot) = self.slots.get(self.next.wrapping_sub(1) as usize) else {
                break;
            };
            *impulse = Impulse {
                phase: self.scale.phase(slot.offset_us()),
                sign: slot.sign(),
            };
            self.next = slot.next();
            len += 1;
        }
        &impulses[..len]
    }
}
