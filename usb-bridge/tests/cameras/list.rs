//! `eecvs-usb` as it is called: usage, and `list` on whatever machine this is.

use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_eecvs-usb"))
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn bad_usage_exits_with_2() {
    assert_eq!(run(&[]).status.code(), Some(2));
    assert_eq!(run(&["list", "--no-such-flag"]).status.code(), Some(2));
    assert_eq!(run(&["no-such-command"]).status.code(), Some(2));
}

#[test]
fn a_list_is_printed_with_devices_or_without() {
    let output = run(&["list"]);
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text == "No known camera or MCU is attached.\n" || text.starts_with("ID "),
        "{text}"
    );
    let output = run(&["list", "--json"]);
    assert!(output.status.success(), "{output:?}");
    let rows: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for row in rows.as_array().unwrap() {
        assert!(row["id"].as_str().unwrap().starts_with("usb:"));
        assert!(row["speed"].is_string() && row["use"].is_string());
    }
}

/// Arguments that are not UTF-8 are values like others, or are refused.
#[cfg(unix)]
#[test]
fn arguments_may_be_of_any_bytes() {
    use std::os::unix::ffi::OsStrExt as _;
    let bad = std::ffi::OsStr::from_bytes(b"a\xff");
    let replayed = std::ffi::OsStr::from_bytes(b"replay:a\xff.stream");
    for arguments in [
        vec!["list"],
        vec!["capture", "--device"],
        vec!["capture", "--rate"],
        vec!["capture"],
        vec!["capture", "-o"],
        vec!["forward", "--to"],
        vec!["receive"],
        vec!["mcu"],
        vec!["simulate"],
        vec![],
    ] {
        for value in [bad, replayed] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs-usb"));
            let output = command.args(&arguments).arg(value).output().unwrap();
            let said = String::from_utf8_lossy(&output.stderr);
            let status = output.status.code();
            assert!(
                matches!(status, Some(1 | 2)),
                "{arguments:?}: {status:?}: {said}"
            );
            assert!(
                !said.is_empty() && !said.contains("panicked"),
                "{arguments:?}: {said}"
            );
        }
    }
}
