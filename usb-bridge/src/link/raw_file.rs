//! Files of a device's stream as it came, `.stream`: every byte, when it came, and what was lost.
//!
//! All numbers are little-endian; times are nanoseconds since the header's.
//!
//! ```text
//! header   8  "EECVSTRM"
//!          2  version, 1
//!          2  bytes of the header, all of it
//!          2  width, 2 height of the sensor in pixels
//!          8  time zero in nanoseconds since 1970
//!          6 strings, each 2 bytes of length and UTF-8: model, name, serial number (empty: none),
//!             firmware, stream, program that wrote the file
//!          4  CRC-32 of the header before it
//! record   4  "DATA", "LOSS", "INDX" or "TAIL"
//!          4  bytes of the payload
//!          8  time; of TAIL: offset of INDX in the file
//!          4  LOSS: cause (1 overflow, 2 damaged, 3 stalled, 4 injected); otherwise 0
//!          4  CRC-32 of the record before it, without the payload
//!             payload: DATA: bytes of the stream, at most 16 MiB, none of them checked
//!                      LOSS: 8 bytes, number of lost bytes, 2^64 - 1 where it is not known
//!                      INDX: entries of 24 bytes: time, offset of a DATA record, bytes of the stream
//!                            before it; one for each MiB of the stream
//!                      TAIL: none
//! ```
//!
//! A header, records in order of time, one INDX, one TAIL. A file that is cut off anywhere is read up
//! to there, without an index; a damaged record is skipped up to the next one and told as a loss.

use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::time::Duration;

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use eecvs_nostd::Sensor;
use thiserror::Error;

use super::Loss;
use crate::device::Info;

const MAGIC: [u8; 8] = *b"EECVSTRM";
const VERSION: u16 = 1;
const FIXED: usize = 24;
const RECORD: usize = 24;
/// The largest payload of DATA.
const DATA_MAX: usize = 16 << 20;
/// Bytes of the stream between entries of the index.
const INDEX_STEP: u64 = 1 << 20;
const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// A file that is none of these, or cannot be read.
#[derive(Debug, Error)]
pub enum RawFileError {
    /// It cannot be read or written.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// It begins otherwise.
    #[error("byte 0: is no stream file: begins with other bytes than EECVSTRM")]
    Magic,
    /// A later program wrote it.
    #[error("byte 8: version {0} of stream files; this program reads version {VERSION}")]
    Version(u16),
    /// The header is cut off or damaged.
    #[error("byte {0}: the header is damaged; nothing says what the stream is of")]
    Header(u64),
}

/// What a file says of its stream.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Model, as on the command line.
    pub model: String,
    /// What the device said of itself; `stream` is its own field here.
    pub name: String,
    /// Serial number, where it has one.
    pub serial: Option<String>,
    /// Version of firmware and logic.
    pub firmware: String,
    /// Which stream it sent.
    pub stream: String,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// Time zero, in nanoseconds since 1970.
    pub started_ns: u64,
    /// Program that wrote it.
    pub program: String,
}

