//! In Rust, for 32-bit cores without the assembly: handles 16 events in a row, to spread the cost of the loop.
//!
//! Everything is kept in locals, because values behind a reference would be loaded again after every store.

use crate::machine::HAS_LONG_PRODUCT;
use crate::window::take_words::Intake;
use crate::window::{COLUMN_BITS, COLUMN_SHIFT, FIRST, Head, Slot, index};
use event_types::evt2::{
    KIND_SHIFT, NO_EVENT, SIDE_BITS, SIDE_MASK, X_SHIFT, low_us, time_step_us,
};

/// Number of events handled in a row.
const ROW: usize = 16;

/// Implements [`Intake::take`].
#[inline(never)]
pub fn take(intake: &mut Intake<'_>, words: &[[u8; 4]]) -> usize {
    let Intake {
        ref mut slots,
        ref mut heads,
        ref mut bitmap,
        width,
        stride,
        len,
        mut time,
        time_last,
        span_us,
        mut span_at,
        mut before_us,
        mut before_at,
    } = *intake;
    let (width, stride) = (u32::from(width) << X_SHIFT, stride.get());
    let (slots, heads, bitmap) = (&mut **slots, &mut **heads, &mut **bitmap);
    let mut rest = words;
    let (mut now, mut span) = (len, span_us);
    loop {
        let before = now;
        let perhaps_time = 'run: {
            macro_rules! event {
                ($word:expr, $slot:expr) => {{
                    let word = u32::from_le_bytes(*$word);
                    // x is compared in place, together with the bits that are never set in an event.
                    let x = word & (NO_EVENT | (SIDE_MASK << X_SHIFT) | SIDE_MASK);
                    if x >= width {
                        break 'run true;
                    }
                    // Once x is known to be on the sensor, the segment's index shows whether y is.
                    let segment = first_of_row(word, stride) + (x >> (X_SHIFT + COLUMN_BITS));
                    let Some(head) = heads.get_mut(segment as usize) else {
                        break 'run false;
                    };
                    let next = index(*head);
                    *head = now as Head;
                    let x = (word >> (X_SHIFT - COLUMN_SHIFT))
                        & (((1 << COLUMN_BITS) - 1) << COLUMN_SHIFT);
                    *$slot = Slot::new(span.wrapping_add(low_us(word)), next, x | (word >> KIND_SHIFT));
                    // The head of an empty list is larger than any slot's number.
                    if next >= now {
                        mark(bitmap, segment);
                    }
                    now += 1;
                }};
            }
            let (many, _) = rest.as_chunks::<ROW>();
            let (places, _) = slots
                .get_mut(now as usize..)
                .unwrap_or_default()
                .as_chunks_mut::<ROW>();
            let mut places = places.iter_mut();
            for some in many {
                let Some(places) = places.next() else { break };
                event!(&some[0], &mut places[0]);
                event!(&some[1], &mut places[1]);
                event!(&some[2], &mut places[2]);
                event!(&some[3], &mut places[3]);
                event!(&some[4], &mut places[4]);
                event!(&some[5], &mut places[5]);
                event!(&some[6], &mut places[6]);
                event!(&some[7], &mut places[7]);
                event!(&some[8], &mut places[8]);
                event!(&some[9], &mut places[9]);
                event!(&some[10], &mut places[10]);
                event!(&some[11], &mut places[11]);
                event!(&some[12], &mut places[12]);
                event!(&some[13], &mut places[13]);
                event!(&some[14], &mut places[14]);
                event!(&some[15], &mut places[15]);
            }
            let words = rest.get((now - before) as usize..).unwrap_or_default();
            let places = slots.get_mut(now as usize..).unwrap_or_default();
            for (word, slot) in words.iter().zip(places) {
                event!(word, slot);
            }
            true
        };
        rest = rest.get((now - before) as usize..).unwrap_or_default();
        let Some((word, after)) = rest.split_first().filter(|_| perhaps_time) else {
            break;
        };
        let word = u32::from_le_bytes(*word);
        if word < time || word > time_last {
            break;
        }
        if now != span_at {
            (before_us, before_at) = (span, span_at);
            span_at = now;
        }
        span += time_step_us(time, word);
        time = word;
        rest = after;
    }
    intake.len = now;
    intake.span_us = span;
    intake.time = time;
    intake.span_at = span_at;
    intake.before_us = before_us;
    intake.before_at = before_at;
    words.len() - rest.len()
}

/// Notes that a segment has its first event.
#[inline(always)]
fn mark(bitmap: &mut [u32], segment: u32) {
    if let Some(bits) = bitmap.get_mut(segment as usize / 32) {
        *bits |= FIRST.rotate_right(segment);
    }
}

/// Returns the index of the first segment in the word's row, with `stride` segments per row.
#[inline(always)]
fn first_of_row(word: u32, stride: u32) -> u32 {
    if HAS_LONG_PRODUCT {
        // The upper half of a product with y in the top bits: nothing has to be masked off.
        let top = u64::from(word << (u32::BITS - SIDE_BITS));
        ((top * u64::from(stride << SIDE_BITS)) >> 32) as u32
    } else {
        (word & SIDE_MASK) * stride
    }
}
