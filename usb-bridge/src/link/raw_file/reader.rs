//! Reads stream files.

use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;
use std::time::Duration;

use super::writer::nanoseconds;
use super::{CAUSES, Entry, FIXED, Fixed, Header, MAGIC, Mark, RECORD, RawFileError, VERSION};
use crate::link::Loss;

/// The next record of a stream file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Record {
    /// Bytes of the stream, written to the caller's buffer.
    Bytes {
        /// When they arrived, after time zero.
        time: Duration,
    },
    /// Bytes are missing before the next ones.
    Lost {
        /// When the loss was found, after time zero.
        time: Duration,
        /// Number of lost bytes, if known.
        bytes: Option<u64>,
        /// Cause of the loss.
        cause: Loss,
    },
}

/// Reads a stream file.
pub struct RawReader<R> {
    input: R,
    header: Header,
    first: u64,
    position: u64,
    index: Vec<Entry>,
    cut: Option<u64>,
    complete: bool,
}

impl RawReader<BufReader<File>> {
    /// Opens a stream file.
    ///
    /// # Errors
    /// As for [`RawReader::new`].
    pub fn open(path: &Path) -> Result<Self, RawFileError> {
        Self::new(BufReader::with_capacity(1 << 18, File::open(path)?))
    }
}

/// Reads until `bytes` is full or the input ends; returns the number of bytes read.
fn read_up_to(input: &mut impl Read, bytes: &mut [u8]) -> io::Result<usize> {
    let mut got = 0;
    while got < bytes.len() {
        match input.read(&mut bytes[got..]) {
            Ok(0) => break,
            Ok(more) => got += more,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(got)
}

impl<R: Read + Seek> RawReader<R> {
    /// Reads the header, and the index if there is one.
    ///
    /// # Errors
    /// The input cannot be read, is not a stream file, or its header is damaged.
    pub fn new(mut input: R) -> Result<Self, RawFileError> {
        let mut bytes = vec![0; FIXED];
        let got = read_up_to(&mut input, &mut bytes)?;
        if !bytes[..got].starts_with(&MAGIC) {
            return Err(RawFileError::Magic);
        }
        let short = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        if got == FIXED && short(8) != VERSION {
            return Err(RawFileError::Version(short(8)));
        }
        let length = usize::from(short(10));
        if got < FIXED || length < FIXED {
            return Err(RawFileError::Header(got as u64));
        }
        bytes.resize(length, 0);
        let got = FIXED + read_up_to(&mut input, &mut bytes[FIXED..])?;
        let header = Header::from_bytes(&bytes).filter(|_| got == length);
        let mut reader = Self {
            header: header.ok_or(RawFileError::Header(got as u64))?,
            first: length as u64,
            position: length as u64,
            index: Vec::new(),
            cut: None,
            complete: false,
            input,
        };
        reader.index = reader.read_index()?.unwrap_or_default();
        reader.go_to(reader.first)?;
        Ok(reader)
    }

    fn read_index(&mut self) -> io::Result<Option<Vec<Entry>>> {
        let end = self.input.seek(SeekFrom::End(0))?;
        let Some(tail) = end.checked_sub(RECORD as u64) else {
            return Ok(None);
        };
        let mut fixed = [0; RECORD];
        self.input.seek(SeekFrom::Start(tail))?;
        read_up_to(&mut self.input, &mut fixed)?;
        let Some(tail) = Fixed::from_bytes(&fixed).filter(|tail| tail.mark == Mark::Tail) else {
            return Ok(None);
        };
        self.input.seek(SeekFrom::Start(tail.time.min(end)))?;
        read_up_to(&mut self.input, &mut fixed)?;
        let Some(index) = Fixed::from_bytes(&fixed).filter(|one| one.mark == Mark::Index) else {
            return Ok(None);
        };
        let mut payload = Vec::new();
        let length = u64::from(index.length);
        self.input.by_ref().take(length).read_to_end(&mut payload)?;
        let entries = payload.as_chunks::<8>().0.as_chunks::<3>().0;
        let entries = entries.iter().map(|entry| {
            let [time, offset, stream] = entry.map(u64::from_le_bytes);
            Entry {
                time,
                offset,
                stream,
            }
        });
        Ok((payload.len() as u64 == length).then(|| entries.collect()))
    }

    fn go_to(&mut self, position: u64) -> io::Result<()> {
        self.position = self.input.seek(SeekFrom::Start(position))?;
        Ok(())
    }

    /// Returns the file's header, which describes its stream.
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// Returns where the file is cut off, once its end was read: the offset of the first incomplete record, or the
    /// end of the file if only the index is missing.
    pub const fn cut(&self) -> Option<u64> {
        self.cut
    }

    /// Returns whether the file has an index; without one, seeking walks through all records from the first one on.
    pub const fn is_indexed(&self) -> bool {
        !self.index.is_empty()
    }

    /// Reads the fixed part of the record here. `Err(true)` means the end of the file, which is noted as a cut;
    /// `Err(false)` means a damaged record.
    fn fixed(&mut self) -> io::Result<Result<Fixed, bool>> {
        let mut bytes = [0; RECORD];
        let got = read_up_to(&mut self.input, &mut bytes)?;
        if got < RECORD {
            self.cut.get_or_insert(self.position);
            return Ok(Err(true));
        }
        Ok(Fixed::from_bytes(&bytes).ok_or(false))
    }

    /// Reads the next record; `None` at the end. `bytes` is cleared, and filled if the record holds bytes of the
    /// stream.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn next(&mut self, bytes: &mut Vec<u8>) -> io::Result<Option<Record>> {
        bytes.clear();
        if self.complete || self.cut.is_some() {
            return Ok(None);
        }
        loop {
            let fixed = match self.fixed()? {
                Ok(fixed) => fixed,
                Err(true) => return Ok(None),
                Err(false) => return self.skip_damage().map(Some),
            };
            let time = Duration::from_nanos(fixed.time);
            let start = self.position;
            let length = u64::from(fixed.length);
            match fixed.mark {
                Mark::Data => {
                    let got = self.input.by_ref().take(length).read_to_end(bytes)? as u64;
                    self.position = start + RECORD as u64 + got;
                    if got < length {
                        self.cut = Some(start);
                    }
                    if got > 0 {
                        return Ok(Some(Record::Bytes { time }));
                    }
                    if self.cut.is_some() {
                        return Ok(None);
                    }
                }
                Mark::Loss => {
                    let mut count = [0; 8];
                    let got = read_up_to(&mut self.input, &mut count)?;
                    if got < count.len() {
                        self.cut = Some(start);
                        return Ok(None);
                    }
                    // Skips fields that later versions may add.
                    self.go_to(start + RECORD as u64 + length.max(8))?;
                    let cause = CAUSES.iter().find(|one| one.1 == fixed.detail);
                    return Ok(Some(Record::Lost {
                        time,
                        bytes: Some(u64::from_le_bytes(count)).filter(|&count| count != u64::MAX),
                        cause: cause.map_or(Loss::Damaged, |one| one.0),
                    }));
                }
                Mark::Index => self.go_to(start + RECORD as u64 + length)?,
                Mark::Tail => {
                    self.complete = true;
                    return Ok(None);
                }
            }
        }
    }

    /// Skips damage up to the next whole record and reports it as a loss.
    fn skip_damage(&mut self) -> io::Result<Record> {
        let damaged = self.position;
        let mut base = damaged + 1;
        let mut window = vec![0; 1 << 10];
        loop {
            self.go_to(base)?;
            let got = read_up_to(&mut self.input, &mut window)?;
            let found = (0..=got.saturating_sub(RECORD))
                .find_map(|at| Some((at, Fixed::from_bytes(window.get(at..at + RECORD)?)?)))
                .filter(|(at, _)| at + RECORD <= got);
            if let Some((at, fixed)) = found {
                self.go_to(base + at as u64)?;
                let of_stream = matches!(fixed.mark, Mark::Data | Mark::Loss);
                return Ok(Record::Lost {
                    time: Duration::from_nanos(if of_stream { fixed.time } else { 0 }),
                    // An upper bound: it includes the damaged records' own headers.
                    bytes: Some(self.position - damaged),
                    cause: Loss::Damaged,
                });
            }
            if got < window.len() {
                self.cut = Some(damaged);
                return Ok(Record::Lost {
                    time: Duration::ZERO,
                    bytes: Some((base + got as u64) - damaged),
                    cause: Loss::Damaged,
                });
            }
            base += (got - (RECORD - 1)) as u64;
            // Twice as much each time, so that what lies close by takes no long reads.
            window.resize((2 * window.len()).min(1 << 16), 0);
        }
    }

    /// Seeks to the first record at or after `time`.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn seek(&mut self, time: Duration) -> io::Result<()> {
        let time = nanoseconds(time);
        // Entries may share a time; this starts before the first of them.
        let after = self.index.partition_point(|entry| entry.time < time);
        let start = after
            .checked_sub(1)
            .map_or(self.first, |entry| self.index[entry].offset);
        (self.cut, self.complete) = (None, false);
        self.go_to(start)?;
        loop {
            let here = self.position;
            let skipped = match self.fixed()? {
                Ok(fixed) if matches!(fixed.mark, Mark::Data | Mark::Loss) => {
                    (fixed.time < time).then_some(fixed.length)
                }
                // `next` reports the end and damage.
                _ => None,
            };
            self.cut = None;
            let Some(length) = skipped else {
                return self.go_to(here);
            };
            self.go_to(here + RECORD as u64 + u64::from(length))?;
        }
    }
}
