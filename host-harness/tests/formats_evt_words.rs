//! EVT 2 and EVT 3 word by word: time overflow, missing state, everything that is no event.

use std::collections::BTreeMap;
use std::io::Cursor;

use eecvs_nostd::{Event, Polarity};
use host_harness::formats;

type Counted = BTreeMap<&'static str, u64>;

fn read(header: &str, words: &[u8]) -> (Vec<Event>, Counted) {
    let bytes = [header.as_bytes(), words].concat();
    let mut reader =
        formats::open_source(Box::new(Cursor::new(bytes)), "test", None).expect("a recording");
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
    // Base 100: bits 0 and 11; then 112: bits 0 and 7; a single event does not move the base 120.
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
