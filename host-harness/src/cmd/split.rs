//! `eecvs split`: separates the frames of several sensors.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use eecvs::frame_file::{FrameReader, LinkReport};
use eecvs_cli::folder::RunFolder;
use eecvs_cli::options::{OutputOptions, tell_link};
use eecvs_cli::output::{print, print_json};
use event_files::input::piped::{name_of, open_bytes};
use event_files::output::is_dash;
use event_types::plain;
use serde::Serialize;

use crate::split::{Part, is_part, split};

/// Separate the frames of several sensors, or of concatenated recordings
///
/// Writes one file per sensor size, and a further one wherever the numbers of the frames restart. Interleaved
/// frames of two sensors of the same size cannot be separated.
#[derive(Debug, Args)]
pub struct Split {
    /// File of frames
    #[arg(value_name = "IN.eecvs")]
    input: PathBuf,

    /// Folder to write the parts to, named 1-346x260.eecvs and so on. It must be empty; --overwrite removes the parts
    /// of an earlier run
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
        let folder = self.check()?;
        let mut reader = FrameReader::new(open_bytes(&self.input)?).of_all_sensors();
        folder.make()?;
        let parts = split(&mut reader, &self.output, self.overwrite.overwrite)
            .with_context(|| name.clone())?;
        if parts.is_empty() {
            bail!("{name}: {}", reader.report().why_empty());
        }
        let link = LinkReport {
            // Separating restarts is the purpose of this command, so they are no fault here.
            restarts: 0,
            ..reader.report().clone()
        };
        let names = parts.iter().filter_map(|part| part.file.file_name());
        let names: Vec<String> = names
            .map(|name| name.to_string_lossy().into_owned())
            .collect();
        folder.keep(&names)?;
        let report = Report { parts, link: &link };
        if self.json {
            print_json(&report)?;
        } else {
            print(&table(&report.parts))?;
        }
        tell_link(&name, &link)
    }

    fn check(&self) -> Result<RunFolder> {
        let name = self.output.display();
        ensure!(
            !is_dash(&self.output),
            "{name}: the parts are written to a folder: name one"
        );
        // Replacing the input by one of its own parts would destroy it.
        let folder = self.input.parent().unwrap_or(Path::new(""));
        let is_inside = folder.join(".").canonicalize().ok() == self.output.canonicalize().ok();
        ensure!(
            !is_inside || !self.overwrite.overwrite,
            "{name}: is the folder of the input {}: choose another folder",
            self.input.display()
        );
        let folder = RunFolder::check(&self.output, self.overwrite.overwrite, is_part)?;
        folder.refuse_inputs([self.input.as_path()])?;
        Ok(folder)
    }
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
            plain::line(&part.file.display().to_string())
        );
    }
    text
}
