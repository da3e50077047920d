//! Reads a ROS 2 bag in a folder: `metadata.yaml`, and files that follow one another.
//!
//! Only the list `relative_file_paths` of the metadata is read, with its items on lines of their own, the only form
//! that rosbag2 writes. Compressed messages and compressed files are supported.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use event_types::stream::small_file::read_text;
use event_types::stream::{Context, Result};
use event_types::{Sensor, bail, ensure, error};

use super::decoder::{Messages, RosReader};
use super::fields::Serialisation;
use super::message::Kind;
use super::topics::Topics;
use super::{db3, mcap};
use crate::Skipped;
use crate::format::Format;
use crate::output::temporary::{Temporary, copy};

/// Name of the file that makes a folder a bag.
pub use crate::format::METADATA;

/// The format of a bag in a folder; messages use its names.
pub const FORMAT: Format = Format {
    name: "rosbag2",
    title: "ROS 2 bag",
    has_places: true,
    is_table: false,
    create: None,
    ..mcap::FORMAT
};

/// Longest metadata, in bytes.
const METADATA_MAX: u64 = 1 << 24;

/// Reads the bag in the folder `path`, like [`RosReader::new`].
///
/// # Errors
/// Those of [`RosReader::new`]; the metadata is missing or lists no files.
pub fn open(path: &Path, place: Option<&str>, size: Option<Sensor>) -> Result<RosReader> {
    RosReader::new(messages(path)?, place, size)
}

/// Returns the messages of the bag in the folder `path`.
///
/// # Errors
/// The metadata is missing or lists no files.
pub fn messages(path: &Path) -> Result<Box<dyn Messages>> {
    let name = path.join(METADATA).display().to_string();
    std::fs::metadata(path.join(METADATA)).with_context(|| {
        let folder = path.display();
        format!("{folder}: is a directory, neither a recording nor a ROS 2 bag ({METADATA})")
    })?;
    let text = read_text(&path.join(METADATA), METADATA_MAX)?;
    let files = files(&text);
    ensure!(
        !files.is_empty(),
        Damaged,
        "{name}: byte 0: no relative_file_paths: write it again with `ros2 bag reindex`"
    );
    let files: Vec<PathBuf> = files.iter().map(|file| path.join(file)).collect();
    let messages = Folder {
        name,
        files,
        next: 0,
        file: None,
        places: Vec::new(),
    };
    Ok(Box::new(messages))
}

/// Returns the items of the list `relative_file_paths`.
fn files(text: &str) -> Vec<&str> {
    let mut lines = text.lines().map(str::trim);
    lines.by_ref().find(|line| *line == "relative_file_paths:");
    let items = lines.map_while(|line| line.strip_prefix("- "));
    items
        .map(|item| item.trim().trim_matches(['"', '\'']))
        .collect()
}

/// The messages of several files.
struct Folder {
    name: String,
    files: Vec<PathBuf>,
    /// Index of the file after the current one.
    next: usize,
    file: Option<Opened>,
    /// Number of places in each file, once they have been requested.
    places: Vec<u64>,
}

/// A file of a bag, and the temporary file with its content if it was compressed.
struct Opened {
    messages: Box<dyn Messages>,
    _unpacked: Option<Temporary>,
}

/// Opens one file of a bag.
fn open_file(path: &Path) -> Result<Opened> {
    let name = path.display().to_string();
    let unpacked = unpacked(path)?;
    let (content, called) = match &unpacked {
        Some(unpacked) => (unpacked.path().to_owned(), path.with_extension("")),
        None => (path.to_owned(), path.to_owned()),
    };
    Ok(Opened {
        messages: open_plain(&content, &called, &name)?,
        _unpacked: unpacked,
    })
}

/// Unpacks a file that rosbag2 compressed as a whole (`.zstd`) to a temporary file, which is removed when the returned
/// path is dropped; returns `None` for any other file.
///
/// # Errors
/// The file cannot be read or is damaged, or the temporary file cannot be written.
pub fn unpacked(path: &Path) -> Result<Option<Temporary>> {
    let name = path.display().to_string();
    if path.extension().is_none_or(|extension| extension != "zstd") {
        return Ok(None);
    }
    let packed = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
    let (mut file, unpacked) =
        Temporary::create().with_context(|| format!("{name}: no temporary file can be created"))?;
    let what = || format!("{name}: byte 0: cannot be decompressed");
    let mut decoder = ruzstd::decoding::StreamingDecoder::new(BufReader::new(packed))
        .map_err(std::io::Error::other)
        .with_context(what)?;
    copy(&mut decoder, &mut file, &name).with_context(what)?;
    Ok(Some(unpacked))
}

/// Opens the file at `path`, whose name in the bag is `called`.
fn open_plain(path: &Path, called: &Path, name: &str) -> Result<Box<dyn Messages>> {
    match called.extension().and_then(|extension| extension.to_str()) {
        Some("mcap") => {
            let file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
            Ok(Box::new(mcap::Mcap::new(Box::new(file), name)?))
        }
        Some("db3") => Ok(Box::new(db3::Database::new(path, name)?)),
        _ => bail!(
            Unsupported,
            "{name}: byte 0: a bag's files must be .mcap or .db3, or one of these compressed as \
             .zstd"
        ),
    }
}

impl Messages for Folder {
    fn format(&self) -> &'static str {
        let file = self.file.as_ref();
        file.map_or(FORMAT.name, |file| file.messages.format())
    }

    fn next(
        &mut self,
        message: &mut Vec<u8>,
        topics: &mut Topics,
        skipped: &mut Skipped,
    ) -> Result<Option<(Kind, Serialisation)>> {
        loop {
            if let Some(file) = &mut self.file
                && let Some(next) = file.messages.next(message, topics, skipped)?
            {
                return Ok(Some(next));
            }
            let Some(path) = self.files.get(self.next) else {
                return Ok(None);
            };
            self.file = Some(open_file(path)?);
            self.next += 1;
        }
    }

    fn places(&mut self, topics: &mut Topics) -> Result<Option<u64>> {
        if self.places.is_empty() {
            for file in &self.files {
                // A file without an index has one place, its beginning.
                let places = open_file(file)?.messages.places(topics)?.unwrap_or(1);
                self.places.push(places);
            }
        }
        let sum = |sum: u64, places: &u64| sum.checked_add(*places);
        Ok(self.places.iter().try_fold(0, sum))
    }

    fn go(&mut self, mut place: u64, topics: &mut Topics) -> Result<()> {
        for (number, (path, places)) in self.files.iter().zip(&self.places).enumerate() {
            if place < *places {
                let mut file = open_file(path)?;
                // The file's own index, since the topics of earlier files are not read again.
                file.messages.places(topics)?;
                file.messages.go(place, topics)?;
                self.file = Some(file);
                self.next = number + 1;
                return Ok(());
            }
            place -= places;
        }
        Ok(())
    }

    fn error(&self, at: usize, what: &str) -> event_types::stream::Error {
        match &self.file {
            Some(file) => file.messages.error(at, what),
            None => error!(Damaged, "{}: byte {at}: {what}", self.name),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_listed_in_their_order() {
        let text = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - b_0.db3\n    \
                    - \"b_1.db3\"\n  duration:\n    nanoseconds: 1\n";
        assert_eq!(files(text), ["b_0.db3", "b_1.db3"]);
        assert!(files("version: 5\n").is_empty());
    }
}
