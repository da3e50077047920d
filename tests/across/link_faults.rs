//! A damaged link: every undamaged frame is found, every loss is counted, nothing panics.

use std::collections::BTreeSet;
use std::io::Read;

use eecvs::frame_file::{FrameReader, LinkReport};
use eecvs_nostd::OUTPUT_BYTES_MIN;
use proptest::prelude::*;
use strategies::{encode, job};

/// Hands out bytes in pieces of the given sizes, over and over.
struct Pieces<'b> {
    bytes: &'b [u8],
    sizes: Vec<usize>,
    turn: usize,
}

impl Read for Pieces<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let size = self.sizes[self.turn % self.sizes.len()]
            .min(out.len())
            .min(self.bytes.len());
        self.turn += 1;
        out[..size].copy_from_slice(&self.bytes[..size]);
        self.bytes = &self.bytes[size..];
        Ok(size)
    }
}

fn read_all(source: impl Read) -> (Vec<u32>, LinkReport) {
    let mut reader = FrameReader::new(source);
    let mut sequences = Vec::new();
    while let Some(located) = reader.next_frame().expect("memory does not fail") {
        sequences.push(located.frame.header.sequence);
        // Whatever a valid frame holds decodes or is refused.
        assert!(located.frame.descriptors().count() <= located.frame.header.pixels as usize + 1);
    }
    (sequences, reader.report().clone())
}

#[derive(Debug, Clone)]
enum Fault {
    Flip { at: usize, bits: u8 },
    Cut { at: usize, len: usize },
    Insert { at: usize, bytes: Vec<u8> },
}

fn fault() -> impl Strategy<Value = Fault> {
    prop_oneof![
        (any::<usize>(), 1..=255_u8).prop_map(|(at, bits)| Fault::Flip { at, bits }),
        (any::<usize>(), 1..200_usize).prop_map(|(at, len)| Fault::Cut { at, len }),
        (
            any::<usize>(),
            proptest::collection::vec(any::<u8>(), 1..50)
        )
            .prop_map(|(at, bytes)| Fault::Insert { at, bytes }),
        any::<usize>().prop_map(|at| Fault::Insert {
            at,
            bytes: vec![0xEE, 0xC5, 1, 40]
        }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_chunking_reads_the_same_frames(
        (config, events) in job(200), sizes in proptest::collection::vec(1..90_usize, 1..6),
    ) {
        let bytes = encode(config, &events, 20, OUTPUT_BYTES_MIN).concat();
        let whole = read_all(&bytes[..]);
        prop_assert!(whole.1.is_clean());
        prop_assert_eq!(read_all(Pieces { bytes: &bytes, sizes, turn: 0 }), whole);
    }

    #[test]
    fn undamaged_frames_survive_any_damage(
        (config, events) in job(300), faults in proptest::collection::vec(fault(), 1..6),
    ) {
        let frames = encode(config, &events, 10, OUTPUT_BYTES_MIN);
        prop_assume!(!frames.is_empty());
        // Bytes with the frame they belong to; a frame is whole if its bytes still stand together.
        let mut stream: Vec<(u8, usize)> = frames
            .iter()
            .enumerate()
            .flat_map(|(i, frame)| frame.iter().map(move |byte| (*byte, i)))
            .collect();
        let mut hit = BTreeSet::new();
        for fault in faults {
            if stream.is_empty() {
                break;
            }
            match fault {
                Fault::Flip { at, bits } => {
                    let at = at % stream.len();
                    stream[at].0 ^= bits;
                    hit.insert(stream[at].1);
                }
                Fault::Cut { at, len } => {
                    let at = at % stream.len();
                    let end = (at + len).min(stream.len());
                    hit.extend(stream.drain(at..end).map(|(_, frame)| frame));
                }
                Fault::Insert { at, bytes } => {
                    let at = at % stream.len();
                    // Between two frames nothing is damaged but the gap.
                    if at > 0 && stream[at - 1].1 == stream[at].1 {
                        hit.insert(stream[at].1);
                    }
                    let frame = stream[at].1;
                    stream.splice(at..at, bytes.into_iter().map(|byte| (byte, frame)));
                }
            }
        }
        let bytes: Vec<u8> = stream.iter().map(|(byte, _)| *byte).collect();
        let (sequences, report) = read_all(&bytes[..]);
        let found: BTreeSet<usize> = sequences.iter().map(|seq| *seq as usize).collect();
        for index in 0..frames.len() {
            prop_assert!(
                hit.contains(&index) || found.contains(&index),
                "frame {} of {} is undamaged but was not found: {:?}", index, frames.len(), report
            );
        }
        let last = found.last().map_or(0, |last| last + 1);
        let first = *found.first().unwrap_or(&0);
        prop_assert_eq!(report.frames_lost as usize, last - first - found.len());
    }

    #[test]
    fn any_bytes_are_survived(bytes in proptest::collection::vec(
        prop_oneof![any::<u8>(), Just(0xEE), Just(0xC5), Just(1)], 0..2000,
    )) {
        let (sequences, report) = read_all(&bytes[..]);
        prop_assert_eq!(sequences.len() as u64, report.frames);
    }
}

#[test]
fn lost_repeated_and_reordered_frames_are_told_apart() {
    let sensor = eecvs_nostd::Sensor {
        width: 8,
        height: 8,
    };
    let config = strategies::plain_config(sensor, eecvs_nostd::Transform::Dwt, 8);
    let events: Vec<_> = (0..6)
        .map(|i| eecvs_nostd::Event {
            t_us: i * 32_768,
            x: 1,
            y: 1,
            polarity: eecvs_nostd::Polarity::On,
        })
        .collect();
    let frames = encode(config, &events, 10, 1 << 16);
    let order = [0, 2, 1, 1, 5];
    let bytes: Vec<u8> = order.iter().flat_map(|i| frames[*i].clone()).collect();
    let (sequences, report) = read_all(&bytes[..]);
    assert_eq!(sequences, [0, 2, 1, 5]);
    assert_eq!(
        (
            report.frames_lost,
            report.frames_repeated,
            report.frames_reordered
        ),
        (2, 1, 1)
    );
}
