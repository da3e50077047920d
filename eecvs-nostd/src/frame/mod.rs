//! The frame of the wire format: sync, header, payload, CRC. docs/wire-format.md has the layout.
//!
//! A frame is parsed in place. The header has a checksum of its own, so that a damaged length is never trusted; the
//! CRC-32 covers everything before it, from the sync bytes on.

pub mod stream;

use serde::{Deserialize, Serialize};

use crate::checksum::{CRC_16, crc_32};
use crate::coder::tree::{Levels, Shape};
use crate::coder::{Axis, Coder, Effort, Fidelity, Hybrid, Readout, Scans, Times};
use crate::pack::bits_lsb_first::BitReader;
use crate::pack::descriptor::Descriptor;
use crate::pack::unpack::UnpackError;
use crate::quantise::Quantiser;
use crate::regime::Regime;
use crate::transform::shape::{Packing, Timed};
use crate::transform::{GRID_MAX, M_MAX, Transform};
use crate::window::EVENTS_MAX;
use event_types::Sensor;

/// First two bytes of a frame.
pub const SYNC: [u8; 2] = [0xEE, 0xC5];
/// Version of the wire format whose header ends with a byte of further flags.
pub const VERSION: u8 = 3;
/// Version of a frame of the tree coder, whose header has the effort and the levels after the further flags, or of
/// the quick or the keys coder, which have a code of their own there.
pub const VERSION_FURTHER: u8 = 4;
/// Version of a frame without further flags.
pub const VERSION_PLAIN: u8 = 2;
/// Size of the largest frame in bytes, from sync to CRC-32.
pub const FRAME_BYTES_MAX: usize = 1 << 24;
/// Size of the largest header in bytes, from sync to CRC-16.
pub const HEADER_BYTES_MAX: usize = 112;
/// Size in bytes of the CRC-32 that ends a frame.
pub const CRC_BYTES: usize = 4;

/// Size of sync, version and header length.
const PREFIX_BYTES: usize = 4;
/// Size of all header fields at their longest.
const FIELDS_BYTES_MAX: usize = 106;
const _: () = assert!(PREFIX_BYTES + FIELDS_BYTES_MAX + 2 <= HEADER_BYTES_MAX);

/// Content of a payload: coefficients or events, and how they are coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Mode {
    /// The kept coefficients of every active pixel, in plain codes: the paper's scheme.
    Transform,
    /// The same coefficients, coded by an adaptive coder.
    Coefficients(Coder),
    /// The events themselves.
    Hybrid(Hybrid),
}

/// Size of the last part of a payload, which codes the order in which events of equal time arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OrderSection {
    /// Its size in bytes.
    pub bytes: u32,
    /// Number of events whose place in the window's order it codes. 0 in the last frame of the window, which codes
    /// the places of all that are left.
    pub events: u32,
}

/// The decoded header of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// The window closed early because its buffer was full.
    pub truncated: bool,
    /// A new run begins with this window: the clock went back before it, so t0 may be any time.
    pub begins_run: bool,
    /// No further frame of this window follows.
    pub last: bool,
    /// Regime that the window's density falls in.
    pub regime: Regime,
    /// Content of the payload.
    pub mode: Mode,
    /// The frame decodes without the frames before it. False for most frames of the dense and the tree coder, true
    /// for all others.
    pub is_key: bool,
    /// The dense coder uses the window before as context; the tree coder the last events of each pixel.
    pub has_previous: bool,
    /// Levels of the trees; in frames of the tree coder alone.
    pub levels: Option<Levels>,
    /// Scans by which the times are coded; only in lossless frames of the dense and the tree coder.
    pub scans: Option<Scans>,
    /// Order section of the payload: in frames of an encoder that keeps arrival order, once every event of the
    /// window is in this frame or an earlier one.
    pub order: Option<OrderSection>,
    /// Sequence number of the frame; wraps.
    pub sequence: u32,
    /// Number of the frame within its window, from 0.
    pub part: u32,
    /// Sensor size.
    pub sensor: Sensor,
    /// Start of the window.
    pub t0_us: u64,
    /// Duration of the window: T of the formulas.
    pub duration_us: u32,
    /// Number of events in the window: N_w.
    pub window_events: u32,
    /// Number of events in this frame.
    pub events: u32,
    /// Number of active pixels in this frame; 0 in a hybrid frame, whose payload codes it.
    pub pixels: u32,
    /// Events too late for their window since the previous frame; 0 from encoders that begin a run for such events.
    pub late: u32,
    /// Events that a filter removed since the previous frame.
    pub filtered: u32,
    /// Events lost since the previous frame.
    pub dropped: u32,
    /// Events of this window that the rate control left out.
    pub thinned: u32,
    /// Levels of this frame that were saturated to 32 bits.
    pub saturated: u32,
    /// Transform of the window. In a hybrid frame this, `m`, `grid` and `quantiser` are those of the volume that a
    /// decoder makes of the events.
    pub transform: Transform,
    /// Number of coefficients kept: M.
    pub m: u8,
    /// Size of the grid of coefficients: K.
    pub grid: u16,
    /// Quantiser of the coefficients.
    pub quantiser: Quantiser,
    /// n0: pixels of 2 to this many events are sent as the times of their events ([`crate::pack::timed`]), in mode
    /// `transform`; 0 if none is.
    pub timed_max: u8,
}

