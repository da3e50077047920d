//! The largest mean error of decoded times: kept by every chain of windows, whatever the coder and the scene.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::DecodedWindow;
use eecvs_nostd::coder::cells::spread_us;
use eecvs_nostd::{
    Cells, Coder, Config, Effort, Event, Fidelity, Hybrid, Mode, OUTPUT_BYTES_MIN, Polarity,
    Sensor, Thresholds, WindowConfig,
};
use event_metrics::compare;
use event_types::stream::{EventReader, MemoryReader};
use proptest::prelude::*;
use strategies::{encode, parse};

pub const SENSOR: Sensor = Sensor {
    width: 70,
    height: 5,
};

pub fn decode(frames: &[Vec<u8>]) -> Vec<DecodedWindow> {
    let bytes = frames.concat();
    let mut reader = WindowReader::new(FrameReader::new(&bytes[..]));
    let mut windows = Vec::new();
    while let Some(window) = reader.next_window().expect("memory") {
        windows.push(window);
    }
    assert!(reader.report().is_clean());
    windows
}

type Place = (u16, u16, Polarity);

/// Times by pixel and polarity, in order.
fn by_place(events: &[Event]) -> BTreeMap<Place, Vec<u64>> {
    let mut places: BTreeMap<Place, Vec<u64>> = BTreeMap::new();
    for event in events {
        let place = (event.y, event.x, event.polarity);
        places.entry(place).or_default().push(event.t_us);
    }
    places.values_mut().for_each(|times| times.sort_unstable());
    places
}

/// Sum of the errors of times in microseconds, in order by pixel and polarity.
fn error_us(a: &[Event], b: &[Event]) -> u64 {
    let (a, b) = (by_place(a), by_place(b));
    assert!(a.keys().eq(b.keys()));
    let errors = a.values().zip(b.values()).map(|(a, b)| {
        assert_eq!(a.len(), b.len());
        let errors = a.iter().zip(b).map(|(a, b)| a.abs_diff(*b));
        errors.sum::<u64>()
    });
    errors.sum()
}

/// Bursts, lone events, pixels with many: `kind` of each stretch of a pixel's events.
pub fn scene() -> impl Strategy<Value = Vec<Event>> {
    let stretch = (
        0_u16..70,
        0_u16..5,
        0_u64..40_000,
        1_u64..60,
        0_u64..2000,
        any::<u64>(),
    );
    proptest::collection::vec(stretch, 1..60).prop_map(|stretches| {
        let mut events = Vec::new();
        for (x, y, from_us, count, spacing_us, seed) in stretches {
            let mut t_us = 1_000_000 + from_us;
            for i in 0..count {
                let mixed = seed.wrapping_add(i).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32;
                t_us += mixed % (spacing_us + 1);
                let polarity = Polarity::from_bool(mixed >> 20 & 3 > 0);
                events.push(Event {
                    t_us,
                    x,
                    y,
                    polarity,
                });
            }
        }
        events.sort_by_key(|event| event.t_us);
        events
    })
}

pub fn coder() -> impl Strategy<Value = Coder> {
    proptest::sample::select(vec![
        Coder::Fast,
        Coder::Dense,
        Coder::Keys,
        Coder::Tree(Effort::One),
        Coder::Tree(Effort::Two),
    ])
}

