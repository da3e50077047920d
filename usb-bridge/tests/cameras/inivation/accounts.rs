//! Any bytes: no panic, events inside, and every word and byte is accounted for.

use proptest::prelude::*;
use usb_bridge::device::Parse;
use usb_bridge::device::inivation::parser::{Reader, WordParser};
use usb_bridge::device::{
    davis::parse::DavisParser, dvs128::parse::Dvs128Parser, dvxplorer::parse::DvxplorerParser,
    dvxplorer_mipi::parse::MipiParser,
};

use super::scene::{scene, sensor, write};

/// Parses pieces, with a loss reported before those whose flag says so, and checks the accounts.
/// `own` is whether an event has a word of its own.
fn check<R: Reader>(mut parser: WordParser<R>, own: bool, pieces: &[(Vec<u8>, Option<u64>)]) {
    let mut events = Vec::new();
    let mut bytes_in = 0;
    for (bytes, loss) in pieces {
        if let Some(now) = loss {
            parser.resume(Some(*now).filter(|now| now % 3 != 0));
        }
        parser.parse(bytes, &mut events);
        bytes_in += bytes.len() as u64;
    }
    // What is kept of a word is counted now.
    parser.resume(None);
    let (words, counted) = parser.accounts();
    assert_eq!(parser.events(), events.len() as u64);
    assert_eq!(words, counted + if own { parser.events() } else { 0 });
    let lost = |wanted: &str| {
        let losses = parser.losses();
        let found = losses.iter().find(|(name, _)| *name == wanted);
        found.map_or(0, |(_, n)| n)
    };
    let bytes = lost("bytes of incomplete words") + lost("bytes left out to realign");
    assert_eq!(bytes_in, words * R::WORD as u64 + bytes);
    let sensor = parser.sensor();
    assert!(events.iter().all(|event| sensor.contains(event.x, event.y)));
}

fn check_all(pieces: &[(Vec<u8>, Option<u64>)]) {
    check(Dvs128Parser::begin(), true, pieces);
    check(DavisParser::begin(sensor(240, 180), false), true, pieces);
    check(DavisParser::begin(sensor(260, 346), true), true, pieces);
    check(DvxplorerParser::begin(sensor(33, 45), false), false, pieces);
    check(
        DvxplorerParser::begin(sensor(640, 480), true),
        false,
        pieces,
    );
    check(MipiParser::begin(sensor(33, 45)), false, pieces);
    check(MipiParser::begin(sensor(640, 480)), false, pieces);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn any_bytes_are_accounted_for(
        pieces in prop::collection::vec(
            (prop::collection::vec(any::<u8>(), 0..700), prop::option::weighted(0.3, any::<u64>())),
            0..12,
        ),
    ) {
        check_all(&pieces);
    }
}

#[test]
fn streams_of_each_model_are_accounted_for_by_each() {
    for (name, width, height) in super::scene::MODELS {
        let sensor = sensor(width, height);
        let bytes = write(name, sensor, &scene(sensor, 3000, 5));
        let pieces = |from: usize| -> Vec<_> {
            bytes[from..]
                .chunks(777)
                .map(|some| (some.to_vec(), None))
                .collect()
        };
        for from in 0..4 {
            check_all(&pieces(from));
        }
    }
}

#[test]
fn words_are_named() {
    let words: [u16; 26] = [
        0x1005, 0x3007, // A row and an event before there is a time.
        0x8064, 0x3007, // An event before there is a row.
        0x1005, 0x3007, 0x2007, // A row and two events.
        0x0002, 0x0003, 0x0004, 0x0010, 0x0011, // Inputs and the generator.
        0x0005, 0x5012, 0x5312, 0x0007, // An inertial sample.
        0x0008, 0x4123, 0x4123, 0x000A, // A frame of one sample, twice.
        0x5134, 0x6012, // A region, an exposure.
        0x1FFF, 0x3FFF, 0x7000, 0x0013, // Outside, outside, no wrap, no code.
    ];
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    let mut parser = DavisParser::begin(sensor(240, 180), false);
    // Where a stream begins, the time is 0, not unknown.
    parser.resume(None);
    let mut events = Vec::new();
    parser.parse(&bytes, &mut events);
    let counts = |skipped: &event_files::Skipped| skipped.iter().collect::<Vec<_>>();
    assert_eq!(events.len(), 2);
    assert_eq!(
        counts(&parser.words()),
        [
            ("exposures and regions", 2),
            ("external inputs", 3),
            ("frame marks", 2),
            ("frame samples", 2),
            ("generator edges", 2),
            ("inertial samples", 4),
            ("rows", 1),
            ("times", 1),
        ]
    );
    assert_eq!(
        counts(&parser.losses()),
        [
            ("columns outside", 1),
            ("rows outside", 1),
            ("words the device does not send", 2),
            ("words without a row or column", 1),
            ("words without a time", 2),
        ]
    );
}

/// A stream from which an odd number of bytes is missing, without any word of it.
#[test]
fn misaligned_words_are_found() {
    for (name, width, height) in super::scene::MODELS {
        let sensor = sensor(width, height);
        let events = scene(sensor, 20_000, 9);
        let bytes = write(name, sensor, &events);
        let word = if ["dvs128", "dvxplorer-mipi"].contains(&name) {
            4
        } else {
            2
        };
        for missing in 1..word {
            let at = bytes.len() / 4 / word * word;
            let mut parser = super::scene::parser(name, sensor);
            let mut read = Vec::new();
            parser.parse(&bytes[..at], &mut read);
            let before = read.len();
            parser.parse(&bytes[at + missing..], &mut read);
            let left_out = parser
                .losses()
                .iter()
                .find(|(name, _)| *name == "bytes left out to realign")
                .map_or(0, |(_, n)| n as usize);
            assert_eq!(
                (left_out + missing) % word,
                0,
                "{name}: {:?}",
                parser.losses()
            );
            // What comes is right again soon: of 15,000 events at most 400 were missed or forged.
            let events = super::scene::sorted_frames(name, events.clone());
            let places = |event: &eecvs_nostd::Event| (event.x, event.y, event.polarity);
            let right = read.iter().rev().zip(events.iter().rev());
            let right = right.take_while(|(a, b)| places(a) == places(b)).count();
            let wrong = events.len().saturating_sub(before + right);
            assert!(
                wrong < 400,
                "{name}, {missing} bytes: {wrong} of {}",
                events.len()
            );
        }
    }
}
