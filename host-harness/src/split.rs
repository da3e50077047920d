//! Separates the frames of several sensors in one stream.
//!
//! A frame identifies its sensor only by the sensor's size. So there is one part per size, and a further part
//! wherever the sequence numbers restart: after a recording that was appended to the first, or after an encoder was
//! restarted. Interleaved frames of two sensors of the same size cannot be separated.

use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use eecvs::frame_file::{FrameFileWriter, FrameReader, FrameSink};
use eecvs_cli::output::frame_file;
use eecvs_nostd::Sensor;
use event_files::output::{Kind, OutputFile, check};
use serde::Serialize;

/// Largest number of parts; each is an open file until the end.
pub const PARTS_MAX: usize = 256;

/// One part of the stream; the fields are JSON keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Part {
    /// File that the part was written to.
    pub file: PathBuf,
    /// Columns of the sensor.
    pub width: u16,
    /// Rows of the sensor.
    pub height: u16,
    /// Number of frames.
    pub frames: u64,
    /// Number of events in the frames.
    pub events: u64,
    /// Size of the frames in bytes.
    pub bytes: u64,
    /// Sequence number of the first frame; not 0 if the beginning of the part is missing.
    pub first_number: u32,
}

/// Returns whether a file has the name of a part.
#[must_use]
pub fn is_part(name: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let parts = || {
        let (number, size) = name.strip_suffix(".eecvs")?.split_once('-')?;
        let (width, height) = size.split_once('x')?;
        Some([number, width, height])
    };
    parts().is_some_and(|parts| parts.into_iter().all(is_number))
}

/// Writes the frames of `reader` unchanged to files in `folder`, named by part number and sensor size.
///
/// The files get their names only after the last frame has been written, so that a failure leaves none of them.
///
/// # Errors
/// Fails if reading or writing fails, a file exists already (unless `overwrite`), or there are more than
/// [`PARTS_MAX`] parts.
pub fn split(
    reader: &mut FrameReader<impl Read>,
    folder: &Path,
    overwrite: bool,
) -> Result<Vec<Part>> {
    let mut parts: Vec<(Part, FrameFileWriter<OutputFile>)> = Vec::new();
    let mut restarts = 0;
    while let Some(located) = reader.next_frame().context("cannot be read")? {
        let header = located.frame.header;
        let is_new = located.restarts > restarts;
        restarts = located.restarts;
        let Sensor { width, height } = header.sensor;
        let is_of = |(part, _): &(Part, _)| (part.width, part.height) == (width, height);
        let latest = parts.iter().rposition(is_of).filter(|_| !is_new);
        let at = match latest {
            Some(at) => at,
            None => {
                ensure!(
                    parts.len() < PARTS_MAX,
                    "byte {}: more than {PARTS_MAX} parts: are these frames of two sensors of one \
                     size that alternate? They cannot be separated",
                    located.offset
                );
                let file = folder.join(format!("{}-{width}x{height}.eecvs", parts.len() + 1));
                check(&file, Kind::Frames, overwrite, &[])?;
                let out = frame_file(&file)?;
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
            out.frame(&header, located.bytes)?;
            part.frames += 1;
            part.events += u64::from(header.events);
            part.bytes += located.bytes.len() as u64;
        }
    }
    let kept = parts.into_iter().map(|(part, out)| {
        out.finish()?.finish()?;
        Ok(part)
    });
    kept.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_known_by_their_names() {
        for (name, is) in [
            ("1-346x260.eecvs", true),
            ("12-1x1.eecvs", true),
            ("1-346x260.raw", false),
            ("one-346x260.eecvs", false),
            ("1-346x.eecvs", false),
            ("-1x1.eecvs", false),
            ("scene.eecvs", false),
        ] {
            assert_eq!(is_part(name), is, "{name}");
        }
    }
}
