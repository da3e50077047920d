//! Proptest generators and small helpers shared by the integration tests.

pub mod one_pixel;

use std::num::NonZeroUsize;
use std::path::Path;

use eecvs::decode::WindowReader;
use eecvs::encode::{EncodeSummary, HostStorage, Limits, encode as encode_events};
use eecvs::frame_file::{FrameFileWriter, FrameReader};
use eecvs::reconstruct::DecodedWindow;
use eecvs_bench::marks::Marks;
use eecvs_bench::record_file::{self, RecordFile};
use eecvs_nostd::frame::{CRC_BYTES, HEADER_BYTES_MAX, seal};
use eecvs_nostd::{
    Coder, Config, Effort, Encoder, Event, Fidelity, Frame, Header, Hybrid, Mode, Polarity, Push,
    Quantiser, Scan, Sensor, Thresholds, Transform, WindowConfig, scan,
};
use event_types::stream::MemoryReader;
use proptest::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// A sensor with sides of 1 to 80: several segments in a row, and a last one that is not full.
pub fn sensor() -> impl Strategy<Value = Sensor> {
    (1..=80_u16, 1..=40_u16).prop_map(|(width, height)| Sensor { width, height })
}

/// Events on `sensor`: bursts of equal times, gaps beyond several windows, some backward steps,
/// few pixels so that many share one, from any start.
pub fn events(sensor: Sensor, most: usize) -> impl Strategy<Value = Vec<Event>> {
    let start = prop_oneof![
        Just(0_u64),
        Just(1_700_000_000_000_000),
        Just(u64::from(u32::MAX) - 500),
        any::<u32>().prop_map(u64::from),
    ];
    let step = prop_oneof![
        4 => Just(0_i64),
        10 => 0..200_i64,
        1 => 0..20_000_i64,
        1 => -300..0_i64,
    ];
    let pixel = (0..sensor.width, 0..sensor.height, any::<bool>());
    let crowded = (
        0..sensor.width.min(3),
        0..sensor.height.min(2),
        any::<bool>(),
    );
    let item = (step, prop_oneof![pixel, crowded]);
    (start, proptest::collection::vec(item, 0..=most)).prop_map(|(start, items)| {
        let mut t_us = start;
        items
            .into_iter()
            .map(|(step, (x, y, on))| {
                t_us = t_us.saturating_add_signed(step);
                Event {
                    t_us,
                    x,
                    y,
                    polarity: Polarity::from_bool(on),
                }
            })
            .collect()
    })
}

/// Any transform.
pub fn transform() -> impl Strategy<Value = Transform> {
    proptest::sample::select(Transform::ALL.to_vec())
}

/// A configuration for `sensor`: any transform or the regime's, any M, default or other grids.
pub fn config(sensor: Sensor) -> impl Strategy<Value = Config> {
    (
        prop_oneof![1..50_u32, 500..5000_u32, Just(32_768)],
        proptest::option::of(transform()),
        1..=64_u8,
        proptest::option::weighted(0.3, 1..=128_u16),
        -15..=8_i8,
        (0..2_000_000_000_000_u64, 0..50_000_000_000_000_u64),
        proptest::bool::weighted(0.3),
    )
        .prop_map(
            move |(window_us, transform, m, grid, step_log2, (low, more), few_as_times)| Config {
                transform,
                m,
                grid,
                quantiser: Quantiser::new(step_log2).expect("-15 to 8"),
                few_as_times,
                ..Config::new(
                    WindowConfig::new(sensor, window_us),
                    Thresholds::new(low, low + more).expect("low is not above high"),
                    Mode::Transform,
                )
            },
        )
}

/// Any coder and fidelity.
pub fn hybrid() -> impl Strategy<Value = Hybrid> {
    let fidelity = prop_oneof![
        2 => Just(Fidelity::Lossless),
        1 => (0_u32..3000).prop_map(Fidelity::ToleranceUs),
        1 => (1_u16..300).prop_map(Fidelity::Bins),
        1 => (1_u32..3000).prop_map(Fidelity::SpreadUs),
    ];
    let effort = prop_oneof![
        4 => Just(Effort::One),
        1 => Just(Effort::Two),
        1 => Just(Effort::Three),
    ];
    let coder = prop_oneof![
        Just(Coder::Fast),
        Just(Coder::Dense),
        Just(Coder::Keys),
        Just(Coder::Quick),
        effort.prop_map(Coder::Tree),
    ];
    (coder, fidelity).prop_map(|(coder, fidelity)| Hybrid {
        coder,
        // The quick coder has no other.
        fidelity: match coder {
            Coder::Quick => Fidelity::Lossless,
            _ => fidelity,
        },
    })
}

/// A configuration with its sensor and events.
pub fn job(most: usize) -> impl Strategy<Value = (Config, Vec<Event>)> {
    sensor().prop_flat_map(move |sensor| (config(sensor), events(sensor, most)))
}

/// A plain configuration.
#[must_use]
pub fn plain_config(sensor: Sensor, transform: Transform, m: u8) -> Config {
    Config {
        transform: Some(transform),
        m,
        ..Config::new(
            WindowConfig::new(sensor, 32_768),
            Thresholds::new(0, 0).expect("equal thresholds"),
            Mode::Transform,
        )
    }
}

/// Every frame that the encoder makes of `events`, with room for `window_events` in a window and
/// `frame_bytes` in a frame.
#[must_use]
pub fn encode(
    config: Config,
    events: &[Event],
    window_events: usize,
    frame_bytes: usize,
) -> Vec<Vec<u8>> {
    encode_windows(config, &[], events, (window_events, frame_bytes)).0
}

/// The events of a window as they were pushed, and the number of those that are in frames.
pub type PushedWindow = (Vec<Event>, u32);

