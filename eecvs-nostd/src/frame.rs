//! The link frame: sync, header, payload, CRC; docs/wire-format.md has the layout.
//!
//! A frame is parsed where it lies. The header has a checksum of its own, so that a damaged length
//! is never trusted; the CRC-32 covers everything from the sync bytes to its own start.

use serde::{Deserialize, Serialize};

use crate::bits::BitReader;
use crate::checksum::{CRC_16, crc_32};
use crate::descriptor::Descriptor;
use crate::event::Sensor;
use crate::packing::Packing;
use crate::quantise::Quantiser;
use crate::regime::Regime;
use crate::transform::{GRID_MAX, M_MAX, Transform};
use crate::unpack::UnpackError;
use crate::window::EVENTS_MAX;

/// First two bytes of a frame.
pub const SYNC: [u8; 2] = [0xEE, 0xC5];
/// Version of the wire format.
pub const VERSION: u8 = 1;
/// Largest frame, sync to CRC-32.
pub const FRAME_BYTES_MAX: usize = 1 << 24;
/// Largest header, sync to CRC-16.
pub const HEADER_BYTES_MAX: usize = 96;
/// Bytes of the CRC-32 that ends a frame.
pub const CRC_BYTES: usize = 4;

/// Sync, version and header length.
const PREFIX_BYTES: usize = 4;
/// Every field of the header at its longest.
const FIELDS_BYTES_MAX: usize = 79;
const _: () = assert!(PREFIX_BYTES + FIELDS_BYTES_MAX + 2 <= HEADER_BYTES_MAX);

/// What a payload holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Mode {
    /// Every active pixel as its kept coefficients: the paper's scheme.
    Transform = 0,
}

/// Meaning of a frame's header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// The window closed early because its buffer was full.
    pub truncated: bool,
    /// No further frame of this window follows.
    pub last: bool,
    /// Regime of the window's density.
    pub regime: Regime,
    /// What the payload holds.
    pub mode: Mode,
    /// Sequence number of the frame; wraps.
    pub sequence: u32,
    /// Number of the frame within its window, from 0.
    pub part: u32,
    /// Sensor size.
    pub sensor: Sensor,
    /// Start of the window.
    pub t0_us: u64,
    /// T of the formulas.
    pub duration_us: u32,
    /// N_w.
    pub window_events: u32,
    /// Events in this frame.
    pub events: u32,
    /// Active pixels in this frame.
    pub pixels: u32,
    /// Events too old for their window, since the previous frame.
    pub late: u32,
    /// Events that a filter kept out, since the previous frame.
    pub filtered: u32,
    /// Events lost, since the previous frame.
    pub dropped: u32,
    /// Levels of this frame that did not fit 32 bits and were cut to the largest.
    pub saturated: u32,
    /// Transform of the window.
    pub transform: Transform,
    /// M.
    pub m: u8,
    /// K.
    pub grid: u16,
    /// Quantiser of the coefficients.
    pub quantiser: Quantiser,
}

/// The header's fields in the order of the link; postcard writes them as varints.
#[derive(Serialize, Deserialize)]
struct Wire {
    payload_bytes: u32,
    flags: u8,
    mode: u8,
    sequence: u32,
    part: u32,
    width: u16,
    height: u16,
    t0_us: u64,
    duration_us: u32,
    window_events: u32,
    events: u32,
    pixels: u32,
    late: u32,
    filtered: u32,
    dropped: u32,
    saturated: u32,
    transform: u8,
    m: u8,
    grid: u16,
    step_log2: i8,
}

const TRUNCATED: u8 = 1;
const LAST: u8 = 2;
const REGIME_SHIFT: u32 = 2;

/// Why bytes are not a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrameError {
    /// The bytes end before the frame does: with more of them it may be one.
    Incomplete,
    /// They do not begin with the sync bytes.
    Sync,
    /// A version that this code does not read.
    Version(u8),
    /// The header's checksum does not match.
    HeaderDamaged,
    /// The header's checksum matches but a field is out of its range.
    HeaderInvalid,
    /// The CRC-32 does not match that of the frame, of this many bytes.
    Damaged(u32),
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Incomplete => f.write_str("the frame is cut short"),
            Self::Sync => f.write_str("no frame begins here"),
            Self::Version(version) => write!(f, "frame version {version} is not supported"),
            Self::HeaderDamaged => f.write_str("the frame's header is damaged"),
            Self::HeaderInvalid => f.write_str("a field of the frame's header is out of range"),
            Self::Damaged(_) => f.write_str("the frame's CRC does not match"),
        }
    }
}

impl core::error::Error for FrameError {}

/// The output has no room for a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoRoom;

impl Header {
    /// What packing and unpacking need of it.
    #[must_use]
    pub const fn packing(&self) -> Packing {
        Packing {
            sensor: self.sensor,
            window_events: self.window_events,
            transform: self.transform,
            m: self.m,
            grid: self.grid,
            quantiser: self.quantiser,
        }
    }

