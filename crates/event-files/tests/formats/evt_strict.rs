//! Tests the words of the writers of EVT 3 and EVT 4 against decoders as strict as the strictest of `OpenEB`: what a
//! sensor would not send is an error there.

use event_types::{Event, Polarity, Sensor};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use crate::support::written;

const EVENTS: usize = 1_000_000;

/// Returns the bytes after the header, in words of `N` bytes.
fn words<const N: usize>(bytes: &[u8]) -> Vec<[u8; N]> {
    let end = b"% end\n";
    let start = bytes.windows(end.len()).position(|part| part == end);
    let (words, rest) = bytes[start.expect("a header") + end.len()..].as_chunks();
    assert!(rest.is_empty());
    words.to_vec()
}

/// Returns random events in every column and row, of which many are neighbours in a row at one time, also with
/// columns left out and at the sensor's edges; times ascend, with a silence now and then.
fn random(sensor: Sensor, seed: u64, silence_us: u64) -> Vec<Event> {
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut below = |n: u64| rng.next_u64() % n;
    let mut events: Vec<Event> = Vec::with_capacity(EVENTS + 64);
    let mut t_us = below(5_000);
    while events.len() < EVENTS {
        t_us += match below(2_000) {
            0 => below(silence_us),
            _ => below(3),
        };
        let y = below(sensor.height.into()) as u16;
        let polarity = Polarity::from_bool(below(2) == 1);
        let first = below(sensor.width.into()) as u16;
        let count = match below(3) {
            0 => 1,
            _ => 1 + below(60) as u16,
        };
        let share = 1 + below(8);
        let columns = (first..sensor.width).take(count.into());
        let kept: Vec<u16> = columns.filter(|_| below(8) < share).collect();
        events.extend(kept.into_iter().map(|x| Event {
            t_us,
            x,
            y,
            polarity,
        }));
    }
    for x in 0..sensor.width {
        assert!(events.iter().any(|event| event.x == x));
    }
    for y in 0..sensor.height {
        assert!(events.iter().any(|event| event.y == y));
    }
    events
}

/// Decodes EVT 3 as the grammar of a sensor's words allows, and counts the vectors.
fn evt3(words: &[[u8; 2]], sensor: Sensor) -> (Vec<Event>, usize) {
    let words: Vec<u16> = words.iter().map(|word| u16::from_le_bytes(*word)).collect();
    let (mut high, mut low, mut y, mut base) = (None, None, None, None);
    let (mut events, mut vectors, mut rest) = (Vec::new(), 0, words.as_slice());
    while let [word, tail @ ..] = rest {
        rest = tail;
        let (value, x) = (u64::from(word & 0xfff), word & 0x7ff);
        let polarity = Polarity::from_bool(word & 0x800 != 0);
        let event = |x: u16, polarity| Event {
            t_us: high.expect("a TIME_HIGH") << 12 | low.expect("a TIME_LOW after it"),
            x,
            y: y.expect("a row"),
            polarity,
        };
        match word >> 12 {
            0x0 => {
                assert!(x < sensor.height);
                y = Some(x);
            }
            0x2 => {
                assert!(x < sensor.width);
                events.push(event(x, polarity));
            }
            0x3 => {
                assert!(x + 32 <= sensor.width, "a vector beyond the sensor");
                base = Some((x, polarity));
            }
            0x4 => {
                let [second, third, tail @ ..] = tail else {
                    panic!("the words end within a vector");
                };
                assert_eq!((second >> 12, third >> 8), (0x4, 0x50));
                rest = tail;
                let (x, polarity) = base.take().expect("a base before every vector");
                let columns = u32::from(word & 0xfff)
                    | u32::from(second & 0xfff) << 12
                    | u32::from(third & 0xff) << 24;
                assert!(columns.count_ones() > 4, "single events take no more words");
                let set = (0..32).filter(|column| columns >> column & 1 == 1);
                events.extend(set.map(|column| event(x + column, polarity)));
                vectors += 1;
            }
            0x6 => low = Some(value),
            0x8 => {
                // Every value, and so no doubt about a wrap.
                let next =
                    high.map_or(value, |high: u64| high + (value.wrapping_sub(high) & 0xfff));
                assert!(
                    high.is_none_or(|high| next - high <= 1),
                    "a TIME_HIGH is left out"
                );
                (high, low) = (Some(next), None);
            }
            kind => panic!("a word of type {kind}"),
        }
    }
    (events, vectors)
}

