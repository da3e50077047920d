//! Bytes of a bag: of the file, or of a compressed chunk while one is being read.

use std::io::Read;

use super::decoder::MESSAGE_MAX;
use crate::formats::input::Input;

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
}

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

    /// Bytes up to the end of the chunk or the file.
    #[must_use]
    pub fn left(&self) -> u64 {
        match &self.chunk {
            Some(chunk) => chunk.bytes.len().saturating_sub(chunk.next) as u64,
            None => self.input.length().saturating_sub(self.input.offset()),
        }
    }

    /// Puts the next `n` bytes in place of `bytes`.
    ///
    /// # Errors
    /// Fewer are left, or more than a message may have.
    pub fn take(&mut self, bytes: &mut Vec<u8>, n: u64) -> anyhow::Result<()> {
        self.check(n)?;
        let n = usize::try_from(n).unwrap_or(usize::MAX);
        if n > MESSAGE_MAX {
            return Err(self.error(format!(
                "a record of {n} bytes, more than the {MESSAGE_MAX} that one may have: it is damaged"
            )));
        }
        bytes.clear();
        if let Some(chunk) = &mut self.chunk {
            let rest = chunk.bytes.get(chunk.next..).unwrap_or_default();
            bytes.extend_from_slice(rest.get(..n).unwrap_or_default());
            chunk.next += n;
            return Ok(());
        }
        bytes.resize(n, 0);
        self.input.fill(bytes).map(drop)
    }

    /// Passes over `n` bytes.
    ///
    /// # Errors
    /// Fewer are left.
    pub fn skip(&mut self, n: u64) -> anyhow::Result<()> {
        self.check(n)?;
        if let Some(chunk) = &mut self.chunk {
            chunk.next += usize::try_from(n).unwrap_or(0);
            return Ok(());
        }
        self.input.seek(self.input.offset() + n)
    }

    /// Leaves a compressed chunk that has been read to its end.
    pub fn leave(&mut self) {
        if self.left() == 0 {
            self.chunk = None;
        }
    }

    fn check(&self, n: u64) -> anyhow::Result<()> {
        let left = self.left();
        if n <= left {
            return Ok(());
        }
        let missing = n - left;
        Err(match self.chunk {
            Some(_) => self.error(format!(
                "a record in this chunk ends {missing} bytes early: it is damaged"
            )),
            None => {
                let end = self.input.length();
                self.input.error_at(
                    end,
                    format!(
                        "the file ends {missing} bytes early: the recording was cut off; what stands \
                         before can be used"
                    ),
                )
            }
        })
    }

    /// Reads a chunk's next `packed` bytes, which become `size` bytes of records by the named
    /// compression: `lz4`, `bz2`, `zstd`, or none (empty or `none`), where the file is read on.
    ///
    /// # Errors
    /// Fewer bytes are left, another compression or length.
    pub fn enter(&mut self, compression: &str, packed: u64, size: u64) -> anyhow::Result<()> {
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
        let offset = self.input.offset();
        let mut from = Vec::new();
        self.take(&mut from, packed)?;
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
            Ok(n) if n as u64 == size => None,
            Ok(n) => Some(format!("{n} bytes or more instead of {size}")),
            Err(what) => Some(what),
        };
        if let Some(what) = fault {
            return Err(self.input.error_at(
                offset,
                format!("a chunk cannot be decompressed ({what}): it is damaged"),
            ));
        }
        let next = 0;
        self.chunk = Some(Chunk {
            bytes,
            next,
            offset,
        });
        Ok(())
    }

    /// Error at the present position.
    pub fn error(&self, what: impl std::fmt::Display) -> anyhow::Error {
        self.input.error_at(self.offset(), what)
    }
}
