//! Every model: found and listed, started, received, stopped, drained, parsed, and every event as it was;
//! of an emulated scene and of the shared recordings, cut or whole.

use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use eecvs_nostd::{Event, Polarity, Sensor};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde_json::Value;
use usb_bridge::device::{Due, MODELS, Model, Stream, find, recognise};
use usb_bridge::link::usb::Bus;
use usb_bridge::link::{Link, Received, drain};
use usb_bridge::peripheral::stream::{Pace, Recording as Played};
use usb_bridge::peripheral::{Peripheral, Speed};

use crate::recordings::{self, Recording, cross_2_31_us, keeps_order};
use crate::umockdev::{Mocked, under_umockdev};

const EVENTS: usize = 60_000;
/// Of each recording, where it is cut.
const CUT: usize = 6000;
/// Between two recordings: several wraps of every clock but those of 34 bits.
const PAUSE_US: u64 = 20_000_000;

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
pub struct Prepared {
    bytes: Vec<u8>,
    at: usize,
}

impl Prepared {
    /// What a model sends of these events.
    pub fn boxed(model: &dyn Model, sensor: Sensor, events: &[Event]) -> Box<Self> {
        let mut bytes = Vec::new();
        let mut writer = model.writer(sensor).unwrap();
        writer.write(events, &mut bytes).unwrap();
        writer.finish(&mut bytes).unwrap();
        Box::new(Self { bytes, at: 0 })
    }
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

pub fn model(name: &str) -> &'static dyn Model {
    find(name).unwrap()
}

/// Its own; a device without events of its own has none.
pub fn sensor(model: &dyn Model) -> Option<Sensor> {
    let mut sensors = SENSORS.iter().filter_map(|&(w, h)| Sensor::new(w, h));
    sensors.find(|&sensor| model.writer(sensor).is_some())
}

/// Events of seeded places, most of them some microseconds apart, some after a pause.
pub fn scene(sensor: Sensor) -> Vec<Event> {
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

/// The shared recordings that a model can send; none, and a line that says so, where they are absent.
fn recordings_of(model: &dyn Model) -> Vec<Recording> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    if !data.join("REFERENCE.json").exists() {
        eprintln!("skipped: recordings: {} is absent", data.display());
        return Vec::new();
    }
    let mut all = recordings::all(&data, &|_| true).unwrap();
    all.retain(|one| model.writer(one.sensor).is_some());
    all
}

/// The beginning of every recording that a model can send, one after the other, across 2^31 us.
fn cuts(model: &dyn Model) -> Vec<Event> {
    let mut all: Vec<Event> = Vec::new();
    for recording in recordings_of(model) {
        let events = recording.events(CUT).unwrap();
        let first_us = events[0].t_us;
        let start_us = all.last().map_or(0, |latest| latest.t_us + PAUSE_US);
        all.extend(events.into_iter().map(|event| Event {
            t_us: event.t_us - first_us + start_us,
            ..event
        }));
    }
    cross_2_31_us(&mut all);
    all
}

/// Whether these are the events that were sent, in their order where the model keeps that.
fn assert_same(model: &dyn Model, mut got: Vec<Event>, mut sent: Vec<Event>, what: &str) {
    let name = model.name();
    assert_eq!(got.len(), sent.len(), "{name}: {what}");
    if !keeps_order(name) {
        assert!(got.is_sorted_by_key(|event| event.t_us), "{name}: {what}");
        got.sort_unstable();
        sent.sort_unstable();
    }
    let mut pairs = got.iter().zip(&sent);
    let differs = pairs.find(|(got, sent)| got != sent);
    assert_eq!(differs, None, "{name}: {what}: got and sent");
}

/// Most of the time is the devices' own waiting.
fn for_every_model(test: fn(&dyn Model, Sensor)) {
    thread::scope(|scope| {
        for model in MODELS {
            if let Some(sensor) = sensor(*model) {
                scope.spawn(move || test(*model, sensor));
            }
        }
    });
}

#[test]
fn every_model_gives_back_every_event() {
    if under_umockdev() {
        return receive();
    }
    for_every_model(|model, sensor| {
        let stream = Prepared::boxed(model, sensor, &scene(sensor));
        let camera = model.camera(sensor, stream).unwrap();
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
        mocked.run_test("models::every_model_gives_back_every_event");
    });
}

