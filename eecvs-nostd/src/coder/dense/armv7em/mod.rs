//! Interface of the dense coder's assembly, [`walk`]: what it starts with and what it leaves to Rust. It codes the
//! same as [`dense`](super) and [`times`](super::times), to the bit.
//!
//! The compiler has fewer registers than the coder has state, and keeps most of it on the stack. The walk is also
//! shorter because an encoder knows more beforehand: which column is the next with events, so that the quiet ones
//! before it need not be looked up, and what all columns see. The assembly leaves to the loop in Rust what it would
//! have to look at twice: events out of order, and the end of the output. The code here moves it to the next
//! segment and to the next row.
#![allow(unsafe_code)]

pub(crate) mod state;
mod times;
mod walk;

use core::cell::Cell;
use core::mem::offset_of;
use core::ptr::null_mut;

use crate::coder::content;
use crate::coder::content::Parts;
use crate::coder::dense::armv7em::state::{FLAG, FULL, LEFT, ROW_FLAG, ROWS, Walk};
use crate::coder::dense::armv7em::walk::{walk_rows, walk_rows_after};
use crate::coder::dense::model::Model;
use crate::coder::dense::times::{Clock, EVENT_BYTES_MAX, FIRST_BITS, Following, LearnedTimes};
use crate::coder::dense::{Begun, Made, row_of, rows};
use crate::coder::range::{FINISH_BYTES, PLAIN_BITS, Probability, RangeParts};
use crate::group::Pixel;
use crate::window::{NEXT_SHIFT, SEGMENT_PIXELS};
use event_types::Sensor;

/// How far the assembly has coded rows.
pub struct Walked {
    /// The first row that was not coded as a whole; beyond all rows if there is none.
    pub y: usize,
    /// Whether the row above that has events.
    pub above_is_active: bool,
    /// How far that row was coded, if its flag was coded.
    pub(in crate::coder) begun: Option<Begun>,
    /// Number of events and pixels coded.
    pub events: u32,
    pub pixels: u32,
}

/// What the assembly leaves to Rust: moving to the next segment and to the next row.
pub(crate) struct Rows<'r, 'p, 'w> {
    parts: Parts<'p, 'w>,
    words: Words<'r>,
    stride: usize,
    height: usize,
    has_previous: bool,
    /// The current row, the one after it, and whether the current one has events.
    y: usize,
    next_y: usize,
    is_active: bool,
    above_is_active: bool,
    pixels: u32,
    flags: *mut [Probability; 4],
    times: *const LearnedTimes,
}

impl Rows<'_, '_, '_> {
    /// Returns the next segment of the row that has events; beyond all segments if there is none.
    #[inline(always)]
    fn segment(&mut self) -> u32 {
        match self.parts.group.peek(self.parts.window) {
            Some((x, row)) if usize::from(row) == self.y => u32::from(x / SEGMENT_PIXELS),
            _ => u32::MAX,
        }
    }

    /// Returns where a row's words begin.
    #[inline(always)]
    fn row(&self, y: usize) -> usize {
        row_of(y, self.has_previous) * self.stride
    }

    #[inline(always)]
    fn here(&self) -> &[Cell<u32>] {
        let here = self.words.occupied.get(self.row(self.y)..);
        let here = here.unwrap_or_default();
        here.get(..self.stride).unwrap_or_default()
    }
}

/// Counts the pixels of a segment and moves to the next segment with events.
pub(crate) unsafe extern "C" fn next_segment(rows: &mut Rows<'_, '_, '_>, occupied: u32) -> u32 {
    rows.pixels += occupied.count_ones();
    rows.segment()
}

/// Moves to the next row and sets `walk.ahead` to its first segment with events. Returns the probability of the
/// row's flag; null after the last row.
pub(crate) unsafe extern "C" fn next_row(
    rows: &mut Rows<'_, '_, '_>,
    walk: &mut Walk,
) -> *mut Probability {
    if rows.next_y > rows.y {
        // The current row was coded.
        if !rows.is_active {
            rows.here().iter().for_each(|word| word.set(0));
        }
        rows.above_is_active = rows.is_active;
    }
    rows.y = rows.next_y;
    if rows.y >= rows.height {
        return null_mut();
    }
    rows.next_y = rows.y + 1;
    let was_active = rows.has_previous && rows.here().iter().any(|word| word.get() != 0);
    walk.ahead = rows.segment();
    rows.is_active = walk.ahead != u32::MAX;
    let context = usize::from(rows.above_is_active) + 2 * usize::from(was_active);
    rows.flags.cast::<Probability>().wrapping_add(context)
}

