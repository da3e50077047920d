//! Times across the 2^32 us wrap, as Unix time, at the end of 64 bits, and across EVT 2.0's wrap.

use eecvs::encode::HostStorage;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::reconstruct::{DecodedWindow, pixels};
use eecvs_nostd::evt2::{Evt2Decoder, Evt2Encoder, Word};
use eecvs_nostd::transform::{M_MAX, Transform};
use eecvs_nostd::{Config, Encoder, Event, Polarity, Sensor};
use strategies::{encode, parse, plain_config};

use super::Random;

const SENSOR: Sensor = Sensor {
    width: 40,
    height: 2,
};
const FRAME_BYTES: usize = 1 << 18;
/// Longer than the streams below.
const SPAN_US: u64 = 200_000;
/// Period of the format's time.
const PERIOD_US: u64 = 1 << 34;

/// Some windows' events from 0 on, some of them out of order and late.
fn stream() -> Vec<Event> {
    let mut random = Random(3);
    let mut t_us = 0_u64;
    let event = |_| {
        let back = u64::from(random.below(10) / 9 * random.below(300));
        t_us += u64::from(random.below(120));
        Event {
            t_us: t_us.saturating_sub(back),
            x: random.below(u32::from(SENSOR.width)) as u16,
            y: random.below(u32::from(SENSOR.height)) as u16,
            polarity: Polarity::from_bool(random.below(2) == 0),
        }
    };
    let events: Vec<Event> = (0..2500).map(event).collect();
    assert!(t_us < SPAN_US && t_us > 3 * 32_768);
    events
}

fn later(events: &[Event], by_us: u64) -> Vec<Event> {
    let later = |event: &Event| Event {
        t_us: event.t_us + by_us,
        ..*event
    };
    events.iter().map(later).collect()
}

/// Next to every power of two that a time could wrap at, Unix times in us and in ns, the end.
fn starts() -> Vec<u64> {
    let mut starts = vec![
        0,
        1,
        1_700_000_000_000_000,
        1_700_000_000_000_000_000,
        u64::MAX - SPAN_US,
    ];
    for log2 in [31, 32, 33, 34, 48, 53, 62, 63] {
        starts.extend([(1 << log2) - SPAN_US / 2, (1 << log2) - 1, 1 << log2]);
    }
    starts
}

fn configs() -> impl Iterator<Item = Config> {
    Transform::ALL.into_iter().flat_map(|transform| {
        [32_768, 33_333, 1000, u32::MAX].map(|window_us| {
            let mut config = plain_config(SENSOR, transform, 16);
            config.window.window_us = window_us;
            config
        })
    })
}

/// A stream gives the same frames whenever it begins, but for t0.
#[test]
fn frames_do_not_depend_on_the_epoch() {
    let events = stream();
    for config in configs() {
        let expected = encode(config, &events, 1000, FRAME_BYTES);
        assert!(expected.len() > 2);
        for start_us in starts() {
            let found = encode(config, &later(&events, start_us), 1000, FRAME_BYTES);
            assert_eq!(found.len(), expected.len(), "from {start_us}");
            for (found, expected) in found.iter().zip(&expected) {
                let (found, expected) = (parse(found), parse(expected));
                let mut header = expected.header;
                header.t0_us += start_us;
                assert_eq!(found.header, header, "from {start_us}");
                assert_eq!(found.payload, expected.payload, "from {start_us}");
            }
        }
    }
}

/// Words of a stream that begins `start_us` after their base, and the frames of what a window takes
/// of them at once.
fn frames_of_words(config: Config, base_us: u64, events: &[Event]) -> Vec<Vec<u8>> {
    let mut words = Vec::new();
    let mut encoder = Evt2Encoder::new(base_us);
    for event in events {
        let (time, word) = encoder.encode(*event).expect("its decoder gives it back");
        words.extend(time.into_iter().chain([word]).map(u32::to_le_bytes));
    }
    let mut storage = HostStorage::new(SENSOR, 1000);
    let mut encoder = storage.encoder(config).expect("a valid configuration");
    let mut decoder = Evt2Decoder::new(base_us);
    let (mut frames, mut out) = (Vec::new(), vec![0; FRAME_BYTES]);
    let mut rest = &words[..];
    loop {
        let taken = encoder
            .window()
            .push_words(&mut decoder, &rest[..rest.len().min(700)]);
        assert_eq!(taken.ignored, 0);
        rest = &rest[taken.words..];
        if rest.is_empty() {
            encoder.flush();
        }
        while let Some(frame) = encoder.next_frame(&mut out).expect("room") {
            frames.push(out[frame.range].to_vec());
        }
        if rest.is_empty() {
            return frames;
        }
    }
}

