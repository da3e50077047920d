//! Event times from contiguous coefficients of the DTFT, M = K = 16: how many come back how exactly,
//! against the peaks of the summed atoms, on emulated scenes and on the shared recordings.
//!
//! What comes back is held against `host-harness/record/exact-times-*.json`, of which a document's table is made.
//! Recordings are skipped, with a notice, where they are absent.

use std::collections::BTreeMap;
use std::path::Path;

use eecvs::decode::WindowReader;
use eecvs::encode::{Limits, all_cores, encode};
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::reconstruct::{DecodedWindow, recover::Confidences};
use eecvs::thresholds_file::ThresholdsFile;
use eecvs::work_limit::WorkLimit;
use eecvs_bench::record_file;
use eecvs_bench::table::exact_times::{self, Row, SCENES, SIZES};
use eecvs_nostd::{Config, Event, Mode, Quantiser, Sensor, Thresholds, Transform, WindowConfig};
use event_emulator::{PRESETS, SceneConfig, emulate};
use event_files::EventReader;
use event_metrics::emd_pixel::Matcher;
use event_metrics::frame::pixel_order;
use strategies::hold_against_record;

const WINDOW_US: u32 = 32_768;
const M: u8 = 16;
/// Windows of a recording that are looked at: its first.
const WINDOWS: u64 = 10;

/// Events of pixels of so many events.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    events: u64,
    within_1_us: u64,
    within_5_us: u64,
    cost_us: u128,
}

impl Tally {
    fn add(&mut self, other: &Self) {
        self.events += other.events;
        self.within_1_us += other.within_1_us;
        self.within_5_us += other.within_5_us;
        self.cost_us += other.cost_us;
    }

    fn emd_us(&self) -> f64 {
        self.cost_us as f64 / self.events.max(1) as f64
    }

    fn share(&self, within: u64) -> f64 {
        within as f64 / self.events.max(1) as f64
    }
}

/// By the number of events in the pixel.
#[derive(Debug, Clone, Default)]
struct Tallies(BTreeMap<usize, Tally>);

impl Tallies {
    fn of(&self, events: impl std::ops::RangeBounds<usize>) -> Tally {
        let mut sum = Tally::default();
        self.0.range(events).for_each(|(_, tally)| sum.add(tally));
        sum
    }

    fn add(&mut self, other: &Self) {
        for (events, tally) in &other.0 {
            self.0.entry(*events).or_default().add(tally);
        }
    }

    fn print(&self, name: &str) {
        for (label, tally) in [
            ("1", self.of(1..=1)),
            ("2", self.of(2..=2)),
            ("3 and 4", self.of(3..=4)),
            ("5 to 8", self.of(5..=8)),
            ("9 to 24", self.of(9..=24)),
            ("over 24", self.of(25..)),
            ("all", self.of(..)),
        ] {
            println!(
                "{name}, {label} events: {} events, {:.2} % within 1 us, {:.2} % within 5 us, emd {:.3} us",
                tally.events,
                100.0 * tally.share(tally.within_1_us),
                100.0 * tally.share(tally.within_5_us),
                tally.emd_us()
            );
        }
    }
}

/// What decoding gave, by either finder.
#[derive(Debug, Clone, Default)]
struct Outcome {
    exact: Tallies,
    peaks: Tallies,
    confidences: Confidences,
}

impl Outcome {
    /// Of every size of pixels.
    fn rows(&self, source: &str, step_log2: i8) -> Vec<Row> {
        let row = |(least, most, size): (usize, usize, &str)| {
            let (exact, peaks) = (self.exact.of(least..=most), self.peaks.of(least..=most));
            Row {
                source: source.to_owned(),
                step_log2,
                size: size.to_owned(),
                events: exact.events,
                within_1_us: exact.within_1_us,
                within_5_us: exact.within_5_us,
                emd_us: exact.emd_us(),
                emd_peaks_us: peaks.emd_us(),
            }
        };
        SIZES.map(row).to_vec()
    }
}

/// Pixels whose solution the last bit of a float decides are few.
const TOLERANCE: f64 = 0.02;

/// Of the scenes and of the recordings: each test has one.
const RECORDS: [&str; 2] = ["exact-times-scenes", "exact-times-recordings"];

