//! Marks in a file of frames: where a segment begins, and where it ends, with its counts and its index.
//!
//! A writer puts [`BEGIN`] in front of the frames of a segment and an [`End`] behind them. A segment that begins and
//! does not end was cut short: its writer was stopped, or the end of the file is missing. docs/wire-format.md has the
//! layout. Streams have no marks.

use core::ops::Range;

use eecvs_nostd::Header;
use eecvs_nostd::frame::CRC_BYTES;
use serde::{Deserialize, Serialize};

use super::wire::{VALUE_BYTES_MAX, put, take};

/// First two bytes of a mark.
pub const SYNC: [u8; 2] = [0xEE, 0xC8];

/// Version of the marks.
const VERSION: u8 = 1;

/// Kinds of marks.
const KIND_BEGIN: u8 = 0;
const KIND_END: u8 = 1;

/// Size of sync, version, kind and the body's size.
const PREFIX_BYTES: usize = 8;

/// Largest number of stretches in the index of a segment.
pub const STRETCHES_MAX: usize = 1 << 16;

/// Sizes of the totals and their number of stretches at their longest, and of the mark's own size.
const TOTALS_BYTES_MAX: usize = 48;
pub(super) const SIZE_BYTES: usize = 4;

/// Size of the largest body.
const BODY_BYTES_MAX: usize = TOTALS_BYTES_MAX + STRETCHES_MAX * VALUE_BYTES_MAX + SIZE_BYTES;

/// Size of the largest mark.
pub const MARK_BYTES_MAX: usize = PREFIX_BYTES + BODY_BYTES_MAX + CRC_BYTES;

/// The mark in front of a segment's frames.
pub const BEGIN: [u8; PREFIX_BYTES + CRC_BYTES] = [
    SYNC[0], SYNC[1], VERSION, KIND_BEGIN, 0, 0, 0, 0, 0x73, 0xEA, 0xD6, 0xC7,
];

/// Counts of the frames of a segment, or of a part of it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Totals {
    /// Bytes from the first frame to the end of the last one, whatever lies between them.
    pub bytes: u64,
    /// Frames.
    pub frames: u64,
    /// Events in the frames.
    pub events: u64,
    /// Runs that begin in the frames.
    pub runs: u64,
    /// Hash of the frames' checksums in their order: h of no frames is 0, and with each frame it becomes the CRC-32 of
    /// h and the frame's own CRC-32.
    pub hash: u32,
}

impl Totals {
    /// Adds a frame of which all bytes are `bytes`, and which takes `stored` bytes in the file.
    fn add(&mut self, header: &Header, bytes: &[u8], stored: u64) {
        let mut hashed = [0; 2 * CRC_BYTES];
        let (before, crc) = hashed.split_at_mut(CRC_BYTES);
        before.copy_from_slice(&self.hash.to_le_bytes());
        crc.copy_from_slice(bytes.last_chunk::<CRC_BYTES>().unwrap_or(&[0; CRC_BYTES]));
        self.hash = crc32fast::hash(&hashed);
        self.runs += u64::from(begins_run(header) || self.frames == 0);
        self.frames += 1;
        self.events += u64::from(header.events);
        self.bytes += stored;
    }

    /// Returns whether the frames are the same, as far as their counts and their hash show.
    #[must_use]
    pub const fn has_same_frames(&self, other: &Self) -> bool {
        self.frames == other.frames && self.events == other.events && self.hash == other.hash
    }
}

/// Returns whether a new run begins with a frame; all frames of a window repeat the flag.
const fn begins_run(header: &Header) -> bool {
    header.begins_run && header.part == 0
}

/// A stretch of a segment: frames that decode without those before them.
///
/// Only the first stretch of a segment may begin with a frame that depends on others, where those are missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stretch {
    /// Offset of its first frame from the segment's first frame.
    pub offset: u64,
    /// Size: up to the first frame of the next stretch, or to the end mark.
    pub bytes: u64,
    /// Frames.
    pub frames: u64,
    /// Events in the frames.
    pub events: u64,
    /// Runs that begin in the frames.
    pub runs: u64,
    /// Time of the earliest window's start, in microseconds.
    pub start_us: u64,
    /// Time of the latest window's end, in microseconds.
    pub end_us: u64,
}

impl Stretch {
    /// Returns the frames' bytes in a segment that begins at `segment`.
    #[must_use]
    pub const fn range(&self, segment: u64) -> Range<u64> {
        let start = segment.saturating_add(self.offset);
        start..start.saturating_add(self.bytes)
    }
}

