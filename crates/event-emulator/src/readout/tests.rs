use event_types::Polarity;

use super::parameters::{CAMERAS, Camera, READOUT_PARAMETERS};
use super::*;

const SENSOR: Sensor = Sensor {
    width: 64,
    height: 48,
};

fn event(t_us: u64, x: u16, y: u16) -> Event {
    Event {
        t_us,
        x,
        y,
        polarity: Polarity::On,
    }
}

/// What the host gets of events, and what is lost.
fn through(events: &[Event], parameters: &ReadoutParameters) -> (Vec<Event>, Losses) {
    let mut readout = Readout::new(SENSOR, parameters).unwrap();
    let (mut out, mut causes) = (Vec::new(), Vec::new());
    for part in events.chunks(7) {
        let hot = vec![Cause::Hot; part.len()];
        readout.push(part, Some(&hot), &mut out, Some(&mut causes));
    }
    readout.finish(&mut out, Some(&mut causes));
    assert_eq!(causes, vec![Cause::Hot; out.len()]);
    assert!(out.is_sorted_by_key(|event| event.t_us));
    let losses = readout.losses();
    let lost = losses.unread + losses.link;
    assert_eq!(out.len() as u64 + lost, events.len() as u64);
    (out, losses)
}

/// All pixels at once.
fn flash(t_us: u64) -> Vec<Event> {
    let rows = (0..SENSOR.height).flat_map(|y| (0..SENSOR.width).map(move |x| event(t_us, x, y)));
    rows.collect()
}

#[test]
fn a_readout_that_takes_no_time_changes_nothing() {
    let events: Vec<Event> = (0..500)
        .map(|i| event(3 * i, (i % 64) as u16, (i * 7 % 48) as u16))
        .collect();
    let (out, losses) = through(&events, &ReadoutParameters::default());
    assert_eq!((out, losses), (events, Losses::default()));
}

#[test]
fn an_arbiter_reads_row_by_row_at_its_speed_and_its_events_share_times() {
    let parameters = ReadoutParameters {
        row_ns: 100.0,
        event_ns: 50.0,
        row_time: 1.0,
        ..ReadoutParameters::default()
    };
    let (out, losses) = through(&flash(1_000), &parameters);
    assert_eq!(losses, Losses::default());
    for (row, events) in out.chunks(64).enumerate() {
        // A row of 64 events takes 3.3 us.
        let t_us = (1_000_000 + 3_300 * row as u64 + 100) / 1_000;
        assert!(
            events
                .iter()
                .all(|event| (event.t_us, usize::from(event.y)) == (t_us, row)),
            "{events:?}"
        );
    }
    let own = ReadoutParameters {
        row_time: 0.0,
        ..parameters
    };
    let (out, _) = through(&flash(1_000), &own);
    // 48 rows of 3.3 us: 19.4 events per us.
    assert_eq!(out.last().unwrap().t_us, 1_158);
    // Blocks of 32 columns: two readings of a row in place of 64.
    let blocks = ReadoutParameters {
        group_columns: 32.0,
        ..own
    };
    let (out, _) = through(&flash(1_000), &blocks);
    assert_eq!(out.last().unwrap().t_us, 1_009);
}

#[test]
fn rows_are_read_in_the_order_in_which_they_ask() {
    let parameters = ReadoutParameters {
        row_ns: 1_000.0,
        event_ns: 1_000.0,
        ..ReadoutParameters::default()
    };
    // The first row is read from 10 us to 12 us; meanwhile row 5 asks, then row 2, then row 5 again.
    let events = [
        event(10, 1, 9),
        event(11, 3, 5),
        event(11, 8, 2),
        event(12, 1, 5),
        event(12, 1, 9),
    ];
    let (out, _) = through(&events, &parameters);
    let places: Vec<_> = out
        .iter()
        .map(|event| (event.t_us, event.x, event.y))
        .collect();
    assert_eq!(
        places,
        [(12, 1, 9), (14, 1, 5), (15, 3, 5), (17, 8, 2), (19, 1, 9)]
    );
}

#[test]
fn a_pixel_that_was_not_read_and_a_full_buffer_lose_events() {
    let slow = ReadoutParameters {
        event_ns: 5_000.0,
        ..ReadoutParameters::default()
    };
    let events: Vec<Event> = (0..10).map(|i| event(100 + i, 0, 0)).collect();
    let (out, losses) = through(&events, &slow);
    // Read at 105, when it may fire again, and at 110 us.
    assert_eq!((out.len(), losses.unread, losses.link), (2, 8, 0));
    let narrow = ReadoutParameters {
        link_per_us: 2.0,
        buffer_events: 100.0,
        ..ReadoutParameters::default()
    };
    let mut events = flash(1_000);
    events.extend(flash(1_030));
    let (out, losses) = through(&events, &narrow);
    // 100 at once, and 60 more in the 30 us until the second flash.
    assert_eq!((out.len() as u64, losses.unread), (160, 0));
    assert_eq!(losses.link, 2 * 64 * 48 - 160);
}

