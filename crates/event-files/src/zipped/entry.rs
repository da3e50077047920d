//! Reads several entries of a zip file at once from one source.
//!
//! The crate `zip` finds the entries but lends its source to one entry at a time, whereas the columns of an npz
//! file must be read in step. So each entry gets its own view of the source and its own inflater.

use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::sync::{Arc, Mutex};

use flate2::Crc;
use flate2::bufread::DeflateDecoder;
use zip::CompressionMethod;

use crate::input::following::ANOTHER;
use crate::input::section::{Section, Shared};
use crate::input::{ReadSeek, following};

/// Number of bytes read from the source at once.
const BUFFER_BYTES: usize = 1 << 15;

/// The entries of a zip file, or files that are read like entries.
pub struct Entries {
    entries: Vec<Entry>,
}

/// The place and attributes of an entry.
#[derive(Clone)]
pub struct Entry {
    /// The entry's name.
    pub name: String,
    /// Offset of its first byte in the zip file.
    pub start: u64,
    source: Shared,
    stored: u64,
    /// Unpacked size in bytes.
    pub size: u64,
    /// CRC-32; `None` unless the entry is part of a zip file.
    crc: Option<u32>,
    deflated: bool,
    /// Why the entry cannot be read, if it cannot.
    problem: Option<String>,
}

/// Size in bytes of a directory's end record without its comment, and of the longest comment.
const END_BYTES: u64 = 22;
const COMMENT_MAX: u64 = 0xffff;

/// Returns where a second zip file begins in a file that consists of two; `None` if that is not certain.
///
/// The end record of a directory states the directory's size and its offset from the start of its own zip file.
fn another(source: &mut dyn ReadSeek) -> io::Result<Option<u64>> {
    let length = source.seek(SeekFrom::End(0))?;
    let start = length.saturating_sub(END_BYTES + COMMENT_MAX);
    source.seek(SeekFrom::Start(start))?;
    let mut tail = Vec::new();
    source.read_to_end(&mut tail)?;
    let mut places = tail.windows(END_BYTES as usize);
    let Some(place) = places.rposition(|end| end.starts_with(b"PK\x05\x06")) else {
        return Ok(None);
    };
    let number = |at: usize| {
        let bytes = tail.get(place + at..place + at + 4);
        bytes
            .and_then(|bytes| bytes.try_into().ok())
            .map(u32::from_le_bytes)
    };
    let end = start + place as u64;
    let (Some(bytes), Some(offset)) = (number(12), number(16)) else {
        return Ok(None);
    };
    // Zip files of more than 4 GiB or 65,535 entries state these numbers in another record.
    let is_large = end >= 20 && following::is_at(source, end - 20, b"PK\x06\x07")?;
    if is_large || bytes == u32::MAX || offset == u32::MAX {
        return Ok(None);
    }
    let begins = end.checked_sub(u64::from(bytes) + u64::from(offset));
    let begins = begins.filter(|begins| *begins > 0);
    // Anything else before a zip file, such as the program of a self-extracting one, is not a recording.
    match begins {
        Some(at) if following::is_at(source, 0, b"PK\x03\x04")? => Ok(Some(at)),
        _ => Ok(None),
    }
}

impl Entries {
    /// Reads the directory. Encrypted entries, and methods other than deflate, are reported only when the entry is
    /// read.
    ///
    /// # Errors
    /// The file is not a valid zip file; the message says why.
    pub fn read(mut source: Box<dyn ReadSeek>) -> Result<Self, String> {
        if let Some(at) = another(source.as_mut()).map_err(|error| error.to_string())? {
            return Err(format!("byte {at}: {ANOTHER}"));
        }
        let mut archive = zip::ZipArchive::new(source).map_err(|error| error.to_string())?;
        let mut found = Vec::new();
        for index in 0..archive.len() {
            let file = archive
                .by_index_raw(index)
                .map_err(|error| error.to_string())?;
            let name = file.name().map_err(|error| error.to_string())?.into_owned();
            let (deflated, problem) = match file.compression() {
                _ if file.encrypted() => (false, Some("encrypted".to_owned())),
                CompressionMethod::Stored => (false, None),
                CompressionMethod::Deflated => (true, None),
                other => (
                    false,
                    Some(format!("packed with {other}: pack it with deflate instead")),
                ),
            };
            let start = file
                .data_start()
                .ok_or_else(|| format!("{name} has no data"))?;
            let (stored, size, crc) = (file.compressed_size(), file.size(), file.crc32());
            found.push((name, start, stored, size, crc, deflated, problem));
        }
        let source: Shared = Arc::new(Mutex::new(archive.into_inner()));
        let entry = |(name, start, stored, size, crc, deflated, problem)| Entry {
            name,
            start,
            source: Arc::clone(&source),
            stored,
            size,
            crc: Some(crc),
            deflated,
            problem,
        };
        Ok(Self {
            entries: found.into_iter().map(entry).collect(),
        })
    }

    /// Wraps files, with their names, as entries that are not packed.
    ///
    /// # Errors
    /// A file cannot seek.
    pub fn files(files: Vec<(String, Box<dyn ReadSeek>)>) -> io::Result<Self> {
        let mut entries = Vec::new();
        for (name, mut source) in files {
            let size = source.seek(SeekFrom::End(0))?;
            entries.push(Entry {
                name,
                start: 0,
                source: Arc::new(Mutex::new(source)),
                stored: size,
                size,
                crc: None,
                deflated: false,
                problem: None,
            });
        }
        Ok(Self { entries })
    }

    /// Returns all entries.
    pub fn iter(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter()
    }

    /// Opens an entry for reading from its start.
    pub fn open(&self, entry: &Entry) -> EntryReader {
        let section = Section::new(&entry.source, entry.start, entry.stored);
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
            problem: entry.problem.clone(),
        }
    }
}

enum Data {
    Stored(BufReader<Section>),
    Deflated(Box<DeflateDecoder<BufReader<Section>>>),
}

/// The bytes of an entry; [`EntryReader::is_damaged`] checks them at the end.
pub struct EntryReader {
    data: Data,
    crc: Crc,
    want: Option<u32>,
    left: u64,
    problem: Option<String>,
}

impl EntryReader {
    /// Returns the number of bytes that have not been read.
    pub const fn left(&self) -> u64 {
        self.left
    }

    /// Returns whether every byte has been read and the CRC-32 does not match.
    pub fn is_damaged(&self) -> bool {
        self.left == 0 && self.want.is_some_and(|want| self.crc.sum() != want)
    }
}

impl Read for EntryReader {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if let Some(problem) = &self.problem {
            return Err(io::Error::other(format!("the entry is {problem}")));
        }
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
        if self.want.is_some() {
            self.crc.update(bytes.get(..read).unwrap_or_default());
        }
        self.left -= read as u64;
        Ok(read)
    }
}