/// The first header fields in the order on the wire. Postcard writes them as varints; a flag announces each of the
/// optional groups below.
#[derive(Serialize, Deserialize)]
struct Wire {
    payload_bytes: u32,
    flags: u8,
    mode: u8,
    sequence: u32,
    width: u16,
    height: u16,
    t0_us: u64,
    duration_us: u32,
    window_events: u32,
}

/// Present if [`PART`] is set: the frame is not its whole window.
#[derive(Serialize, Deserialize)]
struct PartWire {
    part: u32,
    events: u32,
}

/// Present if [`COUNTS`] is set: one of the counts is not 0.
#[derive(Serialize, Deserialize, PartialEq)]
struct CountsWire {
    late: u32,
    filtered: u32,
    dropped: u32,
    thinned: u32,
    saturated: u32,
}

/// Present if [`SHAPE`] is set: always in mode `transform`, else where the shape is not the default.
#[derive(Serialize, Deserialize, PartialEq)]
struct ShapeWire {
    transform: u8,
    m: u8,
    grid: u16,
    step_log2: i8,
}

/// Present if [`COLUMNS`] or [`ROWS`] is set.
#[derive(Serialize, Deserialize)]
struct ScanWire {
    period_q16: u32,
    slope_q16: i32,
    phase_q16: i32,
}

const TRUNCATED: u8 = 1;
const LAST: u8 = 1 << 1;
const REGIME_SHIFT: u32 = 2;
const PART: u8 = 1 << 4;
const COUNTS: u8 = 1 << 5;
const SHAPE: u8 = 1 << 6;
const ORDER: u8 = 1 << 7;

/// Further flags.
const BEGINS_RUN: u8 = 1;
const TIMED: u8 = 1 << 1;

/// Where the levels of the two trees are, above the effort, in the byte of a frame of the tree coder.
const LEVELS_FIRST_SHIFT: u32 = 2;
const LEVELS_SECOND_SHIFT: u32 = 5;

/// That byte of a frame of the quick coder: no effort and no levels.
const QUICK: u8 = 0;
/// That byte of a frame of the keys coder: no effort, and levels that no tree has.
const KEYS: u8 = 1 << LEVELS_FIRST_SHIFT;

/// Codes of the mode.
const TRANSFORM: u8 = 0;
const FAST: u8 = 1;
const DENSE: u8 = 2;
/// One of the coders that the byte after the further flags tells apart.
const FURTHER: u8 = 3;
const CODER: u8 = 3;
const FIDELITY_SHIFT: u32 = 2;
/// Coder of coefficients, in the bits that hold the fidelity in hybrid modes.
const COEFFICIENTS_FAST: u8 = TRANSFORM | (1 << FIDELITY_SHIFT);
const COEFFICIENTS_DENSE: u8 = TRANSFORM | (2 << FIDELITY_SHIFT);
/// Codes of the fidelity.
const LOSSLESS: u8 = 0;
const TOLERANCE: u8 = 1;
const BINS: u8 = 2;
const SPREAD: u8 = 3;
const KEY: u8 = 1 << 4;
const PREVIOUS: u8 = 1 << 5;
/// Axes of a scan.
const COLUMNS: u8 = 1 << 6;
const ROWS: u8 = 1 << 7;

