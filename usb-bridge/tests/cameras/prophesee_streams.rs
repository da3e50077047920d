//! Streams of Prophesee's cameras: each parser against its writer, recordings, and faults.
//!
//! Recordings are skipped, with a notice, where the shared ones are absent.

use std::path::{Path, PathBuf};

use eecvs_nostd::{Event, Polarity, Sensor};
use event_types::evt21::Order;
use proptest::prelude::*;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use usb_bridge::device::prophesee::parse_evt3::Evt3Parser;
use usb_bridge::device::prophesee::parse_evt21::Evt21Parser;
use usb_bridge::device::prophesee::write_evt3::Evt3Stream;
use usb_bridge::device::prophesee::write_evt21::Evt21Stream;
use usb_bridge::device::{Parse, WriteStream};

const HD: Sensor = Sensor {
    width: 1280,
    height: 720,
};

/// The streams under test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stream {
    Evt3,
    Evt21(Order),
}

const STREAMS: [Stream; 3] = [
    Stream::Evt3,
    Stream::Evt21(Order::UpperFirst),
    Stream::Evt21(Order::Little),
];

enum Parser {
    Evt3(Evt3Parser),
    Evt21(Evt21Parser),
}

impl Parser {
    fn parse(&mut self) -> &mut dyn Parse {
        match self {
            Self::Evt3(parser) => parser,
            Self::Evt21(parser) => parser,
        }
    }

    fn words_seen(&self) -> u64 {
        match self {
            Self::Evt3(parser) => parser.words_seen(),
            Self::Evt21(parser) => parser.words_seen(),
        }
    }
}

impl Stream {
    fn parser(self, sensor: Sensor) -> Parser {
        match self {
            Self::Evt3 => Parser::Evt3(Evt3Parser::new(sensor)),
            Self::Evt21(order) => Parser::Evt21(Evt21Parser::new(sensor, order)),
        }
    }

    fn writer(self, sensor: Sensor) -> Box<dyn WriteStream> {
        match self {
            Self::Evt3 => Box::new(Evt3Stream::new(sensor)),
            Self::Evt21(order) => Box::new(Evt21Stream::new(sensor, order)),
        }
    }

    const fn word_bytes(self) -> usize {
        match self {
            Self::Evt3 => 2,
            Self::Evt21(_) => 8,
        }
    }

    /// Words that tell the upper time, as a word of the stream.
    fn is_time(self, word: &[u8]) -> bool {
        match self {
            Self::Evt3 => word[1] >> 4 == 8,
            Self::Evt21(Order::UpperFirst) => word[3] >> 4 == 8,
            Self::Evt21(Order::Little) => word[7] >> 4 == 8,
        }
    }

    fn bytes(self, sensor: Sensor, events: &[Event]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut writer = self.writer(sensor);
        // In batches, as a recording is read.
        for batch in events.chunks(1000) {
            writer.write(batch, &mut bytes).expect("events that fit");
        }
        writer.finish(&mut bytes).expect("an end");
        bytes
    }
}

/// Every kind that the shared data has, and whether the recording is of the camera's own size.
const RECORDINGS: [&str; 9] = [
    "imx636_sparse_evt3/evt3.raw",
    "gen3_vga_dense_evt2/evt2.raw",
    "davis346_static_sparse/davis346.aedat4",
    "davis346_building_dense/davis.aedat4",
    "dvxl_person_moderate/data_sample.aedat4",
    "davis240_boxes_moderate/IMU_translBoxes.aedat",
    "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
    "dvs128_walking_sparse/neal_walking.aedat",
    "dvs128_standup/cam255_alex_standing_up2.aedat",
];

fn shared(path: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../shared/data")
        .join(path);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: {} is absent", path.display());
    None
}

fn events_of(path: &Path) -> Vec<Event> {
    let mut reader = event_files::open(path, None).expect("a recording");
    let mut events = Vec::new();
    while reader.read(&mut events).expect("a recording") > 0 {}
    events
}

/// With times from `start_us` on.
fn rebased(mut events: Vec<Event>, start_us: u64) -> Vec<Event> {
    let first_us = events.iter().map(|event| event.t_us).min().unwrap_or(0);
    for event in &mut events {
        event.t_us = event.t_us - first_us + start_us;
    }
    events
}

fn parsed(parser: &mut Parser, bytes: &[u8], cut: usize) -> Vec<Event> {
    let mut events = Vec::new();
    for piece in bytes.chunks(cut) {
        parser.parse().parse(piece, &mut events);
    }
    events
}

