//! Short frames of a file: what follows from the frames before is not written again.
//!
//! A short frame has a few bytes in place of the header of some 24, the payload, and the frame's CRC-32. It stands for
//! the whole frame, bit for bit: a reader makes the header from the frames before and seals it again, and the checksum
//! shows that it is the same. docs/wire-format.md has the layout.

use std::ops::Range;

use eecvs_nostd::frame::{CRC_BYTES, HEADER_BYTES_MAX, seal};
use eecvs_nostd::{FRAME_BYTES_MAX, Frame, Header, Regime, Scans};

use super::wire::{put, take};

/// Bits of the first byte above the regime. Its highest bit is 0, unlike that of sync bytes.
const KEY: u8 = 1 << 2;
const PREVIOUS: u8 = 1 << 3;
const GAP: u8 = 1 << 4;
const PHASE: u8 = 1 << 5;
const TRUNCATED: u8 = 1 << 6;
const SYNC: u8 = 1 << 7;
const REGIME: u8 = 3;

/// Size of the fields at their longest.
const FIELDS_BYTES_MAX: usize = 1 + 10 + 5 + 5 + 5 + 5;

/// Size of the longest payload of a short frame.
const PAYLOAD_BYTES_MAX: usize = FRAME_BYTES_MAX - HEADER_BYTES_MAX - CRC_BYTES;

/// What short frames are derived from: the frame before, and the latest frame of each regime.
#[derive(Debug, Clone, Default)]
pub struct Lean {
    before: Option<Header>,
    templates: [Option<Header>; Regime::ALL.len()],
}

/// Fields of a short frame, in their order on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Fields {
    flags: u8,
    /// Time between the windows, 0 if `flags` has no [`GAP`]: twice the number of windows left out, or else 1 more than
    /// twice the time in microseconds, as a zigzag number.
    gap: u64,
    /// Phase of the scans, if `flags` has [`PHASE`].
    phase_q16: i32,
    events: u32,
    /// In frames of coefficients alone.
    pixels: u32,
}

/// What was found where a short frame may begin.
#[derive(Debug, PartialEq, Eq)]
pub enum Found {
    /// A short frame of `bytes` bytes; the whole frame is in this range of the room.
    Frame {
        /// Its header.
        header: Header,
        /// Size of the short frame.
        bytes: usize,
        /// Place of the whole frame.
        whole: Range<usize>,
    },
    /// More bytes are needed.
    Incomplete,
    /// No short frame; this many bytes were checked.
    Damaged(usize),
}

impl Lean {
    /// Forgets all frames, so that the next one must be whole.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Takes note of a frame, short or whole, from which the next one may follow.
    pub fn note(&mut self, header: &Header) {
        self.before = Some(*header);
        if let Some(template) = self.templates.get_mut(header.regime as usize) {
            *template = Some(Header {
                begins_run: false,
                last: true,
                order: None,
                part: 0,
                late: 0,
                filtered: 0,
                dropped: 0,
                thinned: 0,
                saturated: 0,
                ..*header
            });
        }
    }

    /// Returns the header that the fields stand for.
    fn header(&self, fields: &Fields) -> Option<Header> {
        let before = self.before?;
        let regime = Regime::from_code(fields.flags & REGIME)?;
        let template = (*self.templates.get(regime as usize)?)?;
        let gap_us = if fields.gap & 1 == 0 {
            (fields.gap >> 1).wrapping_mul(before.duration_us.into())
        } else {
            let zigzag = fields.gap >> 1;
            zigzag >> 1 ^ (zigzag & 1).wrapping_neg()
        };
        let end_us = before.t0_us.wrapping_add(before.duration_us.into());
        let has = |flag: u8| fields.flags & flag != 0;
        let scans = match (template.scans, has(PHASE)) {
            (Some(scans), true) => Some(Scans::new(
                scans.readout(),
                fields.phase_q16,
                template.sensor,
                template.duration_us,
            )?),
            (None, true) => return None,
            (scans, false) => scans,
        };
        Some(Header {
            is_key: has(KEY),
            has_previous: has(PREVIOUS),
            truncated: has(TRUNCATED),
            scans,
            sequence: before.sequence.wrapping_add(1),
            t0_us: end_us.wrapping_add(gap_us),
            window_events: fields.events,
            events: fields.events,
            pixels: fields.pixels,
            ..template
        })
    }

