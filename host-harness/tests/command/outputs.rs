//! What commands leave of their outputs: nothing that is not complete, and never less than was there.

use std::time::Duration;

use crate::support::Folder;

/// Files of the folder whose names do not begin with a dot.
fn names(folder: &Folder) -> Vec<String> {
    let entries = std::fs::read_dir(folder.path(".")).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| !name.starts_with('.')).collect();
    names.sort();
    names
}

#[test]
fn outputs_are_refused_before_anything_is_done() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("encode scene.raw -o good.eecvs").ok();
    folder.eecvs("convert scene.raw old.csv").ok();
    folder.write("hot.txt", "1,1\n");
    std::fs::hard_link(folder.path("scene.raw"), folder.path("hard.eecvs")).unwrap();
    std::fs::hard_link(folder.path("hot.txt"), folder.path("hot.eecvs")).unwrap();
    std::fs::create_dir(folder.path("frames")).unwrap();
    folder.write("frames/frame_000007.png", "stale");
    std::fs::create_dir(folder.path("used")).unwrap();
    folder.write("used/notes.txt", "kept");
    for name in [
        "keep.svg",
        "keep.toml",
        "keep.gif",
        "keep.npy",
        "v.times.npy",
    ] {
        folder.write(name, "kept");
    }
    let before = names(&folder);
    let kept = ["good.eecvs", "scene.raw", "old.csv", "hot.txt"];
    let bytes = kept.map(|name| folder.bytes(name));
    for (line, reason) in [
        ("encode scene.raw -o good.eecvs", "--overwrite"),
        ("encode scene.raw -o out.raw", "another kind"),
        ("encode scene.raw -o out.npy", "another kind"),
        ("encode scene.raw -o hard.eecvs --overwrite", "same file"),
        (
            "encode scene.raw -o ./frames/../hard.eecvs --overwrite",
            "same file",
        ),
        (
            "encode scene.raw --hot-pixels hot.txt -o hot.eecvs --overwrite",
            "same file",
        ),
        ("encode scene.raw -o none/a.eecvs", "no folder"),
        ("encode scene.raw -o frames", "is a folder"),
        ("demo -o frames", "--overwrite"),
        ("encode absent.raw -o good.eecvs --overwrite", "absent.raw"),
        ("encode good.eecvs -o good.eecvs --overwrite", "same file"),
        (
            "encode old.csv -o good.eecvs --overwrite --bytes-per-second 10",
            "good.eecvs|bytes",
        ),
        ("decode good.eecvs -o old.csv", "--overwrite"),
        ("decode good.eecvs -o out.eecvs", "eecvs encode"),
        ("decode good.eecvs --volume keep.npy", "--overwrite"),
        (
            "decode good.eecvs --volume v.npy --all-windows",
            "v.times.npy|--overwrite",
        ),
        (
            "decode good.eecvs -o w.times.npy --volume w.npy --all-windows",
            "same file",
        ),
        ("decode good.eecvs --volume out.raw", "another kind"),
        (
            "decode good.eecvs --volume keep.npy --overwrite --window 999",
            "no window",
        ),
        ("convert scene.raw old.csv", "--overwrite"),
        ("convert scene.raw out.eecvs", "eecvs encode"),
        ("convert scene.raw ./scene.raw --overwrite", "same file"),
        ("emulate motorcycle -o scene.raw", "--overwrite"),
        ("emulate motorcycle -o out.eecvs", "eecvs encode"),
        ("calibrate scene.raw -o keep.toml", "--overwrite"),
        ("calibrate scene.raw -o out.raw", "another kind"),
        ("monitor scene.raw --chart keep.svg", "--overwrite"),
        ("monitor scene.raw --histogram out.eecvs", "another kind"),
        ("view scene.raw -o keep.gif", "--overwrite"),
        ("view scene.raw -o frames/", "--overwrite"),
        // A folder of other files is not one for a run's.
        ("view scene.raw -o used/", "--overwrite"),
        ("view scene.raw -o used", "--overwrite"),
        ("demo -o used", "--overwrite"),
        ("split good.eecvs -o used", "--overwrite"),
        ("report --quick -o used", "--overwrite"),
        ("report --quick -o keep.svg", "is not a folder"),
        ("bench --quick -o used", "--overwrite"),
        ("bench --errors --quick -o used", "--overwrite"),
        ("bench --rate --quick -o used", "--overwrite"),
        // Of all windows of another file.
        (
            "decode good.eecvs --volume v.npy",
            "v.times.npy|--overwrite",
        ),
        (
            "monitor scene.raw --chart a.svg --histogram a.svg",
            "same file",
        ),
    ] {
        let outcome = folder.as_is(line);
        assert_eq!(outcome.status, Some(1), "{outcome}");
        let found = reason
            .split('|')
            .any(|reason| outcome.stderr.contains(reason));
        assert!(found, "{outcome}");
        assert_eq!(names(&folder), before, "{line}");
        for (name, bytes) in kept.iter().zip(&bytes) {
            assert!(folder.bytes(name) == *bytes, "{line}: {name}");
        }
        for name in ["keep.svg", "keep.toml", "keep.gif", "keep.npy"] {
            assert_eq!(folder.bytes(name), b"kept", "{line}: {name}");
        }
    }
    for line in [
        "encode scene.raw -o good.eecvs --overwrite",
        "decode good.eecvs -o old.csv --volume keep.npy --overwrite",
        "monitor scene.raw --chart keep.svg --overwrite",
        "calibrate scene.raw -o keep.toml --overwrite",
        "view scene.raw -o keep.gif --frames 2 --overwrite",
        "view scene.raw -o frames/ --frames 2 --overwrite",
        "view scene.raw -o used --frames 2 --overwrite",
        "split good.eecvs -o used --overwrite",
        "encode scene.raw -o /dev/null",
    ] {
        folder.as_is(line).ok();
    }
    assert_eq!(names(&folder), before);
    assert_eq!(folder.bytes("used/notes.txt"), b"kept");
    assert!(folder.path("used/1-40x30.eecvs").exists());
    assert!(folder.path("used/frame_000001.png").exists());
    // The times are of this array now, or gone.
    folder
        .as_is("decode good.eecvs --volume v.npy --overwrite")
        .ok();
    assert!(!folder.path("v.times.npy").exists());
    assert!(!folder.path("frames/frame_000007.png").exists());
    assert!(folder.path("frames/frame_000001.png").exists());
    for name in ["keep.svg", "keep.toml", "keep.gif", "keep.npy"] {
        assert_ne!(folder.bytes(name), b"kept", "{name}");
    }
}

