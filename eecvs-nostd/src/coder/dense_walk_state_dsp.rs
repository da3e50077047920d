//! What the dense coder's walk in assembly, [`super::dense_walk_dsp`], knows: rows, tables and the range
//! coder's state, at places that the assembly names.

use core::ptr::{null, null_mut};

use super::dense_dsp::Rows;
use super::dense_times::{
    Clock, DISTANCES, FIRST_BITS, FIRST_SYMBOLS, LASTS, LENGTHS, OF_LAST, OF_LAST_LATE,
    OF_LAST_MORE, OF_NEAR, PREFIX_CONTEXTS, RESTS,
};
use super::range::{Probability, RATES};
use super::symbols::Symbols;
use crate::group::Entry;
use crate::window::Slot;

/// What the assembly knows; it addresses all from `rates` on.
#[derive(Debug)]
#[repr(C)]
pub struct Walk {
    // What the columns see.
    pub(super) west: u32,
    pub(super) north_west: u32,
    pub(super) north: u32,
    pub(super) north_east: u32,
    pub(super) far_north: u32,
    /// Whether any neighbour has events, the first column highest.
    pub(super) busy: u32,
    pub(super) rates: [u16; 8],
    /// Weights of four neighbours in a polarity's context, by whether they have events.
    pub(super) weights: [u8; 16],
    /// Of the last distance's bits: twice the context of the next, where at least half of the window is
    /// left and where less is.
    pub(super) of_last: [u8; 16],
    pub(super) of_last_late: [u8; 16],
    /// The same of whether there is another.
    pub(super) of_last_more: [u8; 16],
    /// Of the bits of a neighbour's distance: twice its context.
    pub(super) of_near: [u8; 20],
    pub(super) range: u32,
    pub(super) low: u32,
    pub(super) out: *mut u8,
    pub(super) start: *mut u8,
    /// Beyond this no event is begun, and beyond that no pixel.
    pub(super) room: *mut u8,
    pub(super) pixel_room: *mut u8,
    /// Columns with events that were not visited, and all.
    pub(super) told: u32,
    pub(super) told_all: u32,
    /// Whether a column is quiet but for those to its west, the first highest.
    pub(super) quiet: u32,
    pub(super) columns: u32,
    pub(super) last_column: u32,
    pub(super) entries: *mut Entry,
    pub(super) slots: *mut Slot,
    pub(super) lists: *mut u32,
    pub(super) lasts: *mut u32,
    pub(super) pixels: *mut Probability,
    /// 31 beyond the first one of the crowd at hand.
    pub(super) runs: *mut Probability,
    pub(super) polarities: *mut Probability,
    pub(super) more: *mut Probability,
    pub(super) flips: *mut Probability,
    pub(super) first: *mut Symbols<FIRST_SYMBOLS>,
    /// Plain bits of a first cell.
    pub(super) plain_bits: u32,
    pub(super) distances: *mut Symbols<DISTANCES>,
    /// Leading zeros of what is left of the window where it is at least half.
    pub(super) half: u32,
    pub(super) cells: u32,
    /// By the leading zeros of what is left of the window: six times its context.
    pub(super) rests: *const u8,
    pub(super) fine: u32,
    /// 7 times `fine`, and 8.
    pub(super) fine_symbols: u32,
    /// Of the first events so far, and of those to the west of each column.
    pub(super) first_on: u32,
    pub(super) west_on: u32,
    pub(super) north_west_on: u32,
    pub(super) north_on: u32,
    pub(super) north_east_on: u32,
    /// Pixels of the window before, how many there are further on (two bits each), and the polarities of
    /// those.
    pub(super) old: u32,
    pub(super) later: [u32; 2],
    pub(super) old_on: u32,
    /// Of the last events so far.
    pub(super) last_on: u32,
    /// Last events of the neighbours.
    pub(super) west_last: u32,
    pub(super) north_last: u32,
    /// Bits of the last distance, up to 15.
    pub(super) last_length: u32,
    /// 3 times the polarity before the last, 6 without one.
    pub(super) before: u32,
    /// The part of the number of events in the context of whether there is another.
    pub(super) number: u32,
    pub(super) column: u32,
    /// Link of the last event where the output was full.
    pub(super) link: u32,
    pub(super) left: u32,
    /// The row's segment at hand, its last one, and that one's columns.
    pub(super) segment: u32,
    pub(super) last_segment: u32,
    pub(super) last_columns: u32,
    /// The next segment that has events.
    pub(super) ahead: u32,
    pub(super) segments: *mut Probability,
    pub(super) north_row: *const u32,
    pub(super) far_north_row: *const u32,
    pub(super) north_on_row: *const u32,
    pub(super) here_row: *mut u32,
    pub(super) here_on_row: *mut u32,
    pub(super) south_row: *const u32,
    pub(super) last_on_row: *mut u32,
    /// Of the segment to the west.
    pub(super) made: u32,
    pub(super) made_on: u32,
    /// Above, here and in the segment to the east.
    pub(super) north_here: u32,
    pub(super) north_next: u32,
    pub(super) crowds: *mut Probability,
    pub(super) all_lists: *mut u32,
    pub(super) all_lasts: *mut u32,
    pub(super) columns_told: *mut u32,
    pub(super) rows: *mut Rows<'static, 'static, 'static>,
    /// Whether the row follows, 1 or 0, and the list that the column had before.
    pub(super) follows: u32,
    pub(super) north_list: u32,
    /// In such a row: slots of the next events to the west and north of the pixel at hand, 0 for none.
    pub(super) near: [u32; 2],
    pub(super) prefixes: *mut [Probability; PREFIX_CONTEXTS],
    pub(super) lengths: *mut [Probability; LENGTHS],
    /// Bits of the longest distance that is shorter than all that have a length.
    pub(super) short: u32,
    /// Whether it is counted what following is worth, and where.
    pub(super) tries: u32,
    pub(super) trials: *mut u16,
}

impl Walk {
    /// Before the first row of a frame, for these cells.
    pub(super) fn new(clock: &Clock) -> Self {
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
            // There are at least those of all of the window, less one: all of a window whose cells are a
            // power of two.
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

/// Of what is left of the window, from twice its power of two down: six times the context.
static RESTS_SIX: [u8; 34] = {
    let (mut contexts, mut i) = ([0; 34], 0);
    while i < RESTS {
        contexts[i] = 6 * (if i > 0 { RESTS - i } else { RESTS - 1 }) as u8;
        i += 1;
    }
    contexts
};
