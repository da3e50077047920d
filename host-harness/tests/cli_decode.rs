//! Decoding from the command line: events, volumes and bins against the f64 reference, files
//! cut into many frames, damaged files, and the demo.

mod cli_support;

use std::num::{NonZeroU32, NonZeroUsize};

use cli_support::{Folder, count, text};
use host_harness::reference::reconstruct::bins;
use host_harness::reference::transform::Transform;
use host_harness::reference::window::{HOST_CAPACITY, Window, windows};
use host_harness::reference::{coefficients, impulses};
use num_complex::Complex64;
use serde_json::Value;

const WINDOW_US: NonZeroU32 = NonZeroU32::new(32_768).unwrap();

fn by_name(name: &str) -> Transform {
    match name {
        "dct" => Transform::Dct,
        "dtft" => Transform::Dtft,
        "dwt" => Transform::Dwt,
        other => panic!("{other} is no transform"),
    }
}

/// Coefficients of each pixel (y, x) as a volume in basis order has them.
struct Volume {
    transform: Transform,
    shape: [usize; 3],
    values: Vec<f32>,
}

impl Volume {
    fn read(folder: &Folder, name: &str, transform: Transform) -> Self {
        let (shape, values) = folder.npy(name);
        Self {
            transform,
            shape,
            values,
        }
    }

    fn pixel(&self, y: usize, x: usize) -> Vec<Complex64> {
        let [channels, height, width] = self.shape;
        let at = |c: usize| f64::from(self.values[(c * height + y) * width + x]);
        if self.transform == Transform::Dtft {
            (0..channels / 2)
                .map(|k| Complex64::new(at(2 * k), at(2 * k + 1)))
                .collect()
        } else {
            (0..channels).map(|k| Complex64::from(at(k))).collect()
        }
    }
}

/// Compares every pixel of a volume with the reference: kept coefficients within
/// n 2^-14 + step / 2, the others 0; the kept ones are the r largest (DCT: the first r), where the
/// bound leaves no doubt which these are.
fn check_volume(volume: &Volume, window: &Window, m: usize, grid: usize, step: f64) {
    let transform = volume.transform;
    let [channels, height, width] = volume.shape;
    let parts = if transform == Transform::Dtft { 2 } else { 1 };
    assert_eq!(channels, parts * grid);
    let reference = coefficients(window, transform, grid);
    let counts = impulses(window);
    let r = m.min(grid);
    for y in 0..height {
        for x in 0..width {
            let values = volume.pixel(y, x);
            let key = (y as u16, x as u16);
            let Some(c) = reference.get(&key) else {
                assert!(values.iter().all(|v| *v == Complex64::ZERO), "{key:?}");
                continue;
            };
            let n = counts[&key].len() as f64;
            let kernel = n * 0.5_f64.powi(14);
            let bound = kernel + step / 2.0 + 1e-5;
            let mut magnitudes: Vec<f64> = c.iter().map(|c| c.norm()).collect();
            magnitudes.sort_by(|a, b| b.total_cmp(a));
            let least_kept = magnitudes[r - 1];
            assert!(values.iter().filter(|v| **v != Complex64::ZERO).count() <= r);
            for (k, (value, c)) in values.iter().zip(c).enumerate() {
                let (kept, pruned) = match transform {
                    Transform::Dct => (k < r, k >= r),
                    _ => (
                        c.norm() > least_kept + 4.0 * kernel,
                        c.norm() < least_kept - 4.0 * kernel,
                    ),
                };
                let close = (value.re - c.re).abs() <= bound && (value.im - c.im).abs() <= bound;
                let zero = *value == Complex64::ZERO;
                let right = match (kept, pruned) {
                    (true, _) => close,
                    (_, true) => zero,
                    _ => close || zero,
                };
                assert!(
                    right,
                    "{transform:?} {key:?} k = {k}: {value} for {c}, n = {n}"
                );
            }
            // One event is as strong at every frequency: the tie goes to the lower k.
            if n == 1.0 && transform == Transform::Dtft {
                assert!(values[r..].iter().all(|v| *v == Complex64::ZERO), "{key:?}");
            }
        }
    }
}

