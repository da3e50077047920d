//! A file written from front to back, whose errors name it and whose bytes are counted.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

use event_types::stream::{Context, Result};

use crate::{BUFFER_BYTES, create_file};

/// A file that is being written.
pub struct Output {
    file: BufWriter<File>,
    name: String,
    position: u64,
}

impl Output {
    /// Creates the file.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(path: &Path) -> Result<Self> {
        let (file, name) = create_file(path)?;
        Ok(Self::of(file, name))
    }

    /// Continues with an empty file, which messages call `name`.
    pub fn new(file: File, name: String) -> Self {
        Self::of(BufWriter::with_capacity(BUFFER_BYTES, file), name)
    }

    const fn of(file: BufWriter<File>, name: String) -> Self {
        Self {
            file,
            name,
            position: 0,
        }
    }

    /// Returns the name for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the number of bytes written with [`Output::put`].
    pub const fn position(&self) -> u64 {
        self.position
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn put(&mut self, bytes: &[u8]) -> Result<()> {
        let written = self.file.write_all(bytes);
        self.position += bytes.len() as u64;
        self.said(written)
    }

    /// Overwrites the bytes from `at` on; nothing may be appended afterwards.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn put_at(&mut self, at: u64, bytes: &[u8]) -> Result<()> {
        let sought = self.file.seek(SeekFrom::Start(at));
        let written = sought.and_then(|_| self.file.write_all(bytes));
        self.said(written)
    }

    /// Flushes the buffer.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(&mut self) -> Result<()> {
        let flushed = self.file.flush();
        self.said(flushed)
    }

    fn said(&self, result: std::io::Result<()>) -> Result<()> {
        result.with_context(|| format!("{}: cannot be written", self.name))
    }
}
