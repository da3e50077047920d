//! The encoder's image on the core of every emulated machine, against the host's encoder: are the frames the same, and how
//! many instructions does an event take?

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, ensure};
use eecvs_bench::marks::Marks;
use mcu_link::qemu::Machine;
use serde::Deserialize;

use crate::tree;

const MARKS: Marks = Marks {
    name: "cores",
    command: "cargo xtask cores --save",
};
const DOCUMENT: &str = "docs/boards.md";

/// Each core once, by the machine that has it.
const CORES: [(&str, Machine); 6] = [
    ("Cortex-M0+", Machine::Mps2An385M0),
    ("Cortex-M3", Machine::Mps2An385),
    ("Cortex-M4", Machine::Mps2An386),
    ("Cortex-M7", Machine::Mps2An500),
    ("Cortex-M33", Machine::Mps2An505),
    ("Cortex-M55", Machine::Mps3An547),
];

const MODES: [(&str, &[&str]); 5] = [
    ("fast", &["--coder", "fast"]),
    ("quick", &["--coder", "quick"]),
    ("dense", &["--coder", "dense"]),
    (
        "DCT, M = 8",
        &["--mode", "transform", "--transform", "dct", "-m", "8"],
    ),
    (
        "Haar, M = 8",
        &["--mode", "transform", "--transform", "dwt", "-m", "8"],
    ),
];

/// What of `eecvs mcu --json` is compared and shown.
#[derive(Debug, Deserialize)]
struct Run {
    events: u64,
    events_encoded: u64,
    events_lost: u64,
    frames: u64,
    frames_identical: u64,
    encode_instructions_per_event: f64,
}

/// Runs a scene in every mode on every core by a command `eecvs`, which is built unless it is given; prints the table, and
/// writes it into the document if it is to be saved.
pub fn run(save: bool, eecvs: Option<PathBuf>) -> Result<ExitCode> {
    let eecvs = match eecvs {
        Some(eecvs) => eecvs,
        None => tree::eecvs(&[])?,
    };
    let mut table = String::from("| instructions an event, encoding |");
    for (name, _) in MODES {
        let _ = write!(table, " {name} |");
    }
    table += "\n|---|";
    table += &"---|".repeat(MODES.len());
    table += "\n";
    for (core, machine) in CORES {
        let _ = write!(table, "| {core}, `{}` |", machine.name());
        for (name, mode) in MODES {
            let run = compare(&eecvs, machine, mode).with_context(|| format!("{core}, {name}"))?;
            let _ = write!(table, " {:.0} |", run.encode_instructions_per_event);
        }
        table += "\n";
    }
    print!("{table}");
    if save {
        MARKS.write(&tree::path(DOCUMENT), &table)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Runs the scene, whose frames have to be this host's and whose events all have to be in them.
fn compare(eecvs: &Path, machine: Machine, mode: &[&str]) -> Result<Run> {
    let mut command = tree::command(eecvs);
    command
        .arg("mcu")
        .args(mode)
        .args(["--machine", machine.name(), "--json"]);
    let output = command.output()?;
    ensure!(
        output.status.success(),
        "{}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr).trim_end()
    );
    let run: Run = serde_json::from_slice(&output.stdout)?;
    ensure!(
        run.frames > 0 && run.frames_identical == run.frames && run.events_lost == 0,
        "{run:?}"
    );
    ensure!(run.events_encoded == run.events, "{run:?}");
    Ok(run)
}