impl CountsWire {
    const NONE: Self = Self {
        late: 0,
        filtered: 0,
        dropped: 0,
        thinned: 0,
        saturated: 0,
    };
}

impl Mode {
    /// Returns whether every event's time is coded exactly.
    #[must_use]
    pub const fn is_lossless(self) -> bool {
        matches!(
            self,
            Self::Hybrid(Hybrid {
                fidelity: Fidelity::Lossless,
                ..
            })
        )
    }

    /// Returns whether frames hold coefficients, by whichever coder.
    #[must_use]
    pub const fn is_transform(self) -> bool {
        matches!(self, Self::Transform | Self::Coefficients(_))
    }

    /// Returns whether frames depend on those before them, back to the last key frame.
    #[must_use]
    pub const fn is_dense(self) -> bool {
        matches!(
            self,
            Self::Coefficients(Coder::Dense)
                | Self::Hybrid(Hybrid {
                    coder: Coder::Dense | Coder::Tree(_),
                    ..
                })
        )
    }

    /// Returns the effort of the tree coder, if this is its mode.
    #[must_use]
    pub const fn effort(self) -> Option<Effort> {
        match self {
            Self::Hybrid(Hybrid {
                coder: Coder::Tree(effort),
                ..
            }) => Some(effort),
            _ => None,
        }
    }

    /// Returns whether windows keep the order of arrival for the coder, which is the quick or the keys coder.
    #[must_use]
    pub const fn takes_arrival(self) -> bool {
        self.keeps_arrival() || self.has_keys()
    }

    /// Returns whether events are coded by the keys coder, which decodes them into order of time.
    #[must_use]
    pub const fn has_keys(self) -> bool {
        matches!(
            self,
            Self::Hybrid(Hybrid {
                coder: Coder::Keys,
                ..
            })
        )
    }

    /// Returns whether events are coded and decoded in their order of arrival, by the quick coder.
    #[must_use]
    pub const fn keeps_arrival(self) -> bool {
        matches!(
            self,
            Self::Hybrid(Hybrid {
                coder: Coder::Quick,
                ..
            })
        )
    }

    /// Returns the mode's code on the wire and, for some fidelities, the value that goes with it.
    pub(crate) const fn code(self) -> (u8, Option<u32>) {
        let Hybrid { coder, fidelity } = match self {
            Self::Transform => return (TRANSFORM, None),
            Self::Coefficients(Coder::Fast) => return (COEFFICIENTS_FAST, None),
            // The other coders have none: `Config::check` refuses them.
            Self::Coefficients(_) => return (COEFFICIENTS_DENSE, None),
            Self::Hybrid(hybrid) => hybrid,
        };
        let coder = match coder {
            Coder::Fast => FAST,
            Coder::Dense => DENSE,
            Coder::Keys | Coder::Quick | Coder::Tree(_) => FURTHER,
        };
        let (fidelity, value) = fidelity.code();
        (coder | (fidelity << FIDELITY_SHIFT), value)
    }

    /// The inverse of [`Self::code`], which tells neither the effort nor the quick or the keys coder from the tree
    /// coder; `None` for an unknown code or a value out of range.
    pub(crate) const fn from_code(code: u8, value: u32) -> Option<Self> {
        match code {
            TRANSFORM => return Some(Self::Transform),
            COEFFICIENTS_FAST => return Some(Self::Coefficients(Coder::Fast)),
            COEFFICIENTS_DENSE => return Some(Self::Coefficients(Coder::Dense)),
            _ => (),
        }
        let Some(fidelity) = Fidelity::from_code(code >> FIDELITY_SHIFT, value) else {
            return None;
        };
        let coder = match code & CODER {
            FAST => Coder::Fast,
            DENSE => Coder::Dense,
            FURTHER => Coder::Tree(Effort::One),
            _ => return None,
        };
        Some(Self::Hybrid(Hybrid { coder, fidelity }))
    }
}

