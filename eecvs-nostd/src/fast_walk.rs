//! The walk of [`crate::event_encoder`]'s fast coder over pixels on a core of 32 bits: it deals segments
//! and writes the codes of [`crate::coder::fast`] with little more than these at hand.
//!
//! It gives back to the loop that has every case, as they were, the pixels that it would have to look
//! at twice: with events out of order, with a code of over 32 bits, and where the output is full.

use core::mem;
use core::num::NonZeroU32;

use crate::coder::big_bits::{BigWriter, Position};
use crate::coder::fast::{END, FLIP, Fast, Orders, ROOM_WORDS, TERM_PIXELS};
use crate::group::{Entry, Group};
use crate::window::{FIRST, NO_SLOT, SEGMENT_PIXELS, Slot, Window};

/// What a code of a place and its first event follows from, until a term ends.
#[derive(Clone, Copy)]
struct Codes {
    /// [`crate::coder::fast::Gaps::base`] and 1, before a cell and a polarity.
    base: u32,
    /// Bits of a code, and twice its leading zeros.
    bits: u32,
    /// The longest gap whose pixel has a code of 32 bits with its first event.
    gap_max: u32,
}

impl Codes {
    #[inline(never)]
    const fn new(coder: &Fast, event_bits: u32) -> Self {
        Self {
            base: (coder.gaps.base + 1) << (event_bits & 31),
            bits: coder.gaps.bits.wrapping_sub(2 * event_bits),
            gap_max: coder.gaps.gap_max(),
        }
    }

    /// Whether they are for any gap within a segment.
    const fn are_short(&self) -> bool {
        self.gap_max >= SEGMENT_PIXELS as u32
    }
}

/// The output, whose state is in registers.
#[derive(Clone, Copy)]
struct Output {
    /// Words written.
    at: usize,
    /// Bits of the next word, from the top, and how many: up to 31.
    pending: u32,
    used: u32,
}

impl Output {
    /// Puts a code of up to 32 bits, which has no others.
    #[inline(always)]
    fn put(&mut self, words: &mut [[u8; 4]], code: u32, bits: u32) {
        let end = self.used + bits;
        // Where it goes; what the word has no room for is turned round to the top.
        let turned = code.rotate_right(end);
        if end < 32 {
            self.pending |= turned;
            self.used = end;
        } else {
            let beyond = end & 31;
            let here = u32::MAX >> beyond;
            if let Some(word) = words.get_mut(self.at) {
                *word = (self.pending | (turned & here)).to_be_bytes();
            }
            self.at += 1;
            self.pending = turned & !here;
            self.used = beyond;
        }
    }
}

