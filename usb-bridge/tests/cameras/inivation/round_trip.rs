//! Each parser against its inverse, for any events and any cuts.

use eecvs_nostd::{Event, Polarity, Sensor};
use proptest::prelude::*;

use super::scene::{MODELS, model, parse, parser, sensor, sorted_frames, write};

/// Events in order: many of one time, gaps over several wraps, a few beyond 2^31 us; of which some
/// are the same.
fn events(sensor: Sensor) -> impl Strategy<Value = Vec<Event>> {
    let gap = prop_oneof![
        40 => Just(0_u64),
        40 => 1_u64..100,
        10 => 0_u64..70_000,
        3 => 0_u64..20_000_000,
        1 => 0_u64..(1 << 31) + (1 << 20),
    ];
    let place = prop_oneof![
        (0..sensor.width, 0..sensor.height),
        (0..4_u16, 0..sensor.height.min(20)),
    ];
    let event = (gap, place, any::<bool>());
    prop::collection::vec(event, 0..200).prop_map(move |steps| {
        let mut t_us = 0;
        let event = |(gap, (x, y), bright)| {
            t_us += gap;
            Event {
                t_us,
                x,
                y,
                polarity: Polarity::from_bool(bright),
            }
        };
        steps.into_iter().map(event).collect()
    })
}

/// A model and its events.
fn case() -> impl Strategy<Value = (&'static str, Sensor, Vec<Event>)> {
    prop::sample::select(&MODELS[..]).prop_flat_map(|(name, width, height)| {
        let sensor = sensor(width, height);
        (Just(name), Just(sensor), events(sensor))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn what_was_written_is_read((name, sensor, events) in case()) {
        let bytes = write(name, sensor, &events);
        let mut parser = parser(name, sensor);
        let mut read = Vec::new();
        parser.parse(&bytes, &mut read);
        prop_assert_eq!(parser.events(), events.len() as u64);
        prop_assert_eq!(parser.losses().iter().count(), 0);
        prop_assert_eq!(parser.time_us(), events.last().map(|event| event.t_us));
        prop_assert_eq!(read, sorted_frames(name, events));
    }

    #[test]
    fn cuts_change_nothing(
        (name, sensor, events) in case(),
        calls in prop::collection::vec(1_usize..40, 0..20),
        cuts in prop::collection::vec(1_usize..23, 1..60),
    ) {
        let whole = write(name, sensor, &events);
        // The writer gets them in several calls too.
        let mut writer = model(name).writer(sensor).expect("it fits");
        let (mut bytes, mut rest) = (Vec::new(), events.as_slice());
        for call in calls {
            let (some, others) = rest.split_at(call.min(rest.len()));
            writer.write(some, &mut bytes).expect("in order");
            rest = others;
        }
        writer.write(rest, &mut bytes).expect("in order");
        writer.finish(&mut bytes).expect("in order");
        prop_assert_eq!(parse(name, sensor, &bytes), parse(name, sensor, &whole));

        let mut parser = parser(name, sensor);
        let (mut read, mut rest) = (Vec::new(), whole.as_slice());
        for cut in cuts.iter().cycle() {
            if rest.is_empty() {
                break;
            }
            let (some, others) = rest.split_at((*cut).min(rest.len()));
            parser.parse(some, &mut read);
            rest = others;
        }
        prop_assert_eq!(parser.losses().iter().count(), 0);
        prop_assert_eq!(read, sorted_frames(name, events));
    }
}

#[test]
fn events_that_a_stream_cannot_hold_are_refused() {
    for (name, width, height) in MODELS {
        let sensor = sensor(width, height);
        let at = |t_us, x, y| Event {
            t_us,
            x,
            y,
            polarity: Polarity::On,
        };
        let fails = |events: &[Event]| {
            let mut writer = model(name).writer(sensor).expect("it fits");
            let error = writer.write(events, &mut Vec::new()).expect_err("refused");
            error.to_string()
        };
        let outside = fails(&[at(1, 0, 0), at(2, width, 0)]);
        assert!(
            outside.contains("event 1") && outside.contains("outside"),
            "{outside}"
        );
        let back = fails(&[at(5, 0, 0), at(4, 0, 0)]);
        assert!(back.contains("runs back"), "{back}");
        let late = fails(&[at(1_600_000_000_000_000_000, 0, 0)]);
        assert!(late.contains("too long"), "{late}");
        // The largest number too.
        fails(&[at(u64::MAX, 0, 0)]);
        let larger = Sensor::new(width.max(641), height).expect("a sensor");
        assert!(model(name).writer(larger).is_none());
    }
}

#[test]
fn inverted_logic_exchanges_rows_and_columns() {
    use usb_bridge::device::Parse;
    use usb_bridge::device::{davis::parse::DavisParser, dvxplorer::parse::DvxplorerParser};
    let wire = sensor(180, 240);
    let events = super::scene::scene(wire, 500, 3);
    let exchanged = |events: Vec<Event>| {
        let exchange = |event: Event| Event {
            x: event.y,
            y: event.x,
            ..event
        };
        events.into_iter().map(exchange).collect::<Vec<_>>()
    };
    let mut read = Vec::new();
    let mut parser = DavisParser::begin(sensor(240, 180), true);
    parser.parse(&write("davis346", wire, &events), &mut read);
    assert_eq!(read, exchanged(events.clone()));
    read.clear();
    let mut parser = DvxplorerParser::begin(sensor(240, 180), true);
    parser.parse(&write("dvxplorer", wire, &events), &mut read);
    assert_eq!(read, exchanged(events));
}
