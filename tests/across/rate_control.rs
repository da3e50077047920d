//! Rate control: no second exceeds its budget, no window is without a frame, every event is
//! accounted for, and full fidelity returns when a flood is over.
//!
//! A flood under three budgets, of a shared recording where it is present, is held against
//! `host-harness/record/rate-control.json`, of which a document's table is made.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::path::Path;

use eecvs::decode::WindowReader;
use eecvs::encode::{Budget, Codec, Limits, encode as encode_all};
use eecvs::frame_file::FrameReader;
use eecvs_bench::table::rate_control::{self, Row};
use eecvs_nostd::{
    Coder, Config, Event, Fidelity, Header, Hybrid, Mode, Polarity, Sensor, Transform,
};
use event_files::{EventReader, Skipped};
use event_metrics::compare;
use proptest::prelude::*;
use strategies::{encode, hold_against_record, parse, plain_config};

/// A frame without events, which every window has room for: the budget is exceeded by no more.
const EMPTY_FRAME_BYTES: u64 = 80;

fn with_budget(sensor: Sensor, coder: Coder, fidelity: Fidelity, budget: u32) -> Config {
    Config {
        mode: Mode::Hybrid(Hybrid { coder, fidelity }),
        bytes_per_second: NonZeroU32::new(budget),
        ..plain_config(sensor, Transform::Dct, 8)
    }
}

/// Most bytes of frames whose windows end within a second.
fn most_in_a_second(frames: &[Vec<u8>]) -> u64 {
    let end_and_bytes = |bytes: &Vec<u8>| {
        let header = parse(bytes).header;
        (
            header.t0_us + u64::from(header.duration_us),
            bytes.len() as u64,
        )
    };
    let ends: Vec<_> = frames.iter().map(end_and_bytes).collect();
    let from = |(i, (start_us, _)): (usize, &(u64, u64))| {
        let second = ends[i..]
            .iter()
            .take_while(|end| end.0 < start_us + 1_000_000);
        second.map(|end| end.1).sum()
    };
    ends.iter().enumerate().map(from).max().unwrap_or(0)
}

/// Lowers and raises a budget while frames are written, and keeps what held when.
struct Changing<'b> {
    budget: &'b Budget,
    /// Budgets in bytes a second, a new one after so many frames each.
    budgets: &'b [u32],
    frames_each: usize,
    frames: Vec<(Vec<u8>, u32)>,
}

impl std::io::Write for Changing<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let of = |frame: usize| self.budgets[frame / self.frames_each % self.budgets.len()];
        self.frames.push((bytes.to_vec(), of(self.frames.len())));
        // It holds for the frames of the next window.
        self.budget.set(Some(of(self.frames.len())));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A budget that changes while windows are encoded: no second exceeds the larger of those that held in it, and all events
/// are accounted for.
#[test]
fn a_budget_may_change() {
    let sensor = Sensor::new(64, 48).expect("a size");
    let events = scene(sensor, &[(6000, 200, true)]);
    for coder in [Coder::Fast, Coder::Dense] {
        let config = Config {
            window: eecvs_nostd::WindowConfig::new(sensor, 10_000),
            ..with_budget(sensor, coder, Fidelity::Lossless, 0)
        };
        let budgets = [400_000, 50_000, 200_000, 20_000];
        let budget = Budget::new(Some(budgets[0]));
        let codec = Codec {
            budget: Some(&budget),
            ..Codec::from(config)
        };
        let mut out = Changing {
            budget: &budget,
            budgets: &budgets,
            // More than a second.
            frames_each: 120,
            frames: Vec::new(),
        };
        let mut reader = Memory(events.clone().into_iter(), sensor, Skipped::default());
        let threads = std::num::NonZeroUsize::new(2).expect("2");
        let limits = Limits::default();
        let summary = encode_all(&mut reader, codec, limits, threads, &mut out, &mut |_| {});
        let summary = summary.expect("encoded");
        assert_eq!(summary.threads, 1);
        assert_eq!(summary.events_in, events.len() as u64);
        assert!(summary.events_thinned > 0 && summary.events_encoded > 0);
        let ends: Vec<(u64, u64, u32)> = out
            .frames
            .iter()
            .map(|(bytes, budget)| {
                let header = parse(bytes).header;
                let end_us = header.t0_us + u64::from(header.duration_us);
                (end_us, bytes.len() as u64, *budget)
            })
            .collect();
        for (i, (start_us, ..)) in ends.iter().enumerate() {
            let second = || {
                ends[i..]
                    .iter()
                    .take_while(|end| end.0 < start_us + 1_000_000)
            };
            let bytes: u64 = second().map(|end| end.1).sum();
            let largest = second().map(|end| u64::from(end.2)).max().unwrap_or(0);
            assert!(bytes <= largest + EMPTY_FRAME_BYTES, "{bytes} of {largest}");
        }
    }
}

