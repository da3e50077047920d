//! The quick coder: events come back exactly, in the order in which they arrived, by files and by frames.

use eecvs::encode::{HostStorage, Limits};
use eecvs::reconstruct::hybrid::HybridDecoder;
use eecvs::reconstruct::order::by_time;
use eecvs_nostd::{
    Coder, Config, ConfigError, Event, Fidelity, Filter, Frame, Hybrid, Mode, OUTPUT_BYTES_MIN,
    Region, SetupError, Storage, bitmap_words, segments,
};
use proptest::prelude::*;
use strategies::{encode_windows, job, plain_config, stepping_back, through_a_file};

const HYBRID: Hybrid = Hybrid {
    coder: Coder::Quick,
    fidelity: Fidelity::Lossless,
};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Times that step back, windows that are full, windows of many frames, with pixels and regions left out.
    #[test]
    fn events_come_back_in_their_order_of_arrival(
        (config, events) in job(600), window_events in prop_oneof![1..40_usize, Just(1000)],
        frame_bytes in prop_oneof![Just(OUTPUT_BYTES_MIN), OUTPUT_BYTES_MIN..2000, Just(1 << 16)],
        region in proptest::option::of((0_u16..10, 0_u16..4, 1_u16..40, 1_u16..20)),
        hot in any::<bool>(), keep_order: bool,
    ) {
        let region = region.map(|(x, y, width, height)| Region { x, y, width, height });
        let hot = if hot { &[(0, 0)][..] } else { &[] };
        let config = Config {
            mode: Mode::Hybrid(HYBRID),
            filter: Filter { region, isolated: false },
            keep_order,
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
        let (mut found, mut filtered) = (vec![], 0);
        let mut decoder = HybridDecoder::default();
        for bytes in &frames {
            prop_assert!(bytes.len() <= frame_bytes);
            let frame = Frame::parse(bytes).expect("a frame");
            prop_assert_eq!(frame.header.mode, config.mode);
            prop_assert!(frame.header.is_key && frame.header.order.is_none());
            if frame.header.part == 0 {
                found.push(vec![]);
            }
            filtered += frame.header.filtered as usize;
            let decoded = decoder.frame(&frame, HYBRID).expect("the encoder's own payload");
            found.last_mut().expect("a window").extend(decoded);
        }
        let pushed: usize = windows.iter().map(|(window, _)| window.len()).sum();
        let kept = windows
            .into_iter()
            .map(|(window, _)| window.into_iter().filter(is_kept).collect::<Vec<_>>());
        let expected: Vec<_> = kept.filter(|window| !window.is_empty()).collect();
        found.retain(|window: &Vec<_>| !window.is_empty());
        prop_assert_eq!(filtered, pushed - expected.iter().map(Vec::len).sum::<usize>());
        prop_assert_eq!(found, expected);
    }
}

/// What the quick coder does not do is refused, and so is its window for another coder.
#[test]
fn what_it_does_not_code_is_refused() {
    const SEGMENTS: usize = segments(40, 3);
    let mut storage: Storage<16, SEGMENTS, { bitmap_words(SEGMENTS) }, 128> = Storage::new();
    let sensor = eecvs_nostd::Sensor::new(40, 3).expect("a sensor");
    let plain = plain_config(sensor, eecvs_nostd::Transform::Dct, 8);
    let mut error = |change: fn(&mut Config)| {
        let mut config = Config {
            mode: Mode::Hybrid(HYBRID),
            ..plain
        };
        change(&mut config);
        storage.encoder(config).err()
    };
    let quick = Some(SetupError::Config(ConfigError::Quick));
    assert_eq!(error(|_| ()), None);
    assert_eq!(error(|config| config.keep_order = true), None);
    assert_eq!(error(|config| config.filter.isolated = true), quick);
    assert_eq!(
        error(|config| config.bytes_per_second = std::num::NonZeroU32::new(1 << 20)),
        quick
    );
    for fidelity in [Fidelity::ToleranceUs(3), Fidelity::Bins(3)] {
        let coder = Coder::Quick;
        let config = Config {
            mode: Mode::Hybrid(Hybrid { coder, fidelity }),
            ..plain
        };
        let mut storage = HostStorage::new(sensor, 16);
        assert!(storage.encoder(config).is_err());
    }
    assert_eq!(
        error(|config| config.mode = Mode::Coefficients(Coder::Quick)),
        quick
    );
    assert_eq!(
        error(|config| {
            config.mode = Mode::Hybrid(Hybrid::default());
            config.window.keeps_arrival = true;
        }),
        quick
    );
}

/// A file of events whose times step back, from several threads.
#[test]
fn files_come_back_in_order() {
    let sensor = eecvs_nostd::Sensor::new(320, 240).expect("a sensor");
    let events = stepping_back(sensor);
    let config = Config {
        mode: Mode::Hybrid(HYBRID),
        ..plain_config(sensor, eecvs_nostd::Transform::Dct, 8)
    };
    for threads in [1, 3] {
        let (summary, windows) = through_a_file(config, Limits::default(), threads, &events);
        assert_eq!(summary.windows_in_order, summary.windows);
        let found = windows.iter();
        let found: Vec<_> = found
            .flat_map(|window| by_time(&window.header, &window.events))
            .collect();
        // Events of equal time stay in order.
        let mut expected = events.clone();
        expected.sort_by_key(|event| event.t_us);
        assert!(found == expected);
    }
}