#[test]
fn evt3_is_what_a_sensor_sends() {
    let folder = tempfile::tempdir().expect("a folder");
    for (seed, (width, height)) in [(1280, 720), (346, 260), (640, 480), (33, 2048), (2048, 32)]
        .into_iter()
        .enumerate()
    {
        let sensor = Sensor { width, height };
        let events = random(sensor, seed as u64, 16_000_000);
        let bytes = written(folder.path(), "raw", sensor, &events);
        let (got, vectors) = evt3(&words(&bytes), sensor);
        assert!(vectors > 10_000, "{width}x{height}: {vectors} vectors");
        assert!(got == events, "{width}x{height}: other events");
    }
}

#[test]
fn evt3_of_narrow_sensors_has_no_vectors() {
    let folder = tempfile::tempdir().expect("a folder");
    let sensor = Sensor {
        width: 31,
        height: 9,
    };
    let events = random(sensor, 9, 1_000);
    let (got, vectors) = evt3(
        &words(&written(folder.path(), "raw", sensor, &events)),
        sensor,
    );
    assert_eq!(vectors, 0);
    assert!(got == events);
}

/// Decodes EVT 4 as `OpenEB`'s robust decoder does: after a step of 1,000 us or more it drops events until another
/// `EVT_TIME_HIGH` confirms the step.
fn evt4(words: &[[u8; 4]], sensor: Sensor) -> Vec<Event> {
    let (mut high, mut doubted): (Option<u64>, Option<u64>) = (None, None);
    let mut events = Vec::new();
    let mut words = words.iter().map(|word| u32::from_le_bytes(*word));
    while let Some(word) = words.next() {
        let (x, y) = ((word >> 11 & 0x7ff) as u16, (word & 0x7ff) as u16);
        match word >> 28 {
            kind @ 0xa..=0xd => {
                let is_vector = kind > 0xb;
                let columns = match is_vector {
                    true => words.next().expect("columns"),
                    false => 1,
                };
                assert!(x + if is_vector { 32 } else { 1 } <= sensor.width && y < sensor.height);
                assert_eq!(doubted, None, "an event that is dropped");
                let t_us = high.expect("a time") << 6 | u64::from(word >> 22 & 0x3f);
                let set = (0..32).filter(|column| columns >> column & 1 == 1);
                events.extend(set.map(|column| Event {
                    t_us,
                    x: x + column,
                    y,
                    polarity: Polarity::from_bool(kind & 1 == 1),
                }));
            }
            0xe => {
                let value = u64::from(word & 0xfff_ffff);
                let last = high.unwrap_or(value);
                let wraps = (last >> 28) + u64::from(last & 0xfff_ffff >= value + (1 << 27));
                let next = wraps << 28 | value;
                assert!(next >= last, "a step back");
                if (next - last) << 6 < 1000 || doubted.is_some_and(|doubted| next - doubted <= 1) {
                    (high, doubted) = (Some(next), None);
                } else {
                    doubted = Some(next);
                }
            }
            kind => panic!("a word of type {kind}"),
        }
    }
    events
}

#[test]
fn evt4_loses_nothing_in_a_strict_decoder() {
    let folder = tempfile::tempdir().expect("a folder");
    // The silences wrap the 34 bits of time several times.
    for (seed, (width, height), silence_us) in [
        (1, (1280, 720), 50_000),
        (2, (346, 260), 1 << 33),
        (3, (31, 9), 1 << 35),
    ] {
        let sensor = Sensor { width, height };
        let events = random(sensor, seed, silence_us);
        let bytes = written(folder.path(), "evt4", sensor, &events);
        assert!(evt4(&words(&bytes), sensor) == events, "{width}x{height}");
    }
}
