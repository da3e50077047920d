//! Events of equal time come back in the order in which they came, where that is asked for.

use std::num::{NonZeroU32, NonZeroUsize};
use std::path::Path;

use eecvs::decode::{FrameCounts, WindowReader};
use eecvs::encode::{HostStorage, Limits, encode as encode_file, readout};
use eecvs::frame_file::{FrameReader, LinkReport};
use eecvs::reconstruct::order::by_time;
use eecvs_bench::table::keep_order::{self, Row};
use eecvs_nostd::frame::OrderSection;
use eecvs_nostd::{
    Cells, Coder, Config, ConfigError, Event, Fidelity, Filter, Frame, FrameError, Header, Hybrid,
    Mode, OUTPUT_BYTES_MIN, Polarity, Region, Sensor, SetupError, Storage, Transform, bitmap_words,
    segments,
};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use proptest::prelude::*;
use strategies::{
    encode, encode_windows, hold_against_record, hybrid, job, parse, plain_config, sealed,
};

const CODERS: [Coder; 2] = [Coder::Fast, Coder::Dense];

fn lossless(coder: Coder) -> Mode {
    let fidelity = Fidelity::Lossless;
    Mode::Hybrid(Hybrid { coder, fidelity })
}

/// Windows as `eecvs decode` writes them, and what is said of them.
fn decode(bytes: &[u8]) -> (Vec<(Header, Vec<Event>)>, FrameCounts, LinkReport) {
    let mut reader = WindowReader::new(FrameReader::new(bytes));
    let mut windows = Vec::new();
    while let Some(window) = reader.next_window().expect("memory") {
        // As the events are written.
        windows.push((window.header, by_time(&window.header, &window.events)));
    }
    (windows, reader.counts(), reader.report().clone())
}

/// An event as a decoder is told it.
type Told = (u32, u16, u16, Polarity);

fn told(header: &Header, event: &Event) -> Told {
    let Mode::Hybrid(Hybrid { fidelity, .. }) = header.mode else {
        panic!("events were asked for")
    };
    let cells = Cells::new(fidelity, header.duration_us);
    let offset_us = (event.t_us - header.t0_us) as u32;
    (cells.of(offset_us), event.x, event.y, event.polarity)
}

/// The frames, and the events as they came of each window of which frames have some.
fn frames_and_windows(
    config: Config,
    events: &[Event],
    window_events: usize,
    frame_bytes: usize,
) -> (Vec<Vec<u8>>, Vec<Vec<Event>>) {
    let (frames, windows) = encode_windows(config, &[], events, (window_events, frame_bytes));
    let sent = windows.into_iter().filter(|(_, sent)| *sent > 0);
    (frames, sent.map(|(window, _)| window).collect())
}

/// A window's events in the order of what is told of their times, and of their arrival.
fn in_order(header: &Header, window: &[Event]) -> Vec<Told> {
    let mut expected: Vec<_> = window.iter().map(|event| told(header, event)).collect();
    expected.sort_by_key(|told| told.0);
    expected
}

fn is_subsequence(of: &[Told], part: &[Told]) -> bool {
    let mut rest = of.iter();
    part.iter().all(|told| rest.any(|other| other == told))
}

