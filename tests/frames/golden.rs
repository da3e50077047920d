//! Frozen vectors: input, coefficients and bytes, so that a failure names its stage.
//!
//! `EECVS_BLESS=1 cargo test -p eecvs-tests --test frames golden` writes them anew; review the diff, and
//! raise the wire version where bytes changed.

use std::fmt::Write as _;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use eecvs_nostd::event_link::Setup;
use eecvs_nostd::pack::timed::TimedEvent;
use eecvs_nostd::{
    Axis, Coded, Coder, Config, Effort, Event, Fidelity, Hybrid, Level, Mode, OUTPUT_BYTES_MIN,
    Polarity, Readout, Sensor, Transform,
};
use serde::{Deserialize, Serialize};
use strategies::{encode, parse, plain_config};

/// (x, y, on, off, what tells the coefficients).
type GoldenPixel = (u16, u16, u32, u32, GoldenCoded);

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
enum GoldenCoded {
    /// A single event's.
    Cell(u32),
    /// [(k, re, im)], levels as on the link.
    Levels(Vec<(u16, i32, i32)>),
    /// [(cell, p)] of few events that are sent as times.
    Times(Vec<(u32, u8)>),
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Golden {
    width: u16,
    height: u16,
    transform: String,
    m: u8,
    /// Mode and fidelity's value, as in a setup of the event link.
    #[serde(default)]
    mode: u8,
    #[serde(default)]
    fidelity: u32,
    /// Period and slope of the columns' scans, in 2^-16 us.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    scans: Option<(u32, i32)>,
    /// Whether pixels of few events are sent as times.
    #[serde(default, skip_serializing_if = "is_false")]
    few_as_times: bool,
    /// (t_us, x, y, p)
    events: Vec<(u64, u16, u16, u8)>,
    pixels: Vec<GoldenPixel>,
    /// Frames in hexadecimal.
    frames: Vec<String>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it")]
const fn is_false(value: &bool) -> bool {
    !*value
}

/// Two windows: single events, a pair, a burst of mixed polarity, a crowded pixel beyond one
/// chunk, the last column and row.
fn events() -> Vec<Event> {
    let mut events = Vec::new();
    let mut put = |t_us: u64, x, y, on| {
        events.push(Event {
            t_us: 1_700_000_000_000_000 + t_us,
            x,
            y,
            polarity: Polarity::from_bool(on),
        });
    };
    put(0, 3, 1, true);
    put(16_384, 3, 1, false);
    put(100, 39, 2, true);
    for i in 0..9 {
        put(200 + i * 3_001, 33, 0, i % 3 != 0);
    }
    for i in 0..300 {
        put(500 + i * 97, 0, 2, i % 5 != 0);
    }
    put(32_767, 39, 2, false);
    put(40_000, 12, 1, false);
    events
}

/// The same twice, in windows of their own: the second frames of the dense and the tree coder go on from the first.
fn events_twice() -> Vec<Event> {
    let mut events = events();
    let later = events.clone().into_iter().map(|event| Event {
        t_us: event.t_us + 65_536,
        ..event
    });
    events.extend(later);
    events
}

/// Describes frames of events.
fn hybrid_golden(config: &Config, events: &[Event], frames: &[Vec<u8>]) -> Golden {
    let setup = Setup::new(config, 0);
    let scans = |readout: Readout| (readout.period_q16(), readout.slope_q16());
    Golden {
        width: setup.width,
        height: setup.height,
        transform: "dct".into(),
        m: setup.m,
        mode: setup.mode,
        fidelity: setup.fidelity,
        scans: config.readout.map(scans),
        few_as_times: false,
        events: listed(events),
        pixels: vec![],
        frames: frames.iter().map(|bytes| hex(bytes)).collect(),
    }
}

#[test]
fn hybrid_frames_are_those_of_the_golden_vectors() {
    let sensor = Sensor {
        width: 40,
        height: 3,
    };
    let events = events_twice();
    let lossless = Fidelity::Lossless;
    // The tree coder's windows are whole, or they are the dense coder's.
    let whole = 1 << 14;
    let spread = Fidelity::SpreadUs(1500);
    for (name, coder, fidelity, frame_bytes) in [
        ("v2_hybrid_fast", Coder::Fast, lossless, OUTPUT_BYTES_MIN),
        ("v2_hybrid_dense", Coder::Dense, lossless, OUTPUT_BYTES_MIN),
        (
            "v2_hybrid_fast_tolerance",
            Coder::Fast,
            Fidelity::ToleranceUs(20),
            OUTPUT_BYTES_MIN,
        ),
        (
            "v2_hybrid_dense_bins",
            Coder::Dense,
            Fidelity::Bins(8),
            OUTPUT_BYTES_MIN,
        ),
        (
            "v2_hybrid_fast_spread",
            Coder::Fast,
            spread,
            OUTPUT_BYTES_MIN,
        ),
        (
            "v2_hybrid_dense_spread",
            Coder::Dense,
            spread,
            OUTPUT_BYTES_MIN,
        ),
        ("v4_keys_spread", Coder::Keys, spread, whole),
        ("v4_tree_1_spread", Coder::Tree(Effort::One), spread, whole),
        ("v4_keys", Coder::Keys, lossless, OUTPUT_BYTES_MIN),
        (
            "v4_keys_tolerance",
            Coder::Keys,
            Fidelity::ToleranceUs(20),
            whole,
        ),
        ("v4_quick", Coder::Quick, lossless, OUTPUT_BYTES_MIN),
        ("v4_tree_1", Coder::Tree(Effort::One), lossless, whole),
        ("v4_tree_2", Coder::Tree(Effort::Two), lossless, whole),
        ("v4_tree_3", Coder::Tree(Effort::Three), lossless, whole),
        (
            "v4_tree_1_tolerance",
            Coder::Tree(Effort::One),
            Fidelity::ToleranceUs(20),
            whole,
        ),
    ] {
        let mut config = plain_config(sensor, Transform::Dct, 16);
        config.mode = Mode::Hybrid(Hybrid { coder, fidelity });
        let frames = encode(config, &events, 1000, frame_bytes);
        for frame in &frames {
            assert_eq!(parse(frame).header.mode, config.mode, "{name}");
        }
        let golden = hybrid_golden(&config, &events, &frames);
        let frozen = frozen(&format!("{name}.json"), &golden);
        assert_eq!(golden.events, frozen.events, "{name}: events");
        assert_eq!(golden.frames, frozen.frames, "{name}: bytes");
    }
}

/// Windows whose times are as coarse as a mean error allows: the second one's is found from what the first one left.
#[test]
fn frames_of_a_mean_error_are_those_of_the_golden_vectors() {
    let sensor = Sensor {
        width: 40,
        height: 3,
    };
    let events = events_twice();
    let whole = 1 << 14;
    for (name, coder, max_emd_us, frame_bytes) in [
        ("v2_hybrid_fast_emd", Coder::Fast, 20, OUTPUT_BYTES_MIN),
        ("v2_hybrid_fast_emd_ms", Coder::Fast, 2000, OUTPUT_BYTES_MIN),
        (
            "v2_hybrid_dense_emd_ms",
            Coder::Dense,
            2000,
            OUTPUT_BYTES_MIN,
        ),
        ("v4_keys_emd_ms", Coder::Keys, 2000, whole),
    ] {
        let mut config = plain_config(sensor, Transform::Dct, 16);
        config.mode = Mode::Hybrid(Hybrid {
            coder,
            fidelity: Fidelity::Lossless,
        });
        config.max_emd_us = NonZeroU32::new(max_emd_us);
        let frames = encode(config, &events, 1000, frame_bytes);
        let golden = hybrid_golden(&config, &events, &frames);
        let frozen = frozen(&format!("{name}.json"), &golden);
        assert_eq!(golden, frozen, "{name}");
    }
}

/// Events on the scans of a sensor and beside them, in two windows.
#[test]
fn frames_with_scans_are_those_of_the_golden_vectors() {
    let sensor = Sensor {
        width: 40,
        height: 3,
    };
    let readout = Readout::new(Axis::Columns, (197 << 16) + 18_559, -39_327).expect("in range");
    let mut events: Vec<Event> = (0..400_u64)
        .map(|i| {
            let mixed = i.wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let x = (mixed >> 20) as u16 % 40;
            let scan = mixed >> 50 & 255;
            let lag_q16 = i64::from(readout.slope_q16()) * i64::from(x);
            let since_q16 = scan as i64 * i64::from(readout.period_q16()) + lag_q16;
            // One in eight is a few microseconds off.
            let beside = if i % 8 == 0 { mixed >> 40 & 7 } else { 0 };
            Event {
                t_us: (1_700_000_000_000_100 + ((since_q16 + (1 << 15)) >> 16)) as u64 + beside,
                x,
                y: (mixed >> 30) as u16 % 3,
                polarity: Polarity::from_bool(mixed >> 60 > 7),
            }
        })
        .collect();
    events.sort_by_key(|event| event.t_us);
    let whole = 1 << 14;
    for (name, coder, frame_bytes) in [
        ("v2_hybrid_dense_scans", Coder::Dense, OUTPUT_BYTES_MIN),
        ("v4_tree_1_scans", Coder::Tree(Effort::One), whole),
        ("v4_tree_2_scans", Coder::Tree(Effort::Two), whole),
        ("v4_tree_3_scans", Coder::Tree(Effort::Three), whole),
    ] {
        let fidelity = Fidelity::Lossless;
        let mut config = plain_config(sensor, Transform::Dct, 16);
        config.mode = Mode::Hybrid(Hybrid { coder, fidelity });
        config.readout = Some(readout);
        let frames = encode(config, &events, 1000, frame_bytes);
        for frame in &frames {
            let header = parse(frame).header;
            assert!(
                header.scans.is_some() && header.mode == config.mode,
                "{name}"
            );
        }
        let golden = hybrid_golden(&config, &events, &frames);
        let frozen = frozen(&format!("{name}.json"), &golden);
        assert_eq!(golden, frozen, "{name}");
    }
}

fn listed(events: &[Event]) -> Vec<(u64, u16, u16, u8)> {
    let plain = |e: &Event| (e.t_us, e.x, e.y, e.polarity as u8);
    events.iter().map(plain).collect()
}

/// The vector of a file, which is written anew where that is asked for.
fn frozen(name: &str, golden: &Golden) -> Golden {
    // Another folder than the committed one.
    let folder = std::env::var_os("EECVS_GOLDEN").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("golden"));
    let path = folder.join(name);
    if std::env::var_os("EECVS_BLESS").is_some() {
        let text = serde_json::to_string(golden).expect("plain data") + "\n";
        std::fs::write(&path, text).expect("the golden folder is writable");
    }
    let text = std::fs::read_to_string(&path).expect("a golden vector");
    serde_json::from_str(&text).expect("a golden vector's JSON")
}

#[test]
fn frames_are_those_of_the_golden_vectors() {
    let sensor = Sensor {
        width: 40,
        height: 3,
    };
    let events = events();
    for (transform, few_as_times) in Transform::ALL
        .into_iter()
        .flat_map(|transform| [(transform, false), (transform, true)])
    {
        for m in [8, 16] {
            let config = Config {
                few_as_times,
                ..plain_config(sensor, transform, m)
            };
            let frames = encode(config, &events, 1000, OUTPUT_BYTES_MIN);
            let golden = Golden {
                width: sensor.width,
                height: sensor.height,
                transform: transform.name().into(),
                m,
                mode: 0,
                fidelity: 0,
                scans: None,
                few_as_times,
                events: listed(&events),
                pixels: frames.iter().flat_map(|bytes| pixels(bytes)).collect(),
                frames: frames.iter().map(|bytes| hex(bytes)).collect(),
            };
            let name = match few_as_times {
                false => format!("v2_{}_{m}.json", transform.name()),
                true => format!("v3_{}_{m}_few.json", transform.name()),
            };
            let frozen = frozen(&name, &golden);
            assert_eq!(golden.events, frozen.events, "{transform:?} {m}: events");
            assert_eq!(golden.pixels, frozen.pixels, "{transform:?} {m}: levels");
            assert_eq!(golden.frames, frozen.frames, "{transform:?} {m}: bytes");
        }
    }
}

fn pixels(bytes: &[u8]) -> Vec<GoldenPixel> {
    parse(bytes)
        .descriptors()
        .map(|descriptor| {
            let d = descriptor.expect("the encoder's own payload");
            let coded = match d.coded {
                Coded::Cell(cell) => GoldenCoded::Cell(cell),
                Coded::Times(events) => {
                    let time = |event: &TimedEvent| (event.cell, u8::from(event.is_on));
                    GoldenCoded::Times(events.iter().map(time).collect())
                }
                Coded::Levels(levels) => {
                    let level = |level: &Level| (level.k, level.re, level.im);
                    GoldenCoded::Levels(levels.iter().map(level).collect())
                }
            };
            (d.x, d.y, d.on, d.off, coded)
        })
        .collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").expect("a string");
        text
    })
}
