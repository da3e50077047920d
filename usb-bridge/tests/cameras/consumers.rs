//! `eecvs-usb forward` and `receive` where datagrams are lost, consumers are away and pipes are closed.

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::process::Stdio;
use std::time::{Duration, Instant};

use eecvs_nostd::Sensor;
use usb_bridge::forward::packet::Packet;

use crate::support::{
    CAMERA, EVENTS, Folder, SENSOR, events, free_port, json, listening, read, shifted, sorted,
};

/// A datagram with a part of a message.
struct Datagram {
    bytes: Vec<u8>,
    message: u32,
    begins: bool,
}

/// All datagrams of a stream of frames, those of its end at last.
fn datagrams(folder: &Folder, more: &[&str]) -> (Vec<Datagram>, Vec<Vec<u8>>) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket
        .set_read_timeout(Some(Duration::from_secs(30)))
        .unwrap();
    let to = format!("udp://{}", socket.local_addr().unwrap());
    let forward = ["forward", "--device", CAMERA, "--to", &to, "--json"];
    let child = folder.start(&[&forward[..], more].concat());
    let (mut parts, mut ends) = (Vec::new(), Vec::new());
    while ends.len() < 3 {
        let mut bytes = vec![0; 2000];
        let length = socket.recv(&mut bytes).unwrap();
        bytes.truncate(length);
        let number = u32::from_le_bytes(bytes[8..12].try_into().unwrap());
        assert_eq!(number as usize, parts.len());
        if bytes[3] & 2 != 0 {
            ends.push(bytes);
            continue;
        }
        parts.push(Datagram {
            message: u32::from_le_bytes(bytes[12..16].try_into().unwrap()),
            begins: bytes[3] & 1 != 0,
            bytes,
        });
    }
    json(&child.wait_with_output().unwrap());
    (parts, ends)
}

#[test]
fn what_datagrams_lose_is_counted_to_the_datagram_and_the_message() {
    let folder = Folder::new();
    let (parts, ends) = datagrams(&folder, &[]);
    let messages = parts.last().unwrap().message + 1;
    let begins: Vec<usize> = (0..parts.len()).filter(|at| parts[*at].begins).collect();
    assert!(messages >= 5 && begins[2] + 2 < begins[3], "{begins:?}");
    let last = parts.len() - 1;
    let long = begins[2];
    // What is dropped, and how many datagrams of the end come.
    let scenarios: [(&str, Vec<usize>, usize); 9] = [
        ("nothing", vec![], 3),
        ("the first of all", vec![0], 3),
        ("the first message", (0..begins[1]).collect(), 1),
        ("the start of a message", vec![long], 1),
        ("the middle of a message", vec![long + 1], 1),
        ("the end of a message", vec![begins[3] - 1], 3),
        (
            "the end of one and the start of the next",
            vec![begins[3] - 1, begins[3]],
            3,
        ),
        ("the last of all", vec![last], 1),
        (
            "the last messages, and ends",
            (begins[begins.len() - 2]..=last).collect(),
            1,
        ),
    ];
    for (i, (what, dropped, ends_come)) in scenarios.iter().enumerate() {
        let lost: BTreeSet<u32> = dropped.iter().map(|at| parts[*at].message).collect();
        let name = format!("{i}.eecvs");
        let port = free_port();
        let from = format!("udp://127.0.0.1:{port}");
        let receiver = folder.start(&["receive", &from, "-o", &name, "--once", "--json"]);
        listening(port, "udp");
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        for (at, datagram) in parts.iter().enumerate() {
            if !dropped.contains(&at) {
                socket
                    .send_to(&datagram.bytes, ("127.0.0.1", port))
                    .unwrap();
            }
        }
        for end in &ends[..*ends_come] {
            socket.send_to(end, ("127.0.0.1", port)).unwrap();
        }
        let output = receiver.wait_with_output().unwrap();
        let errors = String::from_utf8(output.stderr).unwrap();
        let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(said["lost_datagrams"], dropped.len(), "{what}: {said}");
        assert_eq!(said["lost_messages"], lost.len(), "{what}: {said}");
        let left = messages as usize - lost.len();
        assert_eq!(said["messages"], left, "{what}: {said}");
        assert_eq!(said["late_datagrams"], 0, "{what}: {said}");
        let is_whole = dropped.is_empty();
        assert_eq!(output.status.code(), Some(i32::from(!is_whole)), "{errors}");
        assert_eq!(errors.is_empty(), is_whole, "{errors}");
        if !is_whole {
            let datagrams = format!("datagrams lost: {}", dropped.len());
            let messages = format!("messages lost: {}", lost.len());
            assert!(
                errors.contains(&datagrams) && errors.contains(&messages),
                "{errors}"
            );
        }
        // Complete as received, under its own name.
        let found = read(&folder.path(&name)).len();
        assert_eq!(said["events"], found, "{what}");
        assert_eq!(found == EVENTS, is_whole, "{what}");
        assert!(!folder.path(&format!("incomplete-{name}")).exists());
    }
}

