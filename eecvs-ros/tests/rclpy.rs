//! Genuine ROS 2 at the other end, where `./test.sh ros` has made its environment.

mod common;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use common::{Program, QOS, root};
use eecvs_ros::message::{
    Density, DiagnosticArray, EventPacket, Frame, Image, Message, TYPES, Type, Volume, from_cdr,
    to_cdr,
};
use eecvs_ros::names::NodeName;
use eecvs_ros::transport::Transport;
use eecvs_ros::transport::dds::Dds;
use sha2::{Digest, Sha256};

const PATIENCE: Duration = Duration::from_secs(60);

/// The folder of the environment; `None`, and a line that says so, without it.
fn peers() -> Option<PathBuf> {
    let folder = std::env::var_os("EECVS_ROS_PEERS").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: genuine ROS 2: `./test.sh ros` makes its environment");
    }
    folder
}

fn peer(folder: &PathBuf, domain: u16, arguments: &[&str]) -> Program {
    let mut command = Command::new(root().join("eecvs-ros/peers/env.sh"));
    command
        .arg(folder)
        .arg("python3")
        .arg(root().join("eecvs-ros/peers/rclpy_peer.py"))
        .args(arguments);
    Program::start(arguments[0], domain, command)
}

fn digest(cdr: &[u8]) -> String {
    let digest = Sha256::digest(cdr);
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The digests that a peer has printed, in their order.
fn digests(output: &str) -> Vec<String> {
    output
        .lines()
        .filter_map(|line| {
            let line: serde_json::Value = serde_json::from_str(line).unwrap();
            line["sha256"].as_str().map(str::to_owned)
        })
        .collect()
}

/// The same message as this project serialises it.
fn again(kind: Type, cdr: &[u8]) -> Vec<u8> {
    fn of<M: Message>(cdr: &[u8]) -> Vec<u8> {
        to_cdr::<M>(&from_cdr(cdr).unwrap())
    }
    match kind.name {
        name if name == EventPacket::TYPE.name => of::<EventPacket>(cdr),
        name if name == Frame::TYPE.name => of::<Frame>(cdr),
        name if name == Density::TYPE.name => of::<Density>(cdr),
        name if name == Volume::TYPE.name => of::<Volume>(cdr),
        name if name == Image::TYPE.name => of::<Image>(cdr),
        name if name == DiagnosticArray::TYPE.name => of::<DiagnosticArray>(cdr),
        other => panic!("{other}"),
    }
}

#[test]
fn types_have_the_hashes_of_ros() {
    let Some(folder) = peers() else { return };
    let hashes = std::fs::read_to_string(folder.join("hashes")).unwrap();
    let hashes: BTreeMap<&str, &str> = hashes
        .lines()
        .map(|line| line.split_once(' ').unwrap())
        .collect();
    for kind in TYPES {
        assert_eq!(hashes.get(kind.name), Some(&kind.hash), "{}", kind.name);
    }
}

/// Messages of ROS come, are understood, and go back to it, in the same bytes each time.
#[test]
fn every_type_passes_both_ways_in_every_byte() {
    let Some(folder) = peers() else { return };
    for (number, kind) in (0_u16..).zip(TYPES) {
        let domain = 70 + number;
        let transport = Dds::join(domain, true).unwrap();
        let name = NodeName::new("/", "test").unwrap();
        let mut node = transport.node(&name, &[]).unwrap();
        let mut subscription = node.subscription("/there", kind, QOS).unwrap();
        let mut publisher = node.publisher("/back", kind, QOS).unwrap();
        let listener = peer(
            &folder,
            domain,
            &[
                "listen",
                kind.name,
                "/back",
                "--count",
                "30",
                "--seconds",
                "30",
            ],
        );
        let talker = peer(
            &folder,
            domain,
            &[
                "talk", kind.name, "/there", "--count", "30", "--rate", "50", "--bytes", "50000",
            ],
        );
        let until = std::time::Instant::now() + PATIENCE;
        while publisher.subscribers() == 0 && std::time::Instant::now() < until {
            std::thread::sleep(Duration::from_millis(20));
        }
        let mut received = Vec::new();
        for _ in 0..30 {
            let cdr = subscription.take(PATIENCE).unwrap().expect("a message");
            let ours = again(kind, &cdr);
            publisher.publish(&ours).unwrap();
            received.push(digest(&ours));
        }
        let sent = digests(&talker.finish(PATIENCE).0);
        let back = digests(&listener.finish(PATIENCE).0);
        assert_eq!(received, sent, "{}", kind.name);
        assert_eq!(back, sent, "{}", kind.name);
    }
}

/// Nodes, topics, types and QoS are seen under the documented names.
#[test]
fn ros_sees_the_nodes() {
    let Some(folder) = peers() else { return };
    let domain = 80;
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
    let mut arguments = vec!["graph", "--seconds", "20", "--until"];
    arguments.extend(topics.iter().map(|(topic, ..)| *topic));
    let (output, _) = peer(&folder, domain, &arguments).finish(PATIENCE);
    let seen: serde_json::Value = serde_json::from_str(&output).unwrap();
    for node in ["emulate", "encode", "decode", "density"] {
        let name = format!("/event_camera/{node}");
        let nodes = seen["nodes"].as_array().unwrap();
        assert!(nodes.iter().any(|node| *node == name.as_str()), "{seen}");
    }
    for (topic, kind, node) in topics {
        let topic = &seen["topics"][topic];
        assert_eq!(topic["types"], serde_json::json!([kind]));
        let publisher = &topic["publishers"][0];
        let node = format!("/event_camera/{node}");
        assert_eq!(
            *publisher,
            serde_json::json!({
                "node": node, "type": kind, "reliability": "BEST_EFFORT", "durability": "VOLATILE",
            })
        );
    }
}
