//! Recordings whose times run back: every event is decoded again, whatever the clock did.

use std::num::{NonZeroU32, NonZeroUsize};

use eecvs::decode::WindowReader;
use eecvs::encode::{EncodeSummary, Limits, encode};
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs_nostd::{
    Coder, Config, Event, Hybrid, Mode, OUTPUT_BYTES_MIN, Polarity, Sensor, Transform,
};
use event_files::{EventReader, Skipped};
use event_metrics::compare;
use proptest::prelude::*;
use strategies::plain_config;

const SENSOR: Sensor = Sensor {
    width: 40,
    height: 12,
};

/// Events in batches.
struct Source {
    events: Vec<Event>,
    at: usize,
    batch: usize,
    skipped: Skipped,
}

impl Source {
    fn new(events: &[Event], batch: usize) -> Self {
        Self {
            events: events.to_vec(),
            at: 0,
            batch,
            skipped: Skipped::default(),
        }
    }
}

impl EventReader for Source {
    fn format(&self) -> &'static str {
        "memory"
    }

    fn sensor(&self) -> Sensor {
        SENSOR
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        let rest = &self.events[self.at..];
        let batch = &rest[..self.batch.min(rest.len())];
        events.extend(batch);
        self.at += batch.len();
        Ok(batch.len())
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

fn frames(
    events: &[Event],
    config: Config,
    limits: Limits,
    threads: usize,
    batch: usize,
) -> (EncodeSummary, Vec<u8>) {
    let mut bytes = Vec::new();
    let threads = NonZeroUsize::new(threads).expect("some");
    let mut source = Source::new(events, batch);
    let summary = encode(
        &mut source,
        config,
        limits,
        threads,
        &mut bytes,
        &mut |_| {},
    );
    (summary.expect("no errors"), bytes)
}

/// The events, and the runs that frames begin.
fn decoded(bytes: &[u8]) -> (Vec<Event>, u64) {
    let mut windows = WindowReader::new(FrameReader::new(bytes));
    let mut finder = EventDecoder::new(Finder::default());
    let (mut events, mut runs) = (Vec::new(), 0);
    while let Some(mut window) = windows.next_window().expect("no errors") {
        finder.fill(&mut window);
        runs += u64::from(window.header.begins_run || runs == 0);
        events.extend(&window.events);
    }
    assert!(windows.report().is_clean(), "{:?}", windows.report());
    (events, runs)
}

fn sorted(events: &[Event]) -> Vec<Event> {
    let mut events = events.to_vec();
    events.sort_unstable();
    events
}

/// What a clock does from one event to the next.
#[derive(Debug, Clone, Copy)]
enum Step {
    On(u64),
    /// This event's stamp alone is off.
    Jitter(i64),
    Repeat,
    Reset(u64),
    Stale(u64),
}

fn recordings() -> impl Strategy<Value = Vec<Event>> {
    let jitter = prop_oneof![
        4 => -200_i64..200,
        2 => -8000_i64..8000,
        1 => -10_000_000_i64..10_000_000,
    ];
    let step = (
        prop_oneof![
            60 => (0_u64..3000).prop_map(Step::On),
            1 => (0_u64..3_000_000).prop_map(Step::On),
            30 => jitter.prop_map(Step::Jitter),
            6 => Just(Step::Repeat),
            1 => prop_oneof![Just(0), any::<u64>(), 0..100_000_u64].prop_map(Step::Reset),
            1 => any::<u64>().prop_map(Step::Stale),
        ],
        0..SENSOR.width,
        0..SENSOR.height,
        any::<bool>(),
    );
    (
        prop_oneof![0..100_000_u64, any::<u64>()],
        prop::collection::vec(step, 0..120),
    )
        .prop_map(|(start_us, steps)| {
            let mut clock_us = start_us;
            let at = |(step, x, y, on)| {
                let mut t_us = clock_us;
                match step {
                    Step::On(us) => {
                        clock_us = clock_us.saturating_add(us);
                        t_us = clock_us;
                    }
                    Step::Jitter(us) => t_us = clock_us.saturating_add_signed(us),
                    Step::Repeat => {}
                    Step::Reset(us) => {
                        clock_us = us;
                        t_us = us;
                    }
                    Step::Stale(us) => t_us = us,
                }
                Event {
                    t_us,
                    x,
                    y,
                    polarity: Polarity::from_bool(on),
                }
            };
            steps.into_iter().map(at).collect()
        })
}

fn hybrid(coder: Coder) -> Mode {
    Mode::Hybrid(Hybrid {
        coder,
        ..Hybrid::default()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn every_event_is_decoded(
        events in recordings(),
        (dense, keep_order) in any::<(bool, bool)>(),
        window_us in prop_oneof![Just(32_768_u32), 1..40_000_u32],
        reorder_us in prop_oneof![Just(None), Just(Some(0)), (1..40_000_u32).prop_map(Some)],
        window_events in prop_oneof![1..20_usize, Just(1000)],
        frame_bytes in prop_oneof![Just(OUTPUT_BYTES_MIN), Just(1 << 16)],
        batches in (1..130_usize, 1..130_usize),
    ) {
        let coder = if dense { Coder::Dense } else { Coder::Fast };
        let mut config = Config {
            mode: hybrid(coder),
            keep_order,
            key_windows: 4,
            ..plain_config(SENSOR, Transform::Dct, 16)
        };
        config.window.window_us = window_us;
        let limits = Limits { window_events, frame_bytes, reorder_us, ..Limits::default() };
        let (summary, bytes) = frames(&events, config, limits, 1, batches.0);
        prop_assert_eq!(summary.events_encoded, events.len() as u64);
        let (found, runs) = decoded(&bytes);
        prop_assert!(sorted(&found) == sorted(&events));
        prop_assert_eq!(summary.runs, runs);
        // Neither threads nor how many events come at a time change a bit.
        let (_, same) = frames(&events, config, limits, 3, batches.1);
        prop_assert!(same == bytes);
        let is_ascending = events.is_sorted_by_key(|event| event.t_us);
        if is_ascending {
            let plain = Limits { reorder_us: Some(0), ..limits };
            prop_assert!(frames(&events, config, plain, 1, 1).1 == bytes);
        }
        if let (Some(reorder_us), 1000) = (reorder_us, window_events) {
            let mut newest_us = 0;
            let falls_back = events.iter().any(|event| {
                newest_us = newest_us.max(event.t_us);
                newest_us - event.t_us > u64::from(reorder_us)
            });
            prop_assert!(falls_back || runs <= 1, "{} runs", runs);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Comparing places every event of every run.
    #[test]
    fn recordings_with_runs_are_compared(events in recordings(), window_us in 1000..40_000_u64) {
        prop_assume!(!events.is_empty());
        // Windows of all time would be too many to tell.
        let events: Vec<_> = events.iter().map(|event| Event { t_us: event.t_us % (1 << 40), ..*event }).collect();
        let config = plain_config(SENSOR, Transform::Dct, 16);
        let config = Config { mode: hybrid(Coder::Fast), ..config };
        let (found, _) = decoded(&frames(&events, config, Limits::default(), 1, 50).1);
        let compared = |b: &[Event]| {
            let open = |events: &[Event]| -> event_files::Result<Box<dyn EventReader>> {
                Ok(Box::new(Source::new(events, 64)))
            };
            compare(&|| open(&events), &|| open(b), window_us, &mut |_| {}).expect("no errors")
        };
        let all = compared(&found);
        prop_assert_eq!((all.exact_fraction, all.mse, all.emd_pixel_us), (1.0, 0.0, 0.0));
        let fewer = compared(&found[1..]);
        let expected = 1.0 - 1.0 / events.len() as f64;
        prop_assert!((fewer.exact_fraction - expected).abs() < 1e-9);
    }

    /// A budget and coefficients change what is told of events, and lose none in silence.
    #[test]
    fn every_event_is_accounted_for(
        events in recordings(), budget in 6000..1_000_000_u32, adaptive: bool,
    ) {
        let config = plain_config(SENSOR, Transform::Dct, 16);
        let budgeted = Config {
            mode: hybrid(Coder::Fast),
            bytes_per_second: NonZeroU32::new(budget),
            ..config
        };
        let mode = if adaptive { Mode::Coefficients(Coder::Dense) } else { Mode::Transform };
        for (config, has_budget) in [(budgeted, true), (Config { mode, ..config }, false)] {
            let (summary, bytes) = frames(&events, config, Limits::default(), 1, 50);
            let kept = summary.events_encoded + summary.events_thinned;
            prop_assert_eq!(kept, events.len() as u64);
            prop_assert!(has_budget || summary.events_thinned == 0);
            let (found, _) = decoded(&bytes);
            if has_budget {
                prop_assert_eq!(found.len() as u64, summary.events_encoded);
            }
        }
    }
}

fn at(t_us: u64, i: usize) -> Event {
    Event {
        t_us,
        x: (i % 40) as u16,
        y: (i / 40 % 12) as u16,
        polarity: Polarity::from_bool(i.is_multiple_of(3)),
    }
}

/// What people's recordings do, and the runs that are made of it.
#[test]
fn clocks_of_real_recordings() {
    let ascending = |from_us: u64, n: usize| (0..n).map(move |i| at(from_us + 100 * i as u64, i));
    let reset: Vec<_> = ascending(5_000_000, 1000)
        .chain(ascending(10, 1000))
        .collect();
    let stale_first: Vec<_> = [at(4_000_000_000, 0)]
        .into_iter()
        .chain(ascending(10, 1000))
        .collect();
    let mut stale_amid: Vec<_> = ascending(10_000_000, 1000).collect();
    stale_amid[500].t_us = 3;
    let mut jitter: Vec<_> = ascending(10_000, 3000).collect();
    for (i, event) in jitter.iter_mut().enumerate() {
        event.t_us -= (i as u64 * 7919) % 4900;
    }
    // To where a window of the grid begins, and what is a little late belongs to the one before.
    let far_us = 94_760 + (1000 << 15);
    let leap = vec![at(94_760, 0), at(far_us, 1), at(far_us - 1, 2)];
    let config = Config {
        mode: hybrid(Coder::Fast),
        ..plain_config(SENSOR, Transform::Dct, 16)
    };
    for (name, events, runs) in [
        ("reset", reset, 2),
        ("stale first", stale_first, 2),
        // Forwards it is no further than any gap.
        ("stale amid", stale_amid, 2),
        ("jitter", jitter, 1),
        ("leap", leap, 1),
    ] {
        let (summary, bytes) = frames(&events, config, Limits::default(), 2, 64);
        assert_eq!((summary.runs, summary.events_late), (runs, 0), "{name}");
        let (found, _) = decoded(&bytes);
        assert!(sorted(&found) == sorted(&events), "{name}");
    }
}
