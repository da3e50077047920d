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
use super::range::{FINISH_BYTES, RangeParts};
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
/// Bits of cells that the assembly takes at the most: their plain bits are coded at once.
const BITS_MAX: u32 = 16;

/// The row above the first.
static ZEROS: [u32; SEGMENTS_MAX] = [0; SEGMENTS_MAX];
/// Segments of the widest sensor's row.
const SEGMENTS_MAX: usize = Sensor::SIDE_MAX as usize / SEGMENT_PIXELS as usize;

impl Walk {
    /// Codes all segments of a row, or those up to where it ends.
    ///
    /// `lists` and `lasts` are the sensor's.
    #[inline(always)]
    pub(super) fn row(
        &mut self,
        (coder, parts): (RangeParts<'_>, Parts<'_, '_>),
        (model, clock): (&mut Model, &mut Clock),
        (lists, lasts): (&mut [u32], &mut [u32]),
        words: &Words<'_>,
        (y, width, following): (usize, usize, Following),
        has_previous: bool,
    ) -> Walked {
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
        self.north_row = seen(words.north);
        self.north_on_row = seen(words.north_on);
        self.far_north_row = seen(words.far_north);
        self.south_row = seen(words.south);
        let made = |row: &[Cell<u32>]| row.as_ptr().cast::<u32>().cast_mut();
        self.here_row = made(words.here);
        self.here_on_row = made(words.here_on);
        self.last_on_row = made(words.last_here);
        let out = coder.out.as_mut_ptr();
        let end = out.wrapping_add(coder.out.len());
        (self.range, self.low) = (*coder.range, *coder.low);
        (self.start, self.out) = (out, out.wrapping_add(*coder.len));
        self.room = end.wrapping_sub(FINISH_BYTES + EVENT_BYTES_MAX);
        self.pixel_room = self.room.wrapping_sub(FLAGS_BYTES_MAX);
        self.entries = parts.group.entries.as_mut_ptr();
        self.slots = parts.window.slots().as_mut_ptr();
        self.segments = model.segments.as_mut_ptr();
        self.pixels = model.pixels.as_mut_ptr();
        self.crowds = model.runs.as_mut_ptr().wrapping_add(31);
        self.polarities = model.polarities.as_mut_ptr();
        self.more = model.times.more.as_mut_ptr();
        self.flips = model.times.flips.as_mut_ptr();
        self.first = &raw mut model.times.first;
        self.distances = model.times.distances.as_mut_ptr();
        self.all_lists = lists.as_mut_ptr();
        self.all_lasts = lasts.as_mut_ptr();
        (self.segment, self.last_segment) = (0, stride as u32 - 1);
        self.last_columns = (width - SEGMENT_PIXELS as usize * (stride - 1)) as u32;
        (self.made, self.made_on, self.last_on) = (0, 0, 0);
        self.last_length = clock.last_length;
        self.left = *parts.left;
        self.follows = u32::from(following != Following::Not);
        self.tries = u32::from(following == Following::Tries);
        self.prefixes = model.times.prefixes.as_mut_ptr();
        self.lengths = model.times.lengths.as_mut_ptr();
        self.trials = (&raw mut model.times)
            .cast::<u8>()
            .wrapping_add(offset_of!(Times, trials))
            .cast();
        let mut advance = Advance {
            parts,
            y,
            pixels: 0,
        };
        self.ahead = advance.segment();
        self.columns_told = &raw mut advance.parts.group.columns;
        self.advance = (&raw mut advance).cast();
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
                walk_row_after(self)
            } else {
                walk_row(self)
            }
        };
        let Advance { parts, pixels, .. } = advance;
        clock.last_length = self.last_length;
        let mut walked = Walked {
            segment: self.segment as usize,
            column: None,
            occupied: 0,
            first_on: 0,
            last_on: self.last_on,
            goes_on: true,
            events: *parts.left - self.left,
            pixels,
        };
        *parts.left = self.left;
        (*coder.range, *coder.low) = (self.range, self.low);
        // Both are of one slice, the first not below the second.
        *coder.len = self.out.addr() - out.addr();
        match how {
            ROW => walked.segment += 1,
            FLAG => {}
            _ => {
                parts.group.columns = self.told;
                walked.occupied = self.told_all & !self.told;
                walked.first_on = self.first_on;
                walked.column = Some(self.column);
                walked.pixels += walked.occupied.count_ones();
                if how != LEFT {
                    walked.goes_on = false;
                    walked.last_on |= (self.link & 1) << (self.column & 31);
                }
                let next = self.link >> NEXT_SHIFT;
                if how == FULL && (next as usize) < parts.window.slots().len() {
                    *parts.pixel = Some(Pixel {
                        x: (u32::from(SEGMENT_PIXELS) * self.segment + self.column) as u16,
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
