//! What the dense coder's walk in assembly, [`super::dense_walk_dsp`], begins a row with, and what it leaves
//! to Rust: the same as [`super::dense`] and [`super::dense_times`] code, to the bit.
//!
//! The compiler has fewer registers than the coder has state and keeps most of it on the stack. What an
//! encoder knows beforehand also makes the walk shorter: which column is the next with events, so that
//! the quiet ones before it need not be looked up, and what all columns see. The assembly leaves to the
//! loop in Rust what it would have to look at twice: events out of order, and the end of the output; and
//! to [`follow`] the events of pixels in rows that follow.
#![allow(unsafe_code)]

use core::cell::Cell;
use core::mem::offset_of;

use super::dense_times::{Clock, EVENT_BYTES_MAX, FIRST_BITS, Following, Times};
use super::dense_walk_dsp::{FLAG, FULL, LEFT, ROW, walk_row, walk_row_after};
use super::dense_walk_state_dsp::Walk;
use super::model::Model;
use super::range::{FINISH_BYTES, PLAIN_BITS, RangeParts};
use crate::event::Sensor;
use crate::group::{Group, Pixel};
use crate::window::{NEXT_SHIFT, SEGMENT_PIXELS, Window};

/// An encoder's window, and how far it is coded.
pub struct Parts<'p, 'w> {
    pub(crate) group: &'p mut Group,
    pub(crate) window: &'p mut Window<'w>,
    /// Events left of the window.
    pub(crate) left: &'p mut u32,
    /// The pixel at which the output is full, its next slot, and whether there is one.
    pub(crate) pixel: &'p mut Option<Pixel>,
    pub(crate) at: &'p mut u32,
    pub(crate) rest: &'p mut u32,
}

/// What is done with an encoder's window: a closure that is always inlined.
pub trait Walks {
    /// Does it.
    fn walk(self, parts: Parts<'_, '_>) -> Walked;
}

/// How far a row was coded.
pub struct Walked {
    /// Its first segment that was not coded as a whole.
    pub segment: usize,
    /// That one's first column that was not visited; `None` where its flag was not coded.
    pub column: Option<u32>,
    /// What was made of it.
    pub occupied: u32,
    pub first_on: u32,
    pub last_on: u32,
    /// Events and pixels coded.
    pub events: u32,
    pub pixels: u32,
    /// The loop in Rust has to see to what is left; else the window's last event was coded, or the output
    /// is full.
    pub goes_on: bool,
}

impl Walked {
    const NOTHING: Self = Self {
        segment: 0,
        column: None,
        occupied: 0,
        first_on: 0,
        last_on: 0,
        events: 0,
        pixels: 0,
        goes_on: true,
    };
}

/// What the assembly does not do itself: going on to the next segment, and the events of pixels in rows
/// that follow.
pub(super) struct Advance<'p, 'w> {
    parts: Parts<'p, 'w>,
    y: usize,
    pixels: u32,
}

impl Advance<'_, '_> {
    /// The next segment of the row that has events, beyond all where there is none.
    #[inline(always)]
    fn segment(&mut self) -> u32 {
        match self.parts.group.peek(self.parts.window) {
            Some((x, row)) if usize::from(row) == self.y => u32::from(x / SEGMENT_PIXELS),
            _ => u32::MAX,
        }
    }
}

/// Counts the pixels of a segment and goes to the next that has events.
pub(super) unsafe extern "C" fn advance(advance: &mut Advance<'_, '_>, occupied: u32) -> u32 {
    advance.pixels += occupied.count_ones();
    advance.segment()
}

/// Bytes that a segment's flags and an event take at the most, beyond what is asked for before an event.
pub const FLAGS_BYTES_MAX: usize = 48;
/// Bits of cells that the assembly takes at the most: the plain ones of a first cell are coded at once, and
/// those of a distance, which are one more, at once but for the last.
const BITS_MAX: u32 = FIRST_BITS + PLAIN_BITS;

/// The row above the first.
static ZEROS: [u32; SEGMENTS_MAX] = [0; SEGMENTS_MAX];
/// Segments of the widest sensor's row.
const SEGMENTS_MAX: usize = Sensor::SIDE_MAX as usize / SEGMENT_PIXELS as usize;

/// What the walk over a row needs.
pub(super) struct RowWalk<'r> {
    pub(super) walk: &'r mut Walk,
    pub(super) coder: RangeParts<'r>,
    pub(super) model: &'r mut Model,
    pub(super) clock: &'r mut Clock,
    /// The sensor's.
    pub(super) lists: &'r mut [u32],
    pub(super) lasts: &'r mut [u32],
    pub(super) words: &'r Words<'r>,
    /// The row, how many columns it has, and what it does with its neighbours' times.
    pub(super) place: (usize, usize, Following),
    pub(super) has_previous: bool,
}

