//! The index of a file: where the frames of a time are, found from the file's end.

use std::io::{Read, Result, Seek, SeekFrom};
use std::ops::Range;

use eecvs_nostd::frame::CRC_BYTES;

use super::mark::{BEGIN, End, MARK_BYTES_MAX, Mark, SIZE_BYTES, STRETCHES_MAX, Stretch};
use super::{Times, is_before_end};

/// Largest number of stretches of a file; what lies before them is one stretch.
const FILE_STRETCHES_MAX: usize = 16 * STRETCHES_MAX;

/// The stretches of a file, in the order of its bytes and without gaps.
///
/// A file has an index if it ends with an end mark. What lies before a segment with an end mark is another such
/// segment, or else one stretch of any times.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Index {
    /// With offsets from the start of the file.
    stretches: Vec<Stretch>,
}

impl Index {
    /// Reads the index of a file from its end; returns `None` if there is none, and `source` at any position.
    ///
    /// # Errors
    /// I/O.
    pub fn read(source: &mut (impl Read + Seek + ?Sized)) -> Result<Option<Self>> {
        let mut at = source.seek(SeekFrom::End(0))?;
        // From the last segment to the first.
        let mut segments: Vec<Vec<Stretch>> = Vec::new();
        let mut count = 0;
        while at > 0 && count < FILE_STRETCHES_MAX {
            let Some((start, End { mut stretches, .. })) = segment_before(source, at)? else {
                break;
            };
            for stretch in &mut stretches {
                stretch.offset += start;
            }
            count += stretches.len().max(1);
            segments.push(stretches);
            at = before_begin(source, start)?;
        }
        if segments.is_empty() {
            return Ok(None);
        }
        let any_time = Stretch {
            offset: 0,
            bytes: at,
            frames: 0,
            events: 0,
            runs: 0,
            start_us: 0,
            end_us: u64::MAX,
        };
        let before = Some(any_time).filter(|_| at > 0);
        let known = segments.into_iter().rev().flatten();
        Ok(Some(Self {
            stretches: before.into_iter().chain(known).collect(),
        }))
    }

    /// Returns the stretches.
    #[must_use]
    pub fn stretches(&self) -> &[Stretch] {
        &self.stretches
    }

    /// Returns the bytes in which all windows are that have some of these times. If none has, these are the bytes of the
    /// first stretch, whose frames tell the sensor.
    #[must_use]
    pub fn between(&self, times: &Times) -> Range<u64> {
        let mut stretches = self.stretches.iter();
        let first = stretches.find(|stretch| stretch.end_us > times.start);
        let mut stretches = self.stretches.iter();
        let last = stretches.rfind(|stretch| is_before_end(times, stretch.start_us));
        match (first, last) {
            (Some(first), Some(last)) if first.offset <= last.offset => {
                first.offset..last.range(0).end
            }
            _ => self.stretches.first().map_or(0..0, |first| first.range(0)),
        }
    }
}

/// Returns the offset of the first frame of the segment whose end mark ends at `at`, and the mark; `None` if there is
/// no such mark.
fn segment_before(source: &mut (impl Read + Seek + ?Sized), at: u64) -> Result<Option<(u64, End)>> {
    let mut tail = [0; SIZE_BYTES + CRC_BYTES];
    let Some(tail_at) = at.checked_sub(tail.len() as u64) else {
        return Ok(None);
    };
    source.seek(SeekFrom::Start(tail_at))?;
    source.read_exact(&mut tail)?;
    let size = tail.first_chunk().copied().map(u32::from_le_bytes);
    let size = size.unwrap_or_default();
    let Some(mark_at) = at.checked_sub(size.into()) else {
        return Ok(None);
    };
    if size as usize > MARK_BYTES_MAX {
        return Ok(None);
    }
    let mut mark = vec![0; size as usize];
    source.seek(SeekFrom::Start(mark_at))?;
    source.read_exact(&mut mark)?;
    let Ok((Mark::End(end), bytes)) = Mark::parse(&mark) else {
        return Ok(None);
    };
    let start = mark_at.checked_sub(end.totals.bytes);
    let start = start.filter(|_| bytes == mark.len());
    Ok(start.map(|start| (start, end)))
}

/// Returns the offset of the begin mark of a segment whose first frame is at `start`, or `start` if it has none.
fn before_begin(source: &mut (impl Read + Seek + ?Sized), start: u64) -> Result<u64> {
    let Some(at) = start.checked_sub(BEGIN.len() as u64) else {
        return Ok(start);
    };
    let mut begin = [0; BEGIN.len()];
    source.seek(SeekFrom::Start(at))?;
    source.read_exact(&mut begin)?;
    Ok(if begin == BEGIN { at } else { start })
}
