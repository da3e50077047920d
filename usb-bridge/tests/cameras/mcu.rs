//! The encoder's stream: frames in any pieces, with packets between them, and faults.
//!
//! Recordings are skipped, with a notice, where the shared ones are absent.

use std::path::Path;
use std::sync::LazyLock;

use eecvs::frame_file::FrameReader;
use eecvs_nostd::event_link::{Kind, Status};
use eecvs_nostd::{Event, Polarity, Sensor};
use mcu_link::link::packet;
use proptest::prelude::*;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use usb_bridge::device::mcu::parse::McuParser;
use usb_bridge::device::mcu::write::McuStream;
use usb_bridge::device::mcu::{ANY_SENSOR, MCU};
use usb_bridge::device::{Model, Parse, WriteStream, find, recognise};

const SENSOR: Sensor = Sensor {
    width: 320,
    height: 240,
};

fn bytes_of(sensor: Sensor, events: &[Event]) -> Vec<u8> {
    let (mut writer, mut bytes) = (McuStream::new(sensor), Vec::new());
    for batch in events.chunks(1000) {
        writer.write(batch, &mut bytes).unwrap();
    }
    writer.finish(&mut bytes).unwrap();
    bytes
}

/// A moving edge: windows of some hundred events.
fn scene(count: u64, start_us: u64) -> Vec<Event> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
    let event = |at: u64| Event {
        t_us: start_us + at * 97 + u64::from(random.next_u32() % 97),
        x: ((at / 7 + u64::from(random.next_u32() % 9)) % 320) as u16,
        y: (random.next_u32() % 240) as u16,
        polarity: Polarity::from_bool(random.next_u32().is_multiple_of(2)),
    };
    (0..count).map(event).collect()
}

static SCENE: LazyLock<(Vec<Event>, Vec<u8>)> = LazyLock::new(|| {
    let events = scene(30_000, 5);
    let bytes = bytes_of(SENSOR, &events);
    (events, bytes)
});

fn sorted(mut events: Vec<Event>) -> Vec<Event> {
    events.sort_unstable();
    events
}

/// The bytes of each frame.
fn frames(bytes: &[u8]) -> Vec<&[u8]> {
    let mut reader = FrameReader::new(bytes);
    let mut found = Vec::new();
    while let Some(located) = reader.next_frame().unwrap() {
        let start = located.offset as usize;
        found.push(&bytes[start..start + located.frame.bytes]);
    }
    assert!(reader.report().is_clean());
    found
}

#[test]
fn it_is_found() {
    let model = recognise(0x1209, 1, 0x0010).unwrap();
    assert_eq!(model.name(), "eecvs");
    assert!(find("eecvs").is_some());
    assert!(MCU.writer(SENSOR).is_some());
}

#[test]
fn recordings_return() {
    for path in [
        "davis346_building_dense/davis.aedat4",
        "davis240_boxes_moderate/IMU_translBoxes.aedat",
        "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
        "gen3_vga_dense_evt2/evt2.raw",
        "imx636_sparse_evt3/evt3.raw",
    ] {
        let file = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../shared/data")
            .join(path);
        if !file.exists() {
            eprintln!("skipped: {} is absent", file.display());
            continue;
        }
        let mut reader = event_files::open(&file, None).unwrap();
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        let bytes = bytes_of(reader.sensor(), &events);
        let (mut parser, mut found) = (McuParser::new(ANY_SENSOR), Vec::new());
        for piece in bytes.chunks(4096) {
            parser.parse(piece, &mut found);
        }
        assert!(sorted(found) == sorted(events), "{path}");
        assert_eq!(parser.losses().iter().collect::<Vec<_>>(), []);
        assert_eq!(parser.sensor(), reader.sensor());
    }
}

#[test]
fn times_beyond_32_bits_return() {
    let events = scene(3000, (1 << 40) + 7);
    let bytes = bytes_of(SENSOR, &events);
    let (mut parser, mut found) = (McuParser::new(ANY_SENSOR), Vec::new());
    parser.parse(&bytes, &mut found);
    assert!(found.is_sorted_by_key(|event| event.t_us));
    assert!(parser.time_us() > events.last().map(|event| event.t_us));
    assert_eq!(sorted(found), sorted(events));
}

