//! `play` plays every bag that the reader of recordings reads, or ends with an error that says why not.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Parser;
use eecvs_nostd::{Event, Sensor};
use eecvs_ros::arguments::RosArguments;
use eecvs_ros::message::{EventPacket, Header, Message, Time, to_cdr};
use eecvs_ros::names::NodeName;
use eecvs_ros::node::play::Play;
use eecvs_ros::node::{Context, NAMESPACE};
use eecvs_ros::packet_reader::PacketReader;
use eecvs_ros::packing::{Encoding, Packer, PacketLimits};
use eecvs_ros::parameters::Parameters;
use eecvs_ros::transport::Transport;
use eecvs_ros::transport::local::Local;
use event_files::{create, open};
use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions};
use serde::Serialize;
use usb_bridge::stop::Stop;

use crate::pipeline::{events, scene};
use crate::program::QOS;

#[derive(Parser)]
struct PlayLine {
    #[command(flatten)]
    play: Play,
}

const SENSOR: Sensor = Sensor {
    width: 120,
    height: 90,
};

/// Plays a bag as fast as possible, on other topics' own names; the events of `/dvs/events`, if any, and the outcome.
fn played(bag: &Path, flags: &str) -> (Vec<Event>, Result<(), String>) {
    let local = Local::alone();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = local.node(&name, &Parameters::none()).unwrap();
    let subscription = node.subscription("/dvs/events", EventPacket::TYPE, QOS);
    let subscription = subscription.unwrap();
    let line = format!("play {} --rate max {flags}", bag.display());
    let play = PlayLine::parse_from(line.split_whitespace()).play;
    let arguments = RosArguments::default().node(NAMESPACE, "play", &[]);
    let context = Context::new(
        &local,
        arguments.unwrap(),
        Parameters::none(),
        Stop::default(),
    );
    let outcome = play.run(context.unwrap());
    let outcome = outcome.map_err(|error| format!("{error:#}"));
    // All messages are in the queue; where there are none, nothing is waited for.
    let stop = Stop::default();
    let ends = stop.clone();
    std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(500));
        ends.ask();
    });
    let idle = Some(Duration::from_millis(300));
    match PacketReader::begin(subscription, &stop, idle).unwrap() {
        Ok(reader) => (events(reader), outcome),
        Err(received) => {
            assert_eq!(received.refused, 0);
            (Vec::new(), outcome)
        }
    }
}

/// A scene as packets.
fn packets(events: &[Event]) -> Vec<Vec<u8>> {
    let limits = PacketLimits {
        bytes: 20_000,
        span_us: 1000,
    };
    let mut packer = Packer::new(SENSOR, Encoding::Libcaer, limits, "left");
    let mut all = Vec::new();
    let mut keep = |packet: &EventPacket, _| {
        all.push(to_cdr(packet));
        Ok(())
    };
    packer.push(events, &mut keep).unwrap();
    packer.flush(&mut keep).unwrap();
    all
}

#[derive(Serialize)]
struct Array {
    header: Header,
    height: u32,
    width: u32,
    events: Vec<Single>,
}

#[derive(Serialize)]
struct Single {
    x: u16,
    y: u16,
    ts: Time,
    polarity: bool,
}

/// A scene with a structure for each event.
fn arrays(events: &[Event]) -> Vec<Vec<u8>> {
    let array = |events: &[Event]| {
        let single = |event: &Event| Single {
            x: event.x,
            y: event.y,
            ts: Time::from_ns(event.t_us as i64 * 1000),
            polarity: event.polarity == eecvs_nostd::Polarity::On,
        };
        let array = Array {
            header: Header::default(),
            height: SENSOR.height.into(),
            width: SENSOR.width.into(),
            events: events.iter().map(single).collect(),
        };
        let mut cdr = vec![0, 1, 0, 0];
        cdr_encoding::to_writer::<_, byteorder::LittleEndian, _>(&mut cdr, &array).unwrap();
        cdr
    };
    events.chunks(3000).map(array).collect()
}

/// Topics of a bag: name, type, serialisation, messages.
type Topics<'t> = [(&'t str, &'t str, &'t str, &'t [Vec<u8>])];