impl Fidelity {
    /// Returns the fidelity's code on the wire and, unless it is lossless, the value that goes with it.
    #[must_use]
    pub const fn code(self) -> (u8, Option<u32>) {
        match self {
            Self::Lossless => (LOSSLESS, None),
            Self::ToleranceUs(tolerance_us) => (TOLERANCE, Some(tolerance_us)),
            Self::Bins(bins) => (BINS, Some(bins as u32)),
            Self::SpreadUs(width_us) => (SPREAD, Some(width_us)),
        }
    }

    /// The inverse of [`Self::code`]; `None` for an unknown code or a value out of range. No value is used with the code
    /// of a lossless fidelity.
    #[must_use]
    pub const fn from_code(code: u8, value: u32) -> Option<Self> {
        match code {
            LOSSLESS => Some(Self::Lossless),
            TOLERANCE => Some(Self::ToleranceUs(value)),
            BINS if value > 0 && value <= u16::MAX as u32 => Some(Self::Bins(value as u16)),
            SPREAD if value > 0 => Some(Self::SpreadUs(value)),
            _ => None,
        }
    }
}

/// Returns whether a value goes with a mode's code.
const fn has_value(code: u8) -> bool {
    code & CODER != TRANSFORM && code >> FIDELITY_SHIFT != LOSSLESS
}

/// M of a hybrid frame whose header has no shape.
pub const M_DEFAULT: u8 = 16;

/// Why bytes were rejected as a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrameError {
    /// The bytes end before the frame does; with more of them it may be valid.
    Incomplete,
    /// The bytes do not begin with the sync bytes.
    Sync,
    /// A version that this code does not read.
    Version(u8),
    /// The header's checksum does not match.
    HeaderDamaged,
    /// The header's checksum matches but a field is out of its range.
    HeaderInvalid,
    /// The CRC-32 does not match; the frame has this many bytes.
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

/// Error: the output has no room for the frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoRoom;

impl Header {
    /// Returns the header fields that packing and unpacking need.
    #[must_use]
    pub const fn packing(&self) -> Packing {
        Packing {
            sensor: self.sensor,
            window_events: self.window_events,
            transform: self.transform,
            m: self.m,
            grid: self.grid,
            quantiser: self.quantiser,
            timed: Timed::new(self.timed_max, self.duration_us),
        }
    }

    /// Returns whether the frame ends a window whose events are coded in their order of arrival.
    #[must_use]
    pub const fn ends_arrival(&self) -> bool {
        self.mode.keeps_arrival() && self.last && self.window_events > 0
    }

    /// Returns low bits of the window's start on a clock that goes on from window to window and shows how long a pixel
    /// has been silent: the number of the first cell among those of all time, or microseconds where times are scans.
    #[must_use]
    pub const fn clock(&self, times: Times) -> u32 {
        let cells = match times {
            Times::Cells(cells) => cells.count(),
            Times::Scans(_) => return self.t0_us as u32,
        };
        let duration_us = if self.duration_us == 0 {
            1
        } else {
            self.duration_us
        };
        let scaled = self.t0_us as u128 * cells as u128 / duration_us as u128;
        scaled as u32
    }

    /// Returns the shape of a hybrid frame's volume where the header has none.
    const fn default_shape(regime: Regime) -> ShapeWire {
        let transform = regime.transform();
        ShapeWire {
            transform: transform as u8,
            m: M_DEFAULT,
            grid: transform.grid_size(M_DEFAULT, None),
            step_log2: Quantiser::DEFAULT.step_log2(),
        }
    }

    /// Returns the lowest version that can express the header.
    const fn version(&self) -> u8 {
        if self.mode.effort().is_some() || self.mode.takes_arrival() {
            VERSION_FURTHER
        } else if self.begins_run || self.timed_max > 0 {
            VERSION
        } else {
            VERSION_PLAIN
        }
    }

