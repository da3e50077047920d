//! The default mode, `hybrid`, from the command line.

mod cli_support;

use cli_support::{Folder, count, number};
use serde_json::Value;

fn compared(folder: &Folder, a: &str, b: &str) -> Value {
    folder
        .eecvs(&format!("compare {a} {b} --json"))
        .ok()
        .object()
}

#[test]
fn a_recording_comes_back_as_exactly_as_was_asked() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for coder in ["fast", "dense"] {
        let encode = format!("encode scene.raw -o a.eecvs --coder {coder} --json");
        // Lossless where nothing else is said.
        for flags in ["", "--mode hybrid --time-tolerance-us 0"] {
            let summary = folder.eecvs(&format!("{encode} {flags}")).ok().object();
            assert_eq!(
                count(&summary, "events_in"),
                count(&summary, "events_encoded")
            );
            assert!(number(&summary, "bits_per_event") < 32.0);
            folder.eecvs("decode a.eecvs -o b.raw").ok();
            let compared = compared(&folder, "scene.raw", "b.raw");
            assert_eq!(number(&compared, "exact_fraction"), 1.0, "{coder} {flags}");
            assert_eq!(number(&compared, "emd_pixel_us"), 0.0);
        }
        let lossless = folder.bytes("a.eecvs").len();
        for (tolerance_us, most) in [(1, 1.0), (50, 50.0), (5000, 5000.0)] {
            folder
                .eecvs(&format!("{encode} --time-tolerance-us {tolerance_us}"))
                .ok();
            folder.eecvs("decode a.eecvs -o b.raw").ok();
            let compared = compared(&folder, "scene.raw", "b.raw");
            let off_us = number(&compared, "emd_pixel_us");
            assert!(off_us > 0.0 && off_us <= most, "{tolerance_us}: {off_us}");
            assert!(folder.bytes("a.eecvs").len() < lossless);
        }
        // Bins are exact as a volume: as many events of each polarity in every bin.
        folder.eecvs(&format!("{encode} --bins 8")).ok();
        folder.eecvs("decode a.eecvs -o b.raw").ok();
        let rows = folder.eecvs("inspect a.eecvs --json").ok().array();
        let bins = |name: &str| {
            let (_, events) = folder.events(name);
            let mut bins: Vec<_> = events
                .iter()
                .map(|event| {
                    let row = rows.iter().rfind(|row| count(row, "t0_us") <= event.t_us);
                    let row = row.expect("a window");
                    let offset_us = event.t_us - count(row, "t0_us");
                    let bin = offset_us * 8 / count(row, "duration_us");
                    (count(row, "t0_us"), bin, event.y, event.x, event.polarity)
                })
                .collect();
            bins.sort_unstable();
            bins
        };
        assert_eq!(bins("scene.raw"), bins("b.raw"));
        for row in &rows {
            assert_eq!(row["mode"], "hybrid");
            assert_eq!(row["coder"], coder);
            assert_eq!(
                (&row["bins"], &row["time_tolerance_us"]),
                (&8.into(), &Value::Null)
            );
            assert!(row["pixels"].is_null());
        }
        let keys = rows.iter().filter(|row| row["key"] == true).count();
        assert_eq!(keys == rows.len(), coder == "fast");
    }
}

#[test]
fn the_volume_is_the_same_in_both_modes() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for flags in [
        "",
        "--transform dtft -m 8",
        "--transform dwt -m 3 --grid 100",
    ] {
        for (mode, name) in [("transform", "a"), ("hybrid --coder dense", "b")] {
            let encode = format!("encode scene.raw -o {name}.eecvs --mode {mode} {flags}");
            folder.eecvs(&encode).ok();
            let decode = format!("decode {name}.eecvs --volume {name}.npy --window 2");
            folder.eecvs(&decode).ok();
        }
        assert!(folder.bytes("a.npy") == folder.bytes("b.npy"), "{flags}");
    }
}

#[test]
fn a_chain_that_lost_a_frame_goes_on_at_the_next_key_and_says_so() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let encode = "encode scene.raw -o a.eecvs --coder dense --key-windows 3 --window-us 20000";
    folder.eecvs(encode).ok();
    let frames = folder.frames("a.eecvs");
    assert!(frames.len() > 6);
    let lost = [&frames[..1], &frames[2..]].concat();
    folder.write("lost.eecvs", lost.concat());
    let summary = folder
        .eecvs("decode lost.eecvs -o b.raw --json")
        .warns(&["lost.eecvs", "frames lost: 1", "go on from"])
        .object();
    assert_eq!(count(&summary, "frames_dependent"), 1);
    assert_eq!(count(&summary, "windows"), frames.len() as u64 - 2);
}

#[test]
fn what_does_not_go_together_is_refused() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for flags in [
        "--bins 8 --time-tolerance-us 5",
        "--bins 0",
        "--bins 65536",
        "--coder best",
        "--key-windows 0",
        "--time-tolerance-us -1",
    ] {
        let outcome = folder.eecvs(&format!("encode scene.raw -o a.eecvs {flags}"));
        assert_eq!(outcome.status, Some(2), "{outcome}");
    }
    folder
        .eecvs("encode scene.raw -o a.eecvs --mode transform --bins 8")
        .fails(&["--bins", "--mode hybrid"]);
}
