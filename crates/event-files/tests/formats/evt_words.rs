//! Tests EVT 2, 2.1, 3 and 4 word by word: time overflow, missing state, and everything that is not an event.

use std::collections::BTreeMap;
use std::io::Cursor;

use event_types::evt21::{Order, time_word};
use event_types::{Event, Polarity};

type Counted = BTreeMap<&'static str, u64>;

fn read(header: &str, words: &[u8]) -> (Vec<Event>, Counted) {
    let bytes = [header.as_bytes(), words].concat();
    let mut reader =
        event_files::open_source(Box::new(Cursor::new(bytes)), "test", None).expect("a recording");
    let mut events = Vec::new();
    while reader.read(&mut events).expect("whole words") > 0 {}
    (events, reader.skipped().iter().collect())
}

fn evt3(words: &[u16]) -> (Vec<Event>, Counted) {
    let words: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    read("% evt 3.0\n% geometry 640x480\n% end\n", &words)
}

fn evt2(words: &[u32]) -> (Vec<Event>, Counted) {
    let words: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    read("% evt 2.0\n% geometry 640x480\n% end\n", &words)
}

fn evt4(words: &[u32]) -> (Vec<Event>, Counted) {
    let words: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    read("% evt 4.0\n% geometry 640x480\n% end\n", &words)
}

/// Reads EVT 2.1 words with header lines that may or may not state their order.
fn evt21(order: Order, lines: &str, words: &[u64]) -> (Vec<Event>, Counted) {
    let words: Vec<u8> = words.iter().flat_map(|word| order.bytes(*word)).collect();
    read(
        &format!("% evt 2.1\n{lines}% geometry 640x480\n% end\n"),
        &words,
    )
}

const fn event(t_us: u64, x: u16, y: u16, on: bool) -> Event {
    Event {
        t_us,
        x,
        y,
        polarity: Polarity::from_bool(on),
    }
}

#[test]
fn evt3_time_high_alone_carries_the_overflow() {
    let (events, _) = evt3(&[
        0x8001, 0x6005, 0x0002, 0x2803, // t = 4101
        0x6003, 0x2804, // TIME_LOW back by 2: no overflow
        0x8002, 0x6000, 0x2005, // the next 4096 us
        0x8002, 0x2006, // repeated: the low bits stay
        0x8fff, 0x6fff, 0x2007, // the last time of 24 bits
        0x8000, 0x2008, // wrapped; low bits 0 until TIME_LOW
        0x6001, 0x2009,
    ]);
    let want = [
        event(4101, 3, 2, true),
        event(4099, 4, 2, true),
        event(8192, 5, 2, false),
        event(8192, 6, 2, false),
        event(0xff_ffff, 7, 2, false),
        event(0x100_0000, 8, 2, false),
        event(0x100_0001, 9, 2, false),
    ];
    assert_eq!(events, want);
}

#[test]
fn evt3_vectors() {
    let (events, _) = evt3(&[
        0x8000, 0x6001, 0x0007, 0x3864, 0x4801, 0x5081, 0x2001, 0x4002,
    ]);
    // Base 100: bits 0 and 11; then base 112: bits 0 and 7. A single event does not move the base of 120.
    let xs = [
        (100, true),
        (111, true),
        (112, true),
        (119, true),
        (1, false),
        (121, true),
    ];
    let want: Vec<Event> = xs.iter().map(|(x, on)| event(1, *x, 7, *on)).collect();
    assert_eq!(events, want);
}

#[test]
fn evt3_counts_what_is_no_event_and_what_lacks_state() {
    let (events, skipped) = evt3(&[
        0x0001, 0x2001, 0x3000, 0x4003, // events before any time
        0x8000, 0x2001, // a row is known
        0xa101, 0xe000, 0xf000, 0x7000, 0x1000, 0x9000,
    ]);
    assert_eq!(events, [event(0, 1, 1, false)]);
    let want = Counted::from([
        ("events before the first time", 3),
        ("triggers", 1),
        ("other words", 1),
        ("continued words", 2),
        ("unknown words", 2),
    ]);
    assert_eq!(skipped, want);
    let (events, skipped) = evt3(&[0x8000, 0x2001, 0x4003]);
    assert!(events.is_empty());
    let want = Counted::from([
        ("events before the first row", 1),
        ("events before the first column", 2),
    ]);
    assert_eq!(skipped, want);
}

