//! `eecvs-usb capture`, `forward` and `receive` as they are called, with cameras that are simulated inside
//! of the program.

use std::io::Read;
use std::net::TcpListener;
use std::process::Command;
use std::time::{Duration, Instant};

use event_emulator::{Camera, Model, Preset, Readout, SceneConfig, emulate};
use event_files::EventReader;

use crate::support::{
    CAMERA, EVENTS, Folder, SENSOR, events, frames, free_port, json, listening, read, shifted,
    sorted,
};

#[test]
fn every_kind_of_file_has_every_event() {
    let folder = Folder::new();
    for name in ["a.raw", "a.aedat4", "a.eecvs", "a.csv", "a.stream"] {
        let arguments = [
            "capture", "--device", CAMERA, "--rate", "max", "--json", "-o", name,
        ];
        let said = folder.json(&arguments);
        assert_eq!(said["events"], EVENTS, "{name}");
        assert_eq!(said["losses"], serde_json::json!({}), "{name}");
        if name == "a.stream" {
            let replay = [
                "capture",
                "--device",
                "replay:a.stream",
                "--rate",
                "max",
                "--json",
            ];
            let again = folder.json(&[&replay[..], &["-o", "b.raw"]].concat());
            assert_eq!(again["events"], EVENTS);
            assert_eq!(shifted(read(&folder.path("b.raw"))), sorted(events()));
        } else {
            let found = if name == "a.csv" {
                let mut found = Vec::new();
                let mut reader = event_files::open(&folder.path(name), Some(SENSOR)).unwrap();
                while reader.read(&mut found).unwrap() > 0 {}
                sorted(found)
            } else {
                read(&folder.path(name))
            };
            assert_eq!(shifted(found), sorted(events()), "{name}");
        }
    }
}

/// What an emulated sensor's readout gives is what the virtual camera of that name sends.
#[test]
fn an_emulated_readout_feeds_its_virtual_camera() {
    let folder = Folder::new();
    for name in ["davis346", "davis240", "dvs128", "dvxplorer"] {
        let camera = Camera::from_name(name).unwrap();
        let scene = SceneConfig {
            sensor: camera.sensor,
            duration_us: 30_000,
            model: Model::Physical,
            ..SceneConfig::new(Preset::Motorcycle, 1)
        };
        let mut pixels = emulate(scene).unwrap();
        let mut readout = Readout::new(camera.sensor, &camera.readout).unwrap();
        let (mut fired, mut events) = (Vec::new(), Vec::new());
        while pixels.read(&mut fired).unwrap() > 0 {}
        readout.push(&fired, None, &mut events, None);
        readout.finish(&mut events, None);
        assert!(events.len() > 500, "{name}: {} events", events.len());
        let recording = format!("{name}.aedat4");
        let mut writer = event_files::create(&folder.path(&recording), camera.sensor).unwrap();
        writer.write(&events).unwrap();
        writer.finish().unwrap();
        let (device, output) = (format!("sim:{name}:{recording}"), format!("{name}.raw"));
        let said = folder.json(&[
            "capture", "--device", &device, "--rate", "max", "--json", "-o", &output,
        ]);
        assert_eq!(said["events"], events.len(), "{name}");
        let got = read(&folder.path(&output));
        assert_eq!(shifted(got), shifted(sorted(events)), "{name}");
    }
}

#[test]
fn every_model_that_the_scene_fits_gives_it_back() {
    let folder = Folder::new();
    for model in usb_bridge::device::MODELS {
        if model.writer(SENSOR).is_none() || model.identities().is_empty() {
            continue;
        }
        let name = format!("{}.raw", model.name());
        let device = format!("sim:{}:scene.raw", model.name());
        let arguments = [
            "capture", "--device", &device, "--rate", "max", "--json", "-o", &name,
        ];
        let said = folder.json(&arguments);
        assert_eq!(said["events"], EVENTS, "{name}: {said}");
        assert_eq!(
            shifted(read(&folder.path(&name))),
            sorted(events()),
            "{name}"
        );
    }
}

/// The frames of an encoder: as they are where it is set up, and what its events are either way.
#[test]
fn an_encoder_is_set_up_or_left_as_it_runs() {
    let folder = Folder::new();
    let device = "sim:eecvs:scene.raw";
    let capture = ["capture", "--device", device, "--rate", "max", "--json"];
    for (name, more) in [
        ("a.eecvs", &[][..]),
        ("b.aedat4", &[]),
        ("c.eecvs", &["--set-up", "128x128"]),
        ("d.raw", &["--set-up", "128x128"]),
    ] {
        let said = folder.json(&[&capture[..], &["-o", name], more].concat());
        assert_eq!(said["events"], EVENTS, "{name}: {said}");
        assert_eq!(said["losses"], serde_json::json!({}), "{name}");
        let is_encoded = said.get("encoding").is_some();
        assert_eq!(is_encoded, name == "a.eecvs", "{name}");
        // Its clock is the recording's.
        assert_eq!(read(&folder.path(name)), sorted(events()), "{name}");
    }
    let to = format!("file:{}", folder.path("e.eecvs").display());
    let forward = ["forward", "--device", device, "--rate", "max", "--json"];
    folder.json(&[&forward[..], &["--set-up", "128x128", "--to", &to]].concat());
    let kept = |name: &str| std::fs::read(folder.path(name)).unwrap();
    assert_eq!(kept("e.eecvs"), kept("c.eecvs"));
}