/// Sets `walk` up for the current row.
pub(crate) unsafe extern "C" fn begin_row(rows: &mut Rows<'_, '_, '_>, walk: &mut Walk) {
    let (y, stride) = (rows.y, rows.stride);
    let occupied = rows.words.occupied.as_ptr().cast::<u32>();
    let here = rows.row(y);
    let above = |rows_above: usize| {
        if y < rows_above {
            ZEROS.as_ptr()
        } else {
            occupied.wrapping_add(rows.row(y - rows_above))
        }
    };
    walk.north_row = above(1);
    walk.far_north_row = above(2);
    walk.south_row = if rows.has_previous && y + 1 < rows.height {
        occupied.wrapping_add(here + stride)
    } else {
        ZEROS.as_ptr()
    };
    walk.here_row = occupied.wrapping_add(here).cast_mut();
    let last_on = rows.words.last_on.as_ptr().cast::<u32>();
    walk.last_on_row = last_on.wrapping_add(here).cast_mut();
    let first_on = rows.words.first_on.as_ptr().cast::<u32>();
    let first_here = (y % 2) * stride;
    walk.here_on_row = first_on.wrapping_add(first_here).cast_mut();
    walk.north_on_row = first_on.wrapping_add(stride - first_here);
    walk.segment = 0;
    (walk.made, walk.made_on, walk.last_on) = (0, 0, 0);
    // SAFETY: nothing else has a reference to the times while this runs.
    let following = unsafe { &*rows.times }.following(y);
    walk.follows = u32::from(following != Following::Not);
    walk.tries = u32::from(following == Following::Tries);
}

/// Most bytes that a segment's flags and an event take, beyond the room that is checked before an event.
pub const FLAGS_BYTES_MAX: usize = 48;
/// Most bits of cells that the assembly handles: it codes the plain bits of a first cell at once, and those of a
/// distance, one more, at once but for the last.
const BITS_MAX: u32 = FIRST_BITS + PLAIN_BITS;

/// Zeros, in place of rows beyond the sensor.
static ZEROS: [u32; SEGMENTS_MAX] = [0; SEGMENTS_MAX];
/// Segments in a row of the widest sensor.
const SEGMENTS_MAX: usize = Sensor::SIDE_MAX as usize / SEGMENT_PIXELS as usize;

/// Input of the walk over rows.
pub(crate) struct RowsWalk<'r> {
    pub(crate) walk: &'r mut Walk,
    pub(crate) coder: RangeParts<'r>,
    pub(crate) model: &'r mut Model,
    pub(crate) clock: &'r mut Clock,
    /// For each column of the sensor, the latest pixel's events and the last of these.
    pub(crate) lists: &'r mut [u32],
    pub(crate) lasts: &'r mut [u32],
    pub(crate) words: Words<'r>,
    pub(crate) sensor: Sensor,
    /// The first row, and whether the row above it has events.
    pub(crate) y: usize,
    pub(crate) above_is_active: bool,
    pub(crate) has_previous: bool,
}

