//! Reads the frames of an `.eecvs` file or stream, and reports what was damaged or lost.

use std::io::Read;

use eecvs_nostd::frame::CRC_BYTES;
use eecvs_nostd::{
    FRAME_BYTES_MAX, Frame, FrameError, Header, Order, Scan, Sensor, Sequence, scan,
};
use serde::Serialize;

use crate::reconstruct::hybrid::Refused;
use crate::stream_buffer::StreamBuffer;

/// Bytes requested from the source at a time.
const READ_BYTES: usize = 1 << 16;

/// Most bytes that are searched for the first frame of a stream.
const FRAMELESS_BYTES_MAX: u64 = 64 << 20;

/// Number of recent frames remembered, the same as in [`Sequence`].
const RECENT: usize = 64;

/// Report of a reader: frames delivered, damage, losses and frames out of order.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct LinkReport {
    /// Frames delivered.
    pub frames: u64,
    /// Bytes that do not belong to any frame.
    pub damaged_bytes: u64,
    /// Runs of consecutive damaged bytes.
    pub damaged_runs: u64,
    /// Offset of the first damaged byte, and the reason why no frame begins there.
    pub first_damage: Option<(u64, String)>,
    /// Frames that never arrived.
    pub frames_lost: u64,
    /// Frames sent before the first one that arrived, by its sequence number: a reader that joins a running stream
    /// has missed them.
    pub frames_before: u64,
    /// Frames that arrived twice; the second copy was skipped.
    pub frames_repeated: u64,
    /// Frames that arrived after a later one; they are delivered in the order of arrival.
    pub frames_reordered: u64,
    /// Times that the sequence numbers started again, because files were concatenated or an encoder was restarted.
    /// No frame is skipped there.
    pub restarts: u64,
    /// Frames whose checksums match but whose payload contradicts its header.
    pub frames_malformed: u64,
    /// Undamaged frames that depend on a missing frame, up to the next key frame.
    pub frames_dependent: u64,
    /// Undamaged frames of windows with more events than the decoder accepts.
    pub frames_crowded: u64,
    /// Offset of the first frame of another sensor, and the size of that sensor. Nothing from there on was used.
    pub other_sensor: Option<(u64, String)>,
}

impl LinkReport {
    /// Returns whether nothing was damaged, lost, repeated or out of order.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        *self
            == Self {
                frames: self.frames,
                ..Self::default()
            }
    }

    /// Returns whether anything is missing. Frames that are repeated or out of order and concatenated files are no
    /// loss.
    #[must_use]
    pub const fn has_loss(&self) -> bool {
        let missing = self.damaged_bytes
            + self.frames_lost
            + self.frames_malformed
            + self.frames_dependent
            + self.frames_crowded;
        missing > 0 || self.other_sensor.is_some()
    }

    /// Counts a frame whose payload does not decode.
    pub const fn count_refused(&mut self, refused: Refused) {
        match refused {
            Refused::Malformed => self.frames_malformed += 1,
            Refused::Dependent => self.frames_dependent += 1,
            Refused::Crowded => self.frames_crowded += 1,
        }
    }

    /// Returns one line that describes the damage and losses, or `None` for a clean stream.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        if self.is_clean() {
            return None;
        }
        let mut met = Vec::new();
        if let Some((offset, why)) = &self.first_damage {
            met.push(format!(
                "{} damaged bytes in {} places, the first at byte {offset}: {why}",
                self.damaged_bytes, self.damaged_runs
            ));
        }
        for (frames, what) in [
            (self.frames_before, "missing before the first one"),
            (self.frames_lost, "lost"),
            (self.frames_repeated, "repeated"),
            (self.frames_reordered, "out of order"),
            (self.frames_malformed, "malformed"),
            (self.frames_dependent, "that depend on missing ones"),
            (
                self.frames_crowded,
                "with more events than a sensor sends or --max-events-per-window allows",
            ),
        ] {
            if frames > 0 {
                met.push(format!("frames {what}: {frames}"));
            }
        }
        if self.restarts > 0 {
            met.push(format!("restarts of the numbering: {}", self.restarts));
        }
        let Some((offset, sensor)) = &self.other_sensor else {
            return Some(format!("{}; everything else was used", met.join("; ")));
        };
        met.push(format!(
            "frames of another sensor ({sensor}) begin at byte {offset}: everything before was \
             used; `eecvs split` separates them"
        ));
        Some(met.join("; "))
    }
}

/// A frame with its position in the source.
#[derive(Debug, Clone, Copy)]
pub struct Located<'r> {
    /// The decoded header, and the payload.
    pub frame: Frame<'r>,
    /// Offset of its first byte.
    pub offset: u64,
    /// All bytes of the frame.
    pub bytes: &'r [u8],
    /// [`LinkReport::restarts`] up to and including this frame.
    pub restarts: u64,
}

/// Follows the sequence numbers of a stream: detects frames lost, repeated or out of order, and restarts.
#[derive(Debug, Clone)]
pub struct FrameOrder {
    sequence: Sequence,
    /// Sequence number and CRC-32 of the latest frames, at index number modulo [`RECENT`].
    recent: [Option<(u32, [u8; CRC_BYTES])>; RECENT],
    newest_t0_us: u64,
}

