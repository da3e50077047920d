//! The largest error of a window's smoothed volume: kept by every window, whatever the coder and the scene.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;

use eecvs::encode::volume_error::SIGMA_US;
use eecvs::encode::{Codec, Limits, encode};
use eecvs_nostd::Region;
use eecvs_nostd::{
    Coder, Config, Event, Fidelity, Filter, Hybrid, Mode, OUTPUT_BYTES_MIN, Polarity, Sensor,
    Thresholds, WindowConfig,
};
use event_types::stream::MemoryReader;
use proptest::prelude::*;

use crate::max_emd::{SENSOR, coder, decode, scene};

/// The integral of the squared volume, but for a factor, by the pairs of a pixel's impulses.
fn power(impulses: &BTreeMap<(u16, u16), Vec<(u64, i32)>>) -> f64 {
    let sigma = f64::from(SIGMA_US);
    let mut sum = 0.0;
    for impulses in impulses.values() {
        for (t_us, weight) in impulses {
            for (other_us, other) in impulses {
                let apart = t_us.abs_diff(*other_us) as f64 / (2.0 * sigma);
                sum += f64::from(weight * other) * (-apart * apart).exp();
            }
        }
    }
    sum
}

/// The normalised error of decoded events.
fn error(events: &[Event], decoded: &[Event]) -> f64 {
    let mut impulses: BTreeMap<_, Vec<_>> = BTreeMap::new();
    let mut add = |events: &[Event], weight: i32| {
        for event in events {
            let impulse = (event.t_us, weight * event.polarity.sign());
            let pixel: &mut Vec<_> = impulses.entry((event.y, event.x)).or_default();
            pixel.push(impulse);
        }
        power(&impulses)
    };
    let original = add(events, 1);
    let difference = add(decoded, -1);
    if difference < 1e-9 * original.max(1.0) {
        return 0.0;
    }
    difference / original
}

fn config(coder: Coder, window_us: u32) -> Config {
    let mode = Mode::Hybrid(Hybrid {
        coder,
        fidelity: Fidelity::Lossless,
    });
    let thresholds = Thresholds::new(0, 0).expect("equal thresholds");
    Config::new(WindowConfig::new(SENSOR, window_us), thresholds, mode)
}

fn frames(config: Config, max_nmse: Option<f64>, events: &[Event], limits: Limits) -> Vec<u8> {
    let codec = Codec {
        max_nmse,
        ..Codec::from(config)
    };
    let run = |threads| {
        let mut reader = MemoryReader::new(config.window.sensor, events.to_vec());
        let mut bytes = Vec::new();
        let threads = NonZeroUsize::new(threads).expect("not 0");
        encode(&mut reader, codec, limits, threads, &mut bytes, &mut |_| ()).expect("in memory");
        bytes
    };
    let bytes = run(1);
    assert_eq!(bytes, run(3), "threads make other frames");
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn every_window_keeps_the_error(
        events in scene(), coder in coder(), key_windows in 1_u16..6,
        isolated: bool, region: bool, keep_order: bool,
        max_nmse in prop_oneof![0.0001..0.01, 0.01..0.2, 0.2..1.0],
        window_us in prop_oneof![1_u32..300, 1000_u32..5000, Just(32_768), Just(1 << 20)],
        frame_bytes in prop_oneof![Just(OUTPUT_BYTES_MIN), OUTPUT_BYTES_MIN..4000, Just(1 << 20)],
    ) {
        let config = Config {
            key_windows,
            keep_order: keep_order && coder != Coder::Keys,
            filter: Filter {
                isolated: isolated && coder != Coder::Keys,
                region: region.then_some(Region { x: 3, y: 1, width: 40, height: 3 }),
            },
            ..config(coder, window_us)
        };
        let limits = Limits { window_events: 4000, frame_bytes, ..Limits::default() };
        let exact = decode(&[frames(config, None, &events, limits)]);
        let decoded = decode(&[frames(config, Some(max_nmse), &events, limits)]);
        prop_assert_eq!(exact.len(), decoded.len());
        for (a, b) in exact.iter().zip(&decoded) {
            prop_assert_eq!(a.events.len(), b.events.len());
            let error = error(&a.events, &b.events);
            prop_assert!(error <= max_nmse * (1.0 + 1e-6), "{error}: {:?}", b.header.mode);
        }
    }
}

/// A lone event that is off by d changes its pixel's volume by 2 (1 - exp(-d^2 / 4 sigma^2)), which is d^2 / 2 sigma^2 for
/// small d. With d spread over -w..w that is w^2 / 6 sigma^2 on average.
#[test]
fn lone_events_get_the_tolerance_of_the_formula() {
    let sensor = Sensor {
        width: 100,
        height: 100,
    };
    let events: Vec<_> = (0..10_000_u32)
        .map(|i| Event {
            t_us: u64::from(i * 3),
            x: (i % 100) as u16,
            y: (i / 100) as u16,
            polarity: Polarity::from_bool(i % 3 > 0),
        })
        .collect();
    for max_nmse in [0.0001, 0.001, 0.01] {
        let expected_us = f64::from(SIGMA_US) * (6.0_f64 * max_nmse).sqrt();
        for coder in [Coder::Fast, Coder::Keys, Coder::Dense] {
            let mut config = config(coder, 32_768);
            config.window.sensor = sensor;
            let bytes = frames(config, Some(max_nmse), &events, Limits::default());
            let windows = decode(&[bytes]);
            let [window] = &windows[..] else {
                panic!("one window");
            };
            let Mode::Hybrid(Hybrid {
                fidelity: Fidelity::ToleranceUs(tolerance_us),
                ..
            }) = window.header.mode
            else {
                panic!("{:?}", window.header.mode);
            };
            let share = f64::from(tolerance_us) / expected_us;
            assert!(
                (0.88..1.05).contains(&share),
                "{max_nmse}: {tolerance_us} us"
            );
        }
    }
}

/// Events of both signs whose volume is the difference of a high order of a Gaussian: next to nothing.
#[test]
fn events_that_cancel_keep_their_times() {
    let multiplicities = [1, 6, 15, 20, 15, 6, 1];
    let mut events = Vec::new();
    for (i, count) in multiplicities.into_iter().enumerate() {
        let event = Event {
            t_us: 20_000 + 10 * i as u64,
            x: 3,
            y: 3,
            polarity: Polarity::from_bool(i % 2 > 0),
        };
        events.extend(std::iter::repeat_n(event, count));
    }
    let bytes = frames(
        config(Coder::Fast, 32_768),
        Some(0.99),
        &events,
        Limits::default(),
    );
    let windows = decode(&[bytes]);
    let [window] = &windows[..] else {
        panic!("one window");
    };
    assert_eq!(window.events, events);
}

#[test]
fn coders_without_a_tolerance_are_refused() {
    for mode in [
        Mode::Transform,
        Mode::Hybrid(Hybrid {
            coder: Coder::Quick,
            fidelity: Fidelity::Lossless,
        }),
    ] {
        let codec = Codec {
            max_nmse: Some(0.1),
            ..Codec::from(Config {
                mode,
                ..config(Coder::Fast, 1000)
            })
        };
        for threads in [1, 2] {
            let events = vec![Event::UNSET; 9];
            let mut reader = MemoryReader::new(SENSOR, events);
            let threads = NonZeroUsize::new(threads).expect("not 0");
            let limits = Limits::default();
            let mut bytes = Vec::new();
            let refused = encode(&mut reader, codec, limits, threads, &mut bytes, &mut |_| ());
            let message = refused.expect_err("no tolerance").to_string();
            assert!(message.contains("mode hybrid"), "{message}");
        }
    }
}