/// Events of each window that `inspect` lists.
fn rows(folder: &Folder, name: &str) -> Vec<Value> {
    folder.eecvs(&format!("inspect {name} --json")).ok().array()
}

#[test]
fn every_format_holds_the_right_events_per_pixel_and_polarity() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o a.eecvs").ok();
    for extension in ["csv", "txt", "npz", "aedat4", "raw", "evt2.raw", "evt2"] {
        let summary = folder
            .eecvs(&format!("decode a.eecvs -o b.{extension} --json"))
            .ok()
            .object();
        let name = format!("b.{extension}");
        assert_eq!(folder.pixels(&name), folder.pixels("scene.raw"), "{name}");
        assert_eq!(count(&summary, "events"), folder.pixels(&name).len() as u64);
        assert_eq!(count(&summary, "windows"), count(&summary, "frames"));
        for key in [
            "frames_lost",
            "frames_repeated",
            "damaged_bytes",
            "events_dropped",
        ] {
            assert_eq!(count(&summary, key), 0, "{key}");
        }
    }
    // AEDAT 2.0 holds the sizes of two cameras.
    folder
        .eecvs("emulate motorcycle -o dvs.raw --width 128 --height 128 --duration-us 20000")
        .ok();
    folder.eecvs("encode dvs.raw -o dvs.eecvs").ok();
    let table = folder.eecvs("decode dvs.eecvs -o dvs.aedat").ok().stdout;
    assert!(table.contains("events") && !table.contains('{'), "{table}");
    assert_eq!(folder.pixels("dvs.aedat"), folder.pixels("dvs.raw"));
    // Each window's events lie in the window.
    let (_, decoded) = folder.events("b.raw");
    for row in rows(&folder, "a.eecvs") {
        let from = count(&row, "t0_us");
        let inside = from..from + count(&row, "duration_us");
        let n = decoded.iter().filter(|e| inside.contains(&e.t_us)).count();
        assert_eq!(n as u64, count(&row, "events"), "{row}");
    }
}

#[test]
fn volumes_and_bins_equal_the_reference() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let (sensor, events) = folder.events("scene.raw");
    let windows = windows(&events, WINDOW_US, HOST_CAPACITY);
    for (flags, m) in [
        ("", 16),
        ("--transform dct -m 8", 8),
        ("--transform dtft -m 8", 8),
        ("--transform dwt -m 8", 8),
        ("--transform dwt -m 24", 24),
        ("--transform dtft -m 24 --step-log2 -15", 24),
        ("--transform dct -m 8 --grid 20 --step-log2 0", 8),
        ("--transform dtft -m 9 --grid 9", 9),
        ("--transform dwt -m 3 --grid 33 --step-log2 -1", 3),
        ("--transform dct -m 64 --grid 5", 64),
        ("-m 1", 1),
    ] {
        folder
            .eecvs(&format!("encode scene.raw -o a.eecvs {flags}"))
            .ok();
        let rows = rows(&folder, "a.eecvs");
        assert_eq!(rows.len(), windows.len());
        // The busiest and the last window: with `auto`, two transforms.
        for index in [4, windows.len() - 1] {
            let (row, window) = (&rows[index], &windows[index]);
            let transform = by_name(text(row, "transform"));
            let (grid, step) = (count(row, "grid") as usize, row["step"].as_f64().unwrap());
            assert_eq!(count(row, "m") as usize, m);
            let line = format!("decode a.eecvs --volume v.npy --window {index}");
            folder.eecvs(&line).ok();
            let volume = Volume::read(&folder, "v.npy", transform);
            let size = [usize::from(sensor.height), usize::from(sensor.width)];
            assert_eq!(volume.shape[1..], size);
            check_volume(&volume, window, m, grid, step);

            let count = [1, 5, 32][index % 3];
            let line = format!("decode a.eecvs --volume b.npy --window {index} --bins {count}");
            folder.eecvs(&line).ok();
            let (shape, values) = folder.npy("b.npy");
            assert_eq!(shape, [count, size[0], size[1]]);
            for y in 0..size[0] {
                for x in 0..size[1] {
                    let expected = bins(transform, &volume.pixel(y, x), count);
                    for (b, expected) in expected.iter().enumerate() {
                        let value = f64::from(values[(b * size[0] + y) * size[1] + x]);
                        assert!(
                            (value - expected).abs() < 1e-4,
                            "{flags}: bin {b} of ({y}, {x}): {value} for {expected}"
                        );
                    }
                }
            }
        }
    }
    // Events and a volume in one go; a window that is not there.
    folder.eecvs("decode a.eecvs -o b.csv --volume w.npy").ok();
    assert_eq!(folder.pixels("b.csv"), folder.pixels("scene.raw"));
    assert_eq!(folder.npy("w.npy").0[0], 1);
    let missing = windows.len();
    folder
        .eecvs(&format!("decode a.eecvs --volume x.npy --window {missing}"))
        .fails(&[
            "a.eecvs",
            &format!("no window {missing}"),
            &format!("has {missing}"),
        ]);
}

