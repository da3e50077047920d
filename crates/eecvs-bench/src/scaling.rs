//! Measures the time of the whole encoder over the sensor's area and over the number of events.

use std::io::sink;
use std::num::NonZeroUsize;

use anyhow::{Result, ensure};
use eecvs::encode::{Limits, encode};
use eecvs_nostd::{Config, Event, Mode, Sensor, Thresholds, Transform, WindowConfig};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use serde::Serialize;

use super::quartiles;
use super::repeated::Repeated;

/// Width and height of the sensors over which the same events are spread.
const SENSORS: [[u16; 2]; 5] = [
    [128, 128],
    [346, 260],
    [640, 480],
    [1280, 720],
    [2048, 2048],
];
/// Number of events on each of [`SENSORS`].
const AREA_EVENTS: u64 = 3000;
/// Numbers of events on one sensor, [`SENSOR`].
const COUNTS: [u64; 5] = [1000, 10_000, 100_000, 1_000_000, 10_000_000];
/// Largest of [`COUNTS`] that a quick run measures; larger counts get fewer repetitions in a full run.
const QUICK_MOST: u64 = 100_000;
/// Sensor on which [`COUNTS`] are measured.
const SENSOR: Sensor = Sensor {
    width: 346,
    height: 260,
};
const PRESET: Preset = Preset::IndoorFlying;
const SEED: u64 = 1;
const WINDOW_US: u32 = 32_768;
/// Number of emulated events. For larger counts they are repeated, each time later.
const EMULATED: usize = 200_000;
/// Number of events that a window's buffer holds. Its allocation is not part of the measured times.
const WINDOW_EVENTS: usize = 1 << 16;
/// Unused, because the transform is fixed.
const THRESHOLDS: Thresholds = Thresholds::new(0, 0).unwrap();
/// M of the times in the paper.
const PARAMETER_M: u8 = 8;

/// One measurement; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The quantity that varies: `sensor` or `events`.
    pub axis: &'static str,
    /// Number of columns of the sensor.
    pub width: u16,
    /// Number of rows of the sensor.
    pub height: u16,
    /// Number of events encoded.
    pub events: u64,
    /// Number of windows with events.
    pub windows: u64,
    /// Size of all frames in bytes.
    pub bytes_out: u64,
    /// Median encoding time in seconds, from events to frames, without reading and writing.
    pub encode_s: f64,
    /// First quartile of the time in seconds.
    pub encode_s_low: f64,
    /// Third quartile of the time in seconds.
    pub encode_s_high: f64,
    /// `encode_s` divided by `events`, in ns.
    pub ns_per_event: f64,
}

/// Measures both series: first over the sensor's area, then over the number of events.
///
/// The encoder runs with the DCT, M = 8 and windows of 32,768 us on one thread, and allocates its memory before
/// the time begins. `progress` receives the number of events encoded so far.
///
/// # Errors
/// Fails if the encoder does not account for every event, or if a scene has no events.
pub fn measure(is_quick: bool, progress: &mut dyn FnMut(u64)) -> Result<Vec<Row>> {
    let mut encoded = 0;
    let mut advance = |events: u64| {
        encoded += events;
        progress(encoded);
    };
    let mut rows = Vec::new();
    let small = Sensor {
        width: SENSORS[0][0],
        height: SENSORS[0][1],
    };
    let base = events(small, AREA_EVENTS as usize)?;
    for [width, height] in SENSORS {
        let sensor = Sensor { width, height };
        let spread = |side: u16, to: u16, from: u16| {
            (u32::from(side) * u32::from(to) / u32::from(from)) as u16
        };
        let spread: Vec<Event> = base
            .iter()
            .map(|event| Event {
                x: spread(event.x, width, small.width),
                y: spread(event.y, height, small.height),
                ..*event
            })
            .collect();
        let repetitions = if is_quick { 3 } else { 51 };
        rows.push(run(
            "sensor",
            sensor,
            &spread,
            AREA_EVENTS,
            repetitions,
            &mut advance,
        )?);
    }
    let base = events(SENSOR, EMULATED)?;
    for count in COUNTS {
        if is_quick && count > QUICK_MOST {
            break;
        }
        let repetitions = match (is_quick, count) {
            (true, _) => 3,
            (false, ..=QUICK_MOST) => 51,
            (false, _) => 7,
        };
        rows.push(run(
            "events",
            SENSOR,
            &base,
            count,
            repetitions,
            &mut advance,
        )?);
    }
    Ok(rows)
}

/// Returns the first `count` events of the scene, or all if it has fewer.
fn events(sensor: Sensor, count: usize) -> Result<Vec<Event>> {
    let mut scene = emulate(SceneConfig {
        sensor,
        duration_us: u64::from(u32::MAX),
        ..SceneConfig::model_1(PRESET, SEED)
    })?;
    let mut events = Vec::new();
    while events.len() < count && scene.read(&mut events)? > 0 {}
    events.truncate(count);
    ensure!(!events.is_empty(), "the scene has no events");
    Ok(events)
}

/// Measures the encoder on `count` events, which are `base` repeated.
fn run(
    axis: &'static str,
    sensor: Sensor,
    base: &[Event],
    count: u64,
    repetitions: usize,
    advance: &mut dyn FnMut(u64),
) -> Result<Row> {
    let config = Config {
        transform: Some(Transform::Dct),
        m: PARAMETER_M,
        ..Config::new(
            WindowConfig::new(sensor, WINDOW_US),
            THRESHOLDS,
            Mode::Transform,
        )
    };
    let limits = Limits {
        window_events: WINDOW_EVENTS,
        ..Limits::default()
    };
    let mut times = Vec::new();
    let mut last = None;
    // Repetition 0 warms up and is not counted.
    for repetition in 0..=repetitions {
        let mut reader = Repeated::new(base, count, sensor);
        let summary = encode(
            &mut reader,
            config,
            limits,
            NonZeroUsize::MIN,
            &mut sink(),
            &mut |_| (),
        )?;
        if repetition > 0 {
            times.push(summary.encode_s);
        }
        advance(summary.events_in);
        last = Some(summary);
    }
    let summary = last.unwrap_or_default();
    let [encode_s_low, encode_s, encode_s_high] = quartiles(&mut times);
    Ok(Row {
        axis,
        width: sensor.width,
        height: sensor.height,
        events: summary.events_encoded,
        windows: summary.windows,
        bytes_out: summary.bytes_out,
        encode_s,
        encode_s_low,
        encode_s_high,
        ns_per_event: encode_s * 1e9 / summary.events_encoded.max(1) as f64,
    })
}
