//! How commands end by what was lost: the table of the manual, tried line by line.
//!
//! 0 where nothing of the input is missing in the output, or only what the user asked to leave out; 1 where anything
//! is, and everything else was used; 2 where the command line is wrong.

use crate::support::Folder;

/// Commands, with IN for what they read.
const COMMANDS: [&str; 10] = [
    "info IN",
    "convert IN out.csv",
    "encode IN -o out.eecvs",
    "calibrate IN -o out.toml",
    "monitor IN",
    "view IN -o out.gif --slice-us 10000",
    "compare IN IN",
    "decode IN -o out.csv",
    "inspect IN",
    "split IN -o parts-IN",
];

/// Of those, commands that read recordings alone, frames as well, frames alone.
const READ_ANY: usize = 7;

/// A kind of loss: file, whether it is of frames, status, part of what is said on stderr (nothing: silence).
type Kind = (&'static str, bool, i32, &'static str);

const KINDS: [Kind; 31] = [
    ("whole.raw", false, 0, ""),
    ("whole.eecvs", true, 0, ""),
    // Nothing is lost where a clock falls back: runs begin.
    ("back.csv", false, 0, "|runs"),
    // Left out by wish.
    ("filtered.eecvs", true, 0, ""),
    ("thinned.eecvs", true, 0, ""),
    // Nothing is missing, but not all is as it was sent.
    ("twice.eecvs", true, 0, "repeated"),
    ("swapped.eecvs", true, 0, "out of order"),
    ("late.eecvs", true, 0, "before the first"),
    ("joined.eecvs", true, 0, "numbering"),
    // Damage.
    ("cut.raw", false, 1, "cut.raw"),
    ("bad.csv", false, 1, "line"),
    ("outside.csv", false, 1, "outside"),
    ("two.npy", false, 1, "follow"),
    ("two.aedat4", false, 1, "another recording"),
    ("two.npz", false, 1, "another recording"),
    ("two.parquet", false, 1, "another recording"),
    ("two.arrow", false, 1, "another recording"),
    ("two.arrows", false, 1, "another recording"),
    ("two.h5", false, 1, "another recording"),
    ("two.mcap", false, 1, "another recording"),
    ("two.db3", false, 1, "another recording"),
    ("two.bag", false, 1, "two.bag"),
    ("short.csv", false, 1, "line 2"),
    ("cut.eecvs", true, 1, "damaged bytes"),
    ("flipped.eecvs", true, 1, "damaged bytes"),
    ("lost.eecvs", true, 1, "frames lost"),
    ("noise.eecvs", true, 1, "damaged bytes"),
    ("sensors.eecvs", true, 1, "another sensor"),
    // Nothing at all.
    ("none.raw", false, 1, "none.raw"),
    ("unknown.bin", false, 1, "unknown.bin"),
    ("garbage.eecvs", true, 1, "no frame"),
];

