//! Arguments that cannot be used end the program with status 2 and a message, before it does anything.

use std::ffi::OsString;
use std::process::Command;
use std::time::Duration;

use crate::program::Program;

/// Runs `eecvs-ros`, which ends at once; what it says.
fn refused(arguments: &[OsString]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs-ros"));
    command.args(arguments);
    let program = Program::start("eecvs-ros", 97, command);
    let (out, said) = program.ends_with(2, Duration::from_secs(20));
    assert!(out.is_empty(), "{out}");
    assert!(!said.contains("panicked"), "{said}");
    said
}

fn words(line: &str) -> Vec<OsString> {
    line.split_whitespace().map(OsString::from).collect()
}

#[test]
fn parameters_have_types_and_ranges() {
    for (line, why) in [
        (
            "-p window_us:='8000'",
            "{window_us} is of type {integer}, setting it to {string}",
        ),
        (
            "-p window_us:=8000.0",
            "{window_us} is of type {integer}, setting it to {double}",
        ),
        ("-p window_us:=0", "invalid value '0' for '--window-us <T>'"),
        (
            "-p max_error:=1",
            "{max_error} is of type {double}, setting it to {integer}",
        ),
        (
            "-p coder:=huffman",
            "[possible values: plain, fast, quick, dense]",
        ),
        ("-p keep_order:=1", "{keep_order} is of type {bool}"),
        ("-p depth:=0", "0 is not in 1..=1000000"),
        ("-p window:=5", "no node here has the parameter window"),
        (
            "-p encode:window:=5",
            "'window' was not declared by /event_camera/encode",
        ),
        ("-p time_tolerance_us:=5 -p bins:=5", "cannot be used with"),
        ("-p window_us", "expected NAME:=VALUE"),
    ] {
        for command in ["encode", "compose encode"] {
            let said = refused(&words(&format!("{command} --ros-args {line}")));
            assert!(said.contains(why), "{line}: {said}");
        }
    }
}

#[test]
fn sim_time_is_refused_in_every_form() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.yaml");
    for node in ["/**", "/event_camera/encode", "encode"] {
        let yaml = format!("{node}: {{ros__parameters: {{use_sim_time: true}}}}");
        std::fs::write(&file, yaml).unwrap();
        let line = format!("encode --ros-args --params-file {}", file.display());
        let said = refused(&words(&line));
        assert!(said.contains("the computer's clock"), "{said}");
    }
    for line in [
        "encode --ros-args -p use_sim_time:=true",
        "encode --ros-args -p encode:use_sim_time:=true",
        "compose encode decode --ros-args -p decode:use_sim_time:=true",
        "router --ros-args -p use_sim_time:=true",
    ] {
        let said = refused(&words(line));
        assert!(said.contains("the computer's clock"), "{line}: {said}");
    }
    let said = refused(&words("encode --ros-args -p use_sim_time:=1"));
    assert!(said.contains("{use_sim_time} is of type {bool}"), "{said}");
    let said = refused(&words("encode --use-sim-time"));
    assert!(said.contains("--use-sim-time"), "{said}");
}

#[cfg(unix)]
#[test]
fn arguments_may_be_of_any_bytes() {
    use std::os::unix::ffi::OsStringExt as _;
    let bad = || OsString::from_vec(b"a\xff".to_vec());
    let with = |line: &str, rest: &[OsString]| [words(line), rest.to_vec()].concat();
    for line in [
        with("", &[bad()]),
        with("encode", &[bad()]),
        with("encode --coder", &[bad()]),
        with("compose", &[bad()]),
        with("encode --ros-args -p", &[bad()]),
        with("encode --ros-args -r", &[bad()]),
        with("encode --ros-args", &[bad()]),
        with("encode --ros-args --params-file", &[bad()]),
    ] {
        let said = refused(&line);
        assert!(!said.is_empty(), "{line:?}");
    }
    // A file's name may be so.
    let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs-ros"));
    command.arg("play").arg(bad());
    let program = Program::start("eecvs-ros", 97, command);
    let (_, said) = program.ends_with(1, Duration::from_secs(20));
    assert!(said.contains("cannot be read"), "{said}");
}