/// Any coder that tells the order of events, and any fidelity that has one.
fn ordered() -> impl Strategy<Value = Hybrid> {
    hybrid().prop_map(|hybrid| Hybrid {
        coder: match hybrid.coder {
            Coder::Keys => Coder::Fast,
            coder => coder,
        },
        fidelity: match hybrid.fidelity {
            Fidelity::SpreadUs(width_us) => Fidelity::ToleranceUs(width_us),
            fidelity => fidelity,
        },
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Whatever the coder, the fidelity, the sizes of windows and frames, the filters and the budget.
    #[test]
    fn every_window_comes_back_in_order(
        (config, events) in job(400), hybrid in ordered(), ties in 1_u64..30, key_windows in 1_u16..5,
        window_events in prop_oneof![1..40_usize, Just(1000)],
        frame_bytes in prop_oneof![Just(OUTPUT_BYTES_MIN), OUTPUT_BYTES_MIN..1000, Just(1 << 16)],
        (region, isolated, budget) in (any::<bool>(), any::<bool>(), prop_oneof![Just(0), 300_000_u32..3_000_000]),
    ) {
        // The quick coder has neither.
        let is_quick = hybrid.coder == Coder::Quick;
        let (isolated, budget) = (isolated && !is_quick, if is_quick { 0 } else { budget });
        // Many events of a time, and both polarities in a pixel.
        let mut events = events;
        for event in &mut events {
            event.t_us -= event.t_us % ties;
        }
        let region = region.then_some(Region { x: 0, y: 0, width: 40, height: 20 });
        let config = Config {
            mode: Mode::Hybrid(hybrid),
            filter: Filter { region, isolated },
            bytes_per_second: NonZeroU32::new(budget).filter(|_| config.window.window_us > 2000),
            key_windows,
            keep_order: true,
            ..config
        };
        let (frames, windows) = frames_and_windows(config, &events, window_events, frame_bytes);
        let (decoded, counts, report) = decode(&frames.concat());
        prop_assert!(report.is_clean(), "{:?}", report);
        prop_assert_eq!(counts.windows_order_lost, 0);
        if config.bytes_per_second.is_none() {
            prop_assert_eq!(counts.windows_in_order as usize, decoded.len());
        }
        for frame in &frames {
            prop_assert!(frame.len() <= frame_bytes);
        }
        prop_assert_eq!(decoded.len(), windows.len());
        for ((header, events), window) in decoded.into_iter().zip(windows) {
            let found: Vec<_> = events.iter().map(|event| told(&header, event)).collect();
            prop_assert!(found.is_sorted_by_key(|told| told.0));
            let expected = in_order(&header, &window);
            if config.bytes_per_second.is_some() {
                // Some are left out, and the order where there is no room for it.
                let mut sorted = (expected, found);
                sorted.0.sort_unstable();
                sorted.1.sort_unstable();
                prop_assert!(is_subsequence(&sorted.0, &sorted.1));
            } else if isolated {
                prop_assert!(is_subsequence(&expected, &found));
            } else {
                let is_kept = |told: &Told| region.is_none() || (told.1 < 40 && told.2 < 20);
                let expected: Vec<_> = expected.into_iter().filter(is_kept).collect();
                prop_assert_eq!(found, expected);
            }
        }
    }

    /// What is told of the events does not change with what is told of their order.
    #[test]
    fn the_order_stands_beside_the_events((config, events) in job(300), hybrid in ordered()) {
        let config = Config { mode: Mode::Hybrid(hybrid), ..config };
        let ordered = Config { keep_order: true, ..config };
        let plain = encode(config, &events, 1000, 1 << 16);
        let ordered = encode(ordered, &events, 1000, 1 << 16);
        prop_assert_eq!(plain.len(), ordered.len());
        for (plain, ordered) in plain.iter().zip(&ordered) {
            let (plain, ordered) = (parse(plain), parse(ordered));
            prop_assert_eq!(plain.payload, ordered.sections().0);
            prop_assert_eq!(plain.sections(), (plain.payload, &[][..]));
            let without = Header { order: None, ..ordered.header };
            prop_assert_eq!(without, plain.header);
        }
    }

    /// A lost frame costs its window's order at the most; the others have theirs.
    #[test]
    fn a_lost_frame_costs_the_order_of_its_window(
        (config, events) in job(300), lost in any::<prop::sample::Index>(),
        coder in prop::sample::select(&CODERS[..]),
    ) {
        let config = Config { mode: lossless(coder), key_windows: 1, keep_order: true, ..config };
        let (mut frames, _) = frames_and_windows(config, &events, 60, OUTPUT_BYTES_MIN);
        prop_assume!(frames.len() > 1);
        let (all, counts, _) = decode(&frames.concat());
        prop_assert_eq!(counts.windows_in_order as usize, all.len());
        let lost = lost.index(frames.len());
        let header = parse(&frames.remove(lost)).header;
        let (decoded, counts, report) = decode(&frames.concat());
        prop_assert_eq!(report.frames_malformed, 0);
        let touched = |other: &Header| (other.t0_us, other.duration_us) == (header.t0_us, header.duration_us);
        let others = |windows: Vec<(Header, Vec<Event>)>| -> Vec<_> {
            windows.into_iter().filter(|window| !touched(&window.0)).map(|window| window.1).collect()
        };
        let left = all.iter().filter(|window| !touched(&window.0)).count() as u64;
        prop_assert_eq!(others(decoded), others(all));
        prop_assert!(counts.windows_in_order >= left);
        prop_assert!(counts.windows_order_lost <= 1);
    }

    /// Any bytes as the order, any claim of it: an order of the same events, or refused.
    #[test]
    fn any_order_is_one_or_refused(
        (config, events) in job(200), coder in prop::sample::select(&CODERS[..]),
        bytes in proptest::collection::vec(any::<u8>(), 0..60), cut in 0_usize..60, cuts: bool,
        (last, part, events_told) in (any::<bool>(), 0_u32..3, 1_u32..300),
    ) {
        let config = Config { mode: lossless(coder), keep_order: true, ..config };
        let frames = encode(config, &events, 1000, 1 << 16);
        let mut damaged = Vec::new();
        for bytes_of in &frames {
            let frame = parse(bytes_of);
            let (payload, order) = frame.sections();
            let order = if cuts { &order[..cut.min(order.len())] } else { &bytes };
            let header = Header {
                last,
                part,
                order: Some(OrderSection {
                    bytes: order.len() as u32,
                    events: if last { 0 } else { events_told },
                }),
                ..frame.header
            };
            damaged.extend(sealed(&header, &[payload, order].concat()));
        }
        let multiset = |windows: Vec<(Header, Vec<Event>)>| {
            let mut events: Vec<_> = windows.into_iter().flat_map(|window| window.1).collect();
            events.sort_unstable();
            events
        };
        let (all, ..) = decode(&frames.concat());
        let (decoded, counts, report) = decode(&damaged);
        prop_assert!(counts.windows_in_order as usize <= decoded.len());
        let (all, found) = (multiset(all), multiset(decoded));
        if report.is_clean() {
            prop_assert_eq!(found, all);
        } else {
            let mut rest = all.iter();
            prop_assert!(found.iter().all(|event| rest.any(|other| other == event)));
        }
    }
}

#[test]
fn claims_out_of_range_are_refused() {
    let sensor = Sensor::new(8, 8).expect("a sensor");
    let events = [0, 0, 5].map(|t_us| Event {
        t_us,
        x: 1,
        y: 1,
        polarity: Polarity::On,
    });
    let config = Config {
        mode: lossless(Coder::Fast),
        keep_order: true,
        ..plain_config(sensor, Transform::Dct, 8)
    };
    let bytes = encode(config, &events, 10, 1 << 16).concat();
    let header = parse(&bytes).header;
    let with = |last, bytes, events, mode| Header {
        mode,
        last,
        order: Some(OrderSection { bytes, events }),
        ..header
    };
    let parsed =
        |header: &Header| Frame::parse(&sealed(header, &[0; 10])).map(|frame| frame.header);
    for (name, header) in [
        ("more than the payload", with(true, 11, 0, header.mode)),
        ("none of the window's", with(false, 5, 0, header.mode)),
        ("all, and not the last", with(false, 5, 3, header.mode)),
        ("of coefficients", with(true, 0, 0, Mode::Transform)),
    ] {
        assert_eq!(parsed(&header), Err(FrameError::HeaderInvalid), "{name}");
    }
    for header in [
        with(true, 10, 0, header.mode),
        with(false, 0, 2, header.mode),
    ] {
        assert_eq!(parsed(&header), Ok(header));
    }
}

/// The wire format is pinned: a group along rows, one backwards, one of any order; and again along columns.
#[test]
fn the_orders_bytes_are_frozen() {
    let sensor = Sensor::new(40, 40).expect("a sensor");
    for (turned, frozen) in [
        (
            false,
            "003f0fb5bcbd103c06bbdd91b43626ef3f2dca35154cc77749f1f76e",
        ),
        (
            true,
            "803f0fb4bcbd103c06bbdd91b43626ef3f2dca35154cc77749f1f76e",
        ),
    ] {
        let events: Vec<Event> = (0..120_u16)
            .map(|i| {
                let (group, at) = (i / 40, i % 40);
                let at = [at, 39 - at, at * 17 % 40][usize::from(group)];
                let (x, y) = (at % 20, at / 20 + 3);
                let (x, y) = if turned { (y, x) } else { (x, y) };
                Event {
                    t_us: u64::from(group),
                    x,
                    y,
                    polarity: Polarity::from_bool(i % 3 == 0),
                }
            })
            .collect();
        for coder in CODERS {
            let config = Config {
                mode: lossless(coder),
                keep_order: true,
                ..plain_config(sensor, Transform::Dct, 8)
            };
            let frames = encode(config, &events, 1000, 1 << 16);
            let (_, order) = parse(&frames[0]).sections();
            let hex: String = order.iter().map(|byte| format!("{byte:02x}")).collect();
            assert_eq!(hex, frozen);
        }
    }
}

/// The setup says what cannot keep an order.
#[test]
fn coefficients_and_missing_memory_are_refused() {
    const SEGMENTS: usize = segments(8, 8);
    let sensor = Sensor::new(8, 8).expect("a sensor");
    let config = Config {
        keep_order: true,
        ..plain_config(sensor, Transform::Dct, 8)
    };
    let refused = Some(SetupError::Config(ConfigError::Order));
    for mode in [Mode::Transform, lossless(Coder::Fast)] {
        let config = Config { mode, ..config };
        let mut storage = Storage::<16, SEGMENTS, { bitmap_words(SEGMENTS) }, 64>::new();
        assert_eq!(storage.encoder(config).err(), refused);
    }
    let error = HostStorage::new(sensor, 10).encoder(config).err();
    assert!(error.expect("refused").to_string().contains("order"));
}

/// However many events share a time, one takes no longer: here all of 200,000 do, in any order.
#[test]
fn a_window_of_one_time_is_ordered_at_once() {
    let sensor = Sensor::new(640, 480).expect("a sensor");
    let events: Vec<Event> = (0..200_000_u32)
        .map(|i| {
            let at = i.wrapping_mul(2_654_435_761) >> 8;
            Event {
                t_us: 7,
                x: (at % 640) as u16,
                y: (at / 640 % 480) as u16,
                polarity: Polarity::from_bool(at % 3 == 0),
            }
        })
        .collect();
    for coder in CODERS {
        let config = Config {
            mode: lossless(coder),
            keep_order: true,
            ..plain_config(sensor, Transform::Dct, 8)
        };
        for frame_bytes in [1 << 22, 60_000] {
            let frames = encode(config, &events, 1 << 18, frame_bytes);
            let (windows, counts, report) = decode(&frames.concat());
            assert!(report.is_clean() && counts.windows_in_order == 1);
            assert!(windows.len() == 1 && windows[0].1 == events);
        }
    }
}

/// The events of a reader, and those of the frames of it.
fn there_and_back(mut open: impl FnMut() -> Box<dyn EventReader>, coder: Coder) -> f64 {
    let mut events = Vec::new();
    let mut reader = open();
    while reader.read(&mut events).expect("a recording") > 0 {}
    let config = Config {
        mode: lossless(coder),
        keep_order: true,
        ..plain_config(reader.sensor(), Transform::Dct, 8)
    };
    let config = readout::look_at(&events, config);
    let (mut bytes, threads) = (Vec::new(), NonZeroUsize::new(2).expect("not 0"));
    let summary = encode_file(
        open().as_mut(),
        config,
        Limits::default(),
        threads,
        &mut bytes,
        &mut |_| (),
    )
    .expect("encoding works");
    assert_eq!(summary.windows_in_order, summary.windows);
    let (windows, ..) = decode(&bytes);
    let decoded: Vec<_> = windows.into_iter().flat_map(|window| window.1).collect();
    assert!(decoded == events, "not the events as they came");
    summary.order_bits_per_event()
}

#[test]
fn scenes_come_back_in_order() {
    for preset in [Preset::IndoorDarkHdr, Preset::Motorcycle] {
        let config = SceneConfig {
            duration_us: 60_000,
            ..SceneConfig::model_1(preset, 1)
        };
        for coder in CODERS {
            there_and_back(|| Box::new(emulate(config).expect("a scene")), coder);
        }
    }
}

/// And what their order costs, which is held against its record: at most what the number of orders of equal times does, log2 of it, and a
/// little that is learned.
#[test]
fn recordings_come_back_in_order() {
    let (mut rows, mut is_whole) = (Vec::new(), true);
    for (name, most_bits) in [
        ("davis346_building_dense/davis.aedat4", 0.58),
        ("davis240_boxes_moderate/IMU_translBoxes.aedat", 0.09),
        ("dvxl_person_moderate/data_sample.aedat4", 0.14),
        ("gen3_vga_dense_evt2/evt2.raw", 1.5),
        ("dvs128_walking_sparse/neal_walking.aedat", 0.02),
    ] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
        let path = folder.join(name);
        if !path.exists() {
            eprintln!("skipped: {} is absent", path.display());
            is_whole = false;
            continue;
        }
        for coder in CODERS {
            let bits = there_and_back(
                || event_files::open(&path, None).expect("a recording"),
                coder,
            );
            assert!(bits < most_bits, "{name}: {bits}");
            rows.push(Row {
                recording: name.split('/').next().unwrap_or(name).to_owned(),
                coder: coder.name().to_owned(),
                order_bits_per_event: bits,
            });
        }
    }
    if is_whole {
        let section = keep_order::document(&rows);
        let place = ("docs/results.md", keep_order::MARKS);
        hold_against_record("keep-order", &rows, 0.0, place, |_| Some(section));
    }
}
