//! What rows tell of sensors: their rates, losses, runs and latencies.

use std::time::Duration;

use eecvs_hub::board::Board;
use eecvs_hub::board::latency::Latencies;
use eecvs_hub::board::rate::{Amount, Rate};
use eecvs_hub::board::row::{Losses, Times};
use eecvs_hub::board::runs::{Place, Runs};
use eecvs_hub::message::{Events, Status, Stored};
use eecvs_nostd::{Coder, Fidelity, Frame, Mode};
use event_emulator::Preset;

use super::EXACT;
use crate::feed::{Way, answer_clock, events, name, scene, stamp};

#[test]
fn a_row_tells_what_came() {
    let board = Board::new("hall");
    let scene = scene(Preset::IndoorFlying, Way::of(EXACT));
    let cam = name("hall-2/door");
    for (number, frame) in scene.frames.iter().enumerate() {
        board.frame(&cam, stamp(5, 3 + number as u64, 20_000), frame);
        if number == 0 {
            assert_eq!(board.rows()[0].latency, None, "the clock is not known yet");
            answer_clock(&board, &cam, 5, 0);
        }
    }
    let rows = board.rows();
    let [row] = &rows[..] else {
        panic!("{rows:?}");
    };
    let sent = |of: fn(&Frame<'_>) -> u64| -> u64 {
        let parsed = scene
            .frames
            .iter()
            .map(|frame| Frame::parse(frame).unwrap());
        parsed.map(|frame| of(&frame)).sum()
    };
    let bytes = sent(|frame| frame.bytes as u64);
    let events = sent(|frame| u64::from(frame.header.events));
    assert!(events > 1000 && events == scene.source.events.len() as u64);
    assert_eq!(
        (row.name.as_str(), row.run, row.is_connected),
        ("hall-2/door", 5, true)
    );
    let sensor = scene.source.sensor;
    assert_eq!((row.columns, row.rows), (sensor.width, sensor.height));
    assert_eq!(row.frames_received, scene.frames.len() as u64);
    assert_eq!((row.bytes_received, row.events_received), (bytes, events));
    assert_eq!(row.losses, Losses::default());
    // All in less than half a second, which is the least that a rate is told over, or a little more.
    let rate = row.rate;
    let share = rate.events_per_s / (events as f64 * 2.0);
    assert!(share > 0.05 && share <= 1.0, "{rate:?}");
    let bits = bytes as f64 * 8.0 / events as f64;
    assert!(
        (rate.bits_per_event.unwrap() - bits).abs() < 1e-9,
        "{rate:?}"
    );
    let last = Frame::parse(scene.frames.last().unwrap()).unwrap().header;
    let window = row.window.unwrap();
    assert_eq!(
        (window.regime, window.transform),
        (last.regime.name(), last.transform.name())
    );
    let density = f64::from(last.window_events) * 1e6
        / (f64::from(sensor.pixels()) * f64::from(last.duration_us));
    assert!((window.density - density).abs() < 1e-9 * density);
    assert_eq!((window.coder, window.times), ("fast", Times::Exact));
    assert_eq!(
        row.windows.iter().sum::<u64>(),
        sent(|frame| u64::from(frame.header.part == 0))
    );
    let latency = row.latency.unwrap();
    assert!((20_000..2_000_000).contains(&latency.p50_us), "{latency:?}");
    assert!(latency.p50_us <= latency.p99_us);
    assert!(row.frame_age_s.unwrap() < 5.0 && row.status_age_s.is_none());
}

#[test]
fn fidelity_budget_and_clocks_are_told() {
    let board = Board::new("hall");
    let thinned = Way {
        bytes_per_second: Some(60_000),
        ..Way::of(events(Coder::Dense, Fidelity::Lossless))
    };
    let within = Way::of(events(Coder::Dense, Fidelity::ToleranceUs(50)));
    for (at, way, window) in [
        // As the encoder does: times go first, then events.
        ("a", thinned, ("dense", Times::Bins(1))),
        ("a-2", within, ("dense", Times::WithinUs(50))),
        (
            "b",
            Way::of(events(Coder::Fast, Fidelity::Bins(8))),
            ("fast", Times::Bins(8)),
        ),
        (
            "c",
            Way::of(Mode::Transform),
            ("plain", Times::Coefficients(16)),
        ),
    ] {
        let scene = scene(Preset::Motorcycle, way);
        for (number, frame) in scene.frames.iter().enumerate() {
            // A clock that is ahead by 40 s, and delays of 10 ms.
            board.frame(&name(at), stamp(1, number as u64, -39_990_000), frame);
            if number == 0 {
                answer_clock(&board, &name(at), 1, 40_000_000);
            }
        }
        let row = board.rows().pop().unwrap();
        let told = row.window.unwrap();
        assert_eq!((told.coder, told.times), window);
        assert_eq!(row.rate.thinned_per_s > 0.0, at == "a", "{:?}", row.rate);
        let (latency, clock) = (row.latency.unwrap(), row.clock.unwrap());
        assert!((9_000..5_000_000).contains(&latency.p50_us), "{row:?}");
        assert!(clock.is_different(), "{row:?}");
        assert!(
            clock.ahead_us.abs_diff(40_000_000) <= clock.error_us,
            "{row:?}"
        );
    }
}