fn config(coder: Coder, max_emd_us: u32, window_us: u32) -> Config {
    let mode = Mode::Hybrid(Hybrid {
        coder,
        fidelity: Fidelity::Lossless,
    });
    let thresholds = Thresholds::new(0, 0).expect("equal thresholds");
    Config {
        max_emd_us: NonZeroU32::new(max_emd_us),
        ..Config::new(WindowConfig::new(SENSOR, window_us), thresholds, mode)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// By windows of a chain, and as `eecvs compare` measures it over all.
    #[test]
    fn every_chain_keeps_the_mean_error(
        events in scene(), coder in coder(), key_windows in 1_u16..6, keep_order: bool,
        max_emd_us in prop_oneof![1_u32..20, 1_u32..1000, 1_u32..20_000],
        window_us in prop_oneof![1_u32..300, 1000_u32..5000, Just(32_768)],
        frame_bytes in prop_oneof![Just(OUTPUT_BYTES_MIN), OUTPUT_BYTES_MIN..4000, Just(1 << 20)],
    ) {
        let config = Config {
            key_windows,
            keep_order: keep_order && coder != Coder::Keys,
            ..config(coder, max_emd_us, window_us)
        };
        let lossless = Config { max_emd_us: None, ..config };
        let exact = decode(&encode(lossless, &events, 4000, 1 << 20));
        let frames = encode(config, &events, 4000, frame_bytes);
        let decoded = decode(&frames);
        prop_assert_eq!(exact.len(), decoded.len());
        let (mut error, mut asked) = (0, 0);
        for (a, b) in exact.iter().zip(&decoded) {
            if b.header.is_key {
                (error, asked) = (0, 0);
            }
            error += error_us(&a.events, &b.events);
            asked += u64::from(max_emd_us) * a.events.len() as u64;
            prop_assert!(error <= asked, "{error} of {asked}: {:?}", b.header.mode);
        }
        let mut all: Vec<Event> = decoded.into_iter().flat_map(|window| window.events).collect();
        all.sort_by_key(|event| event.t_us);
        let open = |events: Vec<Event>| {
            move || -> event_types::stream::Result<Box<dyn EventReader>> {
                Ok(Box::new(MemoryReader::new(SENSOR, events.clone())))
            }
        };
        let compared = compare(&open(events), &open(all), 32_768, &mut |_| ()).expect("in memory");
        prop_assert!(compared.emd_pixel_us <= f64::from(max_emd_us));
    }

    /// Events that are spread lie where the format says: at equal distances in their cell, by pixel and polarity.
    #[test]
    fn events_are_spread_evenly(
        events in scene(), coder in coder(), width_us in 1_u32..40_000,
        window_us in prop_oneof![1_u32..300, Just(32_768)],
    ) {
        let lossless = config(coder, 0, window_us);
        let fidelity = Fidelity::SpreadUs(width_us);
        let spread = Config { mode: Mode::Hybrid(Hybrid { coder, fidelity }), ..lossless };
        let exact = decode(&encode(lossless, &events, 4000, 1 << 20));
        let decoded = decode(&encode(spread, &events, 4000, 1 << 20));
        prop_assert_eq!(exact.len(), decoded.len());
        for (a, b) in exact.iter().zip(&decoded) {
            let (t0_us, cells) = (a.header.t0_us, Cells::new(fidelity, a.header.duration_us));
            let mut expected = Vec::new();
            for ((y, x, polarity), times) in by_place(&a.events) {
                let cell = |t_us: &u64| cells.of((t_us - t0_us) as u32);
                for run in times.chunk_by(|a, b| cell(a) == cell(b)) {
                    let (start_us, width_us) = cells.span_us(cell(&run[0])).expect("a cell of the window");
                    expected.extend((0..run.len() as u32).map(|i| {
                        let offset_us = start_us + spread_us(width_us, i, run.len() as u32);
                        Event { t_us: t0_us + u64::from(offset_us), x, y, polarity }
                    }));
                }
            }
            prop_assert_eq!(by_place(&expected), by_place(&b.events));
            let in_order = |events: &[Event]| events.is_sorted_by_key(|event| event.t_us);
            prop_assert!(coder != Coder::Keys || in_order(&b.events));
        }
    }
}

/// A scene whose pixels have many events each: their spread times are as near from wider cells.
#[test]
fn many_events_of_a_pixel_take_fewer_bits_spread() {
    let events: Vec<Event> = (0..20_000_u64)
        .map(|i| Event {
            t_us: i * 100,
            x: (i % 70) as u16,
            y: (i % 5) as u16,
            polarity: Polarity::On,
        })
        .collect();
    for coder in [Coder::Fast, Coder::Dense] {
        let size = |config: Config| -> usize {
            let frames = encode(config, &events, 4000, 1 << 20);
            assert!(frames.iter().all(|frame| !parse(frame).header.truncated));
            frames.iter().map(Vec::len).sum()
        };
        let tolerance = Mode::Hybrid(Hybrid {
            coder,
            fidelity: Fidelity::ToleranceUs(3999),
        });
        let fixed = size(Config {
            mode: tolerance,
            ..config(coder, 0, 32_768)
        });
        let asked = size(config(coder, 2000, 32_768));
        assert!(asked < fixed * 9 / 10, "{coder:?}: {asked} of {fixed}");
    }
}

/// Where several cells would do, times of a grid are not off by more than asked.
#[test]
fn times_on_a_grid_are_not_taken_for_even_ones() {
    // All at the ends of cells of 4 E - 1 = 399 us.
    let events: Vec<Event> = (0..4000_u64)
        .map(|i| Event {
            t_us: i / 4 * 399 + (i % 2) * 398,
            x: (i % 70) as u16,
            y: (i % 5) as u16,
            polarity: Polarity::On,
        })
        .collect();
    for coder in [Coder::Fast, Coder::Dense, Coder::Keys] {
        let decoded = decode(&encode(config(coder, 100, 32_768), &events, 4000, 1 << 20));
        let all: Vec<Event> = decoded
            .into_iter()
            .flat_map(|window| window.events)
            .collect();
        assert!(error_us(&events, &all) <= 100 * events.len() as u64);
    }
}