#[test]
fn many_small_frames_decode_to_the_same_as_one_per_window() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for transform in ["auto", "dct", "dtft", "dwt"] {
        let encode = format!("encode scene.raw --transform {transform} --json");
        let one = folder
            .eecvs(&format!("{encode} -o one.eecvs"))
            .ok()
            .object();
        let many = folder
            .eecvs(&format!("{encode} -o many.eecvs --frame-bytes 1208"))
            .ok()
            .object();
        assert_eq!(count(&one, "windows"), count(&many, "windows"));
        assert_eq!(count(&one, "frames"), count(&one, "windows"));
        assert!(count(&many, "frames") > count(&one, "frames"), "{many}");
        let rows = rows(&folder, "many.eecvs");
        assert!(rows.iter().all(|row| count(row, "bytes") <= 1208));
        let sum: u64 = rows.iter().map(|row| count(row, "events")).sum();
        assert_eq!(sum, count(&one, "events_encoded"));
        for (index, row) in rows.iter().enumerate() {
            assert_eq!(count(row, "seq"), index as u64);
        }
        for name in ["one", "many"] {
            let line = format!("decode {name}.eecvs -o {name}.csv --volume {name}.npy --window 3");
            folder.eecvs(&line).ok();
        }
        assert!(
            folder.bytes("one.csv") == folder.bytes("many.csv"),
            "{transform}"
        );
        assert!(
            folder.bytes("one.npy") == folder.bytes("many.npy"),
            "{transform}"
        );
    }
}

