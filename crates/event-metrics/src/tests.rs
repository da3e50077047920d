//! Tests of whole comparisons: against scipy and scikit-image, edge cases and progress.

use event_types::Event;
use event_types::stream::{Assumption, MemoryReader, Skipped};
use event_types::test_events::{SENSOR, event, reader};
use proptest::prelude::*;

use super::*;

const EMPTY: &[Event] = &[];

fn compare_on(a: &[Event], b: &[Event], sensor: Sensor, batch: usize) -> Result<Comparison> {
    let open = |events: &[Event]| -> Result<Box<dyn EventReader>> {
        Ok(Box::new(
            MemoryReader::new(sensor, events.to_vec()).in_batches(batch),
        ))
    };
    compare(&|| open(a), &|| open(b), 1000, &mut |_| {})
}

fn compare_events(a: &[Event], b: &[Event]) -> Comparison {
    compare_on(a, b, SENSOR, 100).unwrap()
}

/// The generator of `tests/reference_metrics.py`.
struct Generator(u64);

impl Generator {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }
}

/// The recordings of `tests/reference_metrics.py`, translated line by line.
fn recordings(seed: u64) -> (Vec<Event>, Vec<Event>) {
    let mut r = Generator(seed);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for i in 0..600 {
        let mut t = 5000 + r.below(4000);
        t += if t >= 7000 { 1000 } else { 0 };
        let (side_x, side_y) = if i % 2 == 1 { (6, 6) } else { (40, 30) };
        let (x, y) = (r.below(side_x) as u16, r.below(side_y) as u16);
        let first = event(t, x, y, r.below(2) == 1);
        a.push(first);
        match r.below(6) {
            0 => {}
            1 => b.push(Event {
                t_us: t + r.below(300),
                ..first
            }),
            2 => {
                b.push(first);
                b.push(event(5000 + r.below(5000), x, y, r.below(2) == 1));
            }
            _ => b.push(first),
        }
    }
    b.push(event(3000, 1, 2, true));
    b.push(event(12_500, 3, 4, false));
    b.push(event(12_600, 3, 4, false));
    a.sort_by_key(|e| e.t_us);
    b.sort_by_key(|e| e.t_us);
    (a, b)
}

#[test]
fn equals_scipy_and_scikit_image() {
    // Printed by tests/reference_metrics.py (numpy 2.4.6, scipy 1.17.1, scikit-image 0.26.0):
    // seed, events of A and of B; exact_fraction, mse, ssim, emd_time_ms, emd_pixel_us.
    let cases = [
        (
            1,
            600,
            592,
            [
                0.6433333333333333,
                0.0011250000000000001,
                0.9197801619997077,
                0.4554678207270546,
                345.38166666666666,
            ],
        ),
        (
            2,
            600,
            614,
            [
                0.6566666666666666,
                0.001066666666666667,
                0.9080628787120371,
                0.45160455558403056,
                367.165,
            ],
        ),
        (
            3,
            600,
            599,
            [
                0.66,
                0.0009291666666666668,
                0.9245547722236975,
                0.5150107313923066,
                334.2733333333333,
            ],
        ),
    ];
    let sensor = Sensor::new(40, 30).unwrap();
    for (seed, events_a, events_b, expected) in cases {
        let (a, b) = recordings(seed);
        let c = compare_on(&a, &b, sensor, 100).unwrap();
        assert_eq!((c.events_a, c.events_b), (events_a, events_b));
        let found = [
            c.exact_fraction,
            c.mse,
            c.ssim,
            c.emd_time_ms,
            c.emd_pixel_us,
        ];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-10, "{found} {expected}");
        }
    }
}

#[test]
fn identical_recordings_have_no_distortion() {
    let (a, _) = recordings(4);
    let c = compare_events(&a, &a);
    let numbers = [
        c.exact_fraction,
        c.mse,
        c.ssim,
        c.emd_time_ms,
        c.emd_pixel_us,
    ];
    assert_eq!(numbers, [1.0, 0.0, 1.0, 0.0, 0.0]);
}