impl Default for FrameOrder {
    fn default() -> Self {
        Self {
            sequence: Sequence::new(),
            recent: [None; RECENT],
            newest_t0_us: 0,
        }
    }
}

impl FrameOrder {
    /// Counts a frame's place in the sequence in `report`; returns whether to deliver the frame. `crc` is its last
    /// bytes.
    pub fn take(&mut self, header: &Header, crc: [u8; CRC_BYTES], report: &mut LinkReport) -> bool {
        let number = header.sequence;
        if self.recent.iter().all(Option::is_none) {
            report.frames_before += u64::from(number);
        }
        let mut order = self.sequence.follow(number);
        if order == Order::Repeated && self.begins_anew(header, crc) {
            report.restarts += 1;
            *self = Self::default();
            report.frames_before += u64::from(number);
            order = self.sequence.follow(number);
        }
        match order {
            Order::InOrder => {}
            Order::Lost(frames) => report.frames_lost += u64::from(frames),
            Order::Reordered => {
                report.frames_reordered += 1;
                report.frames_lost = report.frames_lost.saturating_sub(1);
            }
            Order::Repeated => {
                report.frames_repeated += 1;
                return false;
            }
        }
        report.frames += 1;
        self.recent[number as usize % RECENT] = Some((number, crc));
        self.newest_t0_us = if header.begins_run {
            header.t0_us
        } else {
            self.newest_t0_us.max(header.t0_us)
        };
        true
    }

    /// Returns whether a sequence number seen before belongs to a new frame: of a concatenated file, or of an
    /// encoder that was restarted.
    fn begins_anew(&self, header: &Header, crc: [u8; CRC_BYTES]) -> bool {
        match self.recent[header.sequence as usize % RECENT] {
            Some((number, seen)) if number == header.sequence => seen != crc,
            // Too old to be remembered. A repeated frame is neither newer than all others nor an encoder's first.
            _ => header.sequence == 0 || header.t0_us > self.newest_t0_us,
        }
    }
}

/// Sensors whose sequence numbers are followed separately; no camera setup has more.
const SENSORS_MAX: usize = 256;

/// Returns the sequence state of a sensor, and creates it if needed.
fn order_of(orders: &mut Vec<(Sensor, FrameOrder)>, sensor: Sensor) -> &mut FrameOrder {
    let at = orders.iter().position(|(of, _)| *of == sensor);
    let at = at.unwrap_or_else(|| {
        orders.truncate(SENSORS_MAX - 1);
        orders.push((sensor, FrameOrder::default()));
        orders.len() - 1
    });
    &mut orders[at].1
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
    /// Sequence state for each sensor.
    orders: Vec<(Sensor, FrameOrder)>,
    report: LinkReport,
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
            orders: Vec::new(),
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
        let (header, payload, bytes) = loop {
            if self.report.other_sensor.is_some() {
                return Ok(None);
            }
            let rest = self.buffer.rest();
            match scan(rest) {
                Scan::Frame(frame) => {
                    let (header, payload, bytes) = (frame.header, frame.payload.len(), frame.bytes);
                    let crc = rest[..bytes].last_chunk().copied().unwrap_or_default();
                    let Sensor { width, height } = header.sensor;
                    let sensor = *self.sensor.get_or_insert(header.sensor);
                    if header.sensor != sensor && !self.takes_all_sensors {
                        let other = (self.buffer.used(), format!("{width}x{height}"));
                        self.report.other_sensor = Some(other);
                        continue;
                    }
                    self.buffer.take(bytes);
                    let order = order_of(&mut self.orders, header.sensor);
                    if order.take(&header, crc, &mut self.report) {
                        break (header, payload, bytes);
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
                Scan::Incomplete if self.ended => return Ok(None),
                Scan::Incomplete => self.fill()?,
            }
        };
        let offset = self.buffer.used() - bytes as u64;
        let frame_bytes = self.buffer.last(bytes);
        let payload_end = bytes - CRC_BYTES;
        Ok(Some(Located {
            frame: Frame {
                header,
                payload: &frame_bytes[payload_end - payload..payload_end],
                bytes,
            },
            offset,
            bytes: frame_bytes,
            restarts: self.report.restarts,
        }))
    }

    fn skip(&mut self, error: FrameError, skip: usize, checked: usize) {
        let offset = self.buffer.used();
        let first = &mut self.report.first_damage;
        first.get_or_insert_with(|| (offset, error.to_string()));
        self.buffer.damage(skip, checked);
        (self.report.damaged_bytes, self.report.damaged_runs) = self.buffer.damaged();
    }

    fn fill(&mut self) -> std::io::Result<()> {
        // Whatever this is, it is no stream of frames, and it may have no end.
        if self.sensor.is_none() && self.report.damaged_bytes > FRAMELESS_BYTES_MAX {
            let text = format!("no frame in the first {FRAMELESS_BYTES_MAX} bytes");
            return Err(std::io::Error::other(text));
        }
        let read = loop {
            match self.source.read(&mut self.piece) {
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                result => break result?,
            }
        };
        self.buffer.push(&self.piece[..read]);
        self.ended = read == 0;
        Ok(())
    }
}
