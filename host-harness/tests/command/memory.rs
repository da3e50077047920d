//! Memory of conversions: bounded, whatever the length of the recording and however slow its output.

use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::process::{Child, Stdio};
use std::thread::sleep;
use std::time::Duration;

use crate::support::Folder;

/// Most memory of a conversion, in KiB: 64 MB.
const MOST_KIB: u64 = 64_000_000 / 1024;
/// What twelve times as many events may add, in KiB: tables of blocks, not the events, which would be 16 bytes each.
const GROWTH_KIB: u64 = 10_000;
const SHORT: u64 = 300_000;
const LONG: u64 = 12 * SHORT;

/// Writes a DAT recording of events at random places.
fn recording(folder: &Folder, name: &str, events: u64) {
    let mut file = BufWriter::new(File::create(folder.path(name)).expect("a file"));
    file.write_all(b"% Version 2\n% Width 640\n% Height 480\n\x0c\x08")
        .expect("room");
    let mut state = 1_u64;
    for event in 0..events {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let (x, y, p) = (state >> 33 & 511, (state >> 43) % 480, state >> 62 & 1);
        let word = (event * 2) | x << 32 | y << 46 | p << 60;
        file.write_all(&word.to_le_bytes()).expect("room");
    }
    file.flush().expect("room");
}

/// The most memory of a process so far, in KiB; `None` once it has ended.
fn most_kib(child: &Child) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix(" kB")?.parse().ok()
}

/// Runs a command to its end, and returns the most memory that it had, in KiB.
fn memory(folder: &Folder, line: &str) -> u64 {
    let arguments: Vec<&str> = line.split_whitespace().collect();
    let mut command = folder.command(&arguments);
    let mut child = command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts");
    let mut most = 0;
    loop {
        most = most.max(most_kib(&child).unwrap_or(0));
        if let Some(status) = child.try_wait().expect("a child") {
            assert!(status.success(), "eecvs {line}: {status}");
            return most;
        }
        sleep(Duration::from_millis(1));
    }
}

#[test]
fn does_not_grow_with_the_recording() {
    let folder = Folder::new();
    recording(&folder, "short.dat", SHORT);
    recording(&folder, "long.dat", LONG);
    for line in [
        "info IN",
        "convert IN OUT.dat",
        "convert IN OUT.raw",
        "convert IN OUT.csv",
        "convert IN OUT.aedat4",
        "convert IN OUT.npz",
        "convert IN OUT.h5",
        "convert IN OUT.parquet",
        "convert IN OUT.mcap",
        "encode IN -o OUT.eecvs --coder quick --threads 1",
        "convert OUT.eecvs OUT-2.dat",
        "convert OUT.npz OUT-3.dat",
        "convert OUT.h5 OUT-4.dat",
        "convert OUT.parquet OUT-5.dat",
        "convert OUT.csv OUT-6.dat",
    ] {
        let [short, long] = ["short", "long"].map(|name| {
            let line = line
                .replace("IN", &format!("{name}.dat"))
                .replace("OUT", &format!("{name}-out"));
            memory(&folder, &line)
        });
        println!("{line}: {short} KiB, {long} KiB");
        assert!(short > 0 && long <= MOST_KIB, "{line}: {long} KiB");
        assert!(
            long <= short + GROWTH_KIB,
            "{line}: {short} KiB, {long} KiB"
        );
    }
}

#[test]
fn does_not_grow_with_the_frames_of_the_truth() {
    let folder = Folder::new();
    let [short, long] = [50_000, 1_500_000].map(|duration_us| {
        memory(
            &folder,
            &format!(
                "emulate outdoor-dark-blur -o a.raw --truth a.npz --truth-fps 2000 --model 2 --threads 1 --width 64 --height 48 \
                 --duration-us {duration_us} --overwrite"
            ),
        )
    });
    println!("{short} KiB, {long} KiB");
    // All flow would be 74 MB more.
    assert!(
        short > 0 && long <= short + GROWTH_KIB,
        "{short} KiB, {long} KiB"
    );
}

#[test]
fn does_not_grow_while_nobody_takes_the_output() {
    let folder = Folder::new();
    recording(&folder, "long.dat", LONG);
    for line in [
        "convert long.dat - --format dat",
        "convert long.dat - --format csv",
        "encode long.dat -o - --coder quick",
    ] {
        let arguments: Vec<&str> = line.split_whitespace().collect();
        let mut command = folder.command(&arguments);
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        // The pipe is full long before.
        sleep(Duration::from_millis(700));
        let most = most_kib(&child);
        let mut out = child.stdout.take().expect("a pipe");
        let bytes = std::io::copy(&mut out.by_ref(), &mut std::io::sink()).expect("a pipe");
        assert!(child.wait().expect("a child").success(), "eecvs {line}");
        println!("{line}: {most:?} KiB, {bytes} bytes");
        let most = most.expect("it waits for its pipe");
        assert!(bytes > 1 << 20 && most <= MOST_KIB, "{line}: {most} KiB");
    }
}
