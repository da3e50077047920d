//! Reads one list of bytes of an `.npz` as a stream, such as the causes of a recording's events.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use event_types::stream::{Context, Result};
use event_types::{bail, ensure, error};

use super::npy_header::{Descr, NpyHeader};
use crate::zipped::entry::{Entries, EntryReader};

/// The values of an array of shape (N,) and type uint8, in order. It ends after the last one; a wrong CRC-32 is an error
/// there.
pub struct ByteList {
    reader: EntryReader,
    name: String,
    values: u64,
    left: u64,
}

impl ByteList {
    /// Opens the array `array` of the file at `path`.
    ///
    /// # Errors
    /// The file cannot be read or is no `.npz`; it has no such array, or one of another shape or type. The message names the
    /// file.
    pub fn open(path: &Path, array: &str) -> Result<Self> {
        let name = path.display();
        let file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
        let entries = Entries::read(Box::new(file))
            .map_err(|what| error!(Damaged, "{name}: byte 0: damaged zip or npz file: {what}"))?;
        let title = |entry: &str| entry.strip_suffix(".npy").unwrap_or(entry).to_owned();
        let Some(entry) = entries.iter().find(|entry| title(&entry.name) == array) else {
            let titles: Vec<String> = entries.iter().map(|entry| title(&entry.name)).collect();
            bail!(
                Unsupported,
                "{name}: has no array {array}, but {}",
                titles.join(", ")
            );
        };
        let name = format!("{name}/{array}");
        let mut reader = entries.open(entry);
        let header = NpyHeader::read(&mut reader);
        let header = header.map_err(|what| error!(Damaged, "{name}: {what}"))?;
        let is_bytes = match header.descr {
            Descr::Plain(dtype) => dtype.is_unsigned() && dtype.bytes == 1,
            Descr::Fields(..) => false,
        };
        let values = match header.shape[..] {
            [values] if is_bytes => values,
            _ => bail!(
                Unsupported,
                "{name}: is no list of unsigned bytes, but of shape {:?}",
                header.shape
            ),
        };
        ensure!(
            reader.left() == values,
            Damaged,
            "{name}: has {} bytes, and its header states {values}",
            reader.left()
        );
        Ok(Self {
            reader,
            name,
            values,
            left: values,
        })
    }

    /// Returns the number of values.
    #[must_use]
    pub const fn values(&self) -> u64 {
        self.values
    }
}

impl Read for ByteList {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let most = usize::try_from(self.left).unwrap_or(usize::MAX);
        let most = most.min(bytes.len());
        let Some(bytes) = bytes.get_mut(..most).filter(|bytes| !bytes.is_empty()) else {
            return Ok(0);
        };
        let read = self.reader.read(bytes)?;
        if read == 0 {
            let what = format!(
                "{}: ends {} bytes early: damaged data",
                self.name, self.left
            );
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        self.left -= read as u64;
        if self.left == 0 && self.reader.is_damaged() {
            let what = format!("{}: the array's CRC-32 is wrong: damaged data", self.name);
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        Ok(read)
    }
}
