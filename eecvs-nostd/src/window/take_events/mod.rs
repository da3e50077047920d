//! Stores events in a window's slots in their order of arrival: the loop that every event passes through on a host.

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod avx2;
mod portable;

use crate::window::Slot;
use event_types::{Event, Sensor};

/// Where and when the events of an open window lie.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub sensor: Sensor,
    pub start_us: u64,
    pub duration_us: u32,
}

/// Fills slots from the front with events from the front, while there are both and the events lie within `bounds`.
/// Returns their number, and raises `latest_us` to the largest of their offsets.
#[inline]
pub(crate) fn take_in_order(
    bounds: Bounds,
    slots: &mut [Slot],
    events: &[Event],
    latest_us: &mut u32,
) -> usize {
    #[cfg(target_arch = "x86_64")]
    let taken = match avx2::Avx2::detected() {
        Some(avx2) => avx2.take_in_order(bounds, slots, events, latest_us),
        None => 0,
    };
    #[cfg(not(target_arch = "x86_64"))]
    let taken = 0;
    let slots = slots.get_mut(taken..).unwrap_or_default();
    let events = events.get(taken..).unwrap_or_default();
    taken + portable::take_in_order(bounds, slots, events, latest_us)
}

#[cfg(test)]
mod tests {
    use super::*;
    use event_types::Polarity;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Times around the window's ends, at the ends of the clock, and any.
    fn time(start_us: u64, duration_us: u32) -> impl Strategy<Value = u64> {
        let end_us = start_us.wrapping_add(duration_us.into());
        prop_oneof![
            30 => (0..u64::from(duration_us)).prop_map(move |us| start_us.wrapping_add(us)),
            1 => (0..3_u64).prop_map(move |us| end_us.wrapping_sub(1).wrapping_add(us)),
            1 => (0..3_u64).prop_map(move |us| start_us.wrapping_sub(us)),
            1 => 0..3_u64,
            1 => any::<u64>(),
        ]
    }

    fn case() -> impl Strategy<Value = (Bounds, Vec<Event>)> {
        let starts = prop_oneof![0..9_u64, any::<u64>(), u64::MAX - 9..=u64::MAX];
        let durations = prop_oneof![1..9_u32, 1..=u32::MAX, Just(u32::MAX)];
        let sides = || prop_oneof![1..9_u16, Just(Sensor::SIDE_MAX)];
        (starts, durations, sides(), sides()).prop_flat_map(
            |(start_us, duration_us, width, height)| {
                let at = |side: u16| prop_oneof![60 => 0..side, 1 => Just(side), 1 => any::<u16>()];
                let event = (
                    time(start_us, duration_us),
                    at(width),
                    at(height),
                    any::<bool>(),
                );
                let event = event.prop_map(|(t_us, x, y, on)| Event {
                    t_us,
                    x,
                    y,
                    polarity: Polarity::from_bool(on),
                });
                let bounds = Bounds {
                    sensor: Sensor { width, height },
                    start_us,
                    duration_us,
                };
                (Just(bounds), prop::collection::vec(event, 0..40))
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]

        #[test]
        fn vectors_store_what_plain_code_does(
            (bounds, events) in case(), slots in 0..40_usize, before_us: u32,
        ) {
            let mut expected = (vec![Slot::EMPTY; slots], before_us);
            let taken =
                portable::take_in_order(bounds, &mut expected.0, &events, &mut expected.1);
            // By the definition.
            let fits = |event: &&Event| {
                bounds.sensor.contains(event.x, event.y)
                    && event.t_us.checked_sub(bounds.start_us)
                        .is_some_and(|us| us < u64::from(bounds.duration_us))
            };
            prop_assert_eq!(taken, events.iter().take(slots).take_while(fits).count());
            let mut found = (vec![Slot::EMPTY; slots], before_us);
            prop_assert_eq!(take_in_order(bounds, &mut found.0, &events, &mut found.1), taken);
            prop_assert_eq!(found.1, expected.1);
            prop_assert_eq!(&found.0[..taken], &expected.0[..taken]);
        }
    }
}
