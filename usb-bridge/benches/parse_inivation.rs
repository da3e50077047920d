//! Parsing of streams from iniVation's cameras into events, on one thread, in transfers of 8 KiB. Run with
//! `cargo bench -p usb-bridge --bench parse_inivation`.
//!
//! `spread` has a different pixel for every event, which takes the most words; `lines` has runs of neighbours in a
//! column, as moving edges produce them.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use eecvs_nostd::{Event, Polarity, Sensor};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use usb_bridge::device::{Info, find};

const EVENTS: usize = 200_000;

const TRANSFER: usize = 8192;

const MODELS: [(&str, u16, u16); 5] = [
    ("dvs128", 128, 128),
    ("davis240", 240, 180),
    ("davis346", 346, 260),
    ("dvxplorer", 640, 480),
    ("dvxplorer-mipi", 640, 480),
];

/// Events in runs of up to `run` neighbours, 1 to 3 us apart.
fn events(sensor: Sensor, run: u64) -> Vec<Event> {
    let mut numbers = Xoshiro256PlusPlus::seed_from_u64(run);
    let mut below = |end: u64| numbers.next_u64() % end;
    let mut events = Vec::with_capacity(EVENTS);
    let mut t_us = 0;
    while events.len() < EVENTS {
        t_us += 1 + below(3);
        let x = below(sensor.width.into()) as u16;
        let y = below(sensor.height.into());
        let polarity = Polarity::from_bool(below(2) == 0);
        for row in y..(y + 1 + below(run)).min(sensor.height.into()) {
            events.push(Event {
                t_us,
                x,
                y: row as u16,
                polarity,
            });
        }
    }
    events
}

fn benches(criterion: &mut Criterion) {
    for (name, width, height) in MODELS {
        let model = find(name).expect("it is registered");
        let sensor = Sensor::new(width, height).expect("a sensor");
        let info = Info {
            name: name.into(),
            serial: None,
            firmware: String::new(),
            sensor,
            stream: "",
        };
        let mut group = criterion.benchmark_group(name);
        for (scene, run) in [("spread", 1), ("lines", 16)] {
            let wanted = events(sensor, run);
            let mut writer = model.writer(sensor).expect("it fits");
            let mut bytes = Vec::new();
            writer.write(&wanted, &mut bytes).expect("in order");
            writer.finish(&mut bytes).expect("in order");
            let mut read = Vec::with_capacity(wanted.len() + TRANSFER * 8);
            // Verifies the result before timing it.
            model.parser(&info).parse(&bytes, &mut read);
            assert!(read == wanted, "{name} reads what was written");
            group.throughput(Throughput::Elements(wanted.len() as u64));
            group.bench_function(BenchmarkId::new("parse", scene), |bencher| {
                bencher.iter(|| {
                    let mut parser = model.parser(&info);
                    read.clear();
                    for transfer in bytes.chunks(TRANSFER) {
                        parser.parse(transfer, &mut read);
                    }
                    read.len()
                });
            });
        }
        group.finish();
    }
}

criterion_group!(all, benches);
criterion_main!(all);
