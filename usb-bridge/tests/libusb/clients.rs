//! Simulated cameras against the drivers of others, by tests/peers/cameras.py: dv-processing and neuromorphic-drivers open
//! them, unmodified. Which Python is run says the variable `EECVS_PYTHON`, which then must have one of the two.

use std::process::Command;

use crate::counter::Counter;
use crate::umockdev::Mocked;

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/peers/cameras.py");

/// What the script says where none of its packages is there.
const SKIPPED: i32 = 77;

#[test]
fn drivers_of_others_open_every_camera() {
    if Mocked::new(Counter::boxed()).is_none() {
        return;
    }
    let named = std::env::var_os("EECVS_PYTHON");
    let python = named.clone().unwrap_or_else(|| "python3".into());
    let run = Command::new(&python)
        .arg(SCRIPT)
        .arg(env!("CARGO_BIN_EXE_eecvs-usb"))
        .output();
    let run = match run {
        Err(error) if named.is_none() => {
            eprintln!("skipped: {}: {error}", python.display());
            return;
        }
        run => run.expect("the Python that EECVS_PYTHON names"),
    };
    let out = String::from_utf8_lossy(&run.stdout);
    let err = String::from_utf8_lossy(&run.stderr);
    print!("{out}{err}");
    if run.status.code() == Some(SKIPPED) && named.is_none() {
        eprintln!("skipped: this Python has none of the drivers");
        return;
    }
    assert!(run.status.success(), "{}", run.status);
    assert!(
        out.lines().any(|line| line.starts_with("ok ")),
        "nothing was compared"
    );
}
