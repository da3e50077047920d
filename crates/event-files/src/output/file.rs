//! A file of bytes that a command writes.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use event_types::stream::Result;

use super::{Output, is_stdout};

/// A file that is being written and whose errors name it. If it is dropped before [`OutputFile::finish`], it is
/// removed.
#[derive(Debug)]
pub struct OutputFile {
    // Declared first, so that it is closed before the output is removed or renamed.
    out: BufWriter<File>,
    output: Output,
}

impl OutputFile {
    /// Begins a file that appears under its name only when it is complete, like [`Output::begin`].
    ///
    /// # Errors
    /// The file cannot be created; the message names it.
    pub fn create(path: &Path) -> Result<Self> {
        Self::of(Output::begin(path)?)
    }

    fn of(output: Output) -> Result<Self> {
        let file = output.file()?;
        Ok(Self {
            out: BufWriter::with_capacity(1 << 16, file),
            output,
        })
    }

    /// Returns whether the output is a device or a pipe, like [`Output::is_direct`].
    #[must_use]
    pub const fn is_direct(&self) -> bool {
        self.output.is_direct()
    }

    /// Flushes the buffer and gives the file its name.
    ///
    /// # Errors
    /// The file cannot be written or renamed; the message names it.
    pub fn finish(mut self) -> Result<()> {
        self.flush()?;
        let Self { out, output } = self;
        drop(out);
        output.keep()
    }

    /// Finishes one of the many files of a run, like [`Output::keep_unsynced`].
    ///
    /// # Errors
    /// The file cannot be written or renamed; the message names it.
    pub fn finish_unsynced(mut self) -> Result<()> {
        self.flush()?;
        let Self { out, output } = self;
        drop(out);
        output.keep_unsynced().map(drop)
    }

    /// Finishes a file that holds only what precedes damage in its input, like [`Output::keep_incomplete`]; returns
    /// its name.
    ///
    /// # Errors
    /// The file cannot be written or renamed; the message names it.
    pub fn finish_incomplete(mut self) -> Result<PathBuf> {
        self.flush()?;
        let Self { out, output } = self;
        drop(out);
        output.keep_incomplete()
    }

    fn named(&self, error: &io::Error) -> io::Error {
        let name = self.output.name().display();
        // The reader of stdout may stop early on purpose; a named pipe's reader is expected to take everything.
        let kind = match error.kind() {
            io::ErrorKind::BrokenPipe if !is_stdout(self.output.name()) => io::ErrorKind::Other,
            kind => kind,
        };
        io::Error::new(kind, format!("{name}: cannot write: {error}"))
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes);
        let written = written.map_err(|error| self.named(&error))?;
        // A pipe's reader must not wait for the buffer to fill.
        if self.output.is_direct() {
            self.flush()?;
        }
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush().map_err(|error| self.named(&error))
    }
}

/// Writes a whole file and replaces an existing one.
///
/// # Errors
/// The file cannot be created or written; the message names it.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> Result<()> {
    let mut file = OutputFile::create(path)?;
    file.write_all(bytes.as_ref())?;
    file.finish()
}

/// Writes a whole file that only its owner may read, and replaces an existing one.
///
/// # Errors
/// The file cannot be created or written; the message names it.
pub fn write_private(path: &Path, bytes: impl AsRef<[u8]>) -> Result<()> {
    let mut file = OutputFile::of(Output::begin_private(path)?)?;
    file.write_all(bytes.as_ref())?;
    file.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_finished_is_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.eecvs");
        let mut out = OutputFile::create(&path).unwrap();
        out.write_all(b"half").unwrap();
        drop(out);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        write(&path, "whole").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"whole");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_an_error_that_names_the_file() {
        let error = write(Path::new("/dev/full"), "bytes").unwrap_err();
        assert!(error.to_string().contains("/dev/full"), "{error}");
    }
}