impl Walks for RowWalk<'_> {
    /// Codes all segments of a row, or those up to where it ends.
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
            place: (y, width, following),
            has_previous,
        } = self;
        let stride = width.div_ceil(SEGMENT_PIXELS as usize);
        if stride != words.here.len()
            || stride == 0
            || stride > ZEROS.len()
            || lists.len() < width
            || lasts.len() < width
        {
            return Walked::NOTHING;
        }
        let seen =
            |row: Option<&[Cell<u32>]>| row.map_or(ZEROS.as_ptr(), |row| row.as_ptr().cast());
        walk.north_row = seen(words.north);
        walk.north_on_row = seen(words.north_on);
        walk.far_north_row = seen(words.far_north);
        walk.south_row = seen(words.south);
        let made = |row: &[Cell<u32>]| row.as_ptr().cast::<u32>().cast_mut();
        walk.here_row = made(words.here);
        walk.here_on_row = made(words.here_on);
        walk.last_on_row = made(words.last_here);
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
        walk.more = model.times.more.as_mut_ptr();
        walk.flips = model.times.flips.as_mut_ptr();
        walk.first = &raw mut model.times.first;
        walk.distances = model.times.distances.as_mut_ptr();
        walk.all_lists = lists.as_mut_ptr();
        walk.all_lasts = lasts.as_mut_ptr();
        (walk.segment, walk.last_segment) = (0, stride as u32 - 1);
        walk.last_columns = (width - SEGMENT_PIXELS as usize * (stride - 1)) as u32;
        (walk.made, walk.made_on, walk.last_on) = (0, 0, 0);
        walk.last_length = clock.last_length;
        walk.left = *parts.left;
        walk.follows = u32::from(following != Following::Not);
        walk.tries = u32::from(following == Following::Tries);
        walk.prefixes = model.times.prefixes.as_mut_ptr();
        walk.lengths = model.times.lengths.as_mut_ptr();
        walk.trials = (&raw mut model.times)
            .cast::<u8>()
            .wrapping_add(offset_of!(Times, trials))
            .cast();
        let mut advance = Advance {
            parts,
            y,
            pixels: 0,
        };
        walk.ahead = advance.segment();
        walk.columns_told = &raw mut advance.parts.group.columns;
        walk.advance = (&raw mut advance).cast();
        // SAFETY: the pointers are those of exclusive references that outlive the call, of cells that only
        // this writes while it runs, or of zeros, which it reads. The assembly reads and writes as many
        // words of the rows as there are segments; entries of columns below 32 and slots at their heads and
        // links, all of which `Group` has made of slots that are there; lists and last events of the
        // sensor's columns, and reads the last event to the west of one that has it, which is no sensor's
        // first. Its contexts are sums of bounded parts, as the twin's in Rust, and its symbols those of
        // cells below `clock.cells`, where those of a window's events are. It writes bytes from `out` on,
        // where there is room for a segment's flags and first event from `pixel_room` on, and for another
        // event from `room` on. `advance` and `follow` have the only references to the group, the window,
        // the clock and the times while they run. The build script sets `eecvs_dsp` only for cores that
        // have the instructions.
        let how = unsafe {
            if has_previous {
                walk_row_after(walk)
            } else {
                walk_row(walk)
            }
        };
        let Advance { parts, pixels, .. } = advance;
        clock.last_length = walk.last_length;
        let mut walked = Walked {
            segment: walk.segment as usize,
            column: None,
            occupied: 0,
            first_on: 0,
            last_on: walk.last_on,
            goes_on: true,
            events: *parts.left - walk.left,
            pixels,
        };
        *parts.left = walk.left;
        (*coder.range, *coder.low) = (walk.range, walk.low);
        // Both are of one slice, the first not below the second.
        *coder.len = walk.out.addr() - out.addr();
        match how {
            ROW => walked.segment += 1,
            FLAG => {}
            _ => {
                parts.group.columns = walk.told;
                walked.occupied = walk.told_all & !walk.told;
                walked.first_on = walk.first_on;
                walked.column = Some(walk.column);
                walked.pixels += walked.occupied.count_ones();
                if how != LEFT {
                    walked.goes_on = false;
                    walked.last_on |= (walk.link & 1) << (walk.column & 31);
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
        }
        walked
    }
}

/// Words of the rows around one, each with all its segments.
pub struct Words<'r> {
    /// Of the row above: occupied columns, and polarities of first events.
    pub north: Option<&'r [Cell<u32>]>,
    pub north_on: Option<&'r [Cell<u32>]>,
    /// The one above that, and the one below in the window before.
    pub far_north: Option<&'r [Cell<u32>]>,
    pub south: Option<&'r [Cell<u32>]>,
    /// Here, where those of the window before are, and the polarities of last events.
    pub here: &'r [Cell<u32>],
    pub here_on: &'r [Cell<u32>],
    pub last_here: &'r [Cell<u32>],
}

/// Whether a row's walk is made for these cells.
pub(super) const fn serves(clock: &Clock) -> bool {
    clock.beside_bits == 0 && clock.bits > FIRST_BITS && clock.bits <= BITS_MAX
}
