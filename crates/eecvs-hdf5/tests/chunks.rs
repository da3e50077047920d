//! Chunks of rows, packed and unpacked.

#![cfg(feature = "pack")]

use eecvs_hdf5::{Error, Layout, pack, unpack};
use proptest::prelude::*;

/// Prophesee's compound: x, y, p (i16), two bytes of padding, t.
const PROPHESEE: [u32; 9] = [16, 8, 8, 0, 2, 2, 2, 4, 2];
/// Packed: t, x, y (u32), p as a byte.
const WIDE: [u32; 9] = [17, 0, 8, 8, 4, 12, 4, 16, 1];
/// Times of 4 bytes behind the rest.
const SHORT: [u32; 9] = [9, 5, 4, 0, 2, 2, 2, 4, 1];

const EFFORTS: [u32; 4] = [0, 1, 2, 3];

fn layout(values: &[u32; 9], effort: u32) -> Layout {
    Layout::from_values(&[&values[..], &[effort]].concat()).unwrap()
}

/// Rows of events.
fn rows(values: &[u32; 9], events: &[(u64, u16, u16, bool)], off: i64) -> Vec<u8> {
    let mut rows = Vec::new();
    for (t, x, y, is_on) in events {
        let mut row = vec![0; values[0] as usize];
        let p = if *is_on { 1 } else { off };
        let numbers = [*t as i64, i64::from(*x), i64::from(*y), p];
        for (field, number) in values[1..].chunks(2).zip(numbers) {
            let (at, bytes) = (field[0] as usize, field[1] as usize);
            row[at..at + bytes].copy_from_slice(&number.to_le_bytes()[..bytes]);
        }
        rows.extend(row);
    }
    rows
}

fn recording(count: usize, seed: u64) -> Vec<(u64, u16, u16, bool)> {
    let mut state = seed;
    let mut t_us = 1_000_000;
    let mut random = move |below: u64| {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) % below
    };
    (0..count)
        .map(|_| {
            t_us += random(4);
            (t_us, random(346) as u16, random(260) as u16, random(2) == 1)
        })
        .collect()
}

/// Packs, unpacks and compares; returns the bits of a row.
fn check(rows: &[u8], layout: &Layout) -> f64 {
    let packed = pack(rows, layout).unwrap();
    let back = unpack(&packed, layout, rows.len()).unwrap();
    assert!(back == rows, "the rows differ");
    assert!(packed.len() <= rows.len() + 10);
    packed.len() as f64 * 8.0 / (rows.len() / layout.row_bytes()).max(1) as f64
}

#[test]
fn events_of_every_layout_take_few_bits() {
    let events = recording(40_000, 1);
    for values in [PROPHESEE, WIDE, SHORT] {
        for off in [0, -1] {
            for effort in EFFORTS {
                let bits = check(&rows(&values, &events, off), &layout(&values, effort));
                assert!(
                    bits < 26.0,
                    "{values:?}, off {off}, effort {effort}: {bits} bits"
                );
            }
        }
    }
}

#[test]
fn rows_behind_the_end_cost_nothing() {
    let layout = layout(&PROPHESEE, 0);
    let mut rows = rows(&PROPHESEE, &recording(10_000, 2), -1);
    let alone = pack(&rows, &layout).unwrap().len();
    rows.resize(16 * 65_536, 0);
    check(&rows, &layout);
    assert!(pack(&rows, &layout).unwrap().len() < alone + 32);
}

#[test]
fn a_clock_that_falls_back_begins_a_piece() {
    let layout = layout(&SHORT, 0);
    let [first, second] = [recording(20_000, 3), recording(20_000, 4)];
    let bits = check(&rows(&SHORT, &[first, second].concat(), 0), &layout);
    assert!(bits < 26.0, "{bits} bits");
}

#[test]
fn rows_that_are_no_events_are_kept() {
    let layout = layout(&PROPHESEE, 0);
    let mut rows = rows(&PROPHESEE, &recording(30_000, 5), 0);
    // Padding, a polarity, a place off every sensor, a negative time, a time far ahead.
    for (row, at, value) in [
        (1_000, 6, 9),
        (9_000, 4, 7),
        (12_000, 1, 200),
        (20_000, 15, 255),
        (25_000, 14, 1),
    ] {
        rows[row * 16 + at] = value;
    }
    let bits = check(&rows, &layout);
    assert!(bits < 30.0, "{bits} bits");
    assert_eq!(pack(&rows[1..], &layout), Err(Error::PartOfRow));
    check(&[], &layout);
}