/// As [`encode`], without the pixels `hot`, and with the windows.
#[must_use]
pub fn encode_windows(
    config: Config,
    hot: &[(u16, u16)],
    events: &[Event],
    (window_events, frame_bytes): (usize, usize),
) -> (Vec<Vec<u8>>, Vec<PushedWindow>) {
    let mut storage = HostStorage::new(config.window.sensor, window_events);
    let encoder = storage.encoder_without(config, hot);
    let mut encoder = encoder.expect("a valid configuration");
    let mut out = vec![0; frame_bytes];
    let (mut frames, mut windows, mut open) = (vec![], vec![], vec![]);
    let mut close = |encoder: &mut Encoder<'_>, open: &mut Vec<Event>| {
        let mut sent = 0;
        while let Some(frame) = encoder.next_frame(&mut out).expect("room for a frame") {
            sent += frame.header.events;
            frames.push(out[frame.range].to_vec());
        }
        windows.push((std::mem::take(open), sent));
    };
    for event in events {
        let mut push = encoder.push(*event);
        while push == Push::Closed {
            close(&mut encoder, &mut open);
            push = encoder.push(*event);
        }
        if push == Push::Stored {
            open.push(*event);
        }
    }
    encoder.flush();
    close(&mut encoder, &mut open);
    (frames, windows)
}

/// 300,000 events whose times ascend, and then step back by less than the reordering time.
pub fn stepping_back(sensor: Sensor) -> Vec<Event> {
    let event = |i: u64| {
        let mixed = i.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let back = if i > 200_000 { mixed >> 60 } else { 0 };
        Event {
            t_us: 1_000_000 + i / 3 - back,
            x: (mixed >> 20) as u16 % sensor.width,
            y: (mixed >> 40) as u16 % sensor.height,
            polarity: Polarity::from_bool(mixed >> 59 & 1 == 1),
        }
    };
    (0..300_000).map(event).collect()
}

/// Encodes all events into a file, on so many threads, and decodes it; both count the same windows in order.
pub fn through_a_file(
    config: Config,
    limits: Limits,
    threads: usize,
    events: &[Event],
) -> (EncodeSummary, Vec<DecodedWindow>) {
    let mut reader = MemoryReader::new(config.window.sensor, events.to_vec());
    let mut out = FrameFileWriter::new(Vec::new());
    let threads = NonZeroUsize::new(threads).expect("not 0");
    let summary = encode_events(&mut reader, config, limits, threads, &mut out, &mut |_| ());
    let summary = summary.expect("memory");
    assert_eq!(summary.events_encoded, events.len() as u64);
    let file = out.finish().expect("memory");
    let mut reader = WindowReader::new(FrameReader::new(&file[..]));
    let mut windows = Vec::new();
    while let Some(window) = reader.next_window().expect("memory") {
        windows.push(window);
    }
    assert!(reader.report().is_clean());
    assert_eq!(reader.counts().windows_in_order, summary.windows_in_order);
    (summary, windows)
}

/// The frame of a header and a payload.
#[must_use]
pub fn sealed(header: &Header, payload: &[u8]) -> Vec<u8> {
    let mut out = vec![0; HEADER_BYTES_MAX + payload.len() + CRC_BYTES];
    out[HEADER_BYTES_MAX..][..payload.len()].copy_from_slice(payload);
    let range = seal(header, payload.len(), &mut out).expect("room");
    out[range].to_vec()
}

/// The frame that `bytes` are.
#[must_use]
pub fn parse(bytes: &[u8]) -> Frame<'_> {
    match scan(bytes) {
        Scan::Frame(frame) if frame.bytes == bytes.len() => frame,
        other => panic!("not one whole frame: {other:?}"),
    }
}

/// Holds what a test measured against its committed record, or writes that, and the section of the document,
/// where `EECVS_BLESS` is set: `section` makes it, if it can, of the records in a folder. Numbers may be apart by
/// `tolerance` of the record's: where floats decide, another machine's `sin` is not this one's to the last bit. The
/// document is compared with its record by a test of `host-harness`.
///
/// # Panics
/// Rows that are not those of the record.
pub fn hold_against_record<R>(
    name: &str,
    rows: &[R],
    tolerance: f64,
    (document, marks): (&str, Marks),
    section: impl FnOnce(&Path) -> Option<String>,
) where
    R: Serialize + DeserializeOwned + std::fmt::Debug,
{
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = root.join("host-harness/record");
    if std::env::var_os("EECVS_BLESS").is_some() {
        record_file::write(&folder, name, rows).expect("the record is writable");
        let document = root.join(document);
        if let Some(section) = section(&folder) {
            marks
                .write(&document, &section)
                .expect("the document's marks");
        }
        return;
    }
    let record: RecordFile<R> = record_file::read(&folder, name).expect("a record");
    let values = |rows: &[R]| serde_json::to_value(rows).expect("plain data");
    assert!(
        is_near(&values(rows), &values(&record.rows), tolerance),
        "not the rows of {name}.json, which `cargo xtask record` writes anew: {rows:#?}"
    );
}

/// Whether two values are the same, but for numbers that are apart by `tolerance` of the second at the most.
fn is_near(a: &Value, b: &Value, tolerance: f64) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => a
            .as_f64()
            .zip(b.as_f64())
            .is_some_and(|(a, b)| (a - b).abs() <= tolerance * b.abs()),
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_near(a, b, tolerance))
        }
        (Value::Object(a), Value::Object(b)) => {
            a.len() == b.len()
                && a.iter()
                    .all(|(key, a)| b.get(key).is_some_and(|b| is_near(a, b, tolerance)))
        }
        _ => a == b,
    }
}
