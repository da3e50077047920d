//! `eecvs bench`: rows, front, chart, skipping, usage. No time is judged here.

use std::collections::{BTreeMap, BTreeSet};

use crate::support::{Folder, count, exists, number, text};
use eecvs_nostd::Kernel;
use serde_json::Value;

const KEYS: [&str; 12] = [
    "cost",
    "cost_high",
    "cost_low",
    "kernel",
    "m",
    "max_error",
    "pareto",
    "rms_error",
    "target",
    "transform",
    "unit",
    "window",
];

/// Rows of the same transform, M, target and window.
fn group(row: &Value) -> (&str, u64, &str, &str) {
    (
        text(row, "transform"),
        count(row, "m"),
        text(row, "target"),
        text(row, "window"),
    )
}

/// Cost and error; `None` without an error.
fn point(row: &Value) -> Option<(f64, f64)> {
    Some((number(row, "cost"), row["max_error"].as_f64()?))
}

#[test]
fn every_kernel_is_measured_and_the_front_is_one() {
    let folder = Folder::new();
    let outcome = folder
        .eecvs("bench --quick --json -o charts")
        .warns(&["instructions: saved"]);
    let rows = outcome.array();
    for row in &rows {
        let keys: Vec<&String> = row.as_object().expect("an object").keys().collect();
        assert_eq!(keys, KEYS);
        let [low, cost, high] = ["cost_low", "cost", "cost_high"].map(|key| number(row, key));
        assert!(0.0 < low && low <= cost && cost <= high, "{row}");
        match text(row, "target") {
            "host" => assert_eq!(text(row, "unit"), "ns/event"),
            target => {
                assert!(["cortex-m4", "cortex-m7"].contains(&target), "{row}");
                assert_eq!(text(row, "unit"), "instructions/event");
            }
        }
        assert_eq!(row["max_error"].is_null(), row["rms_error"].is_null());
        if let Some((_, error)) = point(row) {
            assert!(number(row, "rms_error") <= error, "{row}");
        }
    }

    // Nothing is missing, and nothing is there twice.
    let host = rows.iter().filter(|row| text(row, "target") == "host");
    let mut found: Vec<_> = host.map(|row| (text(row, "kernel"), group(row))).collect();
    let (mut expected, mut counted) = (Vec::new(), Vec::new());
    let waves = [
        "table",
        "recurrence",
        "precise",
        "micromath",
        "libm",
        "oracle-f64",
        "binning-fft",
    ];
    for (transform, kernels) in [
        ("dct", &waves[..]),
        ("dtft", &waves[..]),
        ("dwt", &["haar", "oracle-f64"]),
        ("none", &["voxel-bilinear"]),
    ] {
        for m in [8, 16, 24, 64] {
            for window in ["moderate", "sparse", "dense"] {
                for kernel in kernels {
                    expected.push((*kernel, (transform, m, "host", window)));
                    if !["oracle-f64", "binning-fft", "voxel-bilinear"].contains(kernel) {
                        for target in ["cortex-m4", "cortex-m7"] {
                            counted.push((*kernel, (transform, m, target, window)));
                        }
                    }
                }
            }
        }
    }
    found.sort_unstable();
    expected.sort_unstable();
    assert_eq!(found, expected);
    // Every kernel on both microcontrollers; only some windows have crowded pixels.
    let mcu = rows.iter().filter(|row| text(row, "target") != "host");
    let (crowded, all): (Vec<&Value>, _) =
        mcu.partition(|row| text(row, "window").ends_with("-crowded"));
    let mut all: Vec<_> = all
        .into_iter()
        .map(|row| (text(row, "kernel"), group(row)))
        .collect();
    all.sort_unstable();
    counted.sort_unstable();
    assert_eq!(all, counted);
    for row in crowded {
        let window = text(row, "window").trim_end_matches("-crowded");
        let (kernel, (transform, m, target, _)) = (text(row, "kernel"), group(row));
        assert!(
            all.contains(&(kernel, (transform, m, target, window))),
            "{row}"
        );
    }

    // The front, once more and independently.
    let groups: BTreeSet<_> = rows.iter().map(group).collect();
    for here in groups {
        let points: Vec<&Value> = rows.iter().filter(|row| group(row) == here).collect();
        for row in &points {
            let is_on = row["pareto"].as_bool().expect("a bool");
            let Some((cost, error)) = point(row) else {
                assert!(!is_on, "{row}");
                continue;
            };
            let is_beaten = points
                .iter()
                .filter_map(|row| point(row))
                .any(|(c, e)| (c < cost && e <= error) || (c <= cost && e < error));
            assert_eq!(is_on, !is_beaten, "{row}");
        }
    }

    // The errors are those of the kernels, whatever the machine.
    for row in &rows {
        let most = match text(row, "kernel") {
            "haar" | "oracle-f64" => 0.0,
            "precise" => 1e-6,
            "recurrence" | "libm" | "table" => 1e-2,
            _ => continue,
        };
        assert!(number(row, "max_error") <= most, "{row}");
    }
    let error =
        |kernel, row: &Value| text(row, "kernel") == kernel && number(row, "max_error") > 0.0;
    for kernel in ["table", "precise", "binning-fft"] {
        assert!(rows.iter().any(|row| error(kernel, row)), "{kernel}");
    }

    for file in ["charts/kernels.svg", "charts/kernels.png"] {
        assert!(exists(&folder.path(file)), "{file}");
    }
    let svg = String::from_utf8(folder.bytes("charts/kernels.svg")).expect("text");
    for name in waves
        .iter()
        .chain(&["haar", "voxel-bilinear", "DTFT, host", "DTFT, Cortex-M4"])
    {
        assert!(svg.contains(name), "{name}");
    }
    assert_eq!(&folder.bytes("charts/kernels.png")[1..4], b"PNG");
}