/// Checks everything but the fidelity; the headers by window.
fn check(config: Config, events: &[Event], frames: &[Vec<u8>]) -> Vec<Vec<Header>> {
    let budget = u64::from(config.bytes_per_second.map_or(0, NonZeroU32::get));
    let mut windows: BTreeMap<u64, Vec<Header>> = BTreeMap::new();
    let mut accounted = 0;
    for bytes in frames {
        let header = parse(bytes).header;
        accounted +=
            header.events + header.late + header.filtered + header.dropped + header.thinned;
        windows.entry(header.t0_us).or_default().push(header);
        if header.events == 0 {
            assert!(bytes.len() as u64 <= EMPTY_FRAME_BYTES);
        }
    }
    assert_eq!(accounted as usize, events.len());
    let most = most_in_a_second(frames);
    assert!(
        most <= budget + EMPTY_FRAME_BYTES,
        "{most} bytes of {budget}"
    );
    // No window without a frame: every event's time is in one.
    for event in events {
        let window = windows.range(..=event.t_us).next_back();
        let header = window.expect("a window before the event").1[0];
        assert!(event.t_us - header.t0_us < u64::from(header.duration_us));
    }
    let bytes = frames.concat();
    let mut reader = WindowReader::new(FrameReader::new(&bytes[..]));
    let mut decoded = 0;
    while let Some(window) = reader.next_window().expect("memory") {
        decoded += window.events.len() as u64;
    }
    assert!(reader.report().is_clean(), "{:?}", reader.report());
    let counts = reader.counts();
    assert_eq!(counts.events_exact + counts.events_approximate, decoded);
    assert_eq!(
        decoded + counts.events_thinned + counts.events_late + counts.events_dropped,
        events.len() as u64
    );
    windows.into_values().collect()
}

/// Events of stretches of some rate each, a millisecond's worth at a time, spread or in a corner.
fn scene(sensor: Sensor, stretches: &[(u32, u32, bool)]) -> Vec<Event> {
    let mut events = Vec::new();
    let (mut t_us, mut seed) = (1_000_000_u64, 1_u32);
    let mut random = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        seed >> 8
    };
    for (milliseconds, events_per_ms, is_spread) in stretches {
        for _ in 0..*milliseconds {
            let mut times: Vec<u64> = (0..*events_per_ms)
                .map(|_| t_us + u64::from(random() % 1000))
                .collect();
            times.sort_unstable();
            for t_us in times {
                let (width, height) = if *is_spread {
                    (sensor.width, sensor.height)
                } else {
                    (sensor.width.min(20), sensor.height.min(20))
                };
                events.push(Event {
                    t_us,
                    x: (random() % u32::from(width)) as u16,
                    y: (random() % u32::from(height)) as u16,
                    polarity: Polarity::from_bool(random() % 3 == 0),
                });
            }
            t_us += 1000;
        }
    }
    events
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn no_second_exceeds_its_budget(
        (width, height) in (1_u16..400, 1_u16..300),
        stretches in proptest::collection::vec((1_u32..300, prop_oneof![0_u32..5, 0_u32..400], any::<bool>()), 1..6),
        budget in prop_oneof![10_000_u32..100_000, 10_000_u32..4_000_000],
        is_dense: bool,
        fidelity in prop_oneof![
            Just(Fidelity::Lossless),
            (0_u32..5000).prop_map(Fidelity::ToleranceUs),
            (1_u16..100).prop_map(Fidelity::Bins),
        ],
        window_us in prop_oneof![Just(32_768_u32), 20_000_u32..2_000_000],
        frame_bytes in prop_oneof![Just(1_usize << 20), Just(4096)],
    ) {
        let sensor = Sensor::new(width, height).expect("a sensor");
        let events = scene(sensor, &stretches);
        let coder = if is_dense { Coder::Dense } else { Coder::Fast };
        let mut config = with_budget(sensor, coder, fidelity, budget);
        config.window.window_us = window_us;
        let frames = encode(config, &events, 1 << 17, frame_bytes);
        check(config, &events, &frames);
    }
}

/// A recording in memory.
struct Memory(std::vec::IntoIter<Event>, Sensor, Skipped);

impl EventReader for Memory {
    fn format(&self) -> &'static str {
        "memory"
    }

    fn sensor(&self) -> Sensor {
        self.1
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        let before = events.len();
        events.extend(self.0.by_ref().take(1 << 14));
        Ok(events.len() - before)
    }

    fn skipped(&self) -> &Skipped {
        &self.2
    }
}

