//! Reads a recording from a pipe, which delivers each byte only once.

use std::fs::File;
use std::io::{self, Error, ErrorKind, Read, Result as IoResult, Seek, SeekFrom};
use std::path::Path;

use event_types::ensure;
use event_types::stream::{Context, Result};

use crate::output::is_dash;
use crate::output::temporary::copy;

/// At least this many of the latest bytes are kept for reading again; the first bytes are dropped once twice as
/// many are kept.
const KEPT_BYTES: usize = 1 << 20;

/// Number of bytes requested from the pipe at a time.
const READ_BYTES: usize = 1 << 16;

/// Name of stdin in messages.
pub const STDIN: &str = "stdin";

/// Returns whether a path leads to a source that delivers each byte only once: stdin under the name `-`, a named
/// pipe, a terminal.
#[must_use]
pub fn is_stream(path: &Path) -> bool {
    let is_special = |path: &Path| {
        let metadata = std::fs::metadata(path);
        metadata.is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
    };
    is_dash(path) || is_special(path)
}

/// Returns a path's name in messages.
#[must_use]
pub fn name_of(path: &Path) -> String {
    if is_dash(path) {
        return STDIN.to_owned();
    }
    path.display().to_string()
}

/// Opens a file or a pipe, or stdin under the name `-`.
///
/// # Errors
/// The path cannot be opened, or is a folder.
pub fn open_bytes(path: &Path) -> Result<File> {
    let name = name_of(path);
    let file = if is_dash(path) {
        stdin()
    } else {
        File::open(path)
    };
    let file = file.with_context(|| format!("{name}: cannot be opened"))?;
    let is_folder = file.metadata().is_ok_and(|metadata| metadata.is_dir());
    ensure!(!is_folder, Refused, "{name}: is a folder, not a file");
    Ok(file)
}

#[cfg(unix)]
fn stdin() -> IoResult<File> {
    use std::os::fd::AsFd;
    Ok(File::from(io::stdin().as_fd().try_clone_to_owned()?))
}

#[cfg(windows)]
fn stdin() -> IoResult<File> {
    use std::os::windows::io::AsHandle;
    Ok(File::from(io::stdin().as_handle().try_clone_to_owned()?))
}

/// A pipe that can be read like a file as long as its reader moves forwards. Memory holds the latest 1 to 2 MiB;
/// older bytes cannot be read again.
pub struct Piped {
    source: Box<dyn Read + Send>,
    kept: Vec<u8>,
    /// Offset in the pipe of the first byte of `kept`.
    kept_at: u64,
    at: u64,
    ended: bool,
}

impl Piped {
    /// Opens a pipe without reading from it.
    ///
    /// # Errors
    /// Those of [`open_bytes`].
    pub fn open(path: &Path) -> Result<Self> {
        Ok(Self::new(Box::new(open_bytes(path)?)))
    }

    /// Creates a pipe that reads from `source`.
    #[must_use]
    pub fn new(source: Box<dyn Read + Send>) -> Self {
        Self {
            source,
            kept: Vec::new(),
            kept_at: 0,
            at: 0,
            ended: false,
        }
    }

    /// Returns the first `count` bytes, or fewer if the pipe ends before, and waits for them; the next read starts
    /// with them. `count` must not exceed what the pipe keeps, and none of these bytes may have been dropped.
    ///
    /// # Errors
    /// I/O.
    pub fn front(&mut self, count: usize) -> IoResult<&[u8]> {
        self.at = 0;
        while self.kept.len() < count && !self.ended {
            self.grow()?;
        }
        Ok(self.kept.get(..count).unwrap_or(&self.kept))
    }

    fn arrived(&self) -> u64 {
        self.kept_at + self.kept.len() as u64
    }

