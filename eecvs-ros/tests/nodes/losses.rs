//! What a node has lost or left out ends it with status 1, and with 0 where that is allowed.

use std::time::{Duration, Instant};

use eecvs_ros::message::{EventPacket, Frame, Message, to_cdr};
use eecvs_ros::names::NodeName;
use eecvs_ros::parameters::Parameters;
use eecvs_ros::transport::dds::Dds;
use eecvs_ros::transport::{Publisher, Transport};

use crate::program::{PATIENCE, Program, QOS};

/// Numbers of the messages, of which one is missing.
const NUMBERS: [u64; 4] = [0, 1, 3, 4];

/// Packets without a readable event, of which the third is of another sensor.
fn packets() -> Vec<Vec<u8>> {
    let packet = |seq: u64| EventPacket {
        seq,
        height: 90,
        width: if seq == 3 { 100 } else { 120 },
        encoding: "mono".to_owned(),
        // One event, at x = 5, y = 0, later with every message.
        events: [seq as u32 * 1000, 5].map(u32::to_le_bytes).concat(),
        ..EventPacket::default()
    };
    NUMBERS.map(|seq| to_cdr(&packet(seq))).into()
}

/// Frames that no operator reads.
fn frames() -> Vec<Vec<u8>> {
    let frame = |seq: u64| Frame {
        seq,
        operator_name: "none".to_owned(),
        ..Frame::default()
    };
    NUMBERS.map(|seq| to_cdr(&frame(seq))).into()
}

fn publish(publisher: &mut dyn Publisher, messages: &[Vec<u8>], subscribers: usize) {
    let until = Instant::now() + PATIENCE;
    while publisher.subscribers() < subscribers {
        assert!(
            Instant::now() < until,
            "{} subscribers",
            publisher.subscribers()
        );
        std::thread::sleep(Duration::from_millis(20));
    }
    // They may discover this publisher later, which cannot be seen from here.
    std::thread::sleep(Duration::from_secs(2));
    for message in messages {
        publisher.publish(message).unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn losses_end_every_node_with_a_status() {
    let domain = 98;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let transport = Dds::join(domain, true).unwrap();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = transport.node(&name, &Parameters::none()).unwrap();
    let events = node.publisher("/event_camera/events", EventPacket::TYPE, QOS);
    let sent = node.publisher("/event_camera/frames", Frame::TYPE, QOS);
    let (mut events, mut sent) = (events.unwrap(), sent.unwrap());
    let packets_lost = "1 event messages have not arrived, 1 event messages were left out";
    let frames_lost = "1 frames have not arrived, 4 frames were left out";
    let of_events = [
        (
            "encode --ros-args -r frames:=unused".to_owned(),
            packets_lost,
        ),
        ("density".to_owned(), packets_lost),
        (
            format!(
                "record -o {} --topic events:event_camera_msgs/msg/EventPacket",
                path("bag")
            ),
            "1 messages have not arrived",
        ),
        (
            "compose encode density --ros-args -r frames:=unused".to_owned(),
            packets_lost,
        ),
    ];
    let of_frames = [
        ("decode".to_owned(), frames_lost),
        (format!("log --features {}", path("a.csv")), frames_lost),
        (
            "delay --seconds 2 --json".to_owned(),
            "1 frames have not arrived",
        ),
    ];
    for allows in [false, true] {
        // In groups, as two processors are soon busy.
        for (nodes, messages, publisher, subscriptions) in [
            (&of_events[..], packets(), &mut events, 5),
            (&of_frames[..], frames(), &mut sent, 3),
        ] {
            let start = |line: &str| {
                let line = line.replace("bag", &format!("bag{allows}"));
                let line = line.replace("a.csv", &format!("{allows}.csv"));
                let mut words: Vec<&str> = line.split(' ').collect();
                let flag = match words[0] {
                    "compose" => vec!["-p", "allow_loss:=true"],
                    _ => vec!["--allow-loss"],
                };
                if allows {
                    let at = words.iter().position(|word| *word == "--ros-args");
                    let at = match words[0] {
                        "compose" => words.len(),
                        _ => at.unwrap_or(words.len()),
                    };
                    words.splice(at..at, flag);
                }
                Program::eecvs_ros(domain, &words)
            };
            let programs: Vec<Program> = nodes.iter().map(|(line, _)| start(line)).collect();
            publish(publisher.as_mut(), &messages, subscriptions);
            std::thread::sleep(Duration::from_millis(500));
            for ((line, lost), program) in nodes.iter().zip(programs) {
                if !line.starts_with("delay") {
                    program.terminate();
                }
                let status = if allows { 0 } else { 1 };
                let (out, said) = program.ends_with(status, PATIENCE);
                let told = format!("{lost}; with --allow-loss this is not an error");
                assert_eq!(said.contains(&told), !allows, "{line}: {said}");
                if line.starts_with("delay") {
                    assert!(out.contains("\"frames_lost\":1"), "{out}");
                }
            }
            // Until the programs are known to be gone.
            let until = Instant::now() + PATIENCE;
            while publisher.subscribers() > 0 {
                assert!(
                    Instant::now() < until,
                    "{} subscribers",
                    publisher.subscribers()
                );
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }
}
