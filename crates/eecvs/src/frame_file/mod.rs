//! The frames of an `.eecvs` file or stream: reads them, reports what was damaged or lost, and writes files of them.

pub mod index;
mod lean;
pub mod mark;
mod order;
mod report;
mod wire;
mod writer;

use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;

use eecvs_nostd::frame::CRC_BYTES;
use eecvs_nostd::{FRAME_BYTES_MAX, Frame, FrameError, Header, Scan, Sensor, scan};

use self::index::Index;
use self::lean::{Found, Lean};
use self::mark::{End, Mark, MarkError, Segment};
pub use self::order::FrameOrder;
use self::order::order_of;
pub use self::report::LinkReport;
pub use self::writer::{FrameFileWriter, FrameSink};
use crate::reconstruct::hybrid::Refused;
use crate::stream_buffer::StreamBuffer;

/// Bytes requested from the source at a time.
const READ_BYTES: usize = 1 << 16;

/// Most bytes that are searched for the first frame of a stream.
const FRAMELESS_BYTES_MAX: u64 = 64 << 20;

/// Times from the first to before the last, in microseconds; an end of [`u64::MAX`] is none, and that time is inside.
pub type Times = Range<u64>;

/// Returns whether a time is before the end of `times`.
pub(crate) const fn is_before_end(times: &Times, t_us: u64) -> bool {
    t_us < times.end || times.end == u64::MAX
}

/// A frame with its position in the source.
#[derive(Debug, Clone, Copy)]
pub struct Located<'r> {
    /// The decoded header, and the payload.
    pub frame: Frame<'r>,
    /// Offset of its first byte.
    pub offset: u64,
    /// All bytes of the frame, made whole if it is short.
    pub bytes: &'r [u8],
    /// Number of bytes that it takes in the source: fewer if it is short.
    pub stored: usize,
    /// [`LinkReport::restarts`] up to and including this frame.
    pub restarts: u64,
}

/// Reads frames from a source of bytes; memory is bounded by the largest frame, and work by the bytes read.
pub struct FrameReader<R> {
    source: R,
    buffer: StreamBuffer,
    /// Room for the bytes of a read.
    piece: Vec<u8>,
    ended: bool,
    /// Sensor of the first frame; a frame of another one ends the stream unless `takes_all_sensors` is set.
    sensor: Option<Sensor>,
    takes_all_sensors: bool,
    /// Whether the first frame may come after any number of bytes.
    is_patient: bool,
    /// Sequence state for each sensor.
    orders: Vec<(Sensor, FrameOrder)>,
    open: Open,
    lean: Lean,
    /// The latest short frame, made whole.
    whole: Vec<u8>,
    /// The next frame is not the first of its stream, and those before it are not missing.
    joins: bool,
    /// Number of bytes left until the reader stops before the end of the source.
    left: Option<u64>,
    /// The source's index, once it was asked for, and the length of the source then.
    index: Option<(u64, Index)>,
    report: LinkReport,
}

/// What has been read of the current segment.
#[derive(Debug, Default)]
struct Open {
    /// It began with a mark.
    has_begin: bool,
    /// It is not read from its first frame on, or not to its end.
    is_partial: bool,
    /// How it ended has been counted.
    is_counted: bool,
    segment: Segment,
    /// Offset of the end of its last frame.
    end: u64,
}

impl Open {
    /// Adds the frame that begins at `offset` and takes `stored` bytes.
    fn add(&mut self, header: &Header, bytes: &[u8], offset: u64, stored: u64) {
        self.segment.skip(offset.saturating_sub(self.end));
        self.segment.add_stored(header, bytes, stored);
        self.end = offset + stored;
    }

