//! unpack(pack(d)) == d, and what a frame carries is what went in.

use std::collections::BTreeMap;

use eecvs_nostd::pack::bits_lsb_first::{BitReader, BitWriter};
use eecvs_nostd::pack::timed::TimedEvent;
use eecvs_nostd::transform::shape::Timed;
use eecvs_nostd::{
    Coded, Descriptor, Event, FRAME_BYTES_MAX, Level, OUTPUT_BYTES_MIN, Packing, Polarity,
    Quantiser, Sensor, Transform,
};
use proptest::prelude::*;
use strategies::{encode, job, parse, plain_config, sensor, transform};

fn packing() -> impl Strategy<Value = Packing> {
    (
        sensor(),
        1..5000_u32,
        transform(),
        1..=64_u8,
        1..=200_u16,
        -15..=8_i8,
        (0..=63_u8, 1..=1_u32 << 25),
    )
        .prop_map(
            |(sensor, window_events, transform, m, grid, step_log2, (timed_max, duration_us))| {
                let packing = Packing {
                    sensor,
                    window_events,
                    transform,
                    m,
                    grid: transform.grid_size(m, Some(grid)),
                    quantiser: Quantiser::new(step_log2).expect("-15 to 8"),
                    timed: Timed::NONE,
                };
                let takes = packing.takes_timed(timed_max, duration_us);
                let timed = Timed::new(timed_max, duration_us);
                Packing {
                    timed: if takes { timed } else { Timed::NONE },
                    ..packing
                }
            },
        )
}