/// Mean error of an event's time, by pixel, from some time on: see the metrics.
fn emd_pixel_us(sensor: Sensor, events: &[Event], frames: &[Vec<u8>], from_us: u64) -> f64 {
    let bytes = frames.concat();
    let mut windows = WindowReader::new(FrameReader::new(&bytes[..]));
    let mut decoded = Vec::new();
    while let Some(window) = windows.next_window().expect("memory") {
        decoded.extend(window.events);
    }
    let later = |events: &[Event]| -> Vec<Event> {
        let mut later: Vec<_> = events
            .iter()
            .copied()
            .filter(|event| event.t_us >= from_us)
            .collect();
        later.sort_by_key(|event| event.t_us);
        later
    };
    let (a, b) = (later(events), later(&decoded));
    let open = |events: Vec<Event>| {
        move || -> event_types::stream::Result<Box<dyn EventReader>> {
            let events = events.clone().into_iter();
            Ok(Box::new(Memory(events, sensor, Skipped::default())))
        }
    };
    let compared = compare(&open(a), &open(b), 32_768, &mut |_| ()).expect("memory");
    compared.emd_pixel_us
}

fn is_exact(window: &[Header]) -> bool {
    window
        .iter()
        .all(|header| header.mode.is_lossless() && header.thinned == 0)
}

/// Half a second of quiet, as much of a flood, and so on.
#[test]
fn full_fidelity_returns_within_two_windows() {
    let sensor = Sensor::new(346, 260).expect("a sensor");
    let (quiet, flood) = ((500, 20, true), (500, 1500, true));
    let events = scene(sensor, &[quiet, flood, quiet, flood, quiet]);
    for coder in [Coder::Fast, Coder::Dense] {
        let config = with_budget(sensor, coder, Fidelity::Lossless, 500_000);
        let frames = encode(config, &events, 1 << 17, 1 << 20);
        let windows = check(config, &events, &frames);
        let mut since_flood = 10;
        let (mut exact, mut degraded) = (0, 0);
        for window in &windows {
            let header = window[0];
            let half = |t_us: u64| (t_us - 1_000_000) / 500_000;
            let end_us = header.t0_us + u64::from(header.duration_us) - 1;
            if half(header.t0_us) % 2 == 1 || half(end_us) % 2 == 1 {
                since_flood = 0;
                degraded += u32::from(!is_exact(window));
                continue;
            }
            since_flood += 1;
            assert!(since_flood <= 2 || is_exact(window), "{coder:?} {header:?}");
            exact += u32::from(is_exact(window));
        }
        assert!(
            exact > 40 && degraded > 25,
            "{exact} exact, {degraded} degraded"
        );
    }
}

/// The flood of a real sensor under the budgets of links: checked, and held against its record.
#[test]
fn a_flood_fits_its_link() {
    let path = "../../shared/data/gen3_vga_dense_evt2/evt2.raw";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    if !path.exists() {
        eprintln!("skipped: {} is absent", path.display());
        return;
    }
    let mut reader = event_files::open(&path, None).expect("a recording");
    let mut once = Vec::new();
    while reader.read(&mut once).expect("a recording") > 0 {}
    let first = once.iter().map(|event| event.t_us).min().expect("events");
    let last = once.iter().map(|event| event.t_us).max().expect("events");
    // The recording is a tenth of a second: over and over again it is one and a half.
    let events: Vec<Event> = (0..16_u64)
        .flat_map(|i| {
            let later = i * (last + 1 - first);
            once.iter().map(move |event| Event {
                t_us: event.t_us + later,
                ..*event
            })
        })
        .collect();
    let mut rows = Vec::new();
    // Of the last pass: what was learned at first has settled.
    let last_pass_us = first + 15 * (last + 1 - first);
    for budget in [12_800_000, 4_000_000, 1_000_000] {
        for coder in [Coder::Fast, Coder::Dense] {
            let config = with_budget(reader.sensor(), coder, Fidelity::Lossless, budget);
            let frames = encode(config, &events, 1 << 20, 1 << 24);
            let windows = check(config, &events, &frames);
            let (mut exact, mut approximate, mut missing) = (0_u64, 0_u64, 0_u64);
            for header in windows.iter().flatten() {
                missing += u64::from(header.thinned);
                match header.mode.is_lossless() {
                    true => exact += u64::from(header.events),
                    false => approximate += u64::from(header.events),
                }
            }
            let share = |count: u64| 100.0 * count as f64 / events.len() as f64;
            rows.push(Row {
                bytes_per_second: budget,
                coder: coder.name().to_owned(),
                events: events.len() as u64,
                exact,
                approximate,
                missing,
                emd_pixel_us: emd_pixel_us(reader.sensor(), &events, &frames, last_pass_us),
                most_in_a_second: most_in_a_second(&frames),
            });
            if budget == 12_800_000 {
                assert_eq!(exact as usize, events.len());
            }
            // The dense coder's volumes of few bins nearly fit the least of the budgets.
            if coder == Coder::Dense {
                assert!(share(missing) < 20.0);
            }
        }
    }
    let section = rate_control::document(&rows);
    print!("{section}");
    let place = ("docs/results.md", rate_control::MARKS);
    hold_against_record("rate-control", &rows, 0.0, place, |_| Some(section));
}
