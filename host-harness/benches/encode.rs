//! Benchmarks pushing and encoding a window of 3,200 events of a 346 x 260 scene, on one thread: `cargo bench`.
//!
//! Events per second are comparable with the paper's Table III, whose windows have the same size.
//! cargo xtask host-instructions counts the instructions of the same work.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use eecvs::encode::{HostStorage, WINDOW_EVENTS};
use eecvs_bench::moderate::{EVENTS, SENSOR, config, encode, scene, window};
use eecvs_nostd::{FRAME_BYTES_MAX, Scan, Transform, scan};

fn benches(criterion: &mut Criterion) {
    let scene = scene().expect("a scene");
    let events = window(&scene).expect("its events");
    let mut group = criterion.benchmark_group("encode");
    group.throughput(Throughput::Elements(EVENTS as u64));
    for transform in Transform::ALL {
        for m in [8, 16] {
            let mut storage = HostStorage::new(SENSOR, WINDOW_EVENTS);
            let mut encoder = storage
                .encoder(config(transform, m))
                .expect("a valid configuration");
            let mut out = vec![0; FRAME_BYTES_MAX];
            // Check the result first: a frame that decodes to every event.
            let Scan::Frame(frame) = scan(encode(&mut encoder, events, &mut out)) else {
                panic!("not a frame");
            };
            assert_eq!(frame.header.events as usize, EVENTS);
            let pixels = frame.descriptors().filter(Result::is_ok).count();
            assert_eq!(pixels, frame.header.pixels as usize);
            group.bench_function(BenchmarkId::new(transform.name(), m), |bencher| {
                bencher.iter(|| encode(&mut encoder, events, &mut out).len());
            });
        }
    }
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