#[test]
fn recordings_return() {
    for path in RECORDINGS {
        let Some(path) = shared(path) else { continue };
        // Before, at and after 2^31 us, the signed end of 32 bits, and many wraps of 2^24.
        for start_us in [0, (1 << 31) - 50_000, (1 << 32) + 7] {
            let events = rebased(events_of(&path), start_us);
            for stream in STREAMS {
                let bytes = stream.bytes(HD, &events);
                let mut parser = stream.parser(HD);
                let found = parsed(&mut parser, &bytes, 16_384);
                assert!(found == events, "{} {stream:?}", path.display());
                assert_eq!(parser.parse().losses().iter().count(), 0);
                assert_eq!(parser.parse().events(), events.len() as u64);
                assert_eq!(
                    parser.words_seen(),
                    (bytes.len() / stream.word_bytes()) as u64
                );
            }
        }
    }
}

/// The bytes that a camera sent, as a file has them.
#[test]
fn a_cameras_own_bytes_are_parsed_as_its_file_is_read() {
    let Some(path) = shared("imx636_sparse_evt3/evt3.raw") else {
        return;
    };
    let bytes = std::fs::read(&path).unwrap();
    let mut start = 0;
    while bytes[start] == b'%' {
        start += bytes[start..].iter().position(|b| *b == b'\n').unwrap() + 1;
    }
    let expected = events_of(&path);
    for cut in [1, 7, 4096, 131_072] {
        let mut parser = Stream::Evt3.parser(HD);
        assert!(parsed(&mut parser, &bytes[start..], cut) == expected);
        assert_eq!(parser.parse().losses().iter().count(), 0);
        let words: Vec<_> = parser.parse().words().iter().collect();
        for known in [
            ("other words", 134_599),
            ("continued words", 107_680 + 215_360),
            ("times, upper bits", 673_000),
            ("times, lower bits", 1_115_492),
            ("rows", 1_215_631),
            ("vectors' first columns", 648),
        ] {
            assert!(words.contains(&known), "{known:?} {words:?}");
        }
        assert_eq!(parser.words_seen(), 4_681_676);
    }
}

fn any_event() -> impl Strategy<Value = (i64, u16, u16, bool)> {
    let step = prop_oneof![
        8 => Just(0_i64),
        4 => 0..20_i64,
        2 => -12..0_i64,
        1 => 0..20_000_000_i64,
    ];
    let x = prop_oneof![0..1280_u16, 100..140_u16, 1240..1280_u16];
    (step, x, prop_oneof![0..720_u16, 5..7_u16], any::<bool>())
}

fn events_from(start_us: u64, steps: Vec<(i64, u16, u16, bool)>) -> Vec<Event> {
    let mut t_us = start_us;
    let event = |(step, x, y, on)| {
        t_us = t_us.saturating_add_signed(step);
        Event {
            t_us,
            x,
            y,
            polarity: Polarity::from_bool(on),
        }
    };
    steps.into_iter().map(event).collect()
}

/// The word of row 0 is 0: it counts before the first time is trusted, too.
#[test]
fn row_0_is_a_row_from_the_first_word_on() {
    for stream in STREAMS {
        let steps = vec![
            (0, 5, 1, true),
            (0, 5, 0, true),
            (0, 6, 0, false),
            (0, 5, 1, true),
        ];
        let events = events_from(7, steps);
        let bytes = stream.bytes(HD, &events);
        assert_eq!(
            parsed(&mut stream.parser(HD), &bytes, 1 << 20),
            events,
            "{stream:?}"
        );
    }
}