#[test]
fn errors_have_three_curves_of_every_kernel() {
    let folder = Folder::new();
    let command = "bench --errors --quick --json -o charts";
    let run = folder.eecvs(command).ok();
    let rows = run.array();
    let keys = [
        "axis",
        "bound",
        "kernel",
        "max_error_per_event",
        "rms_error_per_event",
        "transform",
        "value",
    ];
    let mut kernels = BTreeSet::new();
    let mut values: BTreeMap<_, Vec<u64>> = BTreeMap::new();
    for row in &rows {
        let found: Vec<&String> = row.as_object().expect("an object").keys().collect();
        assert_eq!(found, keys);
        let [max, rms, bound] =
            ["max_error_per_event", "rms_error_per_event", "bound"].map(|key| number(row, key));
        assert!(0.0 <= rms && rms <= max && max <= bound, "{row}");
        let curve = (text(row, "transform"), text(row, "kernel"));
        kernels.insert(curve.1);
        let values = values.entry((text(row, "axis"), curve)).or_default();
        values.push(count(row, "value"));
    }
    // Nothing of the core is left out, whatever it is called.
    let every: BTreeSet<&str> = Kernel::ALL.iter().map(|kernel| kernel.name()).collect();
    assert_eq!(kernels, every);
    let curves: BTreeSet<_> = values.keys().map(|(_, curve)| *curve).collect();
    for axis in ["k", "n", "T"] {
        for curve in &curves {
            let values = &values[&(axis, *curve)];
            assert!(values.windows(2).all(|pair| pair[0] < pair[1]), "{curve:?}");
            let last = match axis {
                "k" => 1023,
                "n" => 4096,
                _ => u32::MAX.into(),
            };
            assert_eq!((values[0], values.last()), (1, Some(&last)), "{curve:?}");
        }
    }
    // The same seed, the same numbers.
    assert_eq!(folder.eecvs(command).ok().stdout, run.stdout);

    let svg = String::from_utf8(folder.bytes("charts/errors.svg")).expect("text");
    for part in [
        "table, 2^",
        "haar: 0 everywhere",
        "DTFT: events in one pixel",
    ] {
        assert!(svg.contains(part), "{part}");
    }
    assert_eq!(&folder.bytes("charts/errors.png")[1..4], b"PNG");
    let table = folder.eecvs("bench --errors --quick -o charts").ok().stdout;
    for part in ["precise", "most over T", "charts/errors.svg"] {
        assert!(table.contains(part), "{table}");
    }
    let both = folder.eecvs("bench --errors --scaling");
    assert_eq!(both.status, Some(2), "{both}");
}

