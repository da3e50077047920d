//! The nodes as programs of their own, over DDS: every event comes out as it went in.

use std::path::Path;
use std::time::Duration;

use eecvs_nostd::Sensor;
use eecvs_ros::message::{Density, EventPacket, Image, Message, Volume, from_cdr};
use eecvs_ros::names::NodeName;
use eecvs_ros::packet_reader::PacketReader;
use eecvs_ros::parameters::Parameters;
use eecvs_ros::transport::Transport;
use eecvs_ros::transport::dds::Dds;
use event_files::{EventReader, create};
use usb_bridge::stop::Stop;

use crate::pipeline::{self, Network, counted, events, scene, through_programs};
use crate::program::{PATIENCE, Program, QOS};

/// The program.
const EECVS_ROS: &str = env!("CARGO_BIN_EXE_eecvs-ros");

#[test]
fn every_event_comes_through_three_programs() {
    let want = counted(&scene(400_000));
    for (domain, encode) in [
        (60, vec!["--window-us", "10000"]),
        (
            61,
            vec!["--coder", "dense", "--ros-args", "-p", "window_us:=20000"],
        ),
    ] {
        let got = through_programs(
            Path::new(EECVS_ROS),
            &Network::dds(domain),
            &encode,
            400_000,
        );
        let total: usize = want.values().sum();
        assert_eq!(got.len(), total);
        assert!(counted(&got) == want, "other events");
    }
}

/// The example's: a program of its own, in which our operator is one of two.
#[test]
fn an_operator_of_another_crate_is_found_by_its_name() {
    let folder = Path::new(EECVS_ROS).parent().unwrap();
    let program = folder.join("examples/operator");
    let is_there = program.exists();
    assert!(
        is_there,
        "of one test alone, first: cargo build -p eecvs-ros --example operator"
    );
    let encode = ["--operator", "steps", "--window-us", "5000"];
    let got = through_programs(&program, &Network::dds(63), &encode, 200_000);
    assert!(counted(&got) == counted(&scene(200_000)));
}

/// A simulated camera, whose link loses nothing.
#[test]
fn a_cameras_events_are_published() {
    let domain = 64;
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("scene.aedat4");
    let want = scene(300_000);
    let sensor = Sensor::new(346, 260).unwrap();
    let mut writer = create(&recording, sensor).unwrap();
    writer.write(&want).unwrap();
    writer.finish().unwrap();
    let transport = Dds::join(domain, true).unwrap();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = transport.node(&name, &Parameters::none()).unwrap();
    let subscription = node.subscription("/event_camera/events", EventPacket::TYPE, QOS);
    let device = format!("sim:davis346:{}", recording.display());
    // Its first events come before anyone has found it.
    let arguments = [
        "bridge",
        "--device",
        &device,
        "--rate",
        "0.2x",
        "--ros-args",
        "-p",
        "frame_id:=left",
    ];
    let bridge = Program::eecvs_ros(domain, &arguments);
    let stop = Stop::default();
    let idle = Some(Duration::from_secs(3));
    let reader = PacketReader::begin(subscription.unwrap(), &stop, idle);
    let reader = reader.unwrap().unwrap();
    assert_eq!(reader.sensor(), sensor);
    let got = events(reader);
    bridge.finish(PATIENCE);
    let missing = want.len() - got.len();
    assert!(missing < want.len() / 2, "{missing} of {}", want.len());
    assert!(counted(&want[missing..]) == counted(&got));
}

#[test]
fn volumes_pictures_and_densities_are_made_for_those_who_ask() {
    let domain = 62;
    let transport = Dds::join(domain, true).unwrap();
    let name = NodeName::new("/", "test").unwrap();
    let mut node = transport.node(&name, &Parameters::none()).unwrap();
    let mut subscribe = |topic: &str, kind| {
        let topic = format!("/event_camera/{topic}");
        node.subscription(&topic, kind, QOS).unwrap()
    };
    let mut volumes = subscribe("volume", Volume::TYPE);
    let mut images = subscribe("image", Image::TYPE);
    let mut densities = subscribe("density", Density::TYPE);
    let run = Program::eecvs_ros(
        domain,
        &[
            "compose",
            "encode",
            "decode",
            "density",
            "--ros-args",
            "-p",
            "window_us:=20000",
            "-p",
            "idle_s:=2",
            "-p",
            "decode:bins:=5",
            // It keeps the sum of every pixel.
            "-p",
            "encode:transform:=dct",
            "-p",
            "decode:volume_bytes:=98000",
        ],
    );
    // Until they have found the test.
    std::thread::sleep(Duration::from_secs(2));
    for program in [pipeline::emulated(&Network::dds(domain), 400_000), run] {
        eprint!("{}", program.finish(PATIENCE).1);
    }
    let taken = |subscription: &mut dyn eecvs_ros::transport::Subscription| {
        let first = subscription
            .take(Duration::from_secs(2))
            .unwrap()
            .expect("a message");
        let mut all = vec![first];
        while let Some(next) = subscription.take(Duration::from_secs(2)).unwrap() {
            all.push(next);
        }
        all
    };
    let volumes: Vec<Volume> = taken(volumes.as_mut())
        .iter()
        .map(|cdr| from_cdr(cdr).unwrap())
        .collect();
    let images = taken(images.as_mut());
    let densities: Vec<Density> = taken(densities.as_mut())
        .iter()
        .map(|cdr| from_cdr(cdr).unwrap())
        .collect();

    let want = scene(400_000);
    let counted: usize = densities
        .iter()
        .map(|density| density.events as usize)
        .sum();
    assert_eq!(counted, want.len());
    assert_eq!(densities[0].t0_us, want[0].t_us);
    for density in &densities {
        let per_pixel_s = f64::from(density.events) / (120.0 * 90.0) / 0.02;
        assert!((density.density - per_pixel_s).abs() < 1e-9 * per_pixel_s);
    }

    // 5 bins of 120 x 90 are 216,000 bytes, in messages of 98,000.
    assert_eq!(volumes.len(), 3 * densities.len());
    let mut sum = 0.0;
    for parts in volumes.chunks(3) {
        let lengths: Vec<usize> = parts.iter().map(|part| part.values.len()).collect();
        assert_eq!(lengths, [24_500, 24_500, 5000]);
        assert_eq!(parts[2].offset, 49_000);
        assert_eq!(parts[0].layout, "bins");
        sum += parts
            .iter()
            .flat_map(|part| &part.values)
            .map(|value| f64::from(*value))
            .sum::<f64>();
    }
    let signed: i64 = want
        .iter()
        .map(|event| i64::from(event.polarity == eecvs_nostd::Polarity::On) * 2 - 1)
        .sum();
    assert!((sum - signed as f64).abs() < 1.0, "{sum} {signed}");

    let image: Image = from_cdr(&images[0]).unwrap();
    assert_eq!((image.width, image.height, image.step), (120, 90, 120));
    assert_eq!(
        (image.encoding.as_str(), image.data.len()),
        ("mono8", 120 * 90)
    );
    assert!(image.data.contains(&255));
    assert!(image.data.contains(&128));
}
