//! Writes frames to files with marks, and to streams without them.

use std::io::{Result, Write};

use eecvs_nostd::Header;

use super::lean::Lean;
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
    lean: Lean,
    /// Bytes of the frames since the last one that follows from none before, itself included.
    joint_bytes: usize,
    /// Bytes of all frames.
    frame_bytes: u64,
}

/// Bytes of frames after which none follows from those before any more, whatever its regime. With a frame more it is what
/// damage of one byte costs.
const JOINT_BYTES_MAX: usize = 1 << 13;

/// Frames of more bytes are written whole: their headers hardly count.
const LEAN_BYTES_MAX: usize = 1 << 12;

impl<W: Write> FrameFileWriter<W> {
    /// Begins a segment. Its marks are written with its first frame: without one, the file stays empty.
    pub fn new(out: W) -> Self {
        Self {
            segment: Some(Segment::default()),
            ..Self::stream(out)
        }
    }

    /// Begins a stream, which has frames and no marks.
    pub fn stream(out: W) -> Self {
        Self {
            out,
            segment: None,
            lean: Lean::default(),
            joint_bytes: 0,
            frame_bytes: 0,
        }
    }

    /// Returns the size of the file if it ends here: frames and marks.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let marks = |segment: &Segment| (BEGIN.len() + segment.end().to_bytes().len()) as u64;
        let segment = self.segment.as_ref();
        let begun = segment.filter(|segment| segment.totals().frames > 0);
        self.frame_bytes + begun.map_or(0, marks)
    }

    /// Ends the segment and returns the output, which is not flushed.
    ///
    /// # Errors
    /// The mark cannot be written.
    pub fn finish(mut self) -> Result<W> {
        self.end()?;
        Ok(self.out)
    }

    /// Ends the segment: what follows is a stream.
    ///
    /// # Errors
    /// The mark cannot be written.
    pub fn end(&mut self) -> Result<()> {
        match self.segment.take() {
            Some(segment) if segment.totals().frames > 0 => {
                self.out.write_all(&segment.end().to_bytes())
            }
            _ => Ok(()),
        }
    }
}

impl<W: Write> FrameSink for FrameFileWriter<W> {
    fn frame(&mut self, header: &Header, bytes: &[u8]) -> Result<()> {
        let Some(segment) = &mut self.segment else {
            self.frame_bytes += bytes.len() as u64;
            return self.out.write_all(bytes);
        };
        if segment.totals().frames == 0 {
            self.out.write_all(&BEGIN)?;
        }
        if segment.may_enter(header) || self.joint_bytes > JOINT_BYTES_MAX {
            // A reader may begin here, so that the first frame of every regime must be whole again.
            self.lean.reset();
            self.joint_bytes = 0;
        }
        let short = if bytes.len() > LEAN_BYTES_MAX {
            None
        } else {
            self.lean.shortened(header, bytes)
        };
        let stored = short.as_deref().unwrap_or(bytes);
        self.joint_bytes += stored.len();
        self.out.write_all(stored)?;
        self.frame_bytes += stored.len() as u64;
        segment.add_stored(header, bytes, stored.len() as u64);
        self.lean.note(header);
        Ok(())
    }
}
