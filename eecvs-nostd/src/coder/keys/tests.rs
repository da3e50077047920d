use std::boxed::Box;
use std::vec;
use std::vec::Vec;

use crate::coder::Fidelity;
use crate::coder::cells::Cells;
use crate::coder::keys::sort::sort_by_time;
use crate::coder::keys::{
    Coded, Damaged, DecoderMemory, EVENT_BYTES_MAX, EncoderMemory, NotEncoded, Simd, Window,
    decode, encode,
};
use crate::coder::quick::{Placed, place};
use event_types::{Event, Polarity, Sensor};
use zerocopy::FromZeros;

/// The ways to code: on a processor without vectors a single one, which is then compared with nothing.
fn kinds() -> Vec<Simd> {
    let detected = Simd::detected();
    if detected == Simd::NONE {
        std::eprintln!("skipped: this processor has no vectors for the keys coder");
        return vec![detected];
    }
    vec![Simd::NONE, detected]
}

/// Memory of both sides, which is what a window before left there.
struct Memory {
    encoder: Box<EncoderMemory>,
    decoder: Box<DecoderMemory>,
}

impl Memory {
    fn new() -> Self {
        Self {
            encoder: EncoderMemory::new_box_zeroed().unwrap(),
            decoder: DecoderMemory::new_box_zeroed().unwrap(),
        }
    }
}

/// The worked example's window: 8 x 4 pixels, 16 us from 1,000 on.
fn small() -> Window {
    Window::new(Sensor::new(8, 4).unwrap(), 1000, 16, Fidelity::Lossless)
}

fn event(t_us: u64, x: u16, y: u16, on: bool) -> Event {
    let polarity = Polarity::from_bool(on);
    Event {
        t_us,
        x,
        y,
        polarity,
    }
}

/// The events as a window's slots hold them.
fn placed(window: &Window, events: &[Event]) -> Vec<Placed> {
    let placed = |event: &Event| {
        let offset_us = event.t_us.wrapping_sub(window.start_us) as u32;
        [offset_us, place(event.x, event.y, event.polarity)]
    };
    events.iter().map(placed).collect()
}

fn sort_key(event: &Event) -> (u64, u16, u16) {
    (event.t_us, event.y, event.x)
}

/// The events as they are decoded, by time and then place; those that are equal in both as they came.
fn expected(window: &Window, events: &[Event]) -> Vec<Event> {
    let mut events = events.to_vec();
    for event in &mut events {
        let cell = window.cells.of((event.t_us - window.start_us) as u32);
        event.t_us = window.start_us + u64::from(window.cells.offset_us(cell));
    }
    events.sort_by_key(sort_key);
    events
}

/// Codes and reads in all ways; returns the payload.
fn round_trip(window: &Window, events: &[Event], memory: &mut Memory) -> Vec<u8> {
    let placed = placed(window, events);
    let room = events.len() * 10 + 400;
    let mut payloads = kinds().into_iter().map(|simd| {
        let mut out = vec![0xA5; room];
        let coded = encode(simd, window, &placed, &mut memory.encoder, &mut out).unwrap();
        assert_eq!(coded.events, events.len());
        out.truncate(coded.bytes);
        out
    });
    let payload = payloads.next().unwrap();
    assert!(payloads.all(|other| other == payload), "{window:?}");
    let expected = expected(window, events);
    for simd in kinds() {
        let mut back = vec![Event::UNSET; events.len()];
        let memory = &mut memory.decoder;
        assert_eq!(decode(simd, window, &payload, memory, &mut back), Ok(()));
        assert!(back.is_sorted_by_key(|event| event.t_us), "{window:?}");
        // Events of one unit may be in two slices.
        back.sort_by_key(sort_key);
        assert!(back == expected, "{simd:?} {window:?}");
        if !payload.is_empty() {
            let cut = &payload[..payload.len() - 1];
            assert_eq!(decode(simd, window, cut, memory, &mut back), Err(Damaged));
        }
        let longer = [&payload[..], &[0]].concat();
        assert_eq!(
            decode(simd, window, &longer, memory, &mut back),
            Err(Damaged)
        );
    }
    payload
}

struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// A number below `n`, or 0.
    fn below(&mut self, n: u64) -> u64 {
        ((u128::from(self.next()) * u128::from(n.max(1))) >> 64) as u64
    }

    /// A number below one of `choices`.
    fn below_one(&mut self, choices: &[u64]) -> u64 {
        let at = self.below(choices.len() as u64) as usize;
        self.below(choices[at])
    }
}