/// Without the datagram of the end, what came last is all that is known; datagrams of another stream are a
/// sender of their own.
#[test]
fn a_sender_that_was_killed_and_the_next_one_are_told_apart() {
    let folder = Folder::new();
    let (first, _) = datagrams(&folder, &[]);
    let (second, ends) = datagrams(&folder, &[]);
    let port = free_port();
    let from = format!("udp://127.0.0.1:{port}");
    let receiver = folder.start(&["receive", &from, "-o", "a.eecvs", "--once", "--json"]);
    listening(port, "udp");
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let cut = first.iter().position(|part| part.message == 3).unwrap() + 1;
    for part in &first[..cut] {
        socket.send_to(&part.bytes, ("127.0.0.1", port)).unwrap();
    }
    // Another one does not get in between.
    socket
        .send_to(&second[0].bytes, ("127.0.0.1", port))
        .unwrap();
    std::thread::sleep(Duration::from_millis(1200));
    for datagram in second.iter().map(|part| &part.bytes).chain(&ends) {
        socket.send_to(datagram, ("127.0.0.1", port)).unwrap();
    }
    let output = receiver.wait_with_output().unwrap();
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert_eq!(said["senders"], 2, "{said}");
    assert_eq!(said["alien_datagrams"], 1, "{said}");
    assert_eq!(said["late_datagrams"], 0, "{said}");
    assert_eq!(said["lost_messages"], 1, "{said}");
    assert_eq!(said["lost_datagrams"], 0, "{said}");
    let messages = second.last().unwrap().message + 1;
    assert_eq!(said["messages"], 3 + messages, "{said}");
}

#[test]
fn what_is_coming_when_the_end_is_wished_for_is_not_lost() {
    let folder = Folder::new();
    let (parts, _) = datagrams(&folder, &[]);
    let port = free_port();
    let from = format!("udp://127.0.0.1:{port}");
    let receiver = folder.start(&[
        "receive",
        &from,
        "-o",
        "a.eecvs",
        "--duration-s",
        "1.5",
        "--json",
    ]);
    listening(port, "udp");
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let cut = parts.iter().position(|part| part.message == 3).unwrap() + 1;
    for part in &parts[..cut] {
        socket.send_to(&part.bytes, ("127.0.0.1", port)).unwrap();
    }
    let said = json(&receiver.wait_with_output().unwrap());
    assert_eq!(
        (&said["messages"], &said["lost_messages"]),
        (&3.into(), &0.into()),
        "{said}"
    );
    assert!(said["unfinished_bytes"].as_u64().unwrap() > 0, "{said}");
    assert_eq!(said["damaged_bytes"], 0, "{said}");
}

/// Packets that no file can hold are counted and skipped, and their sender holds nobody up.
#[test]
fn a_receiver_skips_what_its_file_cannot_hold() {
    let folder = Folder::new();
    let port = free_port();
    let to = format!("tcp://127.0.0.1:{port}");
    let receiver = folder.start(&["receive", &to, "-o", "a.aedat4", "--once", "--json"]);
    listening(port, "tcp");
    let mut strange = TcpStream::connect(("127.0.0.1", port)).unwrap();
    for sequence in 0..3 {
        let mut bytes = Vec::new();
        Packet {
            encoding: "\x1b[31m/new",
            sensor: Sensor::new(4, 4).unwrap(),
            sequence,
            time_base_us: None,
            after_loss: false,
            events: 1,
            words: &[0; 8],
        }
        .write(&mut bytes);
        strange.write_all(&bytes).unwrap();
    }
    std::thread::sleep(Duration::from_millis(200));
    folder.json(&[
        "forward", "--device", CAMERA, "--rate", "max", "--as", "raw", "--to", &to, "--json",
    ]);
    let output = receiver.wait_with_output().unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (&said["skipped_messages"], &said["lost_messages"]),
        (&3.into(), &0.into())
    );
    assert!(
        told.contains("newer version") && !told.contains('\x1b'),
        "{told}"
    );
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(shifted(read(&folder.path("a.aedat4"))), sorted(events()));
    drop(strange);
}