    /// Writes the fields to the start of `out` and returns their length.
    fn write(&self, payload_bytes: u32, out: &mut [u8]) -> postcard::Result<usize> {
        let is_part = self.part > 0 || !self.last || self.events != self.window_events;
        let counts = CountsWire {
            late: self.late,
            filtered: self.filtered,
            dropped: self.dropped,
            thinned: self.thinned,
            saturated: self.saturated,
        };
        let has_counts = counts != CountsWire::NONE;
        let shape = ShapeWire {
            transform: self.transform as u8,
            m: self.m,
            grid: self.grid,
            step_log2: self.quantiser.step_log2(),
        };
        let (code, value) = self.mode.code();
        let is_transform = self.mode.is_transform();
        let mut mode = code;
        if self.mode.is_dense() {
            mode |= (u8::from(self.is_key) * KEY) | (u8::from(self.has_previous) * PREVIOUS);
            mode |= match self.scans.map(|scan| scan.readout().axis()) {
                None => 0,
                Some(Axis::Columns) => COLUMNS,
                Some(Axis::Rows) => ROWS,
            };
        }
        let has_shape = is_transform || shape != Self::default_shape(self.regime);
        let wire = Wire {
            flags: (u8::from(self.truncated) * TRUNCATED)
                | (u8::from(self.last) * LAST)
                | ((self.regime as u8) << REGIME_SHIFT)
                | (u8::from(is_part) * PART)
                | (u8::from(has_counts) * COUNTS)
                | (u8::from(has_shape) * SHAPE)
                | (u8::from(self.order.is_some()) * ORDER),
            mode,
            payload_bytes,
            sequence: self.sequence,
            width: self.sensor.width,
            height: self.sensor.height,
            t0_us: self.t0_us,
            duration_us: self.duration_us,
            window_events: self.window_events,
        };
        let part = PartWire {
            part: self.part,
            events: self.events,
        };
        let mut len = postcard::to_slice(&wire, out)?.len();
        let mut put = |fields: &dyn Fn(&mut [u8]) -> postcard::Result<usize>| {
            let rest = out.get_mut(len..).unwrap_or_default();
            len += fields(rest)?;
            Ok(())
        };
        if is_part {
            put(&|out| Ok(postcard::to_slice(&part, out)?.len()))?;
        }
        if is_transform {
            put(&|out| Ok(postcard::to_slice(&self.pixels, out)?.len()))?;
        }
        if has_counts {
            put(&|out| Ok(postcard::to_slice(&counts, out)?.len()))?;
        }
        if has_shape {
            put(&|out| Ok(postcard::to_slice(&shape, out)?.len()))?;
        }
        if let Some(value) = value {
            put(&|out| Ok(postcard::to_slice(&value, out)?.len()))?;
        }
        if let Some(scan) = self.scans {
            let scan = ScanWire {
                period_q16: scan.readout().period_q16(),
                slope_q16: scan.readout().slope_q16(),
                phase_q16: scan.phase_q16(),
            };
            put(&|out| Ok(postcard::to_slice(&scan, out)?.len()))?;
        }
        if let Some(OrderSection { bytes, events }) = self.order {
            put(&|out| Ok(postcard::to_slice(&bytes, out)?.len()))?;
            if !self.last {
                put(&|out| Ok(postcard::to_slice(&events, out)?.len()))?;
            }
        }
        if self.version() != VERSION_PLAIN {
            let further =
                (u8::from(self.begins_run) * BEGINS_RUN) | (u8::from(self.timed_max > 0) * TIMED);
            put(&|out| Ok(postcard::to_slice(&further, out)?.len()))?;
            if self.timed_max > 0 {
                put(&|out| Ok(postcard::to_slice(&self.timed_max, out)?.len()))?;
            }
        }
        if let (Some(effort), Some(levels)) = (self.mode.effort(), self.levels) {
            let tree = effort as u8
                | (levels.first << LEVELS_FIRST_SHIFT)
                | (levels.second << LEVELS_SECOND_SHIFT);
            put(&|out| Ok(postcard::to_slice(&tree, out)?.len()))?;
        } else if self.mode.keeps_arrival() {
            put(&|out| Ok(postcard::to_slice(&QUICK, out)?.len()))?;
        } else if self.mode.has_keys() {
            put(&|out| Ok(postcard::to_slice(&KEYS, out)?.len()))?;
        }
        Ok(len)
    }