/// A window of any kind and its events, in order of time.
fn case(seed: u64) -> (Window, Vec<Event>) {
    let r = &mut Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    for _ in 0..4 {
        r.next();
    }
    let sides = [1, 8, 128, 700, 2048];
    let width = 1 + r.below_one(&sides) as u16;
    let height = 1 + r.below_one(&sides) as u16;
    let duration_us = 1 + r.below_one(&[1, 100, 40_000, 1 << 20, u64::from(u32::MAX)]);
    let fidelity = match r.below(4) {
        0 | 1 => Fidelity::Lossless,
        2 => Fidelity::ToleranceUs(r.below_one(&[10, 1000, duration_us]) as u32),
        _ => Fidelity::Bins(1 + r.below_one(&[8, 1000, 65_535]) as u16),
    };
    let sensor = Sensor::new(width, height).unwrap();
    let start_us = r.below(1 << 60);
    let window = Window::new(sensor, start_us, duration_us as u32, fidelity);
    let n = r.below_one(&[3, 40, 300, 3000, 5000, 40_000]);
    // How spread out times, places and polarities are.
    let (few_times, few_places, mostly) = (r.below(3), r.below(3), r.below(4));
    let (t, x, y) = (
        r.below(duration_us),
        r.below(u64::from(width)),
        r.below(u64::from(height)),
    );
    let mut events: Vec<Event> = (0..n)
        .map(|_| {
            let t = if few_times == 0 || r.below(8) == 0 {
                r.below(duration_us)
            } else {
                (t + r.below(9)).min(duration_us - 1)
            };
            let (x, y) = if few_places == 0 || r.below(8) == 0 {
                (r.below(u64::from(width)), r.below(u64::from(height)))
            } else {
                ((x + r.below(2)).min(u64::from(width) - 1), y)
            };
            let on = r.below(8) >= 2 * mostly;
            event(start_us + t, x as u16, y as u16, on)
        })
        .collect();
    events.sort_by_key(|event| event.t_us);
    (window, events)
}

#[test]
fn worked_example() {
    // The one of docs/wire-format.md.
    let events = [
        event(1002, 3, 0, true),
        event(1005, 3, 0, true),
        event(1005, 1, 2, false),
        event(1006, 1, 2, true),
        event(1014, 2, 2, true),
    ];
    let memory = &mut Memory::new();
    let payload = round_trip(&small(), &events, memory);
    assert_eq!(
        payload,
        [0x04, 0xFC, 0xFE, 0xEF, 0xDF, 0xED, 0xC8, 0x32, 0x18, 0x01]
    );
    // With a code of its own.
    let payload = [
        0x00, 0x02, 0x00, 0x01, 0xD2, 0xF3, 0x54, 0xA5, 0x52, 0x05, 0x7D, 0x80, 0x32, 0x18, 0x01,
    ];
    for simd in kinds() {
        let mut back = [Event::UNSET; 5];
        let read = decode(simd, &small(), &payload, &mut memory.decoder, &mut back);
        assert_eq!((read, back), (Ok(()), events));
    }
}

#[test]
fn nothing_gives_no_bytes() {
    let mut memory = Memory::new();
    assert!(round_trip(&small(), &[], &mut memory).is_empty());
}

#[test]
fn windows_of_any_kind_come_back() {
    let mut memory = Memory::new();
    let (mut preset, mut described) = (0, 0);
    for seed in 0..1000 {
        let (window, events) = case(seed);
        match round_trip(&window, &events, &mut memory).first() {
            Some(flags) if flags & 4 > 0 => preset += 1,
            Some(_) => described += 1,
            None => (),
        }
    }
    assert!(preset > 50 && described > 500, "{preset} {described}");
}

/// All events but two lie in one bucket of time, so that insertion would be quadratic.
#[test]
fn a_burst_comes_back() {
    let sensor = Sensor::new(640, 480).unwrap();
    let window = Window::new(sensor, 5, u32::MAX, Fidelity::Lossless);
    let r = &mut Random(3);
    let mut at = |t| event(t, r.below(640) as u16, r.below(480) as u16, true);
    let mut events = vec![at(5), at(u64::from(u32::MAX) + 4)];
    let mut times = Random(4);
    events.extend((0..16_000).map(|_| at(1_000_000 + times.below(500))));
    events.sort_by_key(|event| event.t_us);
    round_trip(&window, &events, &mut Memory::new());
}

