//! The records of measurements, and the tables of documents that are made from them.
//!
//! All but the demo, the streams and the long files is measured on the recordings in `../shared/data`, beside the
//! project. Times of a clock (demo, kernels, skips, read-speed, pipelines, ros-delay, hub-load, stream, seek, report) need a machine
//! that does nothing else; all other figures are the same in every run.

use std::path::Path;
use std::process::ExitCode;

use anyhow::Result;
use clap::ValueEnum;

use crate::saved::Action;
use crate::{instructions, kernels, pipelines, read_speed, seek, stream, tree};

/// Where records are.
const RECORD: &str = "host-harness/record";

/// A record and its tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// README.md: every mode on an emulated scene
    Demo,
    /// docs/results.md: run time against error of every kernel on a host
    Kernels,
    /// README.md and METHODOLOGY.md: bits per event, rate and distortion
    Rates,
    /// METHODOLOGY.md: what skipping saves
    Skips,
    /// METHODOLOGY.md: what transforms and events take at equal error; a quarter of an hour
    Selection,
    /// METHODOLOGY.md: what few events as times save
    FewAsTimes,
    /// docs/results.md: a flood on limited links
    RateControl,
    /// docs/results.md: what the order of events costs
    KeepOrder,
    /// docs/paper.md: how exactly event times come back
    ExactTimes,
    /// crates/event-files/README.md; Python's packages come from the network
    ReadSpeed,
    /// crates/event-files/README.md: conversions; Python's packages come from the network
    Pipelines,
    /// eecvs-ros/README.md: delays on ROS 2
    RosDelay,
    /// docs/hub.md: sensors under load
    HubLoad,
    /// docs/paper.md: the paper's evaluation; half an hour
    Report,
    /// docs/results.md: long streams of events; ten minutes
    Stream,
    /// docs/results.md: single milliseconds of long files; a minute, and 4 GB in target
    Seek,
    /// docs/results.md: instructions of every stage on a Cortex-M4
    Instructions,
    /// docs/results.md: instructions of every kernel on microcontrollers
    McuKernels,
}

/// Measures the parts again, all if none is named.
pub fn run(parts: &[Part]) -> Result<ExitCode> {
    let parts = if parts.is_empty() {
        Part::value_variants()
    } else {
        parts
    };
    for part in parts {
        if let Some(value) = part.to_possible_value() {
            println!("=== {}", value.get_name());
        }
        measure(*part)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn measure(part: Part) -> Result<()> {
    let save = Action {
        save: true,
        check: false,
    };
    let file = |name: &str| format!("{RECORD}/{name}.json");
    match part {
        Part::Demo => {
            let demo = ["demo", "--overwrite", "-o", "target/demo"];
            eecvs(&[&demo[..], &["--save", "README.md", "--record", RECORD]].concat())
        }
        Part::Kernels => eecvs(&["bench", "--save", "docs/results.md", "--record", RECORD]),
        Part::Rates => {
            let documents = ["--save", "README.md", "--save", "METHODOLOGY.md"];
            eecvs(&[&["bench", "--rate"], &documents[..], &["--record", RECORD]].concat())
        }
        Part::Skips => {
            let document = ["--save", "METHODOLOGY.md", "--record", RECORD];
            eecvs(&[&["bench", "--skips"], &document[..]].concat())
        }
        Part::Selection => {
            let document = ["--save", "METHODOLOGY.md", "--record", RECORD];
            eecvs(&[&["bench", "--selection"], &document[..]].concat())
        }
        Part::FewAsTimes => {
            let document = ["--save", "METHODOLOGY.md", "--record", RECORD];
            eecvs(&[&["bench", "--few-as-times"], &document[..]].concat())
        }
        Part::RateControl => bless("rate_control::a_flood_fits_its_link"),
        Part::KeepOrder => bless("keep_order::recordings_come_back_in_order"),
        Part::ExactTimes => bless("come_back_with_the_documented_exactness"),
        Part::ReadSpeed => {
            read_speed::run(Some(&tree::path(file("read-speed"))), 5)?;
            sections()
        }
        Part::Pipelines => {
            pipelines::run(Some(&tree::path(file("pipelines"))), 3)?;
            sections()
        }
        Part::RosDelay => {
            let mut script = tree::command(tree::path("eecvs-ros/delay.sh"));
            tree::run(script.args(["--record", &file("ros-delay")]))?;
            sections()
        }
        Part::HubLoad => {
            let mut script = tree::command(tree::path("eecvs-hub/load.sh"));
            tree::run(script.args(["--record", &file("hub-load")]))?;
            sections()
        }
        Part::Report => eecvs(&[
            "report",
            "--overwrite",
            "-o",
            RECORD,
            "--save",
            "docs/paper.md",
        ]),
        Part::Stream => {
            stream::run(stream::EVENTS, Some(Path::new(RECORD)))?;
            sections()
        }
        Part::Seek => {
            seek::run(seek::EVENTS, Some(Path::new(RECORD)))?;
            sections()
        }
        Part::Instructions => instructions::run(save).map(drop),
        Part::McuKernels => kernels::run(save).map(drop),
    }
}

fn eecvs(arguments: &[&str]) -> Result<()> {
    let eecvs = tree::eecvs(&["host-harness/zstd"])?;
    tree::run(tree::command(eecvs).args(arguments))
}

/// Writes the sections of records that another program has written.
fn sections() -> Result<()> {
    let mut test = tree::cargo();
    test.args(["test", "--quiet", "-p", "host-harness", "--lib"]);
    tree::run(
        test.arg("every_section_of_the_documents")
            .env("EECVS_BLESS", "1"),
    )
}

/// Runs a test that writes what it measures in place of comparing it, alone: tests of one document write one file.
fn bless(test: &str) -> Result<()> {
    let mut cargo = tree::cargo();
    cargo.args(["test", "--release", "--quiet", "-p", "eecvs-tests"]);
    cargo.args(["--test", "across", test, "--", "--test-threads=1"]);
    tree::run(cargo.env("EECVS_BLESS", "1"))
}
