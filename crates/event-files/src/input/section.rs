//! Sections of one source, several of which can be read at the same time.

use std::io::{self, Read, SeekFrom};
use std::sync::{Arc, Mutex, PoisonError};

use crate::input::ReadSeek;

/// A source that is shared by its sections.
pub type Shared = Arc<Mutex<Box<dyn ReadSeek>>>;

/// A section of a source, read from its start to its end.
pub struct Section {
    source: Shared,
    at: u64,
    left: u64,
}

impl Section {
    /// Creates a section of `length` bytes from byte `at` on.
    pub fn new(source: &Shared, at: u64, length: u64) -> Self {
        Self {
            source: Arc::clone(source),
            at,
            left: length,
        }
    }
}

impl Read for Section {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let room = usize::try_from(self.left)
            .unwrap_or(usize::MAX)
            .min(bytes.len());
        let bytes = bytes.get_mut(..room).unwrap_or_default();
        // A poisoned lock is fine: a thread that panicked while reading left no state but the position, which is
        // set here.
        let mut source = self.source.lock().unwrap_or_else(PoisonError::into_inner);
        source.seek(SeekFrom::Start(self.at))?;
        let read = source.read(bytes)?;
        self.at += read as u64;
        self.left -= read as u64;
        Ok(read)
    }
}
