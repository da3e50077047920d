//! Codes the order in which a window's events arrived, after the events themselves.
//!
//! If asked for, the encoder scans a closed window before it codes the events: for each event, in order of time and
//! for equal times in order of arrival, it notes the pixel. Once all events are coded, it sorts each group of
//! events of equal time by pixel, as a decoder does, and [`mod@place`] codes which event of the group came next.
//! Times are equal if they are equal to a decoder: coded by the same cell.
//!
//! Takes O(log n) time per event of a group of n. The memory, [`words`] for a window, is lent.

pub mod place;

use crate::coder::Axis;
use crate::coder::arrival_order::place::{Group, Learned, PLACE_BYTES_MAX, place, share, turned};
use crate::coder::cells::Cells;
use crate::coder::range::{Binary, RangeEncoder};
use crate::window::Window;

/// Returns the number of words of memory that a window of `slots` slots needs.
#[must_use]
pub const fn words(slots: usize) -> usize {
    PARTS * slots
}

const PARTS: usize = 3;

/// Marks a slot without an event of the window.
const NONE: u32 = u32::MAX;
/// Set in a place: the event is the first of its group.
const FIRST: u32 = 1 << 31;

/// Progress of coding a window's order.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Progress {
    /// Number of slots that were filled.
    used: u32,
    axis: Axis,
    /// Number of all events, number of those placed, and the bounds of the current group.
    events: u32,
    told: u32,
    start: u32,
    end: u32,
    group: Group,
}

impl Progress {
    pub(crate) const fn is_complete(&self) -> bool {
        self.told >= self.events
    }
}

/// What one frame holds of the order.
pub(crate) struct Told {
    pub(crate) bytes: usize,
    /// Number of events placed.
    pub(crate) events: u32,
}

/// The lent memory, in parts.
struct Parts<'m> {
    /// Places of the events, by time and arrival.
    places: &'m mut [u32],
    /// For each group, the numbers of its events sorted by place.
    sorted: &'m mut [u32],
    /// For each group, its tree.
    tree: &'m mut [u32],
}

impl<'m> Parts<'m> {
    /// Divides the memory for `used` slots; `None` if it is too small.
    fn new(memory: &'m mut [u32], used: usize) -> Option<Self> {
        let (places, rest) = memory.split_at_mut_checked(used)?;
        let (sorted, rest) = rest.split_at_mut_checked(used)?;
        let (tree, _) = rest.split_at_mut_checked(used)?;
        Some(Self {
            places,
            sorted,
            tree,
        })
    }
}

/// Notes the arrival order of a closed window of which `used` slots were filled; a filter may have removed some of
/// these events since. Returns `None` if the memory is too small.
#[inline(never)]
pub(crate) fn note(
    memory: &mut [u32],
    window: &Window<'_>,
    used: u32,
    cells: Cells,
) -> Option<Progress> {
    let Parts {
        places,
        sorted,
        tree,
    } = Parts::new(memory, used as usize)?;
    places.fill(NONE);
    let slots = window.slots_now();
    let mut from = 0;
    while let Some(segment) = window.next_used(from) {
        let (x, y) = window.segment_origin(segment);
        let mut at = window.head_of(segment);
        while let Some(slot) = slots.get(at as usize) {
            if let Some(to) = places.get_mut(at as usize) {
                *to = place(Axis::Rows, (x + slot.column() as u16, y));
            }
            at = slot.next();
        }
        from = segment + 1;
    }
    // List the events in the order of their slots, and their cells by slot.
    let (mut events, mut latest, mut ascends) = (0, 0, true);
    for (at, (_, slot)) in (0_u32..)
        .zip(places.iter().zip(slots))
        .filter(|(_, (place, _))| **place != NONE)
    {
        let cell = cells.of(slot.offset_us());
        if let (Some(to), Some(cells)) = (sorted.get_mut(events), tree.get_mut(at as usize)) {
            (*to, *cells) = (at, cell);
        }
        ascends &= cell >= latest;
        latest = cell;
        events += 1;
    }
    let sorted = sorted.get_mut(..events)?;
    if !ascends {
        sort(sorted, tree);
    }
    let (mut in_rows, mut in_columns) = (0_u32, 0_u32);
    let mut before = (NONE, None);
    for number in sorted.iter_mut() {
        let at = *number as usize;
        let cell = tree.get(at).copied();
        let here = places.get(at).copied().unwrap_or(0);
        let is_first = before.1 != cell;
        let (row, column) = share(before.0, here);
        in_rows += u32::from(row && !is_first);
        in_columns += u32::from(column && !is_first);
        *number = here | (u32::from(is_first) * FIRST);
        before = (here, cell);
    }
    // Choose the axis along which events share more lines with the event before them in their group.
    let axis = if in_columns > in_rows {
        Axis::Columns
    } else {
        Axis::Rows
    };
    for (to, place) in places.iter_mut().zip(&*sorted) {
        *to = match axis {
            Axis::Rows => *place,
            Axis::Columns => turned(place & !FIRST) | (place & FIRST),
        };
    }
    Some(Progress {
        used,
        axis,
        events: events as u32,
        told: 0,
        start: 0,
        end: 0,
        group: Group::EMPTY,
    })
}

