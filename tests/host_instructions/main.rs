//! Instructions of the host's encoder, decoder and readers, counted by Valgrind.
//! `host-harness/instructions.sh` runs this.
//!
//! ```text
//! host_instructions print SAVED    counts and prints
//! host_instructions save SAVED     and takes the counts over into SAVED
//! host_instructions check SAVED    and exits 1 where one has grown, 77 where SAVED does not compare
//! host_instructions run FOLDER     what is counted; this program calls itself so
//! ```
//!
//! Callgrind collects inside of one function (`count_these`) and writes a file each time
//! that it returns, so one process has all cases and neither their preparation nor its own start
//! counts. Nothing is linked in for that: no client requests, which want C headers of Valgrind, a C
//! compiler and libclang, and no harness with a runner to be installed in the same version.

mod callgrind;
mod cases;
mod counts;

use std::path::Path;
use std::process::ExitCode;

use anyhow::bail;

use counts::Counts;

/// Status of a check that could not compare, as test harnesses have it.
const SKIPPED: u8 = 77;

fn main() -> anyhow::Result<ExitCode> {
    let arguments = std::env::args().skip(1).collect::<Vec<_>>();
    let arguments = arguments.iter().map(String::as_str).collect::<Vec<_>>();
    let (action, saved) = match arguments[..] {
        ["run", folder] => {
            cases::run(Path::new(folder))?;
            return Ok(ExitCode::SUCCESS);
        }
        [action @ ("print" | "save" | "check"), saved] => (action, Path::new(saved)),
        _ => bail!("usage: host_instructions print|save|check SAVED; see the head of its source"),
    };
    let counts = callgrind::measure()?;
    print!("{counts}");
    match action {
        "save" => counts.write(saved)?,
        "check" => {
            let saved = Counts::read(saved)?;
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
        _ => {}
    }
    Ok(ExitCode::SUCCESS)
}