#[test]
fn losses_have_causes() {
    let board = Board::new("hall");
    let scene = scene(Preset::OutdoorDark, Way::of(EXACT));
    let cam = name("cam");
    let frame = &scene.frames[0];
    for number in [0, 1, 5, 5, 3] {
        board.frame(&cam, stamp(9, number, 0), frame);
    }
    let mut damaged = frame.clone();
    *damaged.last_mut().unwrap() ^= 1;
    board.frame(&cam, stamp(9, 6, 0), &damaged);
    let longer = [&frame[..], &[0]].concat();
    board.frame(&cam, stamp(9, 7, 0), &longer);
    board.frame(&cam, stamp(9, 8, 0), &[]);
    board.malformed(Some(&cam));
    board.malformed(Some(&name("nobody")));
    board.malformed(None);
    board.alive(&cam, false);
    let status = Status {
        run: 9,
        next: 9,
        width: 3,
        height: 2,
        events: Events {
            late: 1,
            filtered: 2,
            dropped: 3,
            thinned: 4,
            ..Events::default()
        },
        budget: Some(1000),
        is_congested: true,
        outages: 2,
        outages_us: 2_500_000,
        stored: Stored {
            memory_bytes: 11,
            disk_bytes: 12,
            let_go_frames: 13,
            disk_failures: 14,
            disk_damaged_frames: 15,
            disk_damaged_bytes: 16,
            ..Stored::default()
        },
        ..Status::default()
    };
    board.status(&cam, status.clone());
    let overview = board.overview();
    assert_eq!(
        (overview.malformed, overview.refused, overview.connected),
        (2, 0, 0)
    );
    assert_eq!(overview.sensors.len(), 1);
    let row = &overview.sensors[0];
    let losses = row.losses;
    assert_eq!((losses.events_late, losses.events_filtered), (1, 2));
    assert_eq!((losses.events_dropped, losses.events_thinned), (3, 4));
    // 2 and 4.
    assert_eq!((losses.frames_missing, losses.frames_repeated), (2, 1));
    assert_eq!((losses.frames_damaged, losses.malformed), (3, 1));
    assert_eq!((losses.frames_let_go, losses.disk_failures), (13, 14));
    assert_eq!(losses.disk_damaged_frames, 15);
    assert_eq!((losses.outages, losses.outages_s), (2, 2.5));
    assert_eq!((row.budget, row.is_congested), (Some(1000), true));
    assert_eq!((row.store_memory_bytes, row.store_disk_bytes), (11, 12));
    assert_eq!(row.store_damaged_bytes, 16);
    // What a status says exists has until the next status to come.
    let later = Status { next: 12, ..status };
    board.status(&cam, later.clone());
    assert_eq!(board.rows()[0].losses.frames_missing, 2);
    board.status(&cam, later);
    assert_eq!(board.rows()[0].losses.frames_missing, 2 + 3);
}

#[test]
fn runs_are_told_apart() {
    let board = Board::new("hall");
    let scene = scene(Preset::OutdoorDark, Way::of(EXACT));
    let cam = name("cam");
    let come = |run, number| board.frame(&cam, stamp(run, number, 0), &scene.frames[0]);
    come(100, 7);
    come(100, 10);
    assert_eq!(board.rows()[0].losses.frames_missing, 2);
    // After a restart from its first frame on: 0 and 1 did not come.
    come(200, 2);
    let row = board.rows().remove(0);
    assert_eq!(
        (
            row.run,
            row.losses.frames_missing,
            row.losses.frames_missing_before
        ),
        (200, 4, 0)
    );
    // A late one of the run before, which is none that the sensor's present figures are of.
    come(100, 8);
    let row = board.rows().remove(0);
    assert_eq!((row.run, row.losses.frames_missing), (200, 3));
    come(300, 0);
    let losses = board.rows()[0].losses;
    assert_eq!(
        (losses.frames_missing, losses.frames_missing_before),
        (2, 1)
    );
    assert_eq!(board.rows()[0].frames_received, 5);
}

