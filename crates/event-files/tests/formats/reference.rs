//! Compares every shared recording of a known format with every key of the reference.

use std::path::{Path, PathBuf};

use event_files::Reading;
use event_files::recording_info::{RecordingInfo, info};
use event_types::Sensor;
use serde_json::Value;
use sha2::{Digest, Sha256};

const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");

fn reference() -> Option<Vec<Value>> {
    let path = Path::new(SHARED).join("REFERENCE.json");
    let Ok(text) = std::fs::read_to_string(&path) else {
        eprintln!("skipped: {} is absent", path.display());
        return None;
    };
    Some(serde_json::from_str(&text).expect("REFERENCE.json is a list"))
}

fn entry<'a>(reference: &'a [Value], name: &str) -> &'a Value {
    reference
        .iter()
        .find(|entry| entry["name"] == name)
        .expect("the recording has a reference")
}

fn recording_info(path: &Path) -> RecordingInfo {
    info(path, &Reading::default(), &mut |_| {}).expect("a readable recording")
}

/// Checks every key but those of the times, which may be shifted in a derived file.
fn check_counts(info: &RecordingInfo, want: &Value) {
    assert_eq!(want["width"], info.width, "{info:?}");
    assert_eq!(want["height"], info.height);
    assert_eq!(want["events"], info.events);
    assert_eq!(want["on"], info.on);
    assert_eq!(want["off"], info.off);
    assert_eq!(want["sum_x"], info.sum_x);
    assert_eq!(want["sum_y"], info.sum_y);
    let close = |key: &str, got: f64| {
        let want = want[key].as_f64().expect("a number");
        assert!(
            (want - got).abs() <= 1e-9 * want.abs(),
            "{key}: {want} {got}"
        );
    };
    close("duration_s", info.duration_s);
    close("rate_eps", info.rate_eps);
}

fn check(name: &str, file: &str, format: &str) -> Option<RecordingInfo> {
    let reference = reference()?;
    let want = entry(&reference, name);
    let info = recording_info(&PathBuf::from(SHARED).join(name).join(file));
    assert_eq!(info.format, format);
    check_counts(&info, want);
    assert_eq!(want["t_first_us"], info.t_first_us.expect("events"));
    assert_eq!(want["t_last_us"], info.t_last_us.expect("events"));
    assert_eq!(want["sha256_events"], info.sha256_events);
    eprintln!("{name}: {:?} {:?}", info.sensor, info.findings.skipped);
    Some(info)
}

#[test]
fn evt2() {
    check("gen3_vga_dense_evt2", "evt2.raw", "evt2");
}

#[test]
fn evt3() {
    check("imx636_sparse_evt3", "evt3.raw", "evt3");
}

/// The DAT file of the same events starts at another time.
#[test]
fn dat() {
    check("imx636_sparse_dat", "gen4.dat", "dat");
}

/// N-CARS states no sensor size; the reference has the size of its events.
#[test]
fn dat_without_a_size() {
    let Some(reference) = reference() else { return };
    let want = entry(&reference, "ncars");
    let path = Path::new(SHARED).join("ncars/sample_ncars.dat");
    let Err(error) = event_files::open(&path, None) else {
        panic!("no size is known");
    };
    assert!(format!("{error:#}").contains("--width"), "{error:#}");
    let side = |key: &str| u16::try_from(want[key].as_u64().expect("a number")).expect("a side");
    let size = Sensor::new(side("width"), side("height"));
    let info = info(&path, &size.into(), &mut |_| {}).expect("a readable recording");
    assert_eq!(info.format, "dat");
    check_counts(&info, want);
    assert_eq!(want["t_first_us"], info.t_first_us.expect("events"));
    assert_eq!(want["t_last_us"], info.t_last_us.expect("events"));
    assert_eq!(want["sha256_events"], info.sha256_events);
}

