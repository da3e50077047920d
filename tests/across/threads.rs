//! Any number of threads encodes to the same bytes, and an error ends all of them.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::num::{NonZeroU32, NonZeroUsize};

use anyhow::Result;
use eecvs::encode::{EncodeSummary, Limits, encode};
use eecvs::frame_file::FrameSink;
use eecvs_nostd::{
    Coder, Config, Event, Fidelity, Hybrid, Mode, OUTPUT_BYTES_MIN, Sensor, Thresholds, Transform,
};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::{ErrorKind, EventReader, Skipped};
use proptest::prelude::*;
use strategies::{encode as frames_of, hybrid, job, plain_config};

/// What a [`Source`] does after its last event.
#[derive(Clone, Copy, PartialEq)]
enum End {
    Clean,
    /// An error that names a place.
    Damage,
    /// It starts over, an hour later.
    Never,
    Panic,
}

/// Events in batches of changing sizes.
struct Source {
    sensor: Sensor,
    events: VecDeque<Event>,
    batches: Vec<usize>,
    read: usize,
    end: End,
    skipped: Skipped,
}

impl Source {
    fn new(sensor: Sensor, events: &[Event], batches: &[usize], end: End) -> Self {
        Self {
            sensor,
            events: events.iter().copied().collect(),
            batches: batches.to_vec(),
            read: 0,
            end,
            skipped: Skipped::default(),
        }
    }
}