#[test]
fn evt3_column_counter_never_overflows() {
    let mut words = vec![0x8000, 0x0000, 0x3000];
    words.extend(std::iter::repeat_n(0x4000, 400_000));
    let (events, _) = evt3(&words);
    assert!(events.is_empty());
}

#[test]
fn evt2_words() {
    let cd = |on: u32, low: u32, x: u32, y: u32| on << 28 | low << 22 | x << 11 | y;
    let high = |high: u32| 0x8 << 28 | high;
    let (events, skipped) = evt2(&[
        cd(1, 5, 1, 2),
        high(100),
        cd(1, 5, 639, 479),
        cd(0, 63, 0, 0),
        0xa000_0001,
        0xe000_0000,
        0xf000_0000,
        0x3000_0000,
        high(0xfff_ffff),
        cd(0, 0, 1, 1),
        high(0),
        cd(0, 1, 2, 2),
    ]);
    let want = [
        event(6405, 639, 479, true),
        event(6463, 0, 0, false),
        event((1 << 34) - 64, 1, 1, false),
        event((1 << 34) + 1, 2, 2, false),
    ];
    assert_eq!(events, want);
    let want = Counted::from([
        ("events before the first time", 1),
        ("triggers", 1),
        ("other words", 1),
        ("continued words", 1),
        ("unknown words", 1),
    ]);
    assert_eq!(skipped, want);
}

const fn vector(on: u64, low: u64, x: u64, y: u64, columns: u32) -> u64 {
    on << 60 | low << 54 | x << 43 | y << 32 | columns as u64
}

#[test]
fn evt21_words() {
    let words = [
        vector(1, 5, 0, 2, 7),
        time_word(100),
        vector(1, 5, 607, 479, 0x8000_0001),
        vector(0, 63, 33, 0, 0x10),
        vector(0, 63, 33, 0, 0),
        0xa << 60 | 1,
        0xe << 60,
        0xf << 60,
        0x3 << 60,
        time_word((1 << 28) - 1),
        vector(0, 0, 1, 1, 1),
        time_word(0),
        vector(0, 1, 2, 2, 1),
    ];
    let want_events = [
        event(6405, 607, 479, true),
        event(6405, 638, 479, true),
        event(6463, 37, 0, false),
        event((1 << 34) - 64, 1, 1, false),
        event((1 << 34) + 1, 2, 2, false),
    ];
    let want_skipped = Counted::from([
        ("events before the first time", 3),
        ("empty vectors", 1),
        ("triggers", 1),
        ("other words", 1),
        ("continued words", 1),
        ("unknown words", 1),
    ]);
    for (order, lines) in [
        (Order::Little, "% endianness little\n"),
        (Order::UpperFirst, "% endianness legacy\n"),
        (Order::Little, "% format EVT21;endianness=little\n"),
        (
            Order::UpperFirst,
            "% format EVT21;endianness=legacy;height=480;width=640\n",
        ),
    ] {
        let (events, skipped) = evt21(order, lines, &words);
        assert_eq!(events, want_events, "{order:?} {lines}");
        assert_eq!(skipped, want_skipped, "{order:?} {lines}");
    }
}

/// The order of words is found if the header does not state it, for one column or all of them, slow and fast.
#[test]
fn evt21_words_tell_their_order() {
    for order in [Order::Little, Order::UpperFirst] {
        for columns in [1, 1 << 31, 0x8000_0001, u32::MAX, 0x1080_0010] {
            for step in [1, 16, 1 << 20] {
                let mut words = Vec::new();
                for i in 0..40 {
                    words.push(time_word(7 + i * step));
                    words.push(vector(i % 2, i % 64, i * 13 % 608, i * 37 % 480, columns));
                }
                let (events, skipped) = evt21(order, "", &words);
                let first = u16::try_from(columns.trailing_zeros()).unwrap();
                assert_eq!(
                    events.first(),
                    Some(&event(7 * 64, first, 0, false)),
                    "{order:?} {columns:#x} {step}"
                );
                assert_eq!(events.len(), 40 * columns.count_ones() as usize);
                assert!(skipped.is_empty());
            }
        }
    }
}

