//! `eecvs-usb simulate --run`: a program on this machine that sees the camera.

use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use usb_bridge::device::MODELS;

use crate::models::{scene, sensor};
use crate::umockdev::Mocked;

const PROGRAM: &str = env!("CARGO_BIN_EXE_eecvs-usb");

fn command(folder: &Path, model: &str, size: (u16, u16), rest: &[&str]) -> Command {
    let (width, height) = (size.0.to_string(), size.1.to_string());
    let mut command = Command::new(PROGRAM);
    command
        .current_dir(folder)
        .args([
            "simulate",
            model,
            "scene.csv",
            "--width",
            &width,
            "--height",
            &height,
        ])
        .args(rest);
    command
}

fn simulate(folder: &Path, model: &str, size: (u16, u16), rest: &[&str]) -> Output {
    command(folder, model, size, rest).output().unwrap()
}

/// Rows of a file of events, sorted: frames have an order of their own.
fn rows(path: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut rows: Vec<String> = text.lines().skip(1).map(str::to_owned).collect();
    rows.sort();
    rows
}

fn has_library() -> bool {
    Mocked::new(crate::counter::Counter::boxed()).is_some()
}

#[test]
fn a_program_sees_each_camera_and_gets_every_event() {
    if !has_library() {
        return;
    }
    for model in MODELS
        .iter()
        .filter(|model| model.writer(sensor_of(**model)).is_some())
    {
        // Only to simulate, and recognised as others.
        if model.identities().is_empty() || model.name() == "eecvs" {
            continue;
        }
        let folder = tempfile::tempdir().unwrap();
        let sensor = sensor_of(*model);
        let mut text = "t,x,y,p\n".to_owned();
        for event in &scene(sensor)[..2000] {
            let on = u8::from(event.polarity == eecvs_nostd::Polarity::On);
            text += &format!("{},{},{},{on}\n", event.t_us, event.x, event.y);
        }
        std::fs::write(folder.path().join("scene.csv"), text).unwrap();
        let size = (sensor.width, sensor.height);
        let run = [
            "--rate", "max", "--run", PROGRAM, "capture", "-o", "out.csv", "--events", "2000",
        ];
        let output = simulate(folder.path(), model.name(), size, &run);
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{}: {told}", model.name());
        assert!(told.contains("2000 events"), "{told}");
        let got = rows(&folder.path().join("out.csv"));
        assert_eq!(
            got,
            rows(&folder.path().join("scene.csv")),
            "{}",
            model.name()
        );
    }
}

fn sensor_of(model: &dyn usb_bridge::device::Model) -> eecvs_nostd::Sensor {
    sensor(model).unwrap_or(eecvs_nostd::Sensor {
        width: 1,
        height: 1,
    })
}

#[test]
fn it_ends_as_the_program_does() {
    if !has_library() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.csv"), "t,x,y,p\n100,1,2,1\n").unwrap();
    let run = |program: &[&str]| simulate(folder.path(), "dvs128", (128, 128), program);
    assert_eq!(run(&["--run", "sh", "-c", "exit 7"]).status.code(), Some(7));
    let killed = run(&["--run", "sh", "-c", "kill -9 $$"]);
    assert_eq!(killed.status.code(), Some(128 + 9));
    let output = run(&["--run", "no-such-program"]);
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        told.contains("no-such-program: cannot run this program"),
        "{told}"
    );
    let left = |name: &std::ffi::OsStr| name.to_string_lossy().starts_with("eecvs-usb.");
    let temporary = tempfile::tempdir().unwrap();
    let output = command(
        folder.path(),
        "dvs128",
        (128, 128),
        &["--run", "sh", "-c", "exit 3"],
    )
    .env("TMPDIR", temporary.path())
    .output()
    .unwrap();
    assert_eq!(output.status.code(), Some(3));
    let mut entries = std::fs::read_dir(temporary.path()).unwrap();
    assert!(!entries.any(|entry| left(&entry.unwrap().file_name())));
}

/// A signal that reaches only this command reaches the program through it, which may end in order.
#[test]
fn a_signal_is_passed_on() {
    if !has_library() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.csv"), "t,x,y,p\n100,1,2,1\n").unwrap();
    let script =
        "trap 'echo in order > ended; exit 5' TERM; echo > begun; while :; do sleep 0.05; done";
    let mut child = command(
        folder.path(),
        "dvs128",
        (128, 128),
        &["--run", "sh", "-c", script],
    )
    .spawn()
    .unwrap();
    let until = Instant::now() + Duration::from_secs(20);
    while !folder.path().join("begun").exists() {
        assert!(Instant::now() < until);
        std::thread::sleep(Duration::from_millis(10));
    }
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-TERM", &id]).status().unwrap();
    assert!(sent.success());
    assert_eq!(child.wait().unwrap().code(), Some(5));
    assert!(folder.path().join("ended").exists());
}