/// A descriptor that an encoder may write: a cell, the cells of few events, or the right number of coefficients, indices
/// ascending, levels that n events can have, c_0 the one that the counts imply.
fn descriptor(packing: Packing) -> impl Strategy<Value = Descriptor> {
    let kept = packing.kept();
    let grid = usize::from(packing.grid);
    let few = (0..6_u32, 0..6_u32);
    let many = (0..70_000_u32, 0..70_000_u32);
    let counts = prop_oneof![
        2 => Just((1, 0)), 2 => Just((0, 1)), 4 => few.clone(), 1 => many.clone(),
        1 => (few.0, many.1), 1 => (many.0, few.1),
    ];
    let count = match packing.transform {
        Transform::Dwt => 0..=kept,
        Transform::Dct | Transform::Dtft => kept..=kept,
    };
    (
        0..packing.sensor.width,
        0..packing.sensor.height,
        counts,
        proptest::sample::subsequence((0..grid as u16).collect::<Vec<_>>(), count),
        proptest::collection::vec((any::<i32>(), any::<i32>()), 64),
        // By how much the levels are smaller than they might be.
        0..32_u32,
    )
        .prop_map(move |(x, y, (on, off), mut ks, values, shift)| {
            let on = if on + off == 0 { 1 } else { on };
            let events = on + off;
            let net = on as i32 - off as i32;
            let descriptor = |coded| Descriptor {
                x,
                y,
                on,
                off,
                coded,
            };
            if events == 1 {
                let cells = 1 << packing.cells_log2();
                return descriptor(Coded::Cell(values[0].0 as u32 % cells));
            }
            if packing.timed.has(events) {
                let cells = packing.timed_cells(events).count();
                let signs = (0..events).map(|i| i < on);
                let mut sent: Vec<_> = signs
                    .zip(values)
                    .map(|(is_on, (cell, _))| TimedEvent {
                        cell: cell as u32 % cells,
                        is_on,
                    })
                    .collect();
                sent.sort();
                return descriptor(Coded::Times(sent.into_iter().collect()));
            }
            if packing.transform == Transform::Dct {
                ks = (0..kept as u16).collect();
            }
            let step_log2 = i32::from(packing.quantiser.step_log2());
            // Levels from -most to most - 1.
            let most = match packing.transform {
                Transform::Dwt => f64::from(events),
                _ => (f64::from(events) * 2_f64.powi(-step_log2)).ceil(),
            };
            let level = |value: i32| {
                let level = f64::from(value >> shift) / 2_f64.powi(31) * most;
                level.floor().max(f64::from(i32::MIN)) as i32
            };
            let mut levels = Vec::new();
            for (k, (re, im)) in ks.into_iter().zip(values) {
                let (re, im) = match (k, packing.transform) {
                    (0, _) => (net, 0),
                    (_, Transform::Dct) => (level(re), 0),
                    (_, Transform::Dtft) => (level(re), level(im)),
                    (_, Transform::Dwt) => (level(re) + i32::from(re >= 0), 0),
                };
                if packing.transform != Transform::Dwt || re != 0 {
                    levels.push(Level { k, re, im });
                }
            }
            descriptor(Coded::Levels(levels.into_iter().collect()))
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn unpack_inverts_pack(
        (packing, descriptor) in packing().prop_flat_map(|p| (Just(p), descriptor(p))),
        before in any::<u32>(),
    ) {
        let index =
            u32::from(descriptor.y) * u32::from(packing.sensor.width) + u32::from(descriptor.x);
        let next_index = before % (index + 1);
        let mut bytes = [0; eecvs_nostd::transform::shape::PIXEL_BYTES_MAX];
        let mut writer = BitWriter::new(&mut bytes);
        let mut next = next_index;
        prop_assert!(packing.pack(&descriptor, &mut next, &mut writer).is_ok());
        prop_assert_eq!(next, index + 1);
        let len = writer.finish();
        let mut reader = BitReader::new(&bytes[..len]);
        let mut next = next_index;
        let unpacked = packing.unpack(&mut next, descriptor.events(), &mut reader);
        prop_assert_eq!(unpacked, Ok(descriptor.clone()));
        prop_assert!(reader.is_spent());
        // One event fewer in the header, and the pixel contradicts it.
        let mut reader = BitReader::new(&bytes[..len]);
        prop_assert!(packing.unpack(&mut next_index.clone(), descriptor.events() - 1, &mut reader).is_err());
    }

    #[test]
    fn any_payload_unpacks_or_is_refused(
        packing in packing(), bytes in proptest::collection::vec(any::<u8>(), 0..200),
    ) {
        let mut reader = BitReader::new(&bytes);
        let mut next = 0;
        while let Ok(descriptor) = packing.unpack(&mut next, 100_000, &mut reader) {
            prop_assert!(packing.sensor.contains(descriptor.x, descriptor.y));
            let mut ks = Vec::new();
            descriptor.dequantise(&packing, |k, _, _| ks.push(k));
            prop_assert!(ks.len() <= packing.kept());
            prop_assert!(ks.iter().all(|k| *k < packing.grid));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn every_event_is_accounted_for_and_counted_in_its_pixel(
        (config, events) in job(400),
        window_events in prop_oneof![1..40_usize, Just(1000)],
        frame_bytes in prop_oneof![Just(OUTPUT_BYTES_MIN), Just(1 << 16)],
    ) {
        let frames = encode(config, &events, window_events, frame_bytes);
        let mut accounted = 0;
        let mut part = 0;
        let mut counts: BTreeMap<(u16, u16), (u32, u32)> = BTreeMap::new();
        for (index, bytes) in frames.iter().enumerate() {
            let frame = parse(bytes);
            let header = frame.header;
            prop_assert_eq!(header.sequence, index as u32);
            prop_assert_eq!(header.part, part);
            part = if header.last { 0 } else { part + 1 };
            prop_assert!(bytes.len() <= frame_bytes);
            let mut events = 0;
            for descriptor in frame.descriptors() {
                let descriptor = descriptor.expect("the encoder's own payload");
                events += descriptor.events();
                let count = counts.entry((descriptor.y, descriptor.x)).or_default();
                count.0 += descriptor.on;
                count.1 += descriptor.off;
            }
            prop_assert_eq!(events, header.events);
            accounted += header.events + header.late + header.filtered + header.dropped;
        }
        prop_assert_eq!(accounted as usize, events.len());
        prop_assert_eq!(part, 0, "the last window has no last frame");
        let late: u32 = frames.iter().map(|bytes| parse(bytes).header.late).sum();
        if late == 0 {
            let mut expected: BTreeMap<(u16, u16), (u32, u32)> = BTreeMap::new();
            for event in &events {
                let count = expected.entry((event.y, event.x)).or_default();
                match event.polarity {
                    Polarity::On => count.0 += 1,
                    Polarity::Off => count.1 += 1,
                }
            }
            prop_assert_eq!(counts, expected);
        }
    }

    #[test]
    fn smaller_frames_carry_the_same_pixels((config, events) in job(300)) {
        let one: Vec<_> = pixels(&encode(config, &events, 1000, 1 << 20));
        let many: Vec<_> = pixels(&encode(config, &events, 1000, OUTPUT_BYTES_MIN));
        prop_assert_eq!(one, many);
    }
}

fn pixels(frames: &[Vec<u8>]) -> Vec<(u64, u32, Descriptor)> {
    frames
        .iter()
        .flat_map(|bytes| {
            let frame = parse(bytes);
            frame.descriptors().map(move |descriptor| {
                let descriptor = descriptor.expect("the encoder's own payload");
                (frame.header.t0_us, frame.header.duration_us, descriptor)
            })
        })
        .collect()
}

#[test]
fn a_frame_never_exceeds_its_maximum() {
    // 130,000 pairs of events of 64 complex coefficients: some 20 MB.
    let sensor = Sensor {
        width: 1000,
        height: 130,
    };
    let events: Vec<_> = (0..260_000_u32)
        .map(|i| Event {
            t_us: u64::from(i / 8),
            x: (i % 1000) as u16,
            y: (i / 1000 % 130) as u16,
            polarity: Polarity::On,
        })
        .collect();
    let mut config = plain_config(sensor, Transform::Dtft, 64);
    config.quantiser = Quantiser::new(-8).expect("in range");
    let frames = encode(config, &events, events.len(), 2 * FRAME_BYTES_MAX);
    assert_eq!(frames.len(), 2);
    assert!(frames.iter().all(|frame| frame.len() <= FRAME_BYTES_MAX));
    assert_eq!(2 * pixels(&frames).len(), events.len());
}