/// EVT 2.0's 34 bits wrap in the middle of a window, also where the base is close to the end of 64
/// bits: the same frames as from the events.
#[test]
fn wraps_of_evt2_are_followed() {
    let events = stream();
    for config in configs() {
        for base_us in [0, 1_700_000_000_000_000, u64::MAX - PERIOD_US - SPAN_US / 2] {
            for after_us in [
                0,
                (1 << 32) - SPAN_US / 2,
                PERIOD_US / 2,
                PERIOD_US - SPAN_US / 2,
            ] {
                let events = later(&events, base_us + after_us);
                let expected = encode(config, &events, 1000, FRAME_BYTES);
                let found = frames_of_words(config, base_us, &events);
                assert!(found == expected, "{after_us} after {base_us}");
            }
        }
    }
}

/// Several wraps one after another, an event every 1.2 hours, at the end of 64 bits too.
#[test]
fn days_of_evt2_are_followed() {
    let step_us = PERIOD_US / 4 + 12_345;
    for base_us in [0, 1_700_000_000_000_000, u64::MAX - 40 * step_us] {
        let (mut encoder, mut decoder) = (Evt2Encoder::new(base_us), Evt2Decoder::new(base_us));
        for i in 0..=40 {
            let event = Event {
                t_us: base_us + i * step_us,
                x: 3,
                y: 1,
                polarity: Polarity::On,
            };
            let (time, word) = encoder.encode(event).expect("less than half of a period");
            assert_eq!(decoder.decode(time.expect("another time")), Word::Time);
            assert_eq!(decoder.decode(word), Word::Event(event), "{base_us} {i}");
        }
    }
}

/// Words whose time is beyond 64 bits begin again at 0: a new run begins with them.
#[test]
fn words_beyond_the_last_time_begin_a_run() {
    let mut storage = HostStorage::new(SENSOR, 10);
    let config = plain_config(SENSOR, Transform::Dct, 8);
    let mut encoder = storage.encoder(config).expect("a valid configuration");
    let mut decoder = Evt2Decoder::new(u64::MAX - 100);
    // 64 us after the base, an event; 128 us after it, another.
    let words = [0x8000_0001_u32, 0x1000_0000, 0x8000_0002, 0x1000_0000].map(u32::to_le_bytes);
    let taken = encoder.window().push_words(&mut decoder, &words);
    assert_eq!((taken.words, taken.ignored), (3, 0));
    let mut out = vec![0; FRAME_BYTES];
    let mut take = |encoder: &mut Encoder<'_>| {
        let frame = encoder.next_frame(&mut out).expect("room");
        let header = frame.expect("a frame").header;
        assert_eq!(encoder.next_frame(&mut out), Ok(None));
        (header.t0_us, header.events, header.begins_run)
    };
    assert_eq!(take(&mut encoder), (u64::MAX - 36, 1, false));
    let taken = encoder.window().push_words(&mut decoder, &words[3..]);
    assert_eq!((taken.words, taken.ignored), (1, 0));
    encoder.flush();
    assert_eq!(take(&mut encoder), (27, 1, true));
}

/// Decoded events of a pixel each are where they were, to half a cell, and inside of 64 bits.
#[test]
fn decoded_times_are_exact_in_any_epoch() {
    for start_us in starts() {
        for transform in [Transform::Dct, Transform::Dtft] {
            let mut config = plain_config(SENSOR, transform, M_MAX as u8);
            config.window.window_us = 30_011;
            let event = |x: u16| Event {
                t_us: start_us + u64::from(x) * 30_010 / 39,
                x,
                y: 0,
                polarity: Polarity::from_bool(x.is_multiple_of(2)),
            };
            let events: Vec<Event> = (0..40).map(event).collect();
            let frames = encode(config, &events, 100, FRAME_BYTES);
            let frame = parse(&frames[0]);
            let mut window = DecodedWindow {
                header: frame.header,
                pixels: pixels(&frame).expect("the encoder's own payload"),
                events: vec![],
            };
            EventDecoder::new(Finder::Exact).fill(&mut window);
            let mut found = window.events;
            found.sort_by_key(|event| event.x);
            assert_eq!(found.len(), events.len());
            for (found, event) in found.iter().zip(&events) {
                assert_eq!((found.x, found.polarity), (event.x, event.polarity));
                let error = found.t_us.abs_diff(event.t_us);
                assert!(
                    error <= 2,
                    "{transform:?} from {start_us}: {found:?} for {event:?}"
                );
            }
        }
    }
}
