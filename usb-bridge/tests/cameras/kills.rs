//! What `eecvs-usb` leaves where it is killed or interrupted at any moment: nothing reads as complete that is not,
//! and what was there before stays until something complete takes its place.

use std::process::{Child, Command};
use std::time::Duration;

use crate::support::{CAMERA, EVENTS, Folder, events, free_port, listening, read, shifted, sorted};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// Moments for each command, half of them with SIGKILL.
const ROUNDS: u64 = 6;
/// The scene takes 260 ms, with the end of its stream half a second.
const LONGEST_MS: u64 = 550;

/// Ends a command at a moment of its own, and looks at what it left of its output `name`.
fn end(
    folder: &Folder,
    mut child: Child,
    name: &str,
    random: &mut Xoshiro256PlusPlus,
    is_kill: bool,
) {
    std::thread::sleep(Duration::from_millis(random.next_u64() % LONGEST_MS));
    if is_kill {
        child.kill().unwrap();
    } else {
        let id = child.id().to_string();
        let sent = Command::new("kill").args(["-INT", &id]).output().unwrap();
        assert!(sent.status.success());
    }
    let output = child.wait_with_output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    let path = folder.path(name);
    let bytes = std::fs::read(&path).unwrap();
    let part = folder.path(&format!("incomplete-{name}"));
    if output.status.code().is_none() {
        // Killed, or interrupted before it listens to that.
        let is_old = bytes == b"old";
        assert!(is_old || found(folder, name) == sorted(events()), "{name}");
        return;
    }
    if errors.contains("nothing arrived") {
        assert_eq!(output.status.code(), Some(1), "{name}: {errors}");
        assert!(bytes == b"old" && !part.exists(), "{name}");
        return;
    }
    assert!(output.status.success(), "{name}: {errors}");
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let count = said["events"].as_u64().unwrap() as usize;
    assert!(count <= EVENTS);
    assert!(!part.exists(), "{name}");
    assert_eq!(
        found(folder, name),
        sorted(events()[..count].to_vec()),
        "{name}"
    );
}

/// The events of a complete output, from the time at which the scene begins.
fn found(folder: &Folder, name: &str) -> Vec<eecvs_nostd::Event> {
    if !name.ends_with(".stream") {
        return shifted(read(&folder.path(name)));
    }
    let device = format!("replay:{name}");
    let replay = [
        "capture",
        "--rate",
        "max",
        "--overwrite",
        "-o",
        "replayed.aedat4",
    ];
    let output = folder.run(&[&replay[..], &["--device", &device]].concat());
    assert!(output.status.success(), "{output:?}");
    shifted(read(&folder.path("replayed.aedat4")))
}

/// Runs a command that writes `name`, again and again, each time over an old file.
fn rounds(seed: u64, name: &str, mut start: impl FnMut(&Folder) -> (Child, Option<Child>)) {
    let folder = Folder::new();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    for round in 0..ROUNDS {
        std::fs::write(folder.path(name), "old").unwrap();
        let (child, other) = start(&folder);
        end(&folder, child, name, &mut random, round % 2 == 0);
        if let Some(mut other) = other {
            other.kill().unwrap();
            other.wait().unwrap();
        }
    }
}

#[test]
fn capture() {
    for (seed, name) in ["a.eecvs", "a.aedat4", "a.raw", "a.stream"]
        .iter()
        .enumerate()
    {
        let arguments = [
            "capture",
            "--device",
            CAMERA,
            "--json",
            "--overwrite",
            "-o",
            name,
        ];
        rounds(seed as u64, name, |folder| (folder.start(&arguments), None));
    }
}

#[test]
fn forward() {
    let arguments = [
        "forward",
        "--device",
        CAMERA,
        "--json",
        "--overwrite",
        "--to",
    ];
    let arguments = [&arguments[..], &["file:a.eecvs"]].concat();
    rounds(10, "a.eecvs", |folder| (folder.start(&arguments), None));
}

#[test]
fn receive() {
    for (seed, name) in [(20, "a.eecvs"), (21, "a.aedat4")] {
        rounds(seed, name, |folder| {
            let port = free_port();
            let to = format!("tcp://127.0.0.1:{port}");
            let receive = [
                "receive",
                &to,
                "--once",
                "--json",
                "--overwrite",
                "-o",
                name,
            ];
            let receiver = folder.start(&receive);
            listening(port, "tcp");
            let sender = folder.start(&["forward", "--device", CAMERA, "--to", &to]);
            (receiver, Some(sender))
        });
    }
}
