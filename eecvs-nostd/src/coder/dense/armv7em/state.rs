//! State of the dense coder's assembly, [`walk`](super::walk): rows, tables and the range coder's state, at offsets
//! that the assembly names.

use core::ptr::{null, null_mut};

use crate::coder::dense::armv7em::Rows;
use crate::coder::dense::times::{
    Clock, DISTANCES, FIRST_BITS, FIRST_SYMBOLS, LASTS, LENGTHS, OF_LAST, OF_LAST_LATE,
    OF_LAST_MORE, OF_NEAR, PREFIX_CONTEXTS, RESTS,
};
use crate::coder::range::symbols::Symbols;
use crate::coder::range::{Probability, RATES};
use crate::group::Entry;
use crate::window::Slot;

/// How the assembly ends: at the columns' end, at a column that it leaves to the loop in Rust, after the window's
/// last event, and with the output full.
pub(crate) const DONE: u32 = 0;
pub(crate) const LEFT: u32 = 1;
pub(crate) const OVER: u32 = 2;
pub(crate) const FULL: u32 = 3;
/// How it ends in rows: after all of them, and at a segment's or a row's flag that it leaves to the loop in Rust.
pub(crate) const ROWS: u32 = 4;
pub(crate) const FLAG: u32 = 5;
pub(crate) const ROW_FLAG: u32 = 6;

/// State of the assembly, which addresses all of it relative to `rates`.
#[derive(Debug)]
#[repr(C)]
pub struct Walk {
    // What the columns see.
    pub(crate) west: u32,
    pub(crate) north_west: u32,
    pub(crate) north: u32,
    pub(crate) north_east: u32,
    pub(crate) far_north: u32,
    /// Whether any neighbour has events, the first column highest.
    pub(crate) busy: u32,
    pub(crate) rates: [u16; 8],
    /// Weights of four neighbours in a polarity's context, indexed by which of them have events.
    pub(crate) weights: [u8; 16],
    /// By the length of the last distance: twice the context of the next, where at least half of the window is left
    /// and where less is.
    pub(crate) of_last: [u8; 16],
    pub(crate) of_last_late: [u8; 16],
    /// By the same length: the context of whether there is another event.
    pub(crate) of_last_more: [u8; 16],
    /// By the length of a neighbour's distance: twice its context.
    pub(crate) of_near: [u8; 20],
    pub(crate) range: u32,
    pub(crate) low: u32,
    pub(crate) out: *mut u8,
    pub(crate) start: *mut u8,
    /// Beyond `room` no event is begun, and beyond `pixel_room` no pixel.
    pub(crate) room: *mut u8,
    pub(crate) pixel_room: *mut u8,
    /// Columns with events that were not visited yet, and all columns with events.
    pub(crate) told: u32,
    pub(crate) told_all: u32,
    /// Whether a column is quiet except for those to its west, the first column highest.
    pub(crate) quiet: u32,
    pub(crate) columns: u32,
    pub(crate) last_column: u32,
    pub(crate) entries: *mut Entry,
    pub(crate) slots: *mut Slot,
    pub(crate) lists: *mut u32,
    pub(crate) lasts: *mut u32,
    pub(crate) pixels: *mut Probability,
    /// 31 beyond the first one of the current crowd.
    pub(crate) runs: *mut Probability,
    pub(crate) polarities: *mut Probability,
    pub(crate) more: *mut Probability,
    pub(crate) flips: *mut Probability,
    pub(crate) first: *mut Symbols<FIRST_SYMBOLS>,
    /// Plain bits of a first cell.
    pub(crate) plain_bits: u32,
    pub(crate) distances: *mut Symbols<DISTANCES>,
    /// Leading zeros of what is left of the window where it is at least half.
    pub(crate) half: u32,
    pub(crate) cells: u32,
    /// By the leading zeros of what is left of the window: six times the context.
    pub(crate) rests: *const u8,
    pub(crate) fine: u32,
    /// 7 times `fine`, plus 8.
    pub(crate) fine_symbols: u32,
    /// Polarities of the segment's first events so far, and of those to the west of each column.
    pub(crate) first_on: u32,
    pub(crate) west_on: u32,
    pub(crate) north_west_on: u32,
    pub(crate) north_on: u32,
    pub(crate) north_east_on: u32,
    /// Of the window before: pixels with events, how many there are further on (two bits each), and the last
    /// polarities of the former.
    pub(crate) old: u32,
    pub(crate) later: [u32; 2],
    pub(crate) old_on: u32,
    /// Polarities of the segment's last events so far.
    pub(crate) last_on: u32,
    /// Last events of the neighbours to the west and north.
    pub(crate) west_last: u32,
    pub(crate) north_last: u32,
    /// Length in bits of the last distance, up to 15.
    pub(crate) last_length: u32,
    /// 3 times the polarity before the last; 6 if there is none.
    pub(crate) before: u32,
    /// Part of the context of whether there is another event: that of the number of events.
    pub(crate) number: u32,
    pub(crate) column: u32,
    /// Link of the last event, where the window is over or the output is full.
    pub(crate) link: u32,
    pub(crate) left: u32,
    /// The row's current segment, its last one, and the columns of that.
    pub(crate) segment: u32,
    pub(crate) last_segment: u32,
    pub(crate) last_columns: u32,
    /// The next segment with events.
    pub(crate) ahead: u32,
    pub(crate) segments: *mut Probability,
    pub(crate) north_row: *const u32,
    pub(crate) far_north_row: *const u32,
    pub(crate) north_on_row: *const u32,
    pub(crate) here_row: *mut u32,
    pub(crate) here_on_row: *mut u32,
    pub(crate) south_row: *const u32,
    pub(crate) last_on_row: *mut u32,
    /// Columns with events in the segment to the west, and the polarities of their first events.
    pub(crate) made: u32,
    pub(crate) made_on: u32,
    /// Columns with events in the row above: here and in the segment to the east.
    pub(crate) north_here: u32,
    pub(crate) north_next: u32,
    pub(crate) crowds: *mut Probability,
    pub(crate) all_lists: *mut u32,
    pub(crate) all_lasts: *mut u32,
    pub(crate) columns_told: *mut u32,
    pub(crate) rows: *mut Rows<'static, 'static, 'static>,
    /// Whether the row follows (1 or 0), and the list that the column had before.
    pub(crate) follows: u32,
    pub(crate) north_list: u32,
    /// In a row that follows: slots of the next events to the west and north of the current pixel, 0 for none.
    pub(crate) near: [u32; 2],
    pub(crate) prefixes: *mut [Probability; PREFIX_CONTEXTS],
    pub(crate) lengths: *mut [Probability; LENGTHS],
    /// Length in bits of the longest distance whose length is not coded.
    pub(crate) short: u32,
    /// Whether following is tried (1 or 0), and where trials are counted.
    pub(crate) tries: u32,
    pub(crate) trials: *mut u16,
}

