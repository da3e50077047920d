//! Topics to bags and back, and what independent readers find in these.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use eecvs_nostd::{Event, Sensor};
use eecvs_ros::bag::{Reader, Stored};
use eecvs_ros::message::{EventPacket, Frame, Message, from_cdr, sequence_of};
use eecvs_ros::names::NodeName;
use eecvs_ros::parameters::Parameters;
use eecvs_ros::transport::Transport;
use eecvs_ros::transport::dds::Dds;
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::{EventReader, open};
use sha2::{Digest, Sha256};

use crate::program::{PATIENCE, Program, QOS};

const DURATION_US: u64 = 300_000;

fn scene() -> Vec<Event> {
    let mut config = SceneConfig::model_1(Preset::IndoorFlying, 1);
    config.duration_us = DURATION_US;
    config.sensor = Sensor::new(120, 90).unwrap();
    rest(&mut emulate(config).unwrap())
}

fn rest(reader: &mut dyn EventReader) -> Vec<Event> {
    let mut events = Vec::new();
    while reader.read(&mut events).unwrap() > 0 {}
    events
}

fn stored(bag: &Path) -> (Reader, Vec<Stored>) {
    let mut reader = Reader::open(bag, 0).unwrap();
    let mut all = Vec::new();
    while let Some(stored) = reader.next_message().unwrap() {
        all.push(stored);
    }
    (reader, all)
}

/// Records a scene's events and frames.
fn record(domain: u16, bag: &Path, storage: &str) {
    let path = bag.to_str().unwrap();
    let arguments = ["record", "-o", path, "--storage", storage, "--idle-s", "3"];
    let record = Program::eecvs_ros(domain, &arguments);
    let encode = Program::eecvs_ros(domain, &["encode", "--window-us", "20000", "--idle-s", "1"]);
    std::thread::sleep(Duration::from_secs(2));
    let duration_us = DURATION_US.to_string();
    let mut arguments = vec!["emulate", "--duration-us", &duration_us];
    arguments.extend("--width 120 --height 90 --wait-s 20 --rate 0.5x".split(' '));
    Program::eecvs_ros(domain, &arguments).finish(PATIENCE);
    encode.finish(PATIENCE);
    let (_, said) = record.finish(PATIENCE);
    assert!(said.contains("/event_camera/events: "), "{said}");
    assert!(!said.contains("have not arrived"), "{said}");
}

/// What independent readers say of a bag, where `./test.sh ros` has made them.
fn check_readers(bag: &Path, storage: &str, want: &[(&str, Vec<Vec<u8>>)]) {
    let Some(folder) = std::env::var_os("EECVS_ROS_PEERS") else {
        eprintln!("skipped: independent readers of bags: `./test.sh ros` makes them");
        return;
    };
    let mut command = Command::new(concat!(env!("CARGO_MANIFEST_DIR"), "/peers/env.sh"));
    command
        .arg(folder)
        .arg("python")
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/peers/read_bag.py"))
        .arg(bag);
    let (output, _) = Program::start("read_bag", 0, command).finish(PATIENCE);
    let found: Vec<serde_json::Value> = output
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let readers: &[&str] = match storage {
        "mcap" => &["rosbags", "mcap-ros2-support"],
        _ => &["rosbags"],
    };
    for reader in readers {
        for (topic, data) in want {
            let mut digest = Sha256::new();
            data.iter().for_each(|data| digest.update(data));
            let digest: String = digest
                .finalize()
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect();
            let is_it =
                |line: &&serde_json::Value| line["reader"] == *reader && line["topic"] == *topic;
            let line = found
                .iter()
                .find(is_it)
                .unwrap_or_else(|| panic!("{reader}: {output}"));
            assert_eq!(line["messages"], data.len(), "{reader} {topic}");
            assert_eq!(line["sha256"], digest, "{reader} {topic}");
        }
    }
}

#[test]
fn topics_are_recorded_in_mcap_and_played() {
    recorded_and_played(65, "mcap");
}

#[test]
fn topics_are_recorded_in_sqlite_and_played() {
    recorded_and_played(66, "sqlite3");
}

fn recorded_and_played(domain: u16, storage: &str) {
    let folder = tempfile::tempdir().unwrap();
    let want = scene();
    let bag = folder.path().join(storage);
    record(domain, &bag, storage);
    // As a recording: our other reader.
    let mut reader = open(&bag, None).unwrap();
    assert!(rest(reader.as_mut()) == want, "{storage}");

    let (reader, messages) = stored(&bag);
    let of = |name: &str| -> Vec<&Stored> {
        let topic = reader.topics().iter().position(|topic| topic.name == name);
        let is_it = |stored: &&Stored| Some(stored.topic) == topic;
        messages.iter().filter(is_it).collect()
    };
    let (packets, frames) = (of("/event_camera/events"), of("/event_camera/frames"));
    assert!(frames.len() >= 15);
    for (number, stored) in packets.iter().enumerate() {
        let sequence = sequence_of(EventPacket::TYPE, &stored.cdr);
        assert_eq!(sequence, Some(number as u64));
    }
    let events = |stored: &&Stored| from_cdr::<EventPacket>(&stored.cdr).unwrap().events;
    let data = |stored: &&Stored| from_cdr::<Frame>(&stored.cdr).unwrap().data;
    let all = [
        ("/event_camera/events", packets.iter().map(events).collect()),
        ("/event_camera/frames", frames.iter().map(data).collect()),
    ];
    check_readers(&bag, storage, &all);

    // Played on another topic, from a part of a second on.
    let transport = Dds::join(domain, true).unwrap();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = transport.node(&name, &Parameters::none()).unwrap();
    let mut subscription = node.subscription("/again", EventPacket::TYPE, QOS).unwrap();
    let mut other = node
        .subscription("/event_camera/frames", Frame::TYPE, QOS)
        .unwrap();
    let path = bag.to_str().unwrap();
    let play = Program::eecvs_ros(
        domain,
        &[
            "play",
            path,
            "--rate",
            "2x",
            "--start-s",
            "0.2",
            "--wait-s",
            "2",
            "--ros-args",
            "-r",
            "/event_camera/events:=/again",
        ],
    );
    let mut played = Vec::new();
    while let Some(cdr) = subscription.take(Duration::from_secs(5)).unwrap() {
        played.push(cdr);
    }
    let start_ns = messages[0].time_ns + 200_000_000;
    let late: Vec<&Vec<u8>> = packets
        .iter()
        .filter(|stored| stored.time_ns >= start_ns)
        .map(|stored| &stored.cdr)
        .collect();
    assert!(late.len() > 50 && late.len() < packets.len());
    assert!(played.iter().eq(late), "{} messages", played.len());
    assert!(other.take(Duration::ZERO).unwrap().is_some());
    play.finish(PATIENCE);
}