    /// Parses the fields to the header and the length of its payload.
    ///
    /// Returns `None` if a field is out of its range or written in a way that no encoder writes it, or if bytes are
    /// left.
    fn parse(version: u8, fields: &[u8]) -> Option<(Self, u32)> {
        fn take<'b, T: Deserialize<'b>>(bytes: &mut &'b [u8]) -> Option<T> {
            let (fields, rest) = postcard::take_from_bytes(bytes).ok()?;
            *bytes = rest;
            Some(fields)
        }
        let rest = &mut &*fields;
        let wire: Wire = take(rest)?;
        let has = |flag: u8| wire.flags & flag != 0;
        let regime = Regime::from_code(wire.flags >> REGIME_SHIFT & 3)?;
        let coder = wire.mode & CODER;
        let is_transform = coder == TRANSFORM;
        let mut part = PartWire {
            part: 0,
            events: wire.window_events,
        };
        if has(PART) {
            part = take(rest)?;
            let is_whole = part.part == 0 && has(LAST) && part.events == wire.window_events;
            if is_whole {
                return None;
            }
        } else if !has(LAST) {
            return None;
        }
        let pixels = if is_transform { take(rest)? } else { 0 };
        let mut counts = CountsWire::NONE;
        if has(COUNTS) {
            counts = take(rest)?;
            if counts == CountsWire::NONE {
                return None;
            }
        }
        let mut shape = Self::default_shape(regime);
        if has(SHAPE) {
            let told = take(rest)?;
            if !is_transform && told == shape {
                return None;
            }
            shape = told;
        } else if is_transform {
            return None;
        }
        let chained = wire.mode & (KEY | PREVIOUS | COLUMNS | ROWS);
        let code = wire.mode ^ chained;
        let allowed = match (coder, code) {
            (DENSE, _) => KEY | PREVIOUS | COLUMNS | ROWS,
            (FURTHER, _) => KEY | PREVIOUS | COLUMNS | ROWS,
            (_, COEFFICIENTS_DENSE) => KEY | PREVIOUS,
            _ => 0,
        };
        if chained & !allowed != 0 {
            return None;
        }
        let value = if has_value(code) {
            Some(take(rest)?)
        } else {
            None
        };
        let mut mode = Mode::from_code(code, value.unwrap_or(0))?;
        let sensor = Sensor::new(wire.width, wire.height)?;
        let axis = match chained & (COLUMNS | ROWS) {
            0 => None,
            COLUMNS => Some(Axis::Columns),
            ROWS => Some(Axis::Rows),
            _ => return None,
        };
        let scan = match axis {
            None => None,
            // Other fidelities code times as cells.
            Some(_) if has_value(code) => return None,
            Some(axis) => {
                let told: ScanWire = take(rest)?;
                let readout = Readout::new(axis, told.period_q16, told.slope_q16)?;
                Some(Scans::new(
                    readout,
                    told.phase_q16,
                    sensor,
                    wire.duration_us,
                )?)
            }
        };
        let order = if has(ORDER) {
            let bytes = take(rest)?;
            let events = if has(LAST) { 0 } else { take(rest)? };
            // A frame that is not the last places at least one event and not all.
            if is_transform
                || bytes > wire.payload_bytes
                || (!has(LAST) && !(1..wire.window_events).contains(&events))
            {
                return None;
            }
            Some(OrderSection { bytes, events })
        } else {
            None
        };
        // Version 3 needs a further flag: without one the frame would have the other version.
        let further = if version == VERSION_PLAIN {
            0
        } else {
            take(rest)?
        };
        let is_known = match version {
            VERSION_PLAIN => true,
            VERSION => further != 0 && further & !(BEGINS_RUN | TIMED) == 0,
            _ => further & !BEGINS_RUN == 0,
        };
        let timed_max = if further & TIMED != 0 {
            Some(take(rest)?)
        } else {
            None
        };
        if timed_max.is_some() && !is_transform {
            return None;
        }
        // The order is that of events of equal decoded times, which these are not.
        let is_spread = matches!(
            mode,
            Mode::Hybrid(Hybrid {
                fidelity: Fidelity::SpreadUs(_),
                ..
            })
        );
        if is_spread && order.is_some() {
            return None;
        }
        let is_further = version == VERSION_FURTHER;
        if !is_known || is_further != (coder == FURTHER) {
            return None;
        }
        let mut levels = None;
        if is_further {
            let Mode::Hybrid(hybrid) = &mut mode else {
                return None;
            };
            let tree: u8 = take(rest)?;
            if tree == QUICK {
                // It has no history, exact times, and no order to tell.
                if chained != 0 || has_value(code) || order.is_some() {
                    return None;
                }
                hybrid.coder = Coder::Quick;
            } else if tree == KEYS {
                // It has no history, and no order to tell.
                if chained != 0 || order.is_some() {
                    return None;
                }
                hybrid.coder = Coder::Keys;
            } else {
                let told = Levels {
                    first: tree >> LEVELS_FIRST_SHIFT & 7,
                    second: tree >> LEVELS_SECOND_SHIFT,
                };
                let effort = Effort::from_number(tree & 3)?;
                hybrid.coder = Coder::Tree(effort);
                let times = Times::new(hybrid.fidelity, scan, wire.duration_us);
                Shape::new(times, told)?;
                levels = Some(told);
                // A window is whole, but its order may go on in further frames. Only effort one does without history.
                let is_whole = part.events == wire.window_events;
                let is_order = part.events == 0 && part.part > 0;
                let has_history = chained & PREVIOUS != 0 || effort == Effort::One;
                if !(is_whole || is_order) || !has_history {
                    return None;
                }
            }
        }
        if !rest.is_empty() {
            return None;
        }
        let transform = Transform::from_code(shape.transform)?;
        let header = Self {
            truncated: has(TRUNCATED),
            begins_run: further & BEGINS_RUN != 0,
            last: has(LAST),
            regime,
            mode,
            is_key: !mode.is_dense() || chained & KEY != 0,
            has_previous: chained & PREVIOUS != 0,
            levels,
            scans: scan,
            order,
            sequence: wire.sequence,
            part: part.part,
            sensor,
            t0_us: wire.t0_us,
            duration_us: wire.duration_us,
            window_events: wire.window_events,
            events: part.events,
            pixels,
            late: counts.late,
            filtered: counts.filtered,
            dropped: counts.dropped,
            thinned: counts.thinned,
            saturated: counts.saturated,
            transform,
            m: shape.m,
            grid: shape.grid,
            quantiser: Quantiser::new(shape.step_log2)?,
            timed_max: timed_max.unwrap_or(0),
        };
        let grid_fits = usize::from(header.grid) <= GRID_MAX
            && header.grid > 0
            && (transform != Transform::Dwt || header.grid.is_power_of_two());
        let m_fits = header.m > 0 && usize::from(header.m) <= M_MAX;
        let counts_fit = header.window_events as usize <= EVENTS_MAX
            && header.events <= header.window_events
            && header.pixels <= header.events.min(sensor.pixels())
            && (!is_transform || (header.pixels > 0) == (header.events > 0));
        let timed_fits =
            timed_max.is_none_or(|most| header.packing().takes_timed(most, header.duration_us));
        let fits = grid_fits && m_fits && counts_fit && timed_fits && header.duration_us > 0;
        fits.then_some((header, wire.payload_bytes))
    }
}

