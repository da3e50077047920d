//! The keys coder: all events of a window come back in order of time, by files and by frames.

use std::num::NonZeroU32;

use eecvs::encode::{HostStorage, Limits};
use eecvs::reconstruct::hybrid::HybridDecoder;
use eecvs::reconstruct::order::by_time;
use eecvs_nostd::{
    Cells, Coder, Config, Event, Fidelity, Filter, Frame, Hybrid, Mode, OUTPUT_BYTES_MIN, Region,
    Sensor, SetupError, Storage, bitmap_words, segments,
};
use proptest::prelude::*;
use strategies::{encode_windows, job, plain_config, stepping_back, through_a_file};

const fn hybrid(fidelity: Fidelity) -> Hybrid {
    Hybrid {
        coder: Coder::Keys,
        fidelity,
    }
}

fn sorted(mut events: Vec<Event>) -> Vec<Event> {
    events.sort_by_key(|event| (event.t_us, event.y, event.x, event.polarity));
    events
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Times that step back, windows that are full, windows of many frames, with pixels and regions left out.
    #[test]
    fn events_come_back_in_order_of_time(
        (config, events) in job(600), window_events in prop_oneof![1..40_usize, Just(1000)],
        frame_bytes in prop_oneof![Just(OUTPUT_BYTES_MIN), OUTPUT_BYTES_MIN..2000, Just(1 << 16)],
        region in proptest::option::of((0_u16..10, 0_u16..4, 1_u16..40, 1_u16..20)),
        hot in any::<bool>(),
        fidelity in prop_oneof![
            2 => Just(Fidelity::Lossless),
            1 => (0_u32..3000).prop_map(Fidelity::ToleranceUs),
            1 => (1_u16..300).prop_map(Fidelity::Bins),
        ],
    ) {
        let region = region.map(|(x, y, width, height)| Region { x, y, width, height });
        let hot = if hot { &[(0, 0)][..] } else { &[] };
        let hybrid = hybrid(fidelity);
        let config = Config {
            mode: Mode::Hybrid(hybrid),
            filter: Filter { region, isolated: false },
            ..config
        };
        let sizes = (window_events, frame_bytes);
        let (frames, windows) = encode_windows(config, hot, &events, sizes);
        let is_kept = |event: &Event| {
            let is_inside = region.is_none_or(|r| {
                (r.x..r.x + r.width).contains(&event.x) && (r.y..r.y + r.height).contains(&event.y)
            });
            is_inside && !hot.contains(&(event.x, event.y))
        };
        let mut found: Vec<(_, Vec<Event>)> = vec![];
        let mut decoder = HybridDecoder::default();
        for bytes in &frames {
            prop_assert!(bytes.len() <= frame_bytes);
            let frame = Frame::parse(bytes).expect("a frame");
            prop_assert_eq!(frame.header.mode, config.mode);
            prop_assert!(frame.header.is_key && frame.header.order.is_none());
            if frame.header.part == 0 {
                found.push((frame.header, vec![]));
            }
            let decoded = decoder.frame(&frame, hybrid).expect("the encoder's own payload");
            found.last_mut().expect("a window").1.extend(decoded);
        }
        let mut expected = windows
            .into_iter()
            .map(|(window, _)| window.into_iter().filter(is_kept).collect::<Vec<_>>())
            .filter(|window| !window.is_empty());
        found.retain(|window| !window.1.is_empty());
        for (header, found) in found {
            let mut expected = expected.next().expect("as many windows");
            let cells = Cells::new(fidelity, header.duration_us);
            for event in &mut expected {
                let cell = cells.of((event.t_us - header.t0_us) as u32);
                event.t_us = header.t0_us + u64::from(cells.offset_us(cell));
            }
            prop_assert!(found.is_sorted_by_key(|event| event.t_us));
            prop_assert_eq!(sorted(found), sorted(expected));
        }
        prop_assert!(expected.next().is_none());
    }
}

/// What the keys coder does not do is refused, and so is a missing memory.
#[test]
fn what_it_does_not_code_is_refused() {
    let sensor = Sensor::new(40, 3).expect("a sensor");
    let config = Config {
        mode: Mode::Hybrid(hybrid(Fidelity::Lossless)),
        ..plain_config(sensor, eecvs_nostd::Transform::Dct, 8)
    };
    let is_refused = |change: fn(&mut Config)| {
        let mut config = config;
        change(&mut config);
        HostStorage::new(sensor, 16).encoder(config).is_err()
    };
    assert!(!is_refused(|_| ()));
    assert!(!is_refused(
        |config| config.mode = Mode::Hybrid(hybrid(Fidelity::Bins(3)))
    ));
    assert!(is_refused(
        |config| config.mode = Mode::Hybrid(hybrid(Fidelity::Bins(0)))
    ));
    assert!(is_refused(|config| config.keep_order = true));
    assert!(is_refused(|config| config.filter.isolated = true));
    assert!(is_refused(
        |config| config.bytes_per_second = NonZeroU32::new(1 << 20)
    ));
    assert!(is_refused(
        |config| config.mode = Mode::Coefficients(Coder::Keys)
    ));
    const SEGMENTS: usize = segments(40, 3);
    let mut storage: Storage<16, SEGMENTS, { bitmap_words(SEGMENTS) }, 128> = Storage::new();
    assert_eq!(
        storage.encoder(config).err(),
        Some(SetupError::Config(eecvs_nostd::ConfigError::Keys))
    );
}

/// A file of events whose times step back, from several threads, in windows of several slices and frames.
#[test]
fn files_come_back_in_order() {
    let sensor = Sensor::new(320, 240).expect("a sensor");
    let events = stepping_back(sensor);
    let config = Config {
        mode: Mode::Hybrid(hybrid(Fidelity::Lossless)),
        ..plain_config(sensor, eecvs_nostd::Transform::Dct, 8)
    };
    for (threads, frame_bytes) in [(1, 1 << 24), (3, 1 << 24), (2, 10_000)] {
        let limits = Limits {
            frame_bytes,
            ..Limits::default()
        };
        let (summary, windows) = through_a_file(config, limits, threads, &events);
        assert_eq!(summary.windows_in_order, 0);
        assert_eq!(summary.frames > summary.windows, frame_bytes == 10_000);
        let mut found = Vec::new();
        for mut window in windows {
            assert!(window.events == by_time(&window.header, &window.events));
            found.append(&mut window.events);
        }
        assert!(sorted(found) == sorted(events.clone()));
    }
}
