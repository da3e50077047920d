//! Every model over the real libusb, against a device that libumockdev mocks: found and listed, started,
//! received, stopped, drained, parsed, and every event as it was.

mod umockdev;

use std::process::Command;
use std::time::{Duration, Instant};

use eecvs_nostd::{Event, Polarity, Sensor};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use umockdev::Mocked;
use usb_bridge::device::{Due, MODELS, Model, Stream, find};
use usb_bridge::link::usb::Bus;
use usb_bridge::link::{Link, Received, drain};
use usb_bridge::peripheral::Speed;

const NAME: &str = "every_model_gives_back_every_event";
const MODEL: &str = "EECVS_TEST_MODEL";
const EVENTS: usize = 200_000;

/// Sizes of sensors, one of which each camera has.
const SENSORS: [(u16, u16); 7] = [
    (128, 128),
    (240, 180),
    (346, 260),
    (320, 240),
    (640, 480),
    (1280, 720),
    (320, 320),
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
    if let Ok(name) = std::env::var(MODEL) {
        return receive(find(&name).unwrap());
    }
    for model in MODELS {
        // A device without events of its own, as the encoder's MCU.
        let Some(sensor) = sensor(*model) else {
            continue;
        };
        let mut bytes = Vec::new();
        let mut writer = model.writer(sensor).unwrap();
        writer.write(&events(sensor), &mut bytes).unwrap();
        writer.finish(&mut bytes).unwrap();
        let camera = model.camera(sensor, Box::new(Prepared { bytes, at: 0 }));
        let camera = camera.unwrap();
        let speed = camera.descriptors().speed;
        assert!(!model.needs_super_speed() || speed == Speed::Super);
        let Some(mocked) = Mocked::new(camera) else {
            return;
        };
        listed(*model, &mocked);
        let mut test = mocked.command_for(std::env::current_exe().unwrap());
        let output = test
            .args([NAME, "--exact", "--nocapture"])
            .env(MODEL, model.name())
            .output()
            .unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{}: {told}", model.name());
    }
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
fn receive(model: &dyn Model) {
    let attached = Bus::new().unwrap().find(Some(model.name())).unwrap();
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
    let other = got
        .iter()
        .zip(&expected)
        .position(|(got, sent)| got != sent);
    assert_eq!(other, None);
}
