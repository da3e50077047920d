//! Short frames of a file: what follows from the frames before is not written again.
//!
//! A short frame has a few bytes in place of the header of some 24, the payload, and the frame's CRC-32. It stands for
//! the whole frame, bit for bit: a reader makes the header from the frames before and seals it again, and the checksum
//! shows that it is the same. docs/wire-format.md has the layout.

use std::ops::Range;

use eecvs_nostd::frame::{CRC_BYTES, HEADER_BYTES_MAX, seal};
use eecvs_nostd::{FRAME_BYTES_MAX, Fidelity, Frame, Header, Mode, Regime, Scans};

use super::wire::{put, take};

/// Bits of the first byte above the regime. Its highest bit is 0, unlike that of sync bytes.
const KEY: u8 = 1 << 2;
const PREVIOUS: u8 = 1 << 3;
const GAP: u8 = 1 << 4;
/// The phase follows, of frames with scans, or else the fidelity of hybrid frames.
const TIMES: u8 = 1 << 5;
const TRUNCATED: u8 = 1 << 6;
const SYNC: u8 = 1 << 7;
const REGIME: u8 = 3;

/// Size of the fields at their longest.
const FIELDS_BYTES_MAX: usize = 1 + 10 + 10 + 5 + 5 + 5;

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
    /// Phase of the scans as a zigzag number, or code of the fidelity, if `flags` has [`TIMES`].
    times: u64,
    events: u32,
    /// In frames of coefficients alone.
    pixels: u32,
}

/// Returns the number that stands for a fidelity: its code on the wire, plus four times its value.
fn fidelity_code(fidelity: Fidelity) -> u64 {
    let (code, value) = fidelity.code();
    u64::from(code) | u64::from(value.unwrap_or(0)) << 2
}

/// The inverse of [`fidelity_code`]; `None` for a number that stands for none.
fn fidelity(number: u64) -> Option<Fidelity> {
    let value = u32::try_from(number >> 2).ok()?;
    let fidelity = Fidelity::from_code((number & 3) as u8, value)?;
    (fidelity_code(fidelity) == number).then_some(fidelity)
}

/// Returns the zigzag number of a value: 0, -1, 1, -2, ... as 0, 1, 2, 3, ...
const fn zigzag(value: i64) -> u64 {
    (value << 1 ^ value >> 63) as u64
}

/// The inverse of [`zigzag`].
const fn unzigzag(number: u64) -> i64 {
    (number >> 1 ^ (number & 1).wrapping_neg()) as i64
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
            unzigzag(fields.gap >> 1) as u64
        };
        let end_us = before.t0_us.wrapping_add(before.duration_us.into());
        let has = |flag: u8| fields.flags & flag != 0;
        let (mut scans, mut mode) = (template.scans, template.mode);
        if has(TIMES) {
            if let Some(scans) = &mut scans {
                *scans = Scans::new(
                    scans.readout(),
                    i32::try_from(unzigzag(fields.times)).ok()?,
                    template.sensor,
                    template.duration_us,
                )?;
            } else if let Mode::Hybrid(hybrid) = &mut mode {
                hybrid.fidelity = fidelity(fields.times)?;
            } else {
                return None;
            }
        }
        Some(Header {
            is_key: has(KEY),
            has_previous: has(PREVIOUS),
            truncated: has(TRUNCATED),
            scans,
            mode,
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
            zigzag(gap_us) << 1 | 1
        };
        let times = match (header.scans, header.mode) {
            (Some(scans), _) => zigzag(scans.phase_q16().into()),
            (None, Mode::Hybrid(hybrid)) => fidelity_code(hybrid.fidelity),
            _ => 0,
        };
        let has_times = (header.scans, header.mode) != (template.scans, template.mode);
        let flag = |is: bool, flag: u8| if is { flag } else { 0 };
        let fields = Fields {
            flags: header.regime as u8
                | flag(header.is_key, KEY)
                | flag(header.has_previous, PREVIOUS)
                | flag(header.truncated, TRUNCATED)
                | flag(gap != 0, GAP)
                | flag(has_times, TIMES),
            gap,
            times,
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
        if has_times {
            put(&mut short, &times);
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
        let times = if flags & TIMES != 0 { take(rest)? } else { 0 };
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
            times,
            events,
            pixels,
        };
        Some((self.header(&fields)?, payload_bytes))
    }
}