#[test]
fn a_consumer_that_is_absent_holds_up_nobody_and_gets_the_stream_when_it_comes() {
    let folder = Folder::new();
    let nobody = format!("tcp://127.0.0.1:{}", free_port());
    let forward = ["forward", "--device", CAMERA, "--json", "--to"];
    let output = folder.run(&[&forward[..], &[&nobody, "--to", "file:a.eecvs"]].concat());
    let errors = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert_eq!(errors.lines().count(), 2, "{errors}");
    assert!(errors.contains(&format!("{nobody}: lost ")) && errors.contains("was never reached"));
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["consumers"][0]["reached"], false, "{said}");
    assert_eq!(said["consumers"][0]["lost"]["events"], EVENTS, "{said}");
    assert_eq!(said["consumers"][1]["sent"]["events"], EVENTS, "{said}");
    assert_eq!(shifted(read(&folder.path("a.eecvs"))), sorted(events()));
    for kind in ["tcp", "unix"] {
        let port = free_port();
        let to = match kind {
            "tcp" => format!("tcp://127.0.0.1:{port}"),
            _ => format!("unix:{}", folder.path("socket").display()),
        };
        let slow = [
            "forward", "--device", CAMERA, "--rate", "0.1x", "--json", "--to", &to,
        ];
        let forward = folder.start(&slow);
        std::thread::sleep(Duration::from_millis(500));
        let name = format!("{kind}.eecvs");
        let received = folder.json(&["receive", &to, "-o", &name, "--once", "--json"]);
        let said = json(&forward.wait_with_output().unwrap());
        assert_eq!(said["consumers"][0]["lost"]["events"], 0, "{said}");
        assert_eq!(said["consumers"][0]["reached"], true, "{said}");
        assert_eq!(received["events"], EVENTS, "{received}");
        assert_eq!(shifted(read(&folder.path(&name))), sorted(events()));
    }
}

/// Datagrams to nobody do not end it, and are told as what they are.
#[test]
fn datagrams_to_nobody_are_lost_by_name() {
    let folder = Folder::new();
    let to = format!("udp://127.0.0.1:{}", free_port());
    let arguments = ["forward", "--device", CAMERA, "--json", "--to", &to];
    let output = folder.run(&[&arguments[..], &["--to", "file:a.eecvs"]].concat());
    let errors = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(errors.contains("was never reached"), "{errors}");
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["consumers"][0]["lost"]["events"], EVENTS, "{said}");
    assert_eq!(shifted(read(&folder.path("a.eecvs"))), sorted(events()));
}

#[test]
fn a_dash_is_standard_output_everywhere_and_has_the_stream_alone() {
    let folder = Folder::new();
    let camera = ["--device", CAMERA, "--rate", "max"];
    for more in [&["--json"][..], &[]] {
        let capture = folder.run(&[&["capture"], &camera[..], &["-o", "-"], more].concat());
        let forward = folder.run(&[&["forward"], &camera[..], &["--to", "-"], more].concat());
        let port = free_port();
        let to = format!("tcp://127.0.0.1:{port}");
        let receive = [&["receive", &to, "--once", "-o", "-"], more].concat();
        let receiver = folder.start(&receive);
        listening(port, "tcp");
        folder.json(&[&["forward"], &camera[..], &["--to", &to, "--json"]].concat());
        let receive = receiver.wait_with_output().unwrap();
        for (name, output) in [
            ("capture", capture),
            ("forward", forward),
            ("receive", receive),
        ] {
            let said = String::from_utf8(output.stderr).unwrap();
            assert!(output.status.success(), "{name}: {said}");
            if more.is_empty() {
                assert!(
                    said.contains("events ") && said.lines().count() > 5,
                    "{name}: {said}"
                );
            } else {
                let said: serde_json::Value = serde_json::from_str(&said).unwrap();
                assert_eq!(said["events"], EVENTS, "{name}: {said}");
            }
            std::fs::write(folder.path("out.eecvs"), output.stdout).unwrap();
            assert_eq!(
                shifted(read(&folder.path("out.eecvs"))),
                sorted(events()),
                "{name}"
            );
        }
    }
    assert!(!folder.path("-").exists() && !folder.path("incomplete--").exists());
}

