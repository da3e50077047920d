//! Every model over the real libusb, against a device that libumockdev mocks: found and listed, started,
//! received, stopped, drained, parsed, and every event as it was.

mod umockdev;

use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use eecvs_nostd::{Event, Polarity, Sensor};
use host_harness::formats;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use umockdev::{Mocked, under_umockdev};
use usb_bridge::device::{Due, MODELS, Model, Stream, recognise};
use usb_bridge::link::usb::Bus;
use usb_bridge::link::{Link, Received, drain};
use usb_bridge::peripheral::{Peripheral, Speed};

const EVENTS: usize = 60_000;

/// Sizes of sensors, the largest first: the first that a camera takes is its own.
const SENSORS: [(u16, u16); 7] = [
    (1280, 720),
    (640, 480),
    (346, 260),
    (320, 320),
    (320, 240),
    (240, 180),
    (128, 128),
];

/// A stream that is due at once.
struct Prepared {
    bytes: Vec<u8>,
    at: usize,
}

impl Stream for Prepared {
    fn take(&mut self, room: usize, bytes: &mut Vec<u8>) -> anyhow::Result<Due> {
        let end = self.bytes.len().min(self.at + room);
        bytes.extend_from_slice(&self.bytes[self.at..end]);
        self.at = end;
        Ok(if end == self.bytes.len() {
            Due::Ended
        } else {
            Due::More
        })
    }
}

fn sensor(model: &dyn Model) -> Option<Sensor> {
    let mut sensors = SENSORS.iter().filter_map(|&(w, h)| Sensor::new(w, h));
    sensors.find(|&sensor| model.writer(sensor).is_some())
}

/// Events of seeded places, most of them some microseconds apart, some after a pause.
fn events(sensor: Sensor) -> Vec<Event> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    let mut t_us = 10_000;
    (0..EVENTS)
        .map(|_| {
            let draw = random.next_u64();
            t_us += 1
                + (draw >> 32)
                    % if draw.is_multiple_of(1000) {
                        200_000
                    } else {
                        3
                    };
            Event {
                t_us,
                x: (draw as u16) % sensor.width,
                y: ((draw >> 16) as u16) % sensor.height,
                polarity: Polarity::from_bool(draw >> 63 == 1),
            }
        })
        .collect()
}

#[test]
fn every_model_gives_back_every_event() {
    if under_umockdev() {
        return receive();
    }
    // Most of the time is the devices' own waiting.
    thread::scope(|scope| {
        for model in MODELS {
            scope.spawn(|| mocked(*model));
        }
    });
}

/// The device's side.
fn mocked(model: &dyn Model) {
    // A device without events of its own has no sensor.
    let Some(sensor) = sensor(model) else {
        return;
    };
    let mut bytes = Vec::new();
    let mut writer = model.writer(sensor).unwrap();
    writer.write(&events(sensor), &mut bytes).unwrap();
    writer.finish(&mut bytes).unwrap();
    let camera = || {
        let bytes = bytes.clone();
        let camera = model.camera(sensor, Box::new(Prepared { bytes, at: 0 }));
        camera.unwrap()
    };
    captured(sensor, camera());
    let camera = camera();
    let speed = camera.descriptors().speed;
    assert!(!model.needs_super_speed() || speed == Speed::Super);
    // Several models may be one on the bus, which asks the device which one it is.
    let device = &camera.descriptors().device;
    let word = |at: usize| u16::from_le_bytes([device[at], device[at + 1]]);
    let on_the_bus = recognise(word(8), word(10), word(12)).unwrap();
    let Some(mocked) = Mocked::new(camera) else {
        return;
    };
    println!("{}", model.name());
    listed(on_the_bus, &mocked);
    mocked.run_test("every_model_gives_back_every_event");
}

/// `eecvs-usb capture` writes every event.
fn captured(sensor: Sensor, camera: Box<dyn Peripheral>) {
    let Some(mocked) = Mocked::new(camera) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("captured.aedat4");
    let mut command = mocked.command_for(env!("CARGO_BIN_EXE_eecvs-usb"));
    command.args(["capture", "--json", "--duration-s", "60", "--events"]);
    command.arg(EVENTS.to_string()).arg("-o").arg(&path);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["losses"], serde_json::json!({}), "{said}");
    let mut reader = formats::open(&path, None).unwrap();
    let mut got = Vec::new();
    while reader.read(&mut got).unwrap() > 0 {}
    let expected = events(sensor);
    assert_eq!(got.len(), expected.len(), "{said}");
    let mut pairs = got.iter().zip(&expected);
    assert_eq!(pairs.find(|(got, sent)| got != sent), None, "got and sent");
}

/// `eecvs-usb list` names it, free, with its firmware.
fn listed(model: &dyn Model, mocked: &Mocked) {
    let mut command: Command = mocked.command_for(env!("CARGO_BIN_EXE_eecvs-usb"));
    let output = command.args(["list", "--json"]).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let rows: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(rows.as_array().map(Vec::len), Some(1), "{rows}");
    let row = &rows[0];
    assert_eq!(row["model"], model.name());
    assert_eq!(row["use"], "free");
    assert!(row["problem"].is_null(), "{row}");
    assert!(row["firmware"].is_string(), "{row}");
}

/// The host's side.
fn receive() {
    let attached = Bus::new().unwrap().find(None).unwrap();
    let model = attached.model.unwrap();
    let transfers = model.transfers();
    let device = attached.open(transfers.interface).unwrap();
    let mut control = device.control();
    let info = model.identify(&mut control).unwrap();
    let mut link = device.stream(&transfers).unwrap();
    model.start(&info, &mut control).unwrap();
    let mut parser = model.parser(&info);
    let mut got = Vec::new();
    let until = Instant::now() + Duration::from_secs(60);
    while got.len() < EVENTS && Instant::now() < until {
        match link
            .receive(transfers.timeout + Duration::from_secs(2))
            .unwrap()
        {
            Received::Bytes { bytes, .. } => parser.parse(bytes, &mut got),
            Received::Nothing => break,
            other => panic!("{other:?}"),
        }
    }
    model.stop(&info, &mut control).unwrap();
    let quiet = transfers.timeout + Duration::from_millis(100);
    let drained = drain(&mut link, quiet, Duration::from_secs(5), |received| {
        if let Received::Bytes { bytes, .. } = received {
            parser.parse(bytes, &mut got);
        }
    });
    assert!(drained.unwrap());
    let losses: Vec<_> = parser.losses().iter().collect();
    assert_eq!(losses, []);
    let expected = events(parser.sensor());
    assert_eq!(got.len(), expected.len());
    let mut pairs = got.iter().zip(&expected);
    assert_eq!(pairs.find(|(got, sent)| got != sent), None, "got and sent");
}