fn hold(name: &str, rows: &[Row]) {
    let place = ("docs/paper.md", exact_times::MARKS);
    hold_against_record(name, rows, TOLERANCE, place, |folder| {
        let records = RECORDS.map(|name| record_file::read::<Row>(folder, name));
        let rows: Vec<Row> = records
            .into_iter()
            .flatten()
            .flat_map(|record| record.rows)
            .collect();
        exact_times::document(&rows)
    });
}

fn windows(reader: &mut dyn EventReader, step_log2: i8) -> Vec<DecodedWindow> {
    let config = Config {
        transform: Some(Transform::Dtft),
        m: M,
        grid: Some(u16::from(M)),
        quantiser: Quantiser::new(step_log2).expect("in range"),
        ..Config::new(
            WindowConfig::new(reader.sensor(), WINDOW_US),
            Thresholds::new(0, 0).expect("equal thresholds"),
            Mode::Transform,
        )
    };
    let mut bytes = Vec::new();
    let limits = Limits::default();
    encode(reader, config, limits, all_cores(), &mut bytes, &mut |_| ()).expect("encoding works");
    let mut reader = WindowReader::new(FrameReader::new(&bytes[..]));
    let mut windows = Vec::new();
    while let Some(window) = reader.next_window().expect("memory does not fail") {
        windows.push(window);
    }
    windows
}

/// Tallies of a window: `truth` and `found` in [`pixel_order`].
fn tally(truth: &[Event], found: &[Event], tallies: &mut Tallies) {
    let place = |event: &Event| (event.y, event.x);
    let pixels = |events: &[Event]| -> Vec<Vec<Event>> {
        let same = |a: &Event, b: &Event| place(a) == place(b);
        events.chunk_by(same).map(<[Event]>::to_vec).collect()
    };
    for (truth, found) in pixels(truth).iter().zip(pixels(found)) {
        assert_eq!(truth.len(), found.len());
        let tally = tallies.0.entry(truth.len()).or_default();
        tally.events += truth.len() as u64;
        let mut matcher = Matcher::new(u64::from(WINDOW_US));
        matcher.add_window(truth, &found);
        tally.cost_us += matcher.cost();
        for (truth, found) in truth.iter().zip(&found) {
            assert_eq!(
                (place(truth), truth.polarity),
                (place(found), found.polarity)
            );
            let error = truth.t_us.abs_diff(found.t_us);
            tally.within_1_us += u64::from(error <= 1);
            tally.within_5_us += u64::from(error <= 5);
        }
    }
}

fn measure(open: &dyn Fn() -> Box<dyn EventReader>, step_log2: i8, name: &str) -> Outcome {
    let mut events = Vec::new();
    let mut reader = open();
    while reader.read(&mut events).expect("a recording") > 0 {}
    let mut outcome = Outcome::default();
    for window in windows(&mut *open(), step_log2) {
        let header = &window.header;
        let span = header.t0_us..header.t0_us + u64::from(header.duration_us);
        let mut truth: Vec<Event> = events
            .iter()
            .filter(|e| span.contains(&e.t_us))
            .copied()
            .collect();
        truth.sort_unstable_by_key(pixel_order);
        // A window that was closed early, or lost late events, is another multiset.
        if truth.len() != header.window_events as usize {
            continue;
        }
        for (finder, tallies) in [
            (Finder::Exact, &mut outcome.exact),
            (Finder::Peaks, &mut outcome.peaks),
        ] {
            let mut solved = window.clone();
            let confidences = EventDecoder::new(finder).fill(&mut solved);
            let mut found = solved.events;
            found.sort_unstable_by_key(pixel_order);
            tally(&truth, &found, tallies);
            assert_eq!(confidences.pixels_over_work_limit, 0, "{name}");
            if finder == Finder::Exact {
                outcome.confidences.add(confidences);
            }
        }
    }
    println!("{name}, step 2^{step_log2}: {:?}", outcome.confidences);
    outcome
        .peaks
        .print(&format!("{name}, step 2^{step_log2}, peaks"));
    outcome
        .exact
        .print(&format!("{name}, step 2^{step_log2}, exact"));
    outcome
}

/// At the default step, 2^-6, a single event travels as a cell of 2 us, and comes back within 1 us.
///
/// The cost over all pixels is a fifth of the peaks' at the most.
fn check(outcome: &Outcome, name: &str) {
    let exact = &outcome.exact;
    let (single, pair, few) = (exact.of(1..=1), exact.of(2..=2), exact.of(3..=4));
    assert_eq!(single.within_1_us, single.events, "{name}");
    assert!(pair.share(pair.within_1_us) >= 0.98, "{name}: {pair:?}");
    assert!(few.share(few.within_5_us) >= 0.80, "{name}: {few:?}");
    let (all, baseline) = (exact.of(..).emd_us(), outcome.peaks.of(..).emd_us());
    assert!(5.0 * all <= baseline, "{name}: {all} us of {baseline} us");
}

