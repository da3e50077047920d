//! The same seed gives the same events, whoever computes them, and however they are read.

use event_emulator::{
    Cause, Model, PARAMETERS, PRESETS, PixelParameters, Preset, emulate, emulate_with,
};
use event_types::stream::EventReader;
use event_types::{Event, Sensor};

use crate::{events_of, small};

/// FNV-1a over the fields of all events, 64 bits, little-endian.
fn fnv(events: &[Event]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for e in events {
        let bytes = e.t_us.to_le_bytes().into_iter();
        let bytes = bytes.chain(e.x.to_le_bytes()).chain(e.y.to_le_bytes());
        for byte in bytes.chain([e.polarity as u8]) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
    hash
}

#[test]
fn a_seed_gives_the_same_events_everywhere() {
    // A different hash means that every seed in use gives other events: users must be told of such a change.
    let pinned = [
        (Preset::IndoorDarkHdr, 0xa4b8_0797_e239_a748),
        (Preset::IndoorDarkBlur, 0x0562_fa08_41d3_da77),
        (Preset::IndoorHdrBlur, 0x610c_aadc_d10f_6144),
        (Preset::OutdoorWellLitBlur, 0x0897_abf8_7222_fa7d),
        (Preset::OutdoorDarkBlur, 0x5803_bd4b_cdf3_dad7),
        (Preset::IndoorFlying, 0x9939_0cd5_2c86_5295),
        (Preset::Motorcycle, 0x19c1_9f74_454f_e5f6),
        (Preset::OutdoorLowBrightness, 0x7ec7_ce7e_07d5_68a2),
        (Preset::OutdoorDark, 0x7b7c_355e_5024_cc89),
    ];
    let seen = pinned.map(|(preset, _)| (preset, fnv(&events_of(small(preset, 42)))));
    assert_eq!(seen, pinned, "hashes {seen:#x?}");
}

#[test]
fn any_number_of_threads_gives_the_same_events() {
    for preset in [Preset::Motorcycle, Preset::OutdoorDark] {
        let config = small(preset, 7);
        let expected = events_of(config);
        for threads in [1, 2, 3, 7] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let events = pool.expect("threads").install(|| {
                let mut emulator = emulate(config).expect("a scene").parallel(true);
                let mut events = Vec::new();
                while emulator.read(&mut events).expect("events") > 0 {}
                events
            });
            assert_eq!(events, expected, "{preset:?} {threads}");
        }
    }
}

#[test]
fn another_seed_gives_other_events() {
    for preset in PRESETS {
        let events = events_of(small(preset, 1));
        assert!(!events.is_empty(), "{preset:?}");
        assert_eq!(events, events_of(small(preset, 1)), "{preset:?}");
        assert_ne!(events, events_of(small(preset, 2)), "{preset:?}");
    }
}

#[test]
fn events_are_in_order_in_bounds_and_apart() {
    // Jitter would bring two events of a pixel closer.
    let parameters = PixelParameters {
        jitter_us: 0.0,
        ..PixelParameters::default()
    };
    for preset in PRESETS {
        let mut config = small(preset, 3);
        config.start_us = 1_600_000_000_000_000;
        let mut last = vec![None::<u64>; config.sensor.pixels() as usize];
        let events = crate::events_with(config, &parameters);
        for e in &events {
            assert!(config.sensor.contains(e.x, e.y), "{e:?}");
            assert!(e.t_us >= config.start_us && e.t_us < config.start_us + config.duration_us);
            let pixel = usize::from(e.y) * usize::from(config.sensor.width) + usize::from(e.x);
            if let Some(before) = last[pixel].replace(e.t_us) {
                // A microsecond for the rounding of both.
                assert!(e.t_us + 1 >= before + 300, "{preset:?} {e:?}");
            }
        }
        assert!(events.is_sorted_by_key(|e| (e.t_us, e.y, e.x, e.polarity)));
    }
}

#[test]
fn start_only_shifts_and_duration_only_cuts() {
    let config = small(Preset::IndoorFlying, 5);
    let events = events_of(config);
    let mut shifted = config;
    shifted.start_us = u64::MAX - config.duration_us;
    let mut later = events_of(shifted);
    for e in &mut later {
        e.t_us -= shifted.start_us;
    }
    assert_eq!(events, later);
    // A duration that is not a multiple of anything.
    let mut short = config;
    short.duration_us = 54_321;
    let expected = events.iter().filter(|e| e.t_us < 54_321);
    assert!(events_of(short).iter().eq(expected));
}