/// A stretch on the wire: times are relative to the stretch before, at first to 0.
#[derive(Serialize, Deserialize)]
struct StretchWire {
    bytes: u64,
    frames: u64,
    events: u64,
    runs: u64,
    /// `start_us` less the `end_us` before, modulo 2^64.
    gap_us: i64,
    /// `end_us` less `start_us`.
    span_us: u64,
}

/// The mark behind a segment's frames.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct End {
    /// Counts of all frames of the segment.
    pub totals: Totals,
    /// The index: the stretches in their order, without gaps.
    pub stretches: Vec<Stretch>,
}

/// A mark.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Mark {
    /// A segment begins.
    Begin,
    /// A segment ends.
    End(End),
}

/// Why bytes were rejected as a mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MarkError {
    /// The bytes end before the mark does.
    Incomplete,
    /// The bytes do not begin with the sync bytes.
    Sync,
    /// A version that this code does not read.
    Version(u8),
    /// The prefix has a kind or a size that no mark has.
    Invalid,
    /// The checksum does not match; the mark has this many bytes.
    Damaged(usize),
    /// The checksum matches but the counts contradict each other; the mark has this many bytes.
    Contradictory(usize),
}

impl std::fmt::Display for MarkError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Incomplete => f.write_str("the mark is cut short"),
            Self::Sync => f.write_str("no mark begins here"),
            Self::Version(version) => write!(f, "mark version {version} is not supported"),
            Self::Invalid => f.write_str("a field of the mark is out of range"),
            Self::Damaged(_) => f.write_str("the mark's CRC does not match"),
            Self::Contradictory(_) => f.write_str("the mark's counts contradict each other"),
        }
    }
}

impl std::error::Error for MarkError {}

impl Mark {
    /// Parses the mark at the start of `bytes`; returns its size in bytes too.
    ///
    /// # Errors
    /// [`MarkError`]: there is no mark, or not all of it.
    pub fn parse(bytes: &[u8]) -> Result<(Self, usize), MarkError> {
        if !SYNC.starts_with(bytes.get(..SYNC.len()).unwrap_or(bytes)) {
            return Err(MarkError::Sync);
        }
        let Some((prefix, _)) = bytes.split_first_chunk::<PREFIX_BYTES>() else {
            return Err(MarkError::Incomplete);
        };
        let [_, _, version, kind, a, b, c, d] = *prefix;
        let size = u32::from_le_bytes([a, b, c, d]) as usize;
        match (version, kind, size) {
            (VERSION, KIND_BEGIN, 0) | (VERSION, KIND_END, SIZE_BYTES..=BODY_BYTES_MAX) => {}
            (VERSION, ..) => return Err(MarkError::Invalid),
            _ => return Err(MarkError::Version(version)),
        }
        let whole = PREFIX_BYTES + size + CRC_BYTES;
        let Some(mark) = bytes.get(..whole) else {
            return Err(MarkError::Incomplete);
        };
        let (checked, crc) = mark.split_at(PREFIX_BYTES + size);
        if crc32fast::hash(checked).to_le_bytes() != *crc {
            return Err(MarkError::Damaged(whole));
        }
        if kind == KIND_BEGIN {
            return Ok((Self::Begin, whole));
        }
        let body = checked.get(PREFIX_BYTES..).unwrap_or_default();
        let end = End::from_body(body, whole).ok_or(MarkError::Contradictory(whole))?;
        Ok((Self::End(end), whole))
    }
}

impl End {
    /// Returns the mark's bytes.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut mark = vec![SYNC[0], SYNC[1], VERSION, KIND_END, 0, 0, 0, 0];
        put(&mut mark, &self.totals);
        put(&mut mark, &(self.stretches.len() as u64));
        let mut end_us = 0_u64;
        for stretch in &self.stretches {
            put(
                &mut mark,
                &StretchWire {
                    bytes: stretch.bytes,
                    frames: stretch.frames,
                    events: stretch.events,
                    runs: stretch.runs,
                    gap_us: stretch.start_us.wrapping_sub(end_us) as i64,
                    span_us: stretch.end_us.wrapping_sub(stretch.start_us),
                },
            );
            end_us = stretch.end_us;
        }
        let whole = mark.len() + SIZE_BYTES + CRC_BYTES;
        mark.extend((whole as u32).to_le_bytes());
        let body = (mark.len() - PREFIX_BYTES) as u32;
        if let Some(size) = mark.get_mut(PREFIX_BYTES - SIZE_BYTES..PREFIX_BYTES) {
            size.copy_from_slice(&body.to_le_bytes());
        }
        let crc = crc32fast::hash(&mark);
        mark.extend(crc.to_le_bytes());
        mark
    }

    /// Parses the body of a mark of `whole` bytes; `None` if its numbers contradict each other.
    fn from_body(body: &[u8], whole: usize) -> Option<Self> {
        let (mut rest, size) = body.split_at_checked(body.len() - SIZE_BYTES)?;
        let totals: Totals = take(&mut rest)?;
        let count: u64 = take(&mut rest)?;
        if size != (whole as u32).to_le_bytes() || count > STRETCHES_MAX as u64 {
            return None;
        }
        let mut sums = Totals {
            hash: totals.hash,
            ..Totals::default()
        };
        let mut end_us = 0_u64;
        let mut stretches = Vec::new();
        for _ in 0..count {
            let wire: StretchWire = take(&mut rest)?;
            let start_us = end_us.wrapping_add(wire.gap_us as u64);
            end_us = start_us.checked_add(wire.span_us)?;
            stretches.push(Stretch {
                offset: sums.bytes,
                bytes: wire.bytes,
                frames: wire.frames,
                events: wire.events,
                runs: wire.runs,
                start_us,
                end_us,
            });
            sums = Totals {
                bytes: sums.bytes.checked_add(wire.bytes)?,
                frames: sums.frames.checked_add(wire.frames)?,
                events: sums.events.checked_add(wire.events)?,
                runs: sums.runs.checked_add(wire.runs)?,
                ..sums
            };
        }
        (rest.is_empty() && sums == totals).then_some(Self { totals, stretches })
    }
}