#[test]
fn scenes_come_back_with_the_documented_exactness() {
    let mut rows = Vec::new();
    for step_log2 in [-6, -7] {
        let mut sum = Outcome::default();
        for preset in PRESETS {
            let config = SceneConfig {
                sensor: Sensor {
                    width: 86,
                    height: 65,
                },
                duration_us: 3 * u64::from(WINDOW_US),
                ..SceneConfig::model_1(preset, 1)
            };
            let open = || -> Box<dyn EventReader> { Box::new(emulate(config).expect("a scene")) };
            let outcome = measure(&open, step_log2, preset.name());
            sum.exact.add(&outcome.exact);
            sum.peaks.add(&outcome.peaks);
        }
        sum.peaks
            .print(&format!("all scenes, step 2^{step_log2}, peaks"));
        sum.exact
            .print(&format!("all scenes, step 2^{step_log2}, exact"));
        check(&sum, "all scenes");
        rows.extend(sum.rows(SCENES, step_log2));
    }
    hold(RECORDS[0], &rows);
}

/// The first windows of a recording, in memory.
struct Start {
    reader: Box<dyn EventReader>,
    end_us: Option<u64>,
}

impl EventReader for Start {
    fn format(&self) -> &'static str {
        self.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.reader.sensor()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        let before = events.len();
        self.reader.read(events)?;
        let Some(first) = events.get(before) else {
            return Ok(0);
        };
        let end_us = *self
            .end_us
            .get_or_insert(first.t_us + WINDOWS * u64::from(WINDOW_US));
        let mut index = 0;
        events.retain(|event| {
            index += 1;
            index <= before || event.t_us < end_us
        });
        Ok(events.len() - before)
    }

    fn skipped(&self) -> &event_files::Skipped {
        self.reader.skipped()
    }
}

/// The first window of the densest recording, at the encoder's defaults: as docs/paper.md says, no pixel of it is
/// beyond the default limit of work, of which it costs two fifths.
#[test]
fn the_densest_recording_stays_below_the_work_limit() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let path = data.join("gen3_vga_dense_evt2/evt2.raw");
    if !path.exists() {
        eprintln!("skipped: {} is absent", path.display());
        return;
    }
    let mut reader = event_files::open(&path, None).expect("a recording");
    let config = Config::new(
        WindowConfig::new(reader.sensor(), WINDOW_US),
        ThresholdsFile::scenes()
            .and_then(|file| file.thresholds())
            .expect("the built-in thresholds"),
        Mode::Transform,
    );
    let mut bytes = Vec::new();
    let limits = Limits::default();
    encode(
        &mut *reader,
        config,
        limits,
        all_cores(),
        &mut bytes,
        &mut |_| (),
    )
    .expect("encoding works");
    let mut windows = WindowReader::new(FrameReader::new(&bytes[..]));
    let mut window = windows.next_window().expect("memory").expect("a window");
    let mut decoder = EventDecoder::new(Finder::Exact);
    let confidences = decoder.fill(&mut window);
    println!("{} units, {confidences:?}", decoder.units());
    assert_eq!(confidences.pixels_over_work_limit, 0);
    let limit = WorkLimit::default().get();
    assert!((limit / 20 * 7..limit / 20 * 9).contains(&decoder.units()));
}

#[test]
fn recordings_come_back_with_the_documented_exactness() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let (mut rows, mut is_whole) = (Vec::new(), true);
    for name in [
        "davis346_building_dense/davis.aedat4",
        "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
        "davis346_static_sparse/davis346.aedat4",
    ] {
        let path = data.join(name);
        if !path.exists() {
            eprintln!("skipped: {} is absent", path.display());
            is_whole = false;
            continue;
        }
        let open = || -> Box<dyn EventReader> {
            let reader = event_files::open(&path, None).expect("a recording");
            Box::new(Start {
                reader,
                end_us: None,
            })
        };
        let outcome = measure(&open, -6, name);
        check(&outcome, name);
        let recording = name.split('/').next().unwrap_or(name);
        rows.extend(outcome.rows(recording, -6));
    }
    if is_whole {
        hold(RECORDS[1], &rows);
    }
}
