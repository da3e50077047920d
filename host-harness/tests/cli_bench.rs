//! `eecvs bench`: rows, front, chart, usage. No time is judged here.

mod cli_support;

use std::collections::BTreeSet;

use cli_support::{Folder, count, exists, number, text};
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