impl Header {
    /// The header of a capture that starts at `started_ns`.
    #[must_use]
    pub fn new(model: &str, info: &Info, started_ns: u64) -> Self {
        Self {
            model: model.to_owned(),
            name: info.name.clone(),
            serial: info.serial.clone(),
            firmware: info.firmware.clone(),
            stream: info.stream.to_owned(),
            sensor: info.sensor,
            started_ns,
            program: concat!("eecvs-usb ", env!("CARGO_PKG_VERSION")).to_owned(),
        }
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend([0; 2]);
        bytes.extend(self.sensor.width.to_le_bytes());
        bytes.extend(self.sensor.height.to_le_bytes());
        bytes.extend(self.started_ns.to_le_bytes());
        let serial = self.serial.clone().unwrap_or_default();
        let strings = [
            &self.model,
            &self.name,
            &serial,
            &self.firmware,
            &self.stream,
            &self.program,
        ];
        for string in strings {
            // A device's string descriptor has at most 126 characters.
            let mut length = string.len().min(1000);
            while !string.is_char_boundary(length) {
                length -= 1;
            }
            bytes.extend((length as u16).to_le_bytes());
            bytes.extend(&string.as_bytes()[..length]);
        }
        let length = (bytes.len() + 4) as u16;
        bytes[10..12].copy_from_slice(&length.to_le_bytes());
        bytes.extend(CRC.checksum(&bytes).to_le_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (body, crc) = bytes.split_last_chunk::<4>()?;
        if CRC.checksum(body) != u32::from_le_bytes(*crc) {
            return None;
        }
        let mut strings = Vec::new();
        let mut rest = body.get(FIXED..)?;
        for _ in 0..6 {
            let (length, after) = rest.split_first_chunk::<2>()?;
            let (string, after) = after.split_at_checked(u16::from_le_bytes(*length).into())?;
            strings.push(String::from_utf8(string.to_vec()).ok()?);
            rest = after;
        }
        let [model, name, serial, firmware, stream, program] = strings.try_into().ok()?;
        Some(Self {
            model,
            name,
            serial: Some(serial).filter(|serial| !serial.is_empty()),
            firmware,
            stream,
            program,
            sensor: Sensor {
                width: u16::from_le_bytes(body.get(12..14)?.try_into().ok()?),
                height: u16::from_le_bytes(body.get(14..16)?.try_into().ok()?),
            },
            started_ns: u64::from_le_bytes(body.get(16..24)?.try_into().ok()?),
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mark {
    Data,
    Loss,
    Index,
    Tail,
}

/// The fixed part of a record.
#[derive(Debug, Clone, Copy)]
struct Fixed {
    mark: Mark,
    length: u32,
    time: u64,
    detail: u32,
}

impl Fixed {
    fn to_bytes(self) -> [u8; RECORD] {
        let mark = match self.mark {
            Mark::Data => *b"DATA",
            Mark::Loss => *b"LOSS",
            Mark::Index => *b"INDX",
            Mark::Tail => *b"TAIL",
        };
        let mut bytes = [0; RECORD];
        bytes[..4].copy_from_slice(&mark);
        bytes[4..8].copy_from_slice(&self.length.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.time.to_le_bytes());
        bytes[16..20].copy_from_slice(&self.detail.to_le_bytes());
        let crc = CRC.checksum(&bytes[..20]);
        bytes[20..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mark = match bytes.get(..4)? {
            b"DATA" => Mark::Data,
            b"LOSS" => Mark::Loss,
            b"INDX" => Mark::Index,
            b"TAIL" => Mark::Tail,
            _ => return None,
        };
        let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
        if word(20)? != CRC.checksum(bytes.get(..20)?) {
            return None;
        }
        Some(Self {
            mark,
            length: word(4)?,
            time: u64::from_le_bytes(bytes.get(8..16)?.try_into().ok()?),
            detail: word(16)?,
        })
    }
}

const CAUSES: [(Loss, u32); 4] = [
    (Loss::Overflow, 1),
    (Loss::Damaged, 2),
    (Loss::Stalled, 3),
    (Loss::Injected, 4),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Entry {
    time: u64,
    offset: u64,
    stream: u64,
}

/// Writes a stream file. Without [`RawWriter::finish`] it has no index, and is readable.
pub struct RawWriter<W> {
    out: W,
    offset: u64,
    stream: u64,
    index: Vec<Entry>,
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

impl<W: Write> RawWriter<W> {
    /// Begins a file. `out` should be buffered.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn new(mut out: W, header: &Header) -> io::Result<Self> {
        let bytes = header.to_bytes();
        out.write_all(&bytes)?;
        Ok(Self {
            out,
            offset: bytes.len() as u64,
            stream: 0,
            index: Vec::new(),
        })
    }

    fn record(&mut self, fixed: Fixed, payload: &[u8]) -> io::Result<()> {
        self.out.write_all(&fixed.to_bytes())?;
        self.out.write_all(payload)?;
        self.offset += (RECORD + payload.len()) as u64;
        Ok(())
    }

    /// Adds bytes that came at `time` since time zero.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn bytes(&mut self, time: Duration, bytes: &[u8]) -> io::Result<()> {
        let time = nanoseconds(time);
        for part in bytes.chunks(DATA_MAX) {
            let due = self.index.last().map_or(0, |last| last.stream + INDEX_STEP);
            if self.stream >= due {
                self.index.push(Entry {
                    time,
                    offset: self.offset,
                    stream: self.stream,
                });
            }
            let fixed = Fixed {
                mark: Mark::Data,
                length: part.len() as u32,
                time,
                detail: 0,
            };
            self.record(fixed, part)?;
            self.stream += part.len() as u64;
        }
        Ok(())
    }

    /// Adds that bytes were lost before the next ones.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn lost(&mut self, time: Duration, bytes: Option<u64>, cause: Loss) -> io::Result<()> {
        let detail = CAUSES
            .iter()
            .find(|one| one.0 == cause)
            .map_or(0, |one| one.1);
        let fixed = Fixed {
            mark: Mark::Loss,
            length: 8,
            time: nanoseconds(time),
            detail,
        };
        self.record(fixed, &bytes.unwrap_or(u64::MAX).to_le_bytes())
    }

    /// Bytes of the stream so far.
    pub const fn stream_bytes(&self) -> u64 {
        self.stream
    }

    /// Ends the file with its index, and gives the writer back, flushed.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(mut self) -> io::Result<W> {
        let offset = self.offset;
        let payload: Vec<u8> = self
            .index
            .iter()
            .flat_map(|entry| [entry.time, entry.offset, entry.stream])
            .flat_map(u64::to_le_bytes)
            .collect();
        // Four thousand terabytes of stream have a longer index: none is better than a part.
        let length = u32::try_from(payload.len()).unwrap_or(0);
        let fixed = |mark, length, time| Fixed {
            mark,
            length,
            time,
            detail: 0,
        };
        self.record(fixed(Mark::Index, length, 0), &payload[..length as usize])?;
        self.record(fixed(Mark::Tail, 0, offset), &[])?;
        self.out.flush()?;
        Ok(self.out)
    }
}

/// What a stream file has next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Record {
    /// Bytes of the stream, in the caller's buffer.
    Bytes {
        /// When they came, since time zero.
        time: Duration,
    },
    /// Bytes were lost before the next ones.
    Lost {
        /// When that was found, since time zero.
        time: Duration,
        /// How many, where it is known.
        bytes: Option<u64>,
        /// Why.
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
    /// Opens a file.
    ///
    /// # Errors
    /// As for [`RawReader::new`].
    pub fn open(path: &Path) -> Result<Self, RawFileError> {
        Self::new(BufReader::with_capacity(1 << 18, File::open(path)?))
    }
}

/// Fills `bytes` as far as there is something; returns how far.
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
    /// Reads the header, and the index where there is one.
    ///
    /// # Errors
    /// It cannot be read, is no stream file, or its header is damaged.
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

    /// What the file says of its stream.
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// Where the file is cut off, once its end was read: the offset of the first record that is not
    /// whole, or of the end where the index would be.
    pub const fn cut(&self) -> Option<u64> {
        self.cut
    }

    /// Whether there is an index to seek by; without one, seeking reads every record before.
    pub const fn is_indexed(&self) -> bool {
        !self.index.is_empty()
    }

    /// The fixed part of the record here; `None` at the end, which it notes, and where it is damaged.
    fn fixed(&mut self) -> io::Result<Result<Fixed, bool>> {
        let mut bytes = [0; RECORD];
        let got = read_up_to(&mut self.input, &mut bytes)?;
        if got < RECORD {
            self.cut.get_or_insert(self.position);
            return Ok(Err(true));
        }
        Ok(Fixed::from_bytes(&bytes).ok_or(false))
    }

    /// The next record; `bytes` gets the stream's and is empty otherwise. `None` at the end.
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
                    // Whatever else it may hold in later versions.
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

    /// Goes to the next record that is whole.
    fn skip_damage(&mut self) -> io::Result<Record> {
        let damaged = self.position;
        let mut base = damaged + 1;
        let mut window = vec![0; 1 << 16];
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
                    // With the record's own bytes: no more than this.
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
        }
    }

    /// Goes to the first record at or after `time`.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn seek(&mut self, time: Duration) -> io::Result<()> {
        let time = nanoseconds(time);
        // Several entries may have the same time: the first of them.
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
                // `next` tells of the end and of damage.
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

#[cfg(test)]
#[path = "raw_file_tests.rs"]
pub(crate) mod tests;
