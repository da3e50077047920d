//! The instructions of every stage on a Cortex-M4 in QEMU.
//!
//! The windows are cut from the recordings in `../shared/data`, if they are there, and always from emulated scenes;
//! counts of the two are kept and compared apart. The image's frames are compared with this host's, bit for bit.

mod counts;
mod cuts;
mod document;
mod verify;

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result};
use mcu_link::image;
use mcu_link::qemu::{self, Machine};

use crate::saved::Action;
use crate::tree;
use counts::Counts;

const PROGRAM: &str = "instructions";
const MACHINE: Machine = Machine::NetduinoPlus2;
/// How long the image may take.
const PATIENCE: Duration = Duration::from_secs(300);
/// The counts that are committed, and the document that shows them.
const SAVED: &str = "firmware/instructions.json";
const DOCUMENT: &str = "docs/results.md";

/// Counts, and prints, saves or compares. Without an action it also counts what plain Rust takes, in an image without
/// the core's assembly.
pub fn run(action: Action) -> Result<ExitCode> {
    qemu::find()?;
    let target = tree::path("firmware/target");
    let folder = target.join("cuts");
    let recordings = tree::shared_data();
    cuts::write(&folder, recordings.exists().then_some(&recordings))?;
    let counts = target.join("instructions.json");
    count(&image::build(MACHINE, PROGRAM)?, &counts)?;
    let mut counts = Counts::read(&counts)?;
    for run in counts.runs() {
        verify::verify(run, &folder)?;
    }
    print!("{}", counts.table());
    let saved = tree::path(SAVED);
    if action.check {
        let comparison = counts.compare(&Counts::read(&saved)?);
        print!("{comparison}");
        if comparison.has_failed() {
            return Ok(ExitCode::FAILURE);
        }
    } else if action.save {
        for origin in counts.keep_unmeasured(Counts::read(&saved)?) {
            println!("no cuts from {origin} here: their saved counts stay as they were");
        }
        counts.write(&saved)?;
        document::write(&counts, &tree::path(DOCUMENT))?;
    } else {
        let portable = target.join("instructions-portable.json");
        count(&image::build_portable(MACHINE, PROGRAM)?, &portable)?;
        print!("{}", counts.beside(&Counts::read(&portable)?)?);
    }
    Ok(ExitCode::SUCCESS)
}

/// Runs an image, whose lines are the counts.
fn count(image: &Path, to: &Path) -> Result<()> {
    let folder = tempfile::tempdir().context("cannot create a folder to run QEMU in")?;
    let text = qemu::run(MACHINE, image, folder.path(), PATIENCE)?;
    Ok(event_files::output::write(to, text)?)
}
