//! Parts: temporary files that become outputs, and are removed whatever ends the process.

use std::collections::BTreeSet;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::TempPath;

use super::folder;

/// Ending of temporary names.
const PART: &str = ".part";

/// Number of random characters in a temporary name.
const RANDOM: usize = 6;

/// Rights of a new file, before the user's mask.
pub(super) const READABLE: u32 = 0o666;

/// Rights of a file that only its owner may read.
pub(super) const PRIVATE: u32 = 0o600;

/// A temporary file, which is removed when it is dropped.
#[derive(Debug)]
pub(super) struct Part(Option<TempPath>);

impl Part {
    /// Creates an empty temporary file beside `target`, with the permissions `mode`.
    pub(super) fn create(target: &Path, mode: u32) -> std::io::Result<Self> {
        let mut prefix = std::ffi::OsString::from(".");
        prefix.push(target.file_name().unwrap_or_default());
        prefix.push(".");
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).suffix(PART).rand_bytes(RANDOM);
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode));
        #[cfg(not(unix))]
        let _ = mode;
        Self::build(&builder, folder(target)).map(|(_, part)| part)
    }

    /// Creates an empty file in a folder, and returns it opened.
    pub(super) fn build(
        builder: &tempfile::Builder,
        folder: &Path,
    ) -> std::io::Result<(File, Self)> {
        // The file is listed before a signal can end the process.
        let mut parts = parts();
        let (file, path) = builder.tempfile_in(folder)?.into_parts();
        parts.insert(path.to_path_buf());
        drop(parts);
        Ok((file, Self(Some(path))))
    }

    pub(super) fn path(&self) -> &Path {
        self.0.as_deref().unwrap_or(Path::new(""))
    }

    /// Renames the file.
    pub(super) fn persist(mut self, target: &Path) -> std::io::Result<()> {
        let Some(path) = self.0.take() else {
            return Ok(());
        };
        let part = path.to_path_buf();
        // If this fails, the error has the path, and removes the file.
        let renamed = path.persist(target).map_err(|error| error.error);
        parts().remove(&part);
        renamed
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        if let Some(path) = self.0.take() {
            let part = path.to_path_buf();
            // The caller reports the error that led here.
            let _ = path.close();
            parts().remove(&part);
        }
    }
}

/// The temporary files of this process.
static PARTS: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn parts() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    PARTS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes the incomplete files, when the process is about to end. No other can be begun afterwards: a thread that
/// tries waits for the end.
pub fn remove_parts() {
    let parts = parts();
    for part in parts.iter() {
        // The file may have been renamed already.
        let _ = std::fs::remove_file(part);
    }
    std::mem::forget(parts);
}

/// Opens a file for writing, truncated. A part that a signal has removed does not come back: whoever is about to end
/// the process holds the list.
///
/// # Errors
/// The file cannot be created.
pub(super) fn create_file(path: &Path) -> std::io::Result<File> {
    let parts = parts();
    match parts.contains(path) {
        true => File::options().write(true).truncate(true).open(path),
        false => File::create(path),
    }
}

/// Returns the name of a file for messages and metadata: for a temporary name, the name that the file will have.
#[must_use]
pub fn final_path(path: &Path) -> PathBuf {
    let name = path.file_name().and_then(|name| name.to_str());
    let inner = name
        .and_then(|name| name.strip_prefix('.'))
        .and_then(|name| name.strip_suffix(PART));
    let stem = inner
        .and_then(|inner| inner.rsplit_once('.'))
        .filter(|(stem, random)| !stem.is_empty() && random.len() == RANDOM);
    stem.map_or_else(|| path.to_owned(), |(stem, _)| path.with_file_name(stem))
}
