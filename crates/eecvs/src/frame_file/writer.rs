//! Writes frames to files with marks, and to streams without them.

use std::io::{Result, Write};

use eecvs_nostd::Header;

use super::mark::{BEGIN, Segment};

/// Takes frames one after the other. Anything that takes bytes takes frames, as a stream without marks.
pub trait FrameSink {
    /// Takes a frame; `bytes` are all of its bytes.
    ///
    /// # Errors
    /// The frame cannot be written.
    fn frame(&mut self, header: &Header, bytes: &[u8]) -> Result<()>;
}

impl<W: Write + ?Sized> FrameSink for W {
    fn frame(&mut self, _: &Header, bytes: &[u8]) -> Result<()> {
        self.write_all(bytes)
    }
}

/// Writes frames to a file as one segment: a mark where it begins, the frames, and a mark with their counts and the
/// index. A file without the second mark is known to be cut short.
#[derive(Debug)]
pub struct FrameFileWriter<W> {
    out: W,
    /// The frames so far; `None` for a stream.
    segment: Option<Segment>,
}

impl<W: Write> FrameFileWriter<W> {
    /// Begins a segment.
    ///
    /// # Errors
    /// The mark cannot be written.
    pub fn new(mut out: W) -> Result<Self> {
        out.write_all(&BEGIN)?;
        Ok(Self {
            out,
            segment: Some(Segment::default()),
        })
    }

    /// Begins a stream, which has frames and no marks.
    pub const fn stream(out: W) -> Self {
        Self { out, segment: None }
    }

    /// Returns the size of the marks around the frames so far.
    #[must_use]
    pub fn mark_bytes(&self) -> u64 {
        let segment = self.segment.as_ref();
        segment.map_or(0, |segment| {
            (BEGIN.len() + segment.end().to_bytes().len()) as u64
        })
    }

    /// Ends the segment and returns the output, which is not flushed.
    ///
    /// # Errors
    /// The mark cannot be written.
    pub fn finish(mut self) -> Result<W> {
        if let Some(segment) = self.segment {
            self.out.write_all(&segment.end().to_bytes())?;
        }
        Ok(self.out)
    }
}

impl<W: Write> FrameSink for FrameFileWriter<W> {
    fn frame(&mut self, header: &Header, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes)?;
        if let Some(segment) = &mut self.segment {
            segment.add(header, bytes);
        }
        Ok(())
    }
}
