//! Two publishers of one topic: the nodes are named, the first is kept to, and what was left out ends with status 1.

use std::process::Command;
use std::thread;
use std::time::Duration;

use eecvs_ros::transport::zenoh::{Links, Router};

use crate::pipeline::scene;
use crate::program::{PATIENCE, Program, free_port};

/// Starts programs that meet.
struct Meeting {
    domain: u16,
    /// Of Zenoh.
    router: Option<String>,
}

impl Meeting {
    fn start(&self, line: &str) -> Program {
        let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs-ros"));
        if let Some(router) = &self.router {
            command.args(["--transport", "zenoh", "--connect", router]);
        }
        let name = line.split(' ').next().unwrap();
        command.args(line.split_whitespace());
        Program::start(name, self.domain, command)
    }

    fn emulate(&self, node: &str, flags: &str) -> Program {
        let size = "--width 120 --height 90 --wait-s 20 --rate 0.5x";
        self.start(&format!(
            "emulate {size} {flags} --ros-args -r __node:={node}"
        ))
    }
}

#[test]
fn the_first_publisher_of_events_is_kept_over_dds() {
    two_publishers(&Meeting {
        domain: 94,
        router: None,
    });
}

#[test]
fn the_first_publisher_of_events_is_kept_over_zenoh() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let links = Links {
        listen: vec![endpoint.clone()],
        ..Links::default()
    };
    let _router = Router::start(&links).unwrap();
    two_publishers(&Meeting {
        domain: 14,
        router: Some(endpoint),
    });
}

fn two_publishers(meeting: &Meeting) {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let encode = meeting.start("encode --window-us 20000");
    let lenient =
        meeting.start("encode --window-us 20000 --allow-loss --ros-args -r __node:=lenient");
    let density = meeting.start("density");
    let record = meeting.start(&format!(
        "record -o {} --topic events:event_camera_msgs/msg/EventPacket",
        bag.display()
    ));
    // Until all have announced themselves: a publisher waits for one of them.
    thread::sleep(Duration::from_secs(3));
    let first = meeting.emulate("first", "--repeat");
    thread::sleep(Duration::from_secs(2));
    let second = meeting.emulate("second", "--repeat --seed 2");
    thread::sleep(Duration::from_secs(3));
    second.terminate();
    second.finish(PATIENCE);
    thread::sleep(Duration::from_millis(500));
    first.terminate();
    first.finish(PATIENCE);
    thread::sleep(Duration::from_secs(1));
    let told = "/event_camera/events has two publishers: /event_camera/first is used, and the \
                messages of /event_camera/second are left out";
    for (name, program, status) in [
        ("encode", encode, 1),
        ("lenient", lenient, 0),
        ("density", density, 1),
    ] {
        program.terminate();
        let (_, said) = program.ends_with(status, PATIENCE);
        assert_eq!(said.matches(told).count(), 1, "{name}: {said}");
        // Neither events nor messages of the first are lost for it.
        assert!(
            said.contains(" messages (0 lost, 0 left out, "),
            "{name}: {said}"
        );
        assert!(
            said.contains(" 0 late") || said.contains(" 0 events late"),
            "{name}: {said}"
        );
        let error = "event messages of another publisher were left out";
        assert_eq!(said.contains(error), status == 1, "{name}: {said}");
    }
    record.terminate();
    let (_, said) = record.finish(PATIENCE);
    let both = "has several publishers, and the bag holds the messages of all of them: \
                /event_camera/first, /event_camera/second";
    assert!(said.contains(both), "{said}");
    assert!(said.contains(", 0 lost"), "{said}");
}

/// A driver that is started again goes on, and nothing is lost.
#[test]
fn another_publisher_follows_the_first() {
    let meeting = Meeting {
        domain: 95,
        router: None,
    };
    let encode = meeting.start("encode --window-us 20000 --idle-s 8");
    thread::sleep(Duration::from_secs(1));
    for node in ["driver", "other"] {
        let emulate = meeting.emulate(node, "--duration-us 300000");
        emulate.finish(PATIENCE);
    }
    let (_, said) = encode.finish(PATIENCE);
    let events = 2 * scene(300_000).len();
    assert!(said.contains(&format!(": {events} events of ")), "{said}");
    assert!(
        said.contains(" messages (0 lost, 0 left out, 0 of another publisher)"),
        "{said}"
    );
    let follows = "/event_camera/driver has gone: /event_camera/other is the publisher from now on";
    assert!(said.contains(follows), "{said}");
}

/// Frames of two encoders are no better.
#[test]
fn the_first_publisher_of_frames_is_kept() {
    let meeting = Meeting {
        domain: 96,
        router: None,
    };
    let decode = meeting.start("decode");
    let encode = meeting.start("encode --window-us 20000");
    let other = meeting.start("encode --window-us 20000 --ros-args -r __node:=other");
    thread::sleep(Duration::from_secs(2));
    meeting.emulate("emulate", "").finish(PATIENCE);
    thread::sleep(Duration::from_secs(1));
    for encode in [encode, other] {
        encode.terminate();
        encode.finish(PATIENCE);
    }
    decode.terminate();
    let (_, said) = decode.ends_with(1, PATIENCE);
    assert!(
        said.contains("/event_camera/frames has two publishers: "),
        "{said}"
    );
    assert!(
        said.contains("/event_camera/encode") && said.contains("/event_camera/other"),
        "{said}"
    );
    assert!(said.contains("frames (0 lost, 0 left out, "), "{said}");
    assert!(
        said.contains("frames of another publisher were left out"),
        "{said}"
    );
}
