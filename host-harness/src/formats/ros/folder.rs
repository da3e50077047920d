//! A bag of ROS 2 in a folder: `metadata.yaml` and files one after the other.
//!
//! Of the metadata only the list `relative_file_paths` is read, whose items are on lines of their own;
//! rosbag2 writes no other form.

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::Context;
use eecvs_nostd::Sensor;

use super::decoder::{Messages, RosReader};
use super::fields::Serialisation;
use super::message::Kind;
use super::topics::Topics;
use super::{db3, mcap};
use crate::formats::Skipped;

/// The file that makes a folder a bag.
pub const METADATA: &str = "metadata.yaml";

/// Longest metadata.
const METADATA_MAX: u64 = 1 << 24;

/// Reads the bag in the folder `path`, as [`RosReader::new`].
///
/// # Errors
/// As [`RosReader::new`]; no metadata.
pub fn open(path: &Path, place: Option<&str>, size: Option<Sensor>) -> anyhow::Result<RosReader> {
    let name = path.join(METADATA).display().to_string();
    let metadata = std::fs::metadata(path.join(METADATA)).with_context(|| {
        let folder = path.display();
        format!("{folder}: is a directory, not a recording, nor a bag of ROS 2 ({METADATA})")
    })?;
    anyhow::ensure!(
        metadata.len() <= METADATA_MAX,
        "{name}: byte {METADATA_MAX}: longer than metadata is"
    );
    let text = std::fs::read_to_string(path.join(METADATA))
        .with_context(|| format!("{name}: byte 0: cannot be read as text"))?;
    let files = files(&text);
    anyhow::ensure!(
        !files.is_empty(),
        "{name}: byte 0: no relative_file_paths: write it anew with `ros2 bag reindex`"
    );
    let files: Vec<PathBuf> = files.iter().map(|file| path.join(file)).collect();
    let messages = Folder {
        name,
        files,
        next: 0,
        file: None,
        places: Vec::new(),
    };
    RosReader::new(Box::new(messages), place, size)
}

/// The items of the list `relative_file_paths`.
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
    /// Number of the file behind the present one.
    next: usize,
    file: Option<Box<dyn Messages>>,
    /// Places of each file, once asked.
    places: Vec<u64>,
}

/// Opens one file of a bag.
fn open_file(path: &Path) -> anyhow::Result<Box<dyn Messages>> {
    let name = path.display().to_string();
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("mcap") => {
            let file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
            Ok(Box::new(mcap::Mcap::new(Box::new(file), &name)?))
        }
        Some("db3") => Ok(Box::new(db3::Database::new(path, &name)?)),
        _ => anyhow::bail!("{name}: byte 0: a bag's files are .mcap or .db3: decompress it first"),
    }
}

impl Messages for Folder {
    fn format(&self) -> &'static str {
        let file = self.file.as_ref();
        file.map_or("rosbag2", |file| file.format())
    }

    fn next(
        &mut self,
        message: &mut Vec<u8>,
        topics: &mut Topics,
        skipped: &mut Skipped,
    ) -> anyhow::Result<Option<(Kind, Serialisation)>> {
        loop {
            if let Some(file) = &mut self.file
                && let Some(next) = file.next(message, topics, skipped)?
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

    fn places(&mut self, topics: &mut Topics) -> anyhow::Result<Option<u64>> {
        if self.places.is_empty() {
            for file in &self.files {
                // Without an index a file has its beginning.
                let places = open_file(file)?.places(topics)?.unwrap_or(1);
                self.places.push(places);
            }
        }
        let sum = |sum: u64, places: &u64| sum.checked_add(*places);
        Ok(self.places.iter().try_fold(0, sum))
    }

    fn go(&mut self, mut place: u64, topics: &mut Topics) -> anyhow::Result<()> {
        for (number, (path, places)) in self.files.iter().zip(&self.places).enumerate() {
            if place < *places {
                let mut file = open_file(path)?;
                // Its own index: the topics of earlier files are not met.
                file.places(topics)?;
                file.go(place, topics)?;
                self.file = Some(file);
                self.next = number + 1;
                return Ok(());
            }
            place -= places;
        }
        Ok(())
    }

    fn error(&self, at: usize, what: &str) -> anyhow::Error {
        match &self.file {
            Some(file) => file.error(at, what),
            None => anyhow::anyhow!("{}: byte {at}: {what}", self.name),
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
