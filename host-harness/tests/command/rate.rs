//! `eecvs bench --rate`: rows, what they promise, chart, usage.

use std::collections::BTreeSet;

use crate::support::{Folder, exists, number, text};
use serde_json::Value;

const KEYS: [&str; 12] = [
    "bits_per_event",
    "codec",
    "coefficients_nmse",
    "decode_seconds",
    "emd_pixel_us",
    "events",
    "mse",
    "recording",
    "seconds",
    "setting",
    "ssim",
    "volume_nmse",
];
const LOSSLESS: [&str; 11] = [
    "hybrid-dense",
    "hybrid-keys",
    "hybrid-fast",
    "hybrid-quick",
    "hybrid-tree-1",
    "hybrid-tree-2",
    "hybrid-tree-3",
    "evt2",
    "evt3",
    "aedat4-lz4",
    "xz-9",
];

/// The rows of a run that says what it was built without, and which programs of others are not installed.
fn rows(folder: &Folder, line: &str) -> Vec<Value> {
    let outcome = folder.eecvs(&format!("bench --rate --quick --json {line}"));
    let outcome = if !cfg!(feature = "zstd") {
        outcome.warns(&["no rows for", "zstd-19", "--features zstd"])
    } else if outcome.stderr.is_empty() {
        outcome.ok()
    } else {
        outcome.warns(&["no rows for", "install"])
    };
    outcome.array()
}

#[test]
fn scenes_are_measured_and_drawn() {
    let folder = Folder::new();
    let rows = rows(&folder, "-o charts");
    for row in &rows {
        let keys: Vec<&String> = row.as_object().expect("an object").keys().collect();
        assert_eq!(keys, KEYS);
        assert!(number(row, "bits_per_event") > 0.0, "{row}");
        let is_applicable = |key: &str| row[key].as_f64().is_some_and(|value| value >= 0.0);
        if text(row, "codec") != "voxel" {
            assert!(is_applicable("emd_pixel_us"), "{row}");
        }
    }
    let recordings: BTreeSet<&str> = rows.iter().map(|row| text(row, "recording")).collect();
    let scenes = ["emulated_dense", "emulated_moderate", "emulated_sparse"];
    assert!(recordings.into_iter().eq(scenes));
    let find = |recording: &str, codec: &str, setting: &str| -> &Value {
        let key =
            |row: &Value| ["recording", "codec", "setting"].map(|key| text(row, key).to_owned());
        let mut found = rows
            .iter()
            .filter(|row| key(row) == [recording, codec, setting]);
        let row = found
            .next()
            .unwrap_or_else(|| panic!("no {codec}, {setting}"));
        assert!(found.next().is_none(), "twice: {row}");
        row
    };
    for scene in scenes {
        for codec in LOSSLESS {
            let row = find(scene, codec, "lossless");
            assert_eq!(number(row, "emd_pixel_us"), 0.0);
            assert_eq!(number(row, "volume_nmse"), 0.0);
        }
        let bits = |codec| number(find(scene, codec, "lossless"), "bits_per_event");
        let order = [
            "hybrid-tree-3",
            "hybrid-dense",
            "hybrid-keys",
            "hybrid-fast",
            "evt2",
        ];
        assert!(
            order.map(bits).is_sorted(),
            "{scene}: {:?}",
            order.map(bits)
        );
        let within = find(scene, "hybrid-dense", "40 us");
        assert!(number(within, "emd_pixel_us") <= 40.0);
        assert_eq!(
            number(find(scene, "hybrid-dense", "8 bins"), "volume_nmse"),
            0.0
        );
        for transform in ["transform-dct", "transform-dtft", "transform-dwt"] {
            let few = number(find(scene, transform, "M = 8"), "bits_per_event");
            let many = number(find(scene, transform, "M = 32"), "bits_per_event");
            assert!(few < many, "{scene} {transform}");
            let dense = format!("{transform}-dense");
            let dense = number(find(scene, &dense, "M = 8"), "bits_per_event");
            assert!(dense < 0.85 * few, "{scene} {transform}: {dense} of {few}");
        }
        assert!(find(scene, "voxel", "8 bins, i8")["emd_pixel_us"].is_null());
        assert!(number(find(scene, "tore", "f32"), "volume_nmse") < 1.0);
    }
    for chart in
        ["rate.svg", "rate.png", "speed.svg", "speed.png"].map(|name| format!("charts/{name}"))
    {
        assert!(exists(&folder.path(&chart)), "{chart}");
    }
}

#[test]
fn recordings_are_given_as_files_and_folders() {
    let folder = Folder::new();
    std::fs::create_dir_all(folder.path("data/inner")).expect("a folder");
    folder.scene("data/inner/anything.raw");
    // Another scene: of files with the same events one is taken.
    folder
        .eecvs(
            "emulate motorcycle -o alone.csv --width 40 --height 30 --duration-us 200000 --seed 2",
        )
        .ok();
    folder.write("data/notes.md", "no recording");
    let rows = rows(&folder, "--data alone.csv data -o charts");
    let recordings: BTreeSet<&str> = rows.iter().map(|row| text(row, "recording")).collect();
    assert!(recordings.into_iter().eq(["alone", "inner"]));
    let table = folder.eecvs("bench --rate --quick --data data -o charts");
    assert_eq!(table.status, Some(0), "{table}");
    assert!(table.stdout.starts_with("inner\n"), "{table}");
    assert!(table.stdout.contains("rate.png"), "{table}");
}

#[test]
fn what_cannot_be_measured_is_named() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("empty")).expect("a folder");
    for (line, parts) in [
        ("--data nowhere", &["nowhere"][..]),
        ("--data empty", &["empty", "--data"]),
    ] {
        folder
            .eecvs(&format!("bench --rate --quick {line}"))
            .fails(parts);
    }
    folder.write("noise.raw", [0_u8; 100]);
    folder
        .eecvs("bench --rate --quick --data noise.raw")
        .fails(&["noise.raw"]);
    folder.write("file", "");
    folder.scene("scene.raw");
    folder
        .eecvs("bench --rate --quick --data scene.raw -o file")
        .fails(&["file", "folder"]);
    for wrong in [
        "--rate --scaling",
        "--rate --errors",
        "--rate --skips",
        "--rate --recordings .",
        "--rate --mcu run",
        "--data .",
    ] {
        let outcome = folder.eecvs(&format!("bench {wrong}"));
        assert_eq!(outcome.status, Some(2), "{outcome}");
    }
}