fn any_stream() -> impl Strategy<Value = Stream> {
    prop_oneof![Just(STREAMS[0]), Just(STREAMS[1]), Just(STREAMS[2])]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Equal times, duplicates, neighbours, steps back, wraps, in any pieces.
    #[test]
    fn what_is_written_is_parsed(
        stream in any_stream(),
        start_us in prop_oneof![Just(0), 0..1_u64 << 36],
        steps in proptest::collection::vec(any_event(), 0..200),
        cut in prop_oneof![1..40_usize, Just(1 << 20)],
    ) {
        let events = events_from(start_us, steps);
        let bytes = stream.bytes(HD, &events);
        let mut parser = stream.parser(HD);
        prop_assert_eq!(parsed(&mut parser, &bytes, cut), events);
        prop_assert_eq!(parser.parse().losses().iter().count(), 0);
    }

    /// Gaps beyond 2^31 us, walked through word by word or in large steps.
    #[test]
    fn long_silences_are_carried(
        stream in any_stream(),
        gaps in proptest::collection::vec(
            prop_oneof![1 << 31..1_u64 << 32, 1 << 32..1_u64 << 36, 0..1_u64 << 25], 1..3),
    ) {
        let mut t_us = 5;
        let mut events = events_from(t_us, vec![(0, 3, 4, true)]);
        for gap in gaps {
            t_us += gap;
            events.extend(events_from(t_us, vec![(0, 3, 4, true), (1, 4, 4, false)]));
        }
        let bytes = stream.bytes(HD, &events);
        prop_assert_eq!(parsed(&mut stream.parser(HD), &bytes, 65_536), events);
    }

    /// Any bytes: every word is accounted for, in any pieces alike.
    #[test]
    fn any_bytes_are_survived(
        stream in any_stream(),
        bytes in proptest::collection::vec(any::<u8>(), 0..3000),
        cut in 1..300_usize,
        breaks in proptest::collection::vec((0..3000_usize, proptest::option::of(any::<u64>())), 0..3),
        sensor in prop_oneof![Just(HD), Just(Sensor { width: 2048, height: 2048 }), Just(Sensor { width: 1, height: 1 })],
    ) {
        let (mut whole, mut pieces) = (stream.parser(sensor), stream.parser(sensor));
        prop_assert_eq!(parsed(&mut whole, &bytes, 1 << 20), parsed(&mut pieces, &bytes, cut));
        prop_assert_eq!(whole.parse().words(), pieces.parse().words());
        prop_assert_eq!(whole.parse().losses(), pieces.parse().losses());
        prop_assert_eq!(whole.words_seen(), (bytes.len() / stream.word_bytes()) as u64);
        // With breaks: what is left of words is counted.
        let mut parser = stream.parser(sensor);
        let (mut events, mut at) = (Vec::new(), 0);
        for (to, now_us) in breaks {
            let to = to.clamp(at, bytes.len());
            parser.parse().parse(&bytes[at..to], &mut events);
            parser.parse().resume(now_us);
            at = to;
        }
        parser.parse().parse(&bytes[at..], &mut events);
        prop_assert!(events.iter().all(|event| sensor.contains(event.x, event.y)));
        prop_assert_eq!(parser.parse().events(), events.len() as u64);
        parser.parse().resume(None);
        let losses = parser.parse().losses();
        let rest = losses.iter().find(|(name, _)| *name == "bytes of an incomplete word");
        let in_words = parser.words_seen() * stream.word_bytes() as u64;
        prop_assert_eq!(in_words + rest.map_or(0, |(_, count)| count), bytes.len() as u64);
    }
}

/// Words of the common kinds only, so that runs of them are long: the file's reader makes the same of them.
#[test]
fn a_files_reader_makes_the_same_of_any_words() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    for _ in 0..60 {
        let mut high = 100_u16;
        let mut words = vec![0x8000 | high];
        for _ in 0..5000 {
            let value = random.next_u32();
            let side = value as u16 & 0x3ff;
            words.push(match value >> 28 {
                0..2 => side % 720,
                2..6 => 0x2000 | (value as u16 & 0x800) | side,
                6..8 => 0x6000 | (value as u16 & 0xfff),
                8 => 0x8000 | high,
                9 => {
                    high = (high + 1 + (value as u16 & 1)) % 4096;
                    0x8000 | high
                }
                10 => 0x3000 | (value as u16 & 0xb7f),
                11..13 => 0x4000 | (value as u16 & 0xfff),
                13 => 0x5000 | (value as u16 & 0xff),
                14 => 0x7000 | (value as u16 & 0xfff) | (value as u16 & 0x8000),
                _ => 0xe000 | (value as u16 & 0xfff),
            });
        }
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let mut file = b"% evt 3.0\n% geometry 2048x2048\n".to_vec();
        file.extend(&bytes);
        let source = Box::new(std::io::Cursor::new(file));
        let mut reader = event_files::open_source(source, "words", None).unwrap();
        let mut expected = Vec::new();
        let ended = loop {
            match reader.read(&mut expected) {
                Ok(0) => break true,
                Ok(_) => (),
                // A vector that ran beyond any sensor.
                Err(_) => break false,
            }
        };
        let sensor = Sensor::new(2048, 2048).unwrap();
        let mut parser = Stream::Evt3.parser(sensor);
        let found = parsed(&mut parser, &bytes, 999);
        if ended {
            assert_eq!(found, expected);
        } else {
            assert_eq!(found[..expected.len()], expected);
        }
    }
}

/// A fault between two transfers, or in one.
#[derive(Debug, Clone, Copy)]
enum Fault {
    /// The link knows that it lost a transfer.
    Dropped,
    /// Bits are wrong, and nobody knows.
    Flipped,
    Twice,
    Swapped,
    /// The end of a transfer is missing, and the link knows.
    Short,
}