/// Completes a frame whose payload lies in `out[HEADER_BYTES_MAX..][..payload_bytes]`.
///
/// The header is placed right before the payload, whatever its length, so that the payload does not move. Returns
/// the range of the frame within `out`.
///
/// # Errors
/// [`NoRoom`] if `out` cannot hold the payload and a CRC, or the frame would exceed [`FRAME_BYTES_MAX`].
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
    // Never fails: the fields take at most FIELDS_BYTES_MAX.
    let fields = header
        .write(payload_bytes as u32, fields)
        .map_err(|_| NoRoom)?;
    let length = PREFIX_BYTES + fields + 2;
    *prefix = [SYNC[0], SYNC[1], header.version(), length as u8];
    let (checked, after) = header_bytes
        .split_at_mut_checked(PREFIX_BYTES + fields)
        .ok_or(NoRoom)?;
    *after.first_chunk_mut().ok_or(NoRoom)? = CRC_16.checksum(checked).to_le_bytes();

    let start = HEADER_BYTES_MAX.checked_sub(length).ok_or(NoRoom)?;
    let frame = frame.get_mut(start..).ok_or(NoRoom)?;
    let (to, from) = (frame.get_mut(..length), header_bytes.get(..length));
    to.ok_or(NoRoom)?.copy_from_slice(from.ok_or(NoRoom)?);
    *frame_crc = crc_32(frame).to_le_bytes();
    Ok(start..crc_at + CRC_BYTES)
}

