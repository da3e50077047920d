//! Time per event of the parsers of Prophesee's streams, and of the crate `evt3` on the same bytes.
//!
//! Streams are written from the shared recordings, or from a seeded scene if there are none; `own` is what a camera
//! sent. Every result is verified before it is timed. `--test` runs each benchmark once.

use std::hint::black_box;
use std::path::Path;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use eecvs_nostd::{Event, Sensor};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use event_types::evt21::Order;
use evt3::Evt3Decoder;
use usb_bridge::device::prophesee::parse_evt3::Evt3Parser;
use usb_bridge::device::prophesee::parse_evt21::Evt21Parser;
use usb_bridge::device::prophesee::write_evt3::Evt3Stream;
use usb_bridge::device::prophesee::write_evt21::Evt21Stream;
use usb_bridge::device::{Parse, WriteStream};

const HD: Sensor = Sensor {
    width: 1280,
    height: 720,
};
/// Bytes per transfer from the camera.
const TRANSFER: usize = 1 << 17;

fn read(mut reader: Box<dyn EventReader>) -> Vec<Event> {
    let mut events = Vec::new();
    while reader.read(&mut events).expect("a recording") > 0 {}
    let first_us = events.iter().map(|event| event.t_us).min().unwrap_or(0);
    for event in &mut events {
        event.t_us -= first_us;
    }
    events
}

fn sources() -> Vec<(&'static str, Vec<Event>)> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let mut sources = Vec::new();
    for (name, path) in [
        ("sparse", "imx636_sparse_evt3/evt3.raw"),
        ("building", "davis346_building_dense/davis.aedat4"),
        ("dense", "gen3_vga_dense_evt2/evt2.raw"),
    ] {
        match event_files::open(&data.join(path), None) {
            Ok(reader) => sources.push((name, read(reader))),
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
        sources.push(("scene", read(Box::new(emulate(scene).expect("a scene")))));
    }
    sources
}

fn written(mut writer: impl WriteStream, events: &[Event]) -> Vec<u8> {
    let mut bytes = Vec::new();
    writer.write(events, &mut bytes).expect("events that fit");
    bytes
}

/// Returns a camera's bytes without the file's header.
fn own() -> Option<Vec<u8>> {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/imx636_sparse_evt3/evt3.raw");
    let bytes = std::fs::read(path).ok()?;
    let mut start = 0;
    while bytes.get(start) == Some(&b'%') {
        start += bytes[start..].iter().position(|byte| *byte == b'\n')? + 1;
    }
    Some(bytes[start..].to_vec())
}

fn parse(mut parser: impl Parse, bytes: &[u8], events: &mut Vec<Event>) -> u64 {
    for transfer in bytes.chunks(TRANSFER) {
        // A consumer takes the events of each transfer.
        events.clear();
        parser.parse(transfer, events);
        black_box(&events);
    }
    parser.events()
}

fn decode(
    bytes: &[u8],
    events: &mut Vec<evt3::CdEvent>,
    triggers: &mut Vec<evt3::TriggerEvent>,
) -> u64 {
    let (mut decoder, mut count) = (Evt3Decoder::new(), 0);
    for transfer in bytes.chunks(TRANSFER) {
        events.clear();
        triggers.clear();
        decoder
            .decode_bytes(transfer, events, triggers)
            .expect("words");
        count += events.len() as u64;
        black_box(&events);
    }
    count
}

fn benches(criterion: &mut Criterion) {
    let mut evt3_streams = Vec::new();
    let mut group = criterion.benchmark_group("evt21");
    let mut events = Vec::new();
    for (name, recording) in sources() {
        let count = recording.len() as u64;
        group.throughput(Throughput::Elements(count));
        for (order, text) in [
            (Order::UpperFirst, "upper first"),
            (Order::Little, "little"),
        ] {
            let bytes = written(Evt21Stream::new(HD, order), &recording);
            assert_eq!(
                parse(Evt21Parser::new(HD, order), &bytes, &mut events),
                count
            );
            group.bench_function(BenchmarkId::new(name, text), |bencher| {
                bencher.iter(|| parse(Evt21Parser::new(HD, order), &bytes, &mut events));
            });
        }
        evt3_streams.push((name, count, written(Evt3Stream::new(HD), &recording)));
    }
    group.finish();
    if let Some(bytes) = own() {
        let count = parse(Evt3Parser::new(HD), &bytes, &mut events);
        evt3_streams.push(("own", count, bytes));
    }
    let mut group = criterion.benchmark_group("evt3");
    let (mut peers, mut triggers) = (Vec::new(), Vec::new());
    for (name, count, bytes) in &evt3_streams {
        group.throughput(Throughput::Elements(*count));
        assert_eq!(parse(Evt3Parser::new(HD), bytes, &mut events), *count);
        assert_eq!(decode(bytes, &mut peers, &mut triggers), *count);
        group.bench_function(BenchmarkId::new(*name, "ours"), |bencher| {
            bencher.iter(|| parse(Evt3Parser::new(HD), bytes, &mut events));
        });
        group.bench_function(BenchmarkId::new(*name, "crate evt3"), |bencher| {
            bencher.iter(|| decode(bytes, &mut peers, &mut triggers));
        });
    }
    group.finish();
}

criterion_group! {
    name = parse_prophesee;
    config = Criterion::default().sample_size(20).measurement_time(std::time::Duration::from_secs(2)).warm_up_time(std::time::Duration::from_millis(500));
    targets = benches
}
criterion_main!(parse_prophesee);
