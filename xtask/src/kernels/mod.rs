//! The instructions of every kernel of the accumulate stage on a Cortex-M4 and a Cortex-M7 in QEMU.
//!
//! The cuts are those of the stages' counts; the sums of every kernel are compared with this host's.

mod compare;
mod document;
mod file;
mod table;

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result};
use eecvs_bench::cut::{self, Cut};
use eecvs_bench::kernel_image::Images;
use eecvs_bench::mcu::Count;
use eecvs_bench::{Effort, Origin, windows};

use crate::saved::Action;
use crate::tree;

/// The counts that are committed, and the document that shows them.
const SAVED: &str = "firmware/kernels.json";
const DOCUMENT: &str = "docs/results.md";

/// Counts, and prints, saves or compares.
pub fn run(action: Action) -> Result<ExitCode> {
    let mut counts = count(&tree::shared_data())?;
    let folder = tree::path("firmware/target");
    std::fs::create_dir_all(&folder).context("firmware/target")?;
    file::write(&counts, &folder.join("kernels.json"))?;
    let saved = tree::path(SAVED);
    if action.check {
        let comparison = compare::compare(&counts, &file::read(&saved)?);
        print!("{comparison}");
        if comparison.has_failed() {
            return Ok(ExitCode::FAILURE);
        }
        return Ok(ExitCode::SUCCESS);
    }
    print!("{}", table::table(&counts));
    if action.save {
        for origin in file::keep_uncounted(&mut counts, file::read(&saved)?) {
            println!("no cuts from {origin} here: their saved counts stay as they were");
        }
        file::write(&counts, &saved)?;
        document::write(&counts, &tree::path(DOCUMENT))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Builds the images and runs them on every cut that is there.
fn count(recordings: &Path) -> Result<Vec<Count>> {
    let mut origins: Vec<(Origin, Vec<Cut>)> = Vec::new();
    if cut::recordings().all(|(_, file)| recordings.join(file).exists()) {
        origins.push((Origin::Recordings, cut::of_recordings(recordings)?));
    } else {
        println!("no recordings, so no cuts of them");
    }
    origins.push((Origin::Emulator, cut::of_scenes()?));
    let images = Images::build()?;
    let mut counts = Vec::new();
    for (origin, cuts) in &origins {
        counts.extend(images.count(&windows(cuts, Effort::FULL)?, *origin)?);
    }
    Ok(counts)
}
