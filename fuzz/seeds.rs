//! Writes the small recordings in fuzz/seeds/ from which fuzzing starts: `cargo run --example seeds`. The Python
//! scripts in that folder write the seeds of HDF5, MAT, Arrow, Parquet and bags in SQLite.

use std::path::Path;

use eecvs::encode::HostStorage;
use eecvs_nostd::{
    Coder, Config, Effort, Encoder, Event, Fidelity, Frame, Hybrid, Mode, Polarity, Push, Sensor,
    Thresholds, Transform, WindowConfig,
};
use targets::encode::to_mode;

const SEEDS: [(&str, &str, Sensor); 15] = [
    (
        "read_aedat4",
        "events.aedat4",
        Sensor {
            width: 346,
            height: 260,
        },
    ),
    (
        "read_aedat2",
        "dvs128.aedat",
        Sensor {
            width: 128,
            height: 128,
        },
    ),
    (
        "read_aedat2",
        "davis240c.aedat",
        Sensor {
            width: 240,
            height: 180,
        },
    ),
    (
        "read_evt2",
        "events.evt2",
        Sensor {
            width: 640,
            height: 480,
        },
    ),
    (
        "read_evt21",
        "events.evt21",
        Sensor {
            width: 640,
            height: 480,
        },
    ),
    (
        "read_evt4",
        "events.evt4",
        Sensor {
            width: 640,
            height: 480,
        },
    ),
    (
        "read_dat",
        "events.dat",
        Sensor {
            width: 640,
            height: 480,
        },
    ),
    (
        "read_nmnist",
        "events.bin",
        Sensor {
            width: 34,
            height: 34,
        },
    ),
    (
        "read_es",
        "events.es",
        Sensor {
            width: 320,
            height: 240,
        },
    ),
    (
        "read_evt3",
        "events.raw",
        Sensor {
            width: 640,
            height: 480,
        },
    ),
    (
        "read_mcap",
        "events.mcap",
        Sensor {
            width: 64,
            height: 64,
        },
    ),
    (
        "read_rosbag",
        "events.bag",
        Sensor {
            width: 64,
            height: 64,
        },
    ),
    (
        "read_text",
        "events.csv",
        Sensor {
            width: 64,
            height: 64,
        },
    ),
    (
        "read_text",
        "events.txt",
        Sensor {
            width: 64,
            height: 64,
        },
    ),
    (
        "read_npz",
        "events.npz",
        Sensor {
            width: 64,
            height: 64,
        },
    ),
];

/// Returns the events of one short window.
fn events() -> Vec<Event> {
    (0..24)
        .map(|i| Event {
            t_us: 16_777_200 + u64::from(i / 4) * 9,
            x: 10 + i % 4 * 2,
            y: 20 + i / 8,
            polarity: Polarity::from_bool(i % 8 < 4),
        })
        .collect()
}

fn main() -> anyhow::Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("seeds");
    for (target, name, sensor) in SEEDS {
        let folder = root.join(target);
        std::fs::create_dir_all(&folder)?;
        let mut events = events();
        if target == "read_es" || target == "read_nmnist" {
            // ES takes a byte per 127 us elapsed, and N-MNIST has 23 bits of time.
            events.iter_mut().for_each(|event| event.t_us -= 16_776_000);
        }
        let mut writer = event_files::create(&folder.join(name), sensor)?;
        writer.write(&events)?;
        writer.finish()?;
    }
    frames(&root.join("frames"))?;
    sealed(&root.join("sealed"))?;
    uncompressed(&root.join("read_aedat4"))
}

/// Writes one file of frames per transform and per way to code events, with three windows each.
fn frames(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)?;
    let sensor = Sensor {
        width: 64,
        height: 64,
    };
    let of_events = [
        ("fast", lossless(Coder::Fast), false),
        ("keys", lossless(Coder::Keys), false),
        ("quick", lossless(Coder::Quick), false),
        ("dense", lossless(Coder::Dense), false),
        ("tree-1", lossless(Coder::Tree(Effort::One)), false),
        ("tree-2", lossless(Coder::Tree(Effort::Two)), false),
        ("tree-3", lossless(Coder::Tree(Effort::Three)), false),
        ("fast-ordered", lossless(Coder::Fast), true),
        ("dense-ordered", lossless(Coder::Dense), true),
        ("coefficients", Mode::Coefficients(Coder::Dense), false),
    ];
    let of_events = of_events.map(|(name, mode, keep_order)| (name, mode, None, keep_order));
    let of_transforms =
        Transform::ALL.map(|transform| (transform.name(), Mode::Transform, Some(transform), false));
    for (name, mode, transform, keep_order) in of_transforms.into_iter().chain(of_events) {
        let config = Config {
            keep_order,
            ..config(sensor, 20, mode, transform)
        };
        let frames = encode(config, events())?;
        std::fs::write(folder.join(format!("{name}.eecvs")), frames.concat())?;
    }
    Ok(())
}

fn lossless(coder: Coder) -> Mode {
    let fidelity = Fidelity::Lossless;
    Mode::Hybrid(Hybrid { coder, fidelity })
}

fn config(sensor: Sensor, window_us: u32, mode: Mode, transform: Option<Transform>) -> Config {
    let thresholds = Thresholds::new(0, 0).unwrap_or_else(|| unreachable!("in order"));
    Config {
        transform,
        m: 8,
        ..Config::new(WindowConfig::new(sensor, window_us), thresholds, mode)
    }
}

