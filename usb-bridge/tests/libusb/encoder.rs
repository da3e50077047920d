//! `eecvs-usb mcu` over the real libusb, against the microcontroller's own class and encoder, which
//! libumockdev mocks.

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs_nostd::{Event, Polarity, Sensor};

use crate::application;
use crate::umockdev::Mocked;

#[test]
fn a_recording_returns_and_a_refusal_is_one_line() {
    let Some(mocked) = Mocked::new(Box::new(application::Encoder::new().on_a_bus())) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut writer = event_files::create(&path("scene.csv"), Sensor::new(70, 40).unwrap()).unwrap();
    writer.write(&events()).unwrap();
    writer.finish().unwrap();
    for coder in ["fast", "dense"] {
        let mut command = mocked.command_for(env!("CARGO_BIN_EXE_eecvs-usb"));
        command.current_dir(folder.path());
        command.args(["mcu", "scene.csv", "--width", "70", "--height", "40"]);
        command.args(["--window-us", "5000", "--coder", coder]);
        let output = command
            .args(["--json", "-o", "out.eecvs", "--overwrite"])
            .output()
            .unwrap();
        assert!(output.status.success(), "{output:?}");
        let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(said["events"], EVENTS, "{said}");
        assert_eq!(
            (&said["frames_different"], &said["events_lost"]),
            (&0.into(), &0.into())
        );
        let mut windows = WindowReader::new(FrameReader::new(
            std::fs::File::open(path("out.eecvs")).unwrap(),
        ));
        let mut found = Vec::new();
        while let Some(window) = windows.next_window().unwrap() {
            found.extend(window.events);
        }
        found.sort_unstable();
        let mut sent = events();
        sent.sort_unstable();
        assert!(found == sent, "{coder}");
    }
    let mut command = mocked.command_for(env!("CARGO_BIN_EXE_eecvs-usb"));
    command.current_dir(folder.path());
    command.args(["mcu", "scene.csv", "--width", "2048", "--height", "2048"]);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(
        text.contains("refuses the setup for 2048 x 2048 pixels"),
        "{text}"
    );
}

const EVENTS: u64 = 3000;

fn events() -> Vec<Event> {
    let place = |at: u64, below: u64| (at.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) % below;
    let event = |at: u64| Event {
        t_us: 1000 + at * 7,
        x: place(at, 70) as u16,
        y: place(at + 1, 40) as u16,
        polarity: Polarity::from_bool(place(at, 2) == 1),
    };
    (0..EVENTS).map(event).collect()
}
