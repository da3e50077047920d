//! Properties that every representation must have.

use std::sync::Arc;

use eecvs_bench::source::WINDOW_US;
use event_types::test_events::{SENSOR, event};
use proptest::prelude::*;

use super::*;

/// Wraps events as a recording.
pub(super) fn source(events: &[Event]) -> Source {
    Source {
        name: "test".to_owned(),
        sensor: SENSOR,
        events: events.to_vec().into(),
    }
}

/// Returns the events decoded from the arrays of a recording.
pub(super) fn decoded<R: Representation>(
    representation: &mut R,
    source: &Source,
    stored: Stored,
) -> Vec<Event> {
    with(representation, source, stored).unwrap().events
}

#[test]
fn arrays_have_the_size_of_their_definition() {
    let events = [event(0, 1, 1, true), event(40_000, 1, 1, false)];
    for stored in Stored::ALL {
        for (baseline, channels, has_step) in [
            (Baseline::Ces, 32, true),
            (Baseline::Tore, 16, false),
            (Baseline::Voxel, 16, true),
            (Baseline::EventFrame, 2, false),
            (Baseline::TimeSurface, 2, false),
        ] {
            let found = round_trip(baseline, &source(&events), 16, stored).unwrap();
            let step = if has_step && stored != Stored::F32 {
                4
            } else {
                0
            };
            let array = 128 + 64 * 48 * channels * stored.bytes() + step;
            assert_eq!(found.array_bytes, 2 * array, "{}", baseline.name());
            assert!(found.packed_bytes > 0 && found.packed_bytes < 600);
            assert_eq!(found.has_times, baseline != Baseline::EventFrame);
            // Rounding may make the window's first event seem older than the window.
            let least = if stored == Stored::F32 { 2 } else { 1 };
            assert!(
                (least..=2).contains(&found.events.len()),
                "{}",
                baseline.name()
            );
        }
    }
}

#[test]
fn names_are_told_apart() {
    let names = Baseline::ALL.map(Baseline::name);
    for (at, name) in names.iter().enumerate() {
        assert!(!names[..at].contains(name));
    }
}

#[test]
fn a_recording_that_breaks_its_promise_is_refused() {
    let outside = [event(0, 64, 0, true)];
    let unordered = [event(5, 0, 0, true), event(4, 0, 0, true)];
    for baseline in Baseline::ALL {
        for events in [&outside[..], &unordered] {
            assert!(round_trip(baseline, &source(events), 4, Stored::F32).is_err());
        }
        assert!(round_trip(baseline, &source(&[]), 0, Stored::F32).is_err());
        let nothing = round_trip(baseline, &source(&[]), 4, Stored::F32).unwrap();
        assert_eq!((nothing.array_bytes, nothing.events.len()), (0, 0));
    }
}

/// Returns the indices of the windows that hold the events.
fn window_numbers(start_us: u64, events: &[Event]) -> Vec<u64> {
    let number = |event: &Event| (event.t_us - start_us) / u64::from(WINDOW_US);
    let mut numbers: Vec<u64> = events.iter().map(number).collect();
    numbers.dedup();
    numbers
}

/// Generates recordings in order of time, with crowded pixels, equal times, long gaps, and times up to `u64::MAX`.
fn recording() -> impl Strategy<Value = Source> {
    let start = prop_oneof![Just(0), Just(u64::MAX - 20_000), any::<u64>()];
    let step = prop_oneof![
        3 => Just(0_u64),
        8 => 0..900_u64,
        1 => 30_000..200_000_u64,
        1 => any::<u64>(),
    ];
    let place = prop_oneof![(0..2_u16, 0..1_u16), (0..64_u16, 0..48_u16)];
    let events = proptest::collection::vec((step, place, any::<bool>()), 0..150);
    (start, events).prop_map(|(start, events)| {
        let mut t_us: u64 = start;
        let events: Arc<[Event]> = events
            .into_iter()
            .map(|(step, (x, y), on)| {
                t_us = t_us.saturating_add(step);
                event(t_us, x, y, on)
            })
            .collect();
        Source {
            events,
            ..source(&[])
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn decoded_events_are_in_the_sensor_and_in_windows_that_had_some(
        source in recording(),
        channels in prop_oneof![1..=20_u8, Just(64)],
    ) {
        let windows = window_numbers(source.start_us(), &source.events);
        for baseline in Baseline::ALL {
            for stored in Stored::ALL {
                let found = round_trip(baseline, &source, channels, stored).unwrap();
                prop_assert!(found.events.is_sorted_by_key(|event| event.t_us));
                let start_us = source.start_us();
                prop_assert!(found.events.iter().all(|event| event.t_us >= start_us));
                for number in window_numbers(start_us, &found.events) {
                    prop_assert!(windows.binary_search(&number).is_ok(), "{}", baseline.name());
                }
                for event in &found.events {
                    prop_assert!(
                        source.events.iter().any(|e| (e.x, e.y) == (event.x, event.y)),
                        "{}: {event:?}",
                        baseline.name()
                    );
                }
            }
        }
    }
}
