//! Sorts a pixel's events by time, or those of all pixels.
//!
//! They are nearly always in order, which one pass detects. If they are not, a bottom-up merge sort of the list
//! takes O(n log n) steps and no memory.

use core::mem;

use crate::window::{NO_SLOT, SEGMENT_PIXELS, Slot, Window};

/// Puts the events of a closed window, in the list of every segment, in the order of their pixels, and in a pixel the
/// latest first: grouped, they are as they were, and ascend.
pub(crate) fn gather_pixels(window: &mut Window<'_>) {
    let mut from = 0;
    while let Some(segment) = window.next_used(from) {
        let mut columns = [NO_SLOT; SEGMENT_PIXELS as usize];
        let mut at = window.head_of(segment);
        let slots = window.slots();
        while let Some(slot) = slots.get_mut(at as usize) {
            let next = slot.next();
            let first = &mut columns[slot.column() as usize];
            *slot = slot.with_next(mem::replace(first, at));
            at = next;
        }
        let mut newest = NO_SLOT;
        for oldest in columns {
            let mut at = ascending(slots, oldest);
            while let Some(slot) = slots.get_mut(at as usize) {
                let next = slot.next();
                *slot = slot.with_next(mem::replace(&mut newest, at));
                at = next;
            }
        }
        window.put_head(segment, newest);
        from = segment + 1;
    }
}

/// Sorts the list from `head` on by ascending time and returns its first slot. Events of equal times keep their
/// order.
pub(crate) fn ascending(slots: &mut [Slot], head: u32) -> u32 {
    let (mut at, mut before_us) = (head, 0);
    while let Some(slot) = slots.get(at as usize) {
        if slot.offset_us() < before_us {
            return sort(slots, head);
        }
        (at, before_us) = (slot.next(), slot.offset_us());
    }
    head
}

#[cold]
#[inline(never)]
fn sort(slots: &mut [Slot], mut head: u32) -> u32 {
    let mut run = 1_u32;
    loop {
        let mut merges = 0;
        let (mut rest, mut last) = (head, NO_SLOT);
        head = NO_SLOT;
        while rest != NO_SLOT {
            merges += 1;
            let (mut a, mut b) = (rest, skip(slots, rest, run));
            let (mut left_a, mut left_b) = (run, run);
            loop {
                let (from_a, from_b) = (left_a > 0 && a != NO_SLOT, left_b > 0 && b != NO_SLOT);
                let takes_a = match (from_a, from_b) {
                    (false, false) => break,
                    (true, true) => time(slots, a) <= time(slots, b),
                    (is_a, _) => is_a,
                };
                let taken = if takes_a { &mut a } else { &mut b };
                let slot = *taken;
                *taken = next(slots, slot);
                *(if takes_a { &mut left_a } else { &mut left_b }) -= 1;
                if last == NO_SLOT {
                    head = slot;
                } else {
                    link(slots, last, slot);
                }
                last = slot;
            }
            rest = b;
        }
        if last != NO_SLOT {
            link(slots, last, NO_SLOT);
        }
        if merges <= 1 {
            return head;
        }
        run = run.saturating_mul(2);
    }
}

fn next(slots: &[Slot], at: u32) -> u32 {
    let next = slots.get(at as usize).map(|slot| slot.next());
    // The assembly ends a list with any number that no slot of a buffer has.
    let next = next.filter(|next| (*next as usize) < slots.len());
    next.unwrap_or(NO_SLOT)
}

fn time(slots: &[Slot], at: u32) -> u32 {
    slots.get(at as usize).map_or(0, |slot| slot.offset_us())
}

fn link(slots: &mut [Slot], from: u32, to: u32) {
    if let Some(slot) = slots.get_mut(from as usize) {
        *slot = slot.with_next(to);
    }
}

/// Returns the slot `count` places further on in the list.
fn skip(slots: &[Slot], mut at: u32, count: u32) -> u32 {
    for _ in 0..count {
        if at == NO_SLOT {
            break;
        }
        at = next(slots, at);
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Returns a list that links the slots in the given order.
    fn listed(times: &[u32], order: &[usize]) -> (Vec<Slot>, u32) {
        let mut slots = std::vec![Slot::EMPTY; times.len()];
        // Marks an end just as well as `NO_SLOT`.
        let mut head = NO_SLOT - 5;
        for i in order.iter().rev() {
            slots[*i] = Slot::new(times[*i], head, 0);
            head = *i as u32;
        }
        (slots, head)
    }

    proptest! {
        #[test]
        fn lists_ascend_and_equal_times_keep_their_order(
            (times, order) in proptest::collection::vec(0_u32..50, 0..200).prop_flat_map(|times| {
                let order = Just((0..times.len()).collect::<Vec<_>>()).prop_shuffle();
                (Just(times), order)
            }),
        ) {
            let (mut slots, head) = listed(&times, &order);
            let mut at = ascending(&mut slots, head);
            let mut sorted = Vec::new();
            while let Some(slot) = slots.get(at as usize) {
                sorted.push((slot.offset_us(), at as usize));
                at = slot.next();
            }
            let mut expected: Vec<_> = order.iter().map(|i| (times[*i], *i)).collect();
            expected.sort_by_key(|(time, _)| *time);
            prop_assert_eq!(sorted, expected);
        }
    }

    /// Even the worst order, a burst of 65,535 events backwards, takes only n log n steps.
    #[test]
    fn a_long_list_is_sorted_at_once() {
        let count = 65_535;
        let times: Vec<u32> = (0..count as u32).rev().collect();
        let order: Vec<_> = (0..count).collect();
        let (mut slots, head) = listed(&times, &order);
        assert_eq!(ascending(&mut slots, head), count as u32 - 1);
    }
}