#[test]
fn a_reader_that_has_seen_enough_ends_it_quietly() {
    let folder = Folder::new();
    let slow = ["--device", CAMERA, "--rate", "0.05x", "--window-us", "2000"];
    let encoder = ["--device", "sim:eecvs:scene.raw", "--rate", "0.05x"];
    let set_up = ["--set-up", "128x128", "-o", "-"];
    let port = free_port();
    let from = format!("tcp://127.0.0.1:{port}");
    for arguments in [
        [&["capture"], &slow[..], &["-o", "-"]].concat(),
        [&["capture"], &encoder[..], &set_up].concat(),
        [&["forward"], &slow[..], &["--to", "-"]].concat(),
        [&["forward", "--as", "raw"], &slow[..4], &["--to", "-"]].concat(),
        vec!["receive", &from, "-o", "-"],
    ] {
        let started = Instant::now();
        let mut child = folder.start(&arguments);
        let mut sender = None;
        if arguments[0] == "receive" {
            listening(port, "tcp");
            let mut command = folder.command(&[&["forward"], &slow[..], &["--to", &from]].concat());
            command.stdout(Stdio::null()).stderr(Stdio::null());
            sender = Some(command.spawn().unwrap());
        }
        let mut stdout = child.stdout.take().unwrap();
        stdout.read_exact(&mut [0; 20]).unwrap();
        drop(stdout);
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        if let Some(mut sender) = sender {
            sender.kill().unwrap();
            sender.wait().unwrap();
        }
        // The whole scene takes five seconds.
        assert!(started.elapsed() < Duration::from_secs(4), "{arguments:?}");
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
        assert!(
            !said.contains("eecvs-usb:") && !said.contains("panic"),
            "{said}"
        );
    }
}

#[test]
fn files_of_forward_are_refused_before_anything_is_done() {
    let folder = Folder::new();
    std::fs::write(folder.path("old.eecvs"), "old").unwrap();
    std::fs::hard_link(folder.path("scene.raw"), folder.path("hard.eecvs")).unwrap();
    let stream = [
        "capture", "--device", CAMERA, "--rate", "max", "-o", "a.stream",
    ];
    assert!(folder.run(&stream).status.success());
    let replay = "replay:a.stream";
    let kept = ["old.eecvs", "scene.raw", "a.stream"];
    let bytes = kept.map(|name| std::fs::read(folder.path(name)).unwrap());
    for (arguments, reason) in [
        (
            &["forward", "--device", CAMERA, "--to", "file:old.eecvs"][..],
            "--overwrite",
        ),
        (
            &[
                "forward",
                "--device",
                CAMERA,
                "--to",
                "file:hard.eecvs",
                "--overwrite",
            ],
            "same file",
        ),
        (
            &["forward", "--device", CAMERA, "--to", "file:a.raw"],
            "another kind",
        ),
        (
            &["forward", "--device", CAMERA, "--to", "file:none/a.eecvs"],
            "no folder",
        ),
        (
            &["forward", "--device", CAMERA, "--to", "-", "--to", "-"],
            "twice",
        ),
        (
            &[
                "forward",
                "--device",
                CAMERA,
                "--to",
                "file:b.eecvs",
                "--to",
                "file:./b.eecvs",
            ],
            "same file",
        ),
        (
            &[
                "forward",
                "--device",
                CAMERA,
                "--as",
                "raw",
                "--to",
                "file:b.stream",
            ],
            "a .stream file",
        ),
        (
            &[
                "capture",
                "--device",
                replay,
                "-o",
                "a.stream",
                "--overwrite",
            ],
            "same file",
        ),
        (
            &[
                "capture",
                "--device",
                CAMERA,
                "-o",
                "scene.raw",
                "--overwrite",
            ],
            "same file",
        ),
        (
            &[
                "capture",
                "--device",
                CAMERA,
                "-o",
                "b.raw",
                "--trace",
                "old.eecvs",
            ],
            "old.eecvs",
        ),
        (
            &[
                "capture", "--device", CAMERA, "-o", "b.raw", "--trace", "b.raw",
            ],
            "b.raw",
        ),
        (
            &[
                "capture",
                "--device",
                replay,
                "-o",
                "b.raw",
                "--trace",
                "a.stream",
                "--overwrite",
            ],
            "same file",
        ),
        (
            &["receive", "tcp://127.0.0.1:1", "-o", "old.eecvs"],
            "--overwrite",
        ),
    ] {
        let output = folder.run(arguments);
        let errors = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {errors}");
        assert!(errors.contains(reason), "{arguments:?}: {errors}");
        assert_eq!(errors.lines().count(), 1, "{errors}");
        for (name, bytes) in kept.iter().zip(&bytes) {
            assert!(
                std::fs::read(folder.path(name)).unwrap() == *bytes,
                "{arguments:?}: {name}"
            );
        }
    }
    assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 4);
    let whole = [
        "forward",
        "--device",
        CAMERA,
        "--to",
        "file:old.eecvs",
        "--overwrite",
    ];
    assert!(folder.run(&whole).status.success());
    assert_eq!(shifted(read(&folder.path("old.eecvs"))), sorted(events()));
    assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 4);
}

