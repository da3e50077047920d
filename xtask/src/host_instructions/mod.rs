//! The instructions of the host's encoder, decoder and readers, counted by Valgrind: the same in every run, and on every
//! x86-64 processor.
//!
//! Callgrind collects inside one function (`count_these`) and writes a file each time that it returns, so one process
//! runs all cases, and neither their preparation nor its own start counts. Nothing is linked in for that: no client
//! requests, which need C headers of Valgrind, a C compiler and libclang, and no harness whose runner has to be
//! installed in the same version.

mod callgrind;
mod cases;
mod counts;

use std::path::Path;
use std::process::ExitCode;

use anyhow::Result;

use crate::saved::Action;
use crate::tree;
use counts::Counts;

/// Status of a check that could not compare, as test harnesses have it.
const SKIPPED: u8 = 77;

/// The counts that are committed.
const SAVED: &str = "host-harness/instructions.json";

/// Counts, and prints, saves or compares: status 77 if the saved counts are of another compiler or target.
pub fn run(action: Action) -> Result<ExitCode> {
    let counts = callgrind::measure()?;
    print!("{counts}");
    let saved = tree::path(SAVED);
    if action.save {
        counts.write(&saved)?;
    }
    if action.check {
        let saved = Counts::read(&saved)?;
        if let Some(difference) = counts.difference(&saved) {
            println!("skipped: {difference}");
            return Ok(ExitCode::from(SKIPPED));
        }
        let failures = counts.failures(&saved);
        for failure in &failures {
            println!("FAILED {failure}");
        }
        println!(
            "{} cases compared, {} failures (a case may grow by {} %)",
            saved.cases.len(),
            failures.len(),
            counts::TOLERANCE_PERCENT
        );
        if !failures.is_empty() {
            return Ok(ExitCode::FAILURE);
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// What is counted: this program calls itself so.
pub fn run_cases(folder: &Path) -> Result<ExitCode> {
    one_core();
    cases::run(folder)?;
    Ok(ExitCode::SUCCESS)
}

/// Stays on one core, where writers of compressed files have no threads of their own: what these do would not count.
fn one_core() {
    #[cfg(target_os = "linux")]
    {
        use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

        if let Ok(allowed) = sched_getaffinity(None)
            && let Some(first) = (0..CpuSet::MAX_CPU).find(|core| allowed.is_set(*core))
        {
            let mut one = CpuSet::new();
            one.set(first);
            // On a system that refuses, the counts are others than those saved.
            let _ = sched_setaffinity(None, &one);
        }
    }
}