fn files(folder: &Folder) {
    folder.scene("whole.raw");
    folder.eecvs("encode whole.raw -o whole.eecvs").ok();
    folder
        .eecvs("encode whole.raw -o filtered.eecvs --region 0,0,20,20 --isolated")
        .ok();
    folder
        .eecvs("encode whole.raw -o thinned.eecvs --bytes-per-second 8000")
        .ok();
    let raw = folder.bytes("whole.raw");
    folder.write("cut.raw", &raw[..raw.len() - 3]);
    let row = |t: u64| format!("{t},{},{},{}\n", t % 40, t % 30, t % 2);
    let rows: String = (0..500).map(|i| row(1_000_000 + 50 * i)).collect();
    let head = "t,x@40,y@30,p\n";
    let back: String = (0..500).map(|i| row(50 * i)).collect();
    folder.write("back.csv", format!("{head}{rows}{back}"));
    folder.write("bad.csv", format!("{head}{rows}12,3,nothing\n"));
    folder.write("outside.csv", format!("{head}{rows}2000000,41,3,1\n{back}"));
    let frames = folder.frames("whole.eecvs");
    assert!(frames.len() > 4);
    let whole = frames.concat();
    folder.write("cut.eecvs", &whole[..whole.len() - 5]);
    let mut flipped = whole.clone();
    flipped[frames[0].len() + 60] ^= 4;
    folder.write("flipped.eecvs", flipped);
    folder.write(
        "noise.eecvs",
        [&frames[0], &b"noise"[..], &whole[frames[0].len()..]].concat(),
    );
    let mut other = frames.clone();
    other.remove(1);
    folder.write("lost.eecvs", other.concat());
    let mut other = frames.clone();
    other.insert(2, frames[1].clone());
    folder.write("twice.eecvs", other.concat());
    let mut other = frames.clone();
    other.swap(1, 2);
    folder.write("swapped.eecvs", other.concat());
    folder
        .eecvs("encode whole.raw -o again.eecvs --window-us 50000")
        .ok();
    folder.write(
        "joined.eecvs",
        [whole.clone(), folder.bytes("again.eecvs")].concat(),
    );
    folder
        .eecvs("emulate indoor-flying -o other.raw --width 64 --height 48 --duration-us 90000")
        .ok();
    folder.eecvs("encode other.raw -o other.eecvs").ok();
    folder.write(
        "sensors.eecvs",
        [whole, folder.bytes("other.eecvs")].concat(),
    );
    folder.write("late.eecvs", frames[2..].concat());
    for name in [
        "two.npy",
        "two.aedat4",
        "two.npz",
        "two.parquet",
        "two.arrow",
        "two.arrows",
        "two.h5",
        "two.mcap",
        "two.db3",
        "two.bag",
    ] {
        folder.eecvs(&format!("convert whole.raw {name}")).ok();
        let one = folder.bytes(name);
        folder.write(name, [one.clone(), one].concat());
    }
    // Not the sensor's size, which stands before everything else.
    folder.write("short.csv", "t,x,y,p\n1000,63\n1010,5,5,1\n");
    folder.write("unknown.bin", [0x1b; 999]);
    folder.write("garbage.eecvs", [0x1b; 999]);
}

#[test]
fn the_status_says_whether_anything_is_missing() {
    let folder = Folder::new();
    files(&folder);
    for (file, is_frames, status, said) in KINDS {
        for (number, command) in COMMANDS.into_iter().enumerate() {
            let is_of_frames = number >= READ_ANY;
            if is_of_frames && !is_frames {
                continue;
            }
            let line = command.replace("IN", file);
            let outcome = folder.eecvs(&line);
            // Its work is to look at, or to take apart, what others refuse; and joined files are what it is for.
            let is_apart = ["inspect", "split"]
                .iter()
                .any(|name| command.starts_with(name));
            let expected = match file {
                "sensors.eecvs" if is_apart => 0,
                // Pictures go on in time: events of an earlier time are in none.
                "back.csv" | "swapped.eecvs" | "joined.eecvs" if command.starts_with("view") => 1,
                _ => status,
            };
            assert_eq!(outcome.status, Some(expected), "{outcome}");
            let is_silent = said.is_empty()
                || said.starts_with('|')
                || file == "sensors.eecvs" && is_apart
                || file == "joined.eecvs" && command.starts_with("split");
            match said.strip_prefix('|') {
                // Of the encoder alone.
                Some(said) if command.starts_with("encode") => {
                    assert!(outcome.stderr.contains(said), "{outcome}");
                }
                _ if expected > status => {
                    assert!(outcome.stderr.contains("out of time order"), "{outcome}");
                }

                _ if is_silent => assert!(outcome.stderr.is_empty(), "{outcome}"),
                // As recordings, frames say what is no loss in their tables.
                _ if expected == 0 && !is_of_frames => {
                    let is_said = [&outcome.stderr, &outcome.stdout]
                        .iter()
                        .any(|text| !text.is_empty());
                    assert!(is_said, "{outcome}");
                }
                _ => assert!(outcome.stderr.contains(said), "{outcome}"),
            }
            if status == 1 && expected == 1 {
                assert_eq!(outcome.stderr.lines().count(), 1, "{outcome}");
            }
            // A usage error is of another kind than a loss.
            let wrong = folder.as_is(&format!("{line} --no-such-flag"));
            assert_eq!(wrong.status, Some(2), "{wrong}");
        }
    }
}