    /// Counts how the segment ended, at this offset. Without an end mark, its frames are counted as such, or, if it began
    /// with a mark, the segment as cut short.
    fn count(&mut self, end: Option<&End>, offset: u64, report: &mut LinkReport) {
        if self.is_partial || std::mem::replace(&mut self.is_counted, true) {
            return;
        }
        self.segment.skip(offset.saturating_sub(self.end));
        let totals = self.segment.totals();
        match end {
            // The index too: every writer makes the same one.
            Some(end) if end == self.segment.end() => report.segments_ended += 1,
            Some(_) => report.segments_different += 1,
            None if self.has_begin => report.segments_cut_short += 1,
            None => report.frames_unmarked += totals.frames,
        }
    }
}

impl<R: Read> FrameReader<R> {
    /// Creates a reader over a source of bytes.
    pub fn new(source: R) -> Self {
        Self {
            source,
            buffer: StreamBuffer::new(FRAME_BYTES_MAX),
            piece: vec![0; READ_BYTES],
            ended: false,
            sensor: None,
            takes_all_sensors: false,
            is_patient: false,
            orders: Vec::new(),
            open: Open::default(),
            lean: Lean::default(),
            whole: Vec::new(),
            joins: false,
            left: None,
            index: None,
            report: LinkReport::default(),
        }
    }

    /// Continues when frames of another sensor arrive, and follows the sequence numbers of each sensor separately.
    #[must_use]
    pub fn of_all_sensors(self) -> Self {
        Self {
            takes_all_sensors: true,
            ..self
        }
    }

    /// Looks for the first frame however many bytes come before it, as on a link. Otherwise a source without one in its
    /// first 64 MiB, which may have no end, is refused.
    #[must_use]
    pub fn patient(self) -> Self {
        Self {
            is_patient: true,
            ..self
        }
    }

    /// Returns the report so far.
    #[must_use]
    pub const fn report(&self) -> &LinkReport {
        &self.report
    }

    /// Returns the sensor's size, which the first frame states; `None` before it.
    #[must_use]
    pub const fn sensor(&self) -> Option<Sensor> {
        self.sensor
    }

    /// Returns the number of bytes consumed so far.
    #[must_use]
    pub const fn offset(&self) -> u64 {
        self.buffer.used()
    }

    /// Returns the bytes of all damaged frames: the work of their checksums.
    #[must_use]
    pub const fn checked_bytes(&self) -> u64 {
        self.buffer.checked_bytes()
    }

    /// Counts a frame whose payload does not decode.
    pub const fn count_refused(&mut self, refused: Refused) {
        self.report.count_refused(refused);
    }

