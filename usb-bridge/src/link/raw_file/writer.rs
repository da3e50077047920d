//! Writes stream files.

use std::io::{self, Write};
use std::time::Duration;

use super::{CAUSES, DATA_MAX, Entry, Fixed, Header, INDEX_STEP, Mark, RECORD};
use crate::link::Loss;

/// Writes a stream file. Without [`RawWriter::finish`] the file has no index, but is still readable.
pub struct RawWriter<W> {
    out: W,
    offset: u64,
    stream: u64,
    index: Vec<Entry>,
}

pub(super) fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

impl<W: Write> RawWriter<W> {
    /// Begins a file by writing its header; `out` should be buffered.
    ///
    /// # Errors
    /// `out` cannot be written.
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

    /// Appends bytes that arrived at `time` after time zero.
    ///
    /// # Errors
    /// The file cannot be written.
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

    /// Appends a loss: bytes are missing before the next ones. `bytes` is their number, if known.
    ///
    /// # Errors
    /// The file cannot be written.
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

    /// Returns the number of bytes of the stream written so far.
    pub const fn stream_bytes(&self) -> u64 {
        self.stream
    }

    /// Ends the file with its index, flushes it and returns the inner writer.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> io::Result<W> {
        let offset = self.offset;
        let payload: Vec<u8> = self
            .index
            .iter()
            .flat_map(|entry| [entry.time, entry.offset, entry.stream])
            .flat_map(u64::to_le_bytes)
            .collect();
        // The 32-bit length suffices for a stream of about 187 TB; the index of a longer one is left empty.
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
