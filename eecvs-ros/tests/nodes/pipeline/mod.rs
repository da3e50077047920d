//! A scene through `emulate | encode | decode`, each a program of its own, over any network.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use eecvs_nostd::{Event, Sensor};
use eecvs_ros::message::{EventPacket, Message};
use eecvs_ros::names::NodeName;
use eecvs_ros::packet_reader::{PacketReader, look};
use eecvs_ros::parameters::Parameters;
use eecvs_ros::transport::Transport;
use eecvs_ros::transport::dds::Dds;
use eecvs_ros::transport::zenoh::{Links, Zenoh};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use usb_bridge::stop::Stop;

use crate::program::{PATIENCE, Program, QOS};

/// Where programs meet.
pub struct Network {
    /// ROS 2's domain.
    pub domain: u16,
    /// Of Zenoh: the router of those who send, and that of those who receive.
    pub routers: Option<[String; 2]>,
}

impl Network {
    /// DDS.
    pub const fn dds(domain: u16) -> Self {
        Self {
            domain,
            routers: None,
        }
    }

    /// The test's own transport, among those who receive.
    fn join(&self) -> Arc<dyn Transport> {
        match &self.routers {
            None => Arc::new(Dds::join(self.domain, true).unwrap()),
            Some([_, receive]) => {
                let links = Links {
                    connect: vec![receive.clone()],
                    ..Links::default()
                };
                Arc::new(Zenoh::join(self.domain, &links).unwrap())
            }
        }
    }

    fn start(&self, program: &Path, receives: bool, arguments: &[&str]) -> Program {
        let mut command = Command::new(program);
        if let Some(routers) = &self.routers {
            let router = &routers[usize::from(receives)];
            command.args(["--transport", "zenoh", "--connect", router]);
        }
        command.args(arguments);
        Program::start(arguments[0], self.domain, command)
    }
}

/// The events of a scene as `emulate` publishes it.
pub fn scene(duration_us: u64) -> Vec<Event> {
    let mut config = SceneConfig::model_1(Preset::IndoorFlying, 1);
    config.duration_us = duration_us;
    config.sensor = Sensor::new(120, 90).unwrap();
    let mut reader = emulate(config).unwrap();
    let mut events = Vec::new();
    while reader.read(&mut events).unwrap() > 0 {}
    events
}

/// How often each event occurs: windows order those of equal time anew.
pub fn counted(events: &[Event]) -> BTreeMap<(u64, u16, u16, bool), usize> {
    let mut counts = BTreeMap::new();
    for event in events {
        let polarity = event.polarity == eecvs_nostd::Polarity::On;
        *counts
            .entry((event.t_us, event.y, event.x, polarity))
            .or_default() += 1;
    }
    counts
}

pub fn events(mut reader: PacketReader) -> Vec<Event> {
    let watch = reader.watch();
    let mut events = Vec::new();
    loop {
        let read = reader.read(&mut events).unwrap();
        if read == 0 && reader.pause() == event_files::Pause::Ended {
            break;
        }
    }
    let received = look(&watch);
    assert_eq!((received.sequence.lost, received.refused), (0, 0));
    events
}

/// Publishes the scene at half its speed, once somebody has subscribed.
pub fn emulated(network: &Network, duration_us: u64) -> Program {
    let duration_us = duration_us.to_string();
    let mut arguments = vec!["emulate", "--duration-us", &duration_us];
    arguments.extend("--width 120 --height 90 --wait-s 20 --rate 0.5x".split(' '));
    let program = Path::new(env!("CARGO_BIN_EXE_eecvs-ros"));
    network.start(program, false, &arguments)
}

/// Runs emulate, and encode and decode by `program`, and returns what comes out.
pub fn through_programs(
    program: &Path,
    network: &Network,
    encode: &[&str],
    duration_us: u64,
) -> Vec<Event> {
    let transport = network.join();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = transport.node(&name, &Parameters::none()).unwrap();
    let kind = EventPacket::TYPE;
    let subscription = node.subscription("/event_camera/decoded/events", kind, QOS);
    let decode = network.start(program, true, &["decode", "--idle-s", "3"]);
    let mut arguments = vec!["encode", "--idle-s", "2"];
    arguments.extend(encode);
    let encode = network.start(program, false, &arguments);
    // Until encode and decode have found each other, and the test; then encode is who waits for events.
    std::thread::sleep(Duration::from_secs(2));
    let emulate = emulated(network, duration_us);
    let stop = Stop::default();
    let idle = Some(Duration::from_secs(4));
    let reader = PacketReader::begin(subscription.unwrap(), &stop, idle)
        .unwrap()
        .unwrap();
    let decoded = events(reader);
    for program in [emulate, encode, decode] {
        let (_, errors) = program.finish(PATIENCE);
        eprint!("{errors}");
        assert!(!errors.contains("have not arrived"), "{errors}");
    }
    decoded
}