impl Walk {
    /// State before the first row of a frame, for the cells of `clock`.
    pub(crate) fn new(clock: &Clock) -> Self {
        Self {
            west: 0,
            north_west: 0,
            north: 0,
            north_east: 0,
            far_north: 0,
            busy: 0,
            rates: RATES,
            weights: WEIGHTS,
            of_last: OF_LAST_TWICE[0],
            of_last_late: OF_LAST_TWICE[1],
            of_last_more: OF_LAST_MORE,
            of_near: OF_NEAR_TWICE,
            range: 0,
            low: 0,
            out: null_mut(),
            start: null_mut(),
            room: null_mut(),
            pixel_room: null_mut(),
            told: 0,
            told_all: 0,
            quiet: 0,
            columns: 0,
            last_column: 0,
            entries: null_mut(),
            slots: null_mut(),
            lists: null_mut(),
            lasts: null_mut(),
            pixels: null_mut(),
            runs: null_mut(),
            polarities: null_mut(),
            more: null_mut(),
            flips: null_mut(),
            first: null_mut(),
            plain_bits: clock.bits.wrapping_sub(FIRST_BITS),
            distances: null_mut(),
            half: 32 - clock.bits,
            cells: clock.cells,
            // What is left of the window has at least `half` leading zeros, or one less: all of a window whose
            // cells are a power of two.
            rests: (&raw const RESTS_SIX)
                .cast::<u8>()
                .wrapping_add(1)
                .wrapping_sub(32 - clock.bits as usize),
            fine: clock.fine,
            fine_symbols: 7 * clock.fine + 8,
            first_on: 0,
            west_on: 0,
            north_west_on: 0,
            north_on: 0,
            north_east_on: 0,
            old: 0,
            later: [0; 2],
            old_on: 0,
            last_on: 0,
            west_last: 0,
            north_last: 0,
            last_length: 0,
            before: 0,
            number: 0,
            column: 0,
            link: 0,
            left: 0,
            segment: 0,
            last_segment: 0,
            last_columns: 0,
            ahead: 0,
            segments: null_mut(),
            north_row: null(),
            far_north_row: null(),
            north_on_row: null(),
            here_row: null_mut(),
            here_on_row: null_mut(),
            south_row: null(),
            last_on_row: null_mut(),
            made: 0,
            made_on: 0,
            north_here: 0,
            north_next: 0,
            crowds: null_mut(),
            all_lists: null_mut(),
            all_lasts: null_mut(),
            columns_told: null_mut(),
            rows: null_mut(),
            follows: 0,
            north_list: 0,
            near: [0; 2],
            prefixes: null_mut(),
            lengths: null_mut(),
            short: clock.bits.saturating_sub(LENGTHS as u32 - 1),
            tries: 0,
            trials: null_mut(),
        }
    }
}

const fn weights() -> [u8; 16] {
    let (mut weights, mut i) = ([0; 16], 0);
    while i < 16 {
        // West, north-west, north, north-east from the lowest bit up.
        weights[i] = (81 * (i & 1) + 9 * (i >> 1 & 1) + 27 * (i >> 2 & 1) + 3 * (i >> 3)) as u8;
        i += 1;
    }
    weights
}

const WEIGHTS: [u8; 16] = weights();

const fn of_last(is_late: bool) -> [u8; 16] {
    let (mut contexts, mut i) = ([0; 16], 0);
    while i < 16 {
        let context = OF_LAST[i];
        contexts[i] = 2 * if is_late {
            LASTS as u8 + OF_LAST_LATE[context as usize]
        } else {
            context
        };
        i += 1;
    }
    contexts
}

const OF_LAST_TWICE: [[u8; 16]; 2] = [of_last(false), of_last(true)];

const OF_NEAR_TWICE: [u8; 20] = {
    let (mut contexts, mut i) = ([0; 20], 0);
    while i < OF_NEAR.len() {
        contexts[i] = 2 * OF_NEAR[i];
        i += 1;
    }
    contexts
};

/// By what is left of the window, from twice its power of two down: six times the context.
static RESTS_SIX: [u8; 34] = {
    let (mut contexts, mut i) = ([0; 34], 0);
    while i < RESTS {
        contexts[i] = 6 * (if i > 0 { RESTS - i } else { RESTS - 1 }) as u8;
        i += 1;
    }
    contexts
};
