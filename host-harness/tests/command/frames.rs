//! Frames wherever a recording is taken: what commands see of them is what `decode` writes.

use crate::support::{Folder, count};

#[test]
fn commands_take_frames_for_the_recording_that_they_decode_to() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for (name, options) in [
        ("lossless", ""),
        ("tolerance", "--time-tolerance-us 200 --coder dense"),
        ("transform", "--mode transform --transform dwt -m 8"),
        (
            "best",
            "--mode transform --transform best -m 8 --coder dense",
        ),
    ] {
        folder
            .eecvs(&format!("encode scene.raw -o {name}.eecvs {options}"))
            .ok();
        folder
            .eecvs(&format!("decode {name}.eecvs -o {name}.raw"))
            .ok();
        let wanted = folder.events(&format!("{name}.raw"));
        assert!(wanted == folder.events(&format!("{name}.eecvs")), "{name}");
        folder
            .eecvs(&format!("convert {name}.eecvs {name}.aedat4"))
            .ok();
        assert!(wanted == folder.events(&format!("{name}.aedat4")), "{name}");
        let info = |file: &str| {
            let info = folder.eecvs(&format!("info {file} --json")).ok().object();
            (
                info["format"].clone(),
                info["sha256_events"].clone(),
                count(&info, "events"),
            )
        };
        let (format, hash, events) = info(&format!("{name}.eecvs"));
        assert_eq!(format, "eecvs");
        assert_eq!((hash, events), {
            let (_, hash, events) = info(&format!("{name}.raw"));
            (hash, events)
        });
        let twin = folder
            .eecvs(&format!("compare {name}.eecvs {name}.raw --json"))
            .ok()
            .object();
        assert_eq!(twin["mse"], 0.0, "{twin}");
    }
    // And what is written again is the same.
    folder.eecvs("encode lossless.eecvs -o again.eecvs").ok();
    assert!(folder.events("again.eecvs") == folder.events("lossless.eecvs"));
}

/// Few events as times: fewer bytes, whatever the transform and the coder, and `inspect` accounts for every pixel and
/// bit.
#[test]
fn few_events_are_sent_as_times_where_that_is_asked_for() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for transform in ["dct", "dtft", "dwt"] {
        for coder in ["plain", "fast", "dense"] {
            let to = format!("--mode transform -m 16 --coder {coder} --overwrite --json");
            let bytes = |options: &str| {
                let line = format!("encode scene.raw -o frames.eecvs {to} --transform {options}");
                count(&folder.eecvs(&line).ok().object(), "bytes_out")
            };
            let levels = bytes(transform);
            let times = bytes(&format!("{transform} --few-as-times"));
            let rows = folder.eecvs("inspect frames.eecvs --json").ok().array();
            for row in &rows {
                let few = count(row, "few");
                let has_few = (coder, transform) != ("dense", "dwt");
                assert!((2..=63).contains(&few) == has_few, "{row}");
                let of = |way: &str| &row["ways"][way];
                let ways = [of("single"), of("times"), of("coefficients")];
                let pixels: u64 = ways.iter().map(|way| count(way, "pixels")).sum();
                assert_eq!(pixels, count(row, "pixels"), "{row}");
                let bits: f64 = ways.iter().filter_map(|way| way["bits"].as_f64()).sum();
                // The header, the checksum, and what a coder ends with.
                let payload = 8.0 * count(row, "bytes") as f64;
                assert!(bits <= payload && bits + 500.0 > payload, "{row}");
            }
            let is_less = if coder == "plain" {
                2 * times < levels * 3 / 2
            } else {
                times <= levels + 4 * rows.len() as u64
            };
            assert!(is_less, "{transform} {coder}: {times} of {levels}");
            if transform == "dct" {
                assert_eq!(bytes("best"), times);
            }
        }
    }
    // Windows of the dense coder with and without such pixels, in one chain.
    let line = "encode scene.raw -o frames.eecvs --overwrite --mode transform --few-as-times --coder dense";
    folder.eecvs(line).ok();
    let rows = folder.eecvs("inspect frames.eecvs --json").ok().array();
    assert!(rows.iter().all(|row| !row["ways"].is_null()));
    let refused = folder.eecvs("encode scene.raw -o frames.eecvs --transform best --overwrite");
    assert_eq!(refused.status, Some(2), "{refused}");
    assert!(refused.stderr.contains("--mode transform"), "{refused}");
}

