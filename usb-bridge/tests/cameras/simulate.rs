//! `eecvs-usb simulate` as it is called: what it says without a host, and what it refuses.

use std::path::PathBuf;
use std::process::{Command, Output};

/// Six events on 128 x 128 pixels, from 100 us on.
const EVENTS: &str =
    "t,x,y,p\n100,0,0,1\n110,127,5,0\n110,3,5,1\n900,9,9,0\n40000,1,2,1\n50000,1,2,0\n";

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("six.csv"), EVENTS).unwrap();
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_eecvs-usb"))
            .current_dir(&self.0)
            .args(["simulate", "dvs128"])
            .args(arguments)
            .output()
            .unwrap()
    }
}

const SIZE: [&str; 4] = ["--width", "128", "--height", "128"];

#[test]
fn without_a_host_it_says_what_the_camera_would_send() {
    let folder = Folder::new();
    for (rate, seconds) in [("max", 0.0..0.05), ("real", 0.049..5.0), ("100", 0.05..5.0)] {
        let arguments = [&["six.csv", "--json", "--rate", rate], &SIZE[..]].concat();
        let output = folder.run(&arguments);
        assert!(output.status.success(), "{output:?}");
        let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((&said["events"], &said["rounds"]), (&6.into(), &1.into()));
        assert_eq!(
            (&said["first_us"], &said["first_device_us"]),
            (&100.into(), &100.into())
        );
        assert!(said["bytes"].as_u64().unwrap() >= 24, "{said}");
        let found = said["seconds"].as_f64().unwrap();
        assert!(seconds.contains(&found), "{rate}: {found} s");
    }
    let start = [&["six.csv", "--rate", "max", "--start-us", "7"], &SIZE[..]].concat();
    let text = String::from_utf8(folder.run(&start).stdout).unwrap();
    assert!(text.contains("first_device_us  7\n"), "{text}");
}

#[test]
fn what_cannot_be_simulated_is_one_line_and_exit_status_1() {
    let folder = Folder::new();
    let refused = |arguments: &[&str], what: &str| {
        let output = folder.run(arguments);
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(
            text.starts_with("eecvs-usb: ") && text.contains(what),
            "{text}"
        );
    };
    refused(&["none.csv"], "none.csv");
    refused(&["six.csv", "--width", "346", "--height", "260"], "346x260");
    let serve = |flag, address| [&["six.csv", flag, address], &SIZE[..]].concat();
    refused(&serve("--usbip", "192.0.2.1:1"), "192.0.2.1:1");
    // A file that is no socket stays as it is.
    let path = folder.path("six.csv");
    refused(&serve("--usbredir", path.to_str().unwrap()), "six.csv");
    assert_eq!(std::fs::read_to_string(path).unwrap(), EVENTS);
}

#[test]
fn bad_usage_exits_with_2() {
    let folder = Folder::new();
    for arguments in [
        &["six.csv", "--rate", "fast"][..],
        &["six.csv", "--rate", "0"],
        &["six.csv", "--usbip", "localhost:0", "--usbredir", "a"],
        &[],
    ] {
        assert_eq!(
            folder.run(arguments).status.code(),
            Some(2),
            "{arguments:?}"
        );
    }
    let unknown = Command::new(env!("CARGO_BIN_EXE_eecvs-usb"))
        .args(["simulate", "dvs1", "six.csv"])
        .output()
        .unwrap();
    assert_eq!(unknown.status.code(), Some(2));
    assert!(
        String::from_utf8(unknown.stderr)
            .unwrap()
            .contains("dvs128")
    );
}
