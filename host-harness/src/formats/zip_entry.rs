//! Entries of a zip file, several of them read at once from one source.
//!
//! The crate `zip` finds the entries, but lends its source to one entry at a time; columns of an
//! npz must be read in step. So each entry gets its own view of the source and its own inflater.

use std::io::{self, BufReader, Read};
use std::sync::{Arc, Mutex};

use flate2::Crc;
use flate2::bufread::DeflateDecoder;
use zip::CompressionMethod;

use super::input::ReadSeek;
use super::section::{Section, Shared};

/// Bytes read from the source at once.
const BUFFER_BYTES: usize = 1 << 15;

/// The entries of a zip file.
pub struct Entries {
    source: Shared,
    entries: Vec<Entry>,
}

/// Where an entry lies.
#[derive(Debug, Clone)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// Offset of its first byte in the zip file.
    pub start: u64,
    stored: u64,
    size: u64,
    crc: u32,
    deflated: bool,
}

impl Entries {
    /// Reads the directory. Encrypted entries and methods other than deflate are an error.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn read(source: Box<dyn ReadSeek>) -> Result<Self, String> {
        let mut archive = zip::ZipArchive::new(source).map_err(|error| error.to_string())?;
        let mut entries = Vec::new();
        for index in 0..archive.len() {
            let file = archive
                .by_index_raw(index)
                .map_err(|error| error.to_string())?;
            let name = file.name().map_err(|error| error.to_string())?.into_owned();
            let deflated = match file.compression() {
                _ if file.encrypted() => return Err(format!("{name} is encrypted")),
                CompressionMethod::Stored => false,
                CompressionMethod::Deflated => true,
                other => return Err(format!("{name} is packed with {other}: use numpy's savez")),
            };
            let start = file
                .data_start()
                .ok_or_else(|| format!("{name} has no data"))?;
            let (stored, size, crc) = (file.compressed_size(), file.size(), file.crc32());
            entries.push(Entry {
                name,
                start,
                stored,
                size,
                crc,
                deflated,
            });
        }
        Ok(Self {
            source: Arc::new(Mutex::new(archive.into_inner())),
            entries,
        })
    }

    /// Every entry.
    pub fn iter(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter()
    }

    /// Reads an entry from its start.
    pub fn open(&self, entry: &Entry) -> EntryReader {
        let section = Section::new(&self.source, entry.start, entry.stored);
        let section = BufReader::with_capacity(BUFFER_BYTES, section);
        let data = if entry.deflated {
            Data::Deflated(Box::new(DeflateDecoder::new(section)))
        } else {
            Data::Stored(section)
        };
        EntryReader {
            data,
            crc: Crc::new(),
            want: entry.crc,
            left: entry.size,
        }
    }
}

enum Data {
    Stored(BufReader<Section>),
    Deflated(Box<DeflateDecoder<BufReader<Section>>>),
}

/// The bytes of an entry; [`EntryReader::is_damaged`] judges them at the end.
pub struct EntryReader {
    data: Data,
    crc: Crc,
    want: u32,
    left: u64,
}

impl EntryReader {
    /// Whether every byte has been read and the CRC-32 says that some of them are wrong.
    pub fn is_damaged(&self) -> bool {
        self.left == 0 && self.crc.sum() != self.want
    }
}

impl Read for EntryReader {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let room = usize::try_from(self.left)
            .unwrap_or(usize::MAX)
            .min(bytes.len());
        let bytes = bytes.get_mut(..room).unwrap_or_default();
        if bytes.is_empty() {
            return Ok(0);
        }
        let read = match &mut self.data {
            Data::Stored(data) => data.read(bytes)?,
            Data::Deflated(data) => data.read(bytes)?,
        };
        if read == 0 {
            return Err(io::Error::new(
                io::ErrorKind::UnexpectedEof,
                "the entry is truncated",
            ));
        }
        self.crc.update(bytes.get(..read).unwrap_or_default());
        self.left -= read as u64;
        Ok(read)
    }
}