#[test]
fn a_region_and_pixels_outside_of_the_sensor_are_refused_with_its_size() {
    let folder = Folder::new();
    std::fs::write(folder.path("hot.txt"), "127,127\n128,0\n").unwrap();
    std::fs::write(folder.path("fit.txt"), "127,127\n").unwrap();
    let encoder = "sim:eecvs:scene.raw";
    let size = format!("{} x {}", SENSOR.width, SENSOR.height);
    for device in [CAMERA, encoder] {
        for command in ["capture", "forward"] {
            let to = if command == "capture" {
                ["-o", "a.eecvs"]
            } else {
                ["--to", "file:a.eecvs"]
            };
            let set_up = ["--set-up", "128x128"];
            for set_up in [&[][..], &set_up[..]] {
                if device == CAMERA && !set_up.is_empty() {
                    continue;
                }
                let common = [&[command, "--device", device, "--rate", "max"], &to[..]].concat();
                let common = [&common[..], set_up].concat();
                for (what, value) in [
                    ("--region", "0,0,129,1"),
                    ("--region", "128,0,1,1"),
                    ("--region", "5,65535,1,65535"),
                    ("--hot-pixels", "hot.txt"),
                ] {
                    let output = folder.run(&[&common[..], &[what, value]].concat());
                    let errors = String::from_utf8(output.stderr).unwrap();
                    assert_eq!(output.status.code(), Some(1), "{common:?} {what} {value}");
                    assert!(
                        errors.contains(&size) && errors.contains("outside"),
                        "{errors}"
                    );
                    assert!(!folder.path("a.eecvs").exists());
                    assert!(!folder.path("incomplete-a.eecvs").exists());
                }
            }
        }
        let fits = [
            "--region",
            "0,0,128,128",
            "--hot-pixels",
            "fit.txt",
            "-o",
            "fit.eecvs",
        ];
        let capture = [
            "capture",
            "--device",
            device,
            "--rate",
            "max",
            "--overwrite",
            "--json",
        ];
        let said = folder.json(&[&capture[..], &fits].concat());
        assert_eq!(
            (&said["width"], &said["height"]),
            (&128.into(), &128.into()),
            "{said}"
        );
    }
}

/// A recording lacks more than the frames that are lost, where others go on from them.
#[test]
fn what_a_lost_frame_takes_with_it_is_told() {
    let folder = Folder::new();
    let (parts, ends) = datagrams(&folder, &["--coder", "dense"]);
    let port = free_port();
    let from = format!("udp://127.0.0.1:{port}");
    let receiver = folder.start(&["receive", &from, "-o", "a.aedat4", "--once", "--json"]);
    listening(port, "udp");
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let kept = parts.iter().filter(|part| part.message != 2);
    for datagram in kept.map(|part| &part.bytes).chain(&ends) {
        socket.send_to(datagram, ("127.0.0.1", port)).unwrap();
    }
    let output = receiver.wait_with_output().unwrap();
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let errors = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert_eq!(said["lost_messages"], 1, "{said}");
    let cause = "frames without those they go on from";
    let messages = parts.last().unwrap().message + 1;
    assert_eq!(said["left_out"][cause], messages - 3, "{said}");
    assert!(errors.contains(cause), "{errors}");
}
