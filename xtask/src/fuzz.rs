//! Fuzz targets, with stable Rust: without a sanitizer, whose work the compiler's own checks do in safe code.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result, ensure};

use crate::tree;

/// The program of every target `read_FORMAT`.
const READ: &str = "read";

/// A target runs as one unit of code, which is up to three times as fast but takes twice as long to build, from here on.
const LONG_S: u32 = 60;

/// Prints every target.
pub fn list() -> Result<ExitCode> {
    for target in all()? {
        println!("{target}");
    }
    Ok(ExitCode::SUCCESS)
}

/// Runs each target for `seconds`; all targets if none is named.
pub fn run(seconds: u32, targets: &[String]) -> Result<ExitCode> {
    let version = tree::cargo().args(["fuzz", "--version"]).output();
    ensure!(
        version.is_ok_and(|output| output.status.success()),
        "cargo-fuzz is missing: cargo install cargo-fuzz --locked"
    );
    let all: Vec<String> = all()?.into_iter().collect();
    let targets = if targets.is_empty() { &all } else { targets };
    for target in targets {
        ensure!(
            all.contains(target),
            "no target {target}; the targets are: {}",
            all.join(" ")
        );
    }
    let units = if seconds < LONG_S { "16" } else { "1" };
    let folder = tree::path("fuzz");
    fs::create_dir_all(folder.join("artifacts")).context("fuzz/artifacts")?;
    for target in targets {
        println!("== {target}, {seconds} s");
        let corpus = format!("corpus/{target}");
        fs::create_dir_all(folder.join(&corpus)).with_context(|| corpus.clone())?;
        let format = target.strip_prefix("read_");
        let program = format.map_or(target.as_str(), |_| READ);
        let mut fuzz = tree::cargo();
        fuzz.current_dir(&folder);
        fuzz.args([
            "fuzz",
            "run",
            "--sanitizer",
            "none",
            "--codegen-units",
            units,
        ])
        .args([program, &corpus]);
        // The first folder collects new inputs; the second holds the committed seeds.
        let seeds = format!("seeds/{target}");
        if folder.join(&seeds).is_dir() {
            fuzz.arg(&seeds);
        }
        if let Some(format) = format {
            fuzz.env("EECVS_FORMAT", format);
        }
        fuzz.args(["--", &format!("-max_total_time={seconds}")])
            .args(["-max_len=8192", "-rss_limit_mb=1024", "-timeout=10"])
            .arg(format!("-artifact_prefix=artifacts/{target}-"))
            .args(["-verbosity=0", "-print_final_stats=1"]);
        tree::run(&mut fuzz)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The programs of fuzz/, and of `read` one target for every format.
fn all() -> Result<BTreeSet<String>> {
    let mut targets = BTreeSet::new();
    for file in fs::read_dir(tree::path("fuzz/fuzz_targets"))? {
        let name = file?.file_name();
        let name = Path::new(&name).file_stem().unwrap_or_default();
        targets.insert(name.to_string_lossy().into_owned());
    }
    targets.remove(READ);
    // A folder is no file.
    let formats = event_files::FORMATS
        .iter()
        .map(|format| format.name)
        .filter(|name| *name != "rosbag2");
    targets.extend(formats.map(|name| format!("read_{name}")));
    Ok(targets)
}
