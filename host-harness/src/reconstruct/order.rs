//! A window's events in order of time.

use eecvs_nostd::{Event, Header};

/// Sorts events of a window by time; those of equal times stay in their order, which is the raster's
/// where they come from frames.
///
/// By counting, in one pass with a counter for each microsecond where there are events enough for so
/// many, else in a pass for each byte of the offset, the lowest first.
#[must_use]
pub fn by_time(header: &Header, events: &[Event]) -> Vec<Event> {
    let offset_us = |event: &Event| event.t_us.wrapping_sub(header.t0_us);
    let duration_us = header.duration_us as usize;
    let mut sorted = events.to_vec();
    if duration_us / 16 <= events.len() {
        let mut places = vec![0; duration_us];
        pass(events, &mut sorted, &mut places, |event| {
            offset_us(event) as usize
        });
        return sorted;
    }
    let mut from = events.to_vec();
    for shift in (0..u32::BITS - header.duration_us.leading_zeros()).step_by(8) {
        std::mem::swap(&mut sorted, &mut from);
        pass(&from, &mut sorted, &mut [0; 256], |event| {
            (offset_us(event) >> shift) as usize % 256
        });
    }
    sorted
}

/// Deals `from` to `to` by a key below the number of places, all 0; equal keys stay in their order.
fn pass(from: &[Event], to: &mut [Event], places: &mut [usize], key: impl Fn(&Event) -> usize) {
    for event in from {
        places[key(event)] += 1;
    }
    let mut before = 0;
    for place in &mut *places {
        before += std::mem::replace(place, before);
    }
    for event in from {
        let place = &mut places[key(event)];
        to[*place] = *event;
        *place += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::test_header::header;
    use eecvs_nostd::Polarity;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_a_stable_sort(
            duration_us in prop_oneof![1_u32..2000, 1_u32..],
            items in proptest::collection::vec((any::<u32>(), 0_u16..4), 0..400),
        ) {
            let header = header(duration_us);
            let events: Vec<_> = items
                .iter()
                .map(|(offset, x)| Event {
                    t_us: header.t0_us + u64::from(offset % duration_us),
                    x: *x,
                    y: 0,
                    polarity: Polarity::On,
                })
                .collect();
            let mut expected = events.clone();
            expected.sort_by_key(|event| event.t_us);
            prop_assert_eq!(by_time(&header, &events), expected);
        }
    }
}