    /// Reads the next frame; returns `None` at the end of the source or where frames of another sensor begin,
    /// because events of two sensors must not be mixed.
    ///
    /// # Errors
    /// Only I/O errors; damage is reported by [`FrameReader::report`].
    pub fn next_frame(&mut self) -> std::io::Result<Option<Located<'_>>> {
        let (found, place) = loop {
            if self.report.other_sensor.is_some() {
                return Ok(None);
            }
            let rest = self.buffer.rest();
            if rest.starts_with(&mark::SYNC) {
                match Mark::parse(rest) {
                    Ok((mark, bytes)) => {
                        let offset = self.buffer.used();
                        self.buffer.take(bytes);
                        self.mark(&mark, offset);
                    }
                    Err(MarkError::Incomplete) if !self.ended => self.fill()?,
                    Err(error) => self.skip_mark(error),
                }
                continue;
            }
            if self.lean.may_begin(rest) {
                match self.lean.find(rest, &mut self.whole) {
                    Found::Frame {
                        header,
                        bytes,
                        whole,
                    } => {
                        if let Some(found) = self.take(header, bytes, Some(whole.clone())) {
                            break (found, Some(whole));
                        }
                    }
                    Found::Incomplete if !self.ended => self.fill()?,
                    Found::Incomplete => self.skip(FrameError::Incomplete, 1, 0),
                    Found::Damaged(checked) => {
                        self.skip(FrameError::Damaged(checked as u32), 1, checked);
                    }
                }
                continue;
            }
            match scan(rest) {
                Scan::Frame(frame) => {
                    let (header, bytes) = (frame.header, frame.bytes);
                    if let Some(found) = self.take(header, bytes, None) {
                        break (found, None);
                    }
                }
                Scan::Damage {
                    error: error @ FrameError::Damaged(checked),
                    skip,
                } => self.skip(error, skip, checked as usize),
                Scan::Damage { error, skip } => self.skip(error, skip, 0),
                // The frame that seemed to begin here is cut off, but others may lie inside it.
                Scan::Incomplete if self.ended && !rest.is_empty() => {
                    self.skip(FrameError::Incomplete, 1, 0);
                }
                Scan::Incomplete if self.ended => {
                    // Where the reader was to stop, more of the segment follows.
                    if self.left != Some(0) {
                        let offset = self.open.end;
                        self.open.count(None, offset, &mut self.report);
                    }
                    return Ok(None);
                }
                Scan::Incomplete => self.fill()?,
            }
        };
        let (header, stored) = found;
        let offset = self.buffer.used() - stored as u64;
        let bytes = match place {
            Some(whole) => self.whole.get(whole).unwrap_or_default(),
            None => self.buffer.last(stored),
        };
        let header_bytes = bytes.get(3).copied().map_or(0, usize::from);
        Ok(Some(Located {
            frame: Frame {
                header,
                payload: bytes
                    .get(header_bytes..bytes.len() - CRC_BYTES)
                    .unwrap_or_default(),
                bytes: bytes.len(),
            },
            offset,
            bytes,
            stored,
            restarts: self.report.restarts,
        }))
    }

    /// Takes the frame of `stored` bytes at the start of the buffer, whose whole form is in this range of `whole` if it
    /// is short. Returns its header and `stored` if it is to be delivered.
    fn take(
        &mut self,
        header: Header,
        stored: usize,
        whole: Option<Range<usize>>,
    ) -> Option<(Header, usize)> {
        let bytes = match whole {
            Some(whole) => self.whole.get(whole)?,
            None => self.buffer.rest().get(..stored)?,
        };
        let Sensor { width, height } = header.sensor;
        let sensor = *self.sensor.get_or_insert(header.sensor);
        if header.sensor != sensor && !self.takes_all_sensors {
            let other = (self.buffer.used(), format!("{width}x{height}"));
            self.report.other_sensor = Some(other);
            return None;
        }
        let crc = bytes.last_chunk().copied().unwrap_or_default();
        let is_first = self.open.has_begin && self.open.segment.totals().frames == 0;
        self.open
            .add(&header, bytes, self.buffer.used(), stored as u64);
        self.lean.note(&header);
        self.buffer.take(stored);
        let order = order_of(&mut self.orders, header.sensor);
        let before = self.report.frames_before;
        let is_new = order.follow(&header, crc, is_first, &mut self.report);
        if std::mem::take(&mut self.joins) {
            self.report.frames_before = before;
        }
        is_new.then_some((header, stored))
    }

    /// Takes note of a mark at this offset.
    fn mark(&mut self, mark: &Mark, offset: u64) {
        let end = match mark {
            Mark::Begin => None,
            Mark::End(end) => Some(end),
        };
        self.open.count(end, offset, &mut self.report);
        self.lean.reset();
        self.open = Open {
            has_begin: end.is_none(),
            ..Open::default()
        };
    }

    /// Returns the end mark that is missing at the end of a source of `bytes` bytes that was read to its end; `None` if
    /// the last frame belongs to a segment that has ended.
    #[must_use]
    pub fn missing_end(&self, bytes: u64) -> Option<End> {
        let Open {
            segment,
            end,
            has_begin,
            ..
        } = &self.open;
        let mut segment = segment.clone();
        segment.skip(bytes.saturating_sub(*end));
        (*has_begin || segment.totals().frames > 0).then(|| segment.end().clone())
    }

    /// Skips what is no mark; another mark or a frame may lie inside it.
    fn skip_mark(&mut self, error: MarkError) {
        let checked = match error {
            MarkError::Damaged(bytes) | MarkError::Contradictory(bytes) => bytes,
            _ => 0,
        };
        self.damage(&error, mark::SYNC.len(), checked);
    }

    fn skip(&mut self, error: FrameError, skip: usize, checked: usize) {
        // A mark may lie before the next frame.
        let skipped = self.buffer.rest().get(1..skip).unwrap_or_default();
        let sync = skipped.windows(2).position(|bytes| bytes == mark::SYNC);
        self.damage(&error, sync.map_or(skip, |at| at + 1), checked);
    }

    fn damage(&mut self, error: &dyn std::fmt::Display, skip: usize, checked: usize) {
        // A short frame may be missing, and the next one follows from it.
        self.lean.reset();
        let offset = self.buffer.used();
        let first = &mut self.report.first_damage;
        first.get_or_insert_with(|| (offset, error.to_string()));
        self.buffer.damage(skip, checked);
        (self.report.damaged_bytes, self.report.damaged_runs) = self.buffer.damaged();
    }

    fn fill(&mut self) -> std::io::Result<()> {
        // Whatever this is, it is no stream of frames, and it may have no end.
        let is_searched = self.report.damaged_bytes > FRAMELESS_BYTES_MAX;
        if self.sensor.is_none() && is_searched && !self.is_patient {
            let text = format!("no frame in the first {FRAMELESS_BYTES_MAX} bytes");
            return Err(std::io::Error::other(text));
        }
        let most = self.left.map_or(READ_BYTES, |left| {
            usize::try_from(left).map_or(READ_BYTES, |left| left.min(READ_BYTES))
        });
        let piece = self.piece.get_mut(..most).unwrap_or_default();
        let read = loop {
            match self.source.read(piece) {
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                result => break result?,
            }
        };
        self.buffer.push(piece.get(..read).unwrap_or_default());
        if let Some(left) = &mut self.left {
            *left -= read as u64;
        }
        self.ended = read == 0;
        Ok(())
    }
}

