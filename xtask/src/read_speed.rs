//! Events per second that recordings are read with, here and by other libraries.
//!
//! `eecvs bench --read` beside faery, aedat, expelliarmus and evt3, as Python gives them: whole arrays, converted no
//! further. All run on one and the same processor, one after the other in every round, and the best of all rounds
//! counts. The files are the shared recordings, and two of them repeated to some 12 million events in each format. It
//! needs python3 with venv, the network for the packages, and a machine that does nothing else.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::thread::available_parallelism;

use anyhow::Result;

use crate::tree;

const PACKAGES: [&str; 5] = [
    "numpy",
    "faery==0.7.1",
    "aedat==2.3.0",
    "expelliarmus==1.1.12",
    "evt3==0.4.1",
];

/// Measures, and writes the rows into `record` as well.
pub fn run(record: Option<&Path>, rounds: u32) -> Result<ExitCode> {
    let work = tree::target().join("read_speed");
    std::fs::create_dir_all(&work)?;
    let python = python(&work, &PACKAGES)?;
    let eecvs = tree::eecvs(&[])?;
    // One processor for everything, threads of the libraries' own included: the last.
    let mut measure = if tree::command("taskset").arg("--version").output().is_ok() {
        let last = available_parallelism().map_or(0, |count| count.get() - 1);
        let mut pinned = tree::command("taskset");
        pinned.args(["-c", &last.to_string()]).arg(&python);
        pinned
    } else {
        tree::command(&python)
    };
    measure.arg("tests/peers/read_speed.py").arg(eecvs);
    measure.arg(tree::shared_data()).arg(work);
    measure.args(["--rounds", &rounds.to_string()]);
    if let Some(record) = record {
        measure.arg("--record").arg(std::path::absolute(record)?);
    }
    tree::status(&mut measure)
}

/// Returns the Python of a virtual environment in `folder`, made if it is not there, with these packages.
pub fn python(folder: &Path, packages: &[&str]) -> Result<PathBuf> {
    let python = folder.join("venv/bin/python");
    if !python.exists() {
        tree::run(
            tree::command("python3")
                .args(["-m", "venv"])
                .arg(folder.join("venv")),
        )?;
    }
    let mut install = tree::command(&python);
    install.args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ]);
    tree::run(install.args(packages))?;
    Ok(python)
}
