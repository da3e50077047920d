//! Writes the small recordings in fuzz/seeds/ from which fuzzing starts: `cargo run --example seeds`. The Python
//! scripts in that folder write the seeds of HDF5, MAT, Arrow, Parquet and bags in SQLite.

use std::path::Path;

use eecvs::encode::HostStorage;
use eecvs_nostd::{
    Coder, Config, Encoder, Event, Fidelity, Filter, Hybrid, KEY_WINDOWS, Mode, Polarity, Push,
    Quantiser, Sensor, Thresholds, Transform, WindowConfig,
};

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
    uncompressed(&root.join("read_aedat4"))
}

/// Writes one file of frames per transform and per way to code events, with three windows each.
fn frames(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)?;
    let sensor = Sensor {
        width: 64,
        height: 64,
    };
    let lossless = |coder| {
        Mode::Hybrid(Hybrid {
            coder,
            fidelity: Fidelity::Lossless,
        })
    };
    let of_events = [
        ("fast", lossless(Coder::Fast), false),
        ("keys", lossless(Coder::Keys), false),
        ("dense", lossless(Coder::Dense), false),
        ("fast-ordered", lossless(Coder::Fast), true),
        ("dense-ordered", lossless(Coder::Dense), true),
        ("coefficients", Mode::Coefficients(Coder::Dense), false),
    ];
    let of_events = of_events.map(|(name, mode, keep_order)| (name, mode, None, keep_order));
    let of_transforms =
        Transform::ALL.map(|transform| (transform.name(), Mode::Transform, Some(transform), false));
    for (name, mode, transform, keep_order) in of_transforms.into_iter().chain(of_events) {
        let config = Config {
            window: WindowConfig::new(sensor, 20),
            thresholds: Thresholds::new(0, 0).unwrap_or_else(|| unreachable!("in order")),
            transform,
            m: 8,
            grid: None,
            quantiser: Quantiser::DEFAULT,
            mode,
            key_windows: KEY_WINDOWS,
            readout: None,
            filter: Filter::NONE,
            bytes_per_second: None,
            keep_order,
        };
        let mut storage = HostStorage::new(sensor, 100);
        let mut encoder = storage.encoder(config)?;
        let mut out = vec![0; 4096];
        let mut bytes = Vec::new();
        let mut events = events().into_iter();
        let mut next = events.next();
        while let Some(event) = next {
            if encoder.push(event) == Push::Closed {
                take(&mut encoder, &mut out, &mut bytes);
            } else {
                next = events.next();
            }
        }
        encoder.flush();
        take(&mut encoder, &mut out, &mut bytes);
        std::fs::write(folder.join(format!("{name}.eecvs")), bytes)?;
    }
    Ok(())
}

fn take(encoder: &mut Encoder<'_>, out: &mut [u8], bytes: &mut Vec<u8>) {
    while let Ok(Some(encoded)) = encoder.next_frame(out) {
        bytes.extend_from_slice(&out[encoded.range]);
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
