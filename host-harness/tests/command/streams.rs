//! `eecvs` in pipelines: stdin, stdout and named pipes in place of files, frames of several sensors, windows on a
//! grid.

use std::fs::File;
use std::io::{Read, Write};
use std::process::{Child, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use event_files::FORMATS;
use serde_json::Value;

use crate::support::{Folder, Outcome, count, exists};

/// Runs `eecvs` with `input` on stdin; also its stdout as it is.
pub fn piped(folder: &Folder, line: &str, input: &[u8]) -> (Outcome, Vec<u8>) {
    let arguments: Vec<&str> = line.split_whitespace().collect();
    let mut command = folder.command(&arguments);
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().expect("the program starts");
    let mut stdin = child.stdin.take().expect("a pipe");
    let input = input.to_vec();
    // In pieces, as a pipe may give them; a command that ends early leaves the rest.
    let writing = thread::spawn(move || {
        for piece in input.chunks(10_007) {
            if stdin.write_all(piece).is_err() {
                break;
            }
        }
    });
    let output = child.wait_with_output().expect("the program ends");
    writing.join().expect("no panic");
    let outcome = Outcome {
        status: output.status.code(),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        line: line.to_owned(),
    };
    assert!(!outcome.stderr.contains("panicked"), "{outcome}");
    (outcome, output.stdout)
}

fn said(stderr: &str) -> Value {
    serde_json::from_str(stderr).unwrap_or_else(|error| panic!("{error}: {stderr}"))
}

#[test]
fn every_command_reads_stdin_as_it_reads_a_file() {
    let folder = Folder::new();
    folder.scene("a.raw");
    folder.eecvs("encode a.raw -o a.eecvs").ok();
    for (recording, line) in [
        ("a.raw", "info IN --json"),
        ("a.raw", "convert IN OUT.csv --overwrite"),
        ("a.raw", "encode IN -o OUT.eecvs --overwrite"),
        ("a.raw", "encode IN -o OUT.eecvs --overwrite --threads 3"),
        (
            "a.raw",
            "encode IN -o OUT.eecvs --overwrite --sort --keep-order",
        ),
        ("a.raw", "calibrate IN -o OUT.toml --overwrite"),
        ("a.raw", "compare IN a.raw --json"),
        ("a.raw", "compare a.raw IN"),
        (
            "a.raw",
            "view IN -o OUT.png --overwrite --frames 1 --speed 0.1",
        ),
        ("a.raw", "monitor IN --json"),
        ("a.eecvs", "info IN --json"),
        ("a.eecvs", "inspect IN"),
        ("a.eecvs", "decode IN -o OUT.csv --overwrite"),
        ("a.eecvs", "decode IN --volume OUT.npy --bins 5 --overwrite"),
        ("a.eecvs", "monitor IN --json"),
        (
            "a.eecvs",
            "view IN -o OUT.gif --overwrite --frames 3 --speed 0.1",
        ),
    ] {
        let out = line.split(' ').find_map(|part| part.strip_prefix("OUT"));
        let name = |input: &str| {
            let of = if input == "-" { "piped" } else { "file" };
            out.map(|ending| format!("{of}{ending}"))
        };
        let run = |input: &str| {
            let line = line.replace("IN", input);
            let stem = name(input).unwrap_or_default();
            let stem = stem.split('.').next().unwrap_or_default();
            let bytes = if input == "-" {
                folder.bytes(recording)
            } else {
                vec![]
            };
            let (outcome, stdout) = piped(&folder, &line.replace("OUT", stem), &bytes);
            assert_eq!(outcome.status, Some(0), "{outcome}");
            assert!(outcome.stderr.is_empty(), "{outcome}");
            stdout
        };
        let (from_file, from_pipe) = (run(recording), run("-"));
        match out {
            // Thresholds name what they are from.
            Some(".toml") => {}
            Some(_) => {
                let bytes = |input| folder.bytes(&name(input).expect("an output"));
                assert!(bytes(recording) == bytes("-"), "{line}");
            }
            None => assert!(from_file == from_pipe, "{line}"),
        }
    }
    // Two recordings cannot come through one pipe.
    piped(&folder, "compare - -", &[]).0.fails(&["stdin"]);
    piped(&folder, "info -", &[]).0.fails(&["stdin", "empty"]);
    let nothing = b"nothing that is known".to_vec();
    piped(&folder, "info -", &nothing)
        .0
        .fails(&["stdin", "byte 0"]);
}

/// What a name's ending chooses is written, whether the name is that of a file or `--format`'s.
#[test]
fn endings_of_one_format_are_written_as_they_are_named() {
    let folder = Folder::new();
    folder.write("a.csv", b"t,x,y,p\n5000,1,2,1\n5001,33,3,0\n");
    for (name, begins) in [
        ("csv", b"t,x,y,p\n5000,1,2,1\n".as_slice()),
        // A column below 2 leaves it open which number is the time.
        ("txt", b"# t x y p\n5000 1 2 1\n"),
        ("arrow", b"ARROW1\0\0"),
        ("arrows", b"\xff\xff\xff\xff"),
    ] {
        let file = format!("b.{name}");
        folder.eecvs(&format!("convert a.csv {file}")).ok();
        assert!(folder.bytes(&file).starts_with(begins), "{file}");
        folder
            .eecvs(&format!("convert a.csv plain --format {name}"))
            .ok();
        assert!(folder.bytes("plain").starts_with(begins), "{name}");
        let (outcome, bytes) = piped(&folder, &format!("convert a.csv - --format {name}"), &[]);
        assert_eq!(outcome.status, Some(0), "{outcome}");
        assert!(bytes.starts_with(begins), "{name} to stdout");
    }
}

#[test]
fn every_format_that_is_written_is_read_back_through_pipes() {
    let folder = Folder::new();
    let mut tried = 0;
    for format in FORMATS.iter().filter(|format| format.create.is_some()) {
        let name = format.name;
        // AEDAT 2 and N-MNIST hold no other sizes.
        let side = if name == "aedat2" { 128 } else { 34 };
        folder
            .eecvs(&format!(
                "emulate indoor-flying -o a.raw --width {side} --height {side} --duration-us 50000"
            ))
            .ok();
        let (sensor, events) = folder.events("a.raw");
        let line = format!("convert a.raw - --format {name} --json");
        let (outcome, bytes) = piped(&folder, &line, &[]);
        assert_eq!(outcome.status, Some(0), "{outcome}");
        assert_eq!(
            count(&said(&outcome.stderr), "events_out"),
            events.len() as u64
        );
        let file = format!("b{}", format.endings[0]);
        folder
            .eecvs(&format!("convert a.raw {file} --format {name}"))
            .ok();
        // Some have random names inside, or none that stdin could have.
        folder.write(&format!("c{}", format.endings[0]), &bytes);
        let (of_file, read) = folder.events(&format!("c{}", format.endings[0]));
        assert!(read == events, "{name}");
        assert!(
            of_file == sensor || ["npy", "text", "csv"].contains(&name),
            "{name}"
        );
        // Told by an extension alone, which stdin has not; and a database, which is read where it lies.
        if ["nmnist", "db3"].contains(&name) {
            continue;
        }
        let (outcome, text) = piped(
            &folder,
            &format!("convert - - --format text --width {side} --height {side}"),
            &bytes,
        );
        assert_eq!(outcome.status, Some(0), "{name}: {outcome}");
        folder.write("d.csv", &text);
        assert!(folder.events("d.csv").1 == events, "{name}");
        tried += 1;
    }
    assert!(tried > 12);
    piped(&folder, "convert a.raw -", &[])
        .0
        .fails(&["--format"]);
    piped(
        &folder,
        "convert a.raw b.aedat4 --format dat --overwrite",
        &[],
    )
    .0
    .fails(&["b.aedat4", "extension"]);
}

#[test]
fn a_pipeline_carries_every_event_and_its_tables_stay_out_of_it() {
    let folder = Folder::new();
    folder.scene("a.raw");
    let (outcome, raw) = piped(
        &folder,
        "emulate motorcycle -o - --model 1 --format evt3 --width 40 --height 30 --duration-us 200000 --start-us 7000",
        &[],
    );
    assert!(outcome.stderr.contains("motorcycle"), "{outcome}");
    assert!(raw == folder.bytes("a.raw"));
    folder.eecvs("encode a.raw -o a.eecvs").ok();
    for output in ["-", "/dev/stdout"] {
        let line = format!("encode - -o {output} --json");
        let (outcome, frames) = piped(&folder, &line, &raw);
        assert!(frames == folder.frames("a.eecvs").concat(), "{outcome}");
        assert_eq!(count(&said(&outcome.stderr), "events_late"), 0);
        let (outcome, decoded) = piped(&folder, "decode - -o - --format evt3", &frames);
        assert!(outcome.stderr.contains("windows"), "{outcome}");
        folder.write("b.raw", &decoded);
        folder.eecvs("compare a.raw b.raw").ok();
    }
    // Stdout that is a file is not emptied.
    folder.write("c.eecvs", "before");
    let out = File::options()
        .append(true)
        .open(folder.path("c.eecvs"))
        .unwrap();
    let mut command = folder.command(&["encode", "a.raw", "-o", "-"]);
    let status = command.stdout(out).stderr(Stdio::null()).status().unwrap();
    assert!(status.success());
    let both = [b"before".to_vec(), folder.frames("a.eecvs").concat()].concat();
    assert!(folder.bytes("c.eecvs") == both);
    // Damage in the middle of a pipeline is said, with all else in the output.
    let mut frames = folder.bytes("a.eecvs");
    let middle = frames.len() / 2;
    frames[middle] ^= 1;
    let (outcome, decoded) = piped(&folder, "decode - -o - --format text", &frames);
    assert_eq!(outcome.status, Some(1), "{outcome}");
    assert!(
        outcome.stderr.contains("stdin: ") && !decoded.is_empty(),
        "{outcome}"
    );
}

/// Waits until the child has written `bytes` bytes more, whatever else it still waits for.
fn wait_for(child: &mut Child, bytes: usize) -> Vec<u8> {
    let mut read = vec![0; bytes];
    let out = child.stdout.as_mut().expect("a pipe");
    out.read_exact(&mut read).expect("bytes of it");
    read
}

#[test]
fn what_has_come_is_shown_before_the_pipe_ends() {
    let folder = Folder::new();
    folder.scene("a.raw");
    folder.eecvs("encode a.raw -o a.eecvs").ok();
    let frames = folder.frames("a.eecvs");
    let mut command = folder.command(&["monitor", "-"]);
    command.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(&frames[0]).unwrap();
    let begun = Instant::now();
    // The titles and the window's row.
    let first = String::from_utf8(wait_for(&mut child, 130)).unwrap();
    assert!(
        first.contains("regime") && first.contains("7784"),
        "{first}"
    );
    assert!(begun.elapsed() < Duration::from_secs(60));
    stdin.write_all(&frames[1..].concat()).unwrap();
    drop(stdin);
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let rest = String::from_utf8(output.stdout).unwrap();
    assert_eq!((first + &rest).matches("32768").count(), frames.len());
    // Windows are encoded as they end; events are read some thousands at a time.
    folder
        .eecvs("emulate motorcycle -o b.raw --width 128 --height 96 --duration-us 200000")
        .ok();
    folder.eecvs("encode b.raw -o b.eecvs").ok();
    let frames = folder.frames("b.eecvs");
    let raw = folder.bytes("b.raw");
    let mut command = folder.command(&["encode", "-", "-o", "-"]);
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    assert!(raw.len() > 150_000, "{}", raw.len());
    stdin.write_all(&raw[..raw.len() - 4]).unwrap();
    assert_eq!(wait_for(&mut child, frames[0].len()), frames[0]);
    drop(stdin);
    child.wait_with_output().unwrap();
}

#[cfg(unix)]
#[test]
fn a_named_pipe_is_a_file_to_every_command() {
    let folder = Folder::new();
    folder.scene("a.raw");
    folder.eecvs("encode a.raw -o a.eecvs").ok();
    let made = std::process::Command::new("mkfifo")
        .args([folder.path("in"), folder.path("out.eecvs")])
        .status();
    if !made.is_ok_and(|status| status.success()) {
        eprintln!("skipped: there is no mkfifo");
        return;
    }
    let feed = |from: &str| {
        let (bytes, pipe) = (folder.bytes(from), folder.path("in"));
        thread::spawn(move || {
            // Who ends early leaves the rest.
            let _ = File::create(pipe).unwrap().write_all(&bytes);
        })
    };
    for (from, line) in [
        ("a.raw", "info in"),
        ("a.eecvs", "info in"),
        ("a.eecvs", "monitor in"),
        ("a.raw", "monitor in"),
        ("a.eecvs", "inspect in"),
        ("a.eecvs", "view in --terminal-columns 30 --frames 2"),
        ("a.raw", "view in --terminal-columns 30 --frames 2"),
        ("a.eecvs", "decode in -o b.raw"),
    ] {
        let feeding = feed(from);
        folder.eecvs(line).ok();
        feeding.join().unwrap();
    }
    folder.eecvs("compare a.raw b.raw").ok();
    // Written to one as well.
    let pipe = folder.path("out.eecvs");
    let reading = thread::spawn(move || std::fs::read(pipe).unwrap());
    let feeding = feed("a.raw");
    folder.as_is("encode in -o out.eecvs").ok();
    feeding.join().unwrap();
    assert!(reading.join().unwrap() == folder.frames("a.eecvs").concat());
}

#[test]
fn a_closed_pipe_ends_a_command_in_silence() {
    let folder = Folder::new();
    folder.scene("a.raw");
    folder.eecvs("encode a.raw -o a.eecvs").ok();
    for line in [
        "encode a.raw -o -",
        "decode a.eecvs -o - --format text",
        "convert a.raw - --format text",
        "convert a.raw - --format hdf5",
        "inspect a.eecvs",
        "monitor a.eecvs",
    ] {
        let arguments: Vec<&str> = line.split_whitespace().collect();
        let mut command = folder.command(&arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(
            !stderr.contains("panicked") && !stderr.contains("ipe"),
            "{line}: {stderr}"
        );
        assert_eq!(output.status.code(), Some(0), "{line}: {stderr}");
    }
}

#[test]
fn frames_of_two_sensors_are_never_mixed_and_can_be_taken_apart() {
    let folder = Folder::new();
    folder.scene("a.raw");
    folder
        .eecvs("emulate indoor-flying -o c.raw --width 64 --height 48 --duration-us 150000")
        .ok();
    for name in ["a", "c"] {
        let line = format!("encode {name}.raw -o {name}.eecvs --coder dense");
        folder.eecvs(&line).ok();
    }
    let (a, c) = (folder.frames("a.eecvs"), folder.frames("c.eecvs"));
    let alternating: Vec<u8> = (0..a.len().max(c.len()))
        .flat_map(|i| [a.get(i), c.get(i)])
        .flatten()
        .flatten()
        .copied()
        .collect();
    for (name, bytes, first) in [
        ("ac", [a.concat(), c.concat()].concat(), "a"),
        ("ca", [c.concat(), a.concat()].concat(), "c"),
        ("mixed", alternating, "a"),
    ] {
        let file = format!("{name}.eecvs");
        folder.write(&file, &bytes);
        let own = folder.frames(&format!("{first}.eecvs"));
        let before = if name == "mixed" { &own[..1] } else { &own[..] };
        folder.write("before.eecvs", before.concat());
        folder.eecvs("decode before.eecvs -o before.raw").ok();
        for (line, output) in [("decode F -o", "decoded"), ("convert F", "converted")] {
            let output = format!("{output}-{name}.raw");
            let line = format!("{} {output}", line.replace('F', &file));
            folder.eecvs(&line).loses(&[
                "another sensor",
                "eecvs split",
                &format!("byte {}", before.concat().len()),
            ]);
            assert!(
                folder.events(&output).1 == folder.events("before.raw").1,
                "{name}"
            );
        }
        for line in [
            "decode F --volume v.npy --bins 5",
            "info F",
            "monitor F",
            "view F --terminal-columns 30",
        ] {
            folder
                .eecvs(&line.replace('F', &file))
                .loses(&["another sensor", "eecvs split"]);
        }
        // Looked at frame by frame, all are there.
        let rows = folder.eecvs(&format!("inspect {file} --json")).array();
        assert_eq!(rows.len(), a.len() + c.len());
        let parts = folder.eecvs(&format!("split {file} -o {name} --json"));
        assert_eq!(parts.status, Some(0), "{parts}");
        let parts = parts.object();
        assert_eq!(parts["parts"].as_array().map(Vec::len), Some(2), "{parts}");
        let [one, two] = if first == "a" {
            ["40x30", "64x48"]
        } else {
            ["64x48", "40x30"]
        };
        let of = |size: &str| {
            if size == "40x30" {
                a.concat()
            } else {
                c.concat()
            }
        };
        assert!(folder.frames(&format!("{name}/1-{one}.eecvs")).concat() == of(one));
        assert!(folder.frames(&format!("{name}/2-{two}.eecvs")).concat() == of(two));
        folder
            .as_is(&format!("split {file} -o {name}"))
            .fails(&["already has files", "--overwrite"]);
    }
    // Two recordings of one sensor, one behind the other.
    folder
        .eecvs("encode a.raw -o b.eecvs --coder dense --window-us 50000")
        .ok();
    let b = folder.frames("b.eecvs").concat();
    folder.write("ab.eecvs", [a.concat(), b.clone()].concat());
    folder.eecvs("split ab.eecvs -o ab").ok();
    assert!(folder.frames("ab/1-40x30.eecvs").concat() == a.concat());
    assert!(folder.frames("ab/2-40x30.eecvs").concat() == b);
    // Parts of an earlier input are not taken for this one's, and what is no part stays.
    folder.write("ab/notes.eecvs", "");
    folder.eecvs("split a.eecvs -o ab --overwrite").ok();
    assert!(folder.frames("ab/1-40x30.eecvs").concat() == a.concat());
    assert!(!exists(&folder.path("ab/2-40x30.eecvs")));
    assert!(exists(&folder.path("ab/notes.eecvs")));
    // Through a pipe; nothing of what is damaged.
    let mut damaged = [a.concat(), c.concat()].concat();
    damaged[a[0].len() + 50] ^= 1;
    let (outcome, _) = piped(&folder, "split - -o damaged --json", &damaged);
    let outcome = outcome.loses(&["stdin", "damaged bytes"]);
    assert_eq!(
        count(&outcome.object(), "frames"),
        (a.len() + c.len() - 1) as u64
    );
    piped(&folder, "split - -o none", b"no frames")
        .0
        .fails(&["no frame found"]);
}

#[test]
fn windows_of_two_sensors_match_on_a_grid() {
    let folder = Folder::new();
    // Of another size, and later by no whole window.
    folder.scene("a.raw");
    folder
        .eecvs("emulate indoor-flying -o b.raw --width 64 --height 48 --duration-us 180000 --start-us 12345")
        .ok();
    let starts = |line: &str| -> Vec<u64> {
        folder.eecvs(line).ok();
        let rows = folder.eecvs("inspect o.eecvs --json").array();
        rows.iter().map(|row| count(row, "t0_us")).collect()
    };
    for origin_us in [0_u64, 5_000, 1 << 40] {
        let of = |name: &str| {
            starts(&format!(
                "encode {name} -o o.eecvs --window-us 10000 --origin-us {origin_us}"
            ))
        };
        let (a, b) = (of("a.raw"), of("b.raw"));
        for t0_us in a.iter().chain(&b) {
            assert_eq!(t0_us % 10_000, origin_us % 10_000);
        }
        assert!(b.iter().filter(|t0_us| a.contains(t0_us)).count() > 10);
        folder.eecvs("decode o.eecvs -o back.raw").ok();
        folder.eecvs("compare b.raw back.raw").ok();
    }
    // A pixel that sees nothing for a second.
    folder.write("quiet.csv", "t,x,y,p\n100,1,1,1\n1000000,1,1,0\n");
    let quiet = "encode quiet.csv -o o.eecvs --width 8 --height 8 --window-us 10000";
    assert_eq!(starts(quiet).len(), 2);
    let every = starts(&format!("{quiet} --every-window"));
    assert_eq!(
        every,
        (0..100).map(|i| 100 + i * 10_000).collect::<Vec<u64>>()
    );
    let rows = folder.eecvs("inspect o.eecvs --json").array();
    let empty = rows.iter().filter(|row| count(row, "events") == 0);
    assert!(
        empty
            .clone()
            .all(|row| (20..=40).contains(&count(row, "frame_bytes")))
    );
    assert_eq!(empty.count(), 98);
    folder.eecvs("decode o.eecvs -o back.csv").ok();
    assert_eq!(folder.events("back.csv").1, folder.events("quiet.csv").1);
    folder
        .eecvs("encode quiet.csv -o o.eecvs --width 8 --height 8 --region 4,4,5,4")
        .fails(&["--region", "8 x 8"]);
    folder
        .eecvs("encode quiet.csv -o o.eecvs --width 8 --height 8 --region 4,4,4,4")
        .ok();
}