impl content::Walk for RowsWalk<'_> {
    type Walked = Walked;

    /// Codes rows as far as the assembly goes.
    #[inline(always)]
    fn walk(self, parts: Parts<'_, '_>) -> Walked {
        let Self {
            walk,
            coder,
            model,
            clock,
            lists,
            lasts,
            words,
            sensor,
            y,
            above_is_active,
            has_previous,
        } = self;
        let (width, height) = (usize::from(sensor.width), usize::from(sensor.height));
        let stride = width.div_ceil(SEGMENT_PIXELS as usize);
        let rows = stride * rows(sensor, has_previous);
        let mut walked = Walked {
            y,
            above_is_active,
            begun: None,
            events: 0,
            pixels: 0,
        };
        if stride == 0
            || stride > ZEROS.len()
            || words.occupied.len() < rows
            || words.last_on.len() < rows
            || words.first_on.len() < 2 * stride
            || lists.len() < width
            || lasts.len() < width
        {
            return walked;
        }
        let out = coder.out.as_mut_ptr();
        let end = out.wrapping_add(coder.out.len());
        (walk.range, walk.low) = (*coder.range, *coder.low);
        (walk.start, walk.out) = (out, out.wrapping_add(*coder.len));
        walk.room = end.wrapping_sub(FINISH_BYTES + EVENT_BYTES_MAX);
        walk.pixel_room = walk.room.wrapping_sub(FLAGS_BYTES_MAX);
        walk.entries = parts.group.entries.as_mut_ptr();
        walk.slots = parts.window.slots().as_mut_ptr();
        walk.segments = model.segments.as_mut_ptr();
        walk.pixels = model.pixels.as_mut_ptr();
        walk.crowds = model.runs.as_mut_ptr().wrapping_add(31);
        walk.polarities = model.polarities.as_mut_ptr();
        let times = &raw mut model.times;
        // SAFETY: these are addresses of fields within what the pointer points to.
        unsafe {
            walk.more = (&raw mut (*times).more).cast();
            walk.flips = (&raw mut (*times).flips).cast();
            walk.first = &raw mut (*times).first;
            walk.distances = (&raw mut (*times).distances).cast();
            walk.prefixes = (&raw mut (*times).prefixes).cast();
            walk.lengths = (&raw mut (*times).lengths).cast();
        }
        walk.trials = times
            .cast::<u8>()
            .wrapping_add(offset_of!(LearnedTimes, trials))
            .cast();
        walk.all_lists = lists.as_mut_ptr();
        walk.all_lasts = lasts.as_mut_ptr();
        walk.last_segment = stride as u32 - 1;
        walk.last_columns = (width - SEGMENT_PIXELS as usize * (stride - 1)) as u32;
        walk.last_length = clock.last_length;
        walk.left = *parts.left;
        let mut rows = Rows {
            parts,
            words,
            stride,
            height,
            has_previous,
            y,
            next_y: y,
            is_active: false,
            above_is_active,
            pixels: 0,
            flags: &raw mut model.rows,
            times,
        };
        walk.columns_told = &raw mut rows.parts.group.columns;
        walk.rows = (&raw mut rows).cast();
        // SAFETY: the pointers come from exclusive references that outlive the call, from cells that only this
        // writes while it runs, or from zeros, which it only reads. The assembly reads and writes as many words of
        // the rows as there are segments; entries of columns below 32, and slots at their heads and links, all of
        // which `Group` has made of slots that exist; and lists and last events of the sensor's columns. It reads
        // the last event to the west only of a pixel that has events there, which a sensor's first column never
        // has. Its contexts are sums of bounded parts, as in the twin in Rust, and its symbols are those of cells
        // below `clock.cells`, where the cells of a window's events are. It writes bytes from `out` on; from
        // `pixel_room` on there is room for a row's and a segment's flags and a first event, and from `room` on for
        // another event. `next_segment`, `next_row` and `begin_row` have the only references to the group, the
        // window and the times while they run. This file is compiled only for cores that have the instructions.
        let how = unsafe {
            if has_previous {
                walk_rows_after(walk)
            } else {
                walk_rows(walk)
            }
        };
        let Rows {
            parts,
            pixels,
            y,
            above_is_active,
            ..
        } = rows;
        clock.last_length = walk.last_length;
        walked.y = y;
        walked.above_is_active = above_is_active;
        walked.events = *parts.left - walk.left;
        walked.pixels = pixels;
        *parts.left = walk.left;
        (*coder.range, *coder.low) = (walk.range, walk.low);
        // Both point into one slice, the first not below the second.
        *coder.len = walk.out.addr() - out.addr();
        if how == ROWS || how == ROW_FLAG {
            return walked;
        }
        let mut begun = Begun {
            segment: walk.segment as usize,
            column: None,
            made: Made {
                last_on: walk.last_on,
                ..Made::default()
            },
            goes_on: true,
            following: match (walk.follows, walk.tries) {
                (0, _) => Following::Not,
                (_, 0) => Following::Does,
                _ => Following::Tries,
            },
        };
        if how != FLAG {
            parts.group.columns = walk.told;
            begun.made.occupied = walk.told_all & !walk.told;
            begun.made.first_on = walk.first_on;
            begun.column = Some(walk.column);
            walked.pixels += begun.made.occupied.count_ones();
            if how != LEFT {
                begun.goes_on = false;
                begun.made.last_on |= (walk.link & 1) << (walk.column & 31);
            }
            let next = walk.link >> NEXT_SHIFT;
            if how == FULL && (next as usize) < parts.window.slots().len() {
                *parts.pixel = Some(Pixel {
                    x: (u32::from(SEGMENT_PIXELS) * walk.segment + walk.column) as u16,
                    y: y as u16,
                    on: 0,
                    off: 0,
                    head: next,
                });
                (*parts.at, *parts.rest) = (next, 1);
            }
        }
        walked.begun = Some(begun);
        walked
    }
}

/// Words of all rows that are kept: columns with events (from the current pixel on those of the window before), and
/// polarities of last events; and polarities of first events, of two rows.
pub(crate) struct Words<'r> {
    pub(crate) occupied: &'r [Cell<u32>],
    pub(crate) last_on: &'r [Cell<u32>],
    pub(crate) first_on: &'r [Cell<u32>],
}

/// Returns whether the walk can code these cells.
pub(crate) const fn serves(clock: &Clock) -> bool {
    clock.beside_bits == 0 && clock.bits > FIRST_BITS && clock.bits <= BITS_MAX
}