/// A largest mean error holds for whole files, by every coder that has one, and excludes what else says how exact
/// times are.
#[test]
fn times_are_as_near_on_average_as_was_asked() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for coder in ["fast", "dense", "dense --effort 1", "fast --keep-order"] {
        let mut before = u64::MAX;
        for max_us in [20, 500, 4000] {
            let line = format!(
                "encode scene.raw -o frames.eecvs --coder {coder} --max-emd-us {max_us} --overwrite --json"
            );
            let bytes = count(&folder.eecvs(&line).ok().object(), "bytes_out");
            // The order of events takes more where more of them are decoded as of one time.
            let is_less = bytes < before || coder.ends_with("order");
            assert!(is_less, "{coder}, {max_us} us: {bytes}");
            before = bytes;
            folder
                .eecvs("decode frames.eecvs -o decoded.raw --overwrite")
                .ok();
            let compared = folder.eecvs("compare scene.raw decoded.raw --json").ok();
            let compared = compared.object();
            let error = compared["emd_pixel_us"].as_f64().expect("a number");
            assert!(error <= f64::from(max_us), "{coder}: {error} us");
            assert!(
                error > 0.8 * f64::from(max_us),
                "{coder}: {error} of {max_us} us"
            );
            let [a, b] = ["events_a", "events_b"].map(|key| count(&compared, key));
            assert_eq!(a, b, "{coder}");
        }
    }
    let line = "encode scene.raw -o frames.eecvs --overwrite --max-emd-us 50";
    folder.eecvs(&format!("{line} --transform best")).ok();
    for flags in [
        "--time-tolerance-us 3",
        "--bins 3",
        "--coder quick",
        "--mode transform",
    ] {
        let refused = folder.eecvs(&format!("{line} {flags}"));
        assert_eq!(refused.status, Some(2), "{flags}: {refused}");
        assert!(
            refused.stderr.contains("--max-emd-us"),
            "{flags}: {refused}"
        );
    }
    let refused = folder.eecvs("encode scene.raw -o frames.eecvs --overwrite --max-emd-us 0");
    assert_eq!(refused.status, Some(2), "{refused}");
}

/// A larger error of the volume takes fewer bytes, by every coder that has a tolerance, and excludes what else says how
/// exact times are.
#[test]
fn a_larger_error_of_the_volume_takes_fewer_bytes() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    for coder in ["fast", "dense", "dense --effort 1", "fast --keep-order"] {
        let mut sizes = Vec::new();
        for most in ["0.001", "0.01", "0.1 --transform best"] {
            let line = format!(
                "encode scene.raw -o frames.eecvs --coder {coder} --max-nmse {most} --overwrite --json"
            );
            let report = folder.eecvs(&line).ok().object();
            assert_eq!(
                count(&report, "events_in"),
                count(&report, "events_encoded"),
                "{coder}"
            );
            sizes.push(count(&report, "bytes_out"));
        }
        // The order of events takes more where more of them are decoded as of one time.
        let is_less = sizes.is_sorted_by(|a, b| a > b) || coder.ends_with("order");
        assert!(is_less, "{coder}: {sizes:?}");
    }
    let line = "encode scene.raw -o frames.eecvs --overwrite --max-nmse 0.1";
    for flags in [
        "--time-tolerance-us 3",
        "--bins 3",
        "--max-emd-us 3",
        "--bytes-per-second 100000",
        "--coder quick",
        "--mode transform",
    ] {
        let refused = folder.eecvs(&format!("{line} {flags}"));
        assert_eq!(refused.status, Some(2), "{flags}: {refused}");
        assert!(refused.stderr.contains("--max-nmse"), "{flags}: {refused}");
    }
    for share in ["0", "1", "-0.1", "nan", "x"] {
        let line = format!("encode scene.raw -o frames.eecvs --overwrite --max-nmse={share}");
        let refused = folder.eecvs(&line);
        assert_eq!(refused.status, Some(2), "{share}: {refused}");
    }
}

#[test]
fn a_lost_frame_is_told_behind_all_that_decodes() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder
        .eecvs("encode scene.raw -o whole.eecvs --mode transform")
        .ok();
    let mut frames = folder.frames("whole.eecvs");
    frames.remove(2);
    folder.write("lost.eecvs", frames.concat());
    folder
        .eecvs("decode lost.eecvs -o decoded.raw")
        .loses(&["frames lost: 1"]);
    let converted = folder.eecvs("convert lost.eecvs converted.raw");
    assert_eq!(converted.status, Some(1), "{converted}");
    assert!(converted.stderr.contains("frames lost: 1"), "{converted}");
    let (_, events) = folder.events("converted.raw");
    assert!(!events.is_empty() && folder.events("decoded.raw").1 == events);
    let refused = folder.eecvs("convert scene.raw scene.eecvs");
    assert_eq!(refused.status, Some(1), "{refused}");
    assert!(refused.stderr.contains("eecvs encode"), "{refused}");
}
