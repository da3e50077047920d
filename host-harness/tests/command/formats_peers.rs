//! Formats against independent decoders, by the scripts in tests/peers: random events from each writer to each
//! reader, and the shared recordings by both. A script says which of its packages are absent, and is skipped,
//! with a notice, where all are; which Python is run says the variable `EECVS_PYTHON`, which then must have some.

use std::path::{Path, PathBuf};
use std::process::Command;

const SCRIPTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/peers");
const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");

/// What a script says where none of its packages is there.
const SKIPPED: i32 = 77;

/// Shared recordings that are there.
fn recordings(names: &[&str]) -> Vec<PathBuf> {
    let paths = names.iter().map(|name| Path::new(SHARED).join(name));
    let (there, absent): (Vec<_>, Vec<_>) = paths.partition(|path| path.exists());
    for path in absent {
        eprintln!("skipped: {} is absent", path.display());
    }
    there
}

/// Runs a script of tests/peers on recordings beside the random events that it makes.
fn compare(script: &str, names: &[&str]) {
    let named = std::env::var_os("EECVS_PYTHON");
    let python = named.clone().unwrap_or_else(|| "python3".into());
    let run = Command::new(&python)
        .arg(Path::new(SCRIPTS).join(script))
        .arg(env!("CARGO_BIN_EXE_eecvs"))
        .args(recordings(names))
        .output();
    let run = match run {
        Err(error) if named.is_none() => {
            eprintln!("skipped: {script}: {}: {error}", python.display());
            return;
        }
        run => run.expect("the Python that EECVS_PYTHON names"),
    };
    let out = String::from_utf8_lossy(&run.stdout);
    let err = String::from_utf8_lossy(&run.stderr);
    print!("{script}:\n{out}{err}");
    if run.status.code() == Some(SKIPPED) && named.is_none() {
        eprintln!("skipped: {script}: this Python has none of its packages");
        return;
    }
    assert!(run.status.success(), "{script}: {}", run.status);
    assert!(
        out.lines().any(|line| line.starts_with("ok ")),
        "{script}: nothing was compared"
    );
}

#[test]
fn inivation() {
    compare(
        "inivation.py",
        &[
            "davis346_static_sparse/davis346.aedat4",
            "davis346_building_dense/davis.aedat4",
            "dvxl_person_moderate/data_sample.aedat4",
        ],
    );
}

#[test]
fn event_stream() {
    compare(
        "event_stream.py",
        &["es_csv_1ms_grid/dvs.es", "es_csv_1ms_grid/atis.es"],
    );
}

#[test]
fn prophesee() {
    compare(
        "prophesee.py",
        &[
            "gen3_vga_dense_evt2/evt2.raw",
            "imx636_sparse_evt3/evt3.raw",
            "imx636_sparse_dat/gen4.dat",
            "ncars/sample_ncars.dat",
        ],
    );
}

#[test]
fn ros_bags() {
    compare(
        "ros_bags.py",
        &[
            "davis346_static_sparse/davis346.aedat4",
            "gen31_vga_rosbag_moderate/test_events_1.bag",
        ],
    );
}

#[test]
fn mat() {
    compare("mat.py", &["davis346_building_dense/davis.aedat4"]);
}

#[test]
fn nmnist() {
    compare("nmnist.py", &["nmnist/sample_nmnist.bin"]);
}

#[test]
fn tables() {
    compare("tables.py", &["davis346_building_dense/davis.aedat4"]);
}

/// Every writer, on five kinds of events.
#[test]
fn writers() {
    compare("writers.py", &[]);
}