#[test]
fn capture_has_every_event() {
    for_every_model(|model, sensor| {
        let mut events = cuts(model);
        if events.is_empty() {
            events = scene(sensor);
            cross_2_31_us(&mut events);
        }
        let stream = Prepared::boxed(model, sensor, &events);
        let camera = model.camera(sensor, stream).unwrap();
        let Some((got, said)) = captured(camera, events.len()) else {
            return;
        };
        assert_same(model, got, events, "cuts of the recordings");
        // A word may stand for many wraps of 2^15 us: 2^31 us are 2^16 of them. Those of a pause come one by one.
        if ["davis240", "davis346", "dvxplorer"].contains(&model.name()) {
            let wraps = said["words"]["wraps"].as_u64().unwrap_or(0);
            assert!((16..16_384).contains(&wraps), "{said}");
        }
    });
}

#[test]
fn transfers_are_taken_back_when_they_are_asked_to_be() {
    let model = model("dvs128");
    let sensor = sensor(model).unwrap();
    for (wanted, most) in [("0", 0), ("20", usize::MAX)] {
        // All that it sends is there at once: the rest of the time is a pause.
        let stream = Prepared::boxed(model, sensor, &scene(sensor));
        let Some(mocked) = Mocked::new(model.camera(sensor, stream).unwrap()) else {
            return;
        };
        let folder = tempfile::tempdir().unwrap();
        let mut command = mocked.command_for(env!("CARGO_BIN_EXE_eecvs-usb"));
        command.current_dir(folder.path());
        command.args(["capture", "-o", "a.raw", "--duration-s", "0.6"]);
        let output = command.args(["--hand-over-ms", wanted]).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        // The last ones are when the stream ends.
        let paused = mocked.with_usbfs(|usbfs| usbfs.discarded) - model.transfers().count;
        assert!(
            (0..=most).contains(&paused) && (paused > 0) == (most > 0),
            "{paused}"
        );
    }
}

/// `./test.sh usb-recordings` runs it.
#[test]
#[ignore = "minutes"]
fn capture_has_every_event_of_every_recording() {
    for_every_model(|model, _| {
        for recording in recordings_of(model) {
            let Recording { name, sensor, path } = recording;
            let writer = model.writer(sensor).unwrap();
            let mut events = Vec::new();
            let mut reader = event_files::open(&path, Some(sensor)).unwrap();
            while reader.read(&mut events).unwrap() > 0 {}
            let start_us = cross_2_31_us(&mut events);
            // As `eecvs-usb simulate --rate max --start-us` sends it.
            let open = Box::new(move || Ok(event_files::open(&path, Some(sensor))?));
            let played = Played::new(open, writer, Pace::Max, Some(start_us));
            let camera = model.camera(sensor, Box::new(played)).unwrap();
            let started = Instant::now();
            let count = events.len();
            if let Some((got, _)) = captured(camera, count) {
                assert_same(model, got, events, &name);
                let (model, seconds) = (model.name(), started.elapsed().as_secs_f64());
                println!("ok: {model}, {name}: {count} events, {seconds:.1} s");
            }
        }
    });
}

/// What `eecvs-usb capture` writes, and says, of a camera that sends so many events.
fn captured(camera: Box<dyn Peripheral>, events: usize) -> Option<(Vec<Event>, Value)> {
    let mocked = Mocked::new(camera)?;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("captured.aedat4");
    let mut command = mocked.command_for(env!("CARGO_BIN_EXE_eecvs-usb"));
    command.args(["capture", "--json", "--duration-s", "120", "--events"]);
    command.arg(events.to_string()).arg("-o").arg(&path);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let said: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["losses"], serde_json::json!({}), "{said}");
    let mut reader = event_files::open(&path, None).unwrap();
    let mut got = Vec::new();
    while reader.read(&mut got).unwrap() > 0 {}
    Some((got, said))
}

/// `eecvs-usb list` names it, free, with its firmware.
fn listed(model: &dyn Model, mocked: &Mocked) {
    let mut command: Command = mocked.command_for(env!("CARGO_BIN_EXE_eecvs-usb"));
    let output = command.args(["list", "--json"]).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let rows: Value = serde_json::from_slice(&output.stdout).unwrap();
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
    let sent = scene(parser.sensor());
    assert_same(model, got, sent, "a scene");
}
