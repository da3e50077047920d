use std::sync::LazyLock;

use eecvs_nostd::Sensor;
use event_emulator::Preset;

use super::*;
use crate::downstream::test_events::{jittered, shuffled};

/// A scene and its flow.
static SCENE: LazyLock<(Source, FlowReference)> = LazyLock::new(|| {
    let source = Source::scene(Preset::Motorcycle, 1, 200_000).unwrap();
    let reference = FlowReference::new(&source);
    (source, reference)
});

/// Moves each event to the middle of its window.
fn collapsed(source: &Source) -> Vec<Event> {
    let window_us = u64::from(WINDOW_US);
    let start_us = source.start_us();
    source
        .events
        .iter()
        .map(|event| {
            let window = (event.t_us - start_us) / window_us;
            Event {
                t_us: start_us + window * window_us + window_us / 2,
                ..*event
            }
        })
        .collect()
}

#[test]
fn the_scene_moves_as_its_camera_does() {
    // The camera pans at about 170 px/s: the background moves to the left, faster further down. A box crosses rows
    // 3 and 4 of tiles at 1.7 sensor widths per second.
    let reference = &SCENE.1;
    let background = |rows: std::ops::Range<u16>| {
        let flows = reference.flows().iter();
        let mut speeds: Vec<f32> = flows
            .filter(|flow| rows.contains(&flow.tile.1))
            .map(|flow| flow.velocity.0)
            .collect();
        assert!(speeds.len() > 8, "{speeds:?}");
        speeds.sort_by(f32::total_cmp);
        speeds[speeds.len() / 2]
    };
    let window_s = f64::from(WINDOW_US) * 1e-6;
    let (far, near) = (background(0..3), background(5..9));
    let middle = -170.0 * window_s;
    assert!(
        f64::from(near) < 1.3 * middle && f64::from(far) > middle,
        "{near} {far}"
    );
    assert!(near < far && far < -1.0, "{near} {far}");
    let boxed = 1.7 * 346.0 * window_s;
    let in_box = reference.flows().iter().filter(|flow| {
        (f64::from(flow.velocity.0) - boxed).abs() < 0.5 && (3..5).contains(&flow.tile.1)
    });
    assert!(in_box.count() > 3, "{:?}", reference.flows());
}

#[test]
fn the_same_events_in_any_order_differ_by_0() {
    let (source, reference) = &*SCENE;
    let found = reference.against(&shuffled(&source.events));
    assert_eq!(found.tiles, reference.flows().len());
    assert_eq!(
        (found.lost, found.mean_px, found.median_px),
        (0, Some(0.0), Some(0.0))
    );
}

#[test]
fn the_more_times_move_the_more_flows_differ() {
    let (source, reference) = &*SCENE;
    let [near, far] =
        [200, 3_000].map(|jitter_us| reference.against(&jittered(&source.events, jitter_us)));
    assert!(
        near.mean_px > Some(0.0) && near.mean_px < Some(1.0),
        "{near:?}"
    );
    assert!(
        far.mean_px > near.mean_px && far.lost > near.lost,
        "{near:?} {far:?}"
    );
    let none = reference.against(&collapsed(source));
    assert_eq!((none.lost, none.mean_px), (none.tiles, None));
    assert_eq!(reference.against(&[]), none);
}

#[test]
fn events_off_the_sensor_and_the_windows_are_ignored() {
    let (source, reference) = &*SCENE;
    let strange: Vec<Event> = source
        .events
        .iter()
        .zip([u64::MAX, u64::MAX / 2, 1 << 40].into_iter().cycle())
        .flat_map(|(event, t_us)| {
            let y = u16::MAX - event.y;
            [*event, Event { y, ..*event }, Event { t_us, ..*event }]
        })
        .collect();
    assert_eq!(
        reference.against(&strange),
        reference.against(&source.events)
    );
}

#[test]
fn recordings_without_flow_have_none() {
    let event = |t_us| Event {
        t_us,
        x: 0,
        y: 0,
        polarity: eecvs_nostd::Polarity::On,
    };
    for events in [vec![], vec![event(3)], vec![event(0), event(u64::MAX)]] {
        let source = Source {
            name: String::new(),
            sensor: Sensor::new(1, 1).unwrap(),
            events: events.into(),
        };
        let found = flow(&source, &source.events);
        assert_eq!((found.tiles, found.lost, found.median_px), (0, 0, None));
    }
}

#[test]
fn differences_are_lengths_over_the_tiles_of_both() {
    let flow = |row, x, y| TileFlow {
        tile: (0, row, 0),
        velocity: (x, y),
    };
    let original = [
        flow(0, 1.0, 1.0),
        flow(1, 0.0, 0.0),
        flow(2, 5.0, 5.0),
        flow(3, 2.0, 2.0),
    ];
    let reconstructed = [
        flow(3, 2.0, 1.0),
        flow(9, 0.0, 0.0),
        flow(0, 4.0, 5.0),
        flow(1, 0.0, 0.0),
    ];
    let found = end_point_difference(&original, &reconstructed);
    assert_eq!((found.tiles, found.lost), (4, 1));
    assert_eq!((found.mean_px, found.median_px), (Some(2.0), Some(1.0)));
    let two = end_point_difference(&original[..2], &reconstructed);
    assert_eq!((two.mean_px, two.median_px), (Some(2.5), Some(2.5)));
}