#[test]
fn scaling_has_both_series() {
    let folder = Folder::new();
    let rows = folder.eecvs("bench --scaling --quick --json").ok().array();
    let series = |axis: &str| -> Vec<(u64, u64)> {
        rows.iter()
            .filter(|row| text(row, "axis") == axis)
            .map(|row| (count(row, "width"), count(row, "events")))
            .collect()
    };
    let widths = [128, 346, 640, 1280, 2048].map(|width| (width, 3000));
    assert_eq!(series("sensor"), widths);
    let counts = [1000, 10_000, 100_000].map(|events| (346, events));
    assert_eq!(series("events"), counts);
    for row in &rows {
        let [low, median, high] =
            ["encode_s_low", "encode_s", "encode_s_high"].map(|key| number(row, key));
        assert!(0.0 < low && low <= median && median <= high, "{row}");
        let ns = median * 1e9 / count(row, "events") as f64;
        assert!((number(row, "ns_per_event") - ns).abs() < 1e-6 * ns);
        assert!(count(row, "windows") > 0 && count(row, "bytes_out") > 0);
    }
    assert!(!exists(&folder.path("target")), "nothing is written");
    let table = folder.eecvs("bench --scaling --quick").ok().stdout;
    for sensor in ["128x128", "2048x2048"] {
        assert!(table.contains(sensor), "{table}");
    }
}

#[test]
fn skipping_is_measured_with_it_and_without() {
    let folder = Folder::new();
    let rows = folder.eecvs("bench --skips --quick --json").ok().array();
    let scenes = ["emulated_moderate", "emulated_sparse", "emulated_dense"];
    let waves = [
        ("nothing", "us/window", "timed"),
        ("inactive pixels, transformed", "us/window", "timed"),
        ("single events as cells", "us/window", "timed"),
        ("everything", "us/window", "timed"),
        ("single events as cells", "bits/window", "packed"),
        ("inactive pixels, told by gaps", "bits/window", "counted"),
    ];
    let dct = [
        ("empty segments", "us/window", "timed"),
        ("inactive pixels, looked at", "us/window", "timed"),
        ("empty windows", "bits/recording", "packed"),
    ];
    let pruned = [
        ("pruned coefficients", "us/window", "timed"),
        ("pruned coefficients", "bits/window", "packed"),
    ];
    let dwt = [
        ("butterflies of few events", "us/window", "timed"),
        ("zero coefficients", "coefficients/window", "counted"),
        ("zero coefficients", "bits/window", "counted"),
    ];
    let expected: BTreeSet<_> = scenes
        .iter()
        .flat_map(|scene| {
            let of = move |transform| move |(skip, unit, how)| (*scene, transform, skip, unit, how);
            let dct = waves.iter().chain(&dct).copied().map(of("dct"));
            let dtft = waves.iter().chain(&pruned).copied().map(of("dtft"));
            let haar = waves.iter().chain(&pruned).chain(&dwt).copied();
            dct.chain(dtft).chain(haar.map(of("dwt")))
        })
        .collect();
    let key = ["recording", "transform", "skip", "unit", "how"];
    let found: BTreeSet<_> = rows
        .iter()
        .map(|row| key.map(|key| text(row, key)))
        .collect();
    let found: BTreeSet<_> = found
        .into_iter()
        .map(|[a, b, c, d, e]| (a, b, c, d, e))
        .collect();
    assert_eq!(found, expected);
    assert_eq!(rows.len(), expected.len(), "no row is there twice");

    for row in &rows {
        let [with, without] = ["with", "without"].map(|key| number(row, key));
        let saved = 100.0 * (1.0 - with / without);
        assert!(with > 0.0 && without > 0.0, "{row}");
        assert!((number(row, "saved_percent") - saved).abs() < 1e-9, "{row}");
        // Nothing that is skipped would take fewer bits.
        assert!(text(row, "how") == "timed" || with <= without, "{row}");
        let count = |key| count(&row["counts"], key);
        assert!(count("single_pixels") <= count("active_pixels"), "{row}");
        assert!(count("active_pixels") <= count("events"), "{row}");
        assert!(count("active_pixels") < count("pixels"), "{row}");
        assert!(count("active_segments") <= count("active_pixels"), "{row}");
        assert!(
            count("trailing_zero_levels") <= count("zero_levels"),
            "{row}"
        );
        assert_eq!(count("pixels"), 346 * 260 * count("windows"));
    }
}