impl EventReader for Source {
    fn format(&self) -> &'static str {
        "memory"
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        let size = self.batches[self.read % self.batches.len()];
        self.read += 1;
        let batch: Vec<_> = self.events.drain(..size.min(self.events.len())).collect();
        match self.end {
            End::Never => self.events.extend(batch.iter().map(|event| Event {
                t_us: event.t_us + 3_600_000_000,
                ..*event
            })),
            End::Damage if batch.is_empty() => {
                event_types::bail!(Damaged, "memory: byte 7: damaged")
            }
            End::Panic if batch.is_empty() => panic!("a reader's mistake"),
            _ => {}
        }
        events.extend(&batch);
        Ok(batch.len())
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

/// Takes `room` bytes, then there is no space left.
struct Disk {
    room: usize,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match bytes.len().min(self.room) {
            0 if !bytes.is_empty() => Err(io::Error::from(io::ErrorKind::StorageFull)),
            taken => {
                self.room -= taken;
                Ok(taken)
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn run(
    mut source: Source,
    config: Config,
    limits: Limits,
    threads: usize,
    out: &mut dyn FrameSink,
) -> Result<EncodeSummary> {
    let threads = NonZeroUsize::new(threads).expect("not 0");
    let (mut last, events) = (0, source.events.len() as u64);
    let end = source.end;
    let mut progress = |read| {
        assert!(last <= read && (end == End::Never || read <= events));
        last = read;
    };
    let summary = encode(&mut source, config, limits, threads, out, &mut progress)?;
    assert_eq!(summary.threads, threads.get());
    assert_eq!(last, summary.events_in);
    Ok(summary)
}

/// A summary without what is measured.
fn counts(summary: &EncodeSummary) -> EncodeSummary {
    EncodeSummary {
        threads: 0,
        encode_s: 0.0,
        events_per_s: 0.0,
        wall_s: 0.0,
        ..summary.clone()
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    /// Late events, events off the grid, gaps, windows that close early, windows of many frames.
    #[test]
    fn the_bytes_are_those_of_one_encoder(
        (config, events) in job(1500),
        mode in prop_oneof![
            Just(Mode::Transform),
            prop_oneof![Just(Coder::Fast), Just(Coder::Dense)].prop_map(Mode::Coefficients),
            hybrid().prop_map(Mode::Hybrid),
        ],
        key_windows in 1_u16..20,
        window_events in prop_oneof![1..20_usize, 20..2000_usize],
        frame_bytes in prop_oneof![Just(OUTPUT_BYTES_MIN), OUTPUT_BYTES_MIN..20_000],
        batches in proptest::collection::vec(1..400_usize, 1..5),
        damaged in proptest::bool::weighted(0.2), keep_order: bool,
        max_emd_us in proptest::option::of(1_u32..3000),
    ) {
        let is_spread = matches!(mode, Mode::Hybrid(Hybrid { fidelity: Fidelity::SpreadUs(_), .. }));
        let keep_order = keep_order && !mode.is_transform() && !mode.has_keys() && !is_spread;
        let max_emd_us = max_emd_us.and_then(NonZeroU32::new);
        let max_emd_us = max_emd_us.filter(|_| mode.is_lossless() && !mode.keeps_arrival());
        let config = Config { mode, key_windows, keep_order, max_emd_us, ..config };
        let sensor = config.window.sensor;
        let reorder_us = Some(0);
        let limits = Limits { window_events, frame_bytes, reorder_us, ..Limits::default() };
        let end = if damaged { End::Damage } else { End::Clean };
        let mut first = None;
        for threads in [1, 2, 3, 8] {
            let source = Source::new(sensor, &events, &batches, end);
            let mut bytes = Vec::new();
            let summary = run(source, config, limits, threads, &mut bytes);
            let outcome = match summary {
                Ok(summary) => Ok(counts(&summary)),
                Err(error) => Err(format!("{error:#}")),
            };
            prop_assert_eq!(outcome.is_err(), damaged);
            let (same_outcome, same_bytes) =
                first.get_or_insert_with(|| (outcome.clone(), bytes.clone()));
            prop_assert_eq!(&outcome, same_outcome);
            prop_assert!(bytes == *same_bytes, "{} threads", threads);
        }
        let expected = frames_of(config, &events, window_events, frame_bytes).concat();
        let (_, bytes) = first.expect("four runs");
        if damaged {
            // Windows before the damage, but not the one that was open.
            prop_assert!(bytes.len() < expected.len() || events.is_empty());
            prop_assert!(expected.starts_with(&bytes));
        } else {
            prop_assert!(bytes == expected);
        }
    }
}

const SENSOR: Sensor = Sensor {
    width: 346,
    height: 260,
};

/// A seeded scene, with some events put late and off the sensor.
fn scene(duration_us: u64) -> Vec<Event> {
    let mut emulator = emulate(SceneConfig {
        sensor: SENSOR,
        duration_us,
        ..SceneConfig::model_1(Preset::OutdoorWellLitBlur, 3)
    })
    .expect("a scene");
    let mut events = Vec::new();
    while emulator.read(&mut events).expect("a scene") > 0 {}
    for event in events.iter_mut().skip(5000).step_by(997) {
        event.t_us = event.t_us.saturating_sub(40_000);
    }
    for event in events.iter_mut().skip(7000).step_by(3001) {
        event.x = 346;
    }
    events
}

#[test]
fn a_scene_is_the_same_on_any_number_of_threads() {
    let events = scene(300_000);
    let auto = Config {
        transform: None,
        thresholds: Thresholds::new(1_000_000_000_000, 7_000_000_000_000).expect("in order"),
        ..plain_config(SENSOR, Transform::Dct, 16)
    };
    let mut tiny = plain_config(SENSOR, Transform::Dwt, 8);
    tiny.window.window_us = 20;
    let mut long = plain_config(SENSOR, Transform::Dtft, 16);
    long.window.window_us = 100_000;
    // As the core's encoder, which puts nothing in order.
    let plain = Limits {
        reorder_us: Some(0),
        ..Limits::default()
    };
    let limits = |window_events, frame_bytes| Limits {
        window_events,
        frame_bytes,
        ..plain
    };
    for (name, config, limits) in [
        ("plain", auto, plain),
        ("tiny windows", tiny, plain),
        ("full windows", auto, limits(300, 1 << 20)),
        // Several chunks of a window, and numbers that no encoder foresees.
        ("many frames", long, limits(1 << 20, 5000)),
    ] {
        let expected = frames_of(config, &events, limits.window_events, limits.frame_bytes);
        let total: usize = expected.iter().map(Vec::len).sum();
        for threads in [1, 2, 3, 8] {
            let source = Source::new(SENSOR, &events, &[1 << 14], End::Clean);
            let mut bytes = Vec::new();
            let summary = run(source, config, limits, threads, &mut bytes).expect("no errors");
            assert!(bytes == expected.concat(), "{name}, {threads} threads");
            assert_eq!(summary.frames, expected.len() as u64);
            assert_eq!(summary.bytes_out, total as u64);
            assert!(summary.runs > 1 && summary.events_dropped > 20);
            assert!(summary.encode_s > 0.0 && summary.wall_s > 0.0);
        }
    }
}

#[test]
fn a_writer_that_fails_ends_a_reader_without_end() {
    let events = scene(50_000);
    for (window_us, frame_bytes) in [(32_768, 1 << 20), (100, 1 << 20), (32_768, 1000)] {
        let mut config = plain_config(SENSOR, Transform::Dct, 8);
        config.window.window_us = window_us;
        let limits = Limits {
            frame_bytes,
            ..Limits::default()
        };
        for threads in [1, 2, 3, 8] {
            for room in [0, 100, 1_000_000] {
                let source = Source::new(SENSOR, &events, &[1 << 12], End::Never);
                let error = run(source, config, limits, threads, &mut Disk { room })
                    .expect_err("the disk is full");
                let kind = error.downcast_ref().map(event_files::Error::kind);
                let full = ErrorKind::Io(io::ErrorKind::StorageFull);
                assert_eq!(kind, Some(full), "{error:#}");
            }
        }
    }
}

#[test]
fn what_came_before_the_damage_is_written() {
    let events = scene(100_000);
    let config = plain_config(SENSOR, Transform::Dct, 8);
    let whole = frames_of(config, &events, events.len(), 1 << 20);
    for threads in [1, 2, 3, 8] {
        let source = Source::new(SENSOR, &events, &[1000], End::Damage);
        let mut bytes = Vec::new();
        let limits = Limits {
            reorder_us: Some(0),
            ..Limits::default()
        };
        let error =
            run(source, config, limits, threads, &mut bytes).expect_err("the recording is damaged");
        assert_eq!(format!("{error:#}"), "memory: byte 7: damaged");
        assert!(bytes == whole[..whole.len() - 1].concat());
    }
}

#[test]
fn a_panic_of_a_thread_is_passed_on() {
    let events = scene(50_000);
    let config = plain_config(SENSOR, Transform::Dct, 8);
    let outcome = std::panic::catch_unwind(|| {
        let source = Source::new(SENSOR, &events, &[1000], End::Panic);
        run(source, config, Limits::default(), 3, &mut Vec::new()).map(drop)
    });
    assert!(outcome.is_err());
}

#[test]
fn a_configuration_that_cannot_run_is_refused_before_any_thread() {
    let config = plain_config(SENSOR, Transform::Dct, 65);
    for threads in [1, 4] {
        let source = Source::new(SENSOR, &[], &[1], End::Panic);
        let error = run(source, config, Limits::default(), threads, &mut Vec::new())
            .expect_err("M is 64 at most");
        assert!(error.to_string().contains("M is 65"), "{error}");
    }
}
