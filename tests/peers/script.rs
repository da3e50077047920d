//! Runs a script of this folder. A script says which of its packages are absent, and is skipped, with a notice, where all
//! are; which Python runs it says the variable `EECVS_PYTHON`, which then must have some.

use std::ffi::OsString;
use std::path::Path;
use std::process::Command;

const SCRIPTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/peers");

/// What a script says where none of its packages is there.
const SKIPPED: i32 = 77;

/// What a script prints; `None` where it was skipped.
pub fn run(script: &str, arguments: &[OsString]) -> Option<String> {
    let named = std::env::var_os("EECVS_PYTHON");
    let python = named.clone().unwrap_or_else(|| "python3".into());
    let run = Command::new(&python)
        .arg(Path::new(SCRIPTS).join(script))
        .args(arguments)
        .output();
    let run = match run {
        Err(error) if named.is_none() => {
            eprintln!("skipped: {script}: {}: {error}", python.display());
            return None;
        }
        run => run.expect("the Python that EECVS_PYTHON names"),
    };
    let out = String::from_utf8_lossy(&run.stdout).into_owned();
    let err = String::from_utf8_lossy(&run.stderr);
    print!("{script}:\n{out}{err}");
    if run.status.code() == Some(SKIPPED) && named.is_none() {
        eprintln!("skipped: {script}: this Python has none of its packages");
        return None;
    }
    assert!(run.status.success(), "{script}: {}", run.status);
    Some(out)
}

/// Runs a script that compares; it must have compared something if it was not skipped.
#[allow(dead_code, reason = "a script may print something else")]
pub fn compare(script: &str, arguments: &[OsString]) {
    if let Some(out) = run(script, arguments) {
        assert!(
            out.lines().any(|line| line.starts_with("ok ")),
            "{script}: nothing was compared"
        );
    }
}
