//! Peers that are not ours at the other end, where `./test.sh ros` has made them: genuine ROS 2, Fast DDS in C++ and
//! Cyclone DDS in C, each in domains of its own, and an implementation of rmw_zenoh's convention in Python.

mod again;
mod program;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use again::again;
use eecvs_ros::message::{EventPacket, Frame, Header, Message, TYPES, Time, Type, to_cdr};
use eecvs_ros::names::NodeName;
use eecvs_ros::transport::dds::Dds;
use eecvs_ros::transport::zenoh::{Links, Router, Zenoh};
use eecvs_ros::transport::{Qos, Transport};
use program::{PATIENCE, Program, QOS, free_port};
use serde_json::Value;

/// Messages that pass in each direction.
const COUNT: usize = 30;

/// The folder of the peers; `None`, and a line that says so, without it.
fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("EECVS_ROS_PEERS").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: peers of ROS 2: `./test.sh ros` makes them");
    }
    folder
}

/// Genuine ROS 2.
fn rclpy(folder: &Path) -> Command {
    let mut command = Command::new(concat!(env!("CARGO_MANIFEST_DIR"), "/peers/env.sh"));
    command
        .arg(folder)
        .arg("python")
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/peers/rclpy_peer.py"));
    command
}

/// The lines of JSON that a peer has printed.
fn lines(output: &str) -> Vec<Value> {
    let line = |line: &str| serde_json::from_str(line).unwrap();
    output.lines().map(line).collect()
}

/// The messages that it tells of, in their order: every field, bytes by their digest.
fn messages(output: &str) -> Vec<Value> {
    let told = lines(output).into_iter();
    told.filter_map(|line| line.get("message").cloned())
        .collect()
}

/// Messages of a peer come, are understood, and go back to it, with the same content.
fn relay(peer: impl Fn() -> Command, domain: u16, kind: Type) {
    let transport = Dds::join(domain, true).unwrap();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = transport.node(&name, &[]).unwrap();
    let mut subscription = node.subscription("/there", kind, QOS).unwrap();
    let mut publisher = node.publisher("/back", kind, QOS).unwrap();
    let start = |what: &str, topic: &str, more: &str| {
        let mut command = peer();
        command.args([what, kind.name, topic]).args(more.split(' '));
        Program::start(what, domain, command)
    };
    let listener = start("listen", "/back", &format!("--count {COUNT} --seconds 45"));
    let until = Instant::now() + PATIENCE;
    while publisher.subscribers() == 0 && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(20));
    }
    // More than a datagram, and no whole number of words.
    let more = format!("--count {COUNT} --seconds 40 --rate 50 --bytes 90001");
    let talker = start("talk", "/there", &more);
    for _ in 0..COUNT {
        let cdr = subscription.take(PATIENCE).unwrap().expect("a message");
        let message = again(kind, &cdr).expect("a message");
        publisher.publish(&message).unwrap();
    }
    let sent = messages(&talker.finish(PATIENCE).0);
    let back = messages(&listener.finish(PATIENCE).0);
    assert_eq!(sent.len(), COUNT);
    assert!(sent == back, "{}: {sent:?}\n{back:?}", kind.name);
}

#[test]
fn types_have_the_hashes_of_ros() {
    let Some(folder) = folder() else { return };
    let hashes = std::fs::read_to_string(folder.join("hashes.txt")).unwrap();
    let hashes: BTreeMap<&str, &str> = hashes
        .lines()
        .map(|line| line.strip_prefix("hash ").unwrap().split_once(' ').unwrap())
        .collect();
    for kind in TYPES {
        assert_eq!(hashes.get(kind.name), Some(&kind.hash), "{}", kind.name);
    }
}

#[test]
fn every_type_passes_to_ros_and_back() {
    let Some(folder) = folder() else { return };
    for (number, kind) in (0..).zip(TYPES) {
        relay(|| rclpy(&folder), 70 + number, kind);
    }
}

#[test]
fn packets_and_frames_pass_to_fast_dds_and_back() {
    let Some(folder) = folder() else { return };
    let peer = folder.join("fastdds_peer");
    if !peer.exists() {
        eprintln!("skipped: Fast DDS in C++: it is not there");
        return;
    }
    for (number, kind) in (0..).zip([EventPacket::TYPE, Frame::TYPE]) {
        relay(|| Command::new(&peer), 80 + number, kind);
    }
}

#[test]
fn packets_and_frames_pass_to_cyclone_and_back() {
    let Some(folder) = folder() else { return };
    let peer = folder.join("cyclone_peer");
    if !peer.exists() {
        eprintln!("skipped: Cyclone DDS in C: it is not there");
        return;
    }
    for (number, kind) in (0..).zip([EventPacket::TYPE, Frame::TYPE]) {
        relay(|| Command::new(&peer), 85 + number, kind);
    }
}