#[test]
fn a_scan_reads_columns_from_the_last_to_the_first() {
    let parameters = ReadoutParameters {
        scan_us: 640.0,
        ..ReadoutParameters::default()
    };
    // Column 63 is read at 0, 640, ..., column 62 at 10, 650, ...
    let events = [
        event(5, 62, 1),
        event(641, 63, 2),
        event(645, 62, 9),
        event(650, 62, 3),
        event(651, 62, 3),
    ];
    let (out, losses) = through(&events, &parameters);
    let places: Vec<_> = out
        .iter()
        .map(|event| (event.t_us, event.x, event.y))
        .collect();
    assert_eq!(
        places,
        [
            (10, 62, 1),
            (650, 62, 3),
            (650, 62, 9),
            (1_280, 63, 2),
            (1_290, 62, 3)
        ]
    );
    assert_eq!(losses, Losses::default());
    let twice = [event(5, 60, 1), event(6, 60, 1)];
    assert_eq!(through(&twice, &parameters).1.unread, 1);
}

#[test]
fn times_are_in_steps() {
    let parameters = ReadoutParameters {
        tick_us: 25.0,
        ..ReadoutParameters::default()
    };
    let (out, _) = through(
        &[event(24, 0, 0), event(25, 1, 0), event(99, 2, 0)],
        &parameters,
    );
    let times: Vec<u64> = out.iter().map(|event| event.t_us).collect();
    assert_eq!(times, [0, 25, 75]);
    // Microseconds since 1970.
    let late = 1_600_000_000_000_003;
    let slow = ReadoutParameters {
        event_ns: 2_000.0,
        ..ReadoutParameters::default()
    };
    let (out, _) = through(&[event(late, 0, 0), event(late, 1, 0)], &slow);
    assert_eq!((out[0].t_us, out[1].t_us), (late + 2, late + 4));
}

/// The rate at which a camera's readout gives a flash of all pixels, in events per us.
fn flash_rate(camera: &Camera) -> f64 {
    let mut readout = Readout::new(camera.sensor, &camera.readout).unwrap();
    let mut out = Vec::new();
    for y in 0..camera.sensor.height {
        let row: Vec<Event> = (0..camera.sensor.width)
            .map(|x| event(1_000, x, y))
            .collect();
        readout.push(&row, None, &mut out, None);
    }
    readout.finish(&mut out, None);
    let lost = readout.losses().unread + readout.losses().link;
    assert_eq!(out.len() as u64 + lost, u64::from(camera.sensor.pixels()));
    (out.len() as u64 + lost) as f64 / (out.last().unwrap().t_us - 1_000) as f64
}

#[test]
fn cameras_read_as_fast_as_stated() {
    for (name, per_us) in [
        ("dvs128", 2.0),
        ("davis240", 12.0),
        ("davis346", 12.0),
        ("gen3", 66.0),
    ] {
        let camera = Camera::from_name(name).unwrap();
        let rate = flash_rate(camera);
        assert!((rate / per_us - 1.0).abs() < 0.05, "{name}: {rate}");
    }
    // With a row's own time: 40 blocks of 32 columns and a 41st time.
    let rate = flash_rate(Camera::from_name("gen41").unwrap());
    assert!((rate / 1_066.0 - 1.0).abs() < 0.05, "{rate}");
}

#[test]
fn parameters_have_ranges() {
    for camera in CAMERAS {
        camera.readout.check().unwrap();
        assert_eq!(Camera::from_name(camera.name).unwrap().about, camera.about);
    }
    let mut parameters = ReadoutParameters::default();
    for parameter in READOUT_PARAMETERS {
        for value in [parameter.least, parameter.most] {
            parameters.set(parameter.name, value).unwrap();
        }
        for value in [f64::NAN, f64::INFINITY, -1.0, 1e9] {
            assert!(
                parameters.set(parameter.name, value).is_err(),
                "{} {value}",
                parameter.name
            );
        }
    }
    assert!(
        parameters
            .set("tick_us", 1.5)
            .unwrap_err()
            .to_string()
            .contains("whole")
    );
    assert!(
        parameters
            .set("moon", 1.0)
            .unwrap_err()
            .to_string()
            .contains("scan_us")
    );
}
