//! What segments are written to: files, or in tests what fails as disks do.

use std::fmt::Debug;
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::FileExt as _;
use std::path::Path;
use std::sync::Arc;

/// A place for segments.
pub(super) trait Medium: Debug + Send + Sync {
    /// Creates a file, which must not exist.
    fn create(&self, path: &Path) -> io::Result<Arc<dyn Writable>>;

    /// Makes what was created, renamed and removed in a folder outlast a power cut.
    fn sync_folder(&self, folder: &Path) -> io::Result<()>;
}

/// A file that is written to. It has a descriptor as long as it exists.
pub(super) trait Writable: Debug + Send + Sync {
    /// Writes all bytes at a place.
    fn write(&self, bytes: &[u8], place: u64) -> io::Result<()>;

    /// Cuts the file off after some bytes.
    fn cut(&self, bytes: u64) -> io::Result<()>;

    /// Makes what was written outlast a power cut.
    fn sync(&self) -> io::Result<()>;
}

/// Files of the system.
#[derive(Debug)]
pub(super) struct Files;

impl Medium for Files {
    fn create(&self, path: &Path) -> io::Result<Arc<dyn Writable>> {
        let mut options = OpenOptions::new();
        let file = options.write(true).create_new(true).open(path)?;
        Ok(Arc::new(file))
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        event_files::output::sync_folder(folder)
    }
}

impl Writable for File {
    fn write(&self, bytes: &[u8], place: u64) -> io::Result<()> {
        self.write_all_at(bytes, place)
    }

    fn cut(&self, bytes: u64) -> io::Result<()> {
        self.set_len(bytes)
    }

    fn sync(&self) -> io::Result<()> {
        self.sync_data()
    }
}