#[test]
fn ctrl_c_and_limits_leave_a_whole_file() {
    let folder = Folder::new();
    // Slowly: the scene takes minutes.
    let slow = ["capture", "--device", CAMERA, "--rate", "0.002x", "--json"];
    for name in ["a.aedat4", "a.eecvs", "a.raw"] {
        let child = folder.start(&[&slow[..], &["-o", name]].concat());
        let until = Instant::now() + Duration::from_secs(30);
        // Its name is the file's own when it is complete.
        let growing = folder.path(&format!("incomplete-{name}"));
        while !growing.exists() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(10));
        }
        std::thread::sleep(Duration::from_millis(700));
        let id = child.id().to_string();
        assert!(
            Command::new("kill")
                .args(["-INT", &id])
                .status()
                .unwrap()
                .success()
        );
        let said = json(&child.wait_with_output().unwrap());
        let written = said["events"].as_u64().unwrap() as usize;
        assert!((1..EVENTS).contains(&written), "{said}");
        let found = shifted(read(&folder.path(name)));
        assert_eq!(found, sorted(events()[..written].to_vec()), "{name}");
    }
    let started = Instant::now();
    let arguments = [&slow[..], &["-o", "b.raw", "--duration-s", "0.4"]].concat();
    folder.json(&arguments);
    assert!(started.elapsed() < Duration::from_secs(10));
    let some = [
        "capture", "--device", CAMERA, "--rate", "max", "--events", "100", "-o", "c.raw",
    ];
    assert!(folder.run(&some).status.success());
    assert!(read(&folder.path("c.raw")).len() >= 100);
}

/// A disk that is full is a limit of the file's size here, which ends writes in the same way.
#[test]
fn a_full_disk_is_one_line_and_the_file_can_be_read() {
    let folder = Folder::new();
    // In blocks of 512 bytes: an AEDAT 4 has packets of 16,384 events, of which one fits.
    for (name, blocks) in [
        ("a.raw", 24),
        ("a.aedat4", 290),
        ("a.eecvs", 24),
        ("a.stream", 24),
    ] {
        let limited = format!(
            "trap '' XFSZ; ulimit -f {blocks}; exec {} capture --device {CAMERA} --rate max -o {name}",
            env!("CARGO_BIN_EXE_eecvs-usb")
        );
        let output = Command::new("sh")
            .current_dir(&folder.0)
            .args(["-c", &limited])
            .output()
            .unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(text.contains(name), "{text}");
        // A capture that failed is marked by its name.
        assert!(!folder.path(name).exists());
        let path = folder.path(&format!("incomplete-{name}"));
        let found = match name {
            "a.stream" => {
                let device = "replay:incomplete-a.stream";
                let replay = ["capture", "--device", device, "--rate", "max"];
                let output = folder.run(&[&replay[..], &["-o", "b.raw", "--overwrite"]].concat());
                assert!(output.status.success());
                read(&folder.path("b.raw"))
            }
            "a.eecvs" => read(&path),
            _ => {
                let mut found = Vec::new();
                let mut reader = event_files::open(&path, None).unwrap();
                // What is cut is told, after the events before it.
                while matches!(reader.read(&mut found), Ok(read) if read > 0) {}
                sorted(found)
            }
        };
        let written = found.len();
        assert!((1000..EVENTS).contains(&written), "{name}: {written}");
        assert!(path.metadata().unwrap().len() <= 512 * blocks);
        if name != "a.eecvs" {
            assert_eq!(
                shifted(found),
                sorted(events()[..written].to_vec()),
                "{name}"
            );
        }
    }
}

