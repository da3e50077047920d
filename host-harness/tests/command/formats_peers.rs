//! Formats against independent decoders, by the scripts in tests/peers: random events from each writer to each
//! reader, and the shared recordings by both.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

#[path = "../../../tests/peers/script.rs"]
mod peers;

const SHARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");

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
    let command = env!("CARGO_BIN_EXE_eecvs").into();
    let recordings = recordings(names).into_iter().map(PathBuf::into_os_string);
    let arguments: Vec<OsString> = std::iter::once(command).chain(recordings).collect();
    peers::compare(script, &arguments);
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
