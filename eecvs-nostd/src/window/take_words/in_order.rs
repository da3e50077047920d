//! For windows that keep the order of arrival: there is nothing to do but to check a word and to store it. In Rust, for
//! all cores without the assembly.

use crate::window::Slot;
use crate::window::take_words::Intake;
use event_types::evt2::{KIND_SHIFT, NO_EVENT, SIDE_MASK, X_SHIFT, low_us, time_step_us};

/// Implements [`Intake::take_in_order`].
#[inline(never)]
pub fn take(intake: &mut Intake<'_>, height: u16, words: &[[u8; 4]]) -> usize {
    let (width, height) = (u32::from(intake.width) << X_SHIFT, u32::from(height));
    let mut rest = words;
    loop {
        let (span_us, len) = (intake.span_us, intake.len as usize);
        let mut free = intake.slots.get_mut(len..).unwrap_or_default().iter_mut();
        let mut stored = 0;
        let mut next = 0;
        for word in rest {
            next = u32::from_le_bytes(*word);
            // x is compared in place, together with the bits that are never set in an event.
            let x = next & (NO_EVENT | SIDE_MASK << X_SHIFT);
            let y = next & SIDE_MASK;
            if x >= width || y >= height {
                break;
            }
            let Some(slot) = free.next() else { break };
            *slot = Slot {
                offset_us: span_us.wrapping_add(low_us(next)),
                link: y << 16 | x >> (X_SHIFT - 1) | next >> KIND_SHIFT,
            };
            stored += 1;
        }
        rest = rest.get(stored..).unwrap_or_default();
        intake.len += stored as u32;
        if rest.is_empty() || !step_to(intake, next) {
            break;
        }
        rest = rest.get(1..).unwrap_or_default();
    }
    words.len() - rest.len()
}

/// Follows the time if the word is one to which it may step.
fn step_to(intake: &mut Intake<'_>, word: u32) -> bool {
    if word < intake.time || word > intake.time_last {
        return false;
    }
    if intake.len != intake.span_at {
        (intake.before_us, intake.before_at) = (intake.span_us, intake.span_at);
        intake.span_at = intake.len;
    }
    let step_us = time_step_us(intake.time, word);
    intake.span_us = intake.span_us.wrapping_add(step_us);
    intake.time = word;
    true
}
