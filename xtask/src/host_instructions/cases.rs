//! What is counted: the encoder and the decoder on the window of [`moderate`], by every transform and every coder of
//! events, three readers, and conversions between files.

use std::fs;
use std::hint::black_box;
use std::io::Cursor;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use eecvs::encode::{HostStorage, WINDOW_EVENTS, readout};
use eecvs::reconstruct::hybrid::{HybridDecoder, Refused};
use eecvs_bench::moderate::{self, SENSOR, config, encode};
use eecvs_nostd::ingest::reorder::Reorder;
use eecvs_nostd::{
    Coder, Config, Effort, Event, FRAME_BYTES_MAX, Fidelity, Hybrid, Mode, Polarity, Scan,
    Transform, Window, WindowBuffers, WindowConfig, scan,
};
use event_files::Reading;
use event_files::convert::{Conversion, Converted, convert};

/// Events of the files, at the most: the first of the scene.
const FILE_EVENTS: usize = 100_000;
/// Name of the case, and of its file, whose extension is the format's.
const READERS: [(&str, &str); 3] = [
    ("read aedat4", "events.aedat4"),
    ("read evt2", "events.evt2.raw"),
    ("read evt3", "events.raw"),
];
/// Names of formats as in a case's name, with the extension of the input and of the output.
const CONVERSIONS: [(&str, &str); 13] = [
    ("csv", "dat"),
    ("dat", "aedat4"),
    ("dat", "csv"),
    ("dat", "dat"),
    ("dat", "es"),
    ("dat", "evt2"),
    ("dat", "evt3"),
    ("dat", "h5"),
    ("dat", "mcap"),
    ("dat", "npz"),
    ("dat", "parquet"),
    ("npz", "dat"),
    ("parquet", "dat"),
];
/// Extensions of the files that are converted.
const CONVERTED: [&str; 4] = ["csv", "dat", "npz", "parquet"];
/// Memory of a window that is cut, in words.
const CUT_WORDS: usize = 1 << 16;
const M: [u8; 2] = [8, 16];
/// Coders of events, lossless. Frames are key frames.
const CODERS: [(&str, Coder); 5] = [
    ("fast", Coder::Fast),
    ("keys", Coder::Keys),
    ("quick", Coder::Quick),
    ("dense", Coder::Dense),
    ("tree 1", Coder::Tree(Effort::One)),
];

/// A case: its name, and the events that it works on.
pub type Case = (String, usize);

const fn lossless(coder: Coder) -> Hybrid {
    Hybrid {
        coder,
        fidelity: Fidelity::Lossless,
    }
}

/// Returns the configuration of an encoder of events.
fn events_by(hybrid: Hybrid) -> Config {
    Config {
        mode: Mode::Hybrid(hybrid),
        ..config(Transform::Dct, 8)
    }
}

/// Runs what is counted. Callgrind is told this name, which no other function may contain: apart,
/// and one for all cases, so that it is entered once a case.
#[inline(never)]
fn count_these(work: &mut dyn FnMut()) {
    work();
    // A jump to the work in place of a call would leave this function before it is done.
    black_box(0_u32);
}

/// Writes what [`run`] reads: emulating under Valgrind would take a minute.
pub fn prepare(folder: &Path) -> anyhow::Result<()> {
    let scene = moderate::scene()?;
    let read = READERS.map(|(_, file)| file.to_owned()).into_iter();
    let converted = CONVERTED.map(|format| format!("events.{format}"));
    for file in read.chain(converted) {
        let mut writer = event_files::create(&folder.join(file), SENSOR)?;
        writer.write(&scene[..FILE_EVENTS.min(scene.len())])?;
        writer.finish()?;
    }
    Ok(())
}