#[test]
fn hand_computed() {
    // Window 0: one pixel with 2 against 1; window 1: empty; window 2: one OFF event moved by 30 us.
    let a = [
        event(10, 1, 1, true),
        event(20, 1, 1, true),
        event(2100, 5, 5, false),
    ];
    let b = [event(16, 1, 1, true), event(2130, 5, 5, false)];
    let c = compare_events(&a, &b);
    let pixels = f64::from(SENSOR.pixels());
    assert_eq!(c.exact_fraction, 0.0);
    assert!((c.mse - 1.0 / 4.0 / pixels / 3.0).abs() < 1e-15);
    // W1: half of the mass moves by 6, half by 4; then 30. Two windows hold events.
    assert!((c.emd_time_ms - (5.0 + 30.0) / 2.0 / 1000.0).abs() < 1e-15);
    // 20 pairs with 16, and 10 is left over.
    assert!((c.emd_pixel_us - (4.0 + 1000.0 + 30.0) / 3.0).abs() < 1e-12);
    assert!(c.ssim < 1.0 && c.ssim > 0.99);
}

#[test]
fn an_empty_b_costs_a_window_per_event() {
    let a = [event(10, 1, 1, true), event(20, 9, 9, true)];
    let c = compare_events(&a, EMPTY);
    assert_eq!((c.events_a, c.events_b, c.exact_fraction), (2, 0, 0.0));
    assert_eq!((c.emd_time_ms, c.emd_pixel_us), (1.0, 1000.0));
    assert!(c.mse > 0.0 && c.ssim < 1.0);
}

#[test]
fn an_empty_a_is_an_error_unless_b_is_empty_too() {
    let b = [event(10, 1, 1, true)];
    let error = compare_on(EMPTY, &b, SENSOR, 10).unwrap_err().to_string();
    assert!(error.contains("swap A and B"), "{error}");
    let c = compare_events(EMPTY, EMPTY);
    let numbers = [
        c.exact_fraction,
        c.mse,
        c.ssim,
        c.emd_time_ms,
        c.emd_pixel_us,
    ];
    assert_eq!(numbers, [1.0, 0.0, 1.0, 0.0, 0.0]);
}

#[test]
fn a_far_off_time_base_is_neither_slow_nor_hidden() {
    let (a, _) = recordings(5);
    let move_by = |us: u64| -> Vec<Event> {
        let later = |e: &Event| Event {
            t_us: e.t_us + us,
            ..*e
        };
        a.iter().map(later).collect()
    };
    let far = compare_events(&a, &move_by(1_600_000_000_000_000));
    let farthest = compare_events(&a, &move_by(u64::MAX - 20_000));
    let near = compare_events(&a, &move_by(5000));
    for c in [far, farthest, near] {
        assert_eq!((c.exact_fraction, c.emd_time_ms), (0.0, 1.0));
    }
    assert_eq!((far.emd_pixel_us, farthest.emd_pixel_us), (2000.0, 2000.0));
    // A's last events pair with B's first events.
    assert!((1900.0..=2000.0).contains(&near.emd_pixel_us));
    // The empty time in between must not dilute the metrics.
    assert!(far.mse > 0.5 * near.mse && far.ssim < 0.5 + near.ssim / 2.0);
}

#[test]
fn frames_that_cancel_out_are_finite() {
    let a = [event(10, 1, 1, true), event(11, 1, 1, false)];
    let c = compare_events(&a, &a[..1]);
    assert!(c.mse.is_finite() && c.ssim.is_finite());
    let c = compare_events(&a, &a);
    assert_eq!((c.mse, c.ssim), (0.0, 1.0));
}