/// Returns the frames of events.
fn encode(config: Config, events: Vec<Event>) -> anyhow::Result<Vec<Vec<u8>>> {
    let mut storage = HostStorage::new(config.window.sensor, 1000);
    let mut encoder = storage.encoder(config)?;
    let mut out = vec![0; 1 << 16];
    let mut frames = Vec::new();
    let mut events = events.into_iter();
    let mut next = events.next();
    while let Some(event) = next {
        if encoder.push(event) == Push::Closed {
            take(&mut encoder, &mut out, &mut frames);
        } else {
            next = events.next();
        }
    }
    encoder.flush();
    take(&mut encoder, &mut out, &mut frames);
    Ok(frames)
}

/// Writes inputs of the target `sealed` that decode: two windows of each way to code events, and of each transform.
fn sealed(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)?;
    let modes = (0..=255_u8).flat_map(|mode| [0, 1, 2].map(|fidelity| (mode, fidelity)));
    let mut seen = Vec::new();
    for (mode, fidelity) in modes {
        let kind = to_mode(mode, fidelity * 16);
        let transform = Transform::ALL[usize::from(mode >> 4) % 3];
        let key = (kind, kind.is_transform().then_some(transform));
        if seen.contains(&key) {
            continue;
        }
        seen.push(key);
        let ways = [(1, false), (8, false), (40, false), (40, true)];
        let is_transform = kind.is_transform();
        for (pixels, few_as_times) in ways.into_iter().filter(|(_, few)| is_transform || !few) {
            // A payload but the last has whole words: some number of events makes one.
            let input = (100..250).find_map(|count| {
                let config = Config {
                    few_as_times,
                    ..config(
                        targets::sealed::SENSOR,
                        targets::sealed::WINDOW_US,
                        kind,
                        Some(transform),
                    )
                };
                let frames = encode(config, bursts(count, pixels)).ok()?;
                to_sealed(mode, &frames)
            });
            let few = if few_as_times { "-few" } else { "" };
            let name = format!("{mode:02x}-{fidelity}-{pixels}{few}");
            match input {
                Some(input) => std::fs::write(folder.join(name), input)?,
                None => println!("no seed sealed/{name}: an input cannot say such frames"),
            }
        }
    }
    Ok(())
}

/// Returns events of two windows of [`sealed`], at so many pixels.
fn bursts(count: u32, pixels: u32) -> Vec<Event> {
    let mut events: Vec<_> = (0..count)
        .map(|i| {
            let hash = i.wrapping_mul(0x9E37_79B1) ^ i << 7;
            let pixel = (hash >> 8) % pixels;
            Event {
                t_us: u64::from(hash >> 16) % (2 * u64::from(targets::sealed::WINDOW_US)),
                x: (pixel % 9 * 3 % 40) as u16,
                y: (pixel / 9 * 5 % 24) as u16,
                polarity: Polarity::from_bool(hash >> 4 & 3 != 0),
            }
        })
        .collect();
    events.sort_by_key(|event| event.t_us);
    events
}

/// Returns the input of the target `sealed` that makes these frames; `None` if none does.
fn to_sealed(mode: u8, frames: &[Vec<u8>]) -> Option<Vec<u8>> {
    let mut input = Vec::new();
    for (i, bytes) in frames.iter().enumerate() {
        let frame = Frame::parse(bytes).ok()?;
        let (header, payload) = (&frame.header, frame.payload);
        let is_last = i + 1 == frames.len();
        if !is_last && payload.len() % 4 != 0 {
            return None;
        }
        // What tells the fidelity tells the levels too.
        let levels = header
            .levels
            .map(|levels| levels.first | levels.second << 3);
        let fidelity = (0..=255_u8).find(|fidelity| {
            to_mode(mode, *fidelity) == header.mode
                && levels.is_none_or(|levels| fidelity & 63 == levels)
                && (header.timed_max == 0 || targets::sealed::few(*fidelity) == header.timed_max)
        })?;
        let bits = [
            header.begins_run,
            header.last,
            header.is_key,
            header.has_previous,
            false,
            false,
            header.part > 0,
            header.timed_max > 0,
        ];
        let flags = bits
            .iter()
            .rev()
            .fold(0, |flags, bit| flags << 1 | u8::from(*bit));
        input.extend([
            u8::try_from(payload.len().div_ceil(4)).ok()?,
            flags,
            mode,
            fidelity,
            u8::try_from(header.window_events).ok()?,
            u8::try_from(header.events).ok()?,
            u8::try_from(header.pixels).ok()?,
            0,
        ]);
        input.extend_from_slice(payload);
    }
    Some(input)
}

fn take(encoder: &mut Encoder<'_>, out: &mut [u8], frames: &mut Vec<Vec<u8>>) {
    while let Ok(Some(encoded)) = encoder.next_frame(out) {
        frames.push(out[encoded.range].to_vec());
    }
}

/// Writes the same events in an uncompressed packet: checksums of compressed packets would stop the fuzzer.
fn uncompressed(folder: &Path) -> anyhow::Result<()> {
    let lz4 = std::fs::read(folder.join("events.aedat4"))?;
    let number = |at: usize| -> anyhow::Result<usize> {
        let bytes = lz4.get(at..).and_then(|rest| rest.first_chunk()).copied();
        Ok(u32::from_le_bytes(bytes.unwrap_or_default()) as usize)
    };
    let packet = 18 + number(14)?;
    let size = number(packet + 4)?;
    let mut content = Vec::new();
    let mut frame = lz4_flex::frame::FrameDecoder::new(&lz4[packet + 8..packet + 8 + size]);
    std::io::copy(&mut frame, &mut content)?;
    let mut plain = lz4[..packet].to_vec();
    plain[46..50].fill(0);
    plain[54..62].fill(0xff);
    plain.extend_from_slice(&lz4[packet..packet + 4]);
    plain.extend_from_slice(&(content.len() as u32).to_le_bytes());
    plain.extend_from_slice(&content);
    std::fs::write(folder.join("plain.aedat4"), plain)?;
    Ok(())
}
