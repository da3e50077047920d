//! Walk over pixels for the fast coder of [`crate::coder::window_events`], on cores of 32 bits: it sorts segments
//! into columns and writes the codes of [`crate::coder::fast`] with little else in registers.
//!
//! It leaves pixels that it would have to look at twice, unchanged, to the loop that handles every case: pixels
//! with events out of order, pixels with a code of over 32 bits (not counting the zeros of a long gap), and pixels
//! for which the output has no room.

use core::mem;
use core::num::NonZeroU32;
use core::slice::IterMut;

use crate::coder::bits_msb_first::{BigWriter, Position};
use crate::coder::fast::{END, FLIP, Fast, Orders, ROOM_WORDS, TERM_PIXELS};
use crate::group::{Entry, Group};
use crate::window::{FIRST, NO_SLOT, SEGMENT_PIXELS, Slot, Window};

/// What the code of a place and its first event depends on, until a term ends.
#[derive(Clone, Copy)]
struct Codes {
    /// [`crate::coder::fast::Gaps::base`] plus 1, above a cell and a polarity.
    base: u32,
    /// Bits of a code plus twice its leading zeros.
    bits: u32,
    /// The longest gap that fits a code of 32 bits together with the first event.
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

    /// Returns how many zeros come before the code of a pixel after any gap, with a single event or several; `None`
    /// if the rest of the code has over 32 bits.
    const fn zeros(&self, gap: u32, event_bits: u32) -> Option<u32> {
        let raised = 2 * gap + (self.base >> (event_bits & 31));
        // One bit to spare, for a second event's polarity.
        if raised >= FIRST >> (event_bits & 31) {
            return None;
        }
        Some(self.bits + event_bits - u32::BITS - raised.leading_zeros())
    }

    /// Returns whether codes fit 32 bits after any gap within a segment.
    const fn are_short(&self) -> bool {
        self.gap_max >= SEGMENT_PIXELS as u32
    }
}

/// The output, with its state in registers.
struct Output<'o> {
    /// Words in which a pixel may begin.
    rest: IterMut<'o, [u8; 4]>,
    bits: Bits,
}

/// Pending bits of the next word, from the top, and their number, up to 31. Before a pixel after a long gap the
/// number may be negative, and wraps: that many zeros of the pixel's code have been written already.
#[derive(Clone, Copy)]
struct Bits {
    pending: u32,
    used: u32,
}

/// Result of writing a code.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Put {
    /// The code left room in the word.
    Within,
    /// The code completed a word.
    Word,
    /// The code was not written.
    None,
}

impl Output<'_> {
    /// Writes a code of `bits` bits, below 2^`bits`. Writes nothing if there is no room, or if a code that is not
    /// `IS_SHORT` has over 32 bits and completes a word. An `IS_SHORT` code is known to end in the next word at the
    /// latest.
    #[inline(always)]
    fn put<const IS_SHORT: bool>(&mut self, code: u32, bits: u32) -> Put {
        let end = self.bits.used.wrapping_add(bits);
        // Rotated to its place; the bits that the word has no room for wrap to the top.
        let turned = code.rotate_right(end);
        if end < 32 {
            self.bits.pending |= turned;
            self.bits.used = end;
            return Put::Within;
        }
        if !IS_SHORT && bits > 32 {
            return Put::None;
        }
        let Some(word) = self.rest.next() else {
            return Put::None;
        };
        let beyond = end & 31;
        let here = code >> beyond;
        *word = (self.bits.pending | here).to_be_bytes();
        self.bits.pending = turned ^ here;
        self.bits.used = beyond;
        Put::Word
    }
}

/// One event other than its pixel's first in the counts, above the number of pixels left of the term.
const EVENT: u32 = 2 * TERM_PIXELS;