#[test]
fn a_command_that_is_killed_leaves_the_old_file() {
    let folder = Folder::new();
    let long = "emulate motorcycle --width 80 --height 60 --duration-us 2000000 -o";
    folder.eecvs(&format!("{long} scene.raw")).ok();
    folder.eecvs("encode scene.raw -o scene.eecvs").ok();
    let commands = [
        (format!("{long} OUT.aedat4 --overwrite"), "OUT.aedat4"),
        (
            "convert scene.raw OUT.csv --overwrite".to_owned(),
            "OUT.csv",
        ),
        (
            "convert scene.raw OUT.hdf5 --overwrite".to_owned(),
            "OUT.hdf5",
        ),
        (
            "encode scene.raw -o OUT.eecvs --overwrite".to_owned(),
            "OUT.eecvs",
        ),
        (
            "decode scene.eecvs -o OUT.dat --overwrite".to_owned(),
            "OUT.dat",
        ),
        (
            "decode scene.eecvs --volume OUT.npy --overwrite".to_owned(),
            "OUT.npy",
        ),
        (
            "view scene.raw -o OUT.gif --frames 20 --overwrite".to_owned(),
            "OUT.gif",
        ),
    ];
    let mut random = 0x9E37_79B9_7F4A_7C15_u64;
    for (line, out) in &commands {
        folder.eecvs(line).ok();
        let whole = folder.bytes(out);
        for _ in 0..6 {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            folder.write(out, "old");
            let arguments: Vec<&str> = line.split_whitespace().collect();
            let mut child = folder.command(&arguments).spawn().unwrap();
            std::thread::sleep(Duration::from_millis((random >> 33) % 120));
            child.kill().unwrap();
            child.wait().unwrap();
            let left = folder.bytes(out);
            // Files with a date or a random number in them differ from run to run in their bytes.
            assert!(
                left == b"old" || left.len() == whole.len(),
                "{line}: {} of {} bytes",
                left.len(),
                whole.len()
            );
        }
    }
}

/// What comes of a damaged recording never takes the place of a file, even with `--overwrite`; frames that were lost on
/// their way are counted, and what all others hold is the output.
#[test]
fn what_ends_at_a_damage_replaces_nothing() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder.eecvs("convert scene.raw scene.csv").ok();
    folder
        .eecvs("encode scene.raw -o scene.eecvs --window-us 10000")
        .ok();
    let half = |name: &str| {
        let mut bytes = folder.bytes(name);
        bytes.truncate(bytes.len() / 2 + 1);
        bytes
    };
    folder.write("cut.csv", [half("scene.csv"), b"1,".to_vec()].concat());
    folder.write("cut.eecvs", half("scene.eecvs"));
    let cases = [
        ("encode cut.csv -o OUT.eecvs", "OUT.eecvs"),
        ("convert cut.csv OUT.raw", "OUT.raw"),
        ("convert cut.eecvs OUT.dat", "OUT.dat"),
    ];
    for (line, output) in cases {
        let [old, fresh] = ["old", "fresh"].map(|stem| output.replace("OUT", stem));
        let outcome = folder.as_is(&line.replace(output, &fresh));
        assert_eq!(outcome.status, Some(1), "{outcome}");
        folder.write(&old, "kept");
        let line = format!("{} --overwrite", line.replace(output, &old));
        let outcome = folder.as_is(&line);
        assert_eq!(outcome.status, Some(1), "{outcome}");
        assert_eq!(folder.bytes(&old), b"kept", "{outcome}");
        let beside = format!("incomplete-{old}");
        assert_eq!(folder.bytes(&beside), folder.bytes(&fresh), "{outcome}");
        assert!(outcome.stderr.contains(&beside), "{outcome}");
    }
    folder.write("old.csv", "kept");
    let outcome = folder.as_is("decode cut.eecvs -o old.csv --overwrite");
    assert_eq!(outcome.status, Some(1), "{outcome}");
    assert_ne!(folder.bytes("old.csv"), b"kept", "{outcome}");
}
