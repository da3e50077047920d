//! Frames of several sensors in one stream, taken apart.
//!
//! A frame tells its sensor by its size alone. So there is a part for each size, and a further one where the
//! numbers of its frames begin anew: another recording put behind the first, or an encoder that was started
//! again. Frames of two sensors of one size that alternate cannot be told apart.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use eecvs::frame_file::FrameReader;
use eecvs_nostd::Sensor;
use event_files::output::{Kind, OutputFile, check};
use serde::Serialize;

/// Parts at the most: each is an open file until the end.
pub const PARTS_MAX: usize = 256;

/// A part; the fields are JSON keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Part {
    /// Its file.
    pub file: PathBuf,
    /// Columns of its sensor.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// Its frames.
    pub frames: u64,
    /// Events in them.
    pub events: u64,
    /// Bytes of them.
    pub bytes: u64,
    /// The number of its first frame: not 0 where its beginning is missing.
    pub first_number: u32,
}

/// Writes the frames of `reader`, each as it is, to files in `folder`, named by their number and size; all have
/// their names when the last frame has been written, and none before.
///
/// # Errors
/// Reading or writing, a file that is there already (unless `overwrite`), more than [`PARTS_MAX`] parts.
pub fn split(
    reader: &mut FrameReader<impl Read>,
    folder: &Path,
    overwrite: bool,
) -> Result<Vec<Part>> {
    let mut parts: Vec<(Part, OutputFile)> = Vec::new();
    let mut restarts = 0;
    while let Some(located) = reader.next_frame().context("cannot be read")? {
        let header = located.frame.header;
        let is_new = located.restarts > restarts;
        restarts = located.restarts;
        let Sensor { width, height } = header.sensor;
        let is_of = |(part, _): &(Part, OutputFile)| (part.width, part.height) == (width, height);
        let latest = parts.iter().rposition(is_of).filter(|_| !is_new);
        let at = match latest {
            Some(at) => at,
            None => {
                ensure!(
                    parts.len() < PARTS_MAX,
                    "byte {}: more than {PARTS_MAX} parts: are these frames of two sensors of one size that \
                     alternate? They cannot be told apart",
                    located.offset
                );
                let file = folder.join(format!("{}-{width}x{height}.eecvs", parts.len() + 1));
                check(&file, Kind::Frames, overwrite, &[])?;
                let out = OutputFile::create(&file)?;
                let part = Part {
                    file,
                    width,
                    height,
                    frames: 0,
                    events: 0,
                    bytes: 0,
                    first_number: header.sequence,
                };
                parts.push((part, out));
                parts.len() - 1
            }
        };
        if let Some((part, out)) = parts.get_mut(at) {
            out.write_all(located.bytes)?;
            part.frames += 1;
            part.events += u64::from(header.events);
            part.bytes += located.bytes.len() as u64;
        }
    }
    let kept = parts.into_iter().map(|(part, out)| {
        out.finish()?;
        Ok(part)
    });
    kept.collect()
}
