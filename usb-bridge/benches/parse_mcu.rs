//! Time per event of the parser of the encoder's frames: lossless, with the fast coder.
//!
//! Streams are written from the shared recordings, or from a seeded scene if there are none. Every result is
//! verified before it is timed. `--test` runs each benchmark once.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use eecvs_nostd::{Event, Sensor};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use usb_bridge::device::mcu::parse::McuParser;
use usb_bridge::device::mcu::write::McuStream;
use usb_bridge::device::{Parse, WriteStream};

/// Bytes per transfer from the encoder.
const TRANSFER: usize = 1 << 12;

fn sources() -> Vec<(&'static str, Box<dyn EventReader>)> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let mut sources = Vec::new();
    for (name, path) in [
        ("boxes", "davis240_boxes_moderate/IMU_translBoxes.aedat"),
        ("building", "davis346_building_dense/davis.aedat4"),
        ("dense", "gen3_vga_dense_evt2/evt2.raw"),
    ] {
        match event_files::open(&data.join(path), None) {
            Ok(reader) => sources.push((name, reader)),
            Err(error) => eprintln!("skipped: {error:#}"),
        }
    }
    if sources.is_empty() {
        let scene = SceneConfig {
            sensor: Sensor {
                width: 320,
                height: 240,
            },
            duration_us: 200_000,
            ..SceneConfig::model_1(Preset::Motorcycle, 1)
        };
        sources.push(("scene", Box::new(emulate(scene).expect("a scene"))));
    }
    sources
}

fn parse(sensor: Sensor, bytes: &[u8], events: &mut Vec<Event>) -> u64 {
    let mut parser = McuParser::new(sensor);
    for transfer in bytes.chunks(TRANSFER) {
        // A consumer takes the events of each transfer.
        events.clear();
        parser.parse(transfer, events);
        black_box(&events);
    }
    parser.events()
}

fn benches(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("mcu");
    for (name, mut reader) in sources() {
        let (mut recording, mut bytes) = (Vec::new(), Vec::new());
        while reader.read(&mut recording).expect("a recording") > 0 {}
        let sensor = reader.sensor();
        let mut writer = McuStream::new(sensor);
        writer
            .write(&recording, &mut bytes)
            .expect("events that fit");
        writer.finish(&mut bytes).expect("an end");
        let (mut events, count) = (Vec::new(), recording.len() as u64);
        assert_eq!(parse(sensor, &bytes, &mut events), count);
        group.throughput(Throughput::Elements(count));
        group.bench_function(name, |bencher| {
            bencher.iter(|| parse(sensor, &bytes, &mut events));
        });
    }
    group.finish();
}

criterion_group! {
    name = parse_mcu;
    config = Criterion::default()
        .sample_size(20)
        .measurement_time(std::time::Duration::from_secs(2))
        .warm_up_time(std::time::Duration::from_millis(500));
    targets = benches
}
criterion_main!(parse_mcu);
