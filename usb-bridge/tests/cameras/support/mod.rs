//! Runs the `eecvs-usb` binary in a temporary folder, with cameras that are simulated inside of it.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs_nostd::{Event, Polarity, Sensor};
use event_files::EventWriter;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

pub const SENSOR: Sensor = Sensor {
    width: 128,
    height: 128,
};
pub const EVENTS: usize = 20_000;

/// A folder in which commands run; gone with the test.
pub struct Folder(pub tempfile::TempDir);

/// Events of seeded places, from 1 ms on, over about a quarter of a second.
pub fn events() -> Vec<Event> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    let mut t_us = 1000;
    (0..EVENTS)
        .map(|_| {
            let draw = random.next_u64();
            t_us += (draw >> 32) % 26;
            Event {
                t_us,
                x: draw as u16 % SENSOR.width,
                y: (draw >> 16) as u16 % SENSOR.height,
                polarity: Polarity::from_bool(draw >> 63 == 1),
            }
        })
        .collect()
}

impl Folder {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.raw");
        let mut writer: Box<dyn EventWriter> = event_files::create(&path, SENSOR).unwrap();
        writer.write(&events()).unwrap();
        writer.finish().unwrap();
        Self(folder)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs-usb"));
        command.current_dir(&self.0).args(arguments);
        command
    }

    pub fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    pub fn start(&self, arguments: &[&str]) -> Child {
        let mut command = self.command(arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command.spawn().unwrap()
    }

    /// Its JSON, where it succeeds.
    pub fn json(&self, arguments: &[&str]) -> serde_json::Value {
        json(&self.run(arguments))
    }
}

pub fn json(output: &Output) -> serde_json::Value {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// All events of a recording, or of frames, in the order of their times and places.
pub fn read(path: &Path) -> Vec<Event> {
    let mut events = Vec::new();
    if path
        .extension()
        .is_some_and(|extension| extension == "eecvs")
    {
        let mut windows = WindowReader::new(FrameReader::new(std::fs::File::open(path).unwrap()));
        while let Some(window) = windows.next_window().unwrap() {
            events.extend(window.events);
        }
    } else {
        let mut reader = event_files::open(path, None).unwrap();
        while reader.read(&mut events).unwrap() > 0 {}
    }
    sorted(events)
}

pub fn sorted(mut events: Vec<Event>) -> Vec<Event> {
    events.sort_unstable();
    events
}

/// Its events, with the first at the same time as the scene's: a camera's clock begins where it likes.
pub fn shifted(mut events: Vec<Event>) -> Vec<Event> {
    let first = events.first().map_or(0, |event| event.t_us);
    let own = self::events()[0].t_us;
    for event in &mut events {
        event.t_us = event.t_us - first + own;
    }
    events
}

pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

pub const CAMERA: &str = "sim:dvs128:scene.raw";

/// Waits until somebody listens: to try the port itself would be to take it from who is about to.
pub fn listening(port: u16, kind: &str) {
    let until = Instant::now() + Duration::from_secs(20);
    let local = format!(": 0100007F:{port:04X} ");
    while !std::fs::read_to_string(format!("/proc/net/{kind}"))
        .unwrap()
        .contains(&local)
    {
        assert!(Instant::now() < until, "nobody listens");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// The frames of a file without its marks; all of them are there.
pub fn frames(path: &Path) -> Vec<u8> {
    let mut reader = FrameReader::new(std::fs::File::open(path).unwrap());
    let mut frames = Vec::new();
    while let Some(located) = reader.next_frame().unwrap() {
        frames.extend(located.bytes);
    }
    let report = reader.report();
    assert!(
        report.is_clean() && report.segments_ended == 1,
        "{report:?}"
    );
    frames
}
