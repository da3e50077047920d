//! Reads any bytes as a video: it is refused, or its frames have the size that it states and numbers of light.

use std::fs;
use std::process;
use std::thread;

use eecvs_nostd::Sensor;
use event_files::video::{RawGray, VideoReading, open_video};

/// Frames that are read, at most.
const FRAMES_MAX: usize = 16;

/// How videos begin: random bytes would hardly find it.
const STARTS: [&[u8]; 4] = [
    b"",
    b"YUV4MPEG2 W6 H4 F25:1 Ip C420jpeg\nFRAME\n",
    b"\x93NUMPY\x01\x00\x3f\x00{'descr': '|u1', 'fortran_order': False, 'shape': (2, 4, 6), }\n",
    b"#!AER-DAT4.0\r\n",
];

/// Runs one input.
pub fn run(data: &[u8]) {
    let Some((choice, data)) = data.split_first() else {
        return;
    };
    // One file for each process and thread: inputs follow each other.
    let name = format!("eecvs-video-{}-{:?}", process::id(), thread::current().id());
    let path = std::env::temp_dir().join(name);
    let start = STARTS[usize::from(*choice) % STARTS.len()];
    fs::write(&path, [start, data].concat()).expect("a temporary file");
    let raw = (choice / 4 % 4 == 3).then_some(RawGray {
        sensor: Sensor {
            width: 6,
            height: 4,
        },
        wide: choice / 128 == 1,
    });
    let reading = VideoReading {
        fps: (choice / 16 % 2 == 1).then(|| "25".parse().expect("a rate")),
        white: (choice / 32 % 2 == 1).then_some(200.0),
        full_range: (choice / 64 % 2 == 1).then_some(true),
        raw,
        ..VideoReading::default()
    };
    if let Ok(mut video) = open_video(&path, &reading) {
        let sensor = video.sensor();
        let pixels = usize::from(sensor.width) * usize::from(sensor.height);
        let (mut values, mut last_us) = (Vec::new(), None);
        for _ in 0..FRAMES_MAX {
            let Ok(Some(t_us)) = video.read(&mut values) else {
                break;
            };
            assert!(last_us < Some(t_us), "{t_us} us after {last_us:?}");
            assert_eq!(values.len(), pixels, "pixels of a frame");
            let is_light = |value: &f32| value.is_finite() && *value >= 0.0;
            assert!(values.iter().all(is_light), "not a number of light");
            last_us = Some(t_us);
        }
    }
    let _ = fs::remove_file(&path);
}