    /// Waits for more bytes or the end.
    fn grow(&mut self) -> IoResult<()> {
        if self.kept.len() >= 2 * KEPT_BYTES {
            let passed = self.kept.len() - KEPT_BYTES;
            self.kept.drain(..passed);
            self.kept_at += passed as u64;
        }
        let len = self.kept.len();
        self.kept.resize(len + READ_BYTES, 0);
        let room = self.kept.get_mut(len..).unwrap_or_default();
        let read = loop {
            match self.source.read(room) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                read => break read,
            }
        };
        let count = *read.as_ref().unwrap_or(&0);
        self.kept.truncate(len + count);
        self.ended = read? == 0;
        Ok(())
    }
}

impl Read for Piped {
    fn read(&mut self, bytes: &mut [u8]) -> IoResult<usize> {
        if bytes.is_empty() {
            return Ok(0);
        }
        while self.at >= self.arrived() {
            if self.ended {
                return Ok(0);
            }
            self.grow()?;
        }
        let passed = self.at.checked_sub(self.kept_at);
        let passed = passed.and_then(|passed| usize::try_from(passed).ok());
        let Some(held) = passed.and_then(|passed| self.kept.get(passed..)) else {
            return Err(Error::other(
                "a pipe can be read only once, and these bytes have passed: save it to a file \
                 first",
            ));
        };
        let count = held.len().min(bytes.len());
        if let (Some(to), Some(from)) = (bytes.get_mut(..count), held.get(..count)) {
            to.copy_from_slice(from);
        }
        self.at += count as u64;
        Ok(count)
    }
}

/// The end is after the latest byte that has arrived, as in a file that grows.
impl Seek for Piped {
    fn seek(&mut self, to: SeekFrom) -> IoResult<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.arrived().checked_add_signed(by),
        };
        self.at = at.ok_or_else(|| Error::from(ErrorKind::InvalidInput))?;
        Ok(self.at)
    }
}

/// Copies all of a pipe to an unnamed temporary file.
///
/// # Errors
/// I/O.
pub fn whole(mut pipe: impl Read + Seek, name: &str) -> Result<File> {
    pipe.rewind()
        .with_context(|| format!("{name}: cannot be read"))?;
    let mut file = tempfile::tempfile()
        .with_context(|| format!("{name}: no temporary file can be created for it"))?;
    copy(&mut pipe, &mut file, name)
        .with_context(|| format!("{name}: cannot be copied to a temporary file"))?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    /// A source that returns at most 7,001 bytes at a time, as pipes may.
    struct Slow(Cursor<Vec<u8>>);

    impl Read for Slow {
        fn read(&mut self, bytes: &mut [u8]) -> IoResult<usize> {
            let count = bytes.len().min(7_001);
            self.0.read(&mut bytes[..count])
        }
    }

    fn bytes(count: usize) -> Vec<u8> {
        (0..count).map(|i| (i * i / 251) as u8).collect()
    }

    #[test]
    fn a_pipe_reads_as_a_file_does_while_it_goes_forward() {
        let expected = bytes(5 * KEPT_BYTES + 3);
        let mut pipe = Piped::new(Box::new(Slow(Cursor::new(expected.clone()))));
        assert_eq!(pipe.front(4096).unwrap(), &expected[..4096]);
        assert_eq!(pipe.front(10).unwrap(), &expected[..10]);
        let mut all = Vec::new();
        pipe.read_to_end(&mut all).unwrap();
        assert!(all == expected);
        assert!(pipe.kept.len() < 3 * KEPT_BYTES);
        // The latest bytes are kept, earlier ones have passed.
        let end = pipe.seek(SeekFrom::End(-100)).unwrap();
        all.clear();
        pipe.read_to_end(&mut all).unwrap();
        assert_eq!(all, &expected[end as usize..]);
        pipe.rewind().unwrap();
        let error = pipe.read(&mut [0]).unwrap_err();
        assert!(error.to_string().contains("have passed"), "{error}");
    }

    #[test]
    fn a_pipe_can_be_kept_whole() {
        let expected = bytes(300_000);
        let mut pipe = Piped::new(Box::new(Cursor::new(expected.clone())));
        pipe.front(100).unwrap();
        let mut file = whole(pipe, "a").unwrap();
        file.rewind().unwrap();
        let mut all = Vec::new();
        file.read_to_end(&mut all).unwrap();
        assert!(all == expected);
    }
}