/// Nodes, topics, types and QoS are seen under the documented names.
#[test]
fn ros_sees_the_nodes() {
    let Some(folder) = folder() else { return };
    let domain = 90;
    let _nodes: Vec<Program> = [
        vec!["emulate", "--repeat"],
        vec!["encode"],
        vec!["decode"],
        vec!["density"],
    ]
    .iter()
    .map(|arguments| Program::eecvs_ros(domain, arguments))
    .collect();
    let topics = [
        (
            "/event_camera/events",
            "event_camera_msgs/msg/EventPacket",
            "emulate",
        ),
        ("/event_camera/frames", "eecvs_msgs/msg/Frame", "encode"),
        ("/event_camera/density", "eecvs_msgs/msg/Density", "density"),
        (
            "/diagnostics",
            "diagnostic_msgs/msg/DiagnosticArray",
            "density",
        ),
        (
            "/event_camera/decoded/events",
            "event_camera_msgs/msg/EventPacket",
            "decode",
        ),
        ("/event_camera/volume", "eecvs_msgs/msg/Volume", "decode"),
        ("/event_camera/image", "sensor_msgs/msg/Image", "decode"),
    ];
    let mut command = rclpy(&folder);
    command.args(["graph", "--seconds", "20", "--until"]);
    command.args(topics.map(|(topic, ..)| topic));
    let (output, _) = Program::start("graph", domain, command).finish(PATIENCE);
    let seen = lines(&output).pop().unwrap();
    for node in ["emulate", "encode", "decode", "density"] {
        let name = format!("/event_camera/{node}");
        let nodes = seen["nodes"].as_array().unwrap();
        assert!(nodes.iter().any(|node| *node == name.as_str()), "{seen}");
    }
    for (topic, kind, node) in topics {
        let topic = &seen["topics"][topic];
        assert_eq!(topic["types"], serde_json::json!([kind]));
        let publisher = &topic["publishers"][0];
        assert_eq!(publisher["node"], format!("/event_camera/{node}"));
        assert_eq!(publisher["type"], kind);
        assert_eq!(publisher["reliability"], "BEST_EFFORT");
        assert_eq!(publisher["durability"], "VOLATILE");
    }
    // What `ros2 param list` asks.
    let services = seen["services"].as_object().unwrap();
    assert!(
        services.contains_key("/event_camera/encode/list_parameters"),
        "{seen}"
    );
}

/// Messages come back as they went, the hashes are those that follow from the definitions, and the ends of topics
/// are seen with their QoS.
#[test]
fn packets_and_frames_pass_over_zenoh_and_back() {
    let Some(folder) = folder() else { return };
    let header = |number: u32| Header {
        stamp: Time {
            sec: 1_700_000_000,
            nanosec: number,
        },
        frame_id: ".".repeat(number as usize % 5),
    };
    // More than a batch of Zenoh's, and no whole number of words.
    let data = |number: u32| -> Vec<u8> {
        let mixed = |index: u32| (index.wrapping_mul(2_654_435_761) >> 24) as u8;
        (0..90_001 + number)
            .map(|index| mixed(index ^ number))
            .collect()
    };
    let packet = |number: u32| {
        to_cdr(&EventPacket {
            header: header(number),
            height: 720,
            width: 1280,
            seq: number.into(),
            time_base: u64::MAX - 5,
            encoding: "evt3".to_owned(),
            is_bigendian: false,
            events: data(number),
        })
    };
    let frame = |number: u32| {
        to_cdr(&Frame {
            header: header(number),
            seq: number.into(),
            t0_us: 1 << 40,
            duration_us: 33_333,
            height: 720,
            width: 1280,
            events: number,
            operator_name: "eecvs".to_owned(),
            data: data(number),
        })
    };
    let crate_folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let packet_file = "peers/event_camera_msgs/msg/EventPacket.msg";
    let frame_file = "../eecvs_msgs/msg/Frame.msg";
    type Make<'m> = &'m dyn Fn(u32) -> Vec<u8>;
    let kinds: [(Type, &str, Make<'_>); 2] = [
        (EventPacket::TYPE, packet_file, &packet),
        (Frame::TYPE, frame_file, &frame),
    ];
    for (kind, file, make) in kinds {
        let port = free_port();
        let endpoint = vec![format!("tcp/127.0.0.1:{port}")];
        let listens = Links {
            listen: endpoint.clone(),
            ..Links::default()
        };
        let connects = Links {
            connect: endpoint,
            ..Links::default()
        };
        let router = Router::start(&listens).unwrap();
        let domain = 9;
        let transport = Zenoh::join(domain, &connects).unwrap();
        let name = NodeName::new("/robot", "test").unwrap();
        let mut node = transport.node(&name, &[]).unwrap();
        let mut subscription = node.subscription("/back", kind, QOS).unwrap();
        let qos = Qos {
            reliable: true,
            ..QOS
        };
        let mut publisher = node.publisher("/there", kind, qos).unwrap();
        let mut command = Command::new(folder.join("venv/bin/python"));
        command
            .arg(crate_folder.join("peers/zenoh_peer.py"))
            .args([&port.to_string(), kind.name])
            .arg(crate_folder.join(file))
            .args([&COUNT.to_string(), "/there", "/back"]);
        let peer = Program::start("zenoh_peer", domain, command);
        let until = Instant::now() + PATIENCE;
        while publisher.subscribers() == 0 && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(20));
        }
        // Tokens come before routes: the first ones may be lost.
        let mut back = None;
        while back.is_none() && Instant::now() < until {
            publisher.publish(&make(0)).unwrap();
            back = subscription.take(Duration::from_secs(1)).unwrap();
        }
        for number in 1..COUNT as u32 {
            let came = again(kind, &back.expect("a message")).unwrap();
            assert!(came == make(number - 1), "another message");
            publisher.publish(&make(number)).unwrap();
            back = subscription.take(PATIENCE).unwrap();
        }
        let (output, _) = peer.finish(PATIENCE);
        let said = lines(&output);
        assert_eq!(said[0]["hash"], kind.hash);
        let topics = &said[2]["topics"];
        let end = |qos| {
            serde_json::json!([{
                "node": "/robot/test", "type": kind.name, "hash": kind.hash, "qos": qos,
            }])
        };
        assert_eq!(topics["/there"]["publishers"], end("::,10000:,:,:,,"));
        assert_eq!(topics["/back"]["subscribers"], end("2::,10000:,:,:,,"));
        drop(router);
    }
}
