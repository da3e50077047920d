//! Nothing grows without end, and frames are taken as quickly as they come.

use std::sync::Arc;
use std::time::{Duration, Instant};

use eecvs_hub::board::kept::{KEPT_BYTES_MAX, Kept};
use eecvs_hub::board::{Board, SENSORS_MAX};
use eecvs_nostd::Frame;
use event_emulator::Preset;

use super::EXACT;
use crate::feed::{Way, name, scene, stamp};

#[test]
fn sensors_are_bounded() {
    let board = Board::new("hall");
    for number in 0..SENSORS_MAX + 7 {
        board.alive(&name(&format!("cam/{number}")), true);
    }
    let started = Instant::now();
    let overview = board.overview();
    println!(
        "an overview of {SENSORS_MAX} sensors took {:?}",
        started.elapsed()
    );
    assert_eq!((overview.sensors.len(), overview.refused), (SENSORS_MAX, 7));
    assert_eq!(overview.connected, SENSORS_MAX);
    board.alive(&name("cam/0"), false);
    assert_eq!(board.overview().refused, 7);
    assert!(overview.sensors.is_sorted_by_key(|row| row.name.clone()));
}

#[test]
fn kept_frames_are_bounded() {
    let scene = scene(Preset::Motorcycle, Way::of(EXACT));
    let header = Frame::parse(&scene.frames[0]).unwrap().header;
    let goes_on = eecvs_nostd::Header {
        is_key: false,
        ..header
    };
    let part = eecvs_nostd::Header {
        part: 1,
        last: false,
        ..header
    };
    let first = eecvs_nostd::Header {
        last: false,
        ..header
    };
    let bytes = vec![0; KEPT_BYTES_MAX / 3];
    // Windows that go on without a key frame; a window without end; windows that are too large.
    for (begin, more) in [(header, goes_on), (first, part)] {
        let mut kept = Kept::default();
        for number in 0..100 {
            let header = if number % 10 == 0 { begin } else { more };
            kept.take(number, &header, &bytes);
            assert!(kept.bytes() <= KEPT_BYTES_MAX);
            assert_eq!(kept.picture().is_some(), begin.last);
        }
    }
    let mut kept = Kept::default();
    kept.take(0, &header, &bytes);
    kept.take(1, &header, &vec![0; KEPT_BYTES_MAX + 1]);
    assert!(kept.bytes() <= KEPT_BYTES_MAX);
}

#[test]
fn frames_are_taken_quickly() {
    let board = Board::new("hall");
    let names: Vec<_> = (0..100)
        .map(|number| name(&format!("cam-{number}")))
        .collect();
    // As much as a hub takes in a second: 20,000 frames, and 50 MB.
    let small = Way {
        frame_bytes: 2600,
        ..Way::of(EXACT)
    };
    let frames = scene(Preset::Motorcycle, small).frames;
    for is_wanted in [false, true] {
        let (mut bytes, mut number, started) = (0, 0, Instant::now());
        while number < 20_000 || bytes < 50_000_000 {
            let frame = &frames[number % frames.len()];
            let cam = &names[number % 100];
            let stamp = stamp(1 + u64::from(is_wanted), number as u64 / 100, 0);
            board.frame(cam, stamp, frame);
            if is_wanted && number < 100 {
                board.want(cam);
            }
            bytes += frame.len();
            number += 1;
        }
        let took = started.elapsed();
        println!("{number} frames, {bytes} bytes, pictures wanted: {is_wanted}: {took:?}");
        assert!(took < Duration::from_secs(1), "{took:?}");
        assert_eq!(
            board.rows().iter().any(|row| row.picture.is_some()),
            is_wanted
        );
    }
}

#[test]
fn many_threads_feed_one_board() {
    let board = Arc::new(Board::new("hall"));
    let scene = Arc::new(scene(Preset::OutdoorDark, Way::of(EXACT)));
    let threads: Vec<_> = (0..4_u64)
        .map(|thread| {
            let (board, scene) = (Arc::clone(&board), Arc::clone(&scene));
            std::thread::spawn(move || {
                for number in 0..1000 {
                    let frame = &scene.frames[number % scene.frames.len()];
                    // All of them feed one sensor; each has its quarter of the numbers.
                    let number = 4 * number as u64 + thread;
                    board.frame(&name("shared"), stamp(1, number + 1, 0), frame);
                    let _ = board.picture(&name("shared"));
                }
            })
        })
        .collect();
    for thread in threads {
        thread.join().unwrap();
    }
    let row = board.rows().remove(0);
    let missing = row.losses.frames_missing + row.losses.frames_repeated;
    assert_eq!(
        row.frames_received + row.losses.frames_repeated,
        4000,
        "{row:?}"
    );
    // Those that came before the first that was seen are said to have come again.
    assert!(missing < 100, "{row:?}");
}
