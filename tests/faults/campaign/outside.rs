//! What comes from outside: inputs without an end or of another kind, sizes that ask for more memory than there is, and
//! names that a terminal would act on.

use std::os::unix::fs::symlink;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::run::{Bench, program};

/// Virtual memory of a program that must not ask for more: what it takes with a small input, and room for its threads.
const MEMORY_KIB: u64 = 3 << 20;

/// Time in which a program has found out that its input is none; it takes a second or two.
const LONGEST: Duration = Duration::from_secs(60);

/// A command on a small input takes far less.
const SHORTLY: Duration = Duration::from_secs(5);

/// Runs a program in the folder `run`, its arguments split at spaces, with this much virtual memory.
fn run(bench: &Bench, name: &str, line: &str, memory_kib: u64) -> Output {
    let mut command = limited(bench, name, memory_kib);
    end(
        command.args(line.split(' ')).spawn().expect("a program"),
        line,
    )
}

fn limited(bench: &Bench, name: &str, memory_kib: u64) -> Command {
    let mut command = Command::new("sh");
    let limit = format!("ulimit -v {memory_kib}; ulimit -c 0; exec \"$0\" \"$@\"");
    command
        .args(["-c", &limit])
        .arg(program(name))
        .current_dir(bench.at("in"))
        .env("RUST_BACKTRACE", "0")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn end(mut child: Child, line: &str) -> Output {
    let begun = Instant::now();
    while child.try_wait().expect("a child").is_none() {
        if begun.elapsed() > LONGEST {
            let _ = child.kill();
            panic!("{line}: it goes on without an end");
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    child.wait_with_output().expect("a child")
}

/// Status 1 and one line.
fn refused(output: &Output, line: &str) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(
        output.status.code(),
        Some(1),
        "{line}: {}: {said}",
        output.status
    );
    // A node tells its counts as well.
    let is_node = line.contains("--loopback");
    assert!(is_node || said.lines().count() == 1, "{line}: {said}");
    said
}

#[test]
fn inputs_without_an_end_are_refused() {
    let bench = Bench::new();
    let hub = bench.at("in/zeros");
    std::fs::create_dir(&hub).unwrap();
    for name in ["authority-key.pem", "ca.pem", "access.toml"] {
        symlink("/dev/zero", hub.join(name)).unwrap();
    }
    symlink("/dev/zero", bench.at("in/zero.yaml")).unwrap();
    symlink("/dev/zero", bench.at("in/zero.onnx")).unwrap();
    symlink("/dev/zero", bench.at("in/zero.stream")).unwrap();
    symlink("/dev/urandom", bench.at("in/noise.eecvs")).unwrap();
    symlink("/dev/zero", bench.at("in/zero.json5")).unwrap();
    std::fs::create_dir(bench.at("in/bag")).unwrap();
    symlink("/dev/zero", bench.at("in/bag/metadata.yaml")).unwrap();
    std::fs::create_dir(bench.at("in/folder.toml")).unwrap();
    for (name, line) in [
        ("eecvs", "info /dev/zero"),
        ("eecvs", "info /dev/urandom"),
        ("eecvs", "info bag"),
        ("eecvs", "info /proc/self/mem"),
        ("eecvs", "info /proc/self/maps"),
        ("eecvs", "inspect /dev/zero"),
        ("eecvs", "inspect noise.eecvs"),
        ("eecvs", "decode /dev/zero -o OUT.csv"),
        ("eecvs", "monitor /dev/zero"),
        ("eecvs", "view /dev/zero -o OUT.gif"),
        ("eecvs", "split /dev/zero -o OUT"),
        ("eecvs", "calibrate /dev/zero -o OUT.toml"),
        ("eecvs", "compare scene.raw /dev/zero"),
        ("eecvs", "convert /dev/zero OUT.csv"),
        ("eecvs", "encode /dev/zero -o OUT.eecvs"),
        (
            "eecvs",
            "encode scene.raw -o OUT.eecvs --hot-pixels /dev/zero",
        ),
        ("eecvs", "encode scene.raw -o OUT.eecvs --hot-pixels ."),
        (
            "eecvs",
            "encode scene.raw -o OUT.eecvs --thresholds /dev/zero",
        ),
        (
            "eecvs",
            "encode scene.raw -o OUT.eecvs --thresholds folder.toml",
        ),
        ("eecvs", "monitor scene.raw --thresholds /dev/full"),
        ("eecvs", "mcu --image /dev/zero"),
        (
            "eecvs-usb",
            "capture --device replay:zero.stream -o OUT.raw",
        ),
        (
            "eecvs-usb",
            "capture --device sim:dvs128:/dev/zero -o OUT.raw",
        ),
        (
            "eecvs-ros",
            "emulate --recording /dev/zero --loopback --domain-id 93",
        ),
        ("eecvs-ros", "play bag --loopback --domain-id 93"),
        ("eecvs-ros", "router --zenoh-config zero.json5"),
        ("eecvs-hub", "keys zeros sensor door"),
    ] {
        let output = run(&bench, name, line, MEMORY_KIB);
        let said = refused(&output, line);
        assert!(said.starts_with(name), "{said}");
    }
    let line = "encode --loopback --domain-id 93 --ros-args --params-file zero.yaml";
    let output = run(&bench, "eecvs-ros", line, MEMORY_KIB);
    assert_eq!(output.status.code(), Some(2), "{line}: {output:?}");
    // A pipe whose writer never ends; noise behind an empty line, as in text.
    for (line, endless) in [
        ("info -", "exec cat /dev/zero"),
        ("info -", "echo; exec cat /dev/urandom"),
        ("inspect -", "exec cat /dev/zero"),
        ("encode - -o OUT.eecvs", "exec cat /dev/zero"),
        ("convert - OUT.csv", "echo 1,2; exec cat /dev/urandom"),
    ] {
        let mut endless = Command::new("sh")
            .args(["-c", endless])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut command = limited(&bench, "eecvs", MEMORY_KIB);
        let command = command
            .args(line.split(' '))
            .stdin(endless.stdout.take().unwrap());
        refused(&end(command.spawn().unwrap(), line), line);
        endless.kill().unwrap();
        endless.wait().unwrap();
    }
    for name in ["OUT.csv", "OUT.eecvs", "OUT.raw", "OUT.gif", "OUT.toml"] {
        assert!(!bench.at("in").join(name).exists(), "{name}");
    }
}

/// The least memory, to 2 MiB, with which a command succeeds on a small input.
fn least_kib(bench: &Bench, line: &str) -> u64 {
    let (mut refused, mut enough) = (8 << 10, 2 << 20);
    while enough - refused > 2 << 10 {
        let between = (refused + enough) / 2;
        // Far too little may stop a thread of the library for parallel work before it begins.
        let mut command = limited(bench, "eecvs", between);
        let mut child = command.args(line.split(' ')).spawn().expect("a program");
        let begun = Instant::now();
        let status = loop {
            match child.try_wait().expect("a child") {
                None if begun.elapsed() < SHORTLY => std::thread::sleep(Duration::from_millis(2)),
                status => break status,
            }
        };
        let _ = child.kill();
        let _ = child.wait();
        match status.is_some_and(|status| status.success()) {
            true => enough = between,
            false => refused = between,
        }
    }
    enough
}

/// What an input asks for is refused with a message: with as much memory as the same command takes for a small input, and
/// a little more, none is aborted.
#[test]
fn memory_that_an_input_asks_for_may_be_refused() {
    let bench = Bench::new();
    let at = |name: &str| bench.at("in").join(name);
    std::fs::write(at("small.csv"), "1,0,0,1\n2000,9,9,0\n40000,5,5,1\n").unwrap();
    std::fs::write(at("big.csv"), "1,0,0,1\n2000,2047,2047,0\n40000,5,5,1\n").unwrap();
    for name in ["small", "big"] {
        let line = format!("encode {name}.csv -o {name}.eecvs --mode transform --transform dct");
        assert!(run(&bench, "eecvs", &line, MEMORY_KIB).status.success());
    }
    // A packet of 64 MiB, as its header says: the file has as many bytes, nearly all of them holes.
    let size = 1_u32 << 26;
    let mut packet = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#!END-HEADER\r\n".to_vec();
    packet.extend([1, 0, 1, 0]);
    let count = size / 8 - 4;
    for field in [8, 4, 0, count, count, count] {
        packet.extend(field.to_le_bytes());
    }
    std::fs::write(at("packet.aedat"), &packet).unwrap();
    let file = std::fs::File::options()
        .write(true)
        .open(at("packet.aedat"))
        .unwrap();
    file.set_len(u64::from(size) + 1000).unwrap();
    let mut refused_by_memory = 0;
    for (small, big) in [
        ("info small.csv", "info packet.aedat"),
        (
            "encode small.csv -o x.eecvs --threads 1 --overwrite",
            "encode big.csv -o x.eecvs --threads 1 --overwrite",
        ),
        ("compare small.csv small.csv", "compare big.csv big.csv"),
        (
            "view small.csv -o x.png --overwrite",
            "view big.csv -o x.png --overwrite",
        ),
        (
            "decode small.eecvs -o x.csv --volume x.npy --overwrite",
            "decode big.eecvs -o x.csv --volume x.npy --overwrite",
        ),
    ] {
        let least = least_kib(&bench, small);
        for more_kib in [2 << 10, 8 << 10, 24 << 10] {
            let output = run(&bench, "eecvs", big, least + more_kib);
            let said = String::from_utf8_lossy(&output.stderr);
            let status = output.status.code();
            assert!(
                matches!(status, Some(0 | 1)),
                "{big}, {more_kib} KiB more: {status:?}: {said}"
            );
            if status == Some(1) && said.contains("the system refuses") {
                refused_by_memory += 1;
            }
        }
    }
    assert!(refused_by_memory >= 8, "{refused_by_memory}");
}

/// Endings of the formats whose files [`sizes_in_headers_are_refused_or_read`] changes, and the lengths of their headers
/// that the usual tests go over.
const HEADERS: [(&str, usize); 21] = [
    ("aedat4", 200),
    ("arrow", 200),
    ("arrows", 200),
    ("bag", 200),
    ("bin", 40),
    ("csv", 40),
    ("dat", 120),
    ("db3", 200),
    ("eecvs", 80),
    ("es", 80),
    ("evt2", 120),
    ("evt21", 120),
    ("evt4", 120),
    ("h5", 200),
    ("mat", 200),
    ("mcap", 200),
    ("npy", 160),
    ("npz", 120),
    ("parquet", 80),
    ("raw", 120),
    ("aedat", 200),
];

/// Whatever number stands in place of any four bytes of a file's beginning or end, the memory that it asks for is refused
/// with a message where the system has none, and no program is aborted.
#[test]
fn sizes_in_headers_are_refused_or_read() {
    let bench = Bench::new();
    let at = |name: &str| bench.at("in").join(name);
    for (line, name) in [
        (
            "emulate motorcycle -o small.aedat --width 128 --height 128 --duration-us 20000",
            "aedat",
        ),
        (
            "emulate motorcycle -o small.bin --width 34 --height 34 --duration-us 60000",
            "bin",
        ),
        ("encode scene.raw -o small.eecvs", "eecvs"),
    ] {
        let output = run(&bench, "eecvs", line, MEMORY_KIB);
        assert!(output.status.success(), "{name}: {output:?}");
    }
    let (mut refused_by_memory, mut runs) = (0, 0);
    for (ending, header) in HEADERS {
        let small = format!("small.{ending}");
        if !at(&small).exists() {
            let line = format!("convert scene.raw {small}");
            assert!(
                run(&bench, "eecvs", &line, MEMORY_KIB).status.success(),
                "{line}"
            );
        }
        let least = least_kib(&bench, &format!("info {small}"));
        let whole = std::fs::read(at(&small)).unwrap();
        let header = if crate::is_whole() { 4096 } else { header }.min(whole.len() - 4);
        let from_end = whole.len() - 4 - header.min(64);
        let front = (0..header).step_by(4);
        let back = (from_end..whole.len() - 4).step_by(if crate::is_whole() { 1 } else { 4 });
        let changed = format!("changed.{ending}");
        for place in front.chain(back) {
            // 1 GiB, in the order of bytes of the format; a length of 64 bits has it in its lower half.
            let is_big_endian = matches!(ending, "aedat" | "bin" | "db3");
            let size = if is_big_endian {
                0x3FFF_FFF0_u32.to_be_bytes()
            } else {
                0x3FFF_FFF0_u32.to_le_bytes()
            };
            let mut bytes = whole.clone();
            bytes[place..place + 4].copy_from_slice(&size);
            std::fs::write(at(&changed), bytes).unwrap();
            let line = format!("info {changed}");
            let output = run(&bench, "eecvs", &line, least + (16 << 10));
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(
                matches!(output.status.code(), Some(0 | 1)),
                "{ending}, byte {place}: {}: {said}",
                output.status
            );
            assert!(!said.contains("panicked"), "{ending}, byte {place}: {said}");
            refused_by_memory += usize::from(said.contains("the system refuses"));
            runs += 1;
        }
    }
    println!("{runs:>6}  headers, {refused_by_memory} of them refused for want of memory");
    assert!(runs > 500, "{runs}");
}

#[test]
fn names_do_not_reach_a_terminal() {
    let bench = Bench::new();
    let scene = std::fs::read(bench.at("in/scene.raw")).unwrap();
    let frames = std::fs::read(bench.at("in/scene.eecvs")).unwrap();
    // Text that clears the screen, by one character too; a new line; and what turns the direction.
    for evil in [
        "a\x1b[2Jb",
        "a\u{9b}2Jb",
        "a\neecvs: done",
        "a\u{202e}b",
        "a\rb",
    ] {
        let raw = format!("{evil}.raw");
        let [eecvs, cut, toml, csv] =
            ["eecvs", "cut.eecvs", "toml", "csv"].map(|end| format!("{evil}.{end}"));
        let at = |name: &str| bench.at("in").join(name);
        std::fs::write(at(&raw), &scene).unwrap();
        std::fs::write(at(&eecvs), &frames).unwrap();
        std::fs::write(at(&cut), &frames[..frames.len() / 2]).unwrap();
        std::fs::write(at(&toml), "?").unwrap();
        let new = format!("new-{evil}");
        let lines: [(&str, &[&str]); 16] = [
            ("eecvs", &["info", &raw]),
            ("eecvs", &["info", &raw, "--json"]),
            ("eecvs", &["info", evil]),
            ("eecvs", &["inspect", &cut]),
            ("eecvs", &["decode", &cut, "-o", &csv]),
            ("eecvs", &["decode", &cut, "-o", &csv, "--json"]),
            ("eecvs", &["encode", &raw, "-o", &eecvs]),
            ("eecvs", &["encode", &raw, "-o", &eecvs, "--overwrite"]),
            (
                "eecvs",
                &["calibrate", &raw, "-o", &toml, "--overwrite", "--json"],
            ),
            ("eecvs", &["monitor", &raw, "--thresholds", &toml]),
            ("eecvs", &["split", &eecvs, "-o", &new]),
            ("eecvs", &[evil]),
            ("eecvs", &["info", &raw, evil]),
            ("eecvs-usb", &["capture", "--device", evil, "-o", &raw]),
            ("eecvs-hub", &["keys", &toml, "sensor", "door"]),
            (
                "eecvs-ros",
                &["play", evil, "--loopback", "--domain-id", "93"],
            ),
        ];
        for (name, arguments) in lines {
            let mut command = limited(&bench, name, u64::MAX >> 12);
            let child = command.args(arguments).spawn().unwrap();
            let output = end(child, evil);
            assert_eq!(output.status.signal(), None, "{arguments:?}");
            let all = [&output.stdout[..], &output.stderr].concat();
            let text = String::from_utf8(all).unwrap();
            assert!(!text.is_empty(), "{arguments:?}");
            let bad = |c: char| {
                c.is_control() && c != '\n' && c != '\t' || ('\u{202a}'..='\u{202e}').contains(&c)
            };
            assert!(!text.contains(bad), "{arguments:?}: {text:?}");
            assert!(
                !text.lines().any(|line| line == "eecvs: done"),
                "{arguments:?}: {text}"
            );
            if arguments.contains(&"--json") && output.status.success() {
                let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
                // The name itself, where it is among the keys.
                let named = json.get("output").and_then(serde_json::Value::as_str);
                assert!(named.is_none_or(|named| named.starts_with(evil)), "{json}");
            }
        }
    }
}