    fn wire(&self, payload_bytes: u32) -> Wire {
        Wire {
            payload_bytes,
            flags: (u8::from(self.truncated) * TRUNCATED)
                | (u8::from(self.last) * LAST)
                | ((self.regime as u8) << REGIME_SHIFT),
            mode: self.mode as u8,
            sequence: self.sequence,
            part: self.part,
            width: self.sensor.width,
            height: self.sensor.height,
            t0_us: self.t0_us,
            duration_us: self.duration_us,
            window_events: self.window_events,
            events: self.events,
            pixels: self.pixels,
            late: self.late,
            filtered: self.filtered,
            dropped: self.dropped,
            saturated: self.saturated,
            transform: self.transform as u8,
            m: self.m,
            grid: self.grid,
            step_log2: self.quantiser.step_log2(),
        }
    }

    /// `None` where a field is out of its range.
    fn from_wire(wire: &Wire) -> Option<Self> {
        let sensor = Sensor::new(wire.width, wire.height)?;
        let transform = Transform::from_code(wire.transform)?;
        let header = Self {
            truncated: wire.flags & TRUNCATED != 0,
            last: wire.flags & LAST != 0,
            regime: Regime::from_code(wire.flags >> REGIME_SHIFT)?,
            mode: if wire.mode == Mode::Transform as u8 {
                Mode::Transform
            } else {
                return None;
            },
            sequence: wire.sequence,
            part: wire.part,
            sensor,
            t0_us: wire.t0_us,
            duration_us: wire.duration_us,
            window_events: wire.window_events,
            events: wire.events,
            pixels: wire.pixels,
            late: wire.late,
            filtered: wire.filtered,
            dropped: wire.dropped,
            saturated: wire.saturated,
            transform,
            m: wire.m,
            grid: wire.grid,
            quantiser: Quantiser::new(wire.step_log2)?,
        };
        let grid_fits = usize::from(header.grid) <= GRID_MAX
            && header.grid > 0
            && (transform != Transform::Dwt || header.grid.is_power_of_two());
        let m_fits = header.m > 0 && usize::from(header.m) <= M_MAX;
        let counts_fit = header.window_events as usize <= EVENTS_MAX
            && header.events <= header.window_events
            && header.pixels <= header.events.min(sensor.pixels())
            && (header.pixels > 0) == (header.events > 0);
        (grid_fits && m_fits && counts_fit && header.duration_us > 0).then_some(header)
    }
}

/// Completes a frame whose payload lies in `out[HEADER_BYTES_MAX..][..payload_bytes]`.
///
/// The header is laid right before the payload, whatever its length, so that nothing moves.
/// Returns the range of the frame within `out`.
///
/// # Errors
/// [`NoRoom`] where `out` does not hold the payload and a CRC, or the frame would exceed
/// [`FRAME_BYTES_MAX`].
pub fn seal(
    header: &Header,
    payload_bytes: usize,
    out: &mut [u8],
) -> Result<core::ops::Range<usize>, NoRoom> {
    let crc_at = HEADER_BYTES_MAX.checked_add(payload_bytes).ok_or(NoRoom)?;
    if crc_at > FRAME_BYTES_MAX - CRC_BYTES {
        return Err(NoRoom);
    }
    let (frame, after) = out.split_at_mut_checked(crc_at).ok_or(NoRoom)?;
    let frame_crc = after.first_chunk_mut::<CRC_BYTES>().ok_or(NoRoom)?;

    let mut header_bytes = [0; HEADER_BYTES_MAX];
    let (prefix, fields) = header_bytes
        .split_first_chunk_mut::<PREFIX_BYTES>()
        .ok_or(NoRoom)?;
    // FIELDS_BYTES_MAX fits: there is always room.
    let fields = postcard::to_slice(&header.wire(payload_bytes as u32), fields)
        .map_err(|_| NoRoom)?
        .len();
    let length = PREFIX_BYTES + fields + 2;
    *prefix = [SYNC[0], SYNC[1], VERSION, length as u8];
    let (checked, after) = header_bytes
        .split_at_mut_checked(PREFIX_BYTES + fields)
        .ok_or(NoRoom)?;
    *after.first_chunk_mut().ok_or(NoRoom)? = CRC_16.checksum(checked).to_le_bytes();

    let start = HEADER_BYTES_MAX.checked_sub(length).ok_or(NoRoom)?;
    let frame = frame.get_mut(start..).ok_or(NoRoom)?;
    for (to, from) in frame.iter_mut().zip(&header_bytes).take(length) {
        *to = *from;
    }
    *frame_crc = crc_32(frame).to_le_bytes();
    Ok(start..crc_at + CRC_BYTES)
}

