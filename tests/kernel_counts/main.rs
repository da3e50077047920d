//! The instruction counts of every kernel on microcontrollers: counted, shown, compared with saved
//! ones. `firmware/kernels.sh` runs this.
//!
//! ```text
//! kernel_counts run COUNTS [RECORDINGS]    counts on emulated scenes, and on cuts of RECORDINGS
//! kernel_counts table COUNTS               COUNTS as a table
//! kernel_counts save COUNTS SAVED          COUNTS into SAVED; an origin that was not counted stays
//! kernel_counts check COUNTS SAVED         exit 1 where a count has grown
//! kernel_counts readme SAVED README        the table of SAVED into README
//! ```

mod compare;
mod file;
mod readme;
mod table;

use std::path::Path;
use std::process::ExitCode;

use anyhow::bail;
use eecvs_bench::cut::{self, Cut};
use eecvs_bench::kernel_image::Images;
use eecvs_bench::{Effort, Origin, windows};

fn main() -> anyhow::Result<ExitCode> {
    let arguments = std::env::args().skip(1).collect::<Vec<_>>();
    let arguments = arguments.iter().map(String::as_str).collect::<Vec<_>>();
    match arguments[..] {
        ["run", counts] => run(Path::new(counts), None)?,
        ["run", counts, recordings] => run(Path::new(counts), Some(Path::new(recordings)))?,
        ["table", counts] => print!("{}", table::table(&file::read(Path::new(counts))?)),
        ["save", counts, saved] => {
            let (mut counts, saved) = (file::read(Path::new(counts))?, Path::new(saved));
            if saved.exists() {
                for origin in file::keep_uncounted(&mut counts, file::read(saved)?) {
                    println!("no cuts from {origin} here: their saved counts stay as they were");
                }
            }
            file::write(&counts, saved)?;
        }
        ["check", counts, saved] => {
            let (counts, saved) = (
                file::read(Path::new(counts))?,
                file::read(Path::new(saved))?,
            );
            let comparison = compare::compare(&counts, &saved);
            print!("{comparison}");
            if comparison.has_failed() {
                return Ok(ExitCode::FAILURE);
            }
        }
        ["readme", saved, path] => readme::write(&file::read(Path::new(saved))?, Path::new(path))?,
        _ => bail!(
            "usage: kernel_counts run|table|save|check|readme ...; see the head of its source"
        ),
    }
    Ok(ExitCode::SUCCESS)
}

/// Builds the images and runs them on every cut that is there.
fn run(to: &Path, recordings: Option<&Path>) -> anyhow::Result<()> {
    let mut origins: Vec<(Origin, Vec<Cut>)> = Vec::new();
    let is_complete =
        |folder: &&Path| cut::recordings().all(|(_, file)| folder.join(file).exists());
    match recordings.filter(is_complete) {
        Some(folder) => origins.push((Origin::Recordings, cut::of_recordings(folder)?)),
        None => println!("no recordings, no cuts of them"),
    }
    origins.push((Origin::Emulator, cut::of_scenes()?));
    let images = Images::build()?;
    let mut counts = Vec::new();
    for (origin, cuts) in &origins {
        counts.extend(images.count(&windows(cuts, Effort::FULL)?, *origin)?);
    }
    file::write(&counts, to)
}