fn write_mcap(path: &Path, options: WriteOptions, topics: &Topics<'_>) {
    let file = BufWriter::new(File::create(path).unwrap());
    let mut writer = options.profile("ros2").create(file).unwrap();
    for (name, kind, encoding, messages) in topics {
        let schema = writer.add_schema(kind, "ros2msg", b"").unwrap();
        let channel = writer
            .add_channel(schema, name, encoding, &BTreeMap::new())
            .unwrap();
        for (number, message) in messages.iter().enumerate() {
            let header = MessageHeader {
                channel_id: channel,
                sequence: number as u32,
                log_time: 5_000_000_000 + number as u64 * 1_000_000,
                publish_time: 0,
            };
            writer.write_to_known_channel(&header, message).unwrap();
        }
    }
    writer.finish().unwrap();
}

/// As rosbag2 wrote databases before it knew hashes.
fn write_db3(path: &Path, kind: &str, messages: &[Vec<u8>]) {
    let connection = rusqlite::Connection::open(path).unwrap();
    let tables = "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT,
                      serialization_format TEXT, offered_qos_profiles TEXT);
                  CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER,
                      timestamp INTEGER, data BLOB); BEGIN;";
    connection.execute_batch(tables).unwrap();
    let row = "INSERT INTO topics VALUES (3, '/dvs/events', ?1, 'cdr', '')";
    connection.execute(row, [kind]).unwrap();
    for (number, message) in messages.iter().enumerate() {
        let row = "INSERT INTO messages VALUES (?1, 3, ?2, ?3)";
        // Of a clock that began before 1970.
        let values = rusqlite::params![
            number as i64,
            number as i64 * 1_000_000 - 10_000_000,
            message
        ];
        connection.execute(row, values).unwrap();
    }
    connection.execute_batch("COMMIT").unwrap();
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    zstd::encode_all(bytes, 3).unwrap()
}

/// A folder with one file, whose metadata tell how it is compressed.
fn folder_with(path: &Path, file: &str, mode: &str, content: &[u8]) -> PathBuf {
    std::fs::create_dir(path).unwrap();
    let metadata = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: x\n  relative_file_paths:\n    - {file}\n  \
         compression_format: zstd\n  compression_mode: {mode}\n"
    );
    std::fs::write(path.join("metadata.yaml"), metadata).unwrap();
    std::fs::write(path.join(file), content).unwrap();
    path.to_owned()
}

#[test]
fn whatever_is_read_is_played() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let want = scene(200_000);
    let (packets, arrays) = (packets(&want), arrays(&want));
    let small = || WriteOptions::new().chunk_size(Some(50_000));
    let now = EventPacket::TYPE.name;
    let mut bags = Vec::new();
    for (name, options) in [
        ("no-chunks", small().use_chunks(false)),
        (
            "no-summary",
            small().use_chunks(false).emit_summary_records(false),
        ),
        ("plain", small().compression(None)),
        ("lz4", small().compression(Some(Compression::Lz4))),
        ("zstd", small().compression(Some(Compression::Zstd))),
        (
            "zstd-no-index",
            small()
                .compression(Some(Compression::Zstd))
                .emit_chunk_indexes(false),
        ),
        ("no-repeat", small().repeat_channels(false)),
    ] {
        let bag = path(&format!("{name}.mcap"));
        write_mcap(&bag, options, &[("/dvs/events", now, "cdr", &packets)]);
        bags.push(bag);
    }
    // What counts is the content.
    let renamed = path("renamed");
    std::fs::copy(path("zstd.mcap"), &renamed).unwrap();
    bags.push(renamed);
    for (number, (kind, messages)) in [
        ("event_camera_msgs/EventPacket", &packets),
        ("event_array_msgs/msg/EventArray", &packets),
        ("dvs_msgs/msg/EventArray", &arrays),
        ("prophesee_event_msgs/msg/EventArray", &arrays),
    ]
    .into_iter()
    .enumerate()
    {
        let bag = path(&format!("kind{number}.mcap"));
        write_mcap(&bag, small(), &[("/dvs/events", kind, "cdr", messages)]);
        bags.push(bag);
        let bag = path(&format!("kind{number}.db3"));
        write_db3(&bag, kind, messages);
        bags.push(bag);
    }
    let packed: Vec<Vec<u8>> = packets.iter().map(|message| zstd(message)).collect();
    write_db3(&path("packed.db3"), now, &packed);
    let read = |name: &str| std::fs::read(path(name)).unwrap();
    let packed = read("packed.db3");
    bags.push(folder_with(
        &path("by-message"),
        "a_0.db3",
        "MESSAGE",
        &packed,
    ));
    let file = zstd(&read("zstd.mcap"));
    bags.push(folder_with(
        &path("by-file"),
        "a_0.mcap.zstd",
        "FILE",
        &file,
    ));
    let file = read("kind1.db3");
    bags.push(folder_with(&path("plain"), "a_0.db3", "\"\"", &file));
    for bag in bags {
        let mut reader = open(&bag, None).unwrap();
        let mut read = Vec::new();
        while reader.read(&mut read).unwrap() > 0 {}
        assert!(read == want, "{}: read otherwise", bag.display());
        let (got, outcome) = played(&bag, "");
        assert_eq!(outcome, Ok(()), "{}", bag.display());
        assert!(got == want, "{}: {} events", bag.display(), got.len());
    }
}