/// A complete, undamaged frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Frame<'i> {
    /// The frame's header.
    pub header: Header,
    /// The packed pixels, or the events and their order.
    pub payload: &'i [u8],
    /// Length of the frame in bytes, from sync to CRC-32.
    pub bytes: usize,
}

impl<'i> Frame<'i> {
    /// Parses the frame at the start of `bytes`.
    ///
    /// # Errors
    /// Any [`FrameError`]. [`FrameError::Incomplete`] never needs more than [`FRAME_BYTES_MAX`] bytes in all. No
    /// input makes it panic.
    pub fn parse(bytes: &'i [u8]) -> Result<Self, FrameError> {
        let prefix = bytes.len().min(SYNC.len());
        if bytes[..prefix] != SYNC[..prefix] {
            return Err(FrameError::Sync);
        }
        let [_, _, version, header_bytes, ..] = *bytes else {
            return Err(FrameError::Incomplete);
        };
        if !matches!(version, VERSION_PLAIN | VERSION | VERSION_FURTHER) {
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
        let (header, payload_bytes) =
            Header::parse(version, &fields[PREFIX_BYTES..]).ok_or(FrameError::HeaderInvalid)?;
        let payload_bytes = payload_bytes as usize;
        // Checked before the sum below, which would overflow where usize has 32 bits.
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

    /// Splits the payload into the events and their order; the latter is empty if the frame has none.
    #[must_use]
    pub fn sections(&self) -> (&'i [u8], &'i [u8]) {
        let order = self.header.order.map_or(0, |order| order.bytes as usize);
        let events = self.payload.len().saturating_sub(order);
        self.payload
            .split_at_checked(events)
            .unwrap_or((self.payload, &[]))
    }

    /// Iterates over the pixels in raster order.
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

/// Iterator that unpacks a frame pixel by pixel. It ends after an error.
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
    /// Returns how many bits of the payload are left.
    #[must_use]
    pub const fn bits_left(&self) -> u64 {
        self.reader.bits_left()
    }

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
        let header = Header {
            truncated: true,
            begins_run: true,
            last: false,
            regime: Regime::Dense,
            mode: Mode::Hybrid(Hybrid {
                coder: Coder::Dense,
                fidelity: Fidelity::ToleranceUs(u32::MAX),
            }),
            is_key: true,
            has_previous: true,
            levels: None,
            scans: None,
            order: Some(OrderSection {
                bytes: u32::MAX,
                events: u32::MAX,
            }),
            sequence: u32::MAX,
            part: u32::MAX,
            sensor: Sensor {
                width: u16::MAX,
                height: u16::MAX,
            },
            t0_us: u64::MAX,
            duration_us: u32::MAX,
            window_events: u32::MAX,
            events: u32::MAX,
            pixels: u32::MAX,
            late: u32::MAX,
            filtered: u32::MAX,
            dropped: u32::MAX,
            thinned: u32::MAX,
            saturated: u32::MAX,
            transform: Transform::Dwt,
            m: u8::MAX,
            grid: u16::MAX,
            quantiser: Quantiser::DEFAULT,
            timed_max: 0,
        };
        let mut bytes = [0; 2 * HEADER_BYTES_MAX];
        // The number of pixels of mode `transform` takes no more bytes than a tolerance.
        for mode in [header.mode, Mode::Transform] {
            let header = Header { mode, ..header };
            assert!(header.write(u32::MAX, &mut bytes).unwrap() <= FIELDS_BYTES_MAX);
        }
        // Scans take more bytes.
        let readout = Readout::new(Axis::Columns, 250 << 16, -(125 << 16)).unwrap();
        let sensor = Sensor::new(2048, 1).unwrap();
        let scan = Scans::new(readout, i32::MIN, sensor, 1).unwrap();
        let hybrid = Hybrid {
            coder: Coder::Dense,
            fidelity: Fidelity::Lossless,
        };
        let header = Header {
            mode: Mode::Hybrid(hybrid),
            scans: Some(scan),
            ..header
        };
        assert!(header.write(u32::MAX, &mut bytes).unwrap() <= FIELDS_BYTES_MAX);
    }
}