    /// Returns the short form of a frame, or `None` if it has none.
    #[must_use]
    pub fn shortened(&self, header: &Header, frame: &[u8]) -> Option<Vec<u8>> {
        let before = self.before?;
        let template = (*self.templates.get(header.regime as usize)?)?;
        let end_us = before.t0_us.wrapping_add(before.duration_us.into());
        let gap_us = header.t0_us.wrapping_sub(end_us) as i64;
        let duration_us = i64::from(before.duration_us);
        let gap = if gap_us >= 0 && gap_us % duration_us == 0 {
            (gap_us / duration_us) as u64 * 2
        } else {
            // Times that are further away belong to whole frames.
            i32::try_from(gap_us).ok()?;
            ((gap_us << 1 ^ gap_us >> 63) as u64) << 1 | 1
        };
        let phase_q16 = header.scans.map_or(0, Scans::phase_q16);
        let has_phase = header.scans != template.scans;
        let flag = |is: bool, flag: u8| if is { flag } else { 0 };
        let fields = Fields {
            flags: header.regime as u8
                | flag(header.is_key, KEY)
                | flag(header.has_previous, PREVIOUS)
                | flag(header.truncated, TRUNCATED)
                | flag(gap != 0, GAP)
                | flag(has_phase, PHASE),
            gap,
            phase_q16,
            events: header.events,
            pixels: header.pixels,
        };
        if self.header(&fields)? != *header {
            return None;
        }
        let header_bytes = usize::from(*frame.get(3)?);
        let (payload, crc) = frame.get(header_bytes..)?.split_last_chunk::<CRC_BYTES>()?;
        let mut short = Vec::with_capacity(FIELDS_BYTES_MAX + payload.len() + CRC_BYTES);
        short.push(fields.flags);
        if gap != 0 {
            put(&mut short, &gap);
        }
        if has_phase {
            put(&mut short, &phase_q16);
        }
        put(&mut short, &fields.events);
        if header.mode.is_transform() {
            put(&mut short, &fields.pixels);
        }
        put(&mut short, &(payload.len() as u32));
        short.extend_from_slice(payload);
        short.extend_from_slice(crc);
        Some(short)
    }

    /// Returns whether bytes may begin a short frame here: not after damage, nor where sync bytes stand.
    #[must_use]
    pub fn may_begin(&self, bytes: &[u8]) -> bool {
        self.before.is_some() && bytes.first().is_some_and(|first| first & SYNC == 0)
    }

    /// Looks for a short frame at the start of `bytes`, and makes the whole frame in `room`.
    pub fn find(&self, bytes: &[u8], room: &mut Vec<u8>) -> Found {
        let mut rest = bytes;
        let Some((header, payload_bytes)) = self.read(&mut rest) else {
            return if bytes.len() < FIELDS_BYTES_MAX {
                Found::Incomplete
            } else {
                Found::Damaged(0)
            };
        };
        let payload_bytes = payload_bytes as usize;
        if payload_bytes > PAYLOAD_BYTES_MAX {
            return Found::Damaged(0);
        }
        let Some((payload, crc)) = rest
            .get(..payload_bytes + CRC_BYTES)
            .and_then(<[u8]>::split_last_chunk::<CRC_BYTES>)
        else {
            return Found::Incomplete;
        };
        let size = bytes.len() - rest.len() + payload_bytes + CRC_BYTES;
        room.clear();
        room.resize(HEADER_BYTES_MAX, 0);
        room.extend_from_slice(payload);
        room.extend_from_slice(&[0; CRC_BYTES]);
        let Ok(whole) = seal(&header, payload_bytes, room) else {
            return Found::Damaged(size);
        };
        let frame = room.get(whole.clone()).unwrap_or_default();
        // Its fields may be out of their range.
        if frame.ends_with(crc) && Frame::parse(frame).is_ok_and(|frame| frame.header == header) {
            Found::Frame {
                header,
                bytes: size,
                whole,
            }
        } else {
            Found::Damaged(size)
        }
    }

    /// Reads the fields; returns the header and the size of the payload.
    fn read(&self, rest: &mut &[u8]) -> Option<(Header, u32)> {
        let flags: u8 = take(rest)?;
        let gap = if flags & GAP != 0 { take(rest)? } else { 0 };
        let phase_q16 = if flags & PHASE != 0 { take(rest)? } else { 0 };
        let events = take(rest)?;
        let regime = Regime::from_code(flags & REGIME)?;
        let template = (*self.templates.get(regime as usize)?)?;
        let pixels = if template.mode.is_transform() {
            take(rest)?
        } else {
            0
        };
        let payload_bytes = take(rest)?;
        let fields = Fields {
            flags,
            gap,
            phase_q16,
            events,
            pixels,
        };
        Some((self.header(&fields)?, payload_bytes))
    }
}
