//! `eecvs verify`: checks a file of frames without decoding it.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::Args;
use eecvs::frame_file::{FrameReader, LinkReport};
use eecvs_cli::options::tell_link;
use eecvs_cli::output::{print, print_json, rows};
use event_files::input::piped::{name_of, open_bytes};
use serde::Serialize;

/// Check all checksums and counts of a file of frames
///
/// Every frame's checksum, the order of the frames, and the counts, hashes and index of the marks at the ends of
/// segments. Nothing is decoded.
#[derive(Debug, Args)]
pub struct Verify {
    /// File of frames
    #[arg(value_name = "IN.eecvs")]
    input: PathBuf,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// What `eecvs verify` reports; the fields are its JSON keys.
#[derive(Debug, Serialize)]
struct Report<'r> {
    /// Size of the file.
    bytes: u64,
    /// Events in its frames.
    events: u64,
    #[serde(flatten)]
    link: &'r LinkReport,
}

impl Verify {
    /// Reads all frames and prints what was found.
    ///
    /// # Errors
    /// Fails if the file cannot be read, holds no frame, or is not whole.
    pub fn run(self) -> Result<()> {
        let name = name_of(&self.input);
        let mut reader = FrameReader::new(open_bytes(&self.input)?).of_all_sensors();
        let mut events = 0;
        while let Some(located) = reader
            .next_frame()
            .with_context(|| format!("{name}: cannot be read"))?
        {
            events += u64::from(located.frame.header.events);
        }
        let link = reader.report();
        if link.frames == 0 {
            bail!("{name}: {}", link.why_empty());
        }
        let report = Report {
            bytes: reader.offset(),
            events,
            link,
        };
        if self.json {
            print_json(&report)?;
        } else {
            print(&table(&report))?;
        }
        tell_link(&name, link)
    }
}

fn table(report: &Report<'_>) -> String {
    let link = report.link;
    rows([
        ("bytes", report.bytes.to_string()),
        ("  damaged", link.damaged_bytes.to_string()),
        ("frames", link.frames.to_string()),
        ("  lost", link.frames_lost.to_string()),
        ("  without an end mark", link.frames_unmarked.to_string()),
        ("events", report.events.to_string()),
        (
            "segments with their end mark",
            link.segments_ended.to_string(),
        ),
        ("  without one", link.segments_cut_short.to_string()),
        (
            "  with one that does not fit",
            link.segments_different.to_string(),
        ),
    ])
}
