//! The bytes of a bag: those of the file or, while one is being read, of a compressed chunk.

use std::io::Read;

use event_types::stream::Result;

use super::decoder::MESSAGE_MAX;
use crate::input::Input;

/// A file of records, some of which are in compressed chunks.
pub struct Chunked {
    /// The file.
    pub input: Input,
    chunk: Option<Chunk>,
}

/// A decompressed chunk.
struct Chunk {
    bytes: Vec<u8>,
    next: usize,
    /// Offset of the chunk's bytes in the file.
    offset: u64,
    /// Where and why the bytes end early, if they do; reported once they have been read.
    fault: Option<(u64, String)>,
}

impl Chunk {
    /// Returns the next `n` bytes; `None` if fewer are left.
    fn next(&mut self, n: u64) -> Option<&[u8]> {
        let rest = self.bytes.get(self.next..)?;
        let next = rest.get(..usize::try_from(n).ok()?)?;
        self.next += next.len();
        Some(next)
    }
}

/// Number of bytes read at once for a checksum.
const BLOCK_BYTES: usize = 1 << 16;

/// Longest index that is read, in bytes: about 10^6 chunks.
const INDEX_MAX: u64 = 1 << 27;

/// Number of bytes by which memory grows while a stated length is not confirmed.
const STEP_BYTES: usize = 1 << 20;

impl Chunked {
    /// Begins at the file's position.
    #[must_use]
    pub fn new(input: Input) -> Self {
        Self { input, chunk: None }
    }

    /// Returns whether the next bytes come from a compressed chunk.
    #[must_use]
    pub fn inside(&self) -> bool {
        self.chunk.is_some()
    }

    /// Returns the position in the file; inside a compressed chunk, that of the chunk.
    #[must_use]
    pub fn offset(&self) -> u64 {
        match &self.chunk {
            Some(chunk) => chunk.offset,
            None => self.input.offset(),
        }
    }

    /// Returns whether there are more bytes; leaves a compressed chunk that has been read to its end.
    ///
    /// # Errors
    /// The file cannot be read.
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

    /// Continues at byte `offset` of the file, outside any compressed chunk.
    ///
    /// # Errors
    /// The offset is out of range.
    pub fn go(&mut self, offset: u64) -> Result<()> {
        self.chunk = None;
        self.input.seek(offset)
    }

    /// Returns the file's bytes from `start` up to `end`, at most to its end, without changing the position.
    /// Returns `None` if they are too many for an index.
    ///
    /// # Errors
    /// The file cannot be read.
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

    /// Returns the file's current length, without changing the position.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn length(&mut self) -> Result<u64> {
        let offset = self.input.offset();
        let length = self.input.end()?;
        self.input.seek(offset)?;
        Ok(length)
    }

    /// Reads the next `n` bytes into `bytes`, replacing its content.
    ///
    /// # Errors
    /// Fewer bytes are left, or `n` is above the largest size of a message.
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

    /// Reads the file's next `n` bytes, or those that are left, into `bytes`, replacing its content; returns their
    /// number.
    fn take_some(&mut self, bytes: &mut Vec<u8>, n: u64) -> Result<u64> {
        if n > MESSAGE_MAX as u64 {
            return Err(self.error(format!(
                "a record of {n} bytes, more than the {MESSAGE_MAX} allowed: it is damaged"
            )));
        }
        bytes.clear();
        let n = usize::try_from(n).unwrap_or(MESSAGE_MAX);
        while bytes.len() < n {
            let before = bytes.len();
            self.input.room(bytes, n.min(before + STEP_BYTES))?;
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

    /// Skips `n` bytes.
    ///
    /// # Errors
    /// Fewer bytes are left.
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
        // No file is longer than 2^63. In a file that is still being written, the last byte is waited for.
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

    /// Returns the error for a compressed chunk that ends too early.
    fn cut(&self) -> event_types::stream::Error {
        match self.chunk.as_ref().and_then(|chunk| chunk.fault.as_ref()) {
            Some((at, what)) => self.input.error_at(*at, what),
            None => self.error("a record in this chunk goes beyond its end: it is damaged"),
        }
    }

    fn ended(&self, end: u64, missing: u64) -> event_types::stream::Error {
        self.input.error_at(end, ends_early(missing))
    }

    /// Enters a chunk: reads its next `packed` bytes and decompresses them to `size` bytes of records.
    /// `compression` is `lz4`, `bz2`, `zstd`, or none (empty or `none`), in which case reading continues in the
    /// file.
    ///
    /// Of a chunk that was cut off, everything that can be decompressed is read before the error; of a damaged one,
    /// nothing.
    ///
    /// # Errors
    /// The chunk is inside a chunk, or its length is impossible.
    pub fn enter(&mut self, compression: &str, packed: u64, size: u64) -> Result<()> {
        if self.chunk.is_some() {
            return Err(self.error("a chunk inside a chunk: it is damaged"));
        }
        if matches!(compression, "" | "none") {
            return if packed == size {
                // Even if the chunk was cut off, it holds messages.
                Ok(())
            } else {
                Err(self.error(format!(
                    "an uncompressed chunk of {packed} bytes whose stated size is {size}: damaged"
                )))
            };
        }
        if size > MESSAGE_MAX as u64 {
            return Err(self.error(format!(
                "a chunk of {size} bytes, more than the {MESSAGE_MAX} allowed: record with smaller \
                 chunks"
            )));
        }
        if packed == 0 {
            return Err(self.error(format!(
                "a {compression} chunk that was not closed: its recorder was interrupted or is \
                 still recording: until a chunk is closed, it can be read only if it is \
                 uncompressed"
            )));
        }
        let offset = self.input.offset();
        let mut from = Vec::new();
        let missing = packed - self.take_some(&mut from, packed)?;
        let mut bytes = Vec::new();
        // One more byte, to detect a chunk that is too long.
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
        // In a complete chunk that is damaged, nothing before the damage is known to be right.
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

    /// Checks the CRC-32 of the `size` bytes of a chunk that has been entered. An incomplete chunk is not checked;
    /// reading it reports the end of the file.
    ///
    /// # Errors
    /// The CRC differs, before any record of the chunk is read; the file cannot be read.
    pub fn check(&mut self, crc: u32, size: u64) -> Result<()> {
        let found = match &self.chunk {
            Some(Chunk { fault: Some(_), .. }) => return Ok(()),
            Some(Chunk { bytes, .. }) => crc32fast::hash(bytes),
            None => {
                let start = self.input.offset();
                let mut digest = crc32fast::Hasher::new();
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

    /// Returns an error at the current position.
    pub fn error(&self, what: impl std::fmt::Display) -> event_types::stream::Error {
        self.input.error_at(self.offset(), what)
    }
}

fn ends_early(missing: u64) -> String {
    format!(
        "the file ends {missing} bytes early: the recording was cut off; everything before can be \
         used"
    )
}