#[test]
fn es() {
    check("es_csv_1ms_grid", "dvs.es", "es");
    if let Some(info) = check("es_csv_1ms_grid", "atis.es", "es") {
        assert!(info.findings.skipped.contains_key("threshold crossings"));
    }
}

/// The file states no size; the largest x and y are the data set's last column and row.
#[test]
fn nmnist() {
    check("nmnist", "sample_nmnist.bin", "nmnist");
}

#[test]
fn aedat2() {
    check(
        "dvs128_walking_moderate",
        "alex_walking_for_10secs.aedat",
        "aedat2",
    );
    check("dvs128_walking_sparse", "neal_walking.aedat", "aedat2");
    check("dvs128_standup", "cam255_alex_standing_up2.aedat", "aedat2");
    if let Some(info) = check("davis240_boxes_moderate", "IMU_translBoxes.aedat", "aedat2") {
        assert!(info.findings.skipped["APS and IMU words"] > 0);
    }
}

#[test]
fn aedat4() {
    if let Some(info) = check("davis346_static_sparse", "davis346.aedat4", "aedat4") {
        for kind in ["frames", "IMU samples", "triggers"] {
            assert!(info.findings.skipped[kind] > 0, "{kind}");
        }
    }
    check("davis346_building_dense", "davis.aedat4", "aedat4");
    check("dvxl_person_moderate", "data_sample.aedat4", "aedat4");
}

#[test]
fn rosbag() {
    check("gen31_vga_rosbag_moderate", "test_events_1.bag", "rosbag");
}

#[test]
fn rosbag2_db3() {
    check(
        "gen31_vga_rosbag_moderate",
        "test_events_1.db3",
        "rosbag2_db3",
    );
}

#[test]
fn csv() {
    check("es_csv_1ms_grid", "dvs.csv", "text");
}

/// A derived file holds the same events relative to its own time base, and states no sensor size.
fn check_derived(file: &str, format: &str) {
    let Some(reference) = reference() else { return };
    let want = entry(&reference, "davis346_building_dense");
    let path = Path::new(SHARED).join("derived_layouts").join(file);
    let info = recording_info(&path);
    assert_eq!(info.format, format);
    check_counts(&info, want);
    let first = want["t_first_us"].as_u64().expect("a time");
    assert_eq!(info.t_first_us, Some(0));
    // The hash of the same columns with the original's time base added back.
    let mut reader = event_files::open(&path, None).expect("a readable recording");
    let (mut t, mut x, mut y, mut p) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut events = Vec::new();
    while reader.read(&mut events).expect("a whole recording") > 0 {
        for event in events.drain(..) {
            t.extend_from_slice(&(event.t_us + first).to_le_bytes());
            x.extend_from_slice(&event.x.to_le_bytes());
            y.extend_from_slice(&event.y.to_le_bytes());
            p.push(event.polarity as u8);
        }
    }
    let hash = Sha256::digest([t, x, y, p].concat());
    let hash: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(want["sha256_events"], hash);
}

#[test]
fn derived_text() {
    check_derived("davis346_building_txyp.txt", "text");
}

#[test]
fn derived_npz() {
    check_derived("davis346_building_xytp.npz", "npz");
}

/// The HDF5 files keep the original's time base, so that every key equals the original's.
fn check_derived_hdf5(file: &str) {
    let Some(reference) = reference() else { return };
    let want = entry(&reference, "davis346_building_dense");
    let info = recording_info(&Path::new(SHARED).join("derived_layouts").join(file));
    assert_eq!(info.format, "hdf5");
    check_counts(&info, want);
    assert_eq!(want["t_first_us"], info.t_first_us.expect("events"));
    assert_eq!(want["t_last_us"], info.t_last_us.expect("events"));
    assert_eq!(want["sha256_events"], info.sha256_events);
}

#[test]
fn derived_mvsec() {
    check_derived_hdf5("davis346_building_mvsec_layout.hdf5");
}

#[test]
fn derived_dsec() {
    check_derived_hdf5("davis346_building_dsec_layout.h5");
}
