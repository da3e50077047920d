//! Every shared recording of a known format against the reference in every key.

use std::path::{Path, PathBuf};

use host_harness::recording_info::{RecordingInfo, info};
use serde_json::Value;

const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");

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
    info(path, None, &mut |_| {}).expect("a readable recording")
}

/// Checks every key but the times, which a derived file may have shifted.
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
    eprintln!("{name}: {:?} {:?}", info.sensor, info.skipped);
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
        assert!(info.skipped["APS and IMU words"] > 0);
    }
}

#[test]
fn aedat4() {
    if let Some(info) = check("davis346_static_sparse", "davis346.aedat4", "aedat4") {
        for kind in ["frames", "IMU samples", "triggers"] {
            assert!(info.skipped[kind] > 0, "{kind}");
        }
    }
    check("davis346_building_dense", "davis.aedat4", "aedat4");
    check("dvxl_person_moderate", "data_sample.aedat4", "aedat4");
}
