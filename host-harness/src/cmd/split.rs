//! `eecvs split`: separates the frames of several sensors.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use eecvs::frame_file::{FrameReader, LinkReport};
use eecvs_cli::options::{OutputOptions, tell_link};
use eecvs_cli::output::{print, print_json};
use event_files::input::piped::{name_of, open_bytes};
use event_files::output::is_dash;
use serde::Serialize;

use crate::split::{Part, split};

/// Separate the frames of several sensors, or of concatenated recordings
///
/// Writes one file per sensor size, and a further one wherever the numbers of the frames restart. Interleaved
/// frames of two sensors of the same size cannot be separated.
#[derive(Debug, Args)]
pub struct Split {
    /// File of frames
    #[arg(value_name = "IN.eecvs")]
    input: PathBuf,

    /// Folder to write the parts to, named 1-346x260.eecvs and so on
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,

    #[command(flatten)]
    overwrite: OutputOptions,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// What `eecvs split` reports; the fields are its JSON keys.
#[derive(Debug, Serialize)]
struct Report<'r> {
    parts: Vec<Part>,
    #[serde(flatten)]
    link: &'r LinkReport,
}

impl Split {
    /// Writes the parts and prints one row per part.
    ///
    /// # Errors
    /// Fails if the frames cannot be read or a file exists already. If frames are damaged or missing, fails after
    /// writing all the others.
    pub fn run(self) -> Result<()> {
        let name = name_of(&self.input);
        self.check()?;
        let mut reader = FrameReader::new(open_bytes(&self.input)?).of_all_sensors();
        std::fs::create_dir_all(&self.output)
            .with_context(|| format!("{}: cannot be created", self.output.display()))?;
        let parts = split(&mut reader, &self.output, self.overwrite.overwrite)
            .with_context(|| name.clone())?;
        if parts.is_empty() {
            bail!("{name}: no frame found; is it a file that `eecvs encode` wrote?");
        }
        let link = LinkReport {
            // Separating restarts is the purpose of this command, so they are no fault here.
            restarts: 0,
            ..reader.report().clone()
        };
        tell_others(&self.output, &parts)?;
        let report = Report { parts, link: &link };
        if self.json {
            print_json(&report)?;
        } else {
            print(&table(&report.parts))?;
        }
        tell_link(&name, &link)
    }

    fn check(&self) -> Result<()> {
        let name = self.output.display();
        ensure!(
            !is_dash(&self.output) && (!self.output.exists() || self.output.is_dir()),
            "{name}: parts are files of a folder: name one"
        );
        // Replacing the input by one of its own parts would destroy it.
        let folder = self.input.parent().unwrap_or(Path::new(""));
        let is_inside = folder.join(".").canonicalize().ok() == self.output.canonicalize().ok();
        ensure!(
            !is_inside || !self.overwrite.overwrite,
            "{name}: {} lies there: choose another folder",
            self.input.display()
        );
        Ok(())
    }
}

/// Warns on stderr about frame files in the folder that are not parts of this input: an earlier input may have had
/// more parts.
fn tell_others(folder: &Path, parts: &[Part]) -> Result<()> {
    let listed = std::fs::read_dir(folder)
        .with_context(|| format!("{}: cannot be listed", folder.display()))?;
    let paths = listed.filter_map(|entry| entry.ok().map(|entry| entry.path()));
    let mut others: Vec<String> = paths
        .filter(|path| path.extension().is_some_and(|ending| ending == "eecvs"))
        .filter(|path| parts.iter().all(|part| part.file != *path))
        .filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned()))
        .collect();
    others.sort_unstable();
    if !others.is_empty() {
        eprintln!(
            "eecvs: {}: was there before and is not of this input: {}",
            folder.display(),
            others.join(", ")
        );
    }
    Ok(())
}

fn table(parts: &[Part]) -> String {
    let mut text = format!(
        "{:>9} {:>9} {:>11} {:>12}  {}\n",
        "sensor", "frames", "events", "bytes", "file"
    );
    for part in parts {
        text += &format!(
            "{:>9} {:>9} {:>11} {:>12}  {}\n",
            format!("{}x{}", part.width, part.height),
            part.frames,
            part.events,
            part.bytes,
            part.file.display()
        );
    }
    text
}