#[test]
fn the_run_that_was_heard_first_last_is_the_present_one() {
    let mut runs = Runs::default();
    assert_eq!(runs.take(50, 3), Place::New);
    // A clock that was set back.
    assert_eq!(runs.take(40, 0), Place::New);
    assert_eq!(runs.run(), 40);
    runs.told(60, 1);
    assert_eq!((runs.run(), runs.missing_before()), (60, 0));
    assert_eq!(runs.take(40, 1), Place::Late);
    assert_eq!(runs.take(60, 2), Place::New);
    assert_eq!(
        (runs.take(60, 1), runs.take(60, 1)),
        (Place::Late, Place::Again)
    );
    assert_eq!((runs.run(), runs.missing()), (60, 1));
    // And once more; what does not come of it counts, whatever its number.
    runs.told(30, 7);
    runs.told(30, 7);
    assert_eq!((runs.run(), runs.missing()), (30, 8));
    // Runs are bounded; those that are forgotten do not begin anew.
    for run in 100..200 {
        assert_eq!(runs.take(run, 1), Place::New);
    }
    assert_eq!((runs.take(150, 9), runs.run()), (Place::Old, 199));
    assert_eq!((runs.missing(), runs.missing_before()), (2, 8 + 98));
    // Of a sensor whose frames do not come, its statuses tell.
    let mut runs = Runs::default();
    runs.told(1, 10);
    runs.told(1, 15);
    assert_eq!(runs.missing(), 0);
    runs.told(1, 20);
    assert_eq!(runs.missing(), 5);
}

#[test]
fn rates_are_of_the_last_seconds() {
    let mut rate = Rate::default();
    let ms = Duration::from_millis;
    assert_eq!(rate.over(ms(9)).events_per_s, 0.0);
    let amount = Amount {
        events: 100,
        bytes: 50,
        windows: 1,
        thinned: 2,
    };
    for step in 0..1000 {
        rate.add(ms(10 * step), amount);
    }
    let steady = rate.over(ms(10_000));
    for (told, is) in [
        (steady.events_per_s, 10_000.0),
        (steady.bytes_per_s, 5_000.0),
        (steady.windows_per_s, 100.0),
        (steady.thinned_per_s, 200.0),
        (steady.bits_per_event.unwrap(), 4.0),
    ] {
        assert!((told / is - 1.0).abs() < 0.01, "{steady:?}");
    }
    // Half of it is over; and then all of it, also after a round of the slots.
    assert!((rate.over(ms(12_000)).events_per_s / 5_000.0 - 1.0).abs() < 0.02);
    assert_eq!(rate.over(ms(15_000)).bits_per_event, None);
    rate.add(ms(1_000_000), amount);
    assert!(rate.over(ms(1_000_001)).events_per_s <= 200.0);
    // A moment before the newest, as threads have it, is no harm.
    rate.add(ms(999_000), amount);
    assert_eq!(Rate::default().over(Duration::MAX).bytes_per_s, 0.0);
}

#[test]
fn latencies_are_those_of_all_frames_alike() {
    let mut latencies = Latencies::default();
    let at = Duration::from_secs(100);
    assert_eq!(latencies.over(at), None);
    for frame in 0..100_000_i64 {
        latencies.add(at + Duration::from_micros(frame as u64), frame);
    }
    let latency = latencies.over(at + Duration::from_secs(1)).unwrap();
    assert!((latency.p50_us - 50_000).abs() < 2_000, "{latency:?}");
    assert!((latency.p99_us - 99_000).abs() < 2_000, "{latency:?}");
    // Few frames of another slot do not count as much as these.
    for _ in 0..50 {
        latencies.add(at + Duration::from_secs(4), 1_000_000);
    }
    let both = latencies.over(at + Duration::from_secs(4)).unwrap();
    assert!(
        (both.p50_us - latency.p50_us).abs() < 2_000 && both.p99_us < 100_000,
        "{both:?}"
    );
    // They alone are left once the others are ten seconds old.
    let late = latencies.over(at + Duration::from_secs(13)).unwrap();
    assert_eq!((late.p50_us, late.p99_us), (1_000_000, 1_000_000));
    assert_eq!(latencies.over(at + Duration::from_secs(60)), None);
    let mut few = Latencies::default();
    for sample in [-5, -3, 40] {
        few.add(at, sample);
    }
    let few = few.over(at).unwrap();
    assert_eq!((few.p50_us, few.p99_us), (-3, 40));
}

/// A board hears two sensors of one name, and one that is started again.
#[test]
fn sensors_of_one_name_are_counted() {
    let board = Board::new("hall");
    let status = |run, up_s: u64| Status {
        run,
        next: 0,
        up_us: up_s * 1_000_000,
        ..Status::default()
    };
    board.status(&name("again"), status(7, 100));
    board.status(&name("again"), status(3, 0));
    // The clock of the second one is an hour behind.
    for up_s in [100, 101] {
        board.status(&name("twice"), status(3_600_000_007, up_s));
        board.status(&name("twice"), status(7, up_s - 50));
    }
    let rows = board.rows();
    let counts: Vec<_> = rows
        .iter()
        .map(|row| (row.name.as_str(), row.at_once))
        .collect();
    assert_eq!(counts, [("again", 1), ("twice", 2)]);
    assert_eq!(board.shared_names(), [(name("twice"), 2)]);
    let up_s = rows[1].up_s.unwrap();
    assert!((51.0..60.0).contains(&up_s), "{up_s}");
    let figures = board.metrics();
    for line in [
        "eecvs_sensors_at_once{sensor=\"again\"} 1",
        "eecvs_sensors_at_once{sensor=\"twice\"} 2",
    ] {
        assert!(figures.contains(line), "{figures}");
    }
}