/// Encodes pixels up to the window's last, or up to one that [`Fast::write`] has to encode, which is then the
/// group's next. Returns the number of events encoded.
///
/// Times are coded as the window has them: in cells of a microsecond.
#[inline(never)]
pub fn walk(
    (group, window): (&mut Group, &mut Window<'_>),
    coder: &mut Fast,
    writer: &mut BigWriter<'_>,
) -> u32 {
    let event_bits = coder.cell_bits() + 1;
    let mut codes = Codes::new(coder, event_bits & 31);
    // A pixel that completes the word before `limit` is not for this walk, as the frame may end after it.
    let limit = writer.words.len().saturating_sub(ROOM_WORDS + 1);
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
        rest: writer
            .words
            .get_mut(at..limit)
            .unwrap_or_default()
            .iter_mut(),
        bits: Bits {
            pending,
            used: 32 - free,
        },
    };
    let gap_one = 2 << event_bits;
    let term_before = coder.gaps.term_left;
    // From the top: events that are not their pixel's first, plus pixels of terms that have ended; then the pixels
    // left of the term.
    let mut counts = term_before;
    // 30 less each order.
    let mut orders = coder.orders.map(|order| 30_u8.wrapping_sub(order));
    // Place of the segment's first column.
    let mut start = u32::from(group.segment_y) * row + u32::from(group.segment_x);
    // The place after the last pixel's, relative to `start`.
    let mut before = coder.gaps.next.wrapping_sub(start);
    let mut columns = group.columns;
    // Words to take back of a pixel that was not completed.
    let mut back = 0;
    // Bits pending before zeros completed a word.
    let mut zeros_after = 0;
    'segments: loop {
        if let Some(rest) = NonZeroU32::new(columns) {
            let gap = rest.trailing_zeros().wrapping_sub(before);
            if gap > codes.gap_max {
                let Some(zeros) = codes.zeros(gap, event_bits) else {
                    break;
                };
                // If the zeros complete no word, the pixel's code is written like any other.
                if out.bits.used + zeros > 31 {
                    let Some(word) = out.rest.next() else { break };
                    *word = out.bits.pending.to_be_bytes();
                    zeros_after = out.bits.pending;
                    out.bits.pending = 0;
                    out.bits.used = out.bits.used.wrapping_sub(32);
                }
            }
            let slots = window.slots_now();
            let mut left = rest;
            'pixels: loop {
                let column = left.trailing_zeros();
                let entry = &mut group.entries[column as usize];
                let head = mem::replace(&mut entry.head, NO_SLOT);
                let bits_before = out.bits;
                'pixel: {
                    let Some(slot) = slots.get(head as usize) else {
                        break 'pixel;
                    };
                    let code = ((column.wrapping_sub(before) * gap_one + codes.base)
                        | (slot.offset_us() << 1))
                        + slot.sign();
                    if let Some(second) = slots.get(slot.next() as usize) {
                        let code = ((code - gap_one / 2) << 1) + second.sign();
                        let bits = codes.bits - 1 - 2 * code.leading_zeros();
                        if slots.get(second.next() as usize).is_some() {
                            let pair = (slot, second);
                            let copy = Output {
                                rest: mem::take(&mut out.rest),
                                ..out
                            };
                            let room = copy.rest.len();
                            let (copy, further) =
                                several(pair, (code, bits), slots, &mut orders, copy);
                            out = copy;
                            if further == 0 {
                                back = room - out.rest.len();
                                break 'pixel;
                            }
                            counts += further * EVENT;
                        } else {
                            let Some(distance) = second.offset_us().checked_sub(slot.offset_us())
                            else {
                                break 'pixel;
                            };
                            let order = &mut orders[code as usize % 4];
                            let (raised, raised_bits, learned) = raise(distance, *order);
                            let put = out.put::<true>(code, bits);
                            if put == Put::None {
                                break 'pixel;
                            }
                            if out.put::<false>(raised << 2 | END, raised_bits + 2) == Put::None {
                                back = usize::from(put == Put::Word);
                                break 'pixel;
                            }
                            *order = learned;
                            counts += EVENT;
                        }
                    } else {
                        let bits = codes.bits - 2 * code.leading_zeros();
                        if out.put::<true>(code, bits) == Put::None {
                            break 'pixel;
                        }
                    }
                    before = column + 1;
                    counts -= 1;
                    let rest = NonZeroU32::new(left.get() & (left.get() - 1));
                    if counts.is_multiple_of(EVENT) {
                        coder.gaps.end_term(start + before, coder.cell_bits());
                        counts += TERM_PIXELS * (EVENT + 1);
                        codes = Codes::new(coder, event_bits);
                        if !codes.are_short() {
                            columns = rest.map_or(0, NonZeroU32::get);
                            break 'segments;
                        }
                    }
                    let Some(rest) = rest else {
                        break 'pixels;
                    };
                    left = rest;
                    continue 'pixels;
                }
                entry.head = head;
                out.bits = bits_before;
                // Negative: zeros before the pixel have completed a word.
                if out.bits.used > 31 {
                    out.bits.pending = zeros_after;
                    out.bits.used = out.bits.used.wrapping_add(32);
                    back += 1;
                }
                columns = left.get();
                break 'segments;
            }
        }
        before = before.wrapping_add(start);
        let Some((segment, head)) = group.take_segment(window) else {
            columns = 0;
            start = 0;
            break;
        };
        start = segment * u32::from(SEGMENT_PIXELS);
        before = before.wrapping_sub(start);
        columns = deal(&mut group.entries, head, window.slots());
    }
    group.columns = columns;
    if columns != 0 {
        // Never 0; `checked_div` leaves no panic in the code.
        let y = start.checked_div(row).unwrap_or(0);
        (group.segment_x, group.segment_y) = ((start - y * row) as u16, y as u16);
    }
    let position = Position {
        pending: out.bits.pending,
        free: 32 - out.bits.used,
        words: limit - out.rest.len() - back,
    };
    writer.rewind(position);
    coder.orders = orders.map(|zeros| 30_u8.wrapping_sub(zeros));
    coder.gaps.next = before.wrapping_add(start);
    coder.gaps.term_left = counts % EVENT;
    (counts / EVENT + term_before).wrapping_sub(counts % EVENT)
}

