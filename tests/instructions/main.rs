//! The instruction counts of the firmware: the cuts that they are made on, their table, and the
//! comparison with saved ones. `firmware/instructions.sh` runs this.
//!
//! ```text
//! instructions cuts FOLDER [RECORDINGS]    cuts into FOLDER/recordings and FOLDER/emulator
//! instructions verify COUNTS FOLDER       the image's frames are those of the cuts on this host
//! instructions table COUNTS                COUNTS, as the image prints them, as a table
//! instructions portable COUNTS PLAIN       the whole of COUNTS beside that of an image without assembly
//! instructions save COUNTS SAVED           COUNTS into SAVED; an origin that was not measured stays
//! instructions check COUNTS SAVED          exit 1 where a stage has grown
//! instructions readme SAVED README         the tables of SAVED into README
//! ```

mod counts;
mod cuts;
mod readme;
mod verify;

use std::path::Path;
use std::process::ExitCode;

use anyhow::bail;

use counts::Counts;

fn main() -> anyhow::Result<ExitCode> {
    let arguments = std::env::args().skip(1).collect::<Vec<_>>();
    let arguments = arguments.iter().map(String::as_str).collect::<Vec<_>>();
    match arguments[..] {
        ["cuts", folder] => cuts::write(Path::new(folder), None)?,
        ["cuts", folder, recordings] => {
            cuts::write(Path::new(folder), Some(Path::new(recordings)))?;
        }
        ["verify", counts, folder] => {
            for run in Counts::read(Path::new(counts))?.runs() {
                verify::verify(run, Path::new(folder))?;
            }
        }
        ["table", counts] => print!("{}", Counts::read(Path::new(counts))?.table()),
        ["portable", counts, plain] => {
            let plain = Counts::read(Path::new(plain))?;
            print!("{}", Counts::read(Path::new(counts))?.beside(&plain)?);
        }
        ["save", counts, saved] => {
            let saved = Path::new(saved);
            let mut counts = Counts::read(Path::new(counts))?;
            if saved.exists() {
                for origin in counts.keep_unmeasured(Counts::read(saved)?) {
                    println!("no cuts from {origin} here: their saved counts stay as they were");
                }
            }
            counts.write(saved)?;
        }
        ["check", counts, saved] => {
            let comparison =
                Counts::read(Path::new(counts))?.compare(&Counts::read(Path::new(saved))?);
            print!("{comparison}");
            if comparison.has_failed() {
                return Ok(ExitCode::FAILURE);
            }
        }
        ["readme", saved, path] => {
            readme::write(&Counts::read(Path::new(saved))?, Path::new(path))?;
        }
        _ => bail!(
            "usage: instructions cuts|table|portable|save|check ...; see the head of its source"
        ),
    }
    Ok(ExitCode::SUCCESS)
}