#[test]
fn a_damaged_file_gives_everything_that_is_whole() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o a.eecvs").ok();
    let frames = folder.frames("a.eecvs");
    let rows = rows(&folder, "a.eecvs");
    let (all, third) = (
        folder.pixels("scene.raw").len() as u64,
        count(&rows[2], "events"),
    );
    let n = frames.len() as u64;
    let mut flipped = frames.clone();
    let middle = flipped[2].len() / 2;
    flipped[2][middle] ^= 0x10;
    let mut header = frames.clone();
    header[2][6] ^= 0x80;
    let mut cut = frames.clone();
    cut.remove(2);
    let mut twice = frames.clone();
    twice.insert(3, frames[2].clone());
    let mut swapped = frames.clone();
    swapped.swap(2, 3);
    let mut noise = frames.clone();
    noise[2] = vec![0xEE; 100];
    let len = frames[2].len() as u64;
    // What the summary says of events, frames, damaged bytes and runs, frames lost, repeated and
    // reordered.
    for (name, frames, expected) in [
        ("whole", frames.clone(), [all, n, 0, 0, 0, 0, 0]),
        ("flipped", flipped, [all - third, n - 1, len, 1, 1, 0, 0]),
        ("header", header, [all - third, n - 1, len, 1, 1, 0, 0]),
        ("cut", cut, [all - third, n - 1, 0, 0, 1, 0, 0]),
        ("twice", twice, [all, n, 0, 0, 0, 1, 0]),
        ("swapped", swapped, [all, n, 0, 0, 0, 0, 1]),
        ("noise", noise, [all - third, n - 1, 100, 1, 1, 0, 0]),
    ] {
        folder.write("damaged.eecvs", frames.concat());
        for extension in ["csv", "raw", "aedat4"] {
            let line = format!("decode damaged.eecvs -o b.{extension} --json");
            let outcome = folder.eecvs(&line);
            let summary = outcome.object();
            for (key, value) in [
                "events",
                "frames",
                "damaged_bytes",
                "damaged_runs",
                "frames_lost",
                "frames_repeated",
                "frames_reordered",
            ]
            .iter()
            .zip(expected)
            {
                assert_eq!(count(&summary, key), value, "{name} {key}: {summary}");
            }
            if name == "whole" {
                outcome.ok();
            } else {
                outcome.warns(&["damaged.eecvs"]);
            }
            let decoded = folder.pixels(&format!("b.{extension}"));
            assert_eq!(decoded.len() as u64, expected[0], "{name}");
        }
        let outcome = folder.eecvs("inspect damaged.eecvs --json");
        assert_eq!(outcome.array().len() as u64, expected[1], "{name}");
    }
}

#[test]
fn a_truncated_file_gives_its_whole_frames() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o a.eecvs").ok();
    let bytes = folder.bytes("a.eecvs");
    let frames = folder.frames("a.eecvs");
    let rows = rows(&folder, "a.eecvs");
    let two = frames[0].len() + frames[1].len();
    for end in [
        two + 1,
        two + 2,
        two + 5,
        two + 40,
        two + frames[2].len() - 1,
    ] {
        folder.write("cut.eecvs", &bytes[..end]);
        let outcome = folder.eecvs("decode cut.eecvs -o b.csv --json");
        let summary = outcome.object();
        outcome.warns(&["cut.eecvs", &format!("byte {two}")]);
        assert_eq!(count(&summary, "frames"), 2);
        assert_eq!(count(&summary, "damaged_bytes"), (end - two) as u64);
        let events = count(&rows[0], "events") + count(&rows[1], "events");
        assert_eq!(count(&summary, "events"), events);
        assert_eq!(folder.pixels("b.csv").len() as u64, events);
        folder.eecvs("inspect cut.eecvs").warns(&["cut.eecvs"]);
    }
    folder.write("cut.eecvs", &bytes[..frames[0].len() - 1]);
    folder
        .eecvs("decode cut.eecvs -o none.csv")
        .fails(&["cut.eecvs"]);
    folder
        .eecvs("inspect cut.eecvs --json")
        .fails(&["cut.eecvs"]);
}