/// Splits a segment's list, newest first, into one per column, oldest first. Returns the columns with events.
#[inline(never)]
fn deal(entries: &mut [Entry; 32], mut head: u32, slots: &mut [Slot]) -> u32 {
    let mut columns = 0;
    // A list ends with a slot number beyond any buffer.
    while let Some(slot) = slots.get_mut(head as usize) {
        let column = slot.column();
        columns |= 1 << column;
        let entry = &mut entries[column as usize % 32];
        let next = slot.next();
        *slot = slot.with_next(entry.head);
        entry.head = head;
        head = next;
    }
    columns
}

/// Returns a raised distance, the bits of its code, and 30 less the order that follows; `zeros` is 30 less its
/// order.
#[inline(always)]
fn raise(distance: u32, zeros: u8) -> (u32, u32, u8) {
    let zeros = u32::from(zeros);
    let raised = distance + (FIRST >> 1).rotate_right(zeros);
    let bits = 33 + zeros - 2 * raised.leading_zeros();
    (raised, bits, (raised | 2).leading_zeros() as u8)
}

/// Writes a pixel of several events, given the code of its place, first event and second polarity. Returns how many
/// events follow the first, or 0, with the orders unchanged, if the pixel was not written.
///
/// Most runs are of one polarity, so each polarity has a loop of its own: its order is then in one place, and the
/// zero that announces a next event of that polarity becomes one more zero in front of that event's code.
#[inline(always)]
fn several<'o>(
    (first, second): (&Slot, &Slot),
    (code, bits): (u32, u32),
    slots: &[Slot],
    orders: &mut Orders,
    out: Output<'o>,
) -> (Output<'o>, u32) {
    let mut out = Output {
        rest: out.rest,
        bits: out.bits,
    };
    let before = *orders;
    let mut events = 0;
    let (mut cell, mut sign) = (first.offset_us(), first.sign());
    let mut slot = *second;
    'undone: {
        if out.put::<true>(code, bits) == Put::None {
            break 'undone;
        }
        /// Writes the event in `slot`, whose code has `$zeros` more zeros in front, and what follows if the next
        /// event is of the other polarity or there is none. Evaluates to whether the next event is of the same
        /// polarity.
        macro_rules! event {
            ($order:expr, $zeros:literal, $sign:expr) => {{
                let Some(distance) = slot.offset_us().checked_sub(cell) else {
                    break 'undone;
                };
                cell = slot.offset_us();
                let order = &mut orders[$order];
                let (raised, bits, learned) = raise(distance, *order);
                *order = learned;
                events += 1;
                let Some(after) = slots.get(slot.next() as usize) else {
                    if out.put::<false>(raised << 2 | END, bits + 2 + $zeros) == Put::None {
                        break 'undone;
                    }
                    return (out, events);
                };
                slot = *after;
                // Only the lowest bit of `sign` is in use.
                let is_same = (after.sign() ^ $sign) & 1 == 0;
                let put = if is_same {
                    out.put::<false>(raised, bits + $zeros)
                } else {
                    out.put::<false>(raised << 2 | FLIP, bits + 2 + $zeros)
                };
                if put == Put::None {
                    break 'undone;
                }
                is_same
            }};
        }
        loop {
            let sign_now = slot.sign();
            let order = (2 * sign + sign_now) as usize % 4;
            sign = sign_now;
            if event!(order, 0, sign_now) {
                if sign_now == 0 {
                    while event!(0, 1, 0) {}
                } else {
                    while event!(3, 1, 1) {}
                }
            }
        }
    }
    *orders = before;
    (out, 0)
}
