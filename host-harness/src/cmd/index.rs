//! `eecvs index`: adds the end mark that a file of frames lacks.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use eecvs::frame_file::FrameReader;
use eecvs::frame_file::index::Index as Stretches;
use eecvs::frame_file::mark::{MARK_BYTES_MAX, Mark, MarkError, SYNC};
use eecvs_cli::options::tell_link;
use eecvs_cli::output::{print, print_json, rows};
use event_files::output::{self, is_dash};
use serde::Serialize;

/// Add the index that a file of frames lacks
///
/// Checks a file as `eecvs verify` does, and appends an end mark, with counts and an index of times, to a file that ends without one: a stream that was kept, a
/// file of an earlier version, or one whose writer was stopped. Nothing else in the file changes, but that a part of such
/// a mark at its end is replaced. Damage before the mark remains, and is reported.
#[derive(Debug, Args)]
pub struct Index {
    /// File of frames, which is changed
    #[arg(value_name = "FILE.eecvs")]
    file: PathBuf,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

/// What `eecvs index` reports; the fields are its JSON keys.
#[derive(Debug, Serialize)]
struct Report {
    /// Size of the file before.
    bytes: u64,
    /// Bytes that were appended; 0 if the file had an index already.
    bytes_appended: u64,
    /// Stretches of the file that can be read by themselves.
    stretches: u64,
}

impl Index {
    /// Appends the end mark, if it is missing, and prints a summary.
    ///
    /// # Errors
    /// Fails if the file cannot be read or written, or holds no frame. If frames are damaged or missing, fails after
    /// appending the mark.
    pub fn run(self) -> Result<()> {
        let name = self.file.display().to_string();
        let at = || name.clone();
        ensure!(
            !is_dash(&self.file),
            "{name}: a stream can have no index: save it to a file first"
        );
        let about = std::fs::metadata(&self.file).with_context(at)?;
        ensure!(
            about.is_file(),
            "{name}: only a file can have an index: save the stream to one first"
        );
        let bytes = about.len();
        let has_index = stretches(&self.file).with_context(at)?.is_some();
        let bytes_appended = if has_index {
            0
        } else {
            append(&self.file, bytes, &name)?
        };
        let report = Report {
            bytes,
            bytes_appended,
            stretches: stretches(&self.file).with_context(at)?.unwrap_or_default(),
        };
        if self.json {
            print_json(&report)?;
        } else {
            print(&rows([
                ("bytes", report.bytes.to_string()),
                ("  appended", report.bytes_appended.to_string()),
                ("stretches", report.stretches.to_string()),
            ]))?;
        }
        let (reader, _) = read(&self.file).with_context(at)?;
        tell_link(&name, reader.report())
    }
}

/// Returns the number of stretches in a file's index, or `None` if it has none.
fn stretches(path: &Path) -> std::io::Result<Option<u64>> {
    let index = Stretches::read(&mut File::open(path)?)?;
    Ok(index.map(|index| index.stretches().len() as u64))
}

/// Reads all frames of a file; returns the offset of the last one's end too.
fn read(path: &Path) -> std::io::Result<(FrameReader<File>, u64)> {
    let mut frames = FrameReader::new(File::open(path)?).of_all_sensors();
    let mut end_of_frames = 0;
    while let Some(located) = frames.next_frame()? {
        end_of_frames = located.offset + located.stored as u64;
    }
    Ok((frames, end_of_frames))
}

/// Appends the end mark that is missing in a file of `bytes` bytes; returns its size.
fn append(path: &Path, bytes: u64, name: &str) -> Result<u64> {
    let at = || name.to_owned();
    let (frames, end_of_frames) = read(path).with_context(at)?;
    if frames.report().frames == 0 {
        bail!("{name}: {}", frames.report().why_empty());
    }
    let out = OpenOptions::new().read(true).append(true).open(path);
    let mut out = out.with_context(at)?;
    match out.try_lock() {
        Err(TryLockError::WouldBlock) => {
            bail!("{name}: another process writes to it: index it when that has ended");
        }
        // Where the file system has no locks, nobody has one.
        Ok(()) | Err(TryLockError::Error(_)) => {}
    }
    let kept = without_cut_mark(&mut out, end_of_frames, bytes).with_context(at)?;
    let Some(end) = frames.missing_end(kept) else {
        return Ok(0);
    };
    ensure!(
        out.metadata().with_context(at)?.len() == bytes,
        "{name}: has grown meanwhile: index it when nothing is written to it any more"
    );
    let mark = end.to_bytes();
    out.set_len(kept).with_context(at)?;
    if let Err(error) = out.write_all(&mark) {
        // A part of a mark would be damage.
        out.set_len(kept).with_context(at)?;
        return Err(error).with_context(at);
    }
    output::sync(path).with_context(at)?;
    Ok(mark.len() as u64)
}

/// Returns the size of the file without an end mark at its end that is cut short: what a run of this command leaves that
/// is killed while it appends, and a writer that is killed at its end.
fn without_cut_mark(file: &mut File, end_of_frames: u64, bytes: u64) -> std::io::Result<u64> {
    let mut tail = Vec::new();
    file.seek(SeekFrom::Start(end_of_frames))?;
    file.take(MARK_BYTES_MAX as u64).read_to_end(&mut tail)?;
    let is_all = end_of_frames + tail.len() as u64 == bytes;
    let is_cut = tail.starts_with(&SYNC) && Mark::parse(&tail) == Err(MarkError::Incomplete);
    Ok(if is_all && is_cut {
        end_of_frames
    } else {
        bytes
    })
}
