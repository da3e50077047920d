use std::vec;
use std::vec::Vec;

use crate::coder::quick::format::{
    BLOCK, BLOCK_BYTES_MAX, Divisor, Header, Placed, Shape, packed_bytes, place,
};
use crate::coder::quick::{
    Coded, Damaged, EVENT_BYTES_MAX, Kind, Outside, Simd, Window, decode, encode,
};
use event_types::{Event, Polarity, Sensor};

fn kinds() -> Vec<Simd> {
    vec![Simd::NONE, Simd(Kind::Array), Simd::detected()]
}

fn window(width: u16, height: u16, duration_us: u32) -> Window {
    Window::new(Sensor::new(width, height).unwrap(), 1_000_000, duration_us)
}

fn event(t: u64, x: u16, y: u16, on: bool) -> Event {
    Event {
        t_us: 1_000_000 + t,
        x,
        y,
        polarity: Polarity::from_bool(on),
    }
}

/// The events as a window's slots hold them.
fn placed(window: Window, events: &[Event]) -> Vec<Placed> {
    let placed = |event: &Event| {
        let offset_us = event.t_us.wrapping_sub(window.start_us) as u32;
        [offset_us, place(event.x, event.y, event.polarity)]
    };
    events.iter().map(placed).collect()
}

/// Codes and reads in all ways; returns the payload.
fn round_trip(window: Window, events: &[Event]) -> Vec<u8> {
    let placed = placed(window, events);
    let mut out = vec![0; events.len() * 10 + 100];
    let coded = encode(Simd::NONE, window, &placed, &mut out).unwrap();
    assert_eq!(coded.events, events.len());
    out.truncate(coded.bytes);
    for simd in kinds() {
        // No more room than it takes.
        for fill in [0xA5, 0x5A] {
            let mut other = vec![fill; coded.bytes];
            let again = encode(simd, window, &placed, &mut other);
            assert_eq!(again, Ok(coded), "{simd:?}");
            assert_eq!(other, out, "{simd:?}");
        }
        let mut back = vec![Event::UNSET; events.len()];
        assert_eq!(decode(simd, window, &out, &mut back), Ok(()), "{simd:?}");
        assert_eq!(back, events, "{simd:?}");
    }
    out
}

fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

#[test]
fn worked_example() {
    // The one of docs/wire-format.md.
    let events = [
        event(3, 10, 20, true),
        event(9, 12, 21, false),
        event(9, 11, 20, true),
    ];
    let payload = round_trip(window(640, 480, 1000), &events);
    assert_eq!(
        payload,
        [
            0x95, 0x00, 0x3F, 0x2C, 0x01, 0x69, 0x27, 0x14, 0xB1, 0x04, 0x32
        ]
    );
}

#[test]
fn nothing_gives_no_bytes() {
    assert!(round_trip(window(1, 1, 0), &[]).is_empty());
    assert_eq!(
        decode(Simd::NONE, window(1, 1, 0), &[0], &mut []),
        Err(Damaged)
    );
}

#[test]
fn quotients_are_exact() {
    let mut state = 1;
    for i in 0..200_000 {
        let value = match i % 4 {
            0 => 1 + (i / 4),
            1 => (1_u32 << (i / 4 % 32)).saturating_add(i / 128).min(1 << 31),
            _ => ((random(&mut state) >> (33 + i % 31)) as u32).clamp(1, 1 << 31),
        };
        let divisor = Divisor::new(value);
        let most = (1_u32 << 31) - 1;
        let near = (random(&mut state) as u32 & most) / value * value;
        for v in [
            0,
            1,
            value - 1,
            value,
            near,
            near.wrapping_sub(1),
            most,
            most - most % value,
            random(&mut state) as u32,
        ] {
            let v = v & most;
            assert_eq!(divisor.quotient(v), v / value, "{v} / {value}");
        }
    }
}

#[test]
fn shapes_hold_their_block() {
    let mut state = 2;
    for _ in 0..200_000 {
        let codes = 2
            + (random(&mut state) as u32) % (1 << (1 + random(&mut state) % 23)).min((1 << 23) - 1);
        let count = 1 + random(&mut state) as usize % BLOCK;
        let span = (random(&mut state) >> (33 + random(&mut state) % 31)) as u32;
        if let Some(Shape { width, quantum }) = Shape::choose(codes, count, span) {
            assert!(width <= 31 && (span / quantum.value) < 2 * count as u32);
            // The largest word.
            assert!((u64::from(codes) * u64::from(quantum.value)) <= 1 << width);
        }
    }
}

#[test]
fn headers_come_back() {
    for bits in 0..1 << 16 {
        if let Some(header) = Header::from_bits(bits) {
            assert_eq!(header.bits(), bits);
        }
    }
}