#[test]
fn skipping_takes_the_recordings_that_are_there() {
    let folder = Folder::new();
    std::fs::create_dir_all(folder.path("all/gen3_vga_dense_evt2")).expect("a folder");
    folder
        .eecvs("emulate outdoor-dark --duration-us 100000 -o all/gen3_vga_dense_evt2/evt2.raw")
        .ok();
    let table = folder.eecvs("bench --skips --quick --recordings all").ok();
    let lines: Vec<&str> = table.stdout.lines().collect();
    assert!(
        lines[0].ends_with("| how | gen3_vga_dense_evt2 |"),
        "{table}"
    );
    let columns = |line: &str| line.matches('|').count();
    assert!(lines.len() > 20, "{table}");
    assert!(lines.iter().all(|line| columns(line) == 6), "{table}");

    std::fs::create_dir(folder.path("none")).expect("a folder");
    folder
        .eecvs("bench --skips --recordings none")
        .fails(&["none", "--recordings"]);
    let both = folder.eecvs("bench --skips --scaling");
    assert_eq!(both.status, Some(2), "{both}");
}

#[test]
fn what_cannot_be_read_or_written_is_named() {
    let folder = Folder::new();
    folder.write("file", "");
    folder
        .eecvs("bench --quick -o file")
        .fails(&["file", "folder"]);
    folder
        .eecvs("bench --quick --recordings nowhere")
        .fails(&["nowhere", "--recordings"]);
    std::fs::create_dir(folder.path("empty")).expect("a folder");
    folder
        .eecvs("bench --quick --recordings empty")
        .fails(&["davis.aedat4"]);
    for wrong in [
        "--scaling --recordings .",
        "--scaling --mcu run",
        "--mcu guess",
    ] {
        let outcome = folder.eecvs(&format!("bench {wrong}"));
        assert_eq!(outcome.status, Some(2), "{outcome}");
    }
    let without = folder
        .command(&["bench", "--quick", "--mcu", "run"])
        .env("PATH", "")
        .output()
        .expect("the program starts");
    let said = String::from_utf8_lossy(&without.stderr);
    assert!(said.contains("qemu-system-arm is not installed"), "{said}");
    assert_eq!(without.status.code(), Some(1));
}

#[test]
fn the_speed_of_reading_is_of_every_recording() {
    let folder = Folder::new();
    for name in ["a.aedat4", "b.raw", "c.evt2", "d.dat"] {
        folder.scene(name);
    }
    let files = "a.aedat4 b.raw c.evt2 d.dat";
    let rows = folder
        .eecvs(&format!("bench --read {files} --quick --json"))
        .ok()
        .array();
    let formats: Vec<&str> = rows.iter().map(|row| text(row, "format")).collect();
    assert_eq!(formats, ["aedat4", "evt3", "evt2", "dat"]);
    for (row, name) in rows.iter().zip(files.split(' ')) {
        assert_eq!(text(row, "file"), name);
        let events = folder.events(name).1.len() as u64;
        assert_eq!(count(row, "events"), events);
        let rate = events as f64 / number(row, "seconds");
        assert!((number(row, "events_per_s") / rate - 1.0).abs() < 1e-9);
    }
    let table = folder.eecvs(&format!("bench --read {files}")).ok();
    assert_eq!(table.stdout.lines().count(), 5, "{table}");
    folder
        .eecvs("bench --read a.aedat4 none.raw")
        .fails(&["none.raw"]);
    let both = folder.eecvs("bench --read a.aedat4 --scaling");
    assert_eq!(both.status, Some(2), "{both}");
}

#[test]
fn flags_that_a_study_does_not_look_at_are_refused_before_it_begins() {
    let folder = Folder::new();
    folder.write("file", "");
    for study in ["--selection", "--few-as-times"] {
        for (flags, reason) in [
            ("--to csv", "--to"),
            ("-o out", "--output"),
            ("--overwrite", "--overwrite"),
            ("--skips", "--skips"),
        ] {
            let line = format!("bench {study} {flags}");
            let outcome = folder.as_is(&line);
            assert_eq!(outcome.status, Some(2), "{outcome}");
            assert!(outcome.stderr.contains("cannot be used with"), "{outcome}");
            assert!(outcome.stderr.contains(reason), "{outcome}");
        }
        let line = format!("bench {study} --record file");
        folder
            .as_is(&line)
            .fails(&["file: cannot create the folder"]);
    }
    assert!(!folder.path("out").exists());
}
