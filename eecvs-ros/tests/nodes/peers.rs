//! Peers that are not ours at the other end, where `./test.sh ros` has made them: genuine ROS 2, Fast DDS in C++ and
//! Cyclone DDS in C, each in domains of its own, and an implementation of rmw_zenoh's convention in Python.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use crate::again::again;
use crate::program::{PATIENCE, Program, QOS, free_port};
use eecvs_ros::bag::{Storage, Topic, Writer};
use eecvs_ros::message::{EventPacket, Frame, Header, Message, TYPES, Time, Type, to_cdr};
use eecvs_ros::names::NodeName;
use eecvs_ros::parameters::Parameters;
use eecvs_ros::transport::dds::Dds;
use eecvs_ros::transport::zenoh::{Links, Router, Zenoh};
use eecvs_ros::transport::{Qos, Transport};
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

/// A peer that is one program; `None`, and a line that says so, without it.
fn program(name: &str, what: &str) -> Option<PathBuf> {
    let peer = folder()?.join(name);
    if !peer.exists() {
        eprintln!("skipped: {what}: it is not there");
        return None;
    }
    Some(peer)
}

fn fast_dds() -> Option<PathBuf> {
    program("fastdds_peer", "Fast DDS in C++")
}

fn cyclone() -> Option<PathBuf> {
    program("cyclone_peer", "Cyclone DDS in C")
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
    let mut node = transport.node(&name, &Parameters::none()).unwrap();
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

/// Numbers that are never published: of every `of`, the last `leave_out`.
#[derive(Clone, Copy)]
struct Gaps {
    leave_out: u64,
    of: u64,
}

/// Numbers, of which the first and the last are published: what is missing at an end is not known to be missing.
const NUMBERS: u64 = 75;

impl Gaps {
    fn has(self, number: u64) -> bool {
        number % self.of >= self.of - self.leave_out
    }

    fn numbers(self) -> Vec<u64> {
        (0..NUMBERS).filter(|number| self.has(*number)).collect()
    }
}

/// One number, and runs of them.
const GAPS: [Gaps; 2] = [
    Gaps {
        leave_out: 1,
        of: 7,
    },
    Gaps {
        leave_out: 3,
        of: 10,
    },
];

const TOPIC: &str = "/event_camera/events";

/// Nodes count what a peer has left out.
fn count_losses_of(peer: impl Fn() -> Command, domain: u16) {
    let folder = tempfile::tempdir().unwrap();
    for (number, gaps) in GAPS.into_iter().enumerate() {
        let bag = folder.path().join(format!("bag{number}"));
        let arguments: [&[&str]; 2] = [
            &["encode"],
            &[
                "record",
                "-o",
                bag.to_str().unwrap(),
                "--topic",
                "events:event_camera_msgs/msg/EventPacket",
            ],
        ];
        let came = NUMBERS - gaps.numbers().len() as u64;
        let lost = gaps.numbers().len();
        let told = [
            format!(" events of {came} messages ({lost} lost, "),
            format!("{TOPIC}: {came} messages, {lost} lost"),
        ];
        let words = [
            "event messages have not arrived",
            "messages have not arrived",
        ];
        // One at a time: the peer begins once one subscriber is there.
        for ((arguments, told), what) in arguments.into_iter().zip(told).zip(words) {
            let node = Program::eecvs_ros(domain, arguments);
            let mut command = peer();
            let more = format!(
                "--count {NUMBERS} --seconds 40 --bytes 1000 --leave-out {} --of {}",
                gaps.leave_out, gaps.of
            );
            command
                .args(["talk", EventPacket::TYPE.name, TOPIC])
                .args(more.split(' '));
            let (said, _) = Program::start("talk", domain, command).finish(PATIENCE);
            let summary = &lines(&said).pop().unwrap()["summary"];
            assert_eq!(summary["sent"], came);
            node.terminate();
            let (_, said) = node.ends_with(1, PATIENCE);
            assert!(said.contains(&told), "no {told:?} in: {said}");
            let lost = format!("{lost} {what}");
            assert!(said.contains(&lost), "no {lost:?} in: {said}");
        }
    }
}

/// A peer tells the numbers that a bag lacks.
fn have_losses_counted(peer: impl Fn() -> Command, domain: u16) {
    let folder = tempfile::tempdir().unwrap();
    for (number, gaps) in GAPS.into_iter().enumerate() {
        let bag = folder.path().join(format!("bag{number}"));
        let topic = Topic {
            name: TOPIC.to_owned(),
            kind: EventPacket::TYPE.name.to_owned(),
            ..Topic::default()
        };
        let mut writer =
            Writer::create(&bag, Storage::Mcap, vec![(topic, EventPacket::TYPE)]).unwrap();
        let published = (0..NUMBERS).filter(|number| !gaps.has(*number));
        for number in published.clone() {
            let packet = EventPacket {
                seq: number,
                height: 720,
                width: 1280,
                encoding: "evt3".to_owned(),
                events: vec![0; 1000],
                ..EventPacket::default()
            };
            // 100 Hz.
            let time_ns = number * 10_000_000;
            writer.message(0, time_ns, &to_cdr(&packet)).unwrap();
        }
        writer.finish().unwrap();
        let count = published.count().to_string();
        let mut command = peer();
        command
            .args(["listen", EventPacket::TYPE.name, TOPIC])
            .args(["--seconds", "45", "--count", &count]);
        let listener = Program::start("listen", domain, command);
        let play = ["play", bag.to_str().unwrap(), "--wait-s", "40"];
        Program::eecvs_ros(domain, &play).finish(PATIENCE);
        let said = lines(&listener.finish(PATIENCE).0).pop().unwrap();
        let summary = &said["summary"];
        assert_eq!(summary["lost"], serde_json::json!(gaps.numbers()), "{said}");
        assert_eq!(summary["first"], 0, "{said}");
        assert_eq!(summary["last"], NUMBERS - 1, "{said}");
    }
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
    let Some(peer) = fast_dds() else { return };
    for (number, kind) in (0..).zip([EventPacket::TYPE, Frame::TYPE]) {
        relay(|| Command::new(&peer), 80 + number, kind);
    }
}

#[test]
fn packets_and_frames_pass_to_cyclone_and_back() {
    let Some(peer) = cyclone() else { return };
    for (number, kind) in (0..).zip([EventPacket::TYPE, Frame::TYPE]) {
        relay(|| Command::new(&peer), 85 + number, kind);
    }
}

#[test]
fn what_ros_has_left_out_is_counted() {
    let Some(folder) = folder() else { return };
    count_losses_of(|| rclpy(&folder), 76);
}

#[test]
fn ros_counts_what_we_have_left_out() {
    let Some(folder) = folder() else { return };
    have_losses_counted(|| rclpy(&folder), 77);
}

#[test]
fn what_fast_dds_has_left_out_is_counted() {
    let Some(peer) = fast_dds() else { return };
    count_losses_of(|| Command::new(&peer), 82);
}

#[test]
fn fast_dds_counts_what_we_have_left_out() {
    let Some(peer) = fast_dds() else { return };
    have_losses_counted(|| Command::new(&peer), 83);
}

#[test]
fn what_cyclone_has_left_out_is_counted() {
    let Some(peer) = cyclone() else { return };
    count_losses_of(|| Command::new(&peer), 87);
}

#[test]
fn cyclone_counts_what_we_have_left_out() {
    let Some(peer) = cyclone() else { return };
    have_losses_counted(|| Command::new(&peer), 88);
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

/// What `ros2 param` asks for and sets.
#[test]
fn ros_has_typed_parameters() {
    let Some(folder) = folder() else { return };
    let domain = 91;
    let _decode = Program::eecvs_ros(domain, &["decode", "--image-hz", "20"]);
    let mut command = rclpy(&folder);
    command.args(["parameters", "/event_camera/decode", "--names"]);
    command.args([
        "image_hz",
        "image",
        "volume_bytes",
        "connect",
        "reliable",
        "use_sim_time",
    ]);
    for value in [
        "image_hz=10.0",
        "image_hz=10",
        "image=rgb8",
        "image=gif",
        "volume_bytes=5",
        "none=5",
        "use_sim_time=true",
        "use_sim_time=false",
    ] {
        command.args(["--set", value]);
    }
    let (output, _) = Program::start("parameters", domain, command).finish(PATIENCE);
    let seen = lines(&output).pop().unwrap();
    let listed = seen["listed"].as_array().unwrap();
    for name in ["image_hz", "volume_bytes", "use_sim_time"] {
        assert!(listed.contains(&name.into()), "{seen}");
    }
    let values = serde_json::json!([20.0, "mono8", 98_000, null, false, false]);
    assert_eq!(seen["values"], values, "{seen}");
    assert_eq!(seen["types"], serde_json::json!([3, 4, 2, 0, 1, 1]));
    assert_eq!(seen["undeclared"], 0);
    let described = |index: usize| &seen["described"][index];
    assert_eq!(described(0)["type"], 3);
    assert_eq!(described(0)["floating_point_range"][0][1], 1000.0);
    assert_eq!(described(0)["read_only"], false);
    assert_eq!(
        described(2)["integer_range"][0],
        serde_json::json!([0, u32::MAX, 0])
    );
    assert_eq!(described(2)["read_only"], true);
    assert_eq!(described(3)["type"], 9);
    let description = described(2)["description"].as_str().unwrap();
    assert!(
        description.contains("Maximum bytes of values per message"),
        "{seen}"
    );
    let want = [
        "",
        "of type {double}, setting it to {integer}",
        "",
        "mono8, rgb8",
        "read-only",
        "not declared",
        "not supported",
        "",
    ];
    let set = seen["set"].as_array().unwrap();
    assert_eq!(set.len(), want.len());
    for (set, want) in set.iter().zip(want) {
        assert!(
            set["reason"].as_str().unwrap().contains(want),
            "{set} is not {want}"
        );
        assert_eq!(set["successful"], want.is_empty(), "{set}");
    }
    assert_eq!(seen["atomically"]["successful"], false, "{seen}");
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
        let mut node = transport.node(&name, &Parameters::none()).unwrap();
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