#[test]
fn times_that_run_back_far_are_in_their_windows() {
    let a = [
        event(10, 1, 1, true),
        event(200_000, 1, 1, true),
        event(11, 1, 1, true),
    ];
    let c = compare_events(&a, &a);
    assert_eq!(c.events_a, 3);
    assert_eq!((c.exact_fraction, c.emd_pixel_us), (1.0, 0.0));
    let c = compare_events(&a, &a[..2]);
    assert!((c.exact_fraction - 2.0 / 3.0).abs() < 1e-15);
}

/// A recording whose reader inferred its size from the largest x and y.
struct SizeTaken(MemoryReader, [Assumption; 1]);

impl EventReader for SizeTaken {
    fn format(&self) -> &'static str {
        self.0.format()
    }

    fn sensor(&self) -> Sensor {
        self.0.sensor()
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.1
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        self.0.read(events)
    }

    fn skipped(&self) -> &Skipped {
        self.0.skipped()
    }
}

#[test]
fn sensors_that_differ_are_refused_but_where_a_size_was_taken() {
    let a = [event(10, 1, 1, true)];
    let wide = Sensor::new(80, 20).unwrap();
    let open_a = || -> Result<Box<dyn EventReader>> { Ok(Box::new(reader(&a, 9))) };
    let stated =
        || -> Result<Box<dyn EventReader>> { Ok(Box::new(MemoryReader::new(wide, Vec::new()))) };
    let refused = compare(&open_a, &stated, 1000, &mut |_| {})
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("64x48") && refused.contains("80x20"),
        "{refused}"
    );
    let taken = || -> Result<Box<dyn EventReader>> {
        let assumption = Assumption {
            what: SIZE_TAKEN,
            taken: "80x20".to_owned(),
            why: String::new(),
        };
        Ok(Box::new(SizeTaken(
            MemoryReader::new(wide, Vec::new()),
            [assumption],
        )))
    };
    let c = compare(&open_a, &taken, 1000, &mut |_| {}).unwrap();
    assert!((c.mse - 1.0 / (80.0 * 48.0)).abs() < 1e-15);
}

#[test]
fn what_b_has_too_much_lowers_its_share() {
    let (a, _) = recordings(8);
    let mut twice = [a.clone(), a.clone()].concat();
    twice.sort_by_key(|event| event.t_us);
    let c = compare_events(&a, &twice);
    let count = a.len() as u64;
    assert_eq!((c.exact_fraction, c.exact_fraction_b), (1.0, 0.5));
    assert_eq!((c.missing_events, c.surplus_events), (0, count));
    assert_eq!(c.surplus_fraction, 0.5);
    let same = compare_events(&a, &a);
    assert_eq!((same.exact_fraction_b, same.surplus_fraction), (1.0, 0.0));
    assert_eq!((same.missing_events, same.surplus_events), (0, 0));
    let none = compare_events(&a, EMPTY);
    assert_eq!((none.exact_fraction_b, none.surplus_fraction), (1.0, 0.0));
    assert_eq!((none.missing_events, none.surplus_events), (count, 0));
    let half = compare_events(&twice, &a);
    assert_eq!((half.missing_events, half.surplus_events), (count, 0));
}

#[test]
fn a_constant_shift_costs_what_it_is() {
    let (a, _) = recordings(9);
    let moved: Vec<Event> = a
        .iter()
        .map(|event| Event {
            t_us: event.t_us + 7,
            ..*event
        })
        .collect();
    let c = compare_events(&a, &moved);
    // An event may pair with a nearer event of its pixel, so the cost can fall slightly below the shift.
    assert!(
        c.emd_pixel_us <= 7.0 && c.emd_pixel_us > 6.9,
        "{}",
        c.emd_pixel_us
    );
}