/// Follows the frames of a segment, and makes its end mark. Memory is bounded, whatever the number of frames.
#[derive(Debug, Clone)]
pub struct Segment {
    end: End,
    /// A stretch of fewer bytes goes on.
    stretch_bytes: u64,
}

/// Size of the shortest stretch in bytes: the index takes less than 0.5 % of the file.
const STRETCH_BYTES_MIN: u64 = 1 << 13;

impl Default for Segment {
    fn default() -> Self {
        Self {
            end: End::default(),
            stretch_bytes: STRETCH_BYTES_MIN,
        }
    }
}

impl Segment {
    /// Adds a whole frame; `bytes` are all of its bytes.
    pub fn add(&mut self, header: &Header, bytes: &[u8]) {
        self.add_stored(header, bytes, bytes.len() as u64);
    }

    /// Returns whether another stretch begins if the next frame, with this header, is added as a whole one.
    #[must_use]
    pub fn may_enter(&self, header: &Header) -> bool {
        let is_entry = header.part == 0 && header.is_key;
        let last = self.end.stretches.last();
        last.is_none_or(|last| is_entry && last.bytes >= self.stretch_bytes)
    }

    /// Adds a frame of which all bytes are `bytes`, and which takes `stored` bytes in the file: fewer if it is short.
    pub fn add_stored(&mut self, header: &Header, bytes: &[u8], stored: u64) {
        let is_whole = stored == bytes.len() as u64;
        let enters = is_whole && self.may_enter(header);
        self.end.totals.add(header, bytes, stored);
        let stretches = &mut self.end.stretches;
        let is_first = stretches.is_empty();
        if is_first || enters {
            if stretches.len() == STRETCHES_MAX {
                *stretches = stretches.chunks(2).filter_map(joined).collect();
                self.stretch_bytes *= 2;
            }
            stretches.push(Stretch {
                offset: self.end.totals.bytes - stored,
                bytes: 0,
                frames: 0,
                events: 0,
                runs: 0,
                start_us: header.t0_us,
                end_us: header.t0_us,
            });
        }
        if let Some(last) = stretches.last_mut() {
            last.bytes += stored;
            last.frames += 1;
            last.events += u64::from(header.events);
            last.runs += u64::from(begins_run(header) || is_first);
            last.start_us = last.start_us.min(header.t0_us);
            let end_us = header.t0_us.saturating_add(header.duration_us.into());
            last.end_us = last.end_us.max(end_us);
        }
    }

    /// Counts bytes between two frames that belong to no frame.
    pub fn skip(&mut self, bytes: u64) {
        if let Some(last) = self.end.stretches.last_mut() {
            last.bytes += bytes;
            self.end.totals.bytes += bytes;
        }
    }

    /// Returns the counts so far.
    #[must_use]
    pub const fn totals(&self) -> &Totals {
        &self.end.totals
    }

    /// Returns the end mark of the frames so far.
    #[must_use]
    pub const fn end(&self) -> &End {
        &self.end
    }
}

/// Returns neighbours as one stretch.
fn joined(stretches: &[Stretch]) -> Option<Stretch> {
    let joined = stretches.iter().copied();
    joined.reduce(|first, second| Stretch {
        offset: first.offset,
        bytes: first.bytes + second.bytes,
        frames: first.frames + second.frames,
        events: first.events + second.events,
        runs: first.runs + second.runs,
        start_us: first.start_us.min(second.start_us),
        end_us: first.end_us.max(second.end_us),
    })
}
