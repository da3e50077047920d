//! Events per second that recordings are converted with, here and by other libraries.
//!
//! `eecvs bench --pipelines` beside faery, expelliarmus and dv-processing, as Python gives them; tests/peers/pipelines.py
//! says how. It needs python3 with venv, the network for the packages, and a machine that does nothing else.

use std::path::Path;
use std::process::ExitCode;

use anyhow::Result;

use crate::{read_speed, tree};

const PACKAGES: [&str; 4] = [
    "numpy",
    "faery==0.7.1",
    "expelliarmus==1.1.12",
    "dv-processing",
];

/// The recording that is repeated.
const RECORDING: &str = "imx636_sparse_evt3/evt3.raw";

/// Measures, and writes the rows into `record` as well.
pub fn run(record: Option<&Path>, rounds: u32) -> Result<ExitCode> {
    let work = tree::target().join("pipelines");
    std::fs::create_dir_all(&work)?;
    let python = read_speed::python(&work, &PACKAGES)?;
    let mut measure = tree::command(&python);
    measure.arg("tests/peers/pipelines.py");
    measure.arg(tree::eecvs(&[])?);
    measure.arg(tree::shared_data().join(RECORDING)).arg(work);
    measure.args(["--rounds", &rounds.to_string()]);
    if let Some(record) = record {
        measure.arg("--record").arg(std::path::absolute(record)?);
    }
    tree::status(&mut measure)
}