#[test]
fn chunks_of_one_time_and_of_hours_are_exact() {
    for (every_us, start_us) in [(0, 0), (0, 1 << 62), (1_000_000, 0), (1 << 45, 7)] {
        let events: Vec<_> = (0..3_000_u64)
            .map(|i| {
                (
                    start_us + i * every_us,
                    (i * 7 % 2048) as u16,
                    (i % 2048) as u16,
                    i % 3 == 0,
                )
            })
            .collect();
        for effort in EFFORTS {
            check(&rows(&PROPHESEE, &events, 0), &layout(&PROPHESEE, effort));
        }
    }
}

/// A packed chunk of these bytes, with their checksum.
fn sealed(bytes: &[u8]) -> Vec<u8> {
    [bytes, &crc32fast::hash(bytes).to_le_bytes()].concat()
}

#[test]
fn every_flipped_bit_is_found() {
    let layout = layout(&SHORT, 0);
    let mut packed = pack(&rows(&SHORT, &recording(700, 8), 0), &layout).unwrap();
    for bit in 0..8 * packed.len() {
        packed[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(
            unpack(&packed, &layout, 1 << 20),
            Err(Error::Damaged),
            "bit {bit}"
        );
        packed[bit / 8] ^= 1 << (bit % 8);
    }
}

#[test]
fn rows_are_never_more_than_allowed() {
    let layout = layout(&SHORT, 0);
    let rows = rows(&SHORT, &recording(5_000, 6), 0);
    let packed = pack(&rows, &layout).unwrap();
    assert_eq!(
        unpack(&packed, &layout, rows.len() - 1),
        Err(Error::TooLarge)
    );
    // One row, 2^32 - 1 times, and ten million times.
    for count in [[255; 4], 10_000_000_u32.to_le_bytes()] {
        let bomb = sealed(&[&[1, 1][..], &count, &[0; 9]].concat());
        assert_eq!(unpack(&bomb, &layout, 1 << 20), Err(Error::TooLarge));
        assert_eq!(unpack(&bomb, &layout, usize::MAX), Err(Error::TooLarge));
    }
    // Where the number of rows is known, no other is accepted.
    let known = Layout::from_values(&[&SHORT[..], &[0, 5_000]].concat()).unwrap();
    assert_eq!(
        unpack(&packed, &known, usize::MAX).as_deref(),
        Ok(&rows[..])
    );
    assert_eq!(pack(&rows[9..], &known), Err(Error::Rows));
    let fewer = pack(&rows[9..], &layout).unwrap();
    assert_eq!(unpack(&fewer, &known, usize::MAX), Err(Error::Rows));
    let bomb = sealed(&[&[1, 1][..], &5_001_u32.to_le_bytes(), &[0; 9]].concat());
    assert_eq!(unpack(&bomb, &known, usize::MAX), Err(Error::TooLarge));
}

proptest! {
    #[test]
    fn any_rows_are_kept(
        seed in any::<u64>(),
        swaps in prop::collection::vec((0..3_000_usize, 0..9_usize, any::<u8>()), 0..20),
        effort in 0..4_u32,
        off in -1..=0_i64,
    ) {
        let mut rows = rows(&SHORT, &recording(3_000, seed), off);
        for (row, at, value) in swaps {
            rows[row * 9 + at] = value;
        }
        check(&rows, &layout(&SHORT, effort));
    }

    #[test]
    fn damage_is_found_or_harmless(
        seed in any::<u64>(),
        effort in 0..4_u32,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        cut in any::<prop::sample::Index>(),
        is_cut in any::<bool>(),
    ) {
        let layout = layout(&SHORT, effort);
        let rows = rows(&SHORT, &recording(1_000, seed), 0);
        let mut packed = pack(&rows, &layout).unwrap();
        for (at, value) in damage {
            let at = at.index(packed.len());
            packed[at] ^= value;
        }
        if is_cut {
            packed.truncate(cut.index(packed.len()));
        } else {
            // A checksum that holds.
            let content = packed.len() - 4;
            packed = sealed(&packed[..content]);
        }
        if let Ok(back) = unpack(&packed, &layout, 1 << 20) {
            prop_assert!(back.len() <= 1 << 20);
        }
    }
}