/// A whole, undamaged frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Frame<'i> {
    /// Its header.
    pub header: Header,
    /// Its packed pixels.
    pub payload: &'i [u8],
    /// Its length, sync to CRC-32.
    pub bytes: usize,
}

impl<'i> Frame<'i> {
    /// The frame at the start of `bytes`.
    ///
    /// # Errors
    /// [`FrameError`]; [`FrameError::Incomplete`] asks for at most [`FRAME_BYTES_MAX`] bytes in
    /// all. No input makes it panic.
    pub fn parse(bytes: &'i [u8]) -> Result<Self, FrameError> {
        let prefix = bytes.len().min(SYNC.len());
        if bytes[..prefix] != SYNC[..prefix] {
            return Err(FrameError::Sync);
        }
        let [_, _, version, header_bytes, ..] = *bytes else {
            return Err(FrameError::Incomplete);
        };
        if version != VERSION {
            return Err(FrameError::Version(version));
        }
        let header_bytes = usize::from(header_bytes);
        if !(PREFIX_BYTES + 2..=HEADER_BYTES_MAX).contains(&header_bytes) {
            return Err(FrameError::HeaderDamaged);
        }
        let header = bytes.get(..header_bytes).ok_or(FrameError::Incomplete)?;
        let (fields, crc) = header.split_at(header_bytes - 2);
        if CRC_16.checksum(fields).to_le_bytes() != *crc {
            return Err(FrameError::HeaderDamaged);
        }
        let (wire, rest) = postcard::take_from_bytes::<Wire>(&fields[PREFIX_BYTES..])
            .map_err(|_| FrameError::HeaderInvalid)?;
        let header = Header::from_wire(&wire)
            .filter(|_| rest.is_empty())
            .ok_or(FrameError::HeaderInvalid)?;
        let payload_bytes = wire.payload_bytes as usize;
        // Before the sum below, which would overflow where usize has 32 bits.
        if payload_bytes > FRAME_BYTES_MAX - header_bytes - CRC_BYTES {
            return Err(FrameError::HeaderInvalid);
        }
        let crc_at = header_bytes + payload_bytes;
        let end = crc_at + CRC_BYTES;
        let frame = bytes.get(..end).ok_or(FrameError::Incomplete)?;
        if crc_32(&frame[..crc_at]).to_le_bytes() != frame[crc_at..] {
            return Err(FrameError::Damaged(end as u32));
        }
        Ok(Self {
            header,
            payload: &frame[header_bytes..crc_at],
            bytes: end,
        })
    }

    /// Its pixels, in raster order.
    #[must_use]
    pub const fn descriptors(&self) -> Descriptors<'i> {
        Descriptors {
            packing: self.header.packing(),
            reader: BitReader::new(self.payload),
            next_index: 0,
            pixels_left: self.header.pixels,
            events_left: self.header.events,
            failed: false,
        }
    }
}

/// Unpacks a frame pixel by pixel. After an error it ends.
#[derive(Debug, Clone)]
pub struct Descriptors<'i> {
    packing: Packing,
    reader: BitReader<'i>,
    next_index: u32,
    pixels_left: u32,
    events_left: u32,
    failed: bool,
}

impl Descriptors<'_> {
    fn unpack(&mut self) -> Result<Option<Descriptor>, UnpackError> {
        if self.pixels_left == 0 {
            return if self.events_left > 0 {
                Err(UnpackError::Events)
            } else if self.reader.is_spent() {
                Ok(None)
            } else {
                Err(UnpackError::Trailing)
            };
        }
        let descriptor =
            self.packing
                .unpack(&mut self.next_index, self.events_left, &mut self.reader)?;
        self.pixels_left -= 1;
        self.events_left -= descriptor.events();
        Ok(Some(descriptor))
    }
}

impl Iterator for Descriptors<'_> {
    type Item = Result<Descriptor, UnpackError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let unpacked = self.unpack();
        self.failed = !matches!(unpacked, Ok(Some(_)));
        unpacked.transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_header_has_room() {
        let wire = Wire {
            payload_bytes: u32::MAX,
            flags: u8::MAX,
            mode: u8::MAX,
            sequence: u32::MAX,
            part: u32::MAX,
            width: u16::MAX,
            height: u16::MAX,
            t0_us: u64::MAX,
            duration_us: u32::MAX,
            window_events: u32::MAX,
            events: u32::MAX,
            pixels: u32::MAX,
            late: u32::MAX,
            filtered: u32::MAX,
            dropped: u32::MAX,
            saturated: u32::MAX,
            transform: u8::MAX,
            m: u8::MAX,
            grid: u16::MAX,
            step_log2: i8::MIN,
        };
        let mut bytes = [0; 2 * HEADER_BYTES_MAX];
        let fields = postcard::to_slice(&wire, &mut bytes).unwrap();
        assert_eq!(fields.len(), FIELDS_BYTES_MAX);
    }
}