/// Runs every case, in the same order each time. Each answer is looked at.
pub fn run(folder: &Path) -> anyhow::Result<Vec<Case>> {
    let mut cases = Vec::new();
    let mut events = Vec::new();
    for (name, file) in READERS {
        let bytes = fs::read(folder.join(file)).context(file)?;
        let mut bytes = Some(bytes);
        let mut read = Ok(Vec::new());
        count_these(&mut || read = read_all(bytes.take().unwrap_or_default(), file));
        let read = read?;
        ensure!(
            events.is_empty() || events == read,
            "{file}: different events"
        );
        cases.push((name.to_owned(), read.len()));
        events = read;
    }
    for (from, to) in CONVERSIONS {
        let name = format!("convert {from} to {to}");
        let (from, to) = (format!("events.{from}"), format!("converted.{to}"));
        let (from, to) = (folder.join(from), folder.join(to));
        // A run before this one left it.
        if to.exists() {
            fs::remove_file(&to).context(name.clone())?;
        }
        let mut converted = Ok(Converted::default());
        count_these(&mut || {
            converted = convert(&from, &to, &Reading::default(), &Conversion::default());
        });
        let count = converted?.events_out;
        ensure!(count == events.len() as u64, "{name}: {count} events");
        cases.push((name, events.len()));
    }
    let window = moderate::window(&events)?;
    for (name, keeps_arrival) in [("cut", false), ("cut in order", true)] {
        let config = WindowConfig {
            keeps_arrival,
            ..WindowConfig::new(SENSOR, moderate::WINDOW_US)
        };
        let mut memory = vec![0; CUT_WORDS];
        let buffers = WindowBuffers::share(&mut memory, 1, &config);
        let buffers = buffers.and_then(|mut shares| shares.next());
        let empty = buffers.and_then(|buffers| Window::new(config, buffers));
        let mut filled = empty.context("no room for a window")?;
        let mut reorder = Reorder::new(Vec::<Event>::new(), 0);
        count_these(&mut || {
            black_box(reorder.fill(&mut filled, window));
        });
        let counted = filled.events() as usize;
        ensure!(counted == window.len(), "{name}: {counted} events");
        cases.push((name.to_owned(), window.len()));
    }
    for transform in Transform::ALL {
        for m in M {
            let mut storage = HostStorage::new(SENSOR, WINDOW_EVENTS);
            let mut encoder = storage.encoder(config(transform, m))?;
            let mut out = vec![0; FRAME_BYTES_MAX];
            let frame = encode(&mut encoder, window, &mut out).to_vec();
            count_these(&mut || {
                black_box(encode(&mut encoder, window, &mut out));
            });
            let name = |what| format!("{what} {} {m}", transform.name());
            cases.push((name("encode"), window.len()));

            let mut counted = 0;
            count_these(&mut || counted = decode(&frame));
            ensure!(counted == window.len(), "decoded {counted} events");
            cases.push((name("decode"), window.len()));
        }
    }
    // Of the start of a recording, once.
    let dense = events_by(lossless(Coder::Dense));
    let mut looked = dense;
    count_these(&mut || looked = readout::look_at(&events, dense));
    ensure!(looked.readout.is_none(), "the scene's sensor does not scan");
    cases.push(("look for scans".to_owned(), events.len()));
    for (name, coder) in CODERS {
        let hybrid = lossless(coder);
        let mut storage = HostStorage::new(SENSOR, WINDOW_EVENTS);
        let mut encoder = storage.encoder(events_by(hybrid))?;
        let mut out = vec![0; FRAME_BYTES_MAX];
        let frame = encode(&mut encoder, window, &mut out).to_vec();
        count_these(&mut || {
            black_box(encode(&mut encoder, window, &mut out));
        });
        cases.push((format!("encode {name}"), window.len()));

        let Scan::Frame(frame) = scan(&frame) else {
            bail!("{name}: no frame");
        };
        // Once before: what is allocated for all frames does not count.
        let mut decoder = HybridDecoder::default();
        let mut decoded = decoder.frame(&frame, hybrid)?;
        decoder.reuse(decoded);
        decoded = Vec::new();
        let mut decode = || -> Result<(), Refused> {
            decoded = decoder.frame(&frame, hybrid)?;
            Ok(())
        };
        let mut result = Ok(());
        count_these(&mut || result = decode());
        result?;
        ensure!(
            decoded.len() == window.len(),
            "{name}: {} events",
            decoded.len()
        );
        cases.push((format!("decode {name}"), window.len()));
    }
    let at_once = at_once();
    for (number, effort) in [(1, Effort::One), (3, Effort::Three)] {
        let hybrid = lossless(Coder::Tree(effort));
        let mut storage = HostStorage::new(SENSOR, WINDOW_EVENTS);
        let mut encoder = storage.encoder(events_by(hybrid))?;
        let mut out = vec![0; FRAME_BYTES_MAX];
        count_these(&mut || {
            black_box(encode(&mut encoder, &at_once, &mut out));
        });
        let name = format!("encode tree {number} at once");
        cases.push((name, at_once.len()));
    }
    Ok(cases)
}

/// A flash: three events of every pixel of a part of the sensor, all at one time. What is done for a pixel must not grow
/// with the number of events of the others.
fn at_once() -> Vec<Event> {
    let pixels = (0..80_u16).flat_map(|y| (0..100_u16).map(move |x| (x, y)));
    let three = pixels.flat_map(|(x, y)| {
        (0..3).map(move |i| Event {
            t_us: 7,
            x,
            y,
            polarity: Polarity::from_bool(i == 1),
        })
    });
    three.collect()
}

/// The events of a file in memory, its header included.
fn read_all(bytes: Vec<u8>, name: &str) -> anyhow::Result<Vec<Event>> {
    let mut reader = event_files::open_source(Box::new(Cursor::new(bytes)), name, None)?;
    let mut events = Vec::with_capacity(FILE_EVENTS);
    while reader.read(&mut events)? > 0 {}
    Ok(events)
}

/// Checks a frame and unpacks its pixels; returns their events.
fn decode(frame: &[u8]) -> usize {
    let Scan::Frame(frame) = scan(frame) else {
        return 0;
    };
    let pixels = frame.descriptors().flatten();
    pixels.fold(0, |events, pixel| {
        events + black_box(&pixel).events() as usize
    })
}
