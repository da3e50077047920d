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
