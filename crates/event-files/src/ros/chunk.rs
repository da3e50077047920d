//! Bytes of a bag: of the file, or of a compressed chunk while one is being read.

use std::io::Read;

use event_types::stream::Result;

use super::decoder::MESSAGE_MAX;
use super::mcap_writer::CRC;
use crate::input::Input;

/// A file of records, some of them in compressed chunks.
pub struct Chunked {
    /// The file.
    pub input: Input,
    chunk: Option<Chunk>,
}

/// A decompressed chunk.
struct Chunk {
    bytes: Vec<u8>,
    next: usize,
    /// Position of the chunk's bytes in the file.
    offset: u64,
    /// Where and why the bytes end early, if they do: said when they have been read.
    fault: Option<(u64, String)>,
}

impl Chunk {
    /// The next `n` bytes; none where fewer are left.
    fn next(&mut self, n: u64) -> Option<&[u8]> {
        let rest = self.bytes.get(self.next..)?;
        let next = rest.get(..usize::try_from(n).ok()?)?;
        self.next += next.len();
        Some(next)
    }
}

/// Bytes read at once where they are only looked at.
const BLOCK_BYTES: usize = 1 << 16;

/// Longest index that is read: some 10^6 chunks.
const INDEX_MAX: u64 = 1 << 27;

/// Bytes by which memory grows, where a length is not yet known to be true.
const STEP_BYTES: usize = 1 << 20;

impl Chunked {
    /// Begins at the file's position.
    #[must_use]
    pub fn new(input: Input) -> Self {
        Self { input, chunk: None }
    }

    /// Whether the next bytes come from a compressed chunk.
    #[must_use]
    pub fn inside(&self) -> bool {
        self.chunk.is_some()
    }

    /// Position in the file: inside of a compressed chunk, the chunk's.
    #[must_use]
    pub fn offset(&self) -> u64 {
        match &self.chunk {
            Some(chunk) => chunk.offset,
            None => self.input.offset(),
        }
    }

    /// Whether there are more bytes; leaves a compressed chunk that has been read to its end.
    ///
    /// # Errors
    /// I/O.
    pub fn more(&mut self) -> Result<bool> {
        if let Some(Chunk {
            bytes, next, fault, ..
        }) = &self.chunk
            && (*next < bytes.len() || fault.is_some())
        {
            return Ok(true);
        }
        self.chunk = None;
        Ok(!self.input.at_end()?)
    }

    /// Goes on at byte `offset` of the file, outside of any compressed chunk.
    ///
    /// # Errors
    /// I/O.
    pub fn go(&mut self, offset: u64) -> Result<()> {
        self.chunk = None;
        self.input.seek(offset)
    }

    /// The file's bytes from `start` up to `end`, or as many as there are; what is read next stays the same.
    /// None where they are too many for an index.
    ///
    /// # Errors
    /// I/O.
    pub fn peek(&mut self, start: u64, end: u64) -> Result<Option<Vec<u8>>> {
        let offset = self.input.offset();
        let end = end.min(self.input.end()?);
        let length = end.saturating_sub(start);
        let bytes = match usize::try_from(length) {
            Ok(length) if length as u64 <= INDEX_MAX => {
                let mut bytes = vec![0; length];
                let filled = self.input.fill_at(start, &mut bytes)?;
                bytes.truncate(filled);
                Some(bytes)
            }
            _ => None,
        };
        self.input.seek(offset)?;
        Ok(bytes)
    }

    /// The file's length at present; what is read next stays the same.
    ///
    /// # Errors
    /// I/O.
    pub fn length(&mut self) -> Result<u64> {
        let offset = self.input.offset();
        let length = self.input.end()?;
        self.input.seek(offset)?;
        Ok(length)
    }

    /// Puts the next `n` bytes in place of `bytes`.
    ///
    /// # Errors
    /// Fewer are left, or more than a message may have.
    pub fn take(&mut self, bytes: &mut Vec<u8>, n: u64) -> Result<()> {
        if let Some(chunk) = &mut self.chunk {
            let Some(next) = chunk.next(n) else {
                return Err(self.cut());
            };
            bytes.clear();
            bytes.extend_from_slice(next);
            return Ok(());
        }
        let taken = self.take_some(bytes, n)?;
        match n - taken {
            0 => Ok(()),
            missing => Err(self.ended(self.input.offset(), missing)),
        }
    }

    /// Puts the file's next `n` bytes, or as many as it has, in place of `bytes`; returns how many.
    fn take_some(&mut self, bytes: &mut Vec<u8>, n: u64) -> Result<u64> {
        if n > MESSAGE_MAX as u64 {
            return Err(self.error(format!(
                "a record of {n} bytes, more than the {MESSAGE_MAX} that one may have: it is damaged"
            )));
        }
        bytes.clear();
        let n = usize::try_from(n).unwrap_or(MESSAGE_MAX);
        while bytes.len() < n {
            let before = bytes.len();
            bytes.resize(n.min(before + STEP_BYTES), 0);
            let asked = bytes.len() - before;
            let filled = self
                .input
                .fill(bytes.get_mut(before..).unwrap_or_default())?;
            bytes.truncate(before + filled);
            if filled < asked {
                break;
            }
        }
        Ok(bytes.len() as u64)
    }