#[test]
fn what_is_left_out_by_wish_is_no_loss() {
    let folder = Folder::new();
    files(&folder);
    for (line, counted) in [
        (
            "convert outside.csv out.csv --leave-out-bad-events",
            "1 events outside of the sensor",
        ),
        (
            "info outside.csv --leave-out-bad-events",
            "1 events outside of the sensor",
        ),
        (
            "encode outside.csv -o out.eecvs --leave-out-bad-events --sort",
            "1 events outside of the sensor",
        ),
        ("convert back.csv out.csv --sort", ""),
    ] {
        let outcome = folder.eecvs(line).ok();
        assert!(outcome.stdout.contains(counted), "{outcome}");
    }
}

#[test]
fn a_format_can_be_named_for_any_name() {
    let folder = Folder::new();
    files(&folder);
    for line in [
        "decode whole.eecvs -o a --format evt3",
        "convert whole.raw b --format csv",
        "emulate motorcycle -o c.recording --format dat --duration-us 50000",
    ] {
        folder.eecvs(line).ok();
    }
    folder.eecvs("compare whole.raw a").ok();
    folder.eecvs("compare whole.raw b").ok();
}

#[cfg(target_os = "linux")]
#[test]
fn what_cannot_be_written_is_an_error() {
    let folder = Folder::new();
    files(&folder);
    for line in [
        "convert whole.raw /dev/full --format evt3",
        "convert whole.raw /dev/full --format hdf5",
        "encode whole.raw -o /dev/full",
        "decode whole.eecvs -o /dev/full --format text",
        "emulate motorcycle -o /dev/full --format evt2 --duration-us 100000",
    ] {
        folder.as_is(line).fails(&["/dev/full"]);
    }
}

/// Arguments that are not UTF-8 are values like others, or are refused: files may have such names.
#[cfg(unix)]
#[test]
fn arguments_may_be_of_any_bytes() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt as _;
    use std::process::Command;
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&OsStr]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs"));
        let output = command.args(arguments).current_dir(folder.path()).output();
        let output = output.unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!said.contains("panicked"), "{arguments:?}: {said}");
        (output.status.code(), said)
    };
    let nowhere = OsStr::from_bytes(b"nowhere\xff");
    let help = Command::new(env!("CARGO_BIN_EXE_eecvs"))
        .arg("--help")
        .output();
    let help = String::from_utf8(help.unwrap().stdout).unwrap();
    let commands = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let commands = commands.take_while(|line| !line.is_empty());
    let commands: Vec<&str> = commands
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .collect();
    assert!(commands.len() > 10, "{commands:?}");
    for command in commands
        .into_iter()
        .map(OsStr::new)
        .filter(|command| *command != "help")
    {
        for arguments in [
            vec![command, nowhere],
            vec![command, nowhere, nowhere],
            vec![command, OsStr::new("-o"), nowhere, nowhere],
            vec![command, OsStr::new("--scene"), nowhere],
        ] {
            let (status, said) = run(&arguments);
            assert!(
                matches!(status, Some(1 | 2)),
                "{arguments:?}: {status:?}: {said}"
            );
            assert!(!said.is_empty(), "{arguments:?}");
        }
    }
    // A file's name may be so, in every format.
    for ending in [
        "csv", "raw", "aedat4", "mcap", "db3", "bag", "npz", "parquet", "h5",
    ] {
        let path = [b"a\xff.".as_slice(), ending.as_bytes()].concat();
        let path = OsStr::from_bytes(&path);
        let line = ["emulate", "indoor-flying", "--duration-us", "20000", "-o"];
        let mut line: Vec<&OsStr> = line.into_iter().map(OsStr::new).collect();
        line.push(path);
        let (status, said) = run(&line);
        assert_eq!(status, Some(0), "{path:?}: {said}");
        let (status, said) = run(&[OsStr::new("info"), path]);
        assert_eq!(status, Some(0), "{path:?}: {said}");
    }
}
