//! Errors, crops, and rows of a small scene.

use std::sync::Arc;

use eecvs_bench::source::{Memory, WINDOW_US};
use event_emulator::Preset;
use event_metrics::compare;
use event_types::test_events::{SENSOR, event};

use super::*;

fn source(events: &[Event]) -> Source {
    Source {
        name: "test".to_owned(),
        sensor: SENSOR,
        events: Arc::from(events),
    }
}

#[test]
fn the_volumes_error_is_that_of_smoothed_impulses() {
    let one = [event(10_000, 4, 3, true)];
    let original = Original::new(&one);
    assert_eq!(original.errors(&one).volume, 0.0);
    assert_eq!(original.errors(&[]).volume, 1.0);
    // Elsewhere, or of the other polarity: nothing cancels, or everything adds up.
    let volume = |decoded: Event| original.errors(&[decoded]).volume;
    assert_eq!(volume(event(10_000, 4, 4, true)), 2.0);
    assert_eq!(volume(event(10_000, 4, 3, false)), 4.0);
    // 2 - 2 exp(-d^2 / 4 sigma^2) with d = sigma.
    let expected = 2.0 - 2.0 * (-0.25_f64).exp();
    for t_us in [6000, 14_000] {
        assert!((volume(event(t_us, 4, 3, true)) - expected).abs() < 1e-12);
    }
    assert_eq!(volume(event(10_000 + 33_942, 4, 3, true)), 2.0);
    // The sampled integral of two events of either sign against two that are a little off.
    let (a, b) = (
        [event(3000, 1, 1, true), event(9000, 1, 1, false)],
        [event(5000, 1, 1, true), event(8000, 1, 1, false)],
    );
    let smooth = |events: &[Event], t_us: f64| -> f64 {
        let each = events.iter().map(|event| {
            let off = (t_us - event.t_us as f64) / 4000.0;
            f64::from(event.polarity.sign()) * (-off * off / 2.0).exp()
        });
        each.sum()
    };
    let (mut error, mut power) = (0.0, 0.0);
    for at in -400..1000 {
        let t_us = f64::from(at) * 100.0;
        let (of_a, of_b) = (smooth(&a, t_us), smooth(&b, t_us));
        error += (of_b - of_a) * (of_b - of_a);
        power += of_a * of_a;
    }
    assert!((Original::new(&a).errors(&b).volume - error / power).abs() < 1e-6);
}

#[test]
fn the_error_of_times_is_that_of_compare() {
    let scene = Source::scene(Preset::IndoorFlying, 1, 80_000).unwrap();
    let moved = |(at, event): (usize, &Event)| Event {
        t_us: event.t_us + (at as u64 * 7919) % 3000,
        ..*event
    };
    let mut events: Vec<Event> = scene.events.iter().enumerate().map(moved).collect();
    events.pop();
    events.sort_by_key(|event| event.t_us);
    let decoded: Arc<[Event]> = events.into();
    let compared = compare(
        &|| Ok(Box::new(scene.reader())),
        &|| Ok(Box::new(Memory::new(scene.sensor, Arc::clone(&decoded)))),
        WINDOW_US.into(),
        &mut |_| (),
    )
    .unwrap();
    let found = Original::new(&scene.events).errors(&decoded);
    assert!(compared.emd_pixel_us > 100.0);
    assert_eq!(found.emd_pixel_us, compared.emd_pixel_us);
}

#[test]
fn whole_windows_are_kept() {
    let window_us = u64::from(WINDOW_US);
    let times = [7, 8, 6 + window_us, 7 + window_us, 7 + 2 * window_us];
    let events = times.map(|t_us| event(t_us, 1, 1, true));
    let kept = |most| input::crop(source(&events), most).events.len();
    assert_eq!([0, 1, 3, 4, 5, 9].map(kept), [3, 3, 3, 4, 5, 5]);
}

#[test]
fn the_search_ends_at_the_largest_that_is_no_worse() {
    let mut tried = Vec::new();
    let mut measure = |us: u32| {
        tried.push(us);
        Ok(Errors {
            emd_pixel_us: f64::from(us) * 0.6,
            volume: (f64::from(us) / 9000.0).powi(2),
        })
    };
    settings::Search::of_times(100)
        .run(9, &mut measure)
        .unwrap();
    settings::Search::of_volume(0.25)
        .tolerance()
        .run(9, &mut measure)
        .unwrap();
    assert_eq!(tried.first(), Some(&199));
    // 0.6 * 166 <= 100 and (4500 / 9000)^2 <= 0.25, and no larger ones.
    for (within, beyond) in [(166, 167), (4500, 4501)] {
        assert!(
            tried.contains(&within) && tried.contains(&beyond),
            "{tried:?}"
        );
    }
    // An error that falls more slowly than in proportion is not approached from beyond alone.
    tried.clear();
    let slow = |us: u32| 100.0 * (f64::from(us) / 148.5).sqrt();
    let mut measure = |us: u32| {
        tried.push(us);
        Ok(Errors {
            emd_pixel_us: slow(us),
            volume: 0.0,
        })
    };
    settings::Search::of_times(100)
        .run(5, &mut measure)
        .unwrap();
    assert!(tried.iter().any(|us| (140..149).contains(us)), "{tried:?}");
    // Cells longer than a window cannot be made coarser.
    tried.clear();
    let mut measure = |us: u32| {
        tried.push(us);
        Ok(Errors {
            emd_pixel_us: 1.0,
            volume: 0.0,
        })
    };
    settings::Search::of_times(u32::MAX / 4)
        .run(9, &mut measure)
        .unwrap();
    assert_eq!(tried, [16_384]);
}

#[test]
fn a_scene_has_every_row_and_no_family_misses_what_was_asked() {
    let effort = Effort::QUICK;
    let scene = Source::scene(Preset::OutdoorDark, 1, effort.scene_us).unwrap();
    let rows = measure(&[input::crop(scene, effort.events)], effort, &|| ()).unwrap();
    assert_eq!(rows.len(), effort.rows());
    for row in &rows {
        let all = [
            &row.plain,
            &row.fast,
            &row.dense,
            &row.eq3_fast,
            &row.eq3_dense,
            &row.tolerance_keys,
            &row.tolerance_dense,
            &row.tolerance_tree,
            &row.best_keys,
            &row.best_dense,
            &row.best_tree,
        ];
        for found in all.into_iter().flatten() {
            assert!(
                found.error <= row.most && found.bits_per_event > 0.0,
                "{row:?}"
            );
        }
        let bits = |of: &Option<Cheapest>| of.as_ref().map(|of| of.bits_per_event);
        assert_eq!(row.fast.is_some(), row.plain.is_some(), "{row:?}");
        assert!(bits(&row.fast) <= bits(&row.plain), "{row:?}");
        if row.error == TIMES {
            let asked = format!("{} us on average", row.most);
            for best in [&row.best_keys, &row.best_dense, &row.best_tree] {
                assert_eq!(best.as_ref().unwrap().setting, asked);
            }
            for tolerance in [
                &row.tolerance_keys,
                &row.tolerance_dense,
                &row.tolerance_tree,
            ] {
                assert!(tolerance.is_some(), "{row:?}");
            }
        }
    }
}