/// The first and the last pixel, microsecond and class, and a window at the end of the clock's range.
#[test]
fn the_largest_differences_come_back() {
    let sensor = Sensor::new(2048, 2048).unwrap();
    let mut memory = Memory::new();
    for (start_us, duration_us) in [
        (0, u32::MAX),
        (u64::MAX - u64::from(u32::MAX), u32::MAX),
        (7, 1 << 30),
    ] {
        let window = Window::new(sensor, start_us, duration_us, Fidelity::Lossless);
        let last_us = start_us + u64::from(duration_us) - 1;
        let corners = |on| {
            [
                event(start_us, 0, 0, on),
                event(start_us, 2047, 2047, on),
                event(last_us, 0, 0, !on),
                event(last_us, 2047, 2047, !on),
            ]
        };
        round_trip(&window, &corners(true)[..1], &mut memory);
        round_trip(&window, &corners(true)[3..], &mut memory);
        round_trip(&window, &corners(false), &mut memory);
        let mut events = [corners(false), corners(true)].concat().repeat(700);
        events.sort_by_key(|event| event.t_us);
        round_trip(&window, &events, &mut memory);
    }
}

/// The middle of the last cell lies beyond the last time that a clock shows.
#[test]
fn the_last_times_of_a_clock_do_not_wrap() {
    let sensor = Sensor::new(8, 4).unwrap();
    let mut memory = Memory::new();
    for fidelity in [Fidelity::ToleranceUs(500), Fidelity::Bins(3)] {
        for count in [1, 9, 2000] {
            let window = Window::new(sensor, u64::MAX - 100, 1000, fidelity);
            let placed = vec![[100, 1]; count];
            let mut out = vec![0; 100 + 8 * count];
            let coded = encode(Simd::NONE, &window, &placed, &mut memory.encoder, &mut out);
            let coded = coded.unwrap();
            assert_eq!(coded.events, count);
            for simd in kinds() {
                let mut events = vec![Event::UNSET; count];
                let payload = &out[..coded.bytes];
                decode(simd, &window, payload, &mut memory.decoder, &mut events).unwrap();
                let times = events.iter().map(|event| event.t_us);
                assert!(times.into_iter().all(|t_us| t_us >= u64::MAX - 100));
            }
        }
    }
}

#[test]
fn wrong_events_are_refused() {
    let mut memory = Memory::new();
    let sensor = Sensor::new(300, 200).unwrap();
    let window = Window::new(sensor, 1_000_000, 1000, Fidelity::Lossless);
    for count in [1, 30, 5000, 20_000] {
        let events: Vec<_> = (0..count)
            .map(|i| {
                event(
                    1_000_000 + i * 1000 / count,
                    (i % 300) as u16,
                    (i % 200) as u16,
                    true,
                )
            })
            .collect();
        round_trip(&window, &events, &mut memory);
        for bad in [
            event(1_000_500, 300, 0, true),
            event(1_000_500, 0, 200, true),
            event(1_000_500, 32_767, u16::MAX, true),
            event(1_001_000, 0, 0, true),
            event(999_999, 0, 0, true),
        ] {
            for at in [0, count / 2, count - 1] {
                let mut events = events.clone();
                events[at as usize] = Event {
                    t_us: if bad.t_us == 1_000_500 {
                        events[at as usize].t_us
                    } else {
                        bad.t_us
                    },
                    ..bad
                };
                let events = placed(&window, &events);
                let mut out = vec![0; 10 * events.len() + 400];
                for simd in kinds() {
                    let coded = encode(simd, &window, &events, &mut memory.encoder, &mut out);
                    assert!(coded.is_err(), "{bad:?} {at} {simd:?}");
                }
            }
        }
    }
    // Times that step back: in a pixel, and from slice to slice.
    for (count, events) in [(2, [5, 4]), (20_000, [999, 0])] {
        let events: Vec<_> = (0..count)
            .map(|i| [events[(2 * i / count) as usize], place(1, 1, Polarity::On)])
            .collect();
        for simd in kinds() {
            let mut out = vec![0; 200_000];
            assert_eq!(
                encode(simd, &window, &events, &mut memory.encoder, &mut out),
                Err(NotEncoded::Unordered)
            );
        }
    }
}

