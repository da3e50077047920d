//! Volumes of lossless frames against numpy: of a scene, and of the first windows of every shared recording. Skipped, with
//! a notice, without Python and numpy; which Python is run says the variable `EECVS_PYTHON`.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::support::{Folder, count, number};

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/reference_volumes.py");
const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");

/// What the script says where numpy is missing.
const SKIPPED: i32 = 77;

/// Time taken of a recording, in us: four windows.
const TAKEN_US: u64 = 4 * 32_768;

/// Bins, weights, polarities, scaling.
const FORMS: [[&str; 4]; 8] = [
    ["1", "nearest", "signed", "none"],
    ["5", "nearest", "signed", "none"],
    ["9", "nearest", "signed", "none"],
    ["16", "nearest", "signed", "none"],
    ["5", "nearest", "split", "mean-std"],
    ["5", "bilinear", "signed", "none"],
    ["9", "bilinear", "split", "none"],
    ["16", "bilinear", "signed", "mean-std"],
];

/// The recordings of the shared data, by the files that the index names; of formats with the same events one.
const RECORDINGS: [&str; 12] = [
    "davis346_static_sparse/davis346.aedat4",
    "davis346_building_dense/davis.aedat4",
    "gen3_vga_dense_evt2/evt2.raw",
    "imx636_sparse_evt3/evt3.raw",
    "dvxl_person_moderate/data_sample.aedat4",
    "gen31_vga_rosbag_moderate/test_events_1.bag",
    "davis240_boxes_moderate/IMU_translBoxes.aedat",
    "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
    "dvs128_walking_sparse/neal_walking.aedat",
    "dvs128_standup/cam255_alex_standing_up2.aedat",
    "nmnist/sample_nmnist.bin",
    "es_csv_1ms_grid/dvs.es",
];

/// Writes the first windows of a recording into `name`.
fn first_windows(folder: &Folder, path: &Path, name: &str) {
    let mut reader = event_files::open(path, None).expect("a recording");
    let mut events = Vec::new();
    while reader.read(&mut events).expect("a recording") > 0
        && events.last().map(|last| last.t_us) < events.first().map(|first| first.t_us + TAKEN_US)
    {
    }
    let start_us = events.first().map_or(0, |first| first.t_us);
    // Frames hold what ascends; a window is a multiset in any case.
    events.sort_by_key(|event| event.t_us);
    events.retain(|event| (start_us..start_us + TAKEN_US).contains(&event.t_us));
    let mut writer = event_files::create(&folder.path(name), reader.sensor()).expect("a file");
    writer.write(&events).expect("events");
    writer.finish().expect("a file");
}

#[test]
fn equal_numpy_s_to_the_last_bit() {
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
    let folder = Folder::new();
    folder.scene("scene.raw");
    let mut recordings = vec![folder.path("scene.raw")];
    for file in RECORDINGS {
        let path = Path::new(SHARED).join(file);
        if path.exists() {
            recordings.push(path);
        } else {
            eprintln!("skipped: {} is absent", path.display());
        }
    }
    for path in recordings {
        first_windows(&folder, &path, "in.npz");
        folder
            .eecvs("encode in.npz -o a.eecvs -m 3 --coder dense")
            .ok();
        for [bins, how, polarity, normalise] in FORMS {
            folder
                .eecvs(&format!(
                    "decode a.eecvs --volume v.npz --all-windows --bins {bins} --voxel {how} --polarity {polarity} \
                     --normalise {normalise}"
                ))
                .ok();
            let output = Command::new(&python)
                .arg(SCRIPT)
                .args([folder.path("in.npz"), folder.path("v.npz")])
                .args([bins, how, polarity, normalise])
                .output()
                .expect("Python has run before");
            let name = format!("{}: {bins} {how} {polarity} {normalise}", path.display());
            assert!(
                output.status.success(),
                "{name}: {}",
                String::from_utf8_lossy(&output.stderr)
            );
            let row: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
            // Values that are all the same are scaled to 0.
            let is_filled = count(&row, "nonzero") > 0 || normalise != "none";
            assert!(count(&row, "windows") >= 1 && is_filled, "{name}: {row}");
            assert_eq!(
                count(&row, "events"),
                folder.events("in.npz").1.len() as u64,
                "{name}"
            );
            if normalise == "none" {
                assert_eq!(count(&row, "different"), 0, "{name}: {row}");
            } else {
                // numpy sums in another order.
                assert!(number(&row, "largest") < 1e-5, "{name}: {row}");
            }
        }
    }
}