#[test]
fn every_width_comes_back() {
    let mut state = 3;
    for bits in 1..=22 {
        for gap in [0, 1, 2, 3, 10, 100, 1000, 100_000] {
            for count in [1, 2, 7, 8, 9, 127, 128, 129, 300] {
                let (w, h) = (1 << (bits / 2), 1 << (bits - bits / 2));
                let mut t = 0;
                let events: Vec<_> = (0..count)
                    .map(|_| {
                        let r = random(&mut state);
                        t += (r >> 32) % (2 * gap + 1);
                        event(t, r as u16 % w, (r >> 16) as u16 % h, r >> 63 == 1)
                    })
                    .collect();
                round_trip(window(w, h, t as u32 + 1), &events);
            }
        }
    }
}

#[test]
fn times_may_step_back() {
    let w = window(2048, 2048, u32::MAX);
    let late = u64::from(u32::MAX) - 1;
    // Within a block, between blocks, by almost the whole window, and all times the same.
    for times in [
        [5, 4, 4],
        [0, late, 0],
        [late, 0, late],
        [late, late - 1, 0],
        [7, 7, 7],
        [1 << 31, 0, 1 << 31],
        [3_000_000_000, 0, 1],
    ] {
        for run in [1, 64, 127, 128, 129] {
            let events: Vec<_> = times
                .iter()
                .flat_map(|t| {
                    (0..run).map(move |i| event(*t, (i * 15) as u16, 2047 - i as u16, i % 3 == 0))
                })
                .collect();
            round_trip(w, &events);
        }
    }
}

#[test]
fn largest_block_fits() {
    let w = window(2048, 2048, u32::MAX);
    let late = u64::from(u32::MAX) - 1;
    let events: Vec<_> = (0..BLOCK as u64)
        .map(|i| {
            event(
                if i % 2 == 0 { late } else { 0 },
                2047 * (i as u16 & 1),
                2047 * (i as u16 >> 1 & 1),
                true,
            )
        })
        .collect();
    // The area is the whole sensor: no area in it.
    assert_eq!(round_trip(w, &events).len(), BLOCK_BYTES_MAX - 6);
    // And the largest one whose times do not step back.
    let events: Vec<_> = (0..BLOCK as u64)
        .map(|i| {
            event(
                i * 511,
                2047 * (i as u16 & 1),
                2047 * (i as u16 >> 1 & 1),
                true,
            )
        })
        .collect();
    assert_eq!(
        round_trip(w, &events).len(),
        2 + packed_bytes(BLOCK, 31) + 48
    );
}

#[test]
fn events_outside_are_refused() {
    let w = window(300, 200, 1000);
    let inside = vec![event(10, 299, 199, true); BLOCK];
    round_trip(w, &inside);
    let outside = [
        event(1000, 0, 0, true),
        event(0, 300, 0, true),
        event(0, 0, 200, true),
        event(0, u16::MAX, u16::MAX, true),
        Event {
            t_us: 999_999,
            ..event(0, 0, 0, true)
        },
        Event {
            t_us: 0,
            ..event(0, 0, 0, true)
        },
    ];
    for bad in outside {
        for at in [0, 5, 127, 128, 130] {
            let mut events = [inside.clone(), inside.clone()].concat();
            events[at] = bad;
            let events = placed(w, &events);
            for simd in kinds() {
                for count in [events.len(), 131] {
                    let coded = encode(simd, w, &events[..count], &mut [0; 2048]);
                    assert_eq!(coded, Err(Outside), "{bad:?} {simd:?}");
                }
            }
        }
    }
}