#[test]
fn evt4_words() {
    let cd = |kind: u32, low: u32, x: u32, y: u32| kind << 28 | low << 22 | x << 11 | y;
    let high = |high: u32| 0xe << 28 | high;
    let (events, skipped) = evt4(&[
        cd(0xb, 5, 1, 2),
        cd(0xd, 5, 1, 2),
        // Columns that look like a time.
        0xe000_0001,
        high(100),
        cd(0xb, 5, 639, 479),
        cd(0xa, 63, 0, 0),
        cd(0xc, 1, 608, 7),
        0x8000_0001,
        cd(0xd, 2, 5, 6),
        2,
        cd(0xd, 2, 5, 6),
        0,
        0x9000_0001,
        0x6000_0014,
        0x7000_0000,
        0xffff_ffff,
        0x1000_0000,
        high(0xfff_ffff),
        cd(0xa, 0, 1, 1),
        high(0),
        cd(0xa, 1, 2, 2),
    ]);
    let want = [
        event(6405, 639, 479, true),
        event(6463, 0, 0, false),
        event(6401, 608, 7, false),
        event(6401, 639, 7, false),
        event(6402, 6, 6, true),
        event((1 << 34) - 64, 1, 1, false),
        event((1 << 34) + 1, 2, 2, false),
    ];
    assert_eq!(events, want);
    let want = Counted::from([
        ("events before the first time", 5),
        ("empty vectors", 1),
        ("triggers", 1),
        ("other words", 1),
        ("continued words", 1),
        ("padding", 1),
        ("unknown words", 1),
    ]);
    assert_eq!(skipped, want);
}

#[test]
fn evt4_that_ends_within_a_vector() {
    let words = [0xe000_0001_u32, 0xb000_0000, 0xc000_0000];
    let words = words.iter().flat_map(|word| word.to_le_bytes());
    let header = b"% evt 4.0\n% geometry 640x480\n% end\n";
    let bytes: Vec<u8> = header.iter().copied().chain(words).collect();
    let length = bytes.len();
    let mut reader = event_files::open_source(Box::new(Cursor::new(bytes)), "test", None).unwrap();
    let mut events = Vec::new();
    assert_eq!(reader.read(&mut events).unwrap(), 1);
    let error = reader.read(&mut events).unwrap_err().to_string();
    assert!(
        error.contains(&format!("byte {length}")) && error.contains("truncated"),
        "{error}"
    );
}

/// faery subtracts the first time and states it.
#[test]
fn t0_is_added_to_every_time() {
    let lines =
        |version: &str| format!("% evt {version}\n% geometry 9x9\n% T0 5000000000\n% end\n");
    let bytes = |words: &[u32]| -> Vec<u8> { words.iter().flat_map(|w| w.to_le_bytes()).collect() };
    let evt21 = [time_word(2), vector(1, 5, 3, 4, 1)];
    let evt21: Vec<u8> = evt21.iter().flat_map(|word| word.to_le_bytes()).collect();
    let place = 5 << 22 | 3 << 11 | 4;
    for (version, words) in [
        ("2.0", bytes(&[0x8000_0002, 1 << 28 | place])),
        ("2.1", evt21),
        ("3.0", bytes(&[0x6085_8000, 0x2803_0004])),
        ("4.0", bytes(&[0xe000_0002, 0xb << 28 | place])),
    ] {
        let (events, _) = read(&lines(version), &words);
        assert_eq!(events, [event(5_000_000_133, 3, 4, true)], "{version}");
    }
    let text = lines("2.0").replace("5000000000", "soon");
    let source = Box::new(Cursor::new(text.into_bytes()));
    assert!(event_files::open_source(source, "test", None).is_err());
}