/// One fault after the other; after each, what follows the next word of time is right again.
fn faults(stream: Stream, events: &[Event], count: u32, seed: u64) {
    const TRANSFER: usize = 512;
    let bytes = stream.bytes(HD, events);
    let transfers: Vec<&[u8]> = bytes.chunks(TRANSFER).collect();
    // What every word gives where nothing is wrong, and the time before every transfer.
    let mut parser = stream.parser(HD);
    let (mut all, mut marks, mut times) = (Vec::new(), vec![0], Vec::new());
    for transfer in &transfers {
        times.push(parser.parse().time_us());
        for word in transfer.chunks(stream.word_bytes()) {
            parser.parse().parse(word, &mut all);
            marks.push(all.len());
        }
    }
    let words = TRANSFER / stream.word_bytes();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut parser = stream.parser(HD);
    let (mut found, mut done, mut at) = (Vec::new(), 0, 0);
    while done < count {
        if at + 8 > transfers.len() {
            // Around again: the device was started anew.
            parser = stream.parser(HD);
            at = 0;
        }
        if at == 0 {
            parser.parse().parse(transfers[0], &mut found);
            at = 1;
        }
        let fault = match random.next_u32() % 5 {
            0 => Fault::Dropped,
            1 => Fault::Flipped,
            2 => Fault::Twice,
            3 => Fault::Swapped,
            _ => Fault::Short,
        };
        let known = times[at].map(|us: u64| us.saturating_add(u64::from(random.next_u32() % 2000)));
        found.clear();
        let mut damaged = transfers[at].to_vec();
        match fault {
            Fault::Dropped => {
                parser.parse().resume(known);
                at += 1;
            }
            Fault::Flipped => {
                for _ in 0..1 + random.next_u32() % 3 {
                    let place = random.next_u32() as usize % damaged.len();
                    damaged[place] ^= 1 << (random.next_u32() % 8);
                }
                parser.parse().parse(&damaged, &mut found);
                at += 1;
            }
            Fault::Twice => {
                parser.parse().parse(&damaged, &mut found);
                parser.parse().parse(&damaged, &mut found);
                at += 1;
            }
            Fault::Swapped => {
                parser.parse().parse(transfers[at + 1], &mut found);
                parser.parse().parse(&damaged, &mut found);
                at += 2;
            }
            Fault::Short => {
                damaged.truncate(random.next_u32() as usize % damaged.len());
                parser.parse().parse(&damaged, &mut found);
                parser.parse().resume(known);
                at += 1;
            }
        }
        done += 1;
        // The next transfers, of which all is right from the first word of time on.
        found.clear();
        let from = at;
        while at < from + 3 {
            parser.parse().parse(transfers[at], &mut found);
            at += 1;
        }
        // Events before that word may be wrong or missing.
        let before = transfers[from..at]
            .iter()
            .flat_map(|transfer| transfer.chunks(stream.word_bytes()))
            .take_while(|word| !stream.is_time(word))
            .count();
        let expected = &all[marks[from * words + before]..marks[at * words]];
        assert!(
            found.ends_with(expected),
            "{stream:?} fault {done} {fault:?} before {from}: wrong after the first time, word {before}"
        );
    }
    assert!(parser.parse().events() > 0);
}

/// Moves events so that wraps of EVT 3.0's time are often near, and rows are full of neighbours.
fn scene(random: &mut Xoshiro256PlusPlus, count: usize) -> Vec<Event> {
    let mut t_us = (1 << 24) - 30_000;
    let mut events = Vec::new();
    while events.len() < count {
        t_us += u64::from(random.next_u32() % 40);
        let (x, y) = (
            (random.next_u32() % 1200) as u16,
            (random.next_u32() % 720) as u16,
        );
        let on = random.next_u32().is_multiple_of(2);
        for column in 0..(random.next_u32() % 9) as u16 {
            events.push(Event {
                t_us,
                x: x + 2 * column,
                y,
                polarity: Polarity::from_bool(on),
            });
        }
    }
    events
}

#[test]
fn after_faults_events_are_right_from_the_next_word_of_time_on() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let events = scene(&mut random, 40_000);
    for (seed, stream) in STREAMS.into_iter().enumerate() {
        faults(stream, &events, 10_000, seed as u64);
    }
    if let Some(path) = shared("davis346_building_dense/davis.aedat4") {
        let events = rebased(events_of(&path), (1 << 24) - 60_000);
        for (seed, stream) in STREAMS.into_iter().enumerate() {
            faults(stream, &events, 10_000, 10 + seed as u64);
        }
    }
}

/// A break in the middle of a wrap: the clock tells the one that is meant.
#[test]
fn a_break_over_wraps_is_carried_by_the_clock() {
    let events = events_from(
        10,
        vec![(0, 1, 2, true), (100_000_000, 3, 4, true), (5, 5, 6, false)],
    );
    for stream in STREAMS {
        let first = stream.bytes(HD, &events[..1]);
        let all = stream.bytes(HD, &events);
        let mut parser = stream.parser(HD);
        let mut found = Vec::new();
        parser.parse().parse(&first, &mut found);
        parser.parse().resume(Some(99_000_000));
        // The last 80 bytes: whole words, a time among them.
        parser.parse().parse(&all[all.len() - 80..], &mut found);
        assert_eq!(found, events, "{stream:?}");
    }
}