#[test]
fn what_cannot_be_is_one_line_and_exit_status_1() {
    let folder = Folder::new();
    let refused = |arguments: &[&str], what: &str| {
        let output = folder.run(arguments);
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(
            text.starts_with("eecvs-usb: ") && text.contains(what),
            "{text}"
        );
    };
    refused(
        &["capture", "-o", "a.raw", "--device", "usb:250-1"],
        "usb:250-1",
    );
    refused(&["capture", "-o", "a.npz", "--device", CAMERA], "a.npz");
    refused(
        &["capture", "-o", "none/a.raw", "--device", CAMERA],
        "none/a.raw",
    );
    refused(
        &["capture", "-o", "a.raw", "--device", "sim:dvs128:none.raw"],
        "none.raw",
    );
    refused(
        &["capture", "-o", "a.raw", "--device", "replay:scene.raw"],
        "scene.raw",
    );
    refused(
        &["capture", "-o", "scene.raw", "--device", CAMERA],
        "scene.raw",
    );
    refused(
        &["capture", "-o", "a.raw", "--device", "serial:/dev/none"],
        "/dev/none",
    );
    let encoder = "sim:eecvs:scene.raw";
    let set_up = ["capture", "-o", "a.eecvs", "--device"];
    refused(
        &[&set_up[..], &[CAMERA, "--set-up", "128x128"]].concat(),
        "simulated dvs128: is a DVS128, not an encoder",
    );
    refused(
        &[&set_up[..], &[encoder, "--set-up", "128x64"]].concat(),
        "refuses the setup for 128 x 64 pixels: a side of the sensor",
    );
    let dense = ["--set-up", "128x128", "--coder", "dense"];
    refused(
        &[&set_up[..], &[encoder], &dense].concat(),
        "it has no such mode",
    );
    refused(&["mcu", "--device", encoder], "devices take no events");
    refused(&["mcu", "--device", "serial:/dev/none"], "/dev/none");
    refused(
        &["receive", "tcp://192.0.2.1:9", "-o", "a.eecvs"],
        "192.0.2.1:9",
    );
    let usage = |arguments: &[&str]| folder.run(arguments).status.code();
    assert_eq!(usage(&["capture", "--device", CAMERA]), Some(2));
    assert_eq!(
        usage(&["capture", "-o", "a.raw", "--device", "sim:nothing:a"]),
        Some(2)
    );
    assert_eq!(usage(&["forward", "--to", "http://a:1"]), Some(2));
    for size in ["128", "0x4", "4096x4"] {
        let arguments = [&set_up[..], &[encoder, "--set-up", size]].concat();
        assert_eq!(usage(&arguments), Some(2), "{size}");
    }
    assert!(!folder.path("a.npz").exists());
}

#[test]
fn frames_and_raw_packets_arrive_whole() {
    let folder = Folder::new();
    for (kind, what, name) in [
        ("tcp", "frames", "a.eecvs"),
        ("tcp", "raw", "a.raw"),
        ("tcp", "frames", "b.raw"),
        ("udp", "raw", "c.raw"),
    ] {
        let port = free_port();
        let to = format!("{kind}://127.0.0.1:{port}");
        let count = EVENTS.to_string();
        let receiver = folder.start(&[
            "receive",
            &to,
            "-o",
            name,
            "--events",
            &count,
            "--duration-s",
            "20",
            "--json",
        ]);
        listening(port, kind);
        // Datagrams have no way to hold a sender up: it is not to be faster than a camera.
        let rate = if kind == "udp" { "real" } else { "max" };
        let sent = folder.json(&[
            "forward", "--device", CAMERA, "--rate", rate, "--as", what, "--to", &to, "--json",
        ]);
        let received = json(&receiver.wait_with_output().unwrap());
        assert_eq!(sent["consumers"][0]["sent"]["events"], EVENTS, "{sent}");
        assert_eq!(received["events"], EVENTS, "{kind} {what}: {received}");
        assert_eq!(received["lost_messages"], 0);
        assert_eq!(
            shifted(read(&folder.path(name))),
            sorted(events()),
            "{kind} {what}"
        );
    }
}

#[test]
fn a_consumer_that_takes_nothing_is_reported_and_the_file_is_whole() {
    let folder = Folder::new();
    let stuck = TcpListener::bind("127.0.0.1:0").unwrap();
    let to = format!("tcp://{}", stuck.local_addr().unwrap());
    // Not even its own queue has room for a frame of this scene.
    let output = folder.run(&[
        "forward",
        "--device",
        CAMERA,
        "--rate",
        "max",
        "--to",
        &to,
        "--to",
        "file:a.eecvs",
        "--to",
        "-",
        "--json",
    ]);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(shifted(read(&folder.path("a.eecvs"))), sorted(events()));
    // Standard output has the same frames, and nothing else; what is said of them is on stderr.
    let said: serde_json::Value = serde_json::from_slice(&output.stderr).unwrap();
    assert_eq!(said["consumers"][2]["sent"]["events"], EVENTS, "{said}");
    assert_eq!(output.stdout, frames(&folder.path("a.eecvs")));
    let (mut stream, _) = stuck.accept().unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    // The system's own buffers took all there was to take, and the end is in order.
    assert_eq!(bytes, output.stdout);
}