#[test]
fn a_window_of_no_length_is_refused_and_the_longest_is_not() {
    let (a, b) = recordings(6);
    let open_a = || -> Result<Box<dyn EventReader>> { Ok(Box::new(reader(&a, 99))) };
    let open_b = || -> Result<Box<dyn EventReader>> { Ok(Box::new(reader(&b, 99))) };
    assert!(compare(&open_a, &open_b, 0, &mut |_| {}).is_err());
    let c = compare(&open_a, &open_b, u64::MAX, &mut |_| {}).unwrap();
    assert!(c.emd_pixel_us.is_finite() && c.emd_time_ms.is_finite());
}

#[test]
fn progress_reaches_both_passes() {
    let (a, b) = recordings(7);
    let open_a = || -> Result<Box<dyn EventReader>> { Ok(Box::new(reader(&a, 99))) };
    let open_b = || -> Result<Box<dyn EventReader>> { Ok(Box::new(reader(&b, 99))) };
    let mut seen = Vec::new();
    compare(&open_a, &open_b, 1000, &mut |n| seen.push(n)).unwrap();
    assert!(seen.is_sorted());
    assert_eq!(seen.last(), Some(&(2 * (a.len() + b.len()) as u64)));
}

/// Run with `cargo test --release -p event-metrics measure -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement: prints run times"]
fn measure_a_recording_of_1_2_million_events() {
    let sensor = Sensor::new(1280, 720).unwrap();
    let mut r = Generator(1);
    let mut draw = |i: u64| {
        let (x, y) = (r.below(1280) as u16, r.below(720) as u16);
        event(i * 9, x, y, r.below(2) == 1)
    };
    let a: Vec<_> = (0..1_200_000).map(&mut draw).collect();
    let other: Vec<_> = (0..1_200_000).map(&mut draw).collect();
    let moved: Vec<_> = a
        .iter()
        .map(|e| Event {
            t_us: e.t_us + 100,
            ..*e
        })
        .collect();
    let cases = [("A", &a), ("A 100 us later", &moved), ("another", &other)];
    for (name, b) in cases {
        let open = |events: &[Event]| -> Result<Box<dyn EventReader>> {
            Ok(Box::new(MemoryReader::new(sensor, events.to_vec())))
        };
        let mut seconds: Vec<_> = (0..3)
            .map(|_| {
                let start = std::time::Instant::now();
                let c = compare(&|| open(&a), &|| open(b), 32_768, &mut |_| {}).unwrap();
                assert_eq!(c.events_a, 1_200_000);
                start.elapsed().as_secs_f64()
            })
            .collect();
        seconds.sort_by(f64::total_cmp);
        println!("A against {name}: {seconds:.2?} s");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn batches_and_order_within_the_slack_change_nothing(
        seed in 0_u64..1000,
        batch in 1_usize..700,
        swaps in proptest::collection::vec((0_usize..600, 0_usize..600), 0..50),
    ) {
        let (mut a, b) = recordings(seed);
        let expected = compare_events(&a, &b);
        for (i, j) in swaps {
            a.swap(i, j);
        }
        prop_assert_eq!(compare_on(&a, &b, SENSOR, batch).unwrap(), expected);
    }

    #[test]
    fn every_number_is_finite_and_in_range(
        a in proptest::collection::vec((any::<u64>(), 0_u16..64, 0_u16..48, any::<bool>()), 1..20),
        b in proptest::collection::vec((any::<u64>(), 0_u16..64, 0_u16..48, any::<bool>()), 0..20),
    ) {
        let events = |list: Vec<(u64, u16, u16, bool)>| -> Vec<Event> {
            list.into_iter().map(|(t, x, y, on)| event(t, x, y, on)).collect()
        };
        let c = compare_events(&events(a), &events(b));
        prop_assert!((0.0..=1.0).contains(&c.exact_fraction));
        prop_assert!((0.0..=4.0).contains(&c.mse));
        prop_assert!((-1.0..=1.0).contains(&c.ssim));
        prop_assert!((0.0..=1.0).contains(&c.emd_time_ms));
        prop_assert!(c.emd_pixel_us.is_finite() && c.emd_pixel_us >= 0.0);
    }
}