#[test]
fn durations_of_zero_and_without_end() {
    for preset in PRESETS {
        let mut config = small(preset, 1);
        let all = events_of(config);
        config.duration_us = 0;
        assert!(events_of(config).is_empty());
        config.duration_us = u64::MAX;
        let mut emulator = emulate(config).expect("a scene");
        let mut events = Vec::new();
        while events.len() < 20 {
            assert!(emulator.read(&mut events).expect("events") > 0);
        }
        assert!(events.iter().zip(&all).all(|(a, b)| a == b));
    }
}

#[test]
fn sensors_of_any_size_work() {
    for (width, height, duration_us) in [
        (1, 1, 500_000),
        (1, 2_048, 20_000),
        (2_048, 1, 20_000),
        (64, 8, 50_000),
        (65, 9, 50_000),
        (1_280, 720, 5_000),
    ] {
        let mut config = small(Preset::Motorcycle, 8);
        config.sensor = Sensor { width, height };
        config.duration_us = duration_us;
        let events = events_of(config);
        assert!(!events.is_empty(), "{width} x {height}");
        assert!(events.iter().all(|e| config.sensor.contains(e.x, e.y)));
    }
}

#[test]
fn causes_are_those_of_the_scene_and_model_1_has_none() {
    let mut night = emulate(small(Preset::OutdoorDark, 1)).expect("a scene");
    let (mut events, mut causes) = (Vec::new(), Vec::new());
    while night
        .read_with_causes(&mut events, &mut causes)
        .expect("events")
        > 0
    {}
    assert_eq!(events.len(), causes.len());
    let noise = causes.iter().filter(|cause| **cause == Cause::ShotNoise);
    assert!(noise.count() * 2 > causes.len(), "mostly noise at night");

    let mut config = small(Preset::OutdoorDark, 1);
    config.model = Model::Steps;
    let mut night = emulate(config).expect("a scene");
    let error = night.read_with_causes(&mut events, &mut causes);
    assert!(error.expect_err("model 1").to_string().contains("model 2"));
}

#[test]
fn parameters_out_of_range_are_errors() {
    let bad = PixelParameters {
        threshold_on: 0.0,
        ..PixelParameters::default()
    };
    let error = emulate_with(small(Preset::OutdoorDark, 1), &bad).expect_err("no threshold");
    assert!(error.to_string().contains("threshold_on"), "{error}");
}

#[test]
fn every_parameter_works_at_the_ends_of_its_range() {
    for preset in [Preset::Motorcycle, Preset::OutdoorDark] {
        let mut config = small(preset, 9);
        config.sensor = Sensor {
            width: 30,
            height: 20,
        };
        config.duration_us = 20_000;
        // All effects at once, with little in between that would hide one of them.
        let base = PixelParameters {
            refractory_us: 0.0,
            threshold_spread: 0.3,
            hot_share: 0.1,
            stuck_share: 0.1,
            latency_us: 10_000.0,
            ..PixelParameters::default()
        };
        for parameter in PARAMETERS {
            let (least, most) = (parameter.least, parameter.most);
            // Between, by its order of magnitude, too.
            let small = 0.01 * most;
            for value in [least, small.max(least), (0.1 * most).max(least), most] {
                let mut pixel = base;
                pixel.set(parameter.name, value).expect("a value in range");
                if pixel.check().is_err() {
                    // Latency without jitter, one share at a time.
                    pixel.jitter_us = 0.0;
                    (pixel.hot_share, pixel.stuck_share) = (0.0, 0.0);
                    pixel.set(parameter.name, value).expect("a value in range");
                }
                let events = crate::events_with(config, &pixel);
                let is_inside = |e: &Event| config.sensor.contains(e.x, e.y) && e.t_us < 20_000;
                assert!(events.iter().all(is_inside), "{} {value}", parameter.name);
                assert!(events.is_sorted_by_key(|e| e.t_us));
                // A pixel of 10 kHz for 20 ms, and a jump across many small thresholds.
                assert!(events.len() < 600 * 2_000, "{} {value}", parameter.name);
            }
        }
    }
}