/// Whatever the payload and what its header claims, all ways to read give the same events, in order of time, or none.
#[test]
fn damage_reads_alike_in_all_ways() {
    let mut memory = Memory::new();
    let (mut read, mut refused) = (0, 0);
    for seed in 0..1500 {
        let (mut window, mut events) = case(1 << 40 | seed);
        let r = &mut Random(seed + 1);
        if seed % 16 > 0 {
            events.truncate(400);
        }
        let coded = placed(&window, &events);
        let mut payload = vec![0; events.len() * 10 + 400];
        let coded = encode(
            Simd::NONE,
            &window,
            &coded,
            &mut memory.encoder,
            &mut payload,
        )
        .unwrap();
        payload.truncate(coded.bytes);
        for _ in 0..4 {
            let mut bad = payload.clone();
            let mut claimed = events.len();
            for _ in 0..1 + r.below(3) {
                let n = bad.len() as u64;
                match r.below(8) {
                    0 => bad.truncate(r.below(n) as usize),
                    1 => claimed = r.below(2 * events.len() as u64 + 20) as usize,
                    2 => (0..r.below(40)).for_each(|_| bad.push(r.next() as u8)),
                    3 => bad.iter_mut().for_each(|byte| *byte = r.next() as u8),
                    4 => window.duration_us = 1 + r.below(u64::from(u32::MAX)) as u32,
                    5 => window.sensor.width = 1 + r.below(2048) as u16,
                    6 if n > 0 => bad[r.below(n.min(40)) as usize] = r.next() as u8,
                    _ if n > 0 => bad[r.below(n) as usize] ^= 1 << r.below(8),
                    _ => (),
                }
            }
            let fidelity = match window.cells.width_us() {
                Some(width_us) => Fidelity::ToleranceUs(width_us / 2),
                None => Fidelity::Bins(window.cells.count() as u16),
            };
            window.cells = Cells::new(fidelity, window.duration_us);
            let mut outcomes = kinds().into_iter().map(|simd| {
                let mut events = vec![Event::UNSET; claimed];
                let outcome = decode(simd, &window, &bad, &mut memory.decoder, &mut events);
                outcome.map(|()| events)
            });
            let first = outcomes.next().unwrap();
            assert!(outcomes.all(|other| other == first), "case {seed}");
            if let Ok(events) = first {
                assert!(events.is_sorted_by_key(|event| event.t_us), "case {seed}");
                let is_inside = |event: &Event| {
                    window.sensor.contains(event.x, event.y)
                        && event.t_us.wrapping_sub(window.start_us) < u64::from(window.duration_us)
                };
                assert!(events.iter().all(is_inside), "case {seed}");
                read += 1;
            } else {
                refused += 1;
            }
        }
    }
    assert!(read > 100 && refused > 1000, "{read} {refused}");
}

/// Whatever the room, the events that are said to be coded come back, and [`EVENT_BYTES_MAX`] suffice for one.
#[test]
fn as_many_are_coded_as_there_is_room_for() {
    let mut memory = Memory::new();
    for seed in 0..150 {
        let (window, mut events) = case(1 << 41 | seed);
        events.truncate(20_000);
        let placed = placed(&window, &events);
        let r = &mut Random(seed + 1);
        let (mut at, mut frames) = (0, 0);
        while at < events.len() && frames < 30 {
            let room = EVENT_BYTES_MAX + r.below_one(&[1, 900, 30_000]) as usize;
            let mut outputs = kinds().into_iter().map(|simd| {
                let mut out = vec![0; room];
                let left = &placed[at..];
                let coded = encode(simd, &window, left, &mut memory.encoder, &mut out).unwrap();
                out.truncate(coded.bytes);
                (coded.events, out)
            });
            let (count, payload) = outputs.next().unwrap();
            assert!(count > 0, "{room}");
            assert!(outputs.all(|other| other == (count, payload.clone())));
            // Most of the room is used, where it is much more than what comes first.
            assert!(
                at + count == events.len() || room < 3000 || payload.len() > room / 2,
                "{room} {}",
                payload.len()
            );
            let mut back = vec![Event::UNSET; count];
            let memory = &mut memory.decoder;
            decode(Simd::detected(), &window, &payload, memory, &mut back).unwrap();
            back.sort_by_key(sort_key);
            assert!(back == expected(&window, &events[at..at + count]));
            (at, frames) = (at + count, frames + 1);
        }
        for simd in kinds() {
            let coded = encode(simd, &window, &placed, &mut memory.encoder, &mut []);
            assert_eq!(coded, Ok(Coded::default()));
        }
    }
}

#[test]
fn sorting_by_time_is_stable() {
    let r = &mut Random(9);
    for case in 0..400_u64 {
        let times = 1 + r.below_one(&[2, 50, 5000]);
        let steps = case % 3;
        let mut events: Vec<Placed> = (0..r.below_one(&[5, 70, 2000]))
            .map(|i| {
                let t = match steps {
                    // Almost in order, in runs, in no order.
                    0 => i + r.below(times),
                    1 => i % times,
                    _ => r.below(times),
                };
                [t as u32, i as u32]
            })
            .collect();
        let mut expected = events.clone();
        expected.sort_by_key(|event| event[0]);
        sort_by_time(&mut events);
        assert_eq!(events, expected, "case {case}");
    }
}

/// A change of one bit of any payload fails here.
#[test]
fn the_bits_are_frozen() {
    let mut memory = Memory::new();
    let mut all = vec![];
    for seed in 0..40 {
        let (window, events) = case(1 << 42 | seed);
        all.extend(round_trip(&window, &events, &mut memory));
    }
    assert_eq!(
        (all.len(), crate::checksum::crc_32(&all)),
        (160_026, 0x8213_862A)
    );
}