    /// Passes over `n` bytes.
    ///
    /// # Errors
    /// Fewer are left.
    pub fn skip(&mut self, n: u64) -> Result<()> {
        if let Some(chunk) = &mut self.chunk {
            return match chunk.next(n) {
                Some(_) => Ok(()),
                None => Err(self.cut()),
            };
        }
        let Some(before_last) = n.checked_sub(1) else {
            return Ok(());
        };
        let last = self.input.offset().checked_add(before_last);
        // Files are not longer. Of what is still being written, the last byte is waited for.
        let last = last.filter(|last| i64::try_from(*last).is_ok());
        if let Some(last) = last {
            self.input.seek(last)?;
            if self.input.fill(&mut [0])? == 1 {
                return Ok(());
            }
        }
        let end = self.input.end()?;
        let missing = last
            .unwrap_or(u64::MAX)
            .saturating_sub(end)
            .saturating_add(1);
        Err(self.ended(end, missing))
    }

    /// The present compressed chunk has no more bytes, but should.
    fn cut(&self) -> event_types::stream::Error {
        match self.chunk.as_ref().and_then(|chunk| chunk.fault.as_ref()) {
            Some((at, what)) => self.input.error_at(*at, what),
            None => self.error("a record in this chunk goes beyond its end: it is damaged"),
        }
    }

    fn ended(&self, end: u64, missing: u64) -> event_types::stream::Error {
        self.input.error_at(end, ends_early(missing))
    }

    /// Reads a chunk's next `packed` bytes, which become `size` bytes of records by the named
    /// compression: `lz4`, `bz2`, `zstd`, or none (empty or `none`), where the file is read on.
    ///
    /// What can be decompressed of a chunk that was cut off comes before the error, and nothing of one that is damaged.
    ///
    /// # Errors
    /// A chunk in a chunk, a length that no chunk has.
    pub fn enter(&mut self, compression: &str, packed: u64, size: u64) -> Result<()> {
        if self.chunk.is_some() {
            return Err(self.error("a chunk inside of a chunk: it is damaged"));
        }
        if matches!(compression, "" | "none") {
            return if packed == size {
                // A chunk that was cut off still has messages.
                Ok(())
            } else {
                Err(self.error(format!(
                    "an uncompressed chunk of {packed} bytes that is said to have {size}: damaged"
                )))
            };
        }
        if size > MESSAGE_MAX as u64 {
            return Err(self.error(format!(
                "a chunk of {size} bytes, more than the {MESSAGE_MAX} that one may have: record \
                 with smaller chunks"
            )));
        }
        if packed == 0 {
            return Err(self.error(format!(
                "a chunk in {compression} that was not closed: its recorder was cut off, or is at \
                 work: only chunks without compression can be read before"
            )));
        }
        let offset = self.input.offset();
        let mut from = Vec::new();
        let missing = packed - self.take_some(&mut from, packed)?;
        let mut bytes = Vec::new();
        // One byte more, to tell a chunk that is too long.
        let unpacked = match compression {
            "lz4" => lz4_flex::frame::FrameDecoder::new(from.as_slice())
                .take(size + 1)
                .read_to_end(&mut bytes)
                .map_err(|error| error.to_string()),
            "bz2" => bzip2::read::BzDecoder::new(from.as_slice())
                .take(size + 1)
                .read_to_end(&mut bytes)
                .map_err(|error| error.to_string()),
            "zstd" => ruzstd::decoding::StreamingDecoder::new(from.as_slice())
                .map_err(|error| error.to_string())
                .and_then(|decoder| {
                    let read = decoder.take(size + 1).read_to_end(&mut bytes);
                    read.map_err(|error| error.to_string())
                }),
            other => Err(format!("compression {other:?} is not known")),
        };
        let fault = match unpacked {
            _ if missing > 0 => Some((self.input.offset(), ends_early(missing))),
            Ok(n) if n as u64 == size => None,
            Ok(n) => Some((
                offset,
                format!("a chunk has {n} bytes or more instead of {size}: it is damaged"),
            )),
            Err(what) => Some((
                offset,
                format!("a chunk cannot be decompressed ({what}): it is damaged"),
            )),
        };
        // Of a chunk that is all there nothing is known to be right before the damage was found.
        if fault.is_some() && missing == 0 {
            bytes.clear();
        }
        let next = 0;
        self.chunk = Some(Chunk {
            bytes,
            next,
            offset,
            fault,
        });
        Ok(())
    }

    /// Checks the CRC-32 of the `size` bytes of a chunk that has been entered. What is not all there has none, and
    /// the end of the file is met when it is read.
    ///
    /// # Errors
    /// Another CRC, before any record of the chunk; I/O.
    pub fn check(&mut self, crc: u32, size: u64) -> Result<()> {
        let found = match &self.chunk {
            Some(Chunk { fault: Some(_), .. }) => return Ok(()),
            Some(Chunk { bytes, .. }) => CRC.checksum(bytes),
            None => {
                let start = self.input.offset();
                let mut digest = CRC.digest();
                let mut left = size;
                let mut block = vec![0; BLOCK_BYTES];
                while left > 0 {
                    let most = usize::try_from(left)
                        .unwrap_or(BLOCK_BYTES)
                        .min(BLOCK_BYTES);
                    let block = block.get_mut(..most).unwrap_or_default();
                    let filled = self.input.fill(block)?;
                    digest.update(block.get(..filled).unwrap_or_default());
                    left -= filled as u64;
                    if filled < most {
                        break;
                    }
                }
                self.input.seek(start)?;
                if left > 0 {
                    return Ok(());
                }
                digest.finalize()
            }
        };
        if found == crc {
            return Ok(());
        }
        Err(self.error(format!(
            "the CRC of this chunk is {found:08x} instead of {crc:08x}: it is damaged"
        )))
    }

    /// Error at the present position.
    pub fn error(&self, what: impl std::fmt::Display) -> event_types::stream::Error {
        self.input.error_at(self.offset(), what)
    }
}

fn ends_early(missing: u64) -> String {
    format!(
        "the file ends {missing} bytes early: the recording was cut off; what stands before can be used"
    )
}