/// Codes as much of the order as `out` has room for.
#[inline(never)]
pub(crate) fn tell(memory: &mut [u32], progress: &mut Progress, out: &mut [u8]) -> Told {
    let before = progress.told;
    let mut coder = RangeEncoder::new(out);
    let mut learned = Learned::START;
    if let Some(mut parts) = Parts::new(memory, progress.used as usize) {
        while progress.told < progress.events && coder.has_room(PLACE_BYTES_MAX) {
            if progress.told == 0 {
                coder.plain(u32::from(progress.axis == Axis::Columns), 1);
            }
            if progress.told == progress.end {
                parts.enter(progress);
            }
            parts.tell(progress, &mut learned, &mut coder);
        }
    }
    Told {
        bytes: coder.finish(),
        events: progress.told - before,
    }
}

impl Parts<'_> {
    /// Moves to the next group and sorts it.
    fn enter(&mut self, progress: &mut Progress) {
        let start = progress.told;
        let rest = self
            .places
            .get_mut(start as usize..progress.events as usize);
        let rest = rest.unwrap_or_default();
        let further = rest.iter().skip(1);
        let len = 1 + further.take_while(|place| **place & FIRST == 0).count();
        if let Some(first) = rest.first_mut() {
            *first &= !FIRST;
        }
        (progress.start, progress.end) = (start, start + len as u32);
        progress.group = Group::EMPTY;
        let range = start as usize..start as usize + len;
        if len > 1
            && let (Some(sorted), Some(tree)) =
                (self.sorted.get_mut(range.clone()), self.tree.get_mut(range))
        {
            for (number, at) in sorted.iter_mut().zip(start..) {
                *number = at;
            }
            sort(sorted, self.places);
            progress.group = Group::new(tree);
        }
    }

    /// Codes the place of the group's next event.
    fn tell(
        &mut self,
        progress: &mut Progress,
        learned: &mut Learned,
        coder: &mut RangeEncoder<'_>,
    ) {
        let Progress {
            start, end, told, ..
        } = *progress;
        let range = start as usize..end as usize;
        let (places, sorted) = (&*self.places, self.sorted.get(range.clone()));
        let place = |number: u32| places.get(number as usize).copied().unwrap_or(0);
        if let (Some(sorted), Some(tree)) = (sorted, self.tree.get_mut(range)) {
            let key = (place(told), told);
            let rank = sorted.partition_point(|number| (place(*number), *number) < key);
            let by_rank = |rank: u32| sorted.get(rank as usize).map_or(0, |number| place(*number));
            learned.code(coder, (&mut progress.group, tree), by_rank, rank as u32);
        }
        progress.told += 1;
    }
}

/// Sorts numbers by their keys, and by themselves for equal keys, in O(n log n) without extra memory.
#[inline(never)]
fn sort(numbers: &mut [u32], keys: &[u32]) {
    let key = |number: u32| (keys.get(number as usize).copied().unwrap_or(0), number);
    if numbers.is_sorted_by_key(|number| key(*number)) {
        return;
    }
    // Heapsort: first build a heap with the largest on top, then move its top to the end again and again.
    let (mut unmade, mut len) = (numbers.len() / 2, numbers.len());
    while len > 1 {
        let mut at = 0;
        if unmade > 0 {
            unmade -= 1;
            at = unmade;
        } else {
            len -= 1;
            swap(numbers, 0, len);
        }
        let Some(heap) = numbers.get_mut(..len) else {
            break;
        };
        while let Some(left) = heap.get(2 * at + 1).copied() {
            let mut child = 2 * at + 1;
            let mut largest = left;
            if let Some(right) = heap.get(child + 1).copied()
                && key(right) > key(left)
            {
                (child, largest) = (child + 1, right);
            }
            let Some(parent) = heap.get(at).copied() else {
                break;
            };
            if key(parent) >= key(largest) {
                break;
            }
            swap(heap, at, child);
            at = child;
        }
    }
}

/// Swaps two elements. Unlike `slice::swap` it has no code to panic, which indices within a heap never need.
fn swap(numbers: &mut [u32], a: usize, b: usize) {
    if let (Some(&from_a), Some(&from_b)) = (numbers.get(a), numbers.get(b)) {
        for (at, number) in [(a, from_b), (b, from_a)] {
            if let Some(to) = numbers.get_mut(at) {
                *to = number;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    proptest! {
        #[test]
        fn numbers_are_sorted_by_keys_and_themselves(
            keys in proptest::collection::vec(0_u32..20, 0..200),
            numbers in Just((0..200_u32).collect::<Vec<_>>()).prop_shuffle(),
        ) {
            let mut numbers = numbers;
            numbers.retain(|number| (*number as usize) < keys.len());
            let mut expected = numbers.clone();
            expected.sort_unstable_by_key(|number| (keys[*number as usize], *number));
            sort(&mut numbers, &keys);
            prop_assert_eq!(numbers, expected);
        }
    }
}