/// Whatever the payload, all ways to read give the same events or none.
#[test]
fn damage_reads_alike_in_all_ways() {
    let mut state = 7;
    let (mut read, mut refused) = (0, 0);
    for case in 0..6000 {
        let w = window(640, 480, [1000, 100_000, u32::MAX][case % 3]);
        let count = 1 + random(&mut state) as usize % 300;
        let mut t = 0;
        let events: Vec<_> = (0..count)
            .map(|_| {
                let r = random(&mut state);
                t = (t + (r >> 40) % 9).min(999);
                event(t, r as u16 % 640, (r >> 16) as u16 % 480, r >> 63 == 1)
            })
            .collect();
        let mut payload = vec![0; 10 * count + 100];
        let coded = encode(Simd::NONE, w, &placed(w, &events), &mut payload).unwrap();
        payload.truncate(coded.bytes);
        match case % 4 {
            0 => payload
                .iter_mut()
                .for_each(|byte| *byte = random(&mut state) as u8),
            1 => {
                // Heads decide most: of the block, and of its area.
                let at = random(&mut state) as usize % payload.len().min(8);
                payload[at] = random(&mut state) as u8;
            }
            _ => {
                for _ in 0..=random(&mut state) % 3 {
                    let bit = random(&mut state) as usize % (8 * payload.len());
                    payload[bit / 8] ^= 1 << (bit % 8);
                }
            }
        }
        let mut outcomes = kinds().into_iter().map(|simd| {
            let mut events = vec![Event::UNSET; count];
            decode(simd, w, &payload, &mut events).map(|()| events)
        });
        let first = outcomes.next().unwrap();
        assert!(outcomes.all(|other| other == first), "case {case}");
        if let Ok(events) = first {
            let is_inside = |event: &Event| {
                w.sensor.contains(event.x, event.y)
                    && event.t_us.wrapping_sub(w.start_us) < u64::from(w.duration_us)
            };
            assert!(events.iter().all(is_inside), "case {case}");
            read += 1;
        } else {
            refused += 1;
        }
    }
    assert!(read > 500 && refused > 500, "{read} {refused}");
}

#[test]
fn cut_payloads_are_damaged() {
    let w = window(640, 480, 100_000);
    let mut state = 4;
    let mut t = 0;
    let events: Vec<_> = (0..300)
        .map(|_| {
            let r = random(&mut state);
            t += r >> 40 & 31;
            event(t, r as u16 % 640, (r >> 16) as u16 % 480, r >> 63 == 1)
        })
        .collect();
    let payload = round_trip(w, &events);
    for simd in kinds() {
        for cut in 0..payload.len() {
            let mut back = vec![Event::UNSET; events.len()];
            assert_eq!(decode(simd, w, &payload[..cut], &mut back), Err(Damaged));
        }
        // Another number of events.
        for count in [0, 1, 127, 128, 256, 299, 301, 400] {
            let mut back = vec![Event::UNSET; count];
            assert_eq!(
                decode(simd, w, &payload, &mut back),
                Err(Damaged),
                "{count}"
            );
        }
    }
}

/// Whatever the room, the events that are said to be coded come back, and [`EVENT_BYTES_MAX`] suffice for one.
#[test]
fn as_many_are_coded_as_there_is_room_for() {
    let mut state = 5;
    for case in 0..400 {
        let w = window(2048, 2048, u32::MAX);
        let gap = [0, 3, 1 << 20, 1 << 40][case % 4];
        let mut t = 0_u64;
        let events: Vec<_> = (0..400)
            .map(|_| {
                let r = random(&mut state);
                t = (t + (r >> 30) % (gap + 1)) % u64::from(u32::MAX);
                event(t, r as u16 % 2048, (r >> 16) as u16 % 2048, r >> 63 == 1)
            })
            .collect();
        let placed = placed(w, &events);
        for simd in kinds() {
            assert_eq!(encode(simd, w, &placed, &mut []), Ok(Coded::default()));
        }
        let mut at = 0;
        while at < events.len() {
            let room = EVENT_BYTES_MAX + (random(&mut state) % 900) as usize;
            let mut outputs = kinds().into_iter().map(|simd| {
                let mut out = vec![0; room];
                let coded = encode(simd, w, &placed[at..], &mut out).unwrap();
                out.truncate(coded.bytes);
                (coded.events, out)
            });
            let (count, payload) = outputs.next().unwrap();
            assert!(count > 0, "{room}");
            assert!(outputs.all(|other| other == (count, payload.clone())));
            let mut back = vec![Event::UNSET; count];
            assert_eq!(decode(Simd::detected(), w, &payload, &mut back), Ok(()));
            assert_eq!(back, events[at..at + count]);
            at += count;
        }
    }
}

/// A change of one bit of any payload fails here.
#[test]
fn the_bits_are_frozen() {
    let (mut state, mut all) = (6, vec![]);
    for (width, height, gap) in [
        (640, 480, 3),
        (1280, 720, 200),
        (128, 128, 0),
        (2048, 2048, 1 << 20),
    ] {
        let mut t = 1000_u64;
        let events: Vec<_> = (0..1000)
            .map(|i| {
                let r = random(&mut state);
                let back = if i % 400 > 380 { r >> 58 } else { 0 };
                t += (r >> 30) % (gap + 1);
                let x = (r as u16 >> (i / 200)) % width;
                event(t - back, x, (r >> 16) as u16 % height, r >> 63 == 1)
            })
            .collect();
        all.extend(round_trip(window(width, height, u32::MAX), &events));
    }
    assert_eq!(
        (all.len(), crate::checksum::crc_32(&all)),
        (15_457, 0xA7EC_A0FD)
    );
}
