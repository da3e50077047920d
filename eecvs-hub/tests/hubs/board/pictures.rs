//! Pictures, against those of the events themselves.

use std::time::Duration;

use eecvs_hub::board::kept::Kept;
use eecvs_hub::board::{Board, picture};
use eecvs_nostd::{Coder, Fidelity, Frame, Mode, Sensor};
use event_emulator::Preset;
use event_pictures::frame_picture::{FrameSums, event_frame};

use super::EXACT;
use crate::feed::{Scene, Way, events, name, scene, stamp};

/// The picture of a scene's window, from its events themselves.
fn expected(scene: &Scene, window: &eecvs_nostd::Header) -> (u32, u32, Vec<u8>) {
    let end_us = window.t0_us + u64::from(window.duration_us);
    let all = scene.source.events.iter().copied();
    let inside: Vec<_> = all
        .filter(|event| (window.t0_us..end_us).contains(&event.t_us))
        .collect();
    assert_eq!(inside.len(), window.window_events as usize);
    let sums = FrameSums::new(scene.source.sensor, &inside);
    let (shrink, style) = picture::style(scene.source.sensor);
    decoded(&event_frame(&sums.shrunk(shrink), style).png().unwrap())
}

fn decoded(png: &[u8]) -> (u32, u32, Vec<u8>) {
    // The signature and the header; pixels are compared by the bytes of the same encoder.
    assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
    let side = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
    (side(16), side(20), png.to_vec())
}

#[test]
fn pictures_are_those_of_the_latest_window() {
    let small = Way {
        frame_bytes: 4096,
        ..Way::of(EXACT)
    };
    let ways = [
        ("fast", Way::of(EXACT)),
        ("parts", small),
        ("dense", Way::of(events(Coder::Dense, Fidelity::Lossless))),
        ("coefficients", Way::of(Mode::Coefficients(Coder::Fast))),
        ("plain", Way::of(Mode::Transform)),
    ];
    for (at, way) in ways {
        let scene = scene(Preset::Motorcycle, way);
        let headers: Vec<_> = scene
            .frames
            .iter()
            .map(|frame| Frame::parse(frame).unwrap().header)
            .collect();
        if at == "parts" {
            assert!(headers.iter().any(|header| header.part > 1));
        }
        if at == "dense" {
            assert!(headers.iter().any(|header| !header.is_key));
        }
        let board = Board::new("hall");
        let cam = name(at);
        assert_eq!(board.picture(&cam), None);
        board.frame(&cam, stamp(1, 0, 0), &scene.frames[0]);
        // Not before it was asked for: then from the next frame on that decodes by itself.
        assert_eq!((board.rows()[0].picture, board.picture(&cam)), (None, None));
        // Without the last window's last frame, the window before is the latest whole one.
        let end = scene.frames.len() - 1;
        for (number, frame) in scene.frames[..end].iter().enumerate().skip(1) {
            board.frame(&cam, stamp(1, number as u64, 0), frame);
        }
        let shown = headers[..end]
            .iter()
            .rfind(|header| header.last && header.events > 0);
        let png = board.picture(&cam).unwrap();
        let (width, height, bytes) = expected(&scene, shown.unwrap());
        assert!(
            (180..=360).contains(&width.max(height)),
            "{width} x {height}"
        );
        assert!(
            decoded(&png) == (width, height, bytes),
            "{at}: another picture"
        );
        // A second one within a second is the same, whatever has come.
        board.frame(&cam, stamp(1, end as u64, 0), &scene.frames[end]);
        let before = board.picture(&cam).unwrap();
        assert!(before == png, "{at}");
        std::thread::sleep(Duration::from_millis(1050));
        let after = board.picture(&cam).unwrap();
        assert!(
            decoded(&after) == expected(&scene, &headers[end]),
            "{at}: not the last window"
        );
    }
}

#[test]
fn a_gap_ends_a_dense_picture_until_the_next_key_frame() {
    let scene = scene(
        Preset::Motorcycle,
        Way::of(events(Coder::Dense, Fidelity::Lossless)),
    );
    let headers: Vec<_> = scene
        .frames
        .iter()
        .map(|frame| Frame::parse(frame).unwrap().header)
        .collect();
    let keys: Vec<usize> = (0..headers.len()).filter(|i| headers[*i].is_key).collect();
    assert!(keys.len() >= 3 && keys[1] - keys[0] >= 3, "{keys:?}");
    let mut kept = Kept::default();
    let take = |kept: &mut Kept, number: usize| {
        kept.take(number as u64, &headers[number], &scene.frames[number]);
        kept.frames().len()
    };
    // It goes on from frames that did not come.
    assert_eq!(take(&mut kept, 1), 0);
    assert_eq!(
        (take(&mut kept, keys[1]), take(&mut kept, keys[1] + 1)),
        (1, 2)
    );
    let picture = kept.picture();
    // One is missing: what came before it is kept.
    assert_eq!((take(&mut kept, keys[1] + 3), kept.picture()), (2, picture));
    assert_eq!(take(&mut kept, keys[2]), 1);
    assert_ne!(kept.picture(), picture);
    kept.clear();
    assert_eq!((kept.bytes(), kept.picture()), (0, None));
}

#[test]
fn pictures_fit_any_sensor() {
    for (width, height) in [
        (1, 1),
        (2048, 2048),
        (2048, 1),
        (346, 260),
        (640, 480),
        (128, 128),
        (1280, 720),
    ] {
        let sensor = Sensor { width, height };
        let png = picture::png(&FrameSums::empty(sensor)).unwrap();
        let (width, height, _) = decoded(&png);
        assert!(
            (160..=360).contains(&width.max(height)),
            "{width} x {height}"
        );
    }
}
