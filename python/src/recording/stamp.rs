//! Whether a file is still the one that was opened.

use std::fs::{self, Metadata};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Most files of a folder that are looked at.
const FILES_MAX: usize = 4096;

/// What the system says of a file, or of the files of a folder, without reading them.
#[derive(Debug, PartialEq, Eq)]
pub struct Stamp(Vec<File>);

#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct File {
    path: PathBuf,
    /// Device and number on it, where a system has such.
    id: Option<(u64, u64)>,
    bytes: u64,
    modified: Option<SystemTime>,
}

impl File {
    fn new(path: PathBuf, file: &Metadata) -> Self {
        Self {
            path,
            id: id(file),
            bytes: file.len(),
            modified: file.modified().ok(),
        }
    }

    /// Whether this was the same file, and has other bytes where it had some: not if it only grew.
    fn is_overwritten_by(&self, now: &Self) -> bool {
        let same = self.id.is_some() && self.id == now.id;
        let changed = now.bytes == self.bytes && now.modified != self.modified;
        same && (now.bytes < self.bytes || changed)
    }
}

#[cfg(unix)]
fn id(file: &Metadata) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    Some((file.dev(), file.ino()))
}

#[cfg(not(unix))]
fn id(_: &Metadata) -> Option<(u64, u64)> {
    None
}

impl Stamp {
    /// Looks at a file or a folder; `None` if it is neither, or the system does not say.
    pub fn of(path: &Path) -> Option<Self> {
        let file = fs::metadata(path).ok()?;
        if file.is_file() {
            return Some(Self(vec![File::new(path.to_path_buf(), &file)]));
        }
        let mut files = Vec::new();
        for entry in fs::read_dir(path).ok()?.take(FILES_MAX) {
            let path = entry.ok()?.path();
            let file = fs::metadata(&path).ok().filter(Metadata::is_file);
            files.extend(file.map(|file| File::new(path, &file)));
        }
        files.sort();
        Some(Self(files))
    }

    /// Whether a reader that holds these files open would read old bytes and new ones.
    pub fn is_overwritten_by(&self, now: &Self) -> bool {
        self.0.iter().any(|old| {
            let files = now.0.iter();
            files
                .filter(|new| new.id == old.id)
                .any(|new| old.is_overwritten_by(new))
        })
    }
}