#[test]
fn what_cannot_be_played_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let want = scene(50_000);
    let packets = packets(&want);
    let now = EventPacket::TYPE.name;
    // A type that is not known here is published as it is; a serialisation of ROS 1 is not.
    let others = vec![vec![0, 1, 0, 0, 7, 0, 0, 0]; 5];
    let mixed = path("mixed.mcap");
    let topics: &Topics<'_> = &[
        ("/dvs/events", now, "cdr", &packets),
        ("/dvs/other", "some_msgs/msg/Other", "cdr", &others),
        ("/dvs/old", "some_msgs/Old", "ros1", &others),
    ];
    write_mcap(&mixed, WriteOptions::new(), topics);
    let (got, outcome) = played(&mixed, "");
    assert!(got == want);
    let error = outcome.unwrap_err();
    assert!(
        error.contains("5 messages were left out; with --allow-loss"),
        "{error}"
    );
    assert_eq!(played(&mixed, "--allow-loss").1, Ok(()));
    let known = path("known.mcap");
    write_mcap(&known, WriteOptions::new(), &topics[..2]);
    assert_eq!(played(&known, "").1, Ok(()));

    // All of it, up to the damage.
    let whole = path("whole.mcap");
    write_mcap(&whole, WriteOptions::new().use_chunks(false), &topics[..1]);
    let bytes = std::fs::read(&whole).unwrap();
    let cut = path("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let (got, outcome) = played(&cut, "");
    assert!(
        got.len() > want.len() / 3 && want.starts_with(&got),
        "{}",
        got.len()
    );
    assert!(outcome.unwrap_err().contains("cut.mcap"));

    let empty = path("empty.mcap");
    write_mcap(
        &empty,
        WriteOptions::new(),
        &[("/dvs/events", now, "cdr", &[])],
    );
    assert!(
        played(&empty, "")
            .1
            .unwrap_err()
            .contains("no messages to play")
    );
    let late = played(&known, "--start-s 100").1.unwrap_err();
    assert!(late.contains("no messages to play from 100 s on"), "{late}");
    for (name, why) in [
        ("a.bag", "a ROS 1 bag"),
        ("a.raw", "emulate --recording"),
        ("a.aedat4", "emulate --recording"),
    ] {
        let mut writer = create(&path(name), SENSOR).unwrap();
        writer.write(&want).unwrap();
        writer.finish().unwrap();
        let error = played(&path(name), "").1.unwrap_err();
        assert!(error.contains(name) && error.contains(why), "{error}");
    }
    for name in ["nowhere.mcap", "."] {
        assert!(
            played(&path(name), "")
                .1
                .unwrap_err()
                .contains("cannot be read"),
            "{name}"
        );
    }
}