/// Encodes pixels up to the window's last, or up to one that [`Fast::write`] has to see to, which is
/// the group's next then. Returns their events.
///
/// Times are as the window has them: cells of a microsecond.
#[inline(never)]
pub fn walk(
    (group, window): (&mut Group, &mut Window<'_>),
    coder: &mut Fast,
    writer: &mut BigWriter<'_>,
) -> u32 {
    let event_bits = coder.cell_bits() + 1;
    let mut codes = Codes::new(coder, event_bits & 31);
    let limit = writer.words.len().saturating_sub(ROOM_WORDS);
    if event_bits > 30 || !codes.are_short() || writer.position().words >= limit {
        return 0;
    }
    let row = coder.row();
    let Position {
        pending,
        free,
        words: at,
    } = writer.position();
    let mut out = Output {
        at,
        pending,
        used: 32 - free,
    };
    // With the word that a pixel of two events may go on to.
    let words = writer.words.get_mut(..=limit).unwrap_or_default();
    let gap_one = 2 << event_bits;
    let term_before = coder.gaps.term_left;
    let mut term_left = term_before;
    // Events that are not their pixel's first, and pixels of terms that have ended.
    let mut events = 0;
    let mut next = coder.gaps.next;
    // Place of the segment's first column.
    let mut start = u32::from(group.segment_y) * row + u32::from(group.segment_x);
    let mut columns = group.columns.reverse_bits();
    'segments: loop {
        let Some(rest) = NonZeroU32::new(columns) else {
            let Some((segment, head)) = group.take_segment(window) else {
                break;
            };
            start = segment * u32::from(SEGMENT_PIXELS);
            columns = deal(&mut group.entries, head, window.slots());
            continue;
        };
        let slots = window.slots_now();
        let mut column = rest.leading_zeros();
        // The pixel's column is the highest bit.
        columns = rest.get() << column;
        let mut gap = start + column - next;
        if gap > codes.gap_max {
            columns >>= column;
            break;
        }
        'pixels: loop {
            let entry = &mut group.entries[column as usize % 32];
            let head = mem::replace(&mut entry.head, NO_SLOT);
            'pixel: {
                let Some(slot) = slots.get(head as usize) else {
                    break 'pixel;
                };
                let code = (gap * gap_one + codes.base)
                    | (slot.offset_us() << 1 | u32::from(slot.is_on()));
                if let Some(second) = slots.get(slot.next() as usize) {
                    let code = ((code - gap_one / 2) << 1) | u32::from(second.is_on());
                    let bits = codes.bits - 1 - 2 * code.leading_zeros();
                    if slots.get(second.next() as usize).is_some() {
                        let pair = (slot, second);
                        let mut copy = out;
                        let further = several(
                            pair,
                            (code, bits),
                            slots,
                            &mut coder.orders,
                            (words, &mut copy),
                        );
                        if further == 0 {
                            break 'pixel;
                        }
                        out = copy;
                        events += further;
                    } else {
                        let polarities = u32::from(slot.is_on()) << 1 | u32::from(second.is_on());
                        let Some(distance) = second.offset_us().checked_sub(slot.offset_us())
                        else {
                            break 'pixel;
                        };
                        let order = &mut coder.orders[polarities as usize];
                        let (raised, raised_bits, learned) = raise(distance, *order);
                        if raised_bits > 30 {
                            break 'pixel;
                        }
                        *order = learned;
                        out.put(words, code, bits);
                        out.put(words, raised << 2 | END, raised_bits + 2);
                        events += 1;
                    }
                } else {
                    out.put(words, code, codes.bits - 2 * code.leading_zeros());
                }
                columns <<= 1;
                column += 1;
                term_left -= 1;
                if term_left == 0 {
                    coder.gaps.end_term(start + column, coder.cell_bits());
                    term_left = TERM_PIXELS;
                    events += TERM_PIXELS;
                    codes = Codes::new(coder, event_bits);
                    if !codes.are_short() {
                        next = start + column;
                        columns = columns.checked_shr(column).unwrap_or(0);
                        break 'segments;
                    }
                }
                if out.at + 1 >= words.len() {
                    next = start + column;
                    columns = columns.checked_shr(column).unwrap_or(0);
                    break 'segments;
                }
                let Some(rest) = NonZeroU32::new(columns) else {
                    next = start + column;
                    continue 'segments;
                };
                gap = rest.leading_zeros();
                columns = rest.get() << gap;
                column += gap;
                continue 'pixels;
            }
            entry.head = head;
            next = start + column - gap;
            columns >>= column % 32;
            break 'segments;
        }
    }
    group.columns = columns.reverse_bits();
    if columns != 0 {
        // Never 0; asking leaves no panic in the code.
        let y = start.checked_div(row).unwrap_or(0);
        (group.segment_x, group.segment_y) = ((start - y * row) as u16, y as u16);
    }
    let position = Position {
        pending: out.pending,
        free: 32 - out.used,
        words: out.at,
    };
    writer.rewind(position);
    coder.gaps.next = next;
    coder.gaps.term_left = term_left;
    (events + term_before).wrapping_sub(term_left)
}

/// Turns a segment's list, newest first, into one for each column, oldest first; returns the columns,
/// the first one highest.
#[inline(never)]
fn deal(entries: &mut [Entry; 32], mut head: u32, slots: &mut [Slot]) -> u32 {
    let mut columns = 0;
    // The end of a list is a slot that no buffer has.
    while let Some(slot) = slots.get_mut(head as usize) {
        let column = slot.column();
        columns |= 1 << column;
        let entry = &mut entries[column as usize % 32];
        let next = slot.next();
        *slot = slot.with_next(entry.head);
        entry.head = head;
        head = next;
    }
    u32::reverse_bits(columns)
}

/// A raised distance, the bits of its code, and the order that follows.
#[inline(always)]
fn raise(distance: u32, order: u8) -> (u32, u32, u8) {
    let turn = 31 - u32::from(order);
    let raised = distance + FIRST.rotate_right(turn);
    let zeros = raised.leading_zeros();
    let order = (30 - zeros as i32).max(0) as u8;
    (raised, 32 + turn - 2 * zeros, order)
}

/// Puts a pixel of several events, of which the code is that of the place, the first event, and the second
/// one's polarity; returns how many follow the first one. Or 0, and leaves everything as it was.
#[inline(never)]
fn several(
    (first, second): (&Slot, &Slot),
    (code, bits): (u32, u32),
    slots: &[Slot],
    orders: &mut Orders,
    (words, output): (&mut [[u8; 4]], &mut Output),
) -> u32 {
    let before = *orders;
    let mut out = *output;
    out.put(words, code, bits);
    let mut events = 0;
    let (mut cell, mut sign) = (first.offset_us(), u32::from(first.is_on()));
    let mut slot = *second;
    while let Some(distance) = slot.offset_us().checked_sub(cell) {
        cell = slot.offset_us();
        let sign_now = u32::from(slot.is_on());
        let order = &mut orders[(2 * sign + sign_now) as usize % 4];
        let (raised, bits, learned) = raise(distance, *order);
        *order = learned;
        events += 1;
        if bits > 30 {
            break;
        }
        let Some(after) = slots.get(slot.next() as usize) else {
            out.put(words, raised << 2 | END, bits + 2);
            *output = out;
            return events;
        };
        if out.at + 1 >= words.len() {
            break;
        }
        if u32::from(after.is_on()) == sign_now {
            out.put(words, raised << 1, bits + 1);
        } else {
            out.put(words, raised << 2 | FLIP, bits + 2);
        }
        sign = sign_now;
        slot = *after;
    }
    *orders = before;
    0
}