impl<R: Read + Seek> FrameReader<R> {
    /// Continues with the frames of the windows between two times, as the source's [`Index`] says where they are; a few
    /// others around them may be among them. Returns false, and changes nothing, if there is no index.
    ///
    /// # Errors
    /// I/O.
    pub fn seek(&mut self, times: &Times) -> std::io::Result<bool> {
        // A pipe may not go back. What cannot be read here is met again when frames are read.
        let Ok(at) = self.source.stream_position() else {
            return Ok(false);
        };
        let length = self.source.seek(SeekFrom::End(0)).unwrap_or(0);
        let known = self.index.take().filter(|(of, _)| *of == length);
        let index = match known {
            Some((_, index)) => Some(index),
            None => Index::read(&mut self.source).ok().flatten(),
        };
        let Some(index) = index else {
            self.source.seek(SeekFrom::Start(at))?;
            return Ok(false);
        };
        let wanted = index.between(times);
        self.index = Some((length, index));
        self.go_to(wanted.start, Some(wanted.end))?;
        Ok(true)
    }

    /// Continues at byte `start` of the source, and ends at byte `end`, or at the end of the source: the bytes of
    /// stretches of an [`Index`]. What lies outside is neither read nor reported.
    ///
    /// # Errors
    /// I/O.
    fn go_to(&mut self, start: u64, end: Option<u64>) -> std::io::Result<()> {
        self.source.seek(SeekFrom::Start(start))?;
        self.buffer = StreamBuffer::from_byte(FRAME_BYTES_MAX, start);
        // What was read before may be read again.
        self.report = LinkReport::default();
        self.ended = false;
        self.left = end.map(|end| end.saturating_sub(start));
        self.orders.clear();
        self.lean.reset();
        self.joins = true;
        self.open = Open {
            is_partial: true,
            ..Open::default()
        };
        Ok(())
    }
}