#[test]
fn odd_sizes_and_settings_keep_every_event() {
    let folder = Folder::new();
    folder.write("one.txt", "5 0 0 1\n9 0 0 0\n9 0 0 0\n");
    folder.write("size.csv", "t,x,y,p\n1000000,7,3,1\n1000001,0,0,0\n");
    folder
        .eecvs("emulate motorcycle -o tiny.raw --width 1 --height 1 --duration-us 100000")
        .ok();
    for (input, size) in [
        ("one.txt", (1, 1)),
        ("size.csv", (8, 4)),
        ("tiny.raw", (1, 1)),
    ] {
        let info = folder.eecvs(&format!("info {input} --json")).ok().object();
        assert_eq!((count(&info, "width"), count(&info, "height")), size);
        for flags in [
            "--window-us 4294967295",
            "--window-us 1",
            "-m 64 --grid 1024 --transform dtft",
            "-m 64 --grid 1000 --transform dwt",
            "-m 1 --grid 1",
            "--step-log2 8",
            "--step-log2 -15",
        ] {
            folder
                .eecvs(&format!("encode {input} -o a.eecvs {flags}"))
                .ok();
            folder.eecvs("decode a.eecvs -o b.npz").ok();
            assert_eq!(
                folder.pixels("b.npz"),
                folder.pixels(input),
                "{input} {flags}"
            );
        }
    }
    // A window of 1 us leaves no doubt about the time.
    folder
        .eecvs("encode tiny.raw -o a.eecvs --window-us 1")
        .ok();
    folder.eecvs("decode a.eecvs -o b.raw").ok();
    let same = folder.eecvs("compare tiny.raw b.raw --json").ok().object();
    assert_eq!(same["exact_fraction"], 1.0);
    // A size on the command line is that of the frames.
    folder
        .eecvs("encode size.csv -o a.eecvs --width 20 --height 10")
        .ok();
    folder.eecvs("decode a.eecvs --volume v.npy").ok();
    assert_eq!(folder.npy("v.npy").0[1..], [10, 20]);
    // No event at all.
    folder
        .eecvs("emulate motorcycle -o none.raw --width 4 --height 4 --duration-us 0")
        .ok();
    folder
        .eecvs("encode none.raw -o none.eecvs")
        .warns(&["none.raw", "no events"]);
    folder
        .eecvs("decode none.eecvs -o x.csv")
        .fails(&["none.eecvs"]);
}

#[test]
fn the_demo_writes_pictures_and_a_report() {
    let folder = Folder::new();
    let said = folder.eecvs("demo -o results/new").ok().stdout;
    assert!(said.contains("report.html"), "{said}");
    let mut kinds = [0; 2];
    let report = String::from_utf8(folder.bytes("results/new/report.html")).unwrap();
    for entry in std::fs::read_dir(folder.path("results/new")).unwrap() {
        let path = entry.unwrap().path();
        let bytes = std::fs::read(&path).unwrap();
        let name = path.file_name().unwrap().to_str().unwrap();
        if name.ends_with(".png") {
            kinds[0] += 1;
            let decoder = png::Decoder::new(std::io::Cursor::new(&bytes));
            let mut reader = decoder.read_info().unwrap();
            let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut pixels).unwrap();
            let first = pixels[0];
            assert!(
                pixels.iter().any(|value| *value != first),
                "{name} is empty"
            );
        } else if name.ends_with(".svg") {
            kinds[1] += 1;
            let svg = String::from_utf8(bytes).unwrap();
            roxmltree::Document::parse(&svg).unwrap();
        } else {
            assert!(!bytes.is_empty(), "{name}");
            continue;
        }
        assert!(report.contains(name), "{name} is not in the report");
        assert!(said.contains(name), "{name} is not named");
    }
    assert_eq!(kinds, [3, 2], "a picture of each regime, two charts");
    // What it left can be used further.
    folder.eecvs("inspect results/new/auto.eecvs").ok();
    folder
        .eecvs("encode results/new/scene.raw -o b.eecvs --thresholds results/new/thresholds.toml")
        .ok();
    assert!(folder.bytes("b.eecvs") == folder.bytes("results/new/auto.eecvs"));
}

#[test]
fn a_window_closed_early_has_its_own_volume() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder
        .eecvs("encode scene.raw -o a.eecvs --window-events 700 --transform dtft -m 12")
        .ok();
    let events = folder.events("scene.raw").1;
    let windows = windows(&events, WINDOW_US, NonZeroUsize::new(700).unwrap());
    let early = windows.iter().position(|w| w.duration_us < WINDOW_US.get());
    let index = early.expect("a window closed early");
    folder
        .eecvs(&format!("decode a.eecvs --volume v.npy --window {index}"))
        .ok();
    let volume = Volume::read(&folder, "v.npy", Transform::Dtft);
    check_volume(&volume, &windows[index], 12, 24, 1.0 / 64.0);
}
