//! `cargo bench`: a window of 3,200 events of a 346 x 260 scene, pushed and encoded, on one thread.
//!
//! Events per second are comparable with the paper's Table III, whose windows are as large.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use eecvs_nostd::{
    Config, Encoder, Event, FRAME_BYTES_MAX, Push, Quantiser, Scan, Thresholds, Transform,
    WindowConfig, scan,
};
use host_harness::encode::{HostStorage, WINDOW_EVENTS};
use host_harness::formats::EventReader;
use host_harness::scene::{Preset, SceneConfig, emulate};

const EVENTS: usize = 3200;
/// No event of the scene comes later: all are one window.
const WINDOW_US: u32 = 32_768;

fn encode(encoder: &mut Encoder<'_>, events: &[Event], out: &mut [u8]) -> usize {
    for event in events {
        assert_eq!(encoder.push(*event), Push::Stored);
    }
    encoder.flush();
    let frame = encoder.next_frame(out).expect("there is room");
    assert_eq!(encoder.next_frame(out), Ok(None));
    frame.expect("a frame").range.end
}

fn benches(criterion: &mut Criterion) {
    let scene = SceneConfig::new(Preset::OutdoorWellLitBlur, 1);
    let mut emulator = emulate(scene).expect("a scene");
    let mut events = Vec::new();
    // From some way into it.
    while emulator.read(&mut events).expect("a scene") > 0 {}
    events.retain(|event| event.t_us >= 100_000);
    events.truncate(EVENTS);
    assert_eq!(events.len(), EVENTS);
    assert!(events[EVENTS - 1].t_us - events[0].t_us < u64::from(WINDOW_US));

    let mut group = criterion.benchmark_group("encode");
    group.throughput(Throughput::Elements(EVENTS as u64));
    for transform in Transform::ALL {
        for m in [8, 16] {
            let config = Config {
                window: WindowConfig {
                    sensor: scene.sensor,
                    window_us: WINDOW_US,
                },
                thresholds: Thresholds::new(0, 0).expect("equal thresholds"),
                transform: Some(transform),
                m,
                grid: None,
                quantiser: Quantiser::DEFAULT,
            };
            let mut storage = HostStorage::new(scene.sensor, WINDOW_EVENTS);
            let mut encoder = storage.encoder(config).expect("a valid configuration");
            let mut out = vec![0; FRAME_BYTES_MAX];
            // The answer first: a frame that reads back with every event.
            let end = encode(&mut encoder, &events, &mut out);
            let start = out.iter().position(|byte| *byte != 0).expect("a frame");
            let Scan::Frame(frame) = scan(&out[start..end]) else {
                panic!("not a frame");
            };
            assert_eq!(frame.header.events as usize, EVENTS);
            let pixels = frame.descriptors().filter(Result::is_ok).count();
            assert_eq!(pixels, frame.header.pixels as usize);
            group.bench_function(BenchmarkId::new(transform.name(), m), |bencher| {
                bencher.iter(|| encode(&mut encoder, &events, &mut out));
            });
        }
    }
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
