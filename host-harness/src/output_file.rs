//! Files that a command writes: never over what it reads, never half of one left behind.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

/// A file being written, whose errors name it; removed again when dropped before
/// [`OutputFile::finish`].
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    out: BufWriter<File>,
    finished: bool,
}

impl OutputFile {
    /// Creates the file or empties an existing one.
    ///
    /// # Errors
    /// A file that cannot be created; the message names it.
    pub fn create(path: &Path) -> Result<Self> {
        let file =
            File::create(path).with_context(|| format!("{}: cannot create", path.display()))?;
        Ok(Self {
            path: path.to_owned(),
            out: BufWriter::new(file),
            finished: false,
        })
    }

    /// Writes what is buffered and keeps the file.
    ///
    /// # Errors
    /// I/O; the message names the file.
    pub fn finish(mut self) -> Result<()> {
        self.flush()?;
        self.finished = true;
        Ok(())
    }

    fn named(&self, error: &io::Error) -> io::Error {
        let name = self.path.display();
        io::Error::new(error.kind(), format!("{name}: cannot write: {error}"))
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.out.write(bytes).map_err(|error| self.named(&error))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush().map_err(|error| self.named(&error))
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        if !self.finished {
            remove_partial(&self.path);
        }
    }
}

/// Refuses an output that is the input, which opening it for writing would destroy.
///
/// # Errors
/// Both paths lead to the same file; the message names it.
pub fn refuse_same_file(input: &Path, output: &Path) -> Result<()> {
    let same = input.canonicalize().ok().zip(output.canonicalize().ok());
    ensure!(
        same.is_none_or(|(input, output)| input != output),
        "{}: input and output are the same file: give the output another name",
        input.display()
    );
    Ok(())
}

/// Removes an output whose writing failed: a half file must not pass for a whole one.
///
/// Only a regular file: a device, a pipe or a link stays.
pub fn remove_partial(path: &Path) {
    if std::fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file()) {
        // The error that led here says what happened.
        let _ = std::fs::remove_file(path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_file_is_found_under_another_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.raw");
        std::fs::write(&file, "events").unwrap();
        let detour = folder.path().join(".").join("a.raw");
        let message = refuse_same_file(&file, &detour).unwrap_err();
        assert!(message.to_string().contains("a.raw"), "{message}");
        assert!(refuse_same_file(&file, &folder.path().join("b.raw")).is_ok());
    }

    #[test]
    fn what_is_not_finished_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.eecvs");
        let mut out = OutputFile::create(&path).unwrap();
        out.write_all(b"half").unwrap();
        drop(out);
        assert!(!path.exists());
        let mut out = OutputFile::create(&path).unwrap();
        out.write_all(b"whole").unwrap();
        out.finish().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"whole");
    }

    #[test]
    fn only_a_file_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("half.eecvs");
        std::fs::write(&file, "half").unwrap();
        remove_partial(&file);
        assert!(!file.exists());
        remove_partial(folder.path());
        assert!(folder.path().exists());
    }
}