#[test]
fn packets_of_status_are_no_damage() {
    let (events, bytes) = &*SCENE;
    let mut body = [0; 112];
    let length = Status::default().write(&mut body).unwrap();
    let status = packet(Kind::Status, 0, &body[..length]).unwrap();
    let mut stream = status.clone();
    for (at, frame) in frames(bytes).into_iter().enumerate() {
        stream.extend(frame);
        if at.is_multiple_of(3) {
            stream.extend(&status);
        }
    }
    let (mut parser, mut found) = (McuParser::new(SENSOR), Vec::new());
    for piece in stream.chunks(61) {
        parser.parse(piece, &mut found);
    }
    assert_eq!(sorted(found), sorted(events.clone()));
    assert_eq!(parser.losses().iter().count(), 0);
    let words: Vec<_> = parser.words().iter().map(|(name, _)| name).collect();
    assert_eq!(words, ["frames", "packets of status"]);
    // A sensor that is not this one's.
    let mut small = McuParser::new(Sensor::new(128, 128).unwrap());
    let mut none = Vec::new();
    small.parse(bytes, &mut none);
    assert!(none.is_empty());
    let lost: Vec<_> = small.losses().iter().collect();
    assert_eq!(
        lost,
        [("frames of another sensor", frames(bytes).len() as u64)]
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn any_pieces_give_the_same(cut in prop_oneof![1..200_usize, 1..20_000_usize]) {
        let (events, bytes) = &*SCENE;
        let (mut parser, mut found) = (McuParser::new(ANY_SENSOR), Vec::new());
        for piece in bytes.chunks(cut) {
            parser.parse(piece, &mut found);
        }
        prop_assert_eq!(sorted(found), sorted(events.clone()));
    }

    #[test]
    fn any_bytes_are_survived(
        bytes in proptest::collection::vec(
            prop_oneof![any::<u8>(), Just(0xEE), Just(0xC5), Just(0xC6), 0..4_u8], 0..3000),
        cut in 1..300_usize, breaks in any::<bool>(),
    ) {
        let mut parser = McuParser::new(ANY_SENSOR);
        let mut found = Vec::new();
        for piece in bytes.chunks(cut) {
            parser.parse(piece, &mut found);
            if breaks {
                parser.resume(None);
            }
        }
        parser.resume(None);
        // All is accounted for: bytes of no message, and of packets by chance.
        let damaged: u64 = parser.losses().iter().filter(|(name, _)| *name == "damaged bytes").map(|(_, n)| n).sum();
        prop_assert!(damaged <= bytes.len() as u64);
        prop_assert!(damaged == bytes.len() as u64 || parser.words().iter().count() > 0);
    }
}

/// Every fault costs the frames that it touches, and no other.
#[test]
fn after_faults_frames_are_right_at_once() {
    let (_, bytes) = &*SCENE;
    let frames = frames(bytes);
    assert!(frames.len() > 50);
    // Events of each frame: lossless frames of the fast coder decode by themselves.
    let alone: Vec<Vec<Event>> = frames
        .iter()
        .map(|frame| {
            let (mut parser, mut found) = (McuParser::new(SENSOR), Vec::new());
            parser.parse(frame, &mut found);
            found
        })
        .collect();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(9);
    let (mut parser, mut at) = (McuParser::new(SENSOR), 0);
    let mut found = Vec::new();
    for fault in 0..10_000 {
        if at + 4 > frames.len() {
            parser = McuParser::new(SENSOR);
            at = 0;
        }
        found.clear();
        let frame = frames[at];
        let mut damaged = frame.to_vec();
        let place = random.next_u32() as usize % frame.len();
        match random.next_u32() % 6 {
            // Lost, and the link knows.
            0 => parser.resume(None),
            // Lost, and nobody knows.
            1 => {}
            2 => {
                damaged[place] ^= 1 << (random.next_u32() % 8);
                parser.parse(&damaged, &mut found);
            }
            3 => {
                parser.parse(frame, &mut found);
                parser.parse(frame, &mut found);
                assert_eq!(found, alone[at], "{fault}: once");
            }
            4 => {
                damaged.truncate(place);
                parser.parse(&damaged, &mut found);
                parser.resume(None);
            }
            _ => {
                // Cut off, and nobody knows: what follows seems to belong to it.
                damaged.truncate(place);
                parser.parse(&damaged, &mut found);
            }
        }
        at += 1;
        // Within one frame: the second that follows is there at the latest.
        found.clear();
        parser.parse(frames[at], &mut found);
        parser.parse(frames[at + 1], &mut found);
        parser.parse(frames[at + 2], &mut found);
        at += 3;
        let all: Vec<Event> = alone[at - 3..at].concat();
        assert!(
            found == all || all.ends_with(&found) && found.ends_with(&alone[at - 1]),
            "{fault}: {} events of {}",
            found.len(),
            all.len()
        );
    }
}

#[test]
fn losses_have_names() {
    let (_, bytes) = &*SCENE;
    let frames = frames(bytes);
    let (mut parser, mut found) = (McuParser::new(SENSOR), Vec::new());
    parser.parse(frames[0], &mut found);
    parser.parse(&[1, 2, 3], &mut found);
    parser.parse(frames[2], &mut found);
    parser.parse(frames[2], &mut found);
    parser.parse(&frames[3][..30], &mut found);
    parser.resume(None);
    parser.parse(frames[4], &mut found);
    let losses: Vec<_> = parser.losses().iter().collect();
    assert_eq!(
        losses,
        [
            ("damaged bytes", 33),
            ("damaged places", 2),
            ("frames lost", 2),
            ("frames that came twice", 1),
        ]
    );
}
