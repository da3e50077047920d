//! The metrics of `eecvs compare` against scipy and scikit-image: random recordings and real ones,
//! each against a distorted twin. Skipped, with a notice, without Python and its packages; which Python
//! is run says the variable `EECVS_PYTHON`.

use std::path::{Path, PathBuf};
use std::process::Command;

use eecvs_nostd::{Event, Polarity, Sensor};
use event_metrics::Comparison;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/reference_metrics.py");
const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");

/// What the script says where a package is missing.
const SKIPPED: i32 = 77;

/// Events of a real recording.
const REAL_EVENTS: usize = 200_000;

/// A metric: its name, its value, how far it may be apart.
type Metric = (&'static str, fn(&Comparison) -> f64, f64);

/// The metrics, and how far they may be apart, of the larger of the value and 1.
const METRICS: [Metric; 5] = [
    ("exact_fraction", |c| c.exact_fraction, 1e-15),
    ("mse", |c| c.mse, 1e-12),
    ("ssim", |c| c.ssim, 1e-6),
    ("emd_time_ms", |c| c.emd_time_ms, 1e-9),
    ("emd_pixel_us", |c| c.emd_pixel_us, 1e-9),
];

/// Two recordings and the window that they are compared in.
struct Pair {
    name: String,
    window_us: u64,
    sensor: Sensor,
    a: Vec<Event>,
    b: Vec<Event>,
}

fn below(rng: &mut Xoshiro256PlusPlus, n: u64) -> u64 {
    rng.next_u64() % n
}

/// The recording with one event in 20 lost, one in ten moved by up to `jitter_us` either way, one in 50
/// of the other polarity, and one in 40 in a second copy at another pixel.
fn distorted(events: &[Event], sensor: Sensor, jitter_us: u64, seed: u64) -> Vec<Event> {
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut twin = Vec::new();
    for event in events {
        let mut event = *event;
        if below(rng, 20) == 0 {
            continue;
        }
        if below(rng, 10) == 0 {
            event.t_us = (event.t_us + below(rng, 2 * jitter_us)).saturating_sub(jitter_us);
        }
        if below(rng, 50) == 0 {
            event.polarity = Polarity::from_bool(event.polarity == Polarity::Off);
        }
        twin.push(event);
        if below(rng, 40) == 0 {
            event.x = below(rng, u64::from(sensor.width)) as u16;
            twin.push(event);
        }
    }
    twin.sort_by_key(|event| event.t_us);
    twin
}

/// Random events, most of them in few pixels, in bursts with gaps of whole windows.
fn random(seed: u64, count: usize, sensor: Sensor, window_us: u64) -> Pair {
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut t_us = below(rng, 1 << 50);
    let mut a = Vec::new();
    while a.len() < count {
        t_us += match below(rng, 2000) {
            0 => below(rng, 4 * window_us),
            1..1000 => 0,
            _ => below(rng, window_us / 40 + 2),
        };
        let [width, height] = [sensor.width, sensor.height].map(|side| match below(rng, 2) {
            0 => u64::from(side),
            _ => u64::from(side).min(7),
        });
        a.push(Event {
            t_us,
            x: below(rng, width) as u16,
            y: below(rng, height) as u16,
            polarity: Polarity::from_bool(below(rng, 2) == 1),
        });
    }
    Pair {
        name: format!("random {seed}: {count} events, {sensor:?}, {window_us} us"),
        window_us,
        sensor,
        b: distorted(&a, sensor, window_us / 3 + 1, seed + 1000),
        a,
    }
}

fn real(file: &str, window_us: u64) -> Option<Pair> {
    let path = Path::new(SHARED).join(file);
    if !path.exists() {
        eprintln!("skipped: {} is absent", path.display());
        return None;
    }
    let mut reader = event_files::open(&path, None).expect("a recording");
    let mut a = Vec::new();
    while a.len() < REAL_EVENTS && reader.read(&mut a).expect("a recording") > 0 {}
    a.truncate(REAL_EVENTS);
    a.sort_by_key(|event| event.t_us);
    let sensor = reader.sensor();
    Some(Pair {
        name: format!("{file}: {} events, {window_us} us", a.len()),
        window_us,
        sensor,
        b: distorted(&a, sensor, 500, 1),
        a,
    })
}

fn pairs() -> Vec<Pair> {
    let sensor = |width, height| Sensor { width, height };
    let mut pairs = vec![
        // A frame of one position of SSIM's window, and windows of one microsecond.
        random(1, 1, sensor(11, 11), 1000),
        random(2, 300, sensor(11, 30), 1),
        random(3, 2000, sensor(40, 30), 1000),
        random(4, 20_000, sensor(34, 34), 10_000),
        random(5, 20_000, sensor(346, 260), 32_768),
        random(6, 60_000, sensor(128, 128), 32_768),
        random(7, 30_000, sensor(640, 480), 100_000),
    ];
    pairs.extend(real("davis346_building_dense/davis.aedat4", 32_768));
    pairs.extend(real("gen3_vga_dense_evt2/evt2.raw", 10_000));
    pairs.extend(real(
        "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
        32_768,
    ));
    pairs
}

fn write(path: &Path, sensor: Sensor, events: &[Event]) {
    let mut writer = event_files::create(path, sensor).expect("a file");
    writer.write(events).expect("events inside of the sensor");
    writer.finish().expect("a file");
}

fn compared(window_us: u64, a: &Path, b: &Path) -> Comparison {
    let compared = event_metrics::compare(
        &|| event_files::open(a, None),
        &|| event_files::open(b, None),
        window_us,
        &mut |_| (),
    );
    compared.expect("two recordings")
}

#[test]
fn equals_scipy_and_scikit_image() {
    let python = std::env::var_os("EECVS_PYTHON").unwrap_or_else(|| "python3".into());
    match Command::new(&python).arg(SCRIPT).output() {
        Ok(output) if output.status.success() => {}
        Ok(output) if output.status.code() == Some(SKIPPED) => {
            eprint!("skipped: {}", String::from_utf8_lossy(&output.stderr));
            return;
        }
        Ok(output) => panic!("{}", String::from_utf8_lossy(&output.stderr)),
        Err(error) => {
            eprintln!("skipped: {}: {error}", python.display());
            return;
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let pairs = pairs();
    let mut files: Vec<[PathBuf; 2]> = Vec::new();
    let mut script = Command::new(&python);
    script.arg(SCRIPT);
    for (index, pair) in pairs.iter().enumerate() {
        let paths = ["a", "b"].map(|side| folder.path().join(format!("{index}{side}.npz")));
        write(&paths[0], pair.sensor, &pair.a);
        write(&paths[1], pair.sensor, &pair.b);
        script.arg(pair.window_us.to_string()).args(&paths);
        files.push(paths);
    }
    let output = script.output().expect("Python has run before");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let text = String::from_utf8(output.stdout).expect("JSON");
    let lines: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    assert_eq!(lines.len(), pairs.len(), "{text}{errors}");
    let mut largest = [0.0_f64; METRICS.len()];
    for ((pair, [a, b]), want) in pairs.iter().zip(&files).zip(&lines) {
        let found = compared(pair.window_us, a, b);
        assert_eq!(want["events_a"], found.events_a, "{}", pair.name);
        assert_eq!(want["events_b"], found.events_b, "{}", pair.name);
        for ((name, value, bound), largest) in METRICS.iter().zip(&mut largest) {
            let (want, found) = (want[name].as_f64().expect("a number"), value(&found));
            let apart = (want - found).abs() / want.abs().max(1.0);
            assert!(apart <= *bound, "{}: {name}: {want} {found}", pair.name);
            *largest = largest.max(apart);
        }
    }
    for ((name, _, bound), apart) in METRICS.iter().zip(largest) {
        eprintln!("{name}: at the most {apart:.1e} apart, of {bound:.0e}");
    }
}
